//! A user holds a model against measured modes: compares, updates, predicts sensors that were left out, and is told what is wrong
//! with the input.

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::{FOOTBRIDGE_STIFFNESS, belfry_command, published, run_canton, write_footbridge_study};
use predicates::prelude::*;
use serde_json::Value;

use crate::said::json;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap_or_else(|| panic!("{value} is no list"))
}

/// Standard error of a command that must fail with status 1 and without a stack trace, or anything on standard output.
fn refused(arguments: &[&str]) -> String {
    let output = belfry_command().args(arguments).assert().failure().code(1).stdout("").get_output().stderr.clone();
    let text = String::from_utf8(output).unwrap();
    assert!(!text.contains("panicked"), "{text}");
    text
}

/// The Canton template with an hour of the stand-in tower.
fn measured_tower(folder: &Path) -> String {
    let study = folder.join("canton").to_str().unwrap().to_owned();
    belfry_command().args(["init", &study, "--template", "canton"]).assert().success();
    let beam = concat!(env!("CARGO_MANIFEST_DIR"), "/../host/templates/canton/beam_field.csv");
    let simulate = ["simulate", &study, "--beam", beam, "--effect", "base-rotation=7.21e-15", "--adopt", "--seed", "5"];
    belfry_command().args(simulate).assert().success();
    study
}

#[test]
fn a_tower_is_compared_updated_and_co_validated() {
    let folder = tempfile::tempdir().unwrap();
    let study = measured_tower(folder.path());
    // In this order or not at all: each command says what has to come first.
    assert!(refused(&["compare", &study]).contains("belfry identify"));
    json(&["identify", &study]);
    let comparison = json(&["compare", &study]);
    assert_eq!(list(&comparison["pairs"]).len(), 13);
    for pair in list(&comparison["pairs"]) {
        assert_eq!(pair["measured"], pair["model"]);
        assert!(number(&pair["mac"]) > 0.8);
        assert!(number(&pair["frequency_z"]).abs() > 10.0, "errors of 5 to 17 % are far outside the deviations");
    }
    // The paper's Table 1 has the same model and, within 0.03 %, the same measured frequencies.
    assert!((number(&comparison["mean_abs_frequency_error_percent"]) - 11.1).abs() < 0.2);
    assert!(number(&comparison["p_value"]) < 1e-6, "the tower differs by more than the model's tolerance");
    assert_eq!(list(&comparison["by_sensor"]).len(), 20);
    assert_eq!(list(&comparison["by_height"]).len(), 8);
    assert_eq!(comparison["unpaired"], Value::Array(vec![]));

    let update = json(&["update", &study]);
    for (pair, ceiling) in list(&update["pairs"]).iter().zip(list(&update["mac_ceiling"])) {
        let (measured, updated) = (number(&pair["measured_hz"]), number(&pair["after"]["model_hz"]));
        assert!((updated / measured - 1.0).abs() < 1e-9, "{updated} Hz instead of {measured} Hz");
        assert!(number(&pair["after"]["mac"]) <= number(ceiling) + 1e-9);
    }
    assert!(number(&update["mean_mac"]["after"]) > 0.98);
    assert!(number(&update["max_relative_change_of_other_eigenvalues"]) < 1e-9);
    let psi = list(&update["psi"]);
    assert!(psi.len() == 13 && (0..13).all(|i| (0..13).all(|j| psi[i][j] == psi[j][i])));

    // E_d: the same before and after Psi, whatever its weights; directly as through nodes.
    let errors = |extra: &[&str]| -> Vec<(f64, f64, f64)> {
        let report = json(&[&["covalidate", &study, "--channels", "09,12"], extra].concat());
        let of = |channel: &Value, whose: &str| number(&channel["error_percent"][whose]);
        let channels = list(&report["channels"]).iter();
        let three = |c: &Value| (of(c, "model"), of(c, "updated"), of(c, "measured_shapes"));
        assert!(list(&report["channels"])[0]["error_percent"]["with_effects"].is_null());
        channels.map(three).collect()
    };
    let through_nodes = errors(&[]);
    json(&["update", &study, "--modes", "1,2,3,4,5,7", "--shape-weights", "1,1,1,3,3,5"]);
    let direct = errors(&["--direct"]);
    for ((model, updated, shapes), (direct_model, direct_updated, _)) in through_nodes.iter().zip(&direct) {
        assert!((model - updated).abs() < 1e-6 && (direct_model - direct_updated).abs() < 1e-6);
        assert!((model / direct_model - 1.0).abs() < 0.01, "{model} % through nodes, {direct_model} % directly");
        assert!(shapes < model, "measured shapes predict better than those of a wrong model");
    }
    let curves = fs::read_to_string(Path::new(&study).join("results/covalidation.csv")).unwrap();
    assert!(curves.starts_with("time_s,09_measured,09_model,09_updated,09_measured_shapes,12_measured"));
    assert!(curves.lines().count() > 5000);

    // The updated matrix is a model: with it, the frequencies fit and the shapes are those of the update.
    let update = json(&["update", &study]);
    let copy = folder.path().join("updated");
    fs::create_dir_all(copy.join("results")).unwrap();
    let text = fs::read_to_string(Path::new(&study).join("study.toml")).unwrap();
    let from = "../canton/results";
    let matrices = format!(
        "matrices = {{ stiffness = \"{from}/stiffness_updated.mtx\", mass = \"{from}/mass.mtx\", nodes = \"{from}/nodes.csv\" }}"
    );
    fs::write(copy.join("study.toml"), text.replace("beam = \"beam.csv\"", &matrices)).unwrap();
    fs::copy(Path::new(&study).join("results/modes.json"), copy.join("results/modes.json")).unwrap();
    let updated = json(&["compare", copy.to_str().unwrap()]);
    assert_eq!(list(&updated["pairs"]).len(), 13);
    for pair in list(&updated["pairs"]) {
        assert!(number(&pair["frequency_error_percent"]).abs() < 1e-7, "{pair}");
    }
    let macs = [&updated["mean_mac"], &update["mean_mac"]["after"]].map(number);
    assert!((macs[0] - macs[1]).abs() < 1e-3, "mean MAC {macs:?}: between nodes the shape functions differ a little");

    // An update of another model is not taken for one of this.
    let beam = Path::new(&study).join("beam.csv");
    fs::write(&beam, fs::read_to_string(&beam).unwrap().replace("1.30515e+15", "1.2e+15")).unwrap();
    let stale = belfry_command().args(["covalidate", &study, "--channels", "09", "--json"]).assert().success();
    let stale = stale.stderr(predicate::str::contains("another model")).get_output().stdout.clone();
    let report: Value = serde_json::from_slice(&stale).unwrap();
    assert!(report["channels"][0]["error_percent"]["updated"].is_null());
}

