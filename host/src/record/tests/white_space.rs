//! White-space text, and what all formats share: patterns, channels, units.

use super::*;

#[test]
fn rows_come_in_the_order_of_the_sensors() {
    let text = b"\xef\xbb\xbf# made by hand\r\n 1.5 -2e1\t3\r\n\r\n% half way\r\n4 NaN 6";
    let rows = rows_of(&setup(&["3", "01"], &["a.txt"]), "a.txt", text);
    assert_eq!(rows, [[3.0, 1.5], [6.0, 4.0]]);
    let rows = rows_of(&setup(&["2"], &["a.asc"]), "a.asc", text);
    assert_eq!(rows[0], [-20.0]);
    assert!(rows[1][0].is_nan());
}

#[test]
fn files_follow_each_other_by_number() {
    let folder = folder(&[("a_10.dat", b"3\n"), ("a_9.dat", b"2\n"), ("first.DAT", b"1\n"), ("a_8.log", b"9\n")]);
    let (rows, _) = read(&setup(&["1"], &["first.DAT", "a_*.dat"]), folder.path()).unwrap();
    assert_eq!(rows, [[1.0], [2.0], [3.0]]);
}

#[test]
fn a_long_file_is_read_in_blocks_without_loss() {
    let text: String = (0..10_000).map(|row| format!("{row} {}\n", -row)).collect();
    let rows = rows_of(&setup(&["1", "2"], &["a.txt"]), "a.txt", text.as_bytes());
    assert_eq!(rows.len(), 10_000);
    assert!((0..).zip(&rows).all(|(row, values)| *values == [f64::from(row), -f64::from(row)]));
}

#[test]
fn units_become_si() {
    let mut recorded = setup(&["1"], &["a.txt"]);
    recorded.unit = Unit::StandardGravity;
    assert_eq!(rows_of(&recorded, "a.txt", b"2"), [[19.6133]]);
    recorded.unit = Unit::MetrePerSecond;
    assert_eq!(rows_of(&recorded, "a.txt", b"2"), [[2.0]]);
    recorded.unit = Unit::Volt;
    for useless in [None, Some(0.0), Some(f64::NAN)] {
        recorded.sensors[0].sensitivity_v_per_m_s2 = useless;
        expect_error(&recorded, &[("a.txt", b"2")], &["channel `1`", "volts", "sensitivity"]);
    }
    recorded.sensors[0].sensitivity_v_per_m_s2 = Some(0.25);
    assert_eq!(rows_of(&recorded, "a.txt", b"2"), [[8.0]]);
    recorded.sensors[0].gain = Some(1.25);
    assert_eq!(rows_of(&recorded, "a.txt", b"2"), [[10.0]]);
}

#[test]
fn an_infinite_sample_is_told_and_left_out() {
    let two = setup(&["1", "2"], &["a.txt"]);
    for infinite in ["-inf", "1e999", "Infinity"] {
        let text = format!("1 2\n3 {infinite}\n5 6\n");
        expect_impossible(&two, "a.txt", text.as_bytes(), &["a.txt, line 2", "\"2\"", "inf"]);
    }
}

#[test]
fn a_damaged_line_is_named() {
    let two = setup(&["1", "2"], &["a.txt"]);
    expect_error(&two, &[("a.txt", b"# x\n1 2\n3\n")], &["a.txt, line 3", "1 values", "have 2"]);
    expect_error(&two, &[("a.txt", b"1 2\n3 4 5\n")], &["a.txt, line 2", "3 values", "have 2"]);
    expect_error(&two, &[("a.txt", b"1 2\n\n3 off\n")], &["a.txt, line 3", "channel `2`", "`off`", "NaN"]);
    expect_error(&two, &[("a.txt", b"left right\n1 2\n")], &["line 1", "channel `1`", "`left`", "start with #"]);
    expect_error(&two, &[("a.txt", b"1,5 2,5\n")], &["`1,5`", "decimal point"]);
    let endless = vec![b'1'; (1 << 20) + 5];
    expect_error(&two, &[("a.txt", &endless)], &["a.txt, line 1", "longer than 1048576 bytes", "text file?"]);
    // A cell is quoted in a length that can be read, whatever bytes it is made of.
    expect_error(&two, &[("a.txt", b"\0\xff\x1b[2J 2\n")], &["`\\0\u{fffd}\\u{1b}[2J`"]);
}

#[test]
fn what_is_wrong_with_the_setup_is_named() {
    let file: (&str, &[u8]) = ("a.txt", b"1 2\n");
    expect_error(&setup(&["3"], &["a.txt"]), &[file], &["a.txt", "`3`", "2 columns", "1 to 2"]);
    expect_error(&setup(&["0"], &["a.txt"]), &[file], &["`0`", "1 to 2"]);
    expect_error(&setup(&["top"], &["a.txt"]), &[file], &["`top`", "1 to 2"]);
    expect_error(&setup(&["1"], &["b_*.txt"]), &[file], &["no file matches `b_*.txt`"]);
    expect_error(&setup(&["1"], &["b.txt"]), &[file], &["no file matches `b.txt`"]);
    expect_error(&setup(&["1"], &["a***"]), &[file], &["pattern `a***`"]);
    expect_error(&setup(&["1"], &["a.txt", "*.txt"]), &[file], &["a.txt", "twice"]);
    expect_error(&setup(&["1"], &[]), &[file], &["`january`", "no files"]);
    expect_error(&setup(&[], &["a.txt"]), &[file], &["`january`", "no sensors"]);
    let other: (&str, &[u8]) = ("b.txt", b"1 2 3\n");
    expect_error(&setup(&["1"], &["*.txt"]), &[file, other], &["b.txt has 3 columns", "a.txt has 2 columns"]);
    for empty in ["", "\n \n", "# nothing\n"] {
        expect_error(
            &setup(&["1"], &["c.txt"]),
            &[("c.txt", empty.as_bytes())],
            &["c.txt is empty", "at least one row"],
        );
    }
    for (name, part) in [
        ("a.parquet", "Parquet"),
        ("a.uff", "dataset 58"),
        ("a.doc", ".npy, .mat, .parquet"),
        ("a", ".npy, .mat, .parquet"),
    ] {
        expect_error(&setup(&["1"], &[name]), &[(name, b"1")], &[name, part]);
    }
    let mut slow = setup(&["1"], &["a.txt"]);
    for rate in [0.0, -50.0, f64::NAN, f64::INFINITY] {
        slow.sampling_rate_hz = rate;
        expect_error(&slow, &[file], &["sampling rate", "positive"]);
    }
}

#[test]
fn a_folder_with_the_signs_of_patterns_in_its_name_is_no_pattern() {
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("tower [north] *");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("a.txt"), "7\n").unwrap();
    let (rows, _) = read(&setup(&["1"], &["*.txt"]), &folder).unwrap();
    assert_eq!(rows, [[7.0]]);
}
