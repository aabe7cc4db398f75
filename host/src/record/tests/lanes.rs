//! Recordings of several loggers on one line of time.

use super::hdf5::{foreign, same};
use super::*;

/// 2026-03-01 12:00:00.25 UTC.
const START_S: f64 = 1_772_366_400.25;

/// A CSV of one channel with Unix times: rows from `from` on, `step_s` apart, their values their numbers.
fn table(name: &str, from: f64, rows: u32, step_s: f64) -> String {
    let mut text = format!("time,{name}\n");
    for row in 0..rows {
        text += &format!("{:.6},{row}\n", START_S + 0.02 * from + step_s * f64::from(row));
    }
    text
}

fn check_both(folder: &Path, files: &[&str]) -> RecordReport {
    let (rows, report) = read(&setup(&["y", "x"], files), folder).unwrap();
    assert_eq!(rows.len(), 100);
    for (row, found) in rows.iter().enumerate() {
        assert_eq!(found[1], row as f64);
        assert!(if (10..70).contains(&row) { found[0] == row as f64 - 10.0 } else { found[0].is_nan() }, "row {row}");
    }
    report
}

#[test]
fn tables_with_unix_times_stand_beside_each_other_and_what_is_left_is_told() {
    let (x, y) = (table("x", 0.0, 100, 0.02), table("y", 10.2, 60, 0.02));
    let parts: Vec<&str> = y.split_inclusive('\n').collect();
    let second = format!("{}{}", parts[0], parts[31..].concat());
    let files = [("x.csv", x), ("y.csv", y.clone()), ("z1.csv", parts[..31].concat()), ("z2.csv", second)];
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
    let folder = folder(&files);
    for names in [["x.csv", "y.csv"].as_slice(), &["y.csv", "x.csv"], &["x.csv", "z*.csv"]] {
        let report = check_both(folder.path(), names);
        let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
        // A fifth of 20 ms.
        let is_told = |told: &String| told.contains("4.00 ms later") && told.contains("1.44° at 1 Hz");
        assert!(told.iter().any(is_told), "{told:?}");
        let recording = Recording::open(&setup(&["y", "x"], names), folder.path()).unwrap();
        assert_eq!(recording.start_ns().unwrap(), Some(1_772_366_400_250_000_000));
    }
    // A sample that no sensor gives is told in the file and at the line where it stands.
    let wrong = y.replace(",20\n", ",1e30\n");
    std::fs::write(folder.path().join("y.csv"), wrong).unwrap();
    let (_, report) = read(&setup(&["y", "x"], &["x.csv", "y.csv"]), folder.path()).unwrap();
    let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    assert!(told.iter().any(|told| told.contains("no sensor can give") && told.contains("y.csv, line 22")), "{told:?}");
}

#[test]
fn loggers_of_other_formats_stand_beside_each_other() {
    // One second after the TDMS file begins, 150 rows.
    let table = table("z", 50.0, 150, 0.02);
    let stamps: Vec<String> =
        (0..150).map(|row| format!("\"2026-03-01 13:00:01.{:02}\",{row},{row}", 25 + 2 * row)).take(37).collect();
    let toa5 = format!(
        "\"TOA5\",\"mast\"\r\n\"TIMESTAMP\",\"RECORD\",\"AccZ\"\r\n\"TS\",\"RN\",\"g\"\r\n\"\",\"\",\"Smp\"\r\n{}\r\n",
        stamps.join("\r\n")
    );
    let tdms = std::fs::read(foreign().join("nptdms.tdms")).unwrap();
    let folder = folder(&[("a.tdms", &tdms), ("b.csv", table.as_bytes()), ("c.dat", toa5.as_bytes())]);
    let mut both = setup(&["z", "top-y"], &["a.tdms", "b.csv"]);
    let (rows, report) = read(&both, folder.path()).unwrap();
    assert_eq!(rows.len(), 300);
    for (row, (found, expected)) in rows.iter().zip(same()).enumerate() {
        assert_eq!(found[1], expected[1]);
        assert!(if (50..200).contains(&row) { found[0] == row as f64 - 50.0 } else { found[0].is_nan() }, "row {row}");
    }
    assert!(!report.warnings.iter().any(|warning| matches!(warning, crate::record::RecordWarning::Offset { .. })));
    // A logger whose clock is an hour ahead of UTC.
    both = setup(&["top-x", "AccZ"], &["a.tdms", "c.dat"]);
    both.utc_offset_h = Some(1.0);
    let (rows, _) = read(&both, folder.path()).unwrap();
    assert_eq!((rows[49][1].is_nan(), rows[50][1], rows[86][1], rows[87][1].is_nan()), (true, 0.0, 36.0, true));
    both.utc_offset_h = None;
    let error = read(&both, folder.path()).unwrap_err().to_string();
    assert!(error.contains("c.dat has other channels") && error.contains("`utc_offset_h`"), "{error}");
}

