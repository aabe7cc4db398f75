//! The report: levels, missing samples, dead channels.

use super::*;
use crate::record::At;

#[test]
fn levels_are_those_of_the_samples() {
    // A vertical sensor: 1e-4 m/s² of vibration on gravity. A sum of plain squares would keep 4 digits of it.
    let amplitude = 1e-4;
    let text: String =
        (0..10_000).map(|row| format!("{:.9} 5\n", 9.81 + amplitude * f64::from(row % 2 * 2 - 1))).collect();
    let folder = folder(&[("a.txt", text.as_bytes())]);
    let (_, report) = read(&setup(&["1", "2"], &["a.txt"]), folder.path()).unwrap();
    // The square wave's rms is its amplitude; 9.81 as a double is known to 2e-15.
    assert!((report.channels[0].rms / amplitude - 1.0).abs() < 1e-8, "{}", report.channels[0].rms);
    assert!((report.channels[0].mean - 9.81).abs() < 1e-12);
    assert!(!report.channels[0].constant);
    assert!(report.channels[1].constant);
    assert_eq!((report.channels[1].mean, report.channels[1].rms), (5.0, 0.0));
    assert_eq!(report.warnings.len(), 1);
    let text = report.warnings[0].to_string();
    assert!(text.contains("channel \"2\" is dead: every sample is 5"), "{text}");
}

#[test]
fn gaps_are_counted_over_blocks_and_files() {
    let value = |row: usize| if (4000..4200).contains(&row) || row == 10 { "NaN".to_owned() } else { row.to_string() };
    let part = |rows: std::ops::Range<usize>| -> String { rows.map(|row| format!("{row} {}\n", value(row))).collect() };
    let (first, second) = (format!("# one\n{}", part(0..4150)), part(4150..9000));
    let folder = folder(&[("1.txt", first.as_bytes()), ("2.txt", second.as_bytes())]);
    let (_, report) = read(&setup(&["1", "2"], &["*.txt"]), folder.path()).unwrap();
    assert_eq!((report.channels[0].missing, report.channels[0].gap_count), (0, 0));
    let channel = &report.channels[1];
    assert_eq!((channel.missing, channel.gap_count), (201, 2));
    assert_eq!((channel.gaps[0].row, channel.gaps[0].rows, channel.gaps[0].position.at), (10, 1, At::Line(12)));
    assert_eq!((channel.gaps[1].row, channel.gaps[1].rows, channel.gaps[1].position.at), (4000, 200, At::Line(4002)));
    let text = report.warnings[0].to_string();
    for part in [
        "channel \"2\" has 2 gaps, 201 samples (4.020 s) in all",
        "the first at",
        "1.txt, line 12, 0:00:00 into the record",
    ] {
        assert!(text.contains(part), "{text}");
    }
    assert_eq!(report.warnings.len(), 1);
}

#[test]
fn between_joined_blocks_rows_are_missing_and_nothing_is_lost() {
    let lines: String = (0..10_001).map(|row| format!("{row}\n")).collect();
    let folder = folder(&[("a.txt", lines.as_bytes()), ("b.txt", b"1\n2\n")]);
    let joined = Setup { block_s: Some(20.0), ..setup(&["1"], &["*.txt"]) };
    // Blocks of 1000 rows; the last one of the first file has one row.
    let (rows, report) = read(&joined, folder.path()).unwrap();
    assert_eq!(rows.len(), 10_001 + 10 * 4 + 4 + 2);
    for block in 0..10 {
        let start = block * 1004;
        assert_eq!((rows[start][0], rows[start + 999][0]), (1000.0 * block as f64, 1000.0 * block as f64 + 999.0));
        assert!(rows[start + 1000..start + 1004].iter().all(|row| row[0].is_nan()));
    }
    assert_eq!((rows[10_040][0], rows[10_045..].concat()), (10_000.0, vec![1.0, 2.0]));
    assert!(rows[10_041..10_045].iter().all(|row| row[0].is_nan()), "a file is a block too");
    assert_eq!((report.channels[0].missing, report.warnings.len()), (0, 0), "what the study says needs no warning");
}

