//! A user asks which physical effect the model lacks, adds it, and watches the error fall.

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use serde_json::Value;

use crate::said::json;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Runs a command that must fail, and returns what it says.
fn refusal(arguments: &[&str]) -> String {
    let assert = belfry_command().args(arguments).assert().code(1);
    String::from_utf8(assert.get_output().stderr.clone()).unwrap()
}

/// A study of the Canton Tower with six hours of a tower that has an effect which its model does not know.
fn hidden(folder: &Path, effect: &str) -> String {
    let place = folder.join("tower").to_str().unwrap().to_owned();
    belfry_command().args(["init", &place, "--template", "canton"]).assert().success();
    // The modes end at 1.5 Hz.
    let study = Path::new(&place).join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, text.replace("sampling_rate_hz = 50.0", "sampling_rate_hz = 12.5")).unwrap();
    let simulate =
        ["simulate", &place, "--effect", effect, "--scatter", "0.3", "--hours", "6", "--seed", "3", "--adopt"];
    belfry_command().args(simulate).assert().success();
    belfry_command().args(["identify", &place, "--direct"]).assert().success();
    place
}

#[test]
fn a_hidden_effect_is_found_and_added_and_the_error_falls_where_no_psi_update_helps() {
    let folder = tempfile::tempdir().unwrap();
    // A foundation that slides moves the span of the shapes: what the left-out sensors see is not in that of the model.
    let place = hidden(folder.path(), "base-translation=1.2e-9");
    let study = Path::new(&place).join("study.toml");
    let before = fs::read_to_string(&study).unwrap();

    let diagnosis = json(&["diagnose", &place]);
    assert_eq!(fs::read_to_string(&study).unwrap(), before, "a diagnosis changes nothing");
    assert_eq!(diagnosis["verdict"], "effect", "{}", diagnosis["candidates"][0]);
    let best = diagnosis["best"][0].as_str().unwrap();
    assert_eq!(best, "base-translation");
    let candidate = &diagnosis["candidates"][0];
    let value = &candidate["parameters"][0];
    let z = (number(&value["value"]) - 1.2e-9) / number(&value["std"]);
    assert!(z.abs() < 4.0 && value["unit"] == "m/N", "{value}");
    assert!(number(&diagnosis["goodness_of_fit"]["p_value"]) > 0.01 && number(&diagnosis["present"]["p_value"]) < 1e-6);
    for key in ["by_mode", "by_sensor", "by_height"] {
        assert!(!diagnosis["unexplained"][key].as_array().unwrap().is_empty(), "{key}");
    }

    let left_out = ["covalidate", &place, "--channels", "09,12", "--direct"];
    belfry_command().args(["update", &place]).assert().success();
    let error = |report: &Value, whose: &str| -> Vec<f64> {
        let channels = report["channels"].as_array().unwrap();
        channels.iter().map(|channel| number(&channel["error_percent"][whose])).collect()
    };
    let given = json(&left_out);
    for (model, updated) in error(&given, "model").iter().zip(error(&given, "updated")) {
        assert!((model - updated).abs() < 1e-6 * model, "a Psi update cannot change E_d: {model} {updated}");
    }

    let change = json(&["add", &place, best]);
    let mean = |comparison: &Value| number(&comparison["mean_abs_frequency_error_percent"]);
    assert!(mean(&change["after"]) < 0.5 * mean(&change["before"]), "{} {}", change["before"], change["after"]);
    let text = fs::read_to_string(&study).unwrap();
    assert!(text.contains("[[model.effect]]") && text.contains("kind = \"base-translation\""), "{text}");
    for line in before.lines().filter(|line| line.starts_with('#')) {
        assert!(text.contains(line), "a comment is gone: {line}");
    }

    // The noise floor: what the true structure's shapes leave.
    let with = error(&json(&left_out), "with_effects");
    let truth = Path::new(&place).join("study.toml.truth");
    let (head, _) = text.split_once("[[model.effect]]").unwrap();
    fs::copy(&study, &truth).unwrap();
    fs::write(&study, format!("{head}[[model.effect]]\nkind = \"base-translation\"\nvalue = 1.2e-9\n")).unwrap();
    let floor = error(&json(&left_out), "with_effects");
    fs::rename(&truth, &study).unwrap();
    for ((given, with), floor) in error(&given, "model").iter().zip(&with).zip(&floor) {
        assert!(with < &(1.3 * floor), "{with} % with the effect, {floor} % with the truth");
        assert!(given > &(1.2 * floor), "the effect must matter for the test to mean anything: {given} {floor}");
    }

    let history = json(&["history", &place]);
    let steps = history["steps"].as_array().unwrap();
    assert_eq!(steps.len(), 2);
    for key in
        ["chi_squared", "mean_abs_frequency_error_percent", "held_out_error_percent", "held_out_mode_error_percent"]
    {
        assert!(number(&steps[1][key]) < number(&steps[0][key]), "{key}: {} {}", steps[0][key], steps[1][key]);
    }
    assert!(Path::new(&place).join("results/history.svg").exists());
    assert_eq!(json(&["diagnose", &place])["verdict"], "adequate");

    let update = json(&["update", &place]);
    assert!(number(&update["psi_explained"][0]["explained"]) > 0.5, "{}", update["psi_explained"]);
    belfry_command().args(["remove", &place, best]).assert().success();
    assert!(!fs::read_to_string(&study).unwrap().contains("model.effect"));
    assert_eq!(json(&["history", &place])["steps"].as_array().unwrap().len(), 3);
}

