//! CSV: headers, separators, and the time column.

use super::*;
use crate::record::{At, RecordWarning};

#[test]
fn columns_go_by_their_names() {
    let text = b"# logger 7\nlabel, top ,\"low, east\"\r\nx,1.5,\"2\"\r\n,,3\r\n\r\ny,4,nan\r\n";
    let rows = rows_of(&setup(&["low, east", "top"], &["a.csv"]), "a.csv", text);
    assert_eq!(rows.len(), 3);
    assert_eq!(rows[0], [2.0, 1.5]);
    assert!(rows[1][0] == 3.0 && rows[1][1].is_nan());
    assert!(rows[2][0].is_nan() && rows[2][1] == 4.0);
}

#[test]
fn a_calibration_is_applied_to_readings_in_the_unit_of_the_recording() {
    let mut calibrated = setup(&["a", "b"], &["r.csv"]);
    calibrated.unit = crate::study::Unit::StandardGravity;
    calibrated.sensors[0].gain = Some(2.0);
    calibrated.sensors[0].offset_m_s2 = Some(0.5);
    let rows = rows_of(&calibrated, "r.csv", b"a,b\n1,1\n,2\n");
    // (9.80665 - 0.5) × 2, whatever the unit is.
    assert!((rows[0][0] - 2.0 * (9.806_65 - 0.5)).abs() < 1e-12 && rows[0][1] == 9.806_65, "{rows:?}");
    assert!(rows[1][0].is_nan());
}

#[test]
fn semicolons_and_tabulators_separate_too() {
    let wanted = setup(&["b"], &["a.csv"]);
    assert_eq!(rows_of(&wanted, "a.csv", b"a;b\n1;2\n"), [[2.0]]);
    let rows = rows_of(&wanted, "a.csv", b"a\tb\n1\t2\n\t\n3\t\n");
    assert_eq!(rows.len(), 3);
    assert!(rows[0][0] == 2.0 && rows[1][0].is_nan() && rows[2][0].is_nan());
}

#[test]
fn a_blank_line_in_the_only_column_is_a_missing_sample() {
    let rows = rows_of(&setup(&["b"], &["a.csv"]), "a.csv", b"b\n1\n\n\n2\n\n");
    assert_eq!(rows.len(), 4);
    assert!(rows[0][0] == 1.0 && rows[1][0].is_nan() && rows[2][0].is_nan() && rows[3][0] == 2.0);
}

