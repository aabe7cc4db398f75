//! What was collected is analysed in part, damaged, checked, repaired and taken elsewhere, by the command.

use std::fs;
use std::path::Path;
use std::process::Output;

use belfry_tests::belfry_command;
use serde_json::Value;

use super::bench::Bench;
use super::mast::{archive, folder_in_memory};
use crate::said::sound;

/// Runs `belfry` with these words and paths.
fn belfry(words: &[&str]) -> Output {
    belfry_command().args(words).output().unwrap()
}

/// What it says when it succeeds, or fails, as text.
fn said(output: &Output, succeeds: bool) -> String {
    let text = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
    assert_eq!(output.status.code(), Some(i32::from(!succeeds)), "{text}");
    text
}

/// What it prints for programs, whether or not it succeeds.
fn object(words: &[&str]) -> Value {
    sound(serde_json::from_slice(&belfry(&[words, &["--json"]].concat()).stdout).unwrap())
}

/// What `belfry identify --json` prints, and its warnings.
fn modes(study: &str, range: &[&str]) -> (Value, String) {
    let output = belfry(&[&["identify", study, "--json"], range].concat());
    let warnings = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{warnings}");
    (sound(serde_json::from_slice(&output.stdout).unwrap()), warnings)
}

/// Changes the first channel of a window of node 3.
fn change(folder: &Path, number: u32, change: impl FnOnce(Vec<u8>) -> Vec<u8>) {
    let archive = archive(folder);
    let query =
        "SELECT window, lines FROM channel JOIN window ON window = id WHERE node = 3 AND number = ?1 AND channel = 0";
    let (window, lines): (i64, Vec<u8>) =
        archive.query_row(query, [number], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    let update = "UPDATE channel SET lines = ?2 WHERE window = ?1 AND channel = 0";
    archive.execute(update, (window, change(lines))).unwrap();
}

#[test]
fn an_archive_is_analysed_in_part_checked_repaired_and_taken_elsewhere() {
    let bench = Bench::new();
    bench.collect_for(60).unwrap();
    let folder = bench.folder();
    let study = folder.to_str().unwrap();
    said(&belfry(&["archive", "check", study]), true);
    let (whole, warnings) = modes(study, &[]);
    assert!(!warnings.contains("archive"), "{warnings}");
    let (part, _) = modes(study, &["--last", "30s"]);
    // Windows begin every 256 ms; the last half minute has 117 of them, from the first whose middle is in it.
    let averages = |modes: &Value| modes["averages"].as_u64().unwrap();
    assert!(
        (110..=118).contains(&averages(&part)) && averages(&whole) > 200,
        "{} {}",
        averages(&part),
        averages(&whole)
    );
    let of = |modes: &Value, what: &str| modes["collected"][0][what].as_str().unwrap().to_owned();
    assert_eq!(of(&part, "to"), of(&whole, "to"));
    assert!(of(&part, "from") > of(&whole, "from"), "{part}");
    let said_of_none = said(&belfry(&["identify", study, "--to", "2026-11-02"]), false);
    assert!(said_of_none.contains("has no window up to 2026-11-02T00:00:00Z"), "{said_of_none}");

    // One bit of a window, and all of another.
    change(folder, 20, |mut lines| {
        lines[7] ^= 4;
        lines
    });
    change(folder, 30, |lines| vec![0; lines.len()]);
    assert_eq!(object(&["archive", "check", study])["schema"], "archive-check-1");
    let checked = said(&belfry(&["archive", "check", study]), false);
    for part in ["window 20 of node 3", "window 30 of node 3", "belfry archive repair"] {
        assert!(checked.contains(part), "no {part:?} in: {checked}");
    }
    let (damaged, warnings) = modes(study, &[]);
    assert!(warnings.contains("damaged in the archive, and left out: window 20 of node 3"), "{warnings}");
    assert_eq!(averages(&damaged), averages(&whole) - 2);

    let repaired = said(&belfry(&["archive", "repair", study]), true);
    for part in ["not saved: window 30 of node 3", "1 row of which one bit was flipped is mended", "archive.damaged-"] {
        assert!(repaired.contains(part), "no {part:?} in: {repaired}");
    }
    said(&belfry(&["archive", "check", study]), true);
    let (after, warnings) = modes(study, &[]);
    assert!(!warnings.contains("archive"), "{warnings}");
    assert_eq!(averages(&after), averages(&whole) - 1);

    // The same for programs.
    change(folder, 31, |lines| vec![0; lines.len()]);
    assert_eq!(object(&["archive", "repair", study])["lost"].as_array().map(Vec::len), Some(1));
    let table = folder.join("windows.csv");
    let exported = object(&["archive", "export", study, "--output", table.to_str().unwrap()]);
    assert!(exported["windows"].as_u64() > Some(200), "{exported}");

    let elsewhere = folder_in_memory();
    fs::copy(folder.join("study.toml"), elsewhere.path().join("study.toml")).unwrap();
    let output = elsewhere.path().join("archive.sqlite");
    let export = ["archive", "export", study, "--last", "30s", "--output", output.to_str().unwrap()];
    said(&belfry(&export), true);
    let written = fs::read(&output).unwrap();
    let refused = said(&belfry(&export), false);
    assert!(refused.contains("archive.sqlite is there already"), "{refused}");
    assert_eq!(fs::read(&output).unwrap(), written);
    let (there, _) = modes(elsewhere.path().to_str().unwrap(), &[]);
    assert_eq!((averages(&there), &there["modes"]), (averages(&part), &part["modes"]));
}

#[test]
fn a_study_of_recordings_takes_no_range_of_time() {
    let folder = folder_in_memory();
    let study = folder.path().join("canton");
    let study = study.to_str().unwrap();
    said(&belfry(&["init", study, "--template", "canton"]), true);
    for command in ["identify", "covalidate", "serve"] {
        let refused = said(&belfry(&[command, study, "--last", "7d"]), false);
        assert!(refused.contains("this study has no setup with `live = true`"), "{command}: {refused}");
    }
    let absent = said(&belfry(&["archive", "check", study]), false);
    assert!(absent.contains("no node has been collected from"), "{absent}");
}
