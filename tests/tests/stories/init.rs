//! A user makes a new study: from each template, not over an old one, by hand and from a program.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};

use assert_cmd::prelude::*;
use belfry_host::study::{ModelSource, STUDY_FILE, Study};
use belfry_tests::belfry_command;
use predicates::prelude::*;

use crate::said::{json, sound};

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
    from(&whole, "h5py_channels.h5").assert().success().stdout(
        predicate::str::contains("Complete the lines with TODO").and(predicate::str::contains("Next: belfry look")),
    );
    let study = Study::load(&whole).unwrap();
    assert_eq!(study.setups[0].sampling_rate_hz, 50.0);
    let channels: Vec<&str> = study.setups[0].sensors.iter().map(|sensor| sensor.channel.as_str()).collect();
    assert_eq!(channels, ["run 1/top-x", "run 1/top-y"]);
    // Numbers alone say neither.
    let bare = parent.path().join("bare");
    let first = predicate::str::contains("study.toml first: the recordings do not say sampling_rate_hz, unit");
    from(&bare, "same.npy").assert().success().stdout(first);
    let needed = predicate::str::contains("study.toml").and(predicate::str::contains("sampling_rate_hz"));
    belfry_command().arg("identify").arg(&bare).assert().code(1).stderr(needed);
    let unknown = parent.path().join("unknown");
    from(&unknown, "README.md").assert().code(1).stderr(
        predicate::str::contains("README.md: the ending says nothing").and(predicate::str::contains("rename the file")),
    );
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
    assert_eq!(object["warnings"], serde_json::json!([]));
}

/// `belfry init FOLDER --from FILES --json`: the object and what is said on standard error.
fn from_json(folder: &Path, files: &[&Path]) -> (serde_json::Value, String) {
    let files: Vec<&str> = files.iter().map(|file| file.to_str().unwrap()).collect();
    let output = init(folder, &[&["--json", "--from"], files.as_slice()].concat()).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    (sound(serde_json::from_slice(&output.stdout).unwrap()), said)
}

#[test]
fn what_the_next_command_cannot_read_is_told_at_once() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("a.csv");
    let table = |last: &str| {
        let row = |row: u32| {
            let (note, y) =
                (["", "calm"][row as usize % 2], if row == 299 { last.to_owned() } else { row.to_string() });
            format!("{:.2},{row},{note},{y}\n", 0.02 * f64::from(row))
        };
        format!("time,x,note,y\ns,g,-,g\n{}", (0..300).map(row).collect::<String>())
    };
    fs::write(&file, table("bad")).unwrap();
    let folder = parent.path().join("mast");
    let (object, said) = from_json(&folder, &[&file]);
    let warnings: Vec<&str> = object["warnings"].as_array().unwrap().iter().map(|one| one.as_str().unwrap()).collect();
    assert!(warnings[0].contains("a.csv: left out: channel `note` holds no numbers"), "{warnings:?}");
    for part in ["setup-1 cannot be read as it stands", "a.csv, line 302", "channel `y`", "`bad`", "mend the file"] {
        assert!(warnings[1].contains(part), "{part} is not in {warnings:?}");
    }
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(warnings.iter().all(|told| words(&said).contains(&words(told))), "{said}");
    // As the next command says it.
    let fails = predicate::str::contains("a.csv, line 302").and(predicate::str::contains("`bad`"));
    belfry_command().arg("look").arg(&folder).assert().code(1).stderr(fails);
    fs::write(&file, table("299")).unwrap();
    belfry_command().arg("look").arg(&folder).assert().success();
    let sound = parent.path().join("sound");
    assert_eq!(from_json(&sound, &[&file]).0["warnings"].as_array().map(Vec::len), Some(1));
}