#[test]
fn the_missing_effect_in_the_model_lowers_what_no_update_lowers() {
    let folder = tempfile::tempdir().unwrap();
    let study = folder.path().join("canton").to_str().unwrap().to_owned();
    belfry_command().args(["init", &study, "--template", "canton"]).assert().success();
    // Soft enough to change shapes, quiet enough to see it in single sensors.
    let simulate = ["simulate", &study, "--effect", "base-rotation=1e-13", "--adopt", "--hours", "3"];
    belfry_command().args(simulate).args(["--noise-percent", "1", "--seed", "6"]).assert().success();
    json(&["identify", &study]);
    let without = json(&["compare", &study]);
    assert!(number(&without["p_value"]) < 0.01);
    json(&["update", &study]);
    let file = Path::new(&study).join("study.toml");
    let text = fs::read_to_string(&file).unwrap() + "\n[[model.effect]]\nkind = \"base-rotation\"\nvalue = 1e-13\n";
    fs::write(&file, text).unwrap();
    let with = json(&["compare", &study]);
    assert!(
        number(&with["mean_abs_frequency_error_percent"]) < 0.2 * number(&without["mean_abs_frequency_error_percent"])
    );
    // Without it, the model is let miss so much more that chi-squared falls too: 1951 and 84 here.
    assert!(number(&with["chi_squared"]) < 0.05 * number(&without["chi_squared"]), "{with}");
    assert!(number(&with["p_value"]) > 0.01, "{with}");
    let report = json(&["covalidate", &study, "--channels", "05,13"]);
    for channel in list(&report["channels"]) {
        let error = |whose: &str| number(&channel["error_percent"][whose]);
        assert!((error("model") - error("updated")).abs() < 1e-6);
        assert!(error("with_effects") < 0.95 * error("model"), "{channel}");
    }
    // An effect off the structure is told by its line.
    fs::write(
        &file,
        fs::read_to_string(&file).unwrap()
            + "\n[[model.effect]]\nkind = \"added-mass\"\nwhere = \"700m\"\nvalue = 1e5\n",
    )
    .unwrap();
    let message = refused(&["compare", &study]);
    assert!(message.contains("study.toml, line") && message.contains("700") && message.contains("618"), "{message}");
}

