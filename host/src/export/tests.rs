//! What is exported is read back: modes to the precision their files have, tables row by row.

use std::fs;
use std::fs::File;
use std::path::Path;

use ::parquet::file::reader::{FileReader, SerializedFileReader};
use ::parquet::record::{Field, Row};

use super::modes::Modes;
use super::rows::TableFormat::{Csv, Parquet};
use super::spectra::{LinesTable, write_psd};
use super::*;
use crate::measure::{Route, measure_observed};
use crate::modes::{MeasuredModes, read};
use crate::study::Study;

/// A study of four channels at 20 Hz whose sensors have the given keys.
fn study(folder: &Path, sensors: [&str; 4], unit: &str) -> Study {
    let mut text = format!(
        "[structure]\nname = \"Mast\"\n[analysis]\nband_hz = [0.5, 4.0]\n[[setup]]\nname = \"first\"\n\
         files = [\"a.csv\"]\nsampling_rate_hz = 20.0\nunit = \"{unit}\"\n"
    );
    for keys in sensors {
        text += &format!("[[setup.sensor]]\nnode = 1\n{keys}\n");
    }
    Study::from_text(&text, folder).unwrap()
}

/// Two modes as `identify` writes them: complex shapes, unknown deviations, a component that was not measured.
fn write_modes(folder: &Path, channels: [&str; 4]) {
    let component = |channel: usize, re: f64, im: f64, std: &str| {
        let name = channels[channel];
        format!("{{\"channel\":\"{name}\",\"point\":\"{name}\",\"re\":{re},\"im\":{im},\"std\":{std}}}")
    };
    let shapes = [
        [
            component(0, 0.25, 0.0, "0.01"),
            component(1, -0.5, 0.03, "null"),
            component(2, 1.0, 0.0, "0.02"),
            component(3, 1e-3, -1e-4, "0.5"),
        ],
        [
            component(0, 1.0, 0.0, "0.01"),
            component(1, 0.75, 0.01, "0.03"),
            component(2, -0.123456789, 0.0, "0.0"),
            component(3, 0.5, 0.0, "0.5"),
        ],
    ];
    let mode = |number: usize, frequency: f64, std: &str| {
        format!(
            "{{\"number\":{number},\"frequency_hz\":{frequency},\"frequency_std_hz\":{std},\"damping_ratio\":0.0123,\
             \"damping_ratio_std\":0.001,\"frequency_std_bound_hz\":null,\"phase_collinearity\":0.99,\"shape\":[{}]}}",
            shapes[number - 1].join(",")
        )
    };
    let text = format!("{{\"modes\":[{},{}],\"averages\":40}}", mode(1, 1.234567891, "0.002"), mode(2, 2.5, "null"));
    fs::create_dir_all(folder.join("results")).unwrap();
    fs::write(folder.join("results/modes.json"), text).unwrap();
}

fn assert_equal_modes(one: &MeasuredModes, other: &MeasuredModes, relative: f64, stds: bool) {
    assert_eq!(one.modes.len(), other.modes.len());
    for (one, other) in one.modes.iter().zip(&other.modes) {
        let close = |a: f64, b: f64| assert!((a - b).abs() <= relative * a.abs().max(1e-2), "{a} and {b}");
        assert_eq!(one.number, other.number);
        close(one.frequency_hz, other.frequency_hz);
        close(one.damping_ratio.unwrap(), other.damping_ratio.unwrap());
        let (one_shape, other_shape) = (one.shape.as_ref().unwrap(), other.shape.as_ref().unwrap());
        assert_eq!(one_shape.sensors, other_shape.sensors);
        one_shape.values.iter().zip(other_shape.values.iter()).for_each(|(a, b)| close(*a, *b));
        if stds {
            assert_eq!(one.frequency_std_hz, other.frequency_std_hz);
            assert_eq!(format!("{:?}", one_shape.stds), format!("{:?}", other_shape.stds));
        }
    }
}

const AROUND: [&str; 4] = [
    "channel = \"north\"\nelevation_m = 10.0\nazimuth_deg = 90.0",
    "channel = \"west, upper\"\nelevation_m = 20.5\nazimuth_deg = 180.0\noffset_m = [-1.5, 2.0]",
    "channel = \"oblique\"\nelevation_m = 30.0\nazimuth_deg = 18.0",
    "channel = \"vertical\"\nelevation_m = 30.0\nazimuth_deg = \"up\"",
];
const NAMES: [&str; 4] = ["north", "west, upper", "oblique", "vertical"];