#[test]
fn a_table_without_a_header_has_numbered_columns_and_loses_no_row() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("a.csv");
    fs::write(&file, "0.5,1.25\n-0.5,2.5\n0.75,-3.5\n").unwrap();
    let folder = parent.path().join("mast");
    assert_eq!(from_json(&folder, &[&file]).0["warnings"], serde_json::json!([]));
    let text = fs::read_to_string(folder.join(STUDY_FILE)).unwrap();
    assert!(text.contains("# 3 rows") && text.contains("channel = \"2\""), "{text}");
}

#[test]
fn loggers_that_recorded_at_the_same_time_become_one_setup() {
    let parent = tempfile::tempdir().unwrap();
    let recordings = parent.path().join("recordings");
    fs::create_dir(&recordings).unwrap();
    let table = |name: &str, from_s: f64| {
        let rows = (0..200).map(|row| format!("{:.2},{row}\n", from_s + 0.02 * f64::from(row)));
        format!("time,{name}\ns,g\n{}", rows.collect::<String>())
    };
    fs::write(recordings.join("low.csv"), table("low", 1_772_366_400.0)).unwrap();
    fs::write(recordings.join("top.csv"), table("top", 1_772_366_401.0)).unwrap();
    // A folder, and a pattern that no shell has seen.
    for (name, files) in [("folder", recordings.clone()), ("pattern", recordings.join("*.csv"))] {
        let folder = parent.path().join(name);
        assert_eq!(from_json(&folder, &[&files]).0["warnings"], serde_json::json!([]));
        let study = Study::load(&folder).unwrap();
        assert_eq!(study.setups.len(), 1);
        let report = json(&["look", folder.to_str().unwrap()]);
        // The second begins 50 rows after the first.
        assert_eq!(
            (&report["setups"][0]["rows"], &report["setups"][0]["channels"][1]["missing"]),
            (&250.into(), &50.into())
        );
    }
}

#[test]
fn miniseed_by_another_name_is_read_and_what_is_none_is_not() {
    let parent = tempfile::tempdir().unwrap();
    let recordings = belfry_tests::repository().join("host/tests-data");
    for ending in ["msd", "SEED"] {
        let file = parent.path().join(format!("a.{ending}"));
        fs::copy(recordings.join("obspy_steim2.mseed"), &file).unwrap();
        let folder = parent.path().join(ending);
        assert_eq!(from_json(&folder, &[&file]).0["warnings"], serde_json::json!([]));
        fs::write(&file, "000001V 010009").unwrap();
        let none = parent.path().join("none");
        let told = predicate::str::contains("the ending says nothing").and(predicate::str::contains(".miniseed"));
        init(&none, &["--from", file.to_str().unwrap()]).assert().code(1).stderr(told);
        assert!(!none.exists());
    }
}

#[test]
fn a_program_hears_of_wrong_usage_as_of_any_failure() {
    for (words, part) in [
        (&["identify", "--json"][..], "<STUDY>"),
        (&["look", "a.npy", "--rate", "x", "--json"], "--rate"),
        (&["--json", "castle"], "castle"),
        (&["init", "--json"], "<DIR>"),
    ] {
        let output = belfry_command().args(words).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{words:?}");
        let object = sound(serde_json::from_slice(&output.stdout).expect("one JSON object"));
        assert_eq!(object["schema"], "error-1");
        assert!(object["error"]["message"].as_str().unwrap().contains(part), "{object}");
        assert_eq!(object["error"]["causes"], serde_json::json!([]));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.starts_with("error: ") && said.contains("--help"), "{said}");
    }
    belfry_command().args(["look", "--help", "--json"]).assert().code(0).stdout(predicate::str::contains("Examples:"));
}

#[test]
fn usage_is_told_with_status_2_and_help_with_0() {
    let folder = tempfile::tempdir().unwrap();
    let templates = predicate::str::contains("canton").and(predicate::str::contains("blank"));
    init(folder.path(), &["--template", "castle"]).assert().code(2).stdout("").stderr(templates);
    belfry_command().assert().code(2).stdout("");
    belfry_command().arg("init").assert().code(2).stdout("");
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