#[test]
#[cfg_attr(not(footbridge_data), ignore = "needs ../shared/pedestrian-bridge")]
fn the_footbridge_with_half_of_its_degrees_of_freedom_massless() {
    let data = published("pedestrian-bridge");
    let folder = tempfile::tempdir().unwrap();
    write_footbridge_study(&data, folder.path()).unwrap();
    let study = folder.path().to_str().unwrap();
    let comparison = json(&["compare", study]);
    // The first two modes stand in the other order in the model: lateral at 4.06, vertical at 4.55 Hz.
    let models: Vec<_> = list(&comparison["pairs"]).iter().map(|pair| pair["model"].as_u64().unwrap()).collect();
    assert_eq!(models, [2, 1, 3, 4, 5]);
    let update = json(&["update", study]);
    for pair in list(&update["pairs"]) {
        assert!((number(&pair["after"]["model_hz"]) / number(&pair["measured_hz"]) - 1.0).abs() < 1e-9);
        assert!(number(&pair["after"]["mac"]) >= number(&pair["before"]["mac"]), "{pair}");
    }
    assert!(number(&update["max_relative_change_of_other_eigenvalues"]) < 1e-9);
    // A long deck whose sensors have no heights: the misfit is told by its parts.
    let parts: Vec<&str> = list(&comparison["by_group"]).iter().map(|part| part["group"].as_str().unwrap()).collect();
    assert_eq!(parts, FOOTBRIDGE_STIFFNESS);
    let message = refused(&["covalidate", study, "--channels", "dof1"]);
    assert!(message.contains("no recording"), "{message}");
}

/// The published matrices, an hour of the stand-in tower (`cargo run -p belfry-tests -- canton` takes a day).
#[test]
#[cfg_attr(not(canton_data), ignore = "needs ../shared/canton")]
fn the_published_tower_beside_the_papers_tables() {
    let data = published("canton");
    let folder = tempfile::tempdir().unwrap();
    let run = run_canton(belfry_command, &data, &folder.path().join("canton"), 1.0).unwrap();
    assert!((run.update.mean_abs_frequency_error_percent.before - 11.1).abs() < 0.3, "as in the paper's Table 1");
    assert!(run.update.mean_abs_frequency_error_percent.after < 1e-7);
    assert!(run.update.mean_mac.unwrap().after > 0.95);
    for channel in &run.covalidation.channels {
        let errors = channel.error_percent;
        assert!((errors.model.unwrap() - errors.updated.unwrap()).abs() < 1e-6);
    }
    assert!(run.tables.contains("│   12 ┆    1.250 ┆ 1.122 ┆"), "{}", run.tables);
}

const MODES_ALONE: &str =
    "[structure]\nname = \"Mast\"\n\n[measured]\nmodes = \"modes.csv\"\n\n[model]\nbeam = \"beam.csv\"\n";

fn mast(folder: &Path, study: &str, modes: &str) -> String {
    fs::write(folder.join("study.toml"), study).unwrap();
    fs::write(folder.join("modes.csv"), modes).unwrap();
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../host/templates/canton/beam.csv"), folder.join("beam.csv"))
        .unwrap();
    folder.to_str().unwrap().to_owned()
}

