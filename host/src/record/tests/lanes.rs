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

#[test]
fn what_is_missing_between_files_that_say_when_they_begin_is_a_gap() {
    let tdms = std::fs::read(foreign().join("nptdms.tdms")).unwrap();
    // Seconds since 1904, as TDMS counts them.
    let start_s = START_S as i64 + 2_082_844_800;
    let after = |seconds: i64| with(&tdms, &start_s.to_le_bytes(), &(start_s + seconds).to_le_bytes());
    let (follows, late, early) = (after(6), after(16), after(5));
    let h5 = std::fs::read(foreign().join("h5py_scaled.h5")).unwrap();
    let next = with(&h5, b"12:00:00.25Z", b"12:00:10.25Z");
    // A recorder that is half a second behind by its clock has lost nothing.
    let behind = with(&h5, b"12:00:00.25Z", b"12:00:06.75Z");
    let folder = folder(&[
        ("a.tdms", &tdms),
        ("b.tdms", &follows),
        ("c.tdms", &late),
        ("d.tdms", &early),
        ("a.h5", &h5),
        ("b.h5", &next),
        ("c.h5", &behind),
    ]);
    let of = |channels: &[&str], files: &[&str]| {
        let setup = setup(channels, files);
        let (rows, report) = read(&setup, folder.path()).unwrap();
        let counted = Recording::open(&setup, folder.path()).unwrap().total_rows().unwrap();
        assert_eq!((counted, report.rows), (rows.len() as u64, rows.len() as u64));
        let told: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
        (rows, report.filled_rows, told)
    };
    let same = same();
    let in_turn = |rows: &[Vec<f64>], missing: usize| {
        let (before, rest) = rows.split_at(rows.len() - 300 - missing);
        let (gap, after) = rest.split_at(missing);
        assert!(before.chunks(300).all(|file| file == same) && after == same);
        assert!(gap.iter().flatten().all(|value| value.is_nan()));
    };
    let (rows, filled, told) = of(&["top-x", "top-y"], &["a.tdms", "b.tdms", "c.tdms"]);
    assert_eq!((rows.len(), filled), (1100, 200));
    in_turn(&rows, 200);
    assert!(told.iter().any(|told| told.contains("c.tdms, row 1: gap in time: 200 rows (4.000 s)")), "{told:?}");
    let (rows, filled, told) = of(&["top-x", "top-y"], &["c.tdms", "d.tdms", "a.tdms"]);
    assert_eq!((rows.len(), filled), (900, 0));
    in_turn(&rows, 0);
    let is_told = |told: &String| told.contains("d.tdms: begins 17.000 s before") && told.contains("1 more such file;");
    assert!(told.iter().any(is_told), "{told:?}");
    let (rows, filled, _) = of(&["1", "2"], &["a.h5", "b.h5"]);
    assert_eq!((rows.len(), filled), (800, 200));
    in_turn(&rows, 200);
    for names in [["a.h5", "a.h5"], ["a.h5", "c.h5"]] {
        std::fs::copy(folder.path().join(names[1]), folder.path().join("z.h5")).unwrap();
        let (rows, filled, told) = of(&["1", "2"], &[names[0], "z.h5"]);
        assert_eq!((rows.len(), filled, told.len()), (600, 0, 0), "{told:?}");
    }
    // Blocks of a schedule follow each other.
    let mut blocks = setup(&["top-x", "top-y"], &["a.tdms", "c.tdms"]);
    blocks.block_s = Some(6.0);
    assert_eq!(Recording::open(&blocks, folder.path()).unwrap().total_rows().unwrap(), 604);
    // Years are a wrong clock.
    std::fs::write(folder.path().join("y.tdms"), after(500_000_000)).unwrap();
    let years = setup(&["top-x"], &["a.tdms", "y.tdms"]);
    let error = Recording::open(&years, folder.path()).unwrap_err().to_string();
    assert!(error.contains("y.tdms, row 1: time jumps from") && error.contains("correct the times"), "{error}");
}