#[test]
fn blank_lines_between_rows_give_a_warning_where_no_time_says_what_they_are() {
    let told = |bytes: &[u8]| {
        let folder = folder(&[("a.csv", bytes)]);
        let (rows, report) = read(&setup(&["b"], &["a.csv"]), folder.path()).unwrap();
        assert_eq!(rows.len(), 3);
        report.warnings.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let [text] = &told(b"a,b\n\n1,1\n2,2\n\n \n3,1\n\n")[..] else { panic!("one warning") };
    assert!(text.contains("a.csv, line 5: the first of 2 blank lines between rows, which are skipped"), "{text}");
    let [text] = &told(b"a,b\n1,1\n\n2,2\n3,1\n")[..] else { panic!("one warning") };
    assert!(text.contains("a.csv, line 3: a blank line between rows, which is skipped"), "{text}");
    assert_eq!(told(b"Time,b\n0.00,1\n\n0.02,2\n0.04,3\n"), [""; 0]);
}

#[test]
fn an_infinite_sample_is_told_and_left_out() {
    expect_impossible(&setup(&["b"], &["a.csv"]), "a.csv", b"a,b\n1,2\n1,inf\n", &["a.csv, line 3", "\"b\"", "inf"]);
}

#[test]
fn a_damaged_cell_is_named() {
    let wanted = setup(&["b"], &["a.csv"]);
    expect_error(&wanted, &[("a.csv", b"a,b\r\n1,2\r\n#\r\n1,on\r\n")], &["a.csv, line 4", "`b`", "`on`", "empty"]);
    expect_error(&wanted, &[("a.csv", b"a,b\n1,2\n1,2,3\n")], &["a.csv, line 3", "3 values", "have 2"]);
    expect_error(&wanted, &[("a.csv", b"a,b\n1,2\n1\n")], &["a.csv, line 3", "1 values", "have 2"]);
    expect_error(&wanted, &[("a.csv", b"a,b\n1,\"2\n")], &["a.csv, line 2", "quote"]);
    expect_error(&wanted, &[("a.csv", b"a,c\n1,2\n")], &["a.csv", "`b`", "columns `a`, `c`"]);
    expect_error(&wanted, &[("a.csv", b"b,b\n1,2\n")], &["more than one", "`b`"]);
    expect_error(&wanted, &[("a.csv", b"a,b\n")], &["a.csv is empty"]);
    expect_error(&wanted, &[("a.csv", b"")], &["a.csv is empty"]);
    let both = setup(&["b"], &["*.csv"]);
    let (first, second): (&[u8], &[u8]) = (b"a,b\n1,2\n", b"b,a\n2,1\n");
    expect_error(&both, &[("1.csv", first), ("2.csv", second)], &["2.csv has the columns `b`, `a`", "`a`, `b`"]);
}

/// A CSV with rows at `times_s` written with `decimals`, whose samples count up.
fn timed(times_s: impl IntoIterator<Item = f64>, decimals: usize) -> Vec<u8> {
    let rows = times_s.into_iter().enumerate().map(|(row, time_s)| format!("{time_s:.decimals$},{row}\n"));
    format!("Time,top\n{}", rows.collect::<String>()).into_bytes()
}

#[test]
fn rows_lost_by_the_time_column_are_filled_and_warned_of() {
    // 50 Hz; after the third row five rows are lost, which is a jump of six steps.
    let times_s = [0.00, 0.02, 0.04, 0.16, 0.18];
    let folder = folder(&[("a.csv", &timed(times_s, 2))]);
    let (rows, report) = read(&setup(&["top"], &["a.csv"]), folder.path()).unwrap();
    assert_eq!(rows.len(), 10);
    assert!(rows[3..8].iter().all(|row| row[0].is_nan()));
    assert_eq!(rows[8..], [[3.0], [4.0]]);
    assert_eq!(report.filled_rows, 5);
    let [RecordWarning::TimeGap { position, rows: 5, seconds, is_between_files: false }] = &report.warnings[..] else {
        panic!("{:?}", report.warnings)
    };
    assert_eq!(position.at, At::Line(5));
    assert!((seconds - 0.1).abs() < 1e-12); // 5 rows at 50 Hz, rounded once
    let text = report.warnings[0].to_string();
    assert!(text.contains("a.csv, line 5") && text.contains("5 rows (0.100 s)"), "{text}");
    assert_eq!((report.channels[0].missing, report.channels[0].gap_count), (5, 1));
    assert_eq!((report.channels[0].gaps[0].row, report.channels[0].gaps[0].rows), (3, 5));
}

#[test]
fn many_gaps_are_summed_up() {
    let times_s = (0..4000).filter(|row| row % 400 != 399).map(|row| f64::from(row) * 0.02);
    let folder = folder(&[("a.csv", &timed(times_s, 3))]);
    let (rows, report) = read(&setup(&["top"], &["a.csv"]), folder.path()).unwrap();
    // The tenth lost row is the last, after which nothing tells that it was there.
    assert_eq!(rows.len(), 3999);
    assert_eq!(report.warnings.len(), 6);
    assert!(report.warnings[5].to_string().contains("9 gaps in time altogether: 9 rows (0.180 s)"));
}

#[test]
fn time_goes_on_or_starts_again_in_the_next_file() {
    let wanted = setup(&["top"], &["*.csv"]);
    let second = |start_s: f64| timed([start_s, start_s + 0.02], 2);
    let count = |start_s: f64| {
        let folder = folder(&[("1.csv", &timed([10.0, 10.02], 2)), ("2.csv", &second(start_s))]);
        read(&wanted, folder.path()).map(|(rows, _)| rows.len())
    };
    assert_eq!(count(10.04).unwrap(), 4);
    assert_eq!(count(10.0).unwrap(), 4);
    assert_eq!(count(0.0).unwrap(), 4);
    assert_eq!(count(11.04).unwrap(), 4 + 50);
    let text = count(9.0).unwrap_err().to_string();
    assert!(text.contains("2.csv, line 2") && text.contains("from 10.02 s to 9 s"), "{text}");
}

#[test]
fn the_time_column_must_keep_the_sampling_rate() {
    let wanted = setup(&["top"], &["a.csv"]);
    let at = |rate_hz: f64| timed((0..500).map(|row| f64::from(row) / rate_hz), 6);
    expect_error(&wanted, &[("a.csv", &at(100.0))], &["a.csv, line 2", "100.000", "50", "`Time`", "sampling_rate_hz"]);
    expect_error(&wanted, &[("a.csv", &at(50.1))], &["50.1", "sampling_rate_hz is 50"]);
    // 0.04 % off is a crystal, not a mistake.
    assert_eq!(rows_of(&wanted, "a.csv", &at(50.02)).len(), 500);
    // A rate that changes later on is noticed where it happens.
    let drifting = (0..6000).map(|row| f64::from(row) * 0.02 + f64::from((row - 1500).max(0)) * 0.0002);
    expect_error(&wanted, &[("a.csv", &timed(drifting, 6))], &["a.csv, line 4098", "sampling_rate_hz is 50"]);
}

#[test]
fn rounded_times_do_not_mislead() {
    // 128 Hz in whole milliseconds steps by 7 and 8 ms: the median step alone would say 125 Hz.
    let mut wanted = setup(&["top"], &["a.csv"]);
    wanted.sampling_rate_hz = 128.0;
    for rows in [3, 50, 5000] {
        let text = timed((0..rows).map(|row| f64::from(row) / 128.0), 3);
        assert_eq!(rows_of(&wanted, "a.csv", &text).len(), rows as usize);
    }
}

#[test]
fn time_that_is_none_is_named() {
    let wanted = setup(&["top"], &["a.csv"]);
    expect_error(&wanted, &[("a.csv", &timed([0.0, 0.02, 0.04, 0.02], 2))], &["line 5", "from 0.04 s to 0.02 s"]);
    expect_error(&wanted, &[("a.csv", &timed([0.0, 0.02, 0.02], 2))], &["line 4", "from 0.02 s to 0.02 s", "advance"]);
    for time in ["2024-01-31 10:00:00", "", "nan"] {
        let text = format!("timestamp,top\n{time},1\n");
        expect_error(
            &wanted,
            &[("a.csv", text.as_bytes())],
            &["line 2", "`timestamp`", time, "seconds as plain numbers"],
        );
    }
    let leap = timed([0.0, 0.02, 0.04, 1e6], 2);
    expect_error(&wanted, &[("a.csv", &leap)], &["line 5", "from 0.04 s to 1000000 s", "10000000"]);
    // A sensor may be called t.
    assert_eq!(rows_of(&setup(&["t"], &["a.csv"]), "a.csv", b"t\n5\n5\n4\n"), [[5.0], [5.0], [4.0]]);
}

/// As the manual of Campbell's LoggerNet lays TOA5 out: station, names, units and processing, then rows; NAN in quotes.
#[test]
fn toa5_of_campbell_goes_by_its_times_of_day() {
    let text = "\"TOA5\",\"mast\",\"CR1000X\",\"1234\",\"CR1000X.Std.05.01\",\"CPU:mast.CR1X\",\"4711\",\"fast\"\r\n\
        \"TIMESTAMP\",\"RECORD\",\"acc_x\",\"acc_y\"\r\n\"TS\",\"RN\",\"m/s^2\",\"m/s^2\"\r\n\"\",\"\",\"Smp\",\"Smp\"\r\n\
        \"2026-02-28 23:59:59.96\",0,0.5,-1.25\r\n\"2026-02-28 23:59:59.98\",1,\"NAN\",2.5\r\n\"2026-03-01 00:00:00\",2,3,4\r\n\
        \"2026-03-01 00:00:00.06\",5,5,6\r\n";
    let (rows, report) =
        read(&setup(&["acc_y", "acc_x"], &["a.dat"]), folder(&[("a.dat", text.as_bytes())]).path()).unwrap();
    assert_eq!(rows.len(), 6);
    assert_eq!([&rows[0][..], &rows[2], &rows[5]], [[-1.25, 0.5], [4.0, 3.0], [6.0, 5.0]]);
    assert!(rows[1][1].is_nan() && rows[3][0].is_nan() && rows[4][0].is_nan());
    assert_eq!(report.filled_rows, 2);
    // Python: datetime(2026, 2, 28, 23, 59, 59, 960000, tzinfo=timezone(timedelta(hours=1))).timestamp()
    for (utc_offset_h, start_ns) in [(None, None), (Some(1.0), Some(1_772_319_599_960_000_000))] {
        let there = folder(&[("a.dat", text.as_bytes())]);
        let wanted = Setup { utc_offset_h, ..setup(&["acc_x"], &["a.dat"]) };
        assert_eq!(Recording::open(&wanted, there.path()).unwrap().start_ns().unwrap(), start_ns);
    }
    let slow = Setup { sampling_rate_hz: 10.0, ..setup(&["acc_x"], &["a.dat"]) };
    expect_error(&slow, &[("a.dat", text.as_bytes())], &["a.dat", "`TIMESTAMP`", "50.0000 Hz"]);
    let damaged = text.replace("2026-03-01 00:00:00\"", "2026-03-41 00:00:00\"");
    expect_error(&setup(&["acc_x"], &["a.dat"]), &[("a.dat", damaged.as_bytes())], &["a.dat, line 7", "2026-03-41"]);
    for length in 0..text.len() {
        let _ = read(&setup(&["acc_x"], &["a.dat"]), folder(&[("a.dat", &text.as_bytes()[..length])]).path());
    }
}

/// As DIAdem writes CSV, after its manual: what the measurement was, then names, units in a line of their own, and rows.
#[test]
fn names_stand_behind_what_the_measurement_was_and_before_units() {
    let rows = [vec![0.5, -1.0], vec![0.25, 2.0], vec![-0.125, 3.5]];
    let numbers = "0;0.5;-1\n0.02;0.25;2\n0.04;-0.125;3.5\n";
    let two = setup(&["top x", "top y"], &["a.csv"]);
    for head in [
        "Time;top x;top y\ns;m/s^2;m/s^2\n",
        "Time;top x;top y\n[s];[m/s²];\n",
        "\"Time\";\"top x\";\"top y\"\n\"s\";\"g\";\"g\"\n",
        "Test;Mast\nDate;01.03.2026\nOperator;nobody;\n\nTime;top x;top y\ns;m/s^2;m/s^2\n",
        "a mast in the wind\nTime;top x;top y\n",
        "# a comment\nTime;top x;top y\n",
    ] {
        assert_eq!(rows_of(&two, "a.csv", format!("{head}{numbers}").as_bytes()), rows, "{head}");
    }
    // Of Latin-1, as programs of Windows write it.
    let latin = [b"Zeit;H\xf6he x;top y\ns;m/s\xb2;m/s\xb2\n".as_slice(), numbers.as_bytes()].concat();
    assert_eq!(rows_of(&setup(&["Höhe x", "top y"], &["a.csv"]), "a.csv", &latin), rows);
    // Samples that are none are no units, and words in them no names.
    for (text, line) in
        [("a,b\n-,-\n1,2\n", 2), ("a,b\n1,x\n2,3\n", 2), ("a,b\nbad,bad\n1,2\n", 2), ("a,b\n1,2\n3,s\n", 3)]
    {
        let place = format!("a.csv, line {line}");
        expect_error(&setup(&["a", "b"], &["a.csv"]), &[("a.csv", text.as_bytes())], &[&place, "is not a number"]);
    }
}

/// `#N/A` is what spreadsheets write where there is no value; a line that begins with it is no comment.
#[test]
fn rows_that_begin_with_a_spreadsheets_word_are_kept() {
    let text = b"# logger 7\n#N/A,2 is no row yet\na,b\n1,2\n#N/A,3\n# a note\n#NV,4\n5,#N/A\n";
    let wanted = setup(&["a", "b"], &["a.csv"]);
    let rows = rows_of(&wanted, "a.csv", text);
    assert_eq!(rows.iter().map(|row| row[1]).collect::<Vec<_>>()[..3], [2.0, 3.0, 4.0]);
    assert!(rows.len() == 4 && rows[1][0].is_nan() && rows[2][0].is_nan() && rows[3][1].is_nan(), "{rows:?}");
    // Empty cells around it are cells, between tabulators too.
    let text = b"a\tb\tc\n1\t2\t3\n#N/A\t1\t\n\t#NV\t1\n";
    assert_eq!(rows_of(&setup(&["b", "c"], &["a.csv"]), "a.csv", text).len(), 3);
    assert_eq!(rows_of(&setup(&["1"], &["a.txt"]), "a.txt", b"% x y\n#N/A Y\n1 2\n#N/A 3\n# a note\n").len(), 2);
    for (name, channel, text) in [("a.csv", "a", &b"a,b\n1,2\n#DIV/0!,3\n"[..]), ("a.txt", "1", b"1 2\n#DIV/0! 3\n")] {
        let folder = folder(&[(name, text)]);
        let error = read(&setup(&[channel], &[name]), folder.path()).unwrap_err().to_string();
        assert!(error.contains("`#DIV/0!` is not a number") && error.contains("line"), "{error}");
    }
}

/// As DIAdem writes tables on a computer with German settings: in Latin-1, with commas for points.
#[test]
fn commas_are_decimal_points_where_semicolons_separate() {
    let text = b"Zeit;Turm x;Turm y\ns;m/s\xb2;m/s\xb2\n0,00;1,5;-2,5e-3\n0,02;;3\n0,04;1;#NV\n";
    let wanted = setup(&["Turm y", "Turm x"], &["a.csv"]);
    let rows = rows_of(&wanted, "a.csv", text);
    assert_eq!((rows.len(), rows[0].as_slice(), rows[1][0]), (3, &[-2.5e-3, 1.5][..], 3.0));
    assert!(rows[1][1].is_nan() && rows[2][0].is_nan());
    let late = Setup { sampling_rate_hz: 100.0, ..wanted };
    let folder = folder(&[("a.csv", text)]);
    let error = read(&late, folder.path()).unwrap_err().to_string();
    assert!(error.contains("50.0000 Hz by the time column `Zeit`"), "{error}");
}

#[test]
fn an_hour_is_told_as_what_a_clock_that_is_moved_for_summer_does() {
    let told = |times: [&str; 5]| {
        let mut text = String::from("\"TOA5\",\"m\"\n\"TIMESTAMP\",\"a\"\n\"TS\",\"g\"\n\"\",\"Smp\"\n");
        times.iter().for_each(|time| text += &format!("\"2024-{time}\",1\n"));
        let folder = folder(&[("a.dat", text.as_bytes())]);
        match read(&Setup { sampling_rate_hz: 1.0, ..setup(&["a"], &["a.dat"]) }, folder.path()) {
            Ok((_, report)) => report.warnings[0].to_string(),
            Err(error) => error.to_string(),
        }
    };
    let back = told(["10-27 02:59:56", "10-27 02:59:57", "10-27 02:59:58", "10-27 02:59:59", "10-27 02:00:00"]);
    assert!(back.contains("from 2024-10-27 02:59:59.000000 to 2024-10-27 02:00:00.000000"), "{back}");
    assert!(back.contains("set back from summer time"), "{back}");
    let forward = told(["03-31 01:59:56", "03-31 01:59:57", "03-31 01:59:58", "03-31 01:59:59", "03-31 03:00:00"]);
    assert!(forward.contains("3600") && forward.contains("put forward for summer"), "{forward}");
    let other = told(["03-31 01:59:56", "03-31 01:59:57", "03-31 01:59:58", "03-31 01:59:59", "03-31 02:59:00"]);
    assert!(other.contains("gap in time") && !other.contains("summer"), "{other}");
}

#[test]
fn a_first_line_of_numbers_is_a_row_unless_it_can_only_be_names() {
    for (text, channel, expected) in [
        (&b"0.5,1.5\n2.5,3.5\n"[..], "2", &[1.5, 3.5][..]),
        (b"7,8\n9,10\n", "2", &[8.0, 10.0]),
        (b"0.5;1,5\n2.5;3,5\n", "2", &[1.5, 3.5]),
        (b"0.5\n\n1.5\n", "1", &[0.5, 1.5]),
        (b"0.5\t1.5\n\t2.5\n", "2", &[1.5, 2.5]),
        // Channels that are called by numbers.
        (b"1,2\n5,6\n", "2", &[6.0]),
        (b"07,08\n0.5,1.5\n", "08", &[1.5]),
        // As pandas counts columns without names.
        (b"0,1\n0.5,1.5\n", "1", &[1.5]),
        (b"0\n0.001\n-0.002\n", "1", &[0.0, 0.001, -0.002]),
        (b"0,1024\n0.02,1031\n", "2", &[1024.0, 1031.0]),
        (b"1\n2\n3\n", "1", &[1.0, 2.0, 3.0]),
    ] {
        let rows = rows_of(&setup(&[channel], &["a.csv"]), "a.csv", text);
        let found: Vec<f64> = rows.into_iter().flatten().collect();
        assert_eq!(found, expected, "{}", String::from_utf8_lossy(text));
    }
}