/// Late clocks and machines are hidden by the simulation and found, each by what it shows in.
#[test]
fn a_late_clock_and_a_steady_force_are_found() {
    for (effect, value) in [("clock-offset@node3=0.1", Some(0.1)), ("harmonic@0.83hz", None)] {
        let folder = tempfile::tempdir().unwrap();
        let place = hidden(folder.path(), effect);
        let diagnosis = json(&["diagnose", &place]);
        let name = effect.split('=').next().unwrap();
        assert_eq!(diagnosis["best"][0], name, "{}", diagnosis["candidates"][0]);
        if let Some(value) = value {
            let found = &diagnosis["candidates"][0]["parameters"][0];
            assert!((number(&found["value"]) - value).abs() < 4.0 * number(&found["std"]), "{found}");
        } else {
            assert!(diagnosis["reason"].as_str().unwrap().contains("kurtosis"), "{}", diagnosis["reason"]);
        }
        let change = json(&["add", &place, name]);
        assert_eq!(change["effects"][0]["effect"], name.split('@').next().unwrap());
    }
}

/// Errors of another measurement are no step before; effects that contradict each other can be taken out again.
#[test]
fn a_new_measurement_begins_anew_and_contradictions_can_be_removed() {
    let folder = tempfile::tempdir().unwrap();
    let place = hidden(folder.path(), "added-mass@300m=4e6");
    let first = json(&["add", &place, "added-mass"]);
    assert!(number(&first["step"]["log_bayes_factor"]) > 3.0, "{}", first["step"]);
    let again = ["simulate", &place, "--effect", "sensor-gain@13=1.4", "--hours", "6", "--seed", "4", "--force"];
    belfry_command().args(again).assert().success();
    belfry_command().args(["identify", &place, "--direct"]).assert().success();
    let second = json(&["add", &place, "sensor-gain@ch13"]);
    assert_ne!(first["step"]["data"], second["step"]["data"]);
    let before = number(&second["previous"]["chi_squared"]);
    assert!(number(&second["step"]["chi_squared"]) < before, "{} {before}", second["step"]);
    let history = json(&["history", &place]);
    let actions: Vec<&str> =
        history["steps"].as_array().unwrap().iter().map(|step| step["action"].as_str().unwrap()).collect();
    assert!(actions.contains(&"new measurement or model"), "{actions:?}");

    let study = Path::new(&place).join("study.toml");
    let twins = "\n[[model.effect]]\nkind = \"stiffness-scale\"\nvalue = 0.1\n\n[[model.effect]]\nkind = \"mass-scale\"\nvalue = 0.1\n";
    fs::write(&study, fs::read_to_string(&study).unwrap() + twins).unwrap();
    let error = refusal(&["diagnose", &place]);
    assert!(error.contains("stiffness-scale and mass-scale cannot both be fitted"), "{error}");
    belfry_command().args(["remove", &place, "mass-scale"]).assert().success();
    belfry_command().args(["diagnose", &place]).assert().success();
}

