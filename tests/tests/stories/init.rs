//! A user makes a new study: from each template, not over an old one, by hand and from a program.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use assert_cmd::prelude::*;
use belfry_host::study::{ModelSource, STUDY_FILE, Study};
use belfry_tests::belfry_command;
use predicates::prelude::*;

/// `belfry init FOLDER ARGUMENTS`, as a user with backtraces switched on runs it.
fn init(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = belfry_command();
    command.env("RUST_BACKTRACE", "1").arg("init").arg(folder).args(arguments);
    command
}

#[test]
fn each_template_makes_a_study_that_loads() {
    for (template, setup, sensors, parts) in [
        ("canton", "january", 20, Some(37)),
        ("turbine", "january", 8, Some(18)),
        ("frame", "january", 15, Some(5)),
        ("bridge", "january", 21, Some(8)),
        ("blank", "first", 2, None),
    ] {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("new").join("study");
        let next = predicate::str::contains("Next: belfry ").and(predicate::str::contains("belfry identify"));
        init(&folder, &["--template", template]).assert().success().stdout(next).stderr("");
        let study = Study::load(&folder).unwrap();
        assert_eq!(study.setups[0].name, setup);
        assert_eq!(study.setups[0].sensors.len(), sensors);
        assert_eq!(study.model.is_some(), parts.is_some());
        if let Some(model) = study.model {
            let ModelSource::Beam(beam) = model.source else {
                assert_eq!(Some(model.customs.len()), parts, "groups");
                continue;
            };
            let beam = fs::read_to_string(folder.join(beam)).unwrap();
            assert_eq!(Some(beam.lines().count() - 1), parts, "segments below a header");
        }
    }
}

#[test]
fn recordings_say_what_a_study_needs_and_what_they_do_not_say_is_marked() {
    let parent = tempfile::tempdir().unwrap();
    let recordings = belfry_tests::repository().join("host/tests-data");
    let from = |folder: &Path, file: &str| init(folder, &["--from", recordings.join(file).to_str().unwrap()]);
    let whole = parent.path().join("whole");
    from(&whole, "h5py_channels.h5")
        .assert()
        .success()
        .stdout(predicate::str::contains("Complete the lines with TODO"));
    let study = Study::load(&whole).unwrap();
    assert_eq!(study.setups[0].sampling_rate_hz, 50.0);
    let channels: Vec<&str> = study.setups[0].sensors.iter().map(|sensor| sensor.channel.as_str()).collect();
    assert_eq!(channels, ["run 1/top-x", "run 1/top-y"]);
    // Numbers alone say neither.
    let bare = parent.path().join("bare");
    from(&bare, "same.npy").assert().success();
    let needed = predicate::str::contains("study.toml").and(predicate::str::contains("sampling_rate_hz"));
    belfry_command().arg("identify").arg(&bare).assert().code(1).stderr(needed);
    let unknown = parent.path().join("unknown");
    from(&unknown, "README.md").assert().code(1).stderr(predicate::str::contains("README.md: the ending says nothing"));
    assert!(!unknown.exists());
}

#[test]
fn a_study_that_is_there_is_named_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    for mine in [STUDY_FILE, "beam.csv"] {
        let file = folder.path().join(mine);
        fs::write(&file, "mine").unwrap();
        for arguments in [&["--template", "canton"][..], &["--template", "canton", "--json"]] {
            let named = predicate::str::starts_with(format!("error: {} exists already", file.display()))
                .and(predicate::str::contains("name another folder"))
                .and(predicate::str::contains("backtrace").not());
            let assert = init(folder.path(), arguments).assert().code(1).stderr(named);
            let said = &assert.get_output().stdout;
            if arguments.contains(&"--json") {
                let object: serde_json::Value = serde_json::from_slice(said).expect("one JSON object");
                assert!(object["error"]["message"].as_str().unwrap().contains("exists already"), "{object}");
                assert_eq!(object["error"]["causes"], serde_json::json!([]));
            } else {
                assert!(said.is_empty());
            }
        }
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing was written next to it");
        fs::remove_file(file).unwrap();
    }
}

#[test]
fn a_folder_that_cannot_be_made_is_told_with_its_cause() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("file");
    fs::write(&file, "").unwrap();
    let told = predicate::str::contains("error: cannot make the folder")
        .and(predicate::str::contains("\n  caused by: "))
        .and(predicate::str::contains("backtrace").not());
    init(&file.join("study"), &[]).assert().code(1).stdout("").stderr(told);
}

#[test]
fn json_is_one_object_with_the_study_its_files_and_what_comes_next() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("canton");
    let output = init(&folder, &["--template", "canton", "--json"]).output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty());
    let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["study"], folder.display().to_string());
    assert_eq!(object["files"], serde_json::json!(["beam.csv", "study.toml"]));
    for file in object["files"].as_array().unwrap() {
        assert!(folder.join(file.as_str().unwrap()).is_file());
    }
    assert!(object["next"].as_str().unwrap().contains("belfry identify"));
}

#[test]
fn usage_is_told_with_status_2_and_help_with_0() {
    let folder = tempfile::tempdir().unwrap();
    let templates = predicate::str::contains("canton").and(predicate::str::contains("blank"));
    init(folder.path(), &["--template", "castle"]).assert().code(2).stdout("").stderr(templates);
    belfry_command().assert().code(2).stdout("");
    belfry_command().args(["init", "--json"]).assert().code(2).stdout("");
    belfry_command().arg("--help").assert().code(0).stdout(predicate::str::contains("Examples:"));
    belfry_command().args(["init", "--help"]).assert().code(0).stdout(predicate::str::contains("Examples:"));
    let version = format!("belfry {}\n", env!("CARGO_PKG_VERSION"));
    belfry_command().arg("--version").assert().code(0).stdout(version);
}

/// What `belfry ... | true` does: the reader is gone before the first line.
#[test]
fn a_reader_that_goes_away_is_no_fault() {
    for arguments in [&[][..], &["--json"]] {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("study");
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = init(&folder, arguments);
        let mut belfry = command.stdout(writer).stderr(Stdio::piped()).spawn().unwrap();
        drop(command);
        let mut said = String::new();
        belfry.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert!(belfry.wait().unwrap().success(), "{said}");
        assert_eq!(said, "");
        assert!(Study::load(&folder).is_ok());
    }
}
