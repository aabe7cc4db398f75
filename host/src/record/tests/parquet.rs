//! Parquet: types, nulls, row groups, the time column, damage.

use std::sync::Arc;

use ::parquet::basic::{Compression, GzipLevel, ZstdLevel};
use ::parquet::column::writer::ColumnWriter;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::parser::parse_message_type;

use super::*;
use crate::record::RecordWarning;

/// A column's cells; those that are null stand as `None`.
#[derive(Clone)]
enum Cells {
    Single(Vec<Option<f32>>),
    Double(Vec<Option<f64>>),
    Short(Vec<Option<i32>>),
    Long(Vec<Option<i64>>),
}

/// A file of the given schema, with one row group for each of `groups`.
fn parquet(schema: &str, compression: Compression, groups: &[Vec<Cells>]) -> Vec<u8> {
    fn split<T: Copy>(cells: &[Option<T>]) -> (Vec<T>, Vec<i16>) {
        (cells.iter().copied().flatten().collect(), cells.iter().map(|cell| i16::from(cell.is_some())).collect())
    }
    let schema = Arc::new(parse_message_type(&format!("message recording {{ {schema} }}")).unwrap());
    let properties = WriterProperties::builder().set_compression(compression).build();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties)).unwrap();
    for group in groups {
        let mut row_group = writer.next_row_group().unwrap();
        for cells in group {
            let mut column = row_group.next_column().unwrap().unwrap();
            match (column.untyped(), cells) {
                (ColumnWriter::FloatColumnWriter(writer), Cells::Single(cells)) => {
                    let (values, levels) = split(cells);
                    writer.write_batch(&values, Some(&levels), None).unwrap();
                }
                (ColumnWriter::DoubleColumnWriter(writer), Cells::Double(cells)) => {
                    let (values, levels) = split(cells);
                    writer.write_batch(&values, Some(&levels), None).unwrap();
                }
                (ColumnWriter::Int32ColumnWriter(writer), Cells::Short(cells)) => {
                    let (values, levels) = split(cells);
                    writer.write_batch(&values, Some(&levels), None).unwrap();
                }
                (ColumnWriter::Int64ColumnWriter(writer), Cells::Long(cells)) => {
                    let (values, levels) = split(cells);
                    writer.write_batch(&values, Some(&levels), None).unwrap();
                }
                _ => panic!("the cells do not fit the schema"),
            }
            column.close().unwrap();
        }
        row_group.close().unwrap();
    }
    writer.into_inner().unwrap()
}

/// Every type, with nulls, over row groups of differing lengths.
fn all_types(compression: Compression) -> Vec<u8> {
    let schema = "optional float top; required double mid; optional int32 low (INTEGER(16,true)); \
                  required int64 raw; optional int32 unsigned (INTEGER(32,false)); optional double base;";
    let group = |from: usize, rows: usize| {
        let numbers = || (from..from + rows).map(|row| row as f64);
        vec![
            Cells::Single(numbers().map(|row| (row % 10.0 != 3.0).then_some(row as f32 + 0.5)).collect()),
            Cells::Double(numbers().map(|row| Some(-row)).collect()),
            Cells::Short(numbers().map(|row| (row % 2.0 == 0.0).then_some(row as i32 - 7)).collect()),
            Cells::Long(numbers().map(|row| Some(row as i64 * 1_000_000_007)).collect()),
            Cells::Short(numbers().map(|_| Some(-1)).collect()),
            Cells::Double(numbers().map(|_| None).collect()),
        ]
    };
    parquet(schema, compression, &[group(0, 5000), group(5000, 1), group(5001, 8200)])
}

fn assert_all_types(file: &[u8]) {
    let wanted = setup(&["raw", "top", "low", "mid", "unsigned"], &["a.parquet"]);
    let rows = rows_of(&wanted, "a.parquet", file);
    assert_eq!(rows.len(), 13_201);
    for (row, values) in (0_u32..).map(f64::from).zip(&rows) {
        assert_eq!(values[0], row * 1_000_000_007.0);
        assert!(if row % 10.0 == 3.0 { values[1].is_nan() } else { values[1] == row + 0.5 });
        assert!(if row % 2.0 == 0.0 { values[2] == row - 7.0 } else { values[2].is_nan() });
        assert_eq!((values[3], values[4]), (-row, 4_294_967_295.0));
    }
}