#[test]
fn what_cannot_be_added_is_refused_and_nothing_changes() {
    let folder = tempfile::tempdir().unwrap();
    let place = hidden(folder.path(), "mass-scale=0.1");
    let study = Path::new(&place).join("study.toml");
    let unchanged = |before: &str| {
        assert_eq!(fs::read_to_string(&study).unwrap(), before);
    };
    let before = fs::read_to_string(&study).unwrap();
    for (effect, expected) in [
        ("base-rotaton", "did you mean base-rotation?"),
        ("added-mass@900m", "the beam stands from -10 m to 618 m"),
        ("added-mass@ch07", "needs a height such as @225.2m"),
        ("sensor-gain@ch99", "the study has no channel 99"),
        ("clock-offset@node42", "no sensor of the study belongs to node 42"),
        ("stiffness-loss@150m=1.5", "it must be 0 to 0.99"),
        ("custom@cables", "no [[model.custom]] in study.toml has this name"),
        ("temperature-stiffness", "run `belfry identify"),
    ] {
        let error = refusal(&["add", &place, effect]);
        assert!(error.contains(expected), "{effect}: {error}");
        unchanged(&before);
    }
    assert!(refusal(&["remove", &place, "p-delta"]).contains("the model has no effects to remove"));
    assert!(refusal(&["history", &place]).contains("the model has no history yet"));

    belfry_command().args(["add", &place, "mass-scale"]).assert().success();
    let with = fs::read_to_string(&study).unwrap();
    let error = refusal(&["add", &place, "stiffness-scale=0.1"]);
    assert!(error.contains("cannot both be fitted"), "{error}");
    let error = refusal(&["add", &place, "mass-scale"]);
    assert!(error.contains("is in the model already"), "{error}");
    unchanged(&with);

    let fresh = folder.path().join("fresh").to_str().unwrap().to_owned();
    belfry_command().args(["init", &fresh, "--template", "canton"]).assert().success();
    for command in ["diagnose", "add"] {
        let mut arguments = vec![command, &fresh];
        arguments.extend((command == "add").then_some("p-delta"));
        let error = refusal(&arguments);
        assert!(error.contains("run `belfry identify"), "{error}");
    }
}

/// The paper's frequencies against the model: no single effect explains them, and frequencies alone decide little.
#[test]
fn measured_frequencies_alone_are_diagnosed_with_what_they_cannot_decide() {
    let folder = tempfile::tempdir().unwrap();
    let diagnosis = json(&["diagnose", &measured_frequencies(folder.path())]);
    assert_eq!(diagnosis["verdict"], "unknown");
    assert!(diagnosis["candidates"].as_array().unwrap().len() > 3);
    assert!(
        diagnosis["warnings"][0].as_str().unwrap().contains("no shapes were measured"),
        "{}",
        diagnosis["warnings"]
    );
    // The best of them goes part of the way.
    assert!(number(&diagnosis["candidates"][0]["chi_squared"]) < 0.7 * number(&diagnosis["present"]["chi_squared"]));
}

/// A study of the tower's beam with the frequencies of the paper's table and nothing else.
fn measured_frequencies(folder: &Path) -> String {
    let templates = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../host/templates/canton"));
    fs::copy(templates.join("beam.csv"), folder.join("beam.csv")).unwrap();
    let table = fs::read_to_string(templates.join("paper_table1.csv")).unwrap();
    let rows = table.lines().skip(1).map(|row| row.split(',').collect::<Vec<_>>());
    let modes: String = rows.map(|row| format!("{},{}\n", row[0], row[2])).collect();
    fs::write(folder.join("modes.csv"), format!("mode,frequency_hz\n{modes}")).unwrap();
    let model = "[model]\nbeam = \"beam.csv\"\nbackground_stiffness = 0.03\nbackground_mass = 0.01\n";
    fs::write(
        folder.join("study.toml"),
        format!("[structure]\nname = \"Canton Tower\"\n\n[measured]\nmodes = \"modes.csv\"\n\n{model}"),
    )
    .unwrap();
    folder.to_str().unwrap().to_owned()
}

/// Effects that together explain too little are not written.
#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all runs it")]
fn what_explains_too_little_is_not_added_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let place = measured_frequencies(folder.path());
    let before = fs::read_to_string(folder.path().join("study.toml")).unwrap();
    let assert = belfry_command().args(["diagnose", &place, "--auto"]).assert().success();
    let output = assert.get_output();
    let said = String::from_utf8(output.stderr.clone()).unwrap();
    assert!(said.contains("nothing was added"), "{said}");
    // What explains most is shown all the same.
    assert!(String::from_utf8_lossy(&output.stdout).contains("A lead, not a finding"));
    assert_eq!(fs::read_to_string(folder.path().join("study.toml")).unwrap(), before);
}

