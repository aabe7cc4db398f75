//! An engineer takes the fitted model along: its profile of stiffness and mass, and the model with its effects as files.

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use serde_json::Value;

use crate::said::json;

/// What a command says that must fail so.
fn refused(arguments: &[&str], code: i32) -> String {
    let output = belfry_command().args(arguments).assert().failure().code(code).get_output().stderr.clone();
    String::from_utf8(output).unwrap()
}

/// A study of the same sensors whose modes are those of an exported model.
fn measured_study(folder: &Path, canton: &Path, model: &str) -> String {
    let text = fs::read_to_string(canton.join("study.toml")).unwrap();
    let first = text.find("\n[[setup.sensor]]").unwrap();
    let last = text.find("[analysis]").unwrap();
    let sensors = text[first..last].replace("[[setup.sensor]]", "[[sensor]]");
    fs::create_dir_all(folder).unwrap();
    let modes = "../canton/results/export/model_modes.csv";
    let study = format!("[structure]\nname = \"Again\"\n\n[measured]\nmodes = \"{modes}\"\n\n{sensors}\n{model}\n");
    fs::write(folder.join("study.toml"), study).unwrap();
    folder.to_str().unwrap().to_owned()
}

#[test]
fn a_model_with_its_effects_is_exported_and_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let canton = folder.path().join("canton");
    let study = canton.to_str().unwrap();
    belfry_command().args(["init", study, "--template", "canton"]).assert().success();
    let mut text = fs::read_to_string(canton.join("study.toml")).unwrap();
    text += "\n[[model.effect]]\nkind = \"added-mass\"\nwhere = \"443.6m\"\nvalue = 2e6\n";
    text += "\n[[model.effect]]\nkind = \"sensor-polarity\"\nwhere = \"07\"\n";
    fs::write(canton.join("study.toml"), text).unwrap();

    let report = json(&["export", study, "--of", "model"]);
    assert_eq!(report["left_out"], serde_json::json!(["sensor-polarity@ch07"]));
    let names: Vec<&str> =
        report["files"].as_array().unwrap().iter().map(|file| file["file"].as_str().unwrap()).collect();
    for name in ["stiffness.mtx", "mass.mtx", "dofs.csv", "model_shapes.csv", "model_modes.csv", "model_modes.uff"] {
        let file = names.iter().find(|file| file.ends_with(name)).unwrap_or_else(|| panic!("{name} in {names:?}"));
        assert!(fs::metadata(file).unwrap().len() > 0);
    }

    // The matrices are the model that made the modes.
    let export = "../canton/results/export";
    let matrices = format!(
        "[model]\nmatrices = {{ stiffness = \"{export}/stiffness.mtx\", mass = \"{export}/mass.mtx\", dofs = \"{export}/dofs.csv\" }}"
    );
    let again = measured_study(&folder.path().join("again"), &canton, &matrices);
    let comparison = json(&["compare", &again]);
    let pairs = comparison["pairs"].as_array().unwrap();
    assert!(pairs.len() >= 12, "{}", pairs.len());
    for pair in pairs {
        assert!(pair["frequency_error_percent"].as_f64().unwrap().abs() < 1e-6, "{pair}");
        assert!(pair["mac"].as_f64().unwrap() > 0.9999, "{pair}");
    }
    assert!(refused(&["profile", &again], 1).contains("matrices without a [[model.group]]"));
    assert!(
        refused(&["export", &again, "--of", "model", "--fitted-background"], 1)
            .contains("matrices without a [[model.group]]")
    );

    // The beam without the effect: the profile bends, and straightens with it.
    let beam = "[model]\nbeam = \"../canton/beam.csv\"\nbackground_stiffness = 0.03\nbackground_mass = 0.01";
    let lacks = measured_study(&folder.path().join("lacks"), &canton, beam);
    let profiles = json(&["profile", &lacks, "--with", "added-mass@443.6m"]);
    let mass = &profiles["with_effects"]["joint"]["values"][0];
    let [value, std] = ["value", "std"].map(|key| mass[key].as_f64().unwrap());
    assert!((value - 2e6).abs() < 2.0 * std && std < 1e6, "{mass}");
    assert_eq!(profiles["as_given"]["joint"], Value::Null);
    let results = folder.path().join("lacks/results");
    let table = fs::read_to_string(results.join("profile.csv")).unwrap();
    let quantities = profiles["as_given"]["quantities"].as_array().unwrap();
    let segments = quantities[0]["segments"].as_array().unwrap().len();
    assert_eq!(table.lines().count(), 1 + 2 * quantities.len() * segments);
    assert!(fs::read_to_string(results.join("profile.svg")).unwrap().contains("without effects"));
    let text = String::from_utf8(belfry_command().args(["profile", &lacks]).output().unwrap().stdout).unwrap();
    assert!(text.contains("bending 1 %") && text.contains("study.toml"), "{text}");

    assert!(refused(&["profile", &lacks, "--with", "added-mas"], 1).contains("did you mean added-mass"));
    let trusted = beam.lines().take(2).collect::<Vec<_>>().join("\n");
    let trusted = measured_study(&folder.path().join("trusted"), &canton, &trusted);
    assert!(refused(&["profile", &trusted], 1).contains("background_stiffness"));
    assert!(refused(&["export", study, "--of", "psd", "--fitted-background"], 2).contains("--of model"));
    assert!(refused(&["export", study, "--of", "model", "--format", "csv"], 2).contains("expected mtx or npy"));
}
