//! A user looks at what was recorded before anything is identified: every channel's gaps and levels, and which channels are suspect.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::{belfry_command, repository};
use predicates::prelude::*;
use serde_json::Value;

use crate::bad_input::{RATE_HZ, recording};
use crate::said::json;

/// `belfry look --json` with these arguments.
fn look(arguments: &[&str]) -> Value {
    json(&[&["look"], arguments].concat())
}

fn suspects(report: &Value) -> Vec<(String, Vec<String>)> {
    let suspects = report["suspects"].as_array().unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    suspects
        .iter()
        .map(|one| (text(&one["kind"]), one["channels"].as_array().unwrap().iter().map(text).collect()))
        .collect()
}

const NAMES: [&str; 6] = ["north", "east", "south", "west", "dead", "again"];
/// Where the second channel is cut off.
const LIMIT: f64 = 4e-3;

/// A study whose recording lacks two seconds, with a channel that is cut off, one that is dead and one that is recorded twice.
fn faulty(folder: &Path) {
    let mut text = format!("time_s,{}\n", NAMES.join(","));
    for (row, [north, east, south, west]) in recording().into_iter().enumerate() {
        if (1000..1000 + 2 * RATE_HZ).contains(&row) {
            continue;
        }
        let time_s = row as f64 / RATE_HZ as f64;
        let east = east.clamp(-LIMIT, LIMIT);
        writeln!(text, "{time_s:.2},{north:.6e},{east:.6e},{south:.6e},{west:.6e},0.5,{north:.6e}").unwrap();
    }
    fs::write(folder.join("a.csv"), text).unwrap();
    let mut study = format!(
        "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"first\"\nfiles = [\"a.csv\"]\nsampling_rate_hz = {RATE_HZ}.0\nunit = \"m/s2\"\n"
    );
    for (index, name) in NAMES.iter().enumerate() {
        // Four channels a node.
        write!(study, "[[setup.sensor]]\nchannel = \"{name}\"\nnode = {}\n", 1 + index / 4).unwrap();
    }
    fs::write(folder.join("study.toml"), study).unwrap();
}

#[test]
fn gaps_levels_and_faults_are_seen_channel_by_channel() {
    let folder = tempfile::tempdir().unwrap();
    faulty(folder.path());
    let report = look(&[folder.path().to_str().unwrap()]);
    let setup = &report["setups"][0];
    let rows = recording().len();
    assert_eq!((setup["rows"].as_u64(), setup["filled_rows"].as_u64()), (Some(rows as u64), Some(2 * RATE_HZ as u64)));
    assert_eq!(setup["duration_s"].as_f64(), Some((rows / RATE_HZ) as f64));
    let found = suspects(&report);
    for (kind, channels) in [("dead", &["dead"][..]), ("clipped", &["east"]), ("copy", &["again", "north"])] {
        assert!(found.iter().any(|(one, of)| one == kind && of == channels), "{kind}: {found:?}");
    }
    assert!(!found.iter().any(|(_, of)| of == &["south"] || of == &["west"]), "{found:?}");
    let channel = |name: &str| setup["channels"].as_array().unwrap().iter().find(|one| one["channel"] == name).unwrap();
    let (north, east) = (channel("north"), channel("east"));
    // 40 of 24 000 rows.
    let missing = 100.0 * (2 * RATE_HZ) as f64 / rows as f64;
    assert!((north["missing_percent"].as_f64().unwrap() - missing).abs() < 1e-9);
    assert_eq!(
        (north["gaps"].as_u64(), &north["first_gaps"][0]["start_s"], &north["first_gaps"][0]["duration_s"]),
        (Some(1), &50.0.into(), &2.0.into())
    );
    assert_eq!((east["largest"].as_f64(), east["smallest"].as_f64()), (Some(LIMIT), Some(-LIMIT)));
    assert_eq!(east["clipped"]["at"].as_f64().map(f64::abs), Some(LIMIT));
    // The root mean square of the rows that are there, by its definition.
    let left: Vec<f64> = recording()
        .iter()
        .enumerate()
        .filter(|(row, _)| !(1000..1000 + 2 * RATE_HZ).contains(row))
        .map(|(_, row)| row[0])
        .collect();
    let mean = left.iter().sum::<f64>() / left.len() as f64;
    let rms = (left.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / left.len() as f64).sqrt();
    // Six digits in the file.
    assert!((north["rms"].as_f64().unwrap() / rms - 1.0).abs() < 1e-6);
    assert_eq!(channel("dead")["mean"].as_f64(), Some(0.5));
    let picture = fs::read_to_string(folder.path().join("results/look.svg")).unwrap();
    assert!(
        NAMES.iter().all(|name| picture.contains(name)) && picture.contains("copy of north"),
        "every channel is drawn"
    );
    let stored: Value = serde_json::from_slice(&fs::read(folder.path().join("results/look.json")).unwrap()).unwrap();
    assert_eq!((&stored["setups"], &stored["suspects"]), (&report["setups"], &report["suspects"]));
    let told = predicate::str::contains("copy of north").and(predicate::str::contains("look.svg"));
    belfry_command().arg("look").arg(folder.path()).env("COLUMNS", "150").assert().success().stdout(told);
}