#[test]
fn the_table_of_modes_is_read_back_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), AROUND, "m/s2");
    write_modes(folder.path(), NAMES);
    let modes = Modes::load(&study).unwrap();
    let path = folder.path().join("new/modes.csv");
    table::write_csv(&path, &modes).unwrap();
    let (original, back) = (read(&modes.file, &modes.sensors).unwrap(), read(&path, &modes.sensors).unwrap());
    assert!(back.warnings.is_empty(), "{:?}", back.warnings);
    assert_equal_modes(&original, &back, 0.0, true);
    assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "nothing partial is left");
}

#[test]
fn the_table_of_modes_as_parquet_has_a_row_a_mode_and_channel() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), AROUND, "m/s2");
    write_modes(folder.path(), NAMES);
    let modes = Modes::load(&study).unwrap();
    let path = folder.path().join("modes.parquet");
    assert_eq!(table::write_parquet(&path, &modes).unwrap(), 8);
    let (names, rows) = parquet_rows(&path);
    assert_eq!(names[..2], ["mode", "frequency_hz"]);
    assert_eq!(names[6..], ["channel", "re", "im", "std"]);
    let second = &rows[1];
    assert_eq!((number(second, 0), number(second, 1), text(second, 6)), (1.0, 1.234567891, NAMES[1].to_owned()));
    assert_eq!((number(second, 7), number(second, 8)), (-0.5, 0.03));
    assert!(number(second, 9).is_nan(), "a deviation that is not known is missing");
    assert_eq!((number(&rows[6], 7), number(&rows[6], 9)), (-0.123456789, 0.0));
}

#[test]
fn the_universal_file_is_read_back_to_its_six_digits() {
    let named = [
        "channel = \"12x\"\nelevation_m = 10.0\nazimuth_deg = 0.0",
        "channel = \"12y\"\nelevation_m = 10.0\nazimuth_deg = 90.0",
        "channel = \"7:+z\"",
        "channel = \"3x\"",
    ];
    for (sensors, names) in [(AROUND, NAMES), (named, ["12x", "12y", "7:+z", "3x"])] {
        let folder = tempfile::tempdir().unwrap();
        let study = study(folder.path(), sensors, "m/s2");
        write_modes(folder.path(), names);
        let modes = Modes::load(&study).unwrap();
        let (text, warnings) = universal::text(&modes, "Mast");
        assert!(warnings.is_empty(), "{warnings:?}");
        let path = folder.path().join("modes.uff");
        write_file(&path, &text).unwrap();
        let back = read(&path, &modes.sensors).unwrap();
        assert_equal_modes(&read(&modes.file, &modes.sensors).unwrap(), &back, 1e-5, false);
        // Named, both directions of a node stand in one line.
        let first = text.split("    55\n").nth(1).unwrap();
        assert_eq!(
            first.contains("        12\n  2.50000E-01  0.00000E+00 -5.00000E-01  3.00000E-02  0.00000E+00"),
            names[0] == "12x"
        );
    }
}

#[test]
fn the_universal_file_says_where_nodes_stand_and_how_they_are_turned() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), AROUND, "m/s2");
    write_modes(folder.path(), NAMES);
    let (text, _) = universal::text(&Modes::load(&study).unwrap(), "Mast");
    assert!(text.starts_with("    -1\n   164\n         1"));
    // The second sensor's axis x points west: system 11, turned by 180 degrees. The third and the fourth stand at one place.
    assert!(
        text.contains("         2         0        11        11 -1.50000E+00  2.00000E+00  2.05000E+01\n"),
        "{text}"
    );
    assert!(text.contains("        11         0         0         8         1\nazimuth 180 deg\n"));
    assert!(text.contains("  0.00000E+00  0.00000E+00  0.00000E+00 -1.00000E+00"));
    assert!(
        text.contains("         3         0        12        11  0.00000E+00  0.00000E+00  3.00000E+01\n    -1\n"),
        "{text}"
    );
    // Lines reach all nodes: the two on the axis are joined, and the one beside it to the nearer. 0 lifts the pen.
    let lines: Vec<&str> = text.split("    82\n").nth(1).unwrap().lines().take(3).collect();
    assert_eq!(lines[2].split_whitespace().collect::<Vec<_>>(), ["1", "3", "0", "2", "3", "0"]);
    assert!(text.lines().filter(|line| line.trim() == "-1").count() == 2 * (4 + 2));
}

