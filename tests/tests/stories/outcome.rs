//! A command cannot do what it was asked to: it says so before it computes, leaves nothing half-written, and a program learns why.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;

/// A study of the Canton Tower in `parent`, without a recording.
fn study(parent: &Path) -> PathBuf {
    let folder = parent.join("tower");
    belfry_command().arg("init").arg(&folder).args(["--template", "canton"]).assert().success();
    folder
}

/// What lies in `folder`, but for the lock that a command leaves to the next one.
fn files(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name != ".belfry-lock").collect();
    names.sort();
    names
}

#[test]
fn results_that_cannot_be_written_are_noticed_before_anything_is_computed() {
    let parent = tempfile::tempdir().unwrap();
    let folder = study(parent.path());
    belfry_command().arg("simulate").arg(&folder).args(["--hours", "0.5", "--adopt"]).assert().success();
    // Also the administrator, who may write into any folder, cannot write into a file.
    fs::write(folder.join("results"), "in the way").unwrap();
    // The recording is not even opened: it is no longer there.
    let recording = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
    for file in recording.filter(|path| path.extension().is_some_and(|extension| extension == "npy")) {
        fs::remove_file(file).unwrap();
    }
    for command in ["identify", "compare", "update", "covalidate", "diagnose"] {
        let assert = belfry_command().arg(command).arg(&folder).assert().code(1);
        if command == "identify" {
            assert.stderr(contains("cannot write into").and(contains("results")));
        }
    }
}

#[test]
fn no_modes_is_an_error_with_a_reason_and_nothing_comes_next() {
    let parent = tempfile::tempdir().unwrap();
    let folder = study(parent.path());
    // Long enough for lines that part the modes, so that each is dropped by its own frequency.
    belfry_command().arg("simulate").arg(&folder).args(["--hours", "2", "--adopt"]).assert().success();
    let file = folder.join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    // Every mode that there is, dropped.
    let found = belfry_command().arg("identify").arg(&folder).args(["--direct", "--json"]).assert().success();
    let found: Value = serde_json::from_slice(&found.get_output().stdout).unwrap();
    let dropped: Vec<String> =
        found["modes"].as_array().unwrap().iter().map(|mode| mode["frequency_hz"].to_string()).collect();
    let analysis = format!("[analysis]\ndrop_modes_hz = [{}]", dropped.join(", "));
    fs::write(&file, text.replacen("[analysis]", &analysis, 1)).unwrap();
    let assert = belfry_command().arg("identify").arg(&folder).arg("--direct").assert().code(1);
    let output = assert.get_output();
    let (said, error) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(error.contains("no modes were found from") && error.contains("drop_modes_hz"), "{error}");
    assert!(!said.contains("Next:"), "{said}");
    assert!(folder.join("results/singular_values.svg").is_file());
}

#[test]
fn a_program_learns_why_from_an_object() {
    let parent = tempfile::tempdir().unwrap();
    let folder = study(parent.path());
    for arguments in
        [&["identify"][..], &["compare"], &["update"], &["covalidate"], &["diagnose"], &["history"], &["add"]]
    {
        let mut command = belfry_command();
        command.args(arguments).arg(&folder).args((arguments == ["add"]).then_some("base-rotation")).arg("--json");
        let assert = command.assert().code(1);
        let object: Value = serde_json::from_slice(&assert.get_output().stdout).expect("one JSON object");
        let (message, causes) = (object["error"]["message"].as_str(), object["error"]["causes"].as_array());
        assert!(message.is_some_and(|message| !message.is_empty()) && causes.is_some(), "{arguments:?}: {object}");
    }
}

#[test]
fn the_path_of_study_toml_means_its_folder() {
    let parent = tempfile::tempdir().unwrap();
    let folder = study(parent.path());
    let file = folder.join("study.toml");
    belfry_command().arg("simulate").arg(&file).args(["--hours", "0.5", "--adopt"]).assert().success();
    belfry_command().arg("identify").arg(&file).arg("--direct").assert().success();
    assert!(folder.join("results/modes.json").is_file());
    // Also where it is the file of the folder one is in.
    let here = belfry_command().current_dir(&folder).args(["compare", "study.toml"]).assert().success();
    here.stdout(contains("Next: belfry diagnose ."));
    assert!(folder.join("results/comparison.json").is_file());
}

#[cfg(unix)]
#[test]
fn an_interrupted_simulation_leaves_nothing_behind() {
    let parent = tempfile::tempdir().unwrap();
    let folder = study(parent.path());
    let before = files(&folder);
    for signal in ["INT", "TERM"] {
        let mut simulate = belfry_command();
        let mut child = simulate.arg("simulate").arg(&folder).args(["--hours", "2000"]).spawn().unwrap();
        let start = Instant::now();
        while files(&folder) == before {
            assert!(start.elapsed() < Duration::from_secs(120), "no recording was begun");
            std::thread::sleep(Duration::from_millis(20));
        }
        // Only the process that was started here.
        let kill = std::process::Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status();
        assert!(kill.unwrap().success());
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        assert_eq!(files(&folder), before, "{signal}");
    }
}