/// The true tower has two cables in each other's sockets; the study does not know it.
#[test]
fn exchanged_and_reversed_channels_are_suspected_by_the_lowest_shapes() {
    let parent = tempfile::tempdir().unwrap();
    let study = parent.path().join("canton");
    belfry_command().arg("init").arg(&study).args(["--template", "canton"]).assert().success();
    let sound = ["--hours", "1", "--seed", "5", "--adopt", "--force"];
    let wrong = ["--effect", "sensor-swap@14+17", "--effect", "sensor-polarity@10"];
    for (effects, expected) in [(&[][..], 0), (&wrong, 2)] {
        belfry_command().arg("simulate").arg(&study).args(effects).args(sound).assert().success();
        let report = look(&[study.to_str().unwrap()]);
        let found = suspects(&report);
        assert!(report["shapes"]["modes"].as_u64() > Some(5) && report["shapes"]["obstacle"].is_null(), "{report}");
        assert_eq!(found.len(), expected, "{found:?}");
        if expected > 0 {
            assert!(found.contains(&("exchanged".to_owned(), vec!["14".to_owned(), "17".to_owned()])), "{found:?}");
            assert!(found.contains(&("reversed".to_owned(), vec!["10".to_owned()])), "{found:?}");
        }
    }
}

#[test]
fn recordings_alone_are_looked_at_without_a_study() {
    let data = repository().join("host/tests-data");
    let file = |name: &str| data.join(name).to_str().unwrap().to_owned();
    let report = look(&[&file("obspy_part1.mseed"), &file("obspy_part2.mseed")]);
    let setup = &report["setups"][0];
    assert!(report["structure"].is_null());
    assert_eq!((setup["rows"].as_u64(), setup["sampling_rate_hz"].as_f64()), (Some(300), Some(50.0)));
    assert_eq!(setup["start_utc"], "2026-03-01T12:00:00.000Z");
    assert_eq!(setup["end_utc"], "2026-03-01T12:00:06.000Z");
    assert!(report["shapes"]["obstacle"].as_str().is_some(), "six seconds show no mode");
    // A file of counts has no unit; one that says its unit keeps it.
    assert_eq!(setup["channels"][0]["unit"], "as recorded");
    let tdms = look(&[&file("nptdms.tdms"), "--rate", "50"]);
    assert_eq!(tdms["setups"][0]["channels"][0]["unit"], "m/s²");
    // As npTDMS has written it.
    assert_eq!(tdms["setups"][0]["start_utc"], "2026-03-01T12:00:00.250Z");
    let without = predicate::str::contains("same.npy does not say its sampling rate; give it with --rate");
    belfry_command().args(["look", &file("same.npy")]).assert().code(1).stderr(without);
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("a.svg");
    let report = look(&[&file("same.npy"), "--rate", "50", "--picture", picture.to_str().unwrap()]);
    assert_eq!(report["setups"][0]["duration_s"].as_f64(), Some(6.0));
    assert!(fs::read_to_string(picture).unwrap().starts_with("<svg"));
    belfry_command().args(["look", &file("same.npy"), "--rate", "0"]).assert().code(2);
    // A pattern that no shell has seen, as `files` of a setup has it.
    assert_eq!(look(&[&file("obspy_part*.mseed")])["setups"][0]["rows"], 300);
    belfry_command().args(["look", "/nowhere/at/all.csv"]).assert().code(1).stderr(predicate::str::contains("all.csv"));
}