/// A mast with one sensor along y at the top, beside the one along x: four nodes, and one line through all of them.
#[test]
fn sensors_at_one_place_are_one_node_of_the_universal_file() {
    let mast = [
        "channel = \"low\"\nelevation_m = 20.0\nazimuth_deg = 0.0",
        "channel = \"middle\"\nelevation_m = 40.0\nazimuth_deg = 0.0",
        "channel = \"top x\"\nelevation_m = 60.0\nazimuth_deg = 0.0",
        "channel = \"top y\"\nelevation_m = 60.0\nazimuth_deg = 90.0",
    ];
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), mast, "m/s2");
    write_modes(folder.path(), ["low", "middle", "top x", "top y"]);
    let modes = Modes::load(&study).unwrap();
    let (text, warnings) = universal::text(&modes, "Mast");
    assert!(warnings.is_empty(), "{warnings:?}");
    let nodes = text.split("    15\n").nth(1).unwrap().split("    -1\n").next().unwrap();
    assert_eq!(nodes.lines().count(), 3);
    // Both of the top's components stand in one line, x before y.
    assert!(text.contains("         3\n  1.00000E+00  0.00000E+00  1.00000E-03 -1.00000E-04  0.00000E+00"), "{text}");
    let lines: Vec<&str> = text.split("    82\n").nth(1).unwrap().lines().take(3).collect();
    assert_eq!(lines[2].split_whitespace().collect::<Vec<_>>(), ["1", "2", "0", "2", "3", "0"]);
    // Belfry, which numbers places alike, reads it back.
    let path = folder.path().join("modes.uff");
    write_file(&path, &text).unwrap();
    let back = read(&path, &modes.sensors).unwrap();
    assert_equal_modes(&read(&modes.file, &modes.sensors).unwrap(), &back, 1e-5, false);
    assert!(back.warnings.iter().any(|warning| warning.contains("nodes 1 to 3 are taken for the study's places")));
}

#[test]
fn what_cannot_be_exported_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let study_of = |sensors| study(folder.path(), sensors, "m/s2");
    let none = Modes::load(&study_of(AROUND)).unwrap_err().to_string();
    assert!(none.contains("modes.json") && none.contains("belfry identify"), "{none}");
    write_modes(folder.path(), ["north", "west, upper", "oblique", "roof"]);
    let unknown = Modes::load(&study_of(AROUND)).unwrap_err().to_string();
    assert!(unknown.contains("mode 1: `roof`"), "{unknown}");
    fs::write(folder.path().join("results/modes.json"), "{\"modes\":\n[{}]}").unwrap();
    let syntax = Modes::load(&study_of(AROUND)).unwrap_err().to_string();
    assert!(syntax.contains("modes.json, line 2"), "{syntax}");
    fs::write(folder.path().join("results/modes.json"), "{\"modes\":[]}").unwrap();
    let empty = Modes::load(&study_of(AROUND)).unwrap_err().to_string();
    assert!(empty.contains("no modes were found"), "{empty}");
    let names = ["top", "top_std", "a", "b"];
    write_modes(folder.path(), names);
    let sensors = ["channel = \"top\"", "channel = \"top_std\"", "channel = \"a\"", "channel = \"b\""];
    let table = folder.path().join("modes.csv");
    let twice = table::write_csv(&table, &Modes::load(&study_of(sensors)).unwrap()).unwrap_err().to_string();
    assert!(twice.contains("`top_std`"), "{twice}");
    // A file where a folder should be.
    let blocked = folder.path().join("results/modes.json/x.csv");
    let error = write_file(&blocked, "").unwrap_err().to_string();
    assert!(error.contains("x.csv: cannot be written"), "{error}");
}

/// Ten minutes of noise with a tone at 2 Hz on the first channel; the last is dead.
fn write_recording(folder: &Path) {
    let mut state = 1_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    let mut text = String::from("north,\"west, upper\",oblique,vertical\n");
    for row in 0..12_000 {
        let tone = (std::f64::consts::TAU * 2.0 * f64::from(row) / 20.0).sin();
        text += &format!("{},{},{},0\n", tone + 0.1 * noise(), noise(), noise());
    }
    fs::write(folder.join("a.csv"), text).unwrap();
}

pub(super) fn parquet_rows(path: &Path) -> (Vec<String>, Vec<Row>) {
    let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
    let names = reader.metadata().file_metadata().schema_descr().columns().iter().map(|c| c.path().string()).collect();
    (names, reader.into_iter().map(Result::unwrap).collect())
}

