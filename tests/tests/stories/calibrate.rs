//! A user lays a sensor on its six faces, with a logger that writes a table, and wants gains and offsets in the study.

use std::fmt::Write;
use std::fs;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;

use crate::said;

const STUDY: &str = "# of the tower
[structure]
name = \"Tower\"

[[setup]]
name = \"now\"
files = [\"now.csv\"]
sampling_rate_hz = 10.0
unit = \"m/s2\"

[[setup.sensor]]
channel = \"x\"
node = 1
gain = 1.5 # a guess

[[setup.sensor]]
channel = \"z\"
node = 1

[analysis]
band_hz = [0.2, 2.0]
";
const GRAVITY_M_S2: f64 = 9.812;
const GAINS: [f64; 3] = [1.03, 0.97, 1.005];
const OFFSETS: [f64; 3] = [0.3, -0.2, 0.05];

/// A tumble at 10 Hz: three seconds in the hand and ten on each face, which are level.
fn tumble(faces: usize) -> String {
    let mut text = "t,x,y,z\n".to_owned();
    for row in 0..faces * 130 {
        let (face, step) = (row / 130, row % 130);
        let swing = (row as f64 * 0.9).sin();
        let along: [f64; 3] = if step < 30 {
            [9.0 * swing, 5.0, 8.0 * (1.0 - swing)]
        } else {
            let sign = if face % 2 == 0 { 1.0 } else { -1.0 };
            std::array::from_fn(|axis| if axis == face / 2 { sign * GRAVITY_M_S2 } else { 0.0 })
        };
        let noise = 1e-3 * (row as f64 * 7.7).sin();
        let read = |axis: usize| along[axis] / GAINS[axis] + OFFSETS[axis] + noise;
        writeln!(text, "{},{},{},{}", row as f64 * 0.1, read(0), read(1), read(2)).unwrap();
    }
    text
}

#[test]
fn a_recorded_tumble_puts_gains_and_offsets_into_the_study_and_they_are_applied_once() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    let study = folder.path().join("study.toml");
    let file = folder.path().join("tumble.csv");
    fs::write(&study, STUDY).unwrap();
    fs::write(&file, tumble(6)).unwrap();
    let recording = file.to_str().unwrap();
    let arguments = ["calibrate", place, "--recording", recording, "--gravity", "9.812", "--level", "0.1"];
    // Which three of the columns are meant nobody can know.
    belfry_command().args(arguments).assert().failure().stderr(contains("--channels"));
    let with_channels = [&arguments[..], &["--channels", "x,y,z"]].concat();
    let tried = said::json(&[&with_channels[..], &["--dry-run"]].concat());
    assert_eq!((fs::read_to_string(&study).unwrap().as_str(), tried["written"].as_array().unwrap().len()), (STUDY, 0));
    let found = said::json(&with_channels);
    for (axis, (gain, offset)) in found["axes"].as_array().unwrap().iter().zip(GAINS.iter().zip(OFFSETS)) {
        let number = |name: &str| axis[name].as_f64().unwrap();
        // The gain that the study had for x is not in them. Noise of 1 mm/s² over a second's rows is below 0.1 mm/s².
        assert!((number("gain") - gain).abs() < 3e-5 && number("gain_std") < 5e-5, "{axis}");
        assert!((number("offset_m_s2") - offset).abs() < 5e-4, "{axis}");
    }
    assert_eq!(found["written"], serde_json::json!([["now", "x"], ["now", "z"]]));
    let text = fs::read_to_string(&study).unwrap();
    assert!(text.contains("# of the tower") && text.contains("# a guess") && text.matches("gain_std").count() == 2);
    let again = said::json(&with_channels);
    assert_eq!(again["axes"][0]["gain"], found["axes"][0]["gain"], "what the study says is not applied twice");
}

#[test]
fn a_tumble_without_a_face_and_a_recording_in_g_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().to_str().unwrap();
    let file = folder.path().join("tumble.csv");
    fs::write(folder.path().join("study.toml"), STUDY).unwrap();
    fs::write(&file, tumble(5)).unwrap();
    let recording = file.to_str().unwrap();
    let arguments = ["calibrate", place, "--recording", recording, "--channels", "x,y,z"];
    belfry_command().args(arguments).assert().failure().stderr(contains("with -Z up").and(contains("six faces")));
    fs::write(folder.path().join("study.toml"), STUDY.replace("\"m/s2\"", "\"g\"")).unwrap();
    belfry_command().args(arguments).assert().failure().stderr(contains("+X, -X, +Y"));
    let report: Value =
        serde_json::from_slice(&belfry_command().args(arguments).arg("--json").output().unwrap().stdout).unwrap();
    assert!(report["error"]["message"].as_str().unwrap().contains("no still time"), "{report}");
    let other = [&arguments[..4], &["--channels", "x,y"]].concat();
    belfry_command().args(other).assert().failure().stderr(contains("X, Y and Z of one sensor"));
    belfry_command().args(["calibrate", place]).assert().failure().stderr(contains("--port"));
}