#[test]
fn a_gap_that_several_channels_share_is_told_once() {
    let row = |row: u64| match row {
        3000..3025 => "NaN NaN NaN NaN\n".to_owned(),
        7000..7002 => format!("{row} NaN NaN 1\n"),
        _ => format!("{row} {row} {row} {row}\n"),
    };
    let text: String = (0..9000).map(row).collect();
    let folder = folder(&[("a.txt", text.as_bytes())]);
    let texts = |channels: &[&str]| -> Vec<String> {
        let (_, report) = read(&setup(channels, &["a.txt"]), folder.path()).unwrap();
        report.warnings.iter().map(ToString::to_string).collect()
    };
    let told = texts(&["1", "4"]);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].starts_with("both channels have a gap of 25 samples (0.500 s) at "), "{told:?}");
    assert!(told[0].contains("a.txt, line 3001, 0:01:00 into the record"), "{told:?}");
    let told = texts(&["1", "2", "3", "4"]);
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(told[0].starts_with("2 of 4 channels (\"1\", \"4\") have a gap of 25 samples"), "{told:?}");
    assert!(told[1].starts_with("2 of 4 channels (\"2\", \"3\") have 2 gaps, 27 samples (0.540 s) in all"), "{told:?}");
}

#[test]
fn many_gaps_keep_the_first_few() {
    let text: String = (0..100).map(|row| if row % 2 == 0 { "nan\n".into() } else { format!("{row}\n") }).collect();
    let folder = folder(&[("a.txt", text.as_bytes())]);
    let (_, report) = read(&setup(&["1"], &["a.txt"]), folder.path()).unwrap();
    assert_eq!((report.channels[0].missing, report.channels[0].gap_count), (50, 50));
    assert_eq!(report.channels[0].gaps.len(), 5);
    assert!(report.channels[0].gaps.iter().all(|gap| gap.rows == 1));
}

#[test]
fn mostly_missing_channels_are_warned_of() {
    let folder = folder(&[("a.txt", b"1 nan nan\n2 nan nan\n3 5 nan\n")]);
    let (_, report) = read(&setup(&["1", "2", "3"], &["a.txt"]), folder.path()).unwrap();
    let texts: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    assert_eq!(texts.len(), 4, "{texts:?}");
    assert!(texts[2].contains("channel \"2\": 66.7 %") && texts[3].contains("channel \"3\": 100.0 %"), "{texts:?}");
    assert!(report.channels[2].constant && report.channels[2].rms.is_nan());
    assert!(!report.channels[1].constant, "one sample has nothing to differ from");
}

#[test]
fn numbers_that_no_sensor_gives_are_told_and_count_as_missing() {
    let sound = |row: usize| (row as f64 * 0.3).sin();
    // The bit of an exponent that makes most of a number: 1e-308 or 1e308 times as much.
    let flipped = |value: f64| f64::from_bits(value.to_bits() ^ (1 << 62));
    for wrong in [0, 5000] {
        let value = |row: usize| if row == wrong { flipped(sound(row) + 0.5) } else { sound(row) + 0.5 };
        assert!(value(wrong).abs() > 1e300);
        let text: String = (0..9000).map(|row| format!("{row} {:e}\n", value(row))).collect();
        let folder = folder(&[("a.txt", text.as_bytes())]);
        let (rows, report) = read(&setup(&["1", "2"], &["a.txt"]), folder.path()).unwrap();
        assert!(rows.iter().enumerate().all(|(row, values)| values[1].is_nan() == (row == wrong)));
        assert_eq!((report.channels[0].missing, report.channels[1].missing), (0, 1));
        assert!(report.channels[1].rms < 1.0 && report.channels[1].mean < 1.0);
        let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
        let line = format!("a.txt, line {}", wrong + 1);
        let is_told =
            |told: &&String| told.contains("channel \"2\": 1 sample that no sensor can give") && told.contains(&line);
        assert_eq!(told.iter().filter(is_told).count(), 1, "{told:?}");
    }
}