fn number(row: &Row, column: usize) -> f64 {
    match row.get_column_iter().nth(column).unwrap().1 {
        Field::Double(value) => *value,
        Field::Long(value) => *value as f64,
        _ => f64::NAN,
    }
}

fn text(row: &Row, column: usize) -> String {
    match row.get_column_iter().nth(column).unwrap().1 {
        Field::Str(text) => text.clone(),
        other => panic!("{other} is no text"),
    }
}

#[test]
fn averaged_lines_are_the_exported_densities() {
    let folder = tempfile::tempdir().unwrap();
    for (unit, psd_column, line_column) in
        [("m/s2", "psd_m2_per_s4_hz", "re_m_per_s2_sqrt_hz"), ("m/s", "psd_m2_per_s2_hz", "re_m_per_s_sqrt_hz")]
    {
        let study = study(folder.path(), AROUND, unit);
        write_recording(folder.path());
        let lines_file = folder.path().join("lines.parquet");
        let mut lines = LinesTable::create(&lines_file, &study.setups, Parquet).unwrap();
        let lines_csv = folder.path().join("lines.csv");
        let mut as_text = LinesTable::create(&lines_csv, &study.setups, Csv).unwrap();
        let measurement = measure_observed(&study, Route::Direct, &mut |_, _| {}, &mut |setup, grid, window| {
            lines.observe(setup, grid, window);
            as_text.observe(setup, grid, window);
        })
        .unwrap();
        let line_rows = lines.finish().unwrap();
        assert_eq!(as_text.finish().unwrap(), line_rows);
        let psd_file = folder.path().join("psd.parquet");
        let psd_rows = write_psd(&psd_file, &measurement, Parquet).unwrap();
        assert_eq!(write_psd(&folder.path().join("psd.csv"), &measurement, Csv).unwrap(), psd_rows);
        let (psd_names, psd) = parquet_rows(&psd_file);
        let (line_names, lines) = parquet_rows(&lines_file);
        assert_eq!(psd_names, ["setup", "channel", "averages", "frequency_hz", psd_column]);
        assert_eq!(line_names[..6], ["setup", "window", "start_s", "channel", "frequency_hz", line_column]);
        assert_eq!((psd.len() as u64, lines.len() as u64), (psd_rows, line_rows));
        // Both have the same cells.
        let mut text_rows = csv::Reader::from_path(&lines_csv).unwrap();
        assert_eq!(text_rows.headers().unwrap().iter().collect::<Vec<_>>(), line_names);
        for (row, record) in lines.iter().zip(text_rows.records()) {
            let record = record.unwrap();
            assert_eq!((&record[3], record[5].parse::<f64>().unwrap()), (text(row, 3).as_str(), number(row, 5)));
        }
        let (windows, grid) = (measurement.setups[0].spectrum.averages(), measurement.plan.grid);
        // Three channels; the dead one has neither lines nor a density.
        assert_eq!(psd.len(), 3 * grid.lines);
        assert_eq!(lines.len(), 3 * grid.lines * windows);
        let mut csv = csv::Reader::from_path(folder.path().join("psd.csv")).unwrap();
        let mut largest = (0.0, String::new(), 0.0);
        for (row, record) in psd.iter().zip(csv.records()) {
            let (channel, frequency_hz, density) = (text(row, 1), number(row, 3), number(row, 4));
            let record = record.unwrap();
            assert_eq!((&record[1], record[4].parse::<f64>().unwrap()), (channel.as_str(), density));
            if density > largest.0 {
                largest = (density, channel, frequency_hz);
            }
        }
        assert!(largest.1 == "north" && (largest.2 - 2.0).abs() < 2.0 * grid.spacing_hz(), "{largest:?}");
        let squares = lines.iter().filter(|row| text(row, 3) == "north" && number(row, 4) == largest.2);
        let mean = squares.map(|row| number(row, 5).powi(2) + number(row, 6).powi(2)).sum::<f64>() / windows as f64;
        assert!((mean / largest.0 - 1.0).abs() < 1e-6, "{mean} and {largest:?}");
        // Half a segment apart.
        let starts: Vec<f64> = lines.iter().map(|row| number(row, 2)).collect();
        let step_s = starts.iter().find(|start_s| **start_s > starts[0]).unwrap() - starts[0];
        assert!((step_s - 0.5 / grid.spacing_hz()).abs() < 1e-9);
    }
}

#[test]
fn a_file_that_is_not_finished_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines.parquet");
    drop(LinesTable::create(&path, &study(folder.path(), AROUND, "m/s2").setups, Parquet).unwrap());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