#[test]
fn every_type_null_and_compression_is_read_over_row_groups() {
    let zstd = Compression::ZSTD(ZstdLevel::default());
    let gzip = Compression::GZIP(GzipLevel::default());
    for compression in [Compression::UNCOMPRESSED, Compression::SNAPPY, zstd, gzip, Compression::LZ4_RAW] {
        assert_all_types(&all_types(compression));
    }
}

#[test]
fn several_files_follow_each_other() {
    let file = |values: [f64; 2]| {
        parquet("required double a;", Compression::SNAPPY, &[vec![Cells::Double(values.map(Some).to_vec())]])
    };
    let folder = folder(&[("r_1.parquet", &file([1.0, 2.0])), ("r_2.parquet", &file([3.0, 4.0]))]);
    let (rows, _) = read(&setup(&["a"], &["r_*.parquet"]), folder.path()).unwrap();
    assert_eq!(rows, [[1.0], [2.0], [3.0], [4.0]]);
}

fn timed(schema: &str, times: Cells, rows: usize) -> Vec<u8> {
    let values = Cells::Double((0..rows).map(|row| Some(row as f64)).collect());
    parquet(&format!("{schema} required double top;"), Compression::SNAPPY, &[vec![times, values]])
}

#[test]
fn rows_lost_by_the_time_column_are_filled_and_warned_of() {
    // 50 Hz; after the third row five rows are lost, which is a jump of six steps.
    let steps = [0_i64, 1, 2, 8, 9];
    let seconds = Cells::Double(steps.iter().map(|step| Some(*step as f64 * 0.02)).collect());
    let singles = Cells::Single(steps.iter().map(|step| Some(*step as f32 * 0.02)).collect());
    // As a logger stamps them: since 1970.
    let stamps = |a_second: i64| {
        Cells::Long(steps.iter().map(|step| Some((1_700_000_000 * a_second) + step * a_second / 50)).collect())
    };
    let files = [
        timed("required double time_s;", seconds, 5),
        timed("required float Time;", singles, 5),
        timed("required int64 timestamp (TIMESTAMP(MILLIS,true));", stamps(1_000), 5),
        timed("required int64 t (TIMESTAMP(MICROS,false));", stamps(1_000_000), 5),
        timed("optional int64 time (TIMESTAMP(NANOS,true));", stamps(1_000_000_000), 5),
    ];
    for file in files {
        let folder = folder(&[("a.parquet", &file)]);
        let (rows, report) = read(&setup(&["top"], &["a.parquet"]), folder.path()).unwrap();
        assert_eq!(rows.len(), 10);
        assert!(rows[3..8].iter().all(|row| row[0].is_nan()) && rows[8] == [3.0] && rows[9] == [4.0]);
        assert_eq!(report.filled_rows, 5);
        assert!(matches!(&report.warnings[0], RecordWarning::TimeGap { rows: 5, .. }), "{:?}", report.warnings);
    }
}

#[test]
fn a_time_column_that_contradicts_the_setup_is_refused() {
    let one = setup(&["top"], &["a.parquet"]);
    let check = |file: Vec<u8>, parts: &[&str]| expect_error(&one, &[("a.parquet", &file)], parts);
    let doubles = |times: &[f64]| Cells::Double(times.iter().copied().map(Some).collect());
    let schema = "required double time;";
    check(timed(schema, doubles(&[0.0, 0.01, 0.02]), 3), &["a.parquet, row 1", "100.0000 Hz", "`time`", "50"]);
    check(timed(schema, doubles(&[0.0, 0.02, 0.01]), 3), &["a.parquet, row 3", "0.02 s to 0.01 s"]);
    check(timed(schema, doubles(&[0.0, 0.02, 0.04, 1e9]), 4), &["a.parquet, row 4", "filled rows"]);
    let gap = Cells::Double(vec![Some(0.0), None, Some(0.04)]);
    check(timed("optional double time;", gap, 3), &["a.parquet, row 2", "`time`", "`null`"]);
    let date = Cells::Short(vec![Some(1), Some(2), Some(3)]);
    check(timed("required int32 time (DATE);", date, 3), &["a.parquet", "`time`", "INT32", "Date"]);
    // 128 Hz written with three decimals: steps of 7 and 8 ms are rounding, not another rate.
    let rounded: Vec<f64> = (0..5).map(|row| (f64::from(row) / 128.0 * 1e3).round() / 1e3).collect();
    let at_128_hz = Setup { sampling_rate_hz: 128.0, ..one.clone() };
    assert_eq!(rows_of(&at_128_hz, "a.parquet", &timed(schema, doubles(&rounded), 5)).len(), 5);
    // A sensor that is called so makes it a channel.
    let claimed = setup(&["time"], &["a.parquet"]);
    assert_eq!(rows_of(&claimed, "a.parquet", &timed(schema, doubles(&[3.0, 1.0]), 2)), [[3.0], [1.0]]);
}

