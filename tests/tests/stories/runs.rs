//! A model of OpenSees that never leaves it: Belfry is given its modes, and those of runs with one group changed.

use std::fs;
use std::path::Path;

use crate::said::json;
use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::prelude::*;
use predicates::str::contains;

/// A copy of the study that `tests/foreign/runs/frame.py` has written.
fn study(folder: &Path) {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("foreign/runs");
    for entry in fs::read_dir(from).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.extension().is_some_and(|ending| ending == "csv" || ending == "toml") {
            fs::copy(&entry, folder.join(entry.file_name().unwrap())).unwrap();
        }
    }
}

/// What the script has changed: the lower columns have lost a quarter, and all other groups differ within what they are trusted to.
const TRUTH: [(&str, f64); 4] = [("columns-low", 0.75), ("columns-high", 0.98), ("beams", 1.03), ("foundation", 1.05)];

#[test]
fn a_group_that_has_lost_stiffness_is_named_from_modes_alone() {
    let folder = tempfile::tempdir().unwrap();
    study(folder.path());
    let path = folder.path().to_str().unwrap();
    belfry_command().arg("compare").arg(folder.path()).assert().success().stdout(contains("known by its modes"));
    let diagnosis = json(&["diagnose", path]);
    assert_eq!(diagnosis["verdict"], "effect", "{diagnosis}");
    let best = &diagnosis["candidates"][0];
    assert_eq!((best["effect"].as_str(), best["where"].as_str()), (Some("group"), Some("columns-low")), "{best}");
    belfry_command().arg("add").arg(folder.path()).arg("group@columns-low").assert().success();
    let profiles = json(&["profile", path]);
    for group in profiles["with_effects"]["groups"].as_array().unwrap() {
        let (name, factor, std) = (&group["name"], group["factor"].as_f64().unwrap(), group["std"].as_f64().unwrap());
        let (_, truth) = TRUTH.iter().find(|(known, _)| name == known).unwrap();
        assert!((factor - truth).abs() < 3.0 * std, "{name}: {factor} ± {std}, not {truth}");
    }
    // There are no matrices to write, and that is told.
    belfry_command().arg("update").arg(folder.path()).assert().success().stdout(contains("no matrices to write"));
    belfry_command()
        .args(["export", "--of", "model"])
        .arg(folder.path())
        .assert()
        .failure()
        .stderr(contains("has no matrices to export"));
}

/// Runs do not say where a group stands: the study does, by the channels of the sensors there.
#[test]
fn groups_of_runs_have_the_sensors_that_the_study_names() {
    let folder = tempfile::tempdir().unwrap();
    study(folder.path());
    let path = folder.path().to_str().unwrap();
    let unnamed = json(&["compare", path]);
    assert_eq!(unnamed["groups_without_sensors"].as_array().unwrap().len(), TRUTH.len());
    belfry_command().args(["compare", path]).assert().success().stdout(contains(
        "no sensor at group columns-low, columns-high, beams, foundation; `channels` in a [[model.group]]",
    ));
    let file = folder.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    let with = |channels: &str| {
        let named = format!("name = \"columns-low\"\nchannels = {channels}");
        fs::write(&file, text.replacen("name = \"columns-low\"", &named, 1)).unwrap();
    };
    with("[\"100x\", \"200x\"]");
    let named = json(&["compare", path]);
    // The root mean square of its two sensors.
    let misfit = |channel: &str| {
        let sensors = named["by_sensor"].as_array().unwrap();
        sensors.iter().find(|sensor| sensor["channel"] == channel).unwrap()["misfit"].as_f64().unwrap()
    };
    let expected = ((misfit("100x").powi(2) + misfit("200x").powi(2)) / 2.0).sqrt();
    let groups = named["by_group"].as_array().unwrap();
    assert_eq!((groups.len(), groups[0]["group"].as_str()), (1, Some("columns-low")));
    assert!((groups[0]["misfit"].as_f64().unwrap() - expected).abs() < 1e-12);
    with("[\"100x\", \"attic\"]");
    belfry_command()
        .args(["compare", path])
        .assert()
        .failure()
        .stderr(contains("study.toml, line").and(contains("attic")).and(contains("a list of channels")));
    // There is no recording to watch.
    with("[\"100x\"]");
    belfry_command().args(["watch", path, "--once"]).assert().failure().stderr(contains("needs a [[setup]]"));
}

/// A sensor that no column of the runs stands for.
#[test]
fn sensors_that_the_runs_do_not_have_are_told() {
    let folder = tempfile::tempdir().unwrap();
    study(folder.path());
    let file = folder.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replacen("channel = \"200x\"", "channel = \"roof\"", 1)).unwrap();
    let modes = folder.path().join("modes.csv");
    let text = fs::read_to_string(&modes).unwrap();
    fs::write(&modes, text.replace("200x", "roof")).unwrap();
    belfry_command()
        .arg("compare")
        .arg(folder.path())
        .assert()
        .failure()
        .stderr(contains("channel roof: no row of the model has that name").and(contains("100x, ")));
}