#[test]
fn clocks_that_run_apart_are_told_and_what_cannot_stand_beside_each_other_is_refused() {
    let files = [
        ("x.csv", table("x", 0.0, 1500, 0.02)),
        // 0.05 % slow: three quarters of a row at the end.
        ("slow.csv", table("y", 0.0, 1500, 0.02001)),
        ("late.csv", table("y", 1e9, 100, 0.02)),
        ("twice.csv", table("x", 0.0, 1500, 0.02)),
        ("plain.csv", "y\n1\n2\n".to_owned()),
        (
            "other.csv",
            table("y", 0.0, 1500, 0.02).replace("time,y", "time,x").replace("\n", ",0\n").replace("x,0", "x,w"),
        ),
    ];
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
    let folder = folder(&files);
    let (_, report) = read(&setup(&["x", "y"], &["x.csv", "slow.csv"]), folder.path()).unwrap();
    let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    assert!(told.iter().any(|told| told.contains("run apart by 0.7 rows")), "{told:?}");
    for (channels, files, parts) in [
        (["x", "y"], ["x.csv", "late.csv"], ["late.csv begins 20000000 s after", "make two setups"]),
        (["x", "y"], ["x.csv", "plain.csv"], ["plain.csv has other channels", "seconds since 1970"]),
        (["x", "nothing"], ["x.csv", "slow.csv"], ["nothing", "correct `channel`"]),
        (["x", "w"], ["x.csv", "other.csv"], ["other.csv has a channel `x`", "rename one of them"]),
        // The same times again: another logger's, or the file twice.
        (["x", "x"], ["x.csv", "twice.csv"], ["twice.csv, line 2: time goes from", "must advance"]),
    ] {
        let error = read(&setup(&channels, &files), folder.path()).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
}

/// A file with other bytes wherever these stand.
fn with(file: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let mut changed = file.to_vec();
    let places: Vec<usize> = (0..file.len()).filter(|at| file[*at..].starts_with(from)).collect();
    assert!(!places.is_empty());
    places.into_iter().for_each(|at| changed[at..at + to.len()].copy_from_slice(to));
    changed
}

/// TDMS files of six seconds, by their names and when they begin, in s after the first of all.
fn hourly(starts_s: &[(&str, i64)]) -> tempfile::TempDir {
    let tdms = std::fs::read(foreign().join("nptdms.tdms")).unwrap();
    // Seconds since 1904, as TDMS counts them.
    let start_s = START_S as i64 + 2_082_844_800;
    let after = |seconds: i64| with(&tdms, &start_s.to_le_bytes(), &(start_s + seconds).to_le_bytes());
    let files: Vec<(&str, Vec<u8>)> = starts_s.iter().map(|(name, start_s)| (*name, after(*start_s))).collect();
    folder(&files.iter().map(|(name, bytes)| (*name, bytes.as_slice())).collect::<Vec<_>>())
}

/// Rows, those filled in, and what is told, of the two channels of [`same`] in files one after the other.
fn of_files(folder: &Path, channels: &[&str], files: &[&str]) -> (Vec<Vec<f64>>, u64, Vec<String>) {
    let setup = setup(channels, files);
    let (rows, report) = read(&setup, folder).unwrap();
    let counted = Recording::open(&setup, folder).unwrap().total_rows().unwrap();
    assert_eq!((counted, report.rows), (rows.len() as u64, rows.len() as u64));
    (rows, report.filled_rows, report.warnings.iter().map(ToString::to_string).collect())
}

/// Holds rows against files of 300, with so many missing before each.
fn in_turn(rows: &[Vec<f64>], missing: &[usize]) {
    let (same, mut rest) = (same(), rows);
    for missing in missing {
        let (gap, file) = rest.split_at(*missing);
        assert!(gap.iter().flatten().all(|value| value.is_nan()));
        assert_eq!(file[..300], same);
        rest = &file[300..];
    }
    assert!(rest.is_empty());
}

#[test]
fn what_is_missing_between_files_that_say_when_they_begin_is_a_gap() {
    let folder = hourly(&[("a.tdms", 0), ("b.tdms", 6), ("c.tdms", 16), ("d.tdms", 22)]);
    let (rows, filled, told) = of_files(folder.path(), &["top-x", "top-y"], &["*.tdms"]);
    in_turn(&rows, &[0, 0, 200, 0]);
    assert_eq!(filled, 200);
    assert!(told.iter().any(|told| told.contains("c.tdms, row 1: gap in time: 200 rows (4.000 s)")), "{told:?}");
    // Blocks of a schedule follow each other, with the rows between blocks.
    let mut blocks = setup(&["top-x", "top-y"], &["a.tdms", "c.tdms"]);
    blocks.block_s = Some(6.0);
    assert_eq!(read(&blocks, folder.path()).unwrap().0.len(), 604);
    // An hour in UTC is none of a clock that was put forward, and most of the time without a recording is no channel's fault.
    let folder = hourly(&[("a.tdms", 0), ("b.tdms", 3606)]);
    let (_, filled, told) = of_files(folder.path(), &["top-x", "top-y"], &["*.tdms"]);
    assert_eq!((filled, told.len()), (180_000, 1));
    assert!(!told[0].contains("summer"), "{told:?}");
    // Years are a wrong clock.
    let folder = hourly(&[("a.tdms", 0), ("y.tdms", 500_000_000)]);
    let error = Recording::open(&setup(&["top-x"], &["*.tdms"]), folder.path()).unwrap_err().to_string();
    assert!(error.contains("y.tdms, row 1: time jumps from") && error.contains("`block_s`"), "{error}");
}

#[test]
fn starts_that_are_rounded_wrong_or_the_measurements_make_no_gap() {
    for (starts_s, early) in [
        // Whole seconds, rounded apart.
        (&[0, 7, 12][..], None),
        // One clock is wrong, and the next is right again.
        (&[0, -3600, 12], Some("f1.tdms starts 3606.000 s before")),
        // In another order than that of time.
        (
            &[6, 0, 12],
            Some(
                "f1.tdms starts 12.000 s before the files that it follows have ended, by the start time in its header (and so does 1 more file)",
            ),
        ),
        // All of a measurement have its start, and then those of the next.
        (&[0, 0, 0, 18, 18], None),
    ] {
        let names: Vec<String> = (0..starts_s.len()).map(|at| format!("f{at}.tdms")).collect();
        let files: Vec<(&str, i64)> = names.iter().map(String::as_str).zip(starts_s.iter().copied()).collect();
        let (rows, filled, told) = of_files(hourly(&files).path(), &["top-x", "top-y"], &["f*.tdms"]);
        in_turn(&rows, &vec![0; starts_s.len()]);
        assert_eq!((filled, told.len()), (0, usize::from(early.is_some())), "{starts_s:?}: {told:?}");
        assert!(early.is_none_or(|early| told[0].contains(early)), "{told:?}");
    }
}

#[test]
fn of_several_loggers_each_has_its_gaps_and_what_is_shifted_is_told() {
    // A table beside TDMS files: four seconds are missing between two of them, and one more than the last starts say.
    let folder = hourly(&[("a.tdms", 0), ("b.tdms", 10), ("c.tdms", 17)]);
    std::fs::write(folder.path().join("z.csv"), table("z", 0.0, 1150, 0.02)).unwrap();
    let (rows, _, told) = of_files(folder.path(), &["z", "top-x"], &["*.tdms", "z.csv"]);
    let same = same();
    for (row, found) in rows.iter().enumerate() {
        assert_eq!(found[0], row as f64);
        let of_file = match row {
            0..300 => Some(row),
            500..1100 => Some((row - 500) % 300),
            _ => None,
        };
        assert!(of_file.map_or(found[1].is_nan(), |at| found[1] == same[at][0]), "row {row}");
    }
    let is_told =
        |told: &String| told.contains("c.tdms: by the start time in its header its samples are 1000.00 ms later");
    assert_eq!(told.iter().filter(|told| is_told(told)).count(), 1, "{told:?}");
}

#[test]
fn hdf5_files_that_say_when_they_begin_leave_gaps_as_well() {
    let h5 = std::fs::read(foreign().join("h5py_scaled.h5")).unwrap();
    let at = |time: &[u8]| with(&h5, b"12:00:00.25Z", time);
    let (next, behind) = (at(b"12:00:10.25Z"), at(b"12:00:06.75Z"));
    let folder = folder(&[("a.h5", &h5), ("b.h5", &next), ("c.h5", &behind)]);
    let (rows, filled, _) = of_files(folder.path(), &["1", "2"], &["a.h5", "b.h5"]);
    in_turn(&rows, &[0, 200]);
    assert_eq!(filled, 200);
    // A recorder that is half a second behind by its clock has lost nothing.
    let (rows, filled, told) = of_files(folder.path(), &["1", "2"], &["a.h5", "c.h5"]);
    in_turn(&rows, &[0, 0]);
    assert_eq!((filled, told.len()), (0, 0), "{told:?}");
}