#[test]
fn what_is_wrong_with_a_file_is_named() {
    let wanted = setup(&["a"], &["a.parquet"]);
    let check = |file: &[u8], parts: &[&str]| expect_error(&wanted, &[("a.parquet", file)], parts);
    let doubles = |values: &[f64]| Cells::Double(values.iter().copied().map(Some).collect());
    let sound = parquet("required double a;", Compression::SNAPPY, &[vec![doubles(&[1.0, 2.0])]]);
    check(b"", &["a.parquet is empty"]);
    check(b"a,b\n1,2\n", &["a.parquet cannot be read as Parquet", "again"]);
    check(&sound[..sound.len() - 1], &["a.parquet cannot be read as Parquet"]);
    check(&sound[40..], &["a.parquet cannot be read as Parquet"]);
    let mut encrypted = sound.clone();
    let end = encrypted.len() - 4;
    encrypted[end..].copy_from_slice(b"PARE");
    check(&encrypted, &["a.parquet", "encrypted"]);
    check(&parquet("required double a;", Compression::SNAPPY, &[]), &["a.parquet is empty"]);
    check(&parquet("required double b;", Compression::SNAPPY, &[vec![doubles(&[1.0])]]), &["`a`", "the columns `b`"]);
    let schema = "required int32 a (DATE); required double b;";
    let dates = parquet(schema, Compression::SNAPPY, &[vec![Cells::Short(vec![Some(1)]), doubles(&[7.0])]]);
    check(&dates, &["a.parquet, channel `a`", "INT32 (Date)", "DOUBLE"]);
    // The column beside it is none the worse for it.
    assert_eq!(rows_of(&setup(&["b"], &["a.parquet"]), "a.parquet", &dates), [[7.0]]);
    let infinite = parquet("required double a;", Compression::SNAPPY, &[vec![doubles(&[1.0, f64::INFINITY])]]);
    expect_impossible(&setup(&["a"], &["a.parquet"]), "a.parquet", &infinite, &["a.parquet, row 2", "\"a\"", "inf"]);
}

/// Damage wherever it may be: every byte of a small file, to several values, and every length.
#[test]
fn a_damaged_file_never_panics() {
    let doubles = |scale: f64| Cells::Double((0..40).map(|row| (row != 7).then_some(scale * f64::from(row))).collect());
    let groups = [vec![doubles(0.02), doubles(1.0)], vec![doubles(0.02), doubles(2.0)]];
    for compression in [Compression::SNAPPY, Compression::UNCOMPRESSED] {
        let sound = parquet("optional double time_x; optional double a;", compression, &groups);
        let folder = folder(&[]);
        let path = folder.path().join("a.parquet");
        let wanted = setup(&["a"], &["a.parquet"]);
        let mut refused = 0;
        let mut survive = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let Ok(mut recording) = Recording::open(&wanted, folder.path()) else {
                refused += 1;
                return;
            };
            let mut block = Block::new();
            while recording.next_block(&mut block).unwrap_or(false) {}
        };
        for place in 0..sound.len() {
            for byte in [0xff, sound[place] ^ 1, sound[place].wrapping_add(16)] {
                let mut damaged = sound.clone();
                damaged[place] = byte;
                survive(&damaged);
            }
            survive(&sound[..place]);
        }
        assert!(refused > sound.len(), "{refused} of {} damaged files were refused", 4 * sound.len());
    }
}

