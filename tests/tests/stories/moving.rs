//! A user shows how the structure moves: moving pictures are where, and what, `--output` says.

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::str::contains;

/// A mast of three sensors with two modes, as `belfry identify` leaves it.
fn mast(folder: &Path) {
    let mut study = "[structure]\nname = \"Mast\"\n[[setup]]\nname = \"first\"\nfiles = [\"a.csv\"]\nsampling_rate_hz = 20.0\nunit = \"m/s2\"\n".to_owned();
    for (channel, z_m) in [("low", 10.0), ("middle", 20.0), ("top", 30.0)] {
        study += &format!(
            "[[setup.sensor]]\nchannel = \"{channel}\"\nnode = 1\nelevation_m = {z_m:.1}\nazimuth_deg = 0.0\n"
        );
    }
    let mode = |number: usize, frequency_hz: f64, shape: [f64; 3]| {
        let parts: Vec<String> = ["low", "middle", "top"]
            .iter()
            .zip(shape)
            .map(|(channel, re)| {
                format!("{{\"channel\":\"{channel}\",\"point\":\"{channel}\",\"re\":{re},\"im\":0.0,\"std\":null}}")
            })
            .collect();
        format!(
            "{{\"number\":{number},\"frequency_hz\":{frequency_hz},\"frequency_std_hz\":null,\"damping_ratio\":0.01,\
             \"damping_ratio_std\":null,\"phase_collinearity\":null,\"shape\":[{}]}}",
            parts.join(",")
        )
    };
    let modes = [mode(1, 0.4, [0.2, 0.6, 1.0]), mode(2, 2.4, [-0.8, -0.3, 1.0])];
    fs::create_dir_all(folder.join("results")).unwrap();
    fs::write(folder.join("study.toml"), study).unwrap();
    fs::write(folder.join("results/modes.json"), format!("{{\"modes\":[{}]}}", modes.join(","))).unwrap();
}

/// Names in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_file_that_is_named_is_one_file_and_a_folder_has_one_a_mode() {
    let parent = tempfile::tempdir().unwrap();
    let study = parent.path().join("mast");
    mast(&study);
    let moving = |words: &[&str]| {
        let mut command = belfry_command();
        command.current_dir(parent.path()).args(["export", "mast", "--of", "animation"]).args(words);
        command
    };
    let out = parent.path().join("out");
    moving(&["--mode", "2", "--output", "out/two.gif"]).assert().success().stdout(contains("mode 2 at 2.4000 Hz"));
    moving(&["--output", "out/all.gif"]).assert().success().stdout(contains("2 modes, one after the other"));
    moving(&["--output", "out/all.png"]).assert().success();
    assert_eq!(names(&out), ["all.gif", "all.png", "two.gif"]);
    assert!(fs::read(out.join("two.gif")).unwrap().starts_with(b"GIF89a"));
    assert!(fs::read(out.join("all.png")).unwrap().starts_with(b"\x89PNG"));
    moving(&["--output", "folder"]).assert().success();
    moving(&["--format", "gif", "--mode", "1", "--output", "folder"]).assert().success();
    assert_eq!(names(&parent.path().join("folder")), ["animation_1.gif", "animation_1.png", "animation_2.png"]);
    moving(&[]).assert().success();
    assert_eq!(names(&study.join("results/export")), ["animation_1.png", "animation_2.png"]);

    // What cannot be meant is said, and nothing is written.
    moving(&["--output", "x.mp4"]).assert().code(2).stderr(contains("written as .png or .gif"));
    moving(&["--format", "gif", "--output", "x.png"]).assert().code(2).stderr(contains("is not that of --format gif"));
    moving(&["--mode", "9", "--output", "x.gif"]).assert().code(1).stderr(contains("no mode 9; the study has 1, 2"));
    belfry_command()
        .current_dir(parent.path())
        .args(["export", "mast", "--mode", "1"])
        .assert()
        .code(2)
        .stderr(contains("--mode goes with --of animation"));
    assert_eq!(names(parent.path()), ["folder", "mast", "out"]);
}
