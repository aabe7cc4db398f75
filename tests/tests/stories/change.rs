//! A user has measured a structure twice and asks what has changed, and where.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::{belfry_command, published};
use serde_json::Value;

/// The template's tower as it might have been built: every segment's bending, shear, torsion and mass differ from the table by some percent,
/// each by itself, which is not how the model's tolerance has it.
fn as_built(table: &str) -> String {
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut uniform = || {
        // Xorshift (Marsaglia 2003).
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut lines = table.lines();
    let mut built = lines.next().unwrap().to_owned() + "\n";
    for line in lines {
        let mut cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        // Bending about both axes together, shear, torsion, mass: uniform within ±8 % and ±3 %.
        let [bending, shear, torsion, mass] = [0.16, 0.16, 0.16, 0.06].map(|width| 1.0 + width * (uniform() - 0.5));
        for (column, factor) in [(2, bending), (3, bending), (5, shear), (6, torsion), (7, mass)] {
            cells[column] *= factor;
        }
        built += &(cells.iter().map(f64::to_string).collect::<Vec<_>>().join(",") + "\n");
    }
    built
}

/// A study of six hours of the tower as it was built, with effects that its model does not know.
fn measured(parent: &Path, name: &str, seed: &str, effects: &[&str]) -> String {
    let place = parent.join(name).to_str().unwrap().to_owned();
    belfry_command().args(["init", &place, "--template", "canton"]).assert().success();
    let study = Path::new(&place).join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, text.replace("sampling_rate_hz = 50.0", "sampling_rate_hz = 12.5")).unwrap();
    let built = parent.join("built.csv");
    fs::write(&built, as_built(&fs::read_to_string(Path::new(&place).join("beam.csv")).unwrap())).unwrap();
    let mut simulate = belfry_command();
    simulate.args(["simulate", &place, "--hours", "6", "--seed", seed, "--adopt", "--beam"]).arg(&built);
    simulate.args(effects.iter().flat_map(|effect| ["--effect", effect])).assert().success();
    belfry_command().args(["identify", &place, "--direct"]).assert().success();
    place
}

fn change(study: &str, before: &str) -> Value {
    let output = belfry_command().args(["change", study, "--before", before, "--json"]).assert().success();
    serde_json::from_slice(&output.get_output().stdout).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// What the model lacks before and now: a foundation that turns, and the weight above.
const LACKING: [&str; 2] = ["base-rotation=4e-15", "p-delta=1"];

#[test]
fn a_loss_is_found_where_it_is_though_the_model_is_wrong_and_an_unchanged_tower_is_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let before = measured(folder.path(), "before", "51", &LACKING);
    let again = measured(folder.path(), "again", "52", &LACKING);
    let damaged = measured(folder.path(), "damaged", "53", &[&LACKING[..], &["stiffness-loss@285m=0.25"]].concat());

    // The model alone fails: what it lacks is not what has changed.
    let output = belfry_command().args(["compare", &before, "--json"]).assert().success();
    let comparison: Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert!(number(&comparison["mean_abs_frequency_error_percent"]) > 1.0, "{comparison}");

    let found = change(&damaged, &before);
    let diagnosis = &found["diagnosis"];
    assert_eq!(diagnosis["verdict"], "effect", "{}", diagnosis["candidates"][0]);
    let best = &diagnosis["candidates"][0];
    assert_eq!(best["effect"], "stiffness-loss");
    let z_m: f64 = best["where"].as_str().unwrap().trim_end_matches('m').parse().unwrap();
    assert!((z_m - 285.0).abs() < 15.0, "{z_m} m");
    let value = &best["parameters"][0];
    assert!((number(&value["value"]) - 0.25).abs() < 4.0 * number(&value["std"]) + 0.05, "{value}");
    assert!(number(&found["test"]["p_value"]) < 1e-6);
    assert!(Path::new(&damaged).join("results/change.svg").is_file());
    assert!(Path::new(&damaged).join("results/change.json").is_file());

    let found = change(&again, &before);
    assert_eq!(found["diagnosis"]["verdict"], "unchanged", "{}", found["diagnosis"]["candidates"][0]);
    assert!(number(&found["test"]["p_value"]) > 0.01, "{}", found["test"]);
    assert_eq!(found["modes"].as_array().unwrap().len(), 14);

    // A file of modes is as good as a study; other sensors are not.
    let file = Path::new(&before).join("results/modes.json");
    assert_eq!(change(&again, file.to_str().unwrap())["test"], found["test"]);
    let study = Path::new(&before).join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, text.replacen("elevation_m = 30.63", "elevation_m = 40", 1)).unwrap();
    let assert = belfry_command().args(["change", &again, "--before", &before]).assert().code(1);
    let said = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(said.contains("channel 01") && said.contains("40 m there, 30.63 m here"), "{said}");
    let assert = belfry_command().args(["change", &again, "--before", "no-such.csv"]).assert().code(1);
    assert!(String::from_utf8_lossy(&assert.get_output().stderr).contains("no-such.csv"));
}