/// The library would count to two thousand million, and take half an hour for it.
#[test]
fn a_page_header_that_announces_a_list_without_end_is_refused_at_once() {
    let mut bytes =
        parquet("required double a;", Compression::UNCOMPRESSED, &[vec![Cells::Double(vec![Some(1.0); 40])]]);
    // The first page's header follows the word that the file begins with.
    // A field that it does not know, and skips.
    bytes[4..11].copy_from_slice(&[0xf9, 0xf7, 0xff, 0xff, 0xff, 0xff, 0x07]);
    let folder = folder(&[("a.parquet", &bytes)]);
    let error = read(&setup(&["a"], &["a.parquet"]), folder.path()).unwrap_err().to_string();
    assert!(error.contains("a.parquet") && error.contains("announces more"), "{error}");
}

/// As pandas writes an index of dates: under a name of its own, and without a zone unless it has one.
#[test]
fn dates_are_the_times_whatever_their_name_and_of_no_zone_until_it_is_said() {
    // 2026-03-01 12:00:00 in ms.
    let times = (0..4).map(|row| Some(1_772_366_400_000 + 20 * row)).collect();
    let cells = [Cells::Double(vec![Some(1.0); 4]), Cells::Long(times)];
    for (utc, ahead_h, expected) in
        [(true, None, Some(0)), (false, None, None), (false, Some(1.0), Some(-3600)), (true, Some(1.0), Some(0))]
    {
        let schema = format!("required double a; required int64 __index_level_0__ (TIMESTAMP(MILLIS,{utc}));");
        let folder = folder(&[("a.parquet", &parquet(&schema, Compression::UNCOMPRESSED, &[cells.to_vec()]))]);
        let wanted = Setup { utc_offset_h: ahead_h, ..setup(&["a"], &["a.parquet"]) };
        let recording = Recording::open(&wanted, folder.path()).unwrap();
        let start_s = expected.map(|shift| (1_772_366_400 + shift) * 1_000_000_000);
        assert_eq!(recording.start_ns().unwrap(), start_s, "{utc} {ahead_h:?}");
        let late = Setup { sampling_rate_hz: 100.0, ..wanted };
        let error = read(&late, folder.path()).unwrap_err().to_string();
        assert!(error.contains("50.0000 Hz by the time column `__index_level_0__`"), "{error}");
    }
    let schema = "required int64 seen (TIMESTAMP(MILLIS,true)); required int64 t (TIMESTAMP(MILLIS,true));";
    let stamps = Cells::Long(vec![Some(1_772_366_400_000)]);
    let folder = folder(&[("a.parquet", &parquet(schema, Compression::UNCOMPRESSED, &[vec![stamps.clone(), stamps]]))]);
    let error = read(&setup(&["seen"], &["a.parquet"]), folder.path()).unwrap_err().to_string();
    assert!(error.contains("channel `seen`") && error.contains("holds dates and times of day"), "{error}");
}

/// What pyarrow writes; `host/tests-data/README.md` says how.
#[test]
fn files_of_another_writer_are_read() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
    let of = |file: &'static str| setup(&["mid", "top", "low"], &[file]);
    for file in ["pyarrow_snappy.parquet", "pyarrow_zstd.parquet", "pyarrow_gzip.parquet", "pyarrow_stamp.parquet"] {
        let (rows, report) = read(&of(file), folder).unwrap();
        assert_eq!((rows.len(), report.filled_rows), (7, 2), "{file}");
        let expected = [
            [1.0, 1.5, 0.1],
            [2.0, f64::NAN, 0.2],
            [f64::NAN, -3.0, 0.3],
            [f64::NAN; 3],
            [f64::NAN; 3],
            [4.0, 4.0, 0.4],
            [5.0, f64::NAN, 0.5],
        ];
        for (row, expected) in rows.iter().zip(&expected) {
            for (value, expected) in row.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-7 || value.is_nan() && expected.is_nan(), "{file}: {row:?}");
            }
        }
    }
    let text = setup(&["note"], &["pyarrow_snappy.parquet"]);
    let error = read(&text, folder).unwrap_err().to_string();
    assert!(error.contains("channel `note`") && error.contains("BYTE_ARRAY (String)"), "{error}");
    let error = read(&of("pyarrow_brotli.parquet"), folder).unwrap_err().to_string();
    assert!(error.to_lowercase().contains("brotli"), "{error}");
}
