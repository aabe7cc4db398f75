//! No single effect explains a measurement: the set that explains most is shown as a lead, and frequencies count where the file of modes
//! says which mode is which.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::{belfry_command, published};
use serde_json::Value;

fn json(arguments: &[&str]) -> Value {
    let output = belfry_command().args(arguments).arg("--json").assert().success().get_output().stdout.clone();
    serde_json::from_slice(&output).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn warnings(report: &Value) -> String {
    report["warnings"].to_string()
}

/// A study of modes from elsewhere.
fn study(folder: &Path, beam: &str, modes: &str, sensors: &str) -> String {
    fs::write(folder.join("beam.csv"), beam).unwrap();
    fs::write(folder.join("modes.csv"), modes).unwrap();
    let model = "[model]\nbeam = \"beam.csv\"\nbackground_stiffness = 0.03\nbackground_mass = 0.01\n";
    let text = format!("[structure]\nname = \"tower\"\n\n[measured]\nmodes = \"modes.csv\"\n\n{sensors}{model}");
    fs::write(folder.join("study.toml"), text).unwrap();
    folder.to_str().unwrap().to_owned()
}

/// The paper's measured frequencies, each paired with the model's frequency beside it in the table; `model_mode` makes the cell.
fn table_1(folder: &Path, model_mode: impl Fn(usize) -> String) -> String {
    let templates = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../host/templates/canton"));
    let table = fs::read_to_string(templates.join("paper_table1.csv")).unwrap();
    let mut modes = "mode,frequency_hz,model_mode\n".to_owned();
    for (row, index) in table.lines().skip(1).zip(1..) {
        let cells: Vec<&str> = row.split(',').collect();
        writeln!(modes, "{},{},{}", cells[0], cells[2], model_mode(index)).unwrap();
    }
    study(folder, &fs::read_to_string(templates.join("beam.csv")).unwrap(), &modes, "")
}

#[test]
fn published_frequencies_are_diagnosed_where_the_pairing_is_stated() {
    let folder = tempfile::tempdir().unwrap();
    // The table has the model's first twelve modes in their order.
    let place = table_1(folder.path(), |index| index.to_string());
    let comparison = json(&["compare", &place]);
    let pairs = comparison["pairs"].as_array().unwrap();
    assert_eq!(pairs.len(), 12);
    for pair in pairs {
        assert_eq!((&pair["measured"], &pair["stated"]), (&pair["model"], &Value::Bool(true)), "{pair}");
    }
    // The published errors: 0.110 Hz for 0.094 Hz, 0.397 Hz for 0.475 Hz.
    let error = |index: usize| number(&pairs[index]["frequency_error_percent"]);
    assert!((error(0) - 17.0).abs() < 1.0 && (error(4) + 16.4).abs() < 1.0, "{} {}", error(0), error(4));
    assert!(!warnings(&comparison).contains("guess"), "{}", warnings(&comparison));

    let diagnosis = json(&["diagnose", &place]);
    assert!(warnings(&diagnosis).contains("no shapes were measured: effects"), "{}", warnings(&diagnosis));
    assert!(warnings(&diagnosis).contains("0.5 % of frequencies"), "{}", warnings(&diagnosis));
    assert_eq!(diagnosis["verdict"], "unknown");
}

#[test]
fn a_pairing_that_cannot_be_is_refused_by_line() {
    let folder = tempfile::tempdir().unwrap();
    for (model_mode, expected) in [
        (
            &(|index: usize| if index == 3 { "999".to_owned() } else { String::new() }) as &dyn Fn(usize) -> String,
            "line 4: model_mode 999",
        ),
        (
            &|index: usize| if index > 3 { "7".to_owned() } else { String::new() },
            "line 6: model_mode 7 is that of measured mode 4",
        ),
        (&|_| "BX".to_owned(), "line 2, column `model_mode`: `BX`"),
    ] {
        let place = table_1(folder.path(), model_mode);
        for command in ["compare", "diagnose"] {
            let output = belfry_command().args([command, &place]).assert().code(1).get_output().stderr.clone();
            let error = String::from_utf8(output).unwrap();
            assert!(error.contains("modes.csv") && error.contains(expected), "{error}");
        }
    }
}

/// A frame as its designers have it: storeys that only shear, `height_m` high, across the direction of measurement far stiffer.
fn frame(name: &str, height_m: f64, folder: &Path) -> String {
    let data = published("real").join(name);
    let read = |file: &str| fs::read_to_string(data.join(file)).unwrap();
    let mut beam = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_1_n,shear_2_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n".to_owned();
    let model = read("model.csv");
    let storeys: Vec<[f64; 2]> = model
        .lines()
        .skip(1)
        .map(|row| {
            let cells: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            [cells[1], cells[2]]
        })
        .collect();
    for (index, [stiffness, mass]) in storeys.iter().enumerate() {
        let (bottom_m, top_m) = (index as f64 * height_m, (index + 1) as f64 * height_m);
        // Bending that adds less than a thousandth to what the shear of all storeys gives.
        let rigid = 100.0 * stiffness * height_m * (height_m * storeys.len() as f64).powi(2);
        let turning = 0.1 * mass * height_m * height_m;
        writeln!(
            beam,
            "{bottom_m},{top_m},{rigid:e},{rigid:e},0,{:e},,{rigid:e},{mass},0,0,{turning}",
            stiffness * height_m
        )
        .unwrap();
    }
    let modes = read("modes.csv");
    let channels = modes.lines().next().unwrap().split(',').filter(|name| name.starts_with("storey"));
    let mut sensors = String::new();
    for channel in channels {
        let storey: f64 = channel.trim_start_matches("storey ").parse().unwrap();
        write!(
            sensors,
            "[[sensor]]\nchannel = {channel:?}\nelevation_m = {:?}\nazimuth_deg = 0.0\n\n",
            storey * height_m
        )
        .unwrap();
    }
    study(folder, &beam, &modes, &sensors)
}
