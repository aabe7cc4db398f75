//! Two programs on one study at the same time: each change of study.toml stays, and results are of one of them.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread;
use std::time::Duration;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use serde_json::Value;

fn started(study: &str, effect: &str) -> Child {
    let mut command = belfry_command();
    command.args(["add", study, effect]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("belfry starts")
}

/// A study whose model lacks what its recording has.
fn canton(folder: &Path) -> String {
    let study = folder.join("canton").to_str().unwrap().to_owned();
    for words in [
        &["init", &study, "--template", "canton"][..],
        &["simulate", &study, "--effect", "base-rotation=1.2e-14", "--hours", "1", "--seed", "5", "--adopt"],
    ] {
        belfry_command().args(words).assert().success();
    }
    study
}

#[test]
fn commands_that_write_results_wait_for_one_another() {
    let folder = tempfile::tempdir().unwrap();
    let study = canton(folder.path());
    let lock = File::options().write(true).open(Path::new(&study).join(".belfry-lock")).unwrap();
    fs::remove_file(Path::new(&study).join("truth.json")).unwrap();
    for (words, written) in [
        (&["identify", "--direct"][..], "modes.json"),
        (&["compare"], "comparison.json"),
        (&["update"], "update.json"),
        (&["covalidate", "--direct"], "covalidation.json"),
        (&["diagnose", "--without", "added-mass"], "diagnosis.json"),
        (&["profile"], "profile.json"),
        (&["plan", "--effect", "base-rotation=7e-15", "--hours", "1"], "plan.json"),
        (&["report"], "report.html"),
        (&["export", "--of", "modes"], "export/modes.csv"),
        (&["add", "base-rotation"], "history.jsonl"),
        (&["simulate", "--hours", "0.1", "--force"], "../truth.json"),
    ] {
        lock.lock().unwrap();
        let mut command = belfry_command();
        command.arg(words[0]).arg(&study).args(&words[1..]).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        stderr.read_line(&mut said).unwrap();
        assert!(said.contains("another command is writing into this study"), "{words:?}: {said}");
        let written = Path::new(&study).join("results").join(written);
        assert!(!written.exists(), "{words:?}");
        lock.unlock().unwrap();
        if words[0] == "identify" {
            // It has the lock as long as it writes, and not only while it asks for it.
            while lock.try_lock().is_ok() {
                lock.unlock().unwrap();
                assert!(child.try_wait().unwrap().is_none(), "it has ended, and never had the lock: {said}");
                thread::sleep(Duration::from_millis(1));
            }
            lock.lock().unwrap();
            assert!(written.exists(), "it has given the lock back before it has written");
            lock.unlock().unwrap();
        }
        stderr.read_to_string(&mut said).unwrap();
        assert!(child.wait().unwrap().success() && written.exists(), "{words:?}: {said}");
    }
}

#[test]
fn two_commands_that_change_a_study_at_once_both_do() {
    let folder = tempfile::tempdir().unwrap();
    let study = canton(folder.path());
    belfry_command().args(["identify", &study, "--direct"]).assert().success();
    let both = ["base-rotation=1e-14", "added-mass@300m=1e6"].map(|effect| started(&study, effect));
    let said = both.map(|child| {
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        said
    });
    assert!(said.iter().any(|said| said.contains("another command is writing into this study")), "{said:?}");
    let text = fs::read_to_string(Path::new(&study).join("study.toml")).unwrap();
    assert!(text.contains("base-rotation") && text.contains("added-mass"), "{text}");
    let history = fs::read_to_string(Path::new(&study).join("results/history.jsonl")).unwrap();
    let last: Value = serde_json::from_str(history.lines().last().unwrap()).unwrap();
    assert_eq!(last["effects"].as_array().unwrap().len(), 2);

    // A step of which only half came to disk is left out and told, and the next one follows the last whole one.
    let file = Path::new(&study).join("results/history.jsonl");
    let half = &history[..history.len() / 3];
    fs::write(&file, format!("{history}{}", &half[..half.find("\"action\"").unwrap() + 20])).unwrap();
    let output = belfry_command().args(["history", &study]).assert().success().get_output().clone();
    assert!(String::from_utf8_lossy(&output.stderr).contains("ends in half a line"), "{output:?}");
    belfry_command().args(["remove", &study, "base-rotation"]).assert().success();
    let after = fs::read_to_string(&file).unwrap();
    assert!(after.starts_with(&history) && after.lines().count() == history.lines().count() + 1, "{after}");

    // So is a line that was broken afterwards; it stays in the file.
    let broken: Vec<String> = after
        .lines()
        .enumerate()
        .map(|(at, line)| if at == 1 { line.replacen('"', "'", 1) } else { line.to_owned() })
        .collect();
    fs::write(&file, broken.join("\n") + "\n").unwrap();
    let output = belfry_command().args(["history", &study, "--json"]).assert().success().get_output().clone();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("history.jsonl, line 2 is no step and is left out"), "{said}");
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(told["steps"].as_array().unwrap().len(), after.lines().count() - 1);
    belfry_command().args(["remove", &study, "added-mass"]).assert().success();
    let last = fs::read_to_string(&file).unwrap();
    assert!(last.starts_with(&broken.join("\n")) && last.lines().count() == after.lines().count() + 1, "{last}");

    // A kill between a line and its end loses nothing, and the next step begins a line of its own.
    fs::write(&file, last.trim_end()).unwrap();
    belfry_command().args(["add", &study, "base-rotation=1e-14"]).assert().success();
    let after = fs::read_to_string(&file).unwrap();
    assert!(after.starts_with(&last) && after.lines().count() > last.lines().count(), "{after}");

    // Where it is lost what results were computed from, the page says so.
    fs::write(Path::new(&study).join("results/inputs.json"), "{").unwrap();
    belfry_command().args(["report", &study]).assert().success();
    let page = fs::read_to_string(Path::new(&study).join("results/report.html")).unwrap();
    assert!(page.contains("nothing says whether results are of the model as it is now"), "no word of it");
}