/// The Z24 bridge with the five sensors that stood in all setups; no model.
fn bridge(parent: &Path, state: &str, setups: &[&str]) -> String {
    let folder = published("real/z24");
    let mut study = "[structure]\nname = \"bridge\"\n[analysis]\nband_hz = [2.0, 30.0]\n".to_owned();
    for setup in setups {
        let file = folder.join(format!("{state}setup{setup}_R.mat"));
        write!(
            study,
            "[[setup]]\nname = \"setup {setup}\"\nfiles = [{file:?}]\nvariable = \"data_last5\"\nsampling_rate_hz = 100.0\nunit = \"m/s2\"\n"
        )
        .unwrap();
        for channel in 1..=5 {
            let reference = setups.len() > 1;
            write!(
                study,
                "[[setup.sensor]]\nchannel = \"{channel}\"\nnode = {}\nreference = {reference}\n",
                1 + channel / 5
            )
            .unwrap();
        }
    }
    let place = parent.join(format!("{state}-{}", setups.join("-")));
    fs::create_dir(&place).unwrap();
    fs::write(place.join("study.toml"), study).unwrap();
    belfry_command().arg("identify").arg(&place).arg("--direct").assert().success();
    place.to_str().unwrap().to_owned()
}

#[test]
#[cfg_attr(not(real_data), ignore = "needs ../shared/real")]
fn a_bridge_whose_pier_was_lowered_has_changed_by_what_was_published_and_a_sound_one_has_not() {
    let parent = tempfile::tempdir().unwrap();
    let sound = bridge(parent.path(), "01", &["01", "02", "03"]);
    let lowered = bridge(parent.path(), "05", &["01", "02", "03"]);
    let found = change(&lowered, &sound);
    assert!(found["diagnosis"].is_null(), "there is no model");
    assert!(number(&found["test"]["p_value"]) < 1e-4, "{}", found["test"]);
    // Lowering the pier by up to 95 mm costs the first mode up to 6 %, and the others less.
    let first = &found["modes"][0];
    assert!((-6.0..-2.0).contains(&number(&first["change_percent"])), "{first}");
    assert!(number(&first["p_value_of_frequency"]) < 1e-4, "{first}");
    let second = &found["modes"][1];
    assert!((-4.0..-1.0).contains(&number(&second["change_percent"])), "{second}");
    // Setups of the sound bridge, eleven minutes each, against each other.
    let setups = ["01", "02", "03"].map(|setup| bridge(parent.path(), "01", &[setup]));
    for (one, other) in [(0, 1), (1, 2), (0, 2)] {
        let found = change(&setups[other], &setups[one]);
        let changes: Vec<&Value> = found["modes"].as_array().unwrap().iter().collect();
        assert!(number(&changes[0]["p_value_of_frequency"]) > 0.01, "{}", changes[0]);
        assert!(number(&changes[1]["p_value_of_frequency"]) > 0.01, "{}", changes[1]);
    }
}