/// A hypothesis of the user's own competes with the catalogue.
#[test]
fn a_custom_hypothesis_is_a_candidate_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let diagnosis = json(&["diagnose", &weak_side(folder.path())]);
    assert_eq!(diagnosis["best"][0], "custom@weak-side", "{}", diagnosis["candidates"][0]);
    // 30 % times 0.8 is 24 %.
    let value = number(&diagnosis["candidates"][0]["parameters"][0]["value"]);
    assert!((value - 0.8).abs() < 0.1, "{value}");
}

#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all runs it")]
fn what_only_a_custom_hypothesis_explains_is_unknown_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let without = json(&["diagnose", &weak_side(folder.path()), "--without", "custom"]);
    assert_eq!(without["verdict"], "unknown", "{}", without["best"]);
}

/// A study with a hypothesis of the user's own, and six hours of a tower of which it is true.
fn weak_side(folder: &Path) -> String {
    let place = hidden(folder, "stiffness-scale=0");
    let table = "z_bottom_m,z_top_m,bending_2\n-10,618,-0.3\n";
    fs::write(Path::new(&place).join("weak.csv"), table).unwrap();
    let study = Path::new(&place).join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    let custom = "\n[[model.custom]]\nname = \"weak-side\"\nsegments = \"weak.csv\"\nleast = 0.0\n";
    fs::write(&study, text + custom).unwrap();
    // The tower is made from a beam that is weaker in one direction, which nothing in the catalogue says.
    let beam = fs::read_to_string(Path::new(&place).join("beam.csv")).unwrap();
    let weaker: Vec<String> = beam
        .lines()
        .enumerate()
        .map(|(index, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if index > 0 {
                cells[3] = format!("{:e}", 0.76 * cells[3].parse::<f64>().unwrap());
            }
            cells.join(",")
        })
        .collect();
    let weak = folder.join("weak_tower.csv");
    fs::write(&weak, weaker.join("\n") + "\n").unwrap();
    let simulate =
        ["simulate", &place, "--beam", weak.to_str().unwrap(), "--hours", "6", "--seed", "5", "--adopt", "--force"];
    belfry_command().args(simulate).assert().success();
    belfry_command().args(["identify", &place, "--direct"]).assert().success();
    place
}

#[test]
fn the_catalogue_is_listed_and_explained() {
    let all = json(&["effects"]);
    let kinds = all["effects"].as_array().unwrap();
    assert!(kinds.len() >= 23);
    for kind in kinds {
        for key in ["name", "physics", "formula", "fingerprint", "source"] {
            assert!(kind[key].as_str().is_some_and(|text| !text.is_empty()), "{key} of {}", kind["name"]);
        }
    }
    let text = belfry_command().args(["effects", "base-rotation"]).assert().success().get_output().stdout.clone();
    let text = String::from_utf8(text).unwrap();
    assert!(text.contains("rad/(N m)") && text.contains("Looks like base-translation"), "{text}");
    assert!(text.contains("base-rotation=flexibility_x=7e-15,flexibility_y=9e-15"), "how two values are typed: {text}");
}

/// All storeys are too flexible in shear, by 0.309, and frequencies off by an eighth, whatever the study says of how far storeys scatter. The modes are those
/// of a simulated recording.
#[test]
fn storeys_far_too_flexible_are_named_whatever_the_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("flexible-storeys");
    for file in ["study.toml", "beam.csv", "modes.csv"] {
        fs::copy(from.join(file), folder.path().join(file)).unwrap();
    }
    let (place, toml) = (folder.path().to_str().unwrap(), folder.path().join("study.toml"));
    let text = fs::read_to_string(&toml).unwrap();
    assert!(text.contains("background_stiffness = 0.03\n"), "{text}");
    for tolerance in ["0.015", "0.03", "0.04"] {
        let stated = format!("background_stiffness = {tolerance}\n");
        fs::write(&toml, text.replace("background_stiffness = 0.03\n", &stated)).unwrap();
        let said = json(&["diagnose", place]);
        let best = (said["verdict"].as_str(), said["best"][0].as_str());
        assert_eq!(best, (Some("effect"), Some("shear-flexibility")), "{tolerance}");
        let first = &said["candidates"][0];
        let (value, std) = (number(&first["parameters"][0]["value"]), number(&first["parameters"][0]["std"]));
        assert!((value - 0.309).abs() < 2.0 * std && std < 0.04, "{tolerance}: {value} ± {std}");
        assert!(number(&first["probability"]) > 0.9, "{tolerance}: {first}");
    }
}