#[test]
fn frequencies_alone_are_compared_and_shapes_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let modes = "mode,frequency_hz\n1,0.094\n2,0.138\n3,0.366\n4,0.424\n5,0.475\n";
    let study = mast(folder.path(), MODES_ALONE, modes);
    let comparison = json(&["compare", &study]);
    assert_eq!(list(&comparison["pairs"]).len(), 5);
    assert!(comparison["mean_mac"].is_null() && list(&comparison["by_sensor"]).is_empty());
    assert!(refused(&["update", &study]).contains("none of the paired modes has a measured shape"));
}

#[test]
fn what_does_not_go_together_is_told_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let sensor = |channel: &str, elevation_m: f64| {
        format!("[[sensor]]\nchannel = \"{channel}\"\nelevation_m = {elevation_m}\nazimuth_deg = 108\n")
    };
    let write = |top_m: f64, modes: &str| {
        let sensors = sensor("top", top_m) + &sensor("mid", 300.0);
        mast(folder.path(), &format!("{MODES_ALONE}\n{sensors}"), modes)
    };

    let study = write(900.0, "mode,frequency_hz,top,mid\n1,0.1,1,0.4\n");
    let message = refused(&["compare", &study]);
    assert!(message.contains("channel top") && message.contains("900") && message.contains("618"), "{message}");

    let study = write(600.0, "mode,frequency_hz,tpo\n1,0.1,1\n");
    assert!(refused(&["compare", &study]).contains("`tpo` is no channel or point of the study; it has top, mid"));

    // Two sensors, three modes: an answer, and what it lacks. With one mode there is nothing to turn.
    let study = write(600.0, "mode,frequency_hz,top,mid\n1,0.11,1,0.3\n2,0.16,1,0.3\n3,0.35,1,-0.4\n");
    let warned =
        predicate::str::contains("3 modes at 2 sensors").and(predicate::str::contains("1 of the 3 directions"));
    belfry_command().args(["update", &study]).assert().success().stderr(warned);
    let one = json(&["update", &study, "--modes", "1"]);
    assert!(number(&one["max_relative_change_of_other_eigenvalues"]) < 1e-9);
    assert_eq!(one["rotation"], serde_json::json!([[1.0]]));
    assert!(refused(&["update", &study, "--shape-weights", "1,2,3,4"]).contains("give 1, 2 or one for each of the 3"));

    let study = write(600.0, "mode,frequency_hz,top,mid\n1,0.11,1,NaN\n");
    let warned = predicate::str::contains("mode 1: a component at channel top alone is no shape");
    belfry_command().args(["compare", &study]).assert().success().stderr(warned);

    fs::write(folder.path().join("study.toml"), MODES_ALONE.replace("[model]\nbeam = \"beam.csv\"\n", "")).unwrap();
    assert!(refused(&["compare", &study]).contains("no [model] to compare"));
    fs::remove_file(folder.path().join("modes.csv")).unwrap();
    fs::write(folder.path().join("study.toml"), MODES_ALONE).unwrap();
    assert!(refused(&["update", &study]).contains("modes.csv: cannot be read"));
}

#[test]
fn left_out_channels_are_checked_before_anything_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let study = measured_tower(folder.path());
    json(&["identify", &study]);
    assert!(
        refused(&["covalidate", &study, "--channels", "09,21"])
            .contains("there is no channel 21; the study has 01, 02")
    );
    assert!(
        refused(&["covalidate", &study, "--channels", "09", "--setup", "may"]).contains("there is no setup \"may\"")
    );
    assert!(refused(&["update", &study, "--modes", "1,40"]).contains("there is no measured mode 40"));
    let most: Vec<String> = (1..=10).map(|channel| format!("{channel:02}")).collect();
    let message = refused(&["covalidate", &study, "--channels", &most.join(",")]);
    assert!(message.contains("13 modes cannot be told apart by 10 sensors"), "{message}");
    // Without any the two are chosen that the others see best.
    let report = json(&["covalidate", &study, "--direct"]);
    let chosen = report["channels"].as_array().unwrap();
    assert_eq!(chosen.len(), 2);
    for channel in chosen {
        assert!(number(&channel["noise_gain"]) < 4.0 && number(&channel["error_percent"]["measured_shapes"]) < 50.0);
    }
}
