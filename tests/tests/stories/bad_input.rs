//! A user's data are not what they should be: every fault is named with its place and a way out, and what is sound still works.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use serde_json::Value;

pub(crate) const RATE_HZ: usize = 20;

/// Two modes (1.1 and 2.7 Hz, 2 % damping) at four sensors, driven by noise, with a little sensor noise: 20 minutes.
pub(crate) fn recording() -> Vec<[f64; 4]> {
    let mut state = 1_u64;
    let mut noise = || {
        let mut sum = 0.0;
        for _ in 0..12 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 40) as f64 / (1 << 24) as f64;
        }
        sum - 6.0
    };
    let step = 1.0 / RATE_HZ as f64;
    let mut oscillators = [(1.1_f64, 0.0_f64, 0.0_f64), (2.7, 0.0, 0.0)];
    let shapes = [[0.2, 0.5, 0.8, 1.0], [-0.6, -1.0, -0.1, 0.9]];
    (0..20 * 60 * RATE_HZ)
        .map(|_| {
            let mut row = [0.0; 4];
            for ((frequency, x, before), shape) in oscillators.iter_mut().zip(shapes) {
                // x(n+1) = 2 e cos(w dt) x(n) - e² x(n-1) + force: the exact poles of a damped oscillator.
                let omega = std::f64::consts::TAU * *frequency;
                let decay = (-0.02 * omega * step).exp();
                let next = 2.0 * decay * (omega * step).cos() * *x - decay * decay * *before + noise();
                (*before, *x) = (*x, next);
                for (value, part) in row.iter_mut().zip(shape) {
                    *value += part * next;
                }
            }
            row.map(|value| 1e-3 * (value + 0.1 * noise()))
        })
        .collect()
}

fn csv(rows: &[[f64; 4]], mut cell: impl FnMut(usize, usize, f64) -> String) -> String {
    let mut text = String::from("north,east,south,west\n");
    for (row, values) in rows.iter().enumerate() {
        let cells: Vec<String> = values.iter().enumerate().map(|(column, &value)| cell(row, column, value)).collect();
        writeln!(text, "{}", cells.join(",")).unwrap();
    }
    text
}

fn plain(_: usize, _: usize, value: f64) -> String {
    format!("{value:.6e}")
}

/// A study of these setups (name, recording's file, sampling rate) with four channels each.
fn study(folder: &Path, setups: &[(&str, &str, f64)], channels: [&str; 4]) {
    let mut text = String::from("[structure]\nname = \"Test mast\"\n\n[analysis]\nband_hz = [0.5, 4.0]\n");
    for (name, file, rate) in setups {
        write!(
            text,
            "\n[[setup]]\nname = \"{name}\"\nfiles = [\"{file}\"]\nsampling_rate_hz = {rate}\nunit = \"m/s2\"\n"
        )
        .unwrap();
        for (index, channel) in channels.iter().enumerate() {
            let node = 1 + index / 2;
            write!(text, "\n[[setup.sensor]]\nchannel = \"{channel}\"\nnode = {node}\nreference = true\n").unwrap();
        }
    }
    fs::write(folder.join("study.toml"), text).unwrap();
}

const CHANNELS: [&str; 4] = ["north", "east", "south", "west"];

/// Runs identify on one recording; exit status, standard error, and the JSON where there is one.
fn identify(file: &str, content: &str, rate: f64, channels: [&str; 4]) -> (i32, String, Option<Value>) {
    let folder = tempfile::tempdir().unwrap();
    study(folder.path(), &[("first", file, rate)], channels);
    fs::write(folder.path().join(file), content).unwrap();
    run(folder.path())
}

fn run(folder: &Path) -> (i32, String, Option<Value>) {
    let output =
        belfry_command().arg("identify").arg(folder).arg("--json").env("RUST_BACKTRACE", "1").unwrap_or_output();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!error.contains("panicked") && !error.contains("stack backtrace"), "{error}");
    (output.status.code().unwrap(), error, serde_json::from_slice(&output.stdout).ok())
}

trait Output {
    fn unwrap_or_output(&mut self) -> std::process::Output;
}

impl Output for std::process::Command {
    fn unwrap_or_output(&mut self) -> std::process::Output {
        self.output().unwrap()
    }
}

fn frequencies(report: &Value) -> Vec<f64> {
    report["modes"].as_array().unwrap().iter().map(|mode| mode["frequency_hz"].as_f64().unwrap()).collect()
}

fn assert_both_modes(report: &Option<Value>) {
    let found = frequencies(report.as_ref().expect("a report"));
    assert_eq!(found.len(), 2, "{found:?}");
    assert!((found[0] - 1.1).abs() < 0.01 && (found[1] - 2.7).abs() < 0.02, "{found:?}");
}

/// Fails with status 1, prints the error as JSON, and says all of `parts`.
fn assert_fails(outcome: &(i32, String, Option<Value>), parts: &[&str]) {
    let (status, error, report) = outcome;
    assert_eq!(*status, 1, "{error}");
    let message = report.as_ref().and_then(|report| report["error"]["message"].as_str()).unwrap_or_default();
    assert!(!message.is_empty() && error.contains(message), "{report:?}");
    for part in parts {
        assert!(error.contains(part), "\"{part}\" is not in: {error}");
    }
}

#[test]
fn a_sound_recording_gives_both_modes_and_no_warning() {
    let (status, error, report) = identify("data.csv", &csv(&recording(), plain), 20.0, CHANNELS);
    assert_eq!((status, error.as_str()), (0, ""));
    assert_both_modes(&report);
}

#[test]
fn broken_rows_are_named_by_file_line_and_column() {
    let rows = recording();
    let ragged = csv(&rows, plain).lines().enumerate().fold(String::new(), |mut text, (index, line)| {
        let line = if index == 500 { line.rsplit_once(',').unwrap().0 } else { line };
        writeln!(text, "{line}").unwrap();
        text
    });
    assert_fails(&identify("data.csv", &ragged, 20.0, CHANNELS), &["data.csv", "501", "3", "4"]);
    let text =
        csv(&rows, |row, column, value| if (row, column) == (700, 1) { "n/a?".into() } else { plain(0, 0, value) });
    assert_fails(&identify("data.csv", &text, 20.0, CHANNELS), &["data.csv", "702", "n/a?", "east"]);
    let infinite =
        csv(&rows, |row, column, value| if (row, column) == (9, 2) { "inf".into() } else { plain(0, 0, value) });
    let (status, said, report) = identify("data.csv", &infinite, 20.0, CHANNELS);
    assert_eq!(status, 0, "{said}");
    for part in ["data.csv, line 11", "\"south\"", "1 sample that no sensor can give", "it counts as missing"] {
        assert!(said.contains(part), "no {part:?} in: {said}");
    }
    assert_both_modes(&report);
}

#[test]
fn a_channel_that_is_a_copy_of_another_is_told_and_left_out() {
    let rows = recording();
    let text = csv(&rows, |row, column, value| plain(0, 0, if column == 3 { rows[row][0] } else { value }));
    let (status, said, report) = identify("data.csv", &text, 20.0, CHANNELS);
    assert_eq!(status, 0, "{said}");
    assert!(
        said.contains("channel \"west\" has the same samples as channel \"north\" in every row, and is left out"),
        "{said}"
    );
    assert_both_modes(&report);
}

#[test]
fn a_wrong_channel_name_lists_the_names_there_are() {
    let outcome = identify("data.csv", &csv(&recording(), plain), 20.0, ["north", "east", "south", "wset"]);
    assert_fails(&outcome, &["wset", "west", "data.csv"]);
}

#[test]
fn a_missing_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    study(folder.path(), &[("first", "nowhere.csv", 20.0)], CHANNELS);
    assert_fails(&run(folder.path()), &["nowhere.csv", "first"]);
}

#[test]
fn a_sampling_rate_that_contradicts_the_time_column_is_refused_with_both_rates() {
    let rows = recording();
    let mut text = String::from("time,north,east,south,west\n");
    for (index, row) in rows.iter().enumerate() {
        writeln!(text, "{:.3},{},{},{},{}", index as f64 / 20.0, row[0], row[1], row[2], row[3]).unwrap();
    }
    assert_fails(&identify("data.csv", &text, 25.0, CHANNELS), &["data.csv", "20", "25", "sampling_rate_hz"]);
    let (status, _, report) = identify("data.csv", &text, 20.0, CHANNELS);
    assert_eq!(status, 0);
    assert_both_modes(&report);
}

#[test]
fn a_recording_too_short_for_its_channels_is_refused_with_what_is_missing() {
    let rows = recording();
    // 40 s: a few windows of 256 points, fewer than 16 averages for four channels.
    let outcome = identify("data.csv", &csv(&rows[..40 * RATE_HZ], plain), 20.0, CHANNELS);
    assert_fails(&outcome, &["averages for 4 channels", "Record", "min more", "modes_hz"]);
    let outcome = identify("data.csv", &csv(&rows[..5 * RATE_HZ], plain), 20.0, CHANNELS);
    assert_fails(&outcome, &["too short", "record longer"]);
}

#[test]
fn a_dead_channel_is_left_out_and_named_and_the_rest_works() {
    let text = csv(&recording(), |_, column, value| if column == 2 { "0.25".into() } else { plain(0, 0, value) });
    let (status, error, report) = identify("data.csv", &text, 20.0, CHANNELS);
    assert_eq!(status, 0, "{error}");
    assert!(error.contains("south"), "{error}");
    assert_both_modes(&report);
    let shape = &report.unwrap()["modes"][0]["shape"];
    let channels: Vec<&str> = shape.as_array().unwrap().iter().map(|c| c["channel"].as_str().unwrap()).collect();
    assert_eq!(channels, ["north", "east", "west"]);
}

#[test]
fn gaps_cost_their_windows_and_are_named_by_channel_and_row() {
    // NaN for a second in one channel, empty cells in another.
    let text = csv(&recording(), |row, column, value| match (row, column) {
        (4000..4020, 0) => "NaN".into(),
        (15_000..15_003, 3) => String::new(),
        _ => plain(0, 0, value),
    });
    let (status, error, report) = identify("data.csv", &text, 20.0, CHANNELS);
    assert_eq!(status, 0, "{error}");
    for part in
        ["channel \"north\" has a gap of 20 samples", "\"west\": 3 missing samples", "windows are left out", "data.csv"]
    {
        assert!(error.contains(part), "\"{part}\" is not in: {error}");
    }
    assert_both_modes(&report);
}

#[test]
fn a_gap_in_all_channels_is_told_once_and_gaps_and_not_the_study_are_why_segments_are_shorter() {
    // A second is missing every 50 s.
    let text = csv(&recording(), |row, column, value| match row % 1000 {
        500..520 => "NaN".into(),
        _ => plain(row, column, value),
    });
    let (status, error, report) = identify("data.csv", &text, 20.0, CHANNELS);
    assert_eq!(status, 0, "{error}");
    assert!(error.contains("all 4 channels have 24 gaps, 480 samples (24.000 s) in all, the first at"), "{error}");
    assert!(error.contains("data.csv, line 502, 0:00:25 into the record"), "{error}");
    assert_eq!(error.matches(" 24 gaps").count(), 1, "{error}");
    assert_both_modes(&report);
    let reasons = report.unwrap()["segments"]["reasons"].to_string();
    assert!(reasons.contains("as gaps cost too many segments of") && !reasons.contains("[analysis]"), "{reasons}");
}

#[test]
fn blocks_that_are_too_short_for_a_mode_are_told_with_what_would_do() {
    let in_blocks = |block_s: f64| {
        let folder = tempfile::tempdir().unwrap();
        study(folder.path(), &[("first", "data.csv", 20.0)], CHANNELS);
        fs::write(folder.path().join("data.csv"), csv(&recording(), plain)).unwrap();
        let file = folder.path().join("study.toml");
        let text = fs::read_to_string(&file).unwrap();
        let rate = "sampling_rate_hz = 20\n";
        assert!(text.contains(rate), "{text}");
        fs::write(&file, text.replace(rate, &format!("{rate}block_s = {block_s:.1}\n"))).unwrap();
        run(folder.path())
    };
    assert_fails(&in_blocks(10.0), &["the blocks of 10.0 s (block_s in [[setup]]) are too short", "need "]);
    let (status, error, _) = in_blocks(40.0);
    assert_eq!(status, 0, "{error}");
    for part in [
        "its blocks of 40 s (block_s) leave room for segments of",
        "% of damping is 0.0",
        "and blocks of",
        "Damping may be far off",
    ] {
        assert!(error.contains(part), "\"{part}\" is not in: {error}");
    }
    let (status, error, report) = in_blocks(400.0);
    assert_eq!(status, 0, "{error}");
    assert!(!error.contains("(block_s)"), "{error}");
    assert_both_modes(&report);
}

/// Frequencies lie within a deviation of those of the sound recording, and damping within 10 %.
fn assert_as_good_as_sound(report: &Option<Value>) {
    let sound = identify("sound.csv", &csv(&recording(), plain), RATE_HZ as f64, CHANNELS).2.unwrap();
    let modes = |report: &Value| report["modes"].as_array().unwrap().clone();
    let (here, sound) = (modes(report.as_ref().unwrap()), modes(&sound));
    assert_eq!(here.len(), sound.len());
    for (here, sound) in here.iter().zip(&sound) {
        let number = |mode: &Value, name: &str| mode[name].as_f64().unwrap();
        let apart_hz = number(here, "frequency_hz") - number(sound, "frequency_hz");
        assert!(apart_hz.abs() < number(sound, "frequency_std_hz"), "{here} {sound}");
        let ratio = number(here, "damping_ratio") / number(sound, "damping_ratio");
        assert!((0.9..1.1).contains(&ratio), "{ratio}");
    }
}

#[test]
fn spikes_of_single_samples_are_replaced_and_told() {
    // One of 1 g among some mm/s².
    let once = csv(&recording(), |row, column, value| {
        plain(row, column, if (row, column) == (9001, 2) { value + 9.81 } else { value })
    });
    let (status, stderr, report) = identify("spike.csv", &once, RATE_HZ as f64, CHANNELS);
    assert_eq!(status, 0, "{stderr}");
    assert!(stderr.contains("channel \"south\": 1 spike of a single sample 0:07:30 into the record"), "{stderr}");
    assert_as_good_as_sound(&report);
}

#[test]
fn a_step_costs_the_windows_it_is_in_and_is_told_with_its_time() {
    let step = csv(&recording(), |row, column, value| {
        plain(row, column, if row >= 12_000 && column == 1 { value + 9.81 } else { value })
    });
    let (status, stderr, report) = identify("step.csv", &step, RATE_HZ as f64, CHANNELS);
    assert_eq!(status, 0, "{stderr}");
    assert!(stderr.contains("channel \"east\" stands far off what is usual"), "{stderr}");
    assert_both_modes(&report);
}

#[test]
fn a_channel_of_loud_noise_is_left_out_and_named() {
    let mut state = 5_u64;
    let noisy = csv(&recording(), |row, column, value| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let noise = (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5;
        plain(row, column, if column == 0 { value + noise } else { value })
    });
    let (status, stderr, report) = identify("noisy.csv", &noisy, RATE_HZ as f64, CHANNELS);
    assert_eq!(status, 0, "{stderr}");
    assert!(stderr.contains("channel \"north\" is left out: it is loud"), "{stderr}");
    assert_both_modes(&report);
}

#[test]
fn a_setup_that_cannot_be_read_is_left_out_and_the_others_still_give_modes() {
    let folder = tempfile::tempdir().unwrap();
    let setups = [
        ("first", "good.csv", 20.0),
        ("second", "bad.csv", 20.0),
        ("third", "short.csv", 20.0),
        ("fourth", "none.csv", 20.0),
    ];
    study(folder.path(), &setups, CHANNELS);
    let rows = recording();
    let bad = csv(&rows, |row, column, value| if (row, column) == (700, 1) { "x".into() } else { plain(0, 0, value) });
    for (file, text) in [("good.csv", csv(&rows, plain)), ("bad.csv", bad), ("short.csv", csv(&rows[..50], plain))] {
        fs::write(folder.path().join(file), text).unwrap();
    }
    let (status, error, report) = run(folder.path());
    assert_eq!(status, 0, "{error}");
    for part in ["left out", "\"second\"", "bad.csv", "702", "\"third\"", "too short", "\"fourth\"", "none.csv"] {
        assert!(error.contains(part), "\"{part}\" is not in: {error}");
    }
    assert_both_modes(&report);
}

#[test]
fn a_harmonic_is_reported_as_one_and_not_as_a_mode() {
    // A fan at 1.875 Hz: on a spectral line, steady, in all channels.
    let text = csv(&recording(), |row, column, value| {
        let tone = 5e-3 * (std::f64::consts::TAU * 1.875 * row as f64 / 20.0).sin();
        plain(0, 0, value + tone * [1.0, 0.9, -0.4, 0.7][column])
    });
    let (status, error, report) = identify("data.csv", &text, 20.0, CHANNELS);
    assert_eq!(status, 0, "{error}");
    assert_both_modes(&report);
    let harmonics = report.unwrap()["harmonics"].as_array().unwrap().clone();
    assert_eq!(harmonics.len(), 1, "{harmonics:?}");
    assert!((harmonics[0]["frequency_hz"].as_f64().unwrap() - 1.875).abs() < 0.02);
    assert!(harmonics[0]["kurtosis"].as_f64().unwrap() < 2.0);
}

#[test]
fn one_channel_alone_gives_its_frequencies() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[structure]\nname = \"Mast\"\n[analysis]\nband_hz = [0.5, 4.0]\n[[setup]]\nname = \"one\"\nfiles = [\"data.csv\"]\nsampling_rate_hz = 20.0\nunit = \"m/s2\"\n[[setup.sensor]]\nchannel = \"west\"\nnode = 1\n";
    fs::write(folder.path().join("study.toml"), text).unwrap();
    fs::write(folder.path().join("data.csv"), csv(&recording(), plain)).unwrap();
    let (status, error, report) = run(folder.path());
    assert_eq!(status, 0, "{error}");
    assert_both_modes(&report);
}

#[test]
fn wrong_usage_has_status_two() {
    belfry_command().args(["identify", ".", "--bits", "40"]).assert().code(2);
    belfry_command().args(["identify", ".", "--direct", "--bits", "8"]).assert().code(2);
    belfry_command().arg("identify").assert().code(2);
}

/// A NumPy file of these rows, in which one number is changed.
fn npy(rows: &[[f64; 4]], change: (usize, usize), by: impl Fn(f64) -> f64) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 4), }}", rows.len());
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for (row, values) in rows.iter().enumerate() {
        for (column, &value) in values.iter().enumerate() {
            bytes.extend(if (row, column) == change { by(value) } else { value }.to_le_bytes());
        }
    }
    bytes
}

/// Any bit of a number may be flipped: its exponent's make it anything from 1e-308 to 1e308.
#[test]
fn one_flipped_bit_of_a_recording_is_told_or_does_no_harm() {
    let rows = recording();
    for bit in [63, 62, 61, 60, 58, 57, 55, 52, 30] {
        let folder = tempfile::tempdir().unwrap();
        study(folder.path(), &[("first", "data.npy", RATE_HZ as f64)], ["1", "2", "3", "4"]);
        let flipped = |value: f64| f64::from_bits(value.to_bits() ^ (1 << bit));
        let (at, before) = ((9001, 2), rows[9001][2]);
        fs::write(folder.path().join("data.npy"), npy(&rows, at, flipped)).unwrap();
        let (status, stderr, report) = run(folder.path());
        assert_eq!(status, 0, "bit {bit}: {stderr}");
        if (flipped(before) - before).abs() > 1.0 {
            assert!(stderr.contains("\"3\"") && stderr.contains("0:07:30 into the record"), "bit {bit}: {stderr}");
        }
        assert_both_modes(&report);
        for picture in ["singular_values.svg", "fits.svg"] {
            assert!(fs::metadata(folder.path().join("results").join(picture)).unwrap().len() > 1000, "bit {bit}");
        }
    }
}

/// Runs `belfry` with so many KB of memory, which ends within half a minute; exit status and standard error.
#[cfg(target_os = "linux")]
fn within_memory(kilobytes: u64, words: &[&str]) -> (i32, String) {
    let start = std::time::Instant::now();
    let mut command = std::process::Command::new("bash");
    command.args(["-c", &format!("ulimit -v {kilobytes}; exec \"$@\""), "bash", "timeout", "60"]);
    let output = command.arg(belfry_command().get_program()).args(words).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!said.contains("panicked"), "{said}");
    assert!(start.elapsed() < std::time::Duration::from_secs(30), "{:?}: {said}", start.elapsed());
    (output.status.code().unwrap_or(-1), said)
}

#[cfg(target_os = "linux")]
#[test]
fn a_model_that_does_not_fit_into_memory_is_refused_with_what_it_would_take() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    study(folder.path(), &[("first", "data.csv", RATE_HZ as f64)], CHANNELS);
    fs::write(folder.path().join("data.csv"), csv(&recording(), plain)).unwrap();
    assert_eq!(run(folder.path()).0, 0);
    let with = |model: &str| {
        let file = folder.path().join("study.toml");
        let text = fs::read_to_string(&file).unwrap();
        fs::write(&file, format!("{}\n[model]\n{model}\n", text.split("\n[model]").next().unwrap())).unwrap();
    };
    with("beam = \"beam.csv\"");
    for (segments, kilobytes, takes) in [(200_000, 8_000_000, "640000 GB"), (1000, 2_000_000, "16 GB")] {
        let mut table = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n".to_owned();
        // No higher than structures are.
        for (n, next) in (0..segments).map(|n| (f64::from(n) * 0.01, f64::from(n + 1) * 0.01)) {
            writeln!(table, "{n},{next},1e12,1e12,0,1e10,1e12,1e4,1e5,1e5,1e5").unwrap();
        }
        fs::write(folder.path().join("beam.csv"), table).unwrap();
        for command in ["compare", "simulate"] {
            let (status, said) = within_memory(kilobytes, &[command, path]);
            assert_eq!(status, 1, "{command}: {said}");
            for part in ["beam.csv", &format!("{segments} segments"), takes, "GB are free", "join segments"] {
                assert!(said.contains(part), "{command}: no {part:?} in: {said}");
            }
        }
    }
    // Sparse matrices of 11 000 rows, of diagonals: they are small, but not as those of a mast, which are kept in full.
    const ROWS: u32 = 11_000;
    let mut file = b"MATLAB 5.0 MAT-file".to_vec();
    file.resize(124, b' ');
    file.extend([0, 1, b'I', b'M']);
    let element = |kind: u32, content: &[u8]| {
        let mut bytes = [kind.to_le_bytes(), (content.len() as u32).to_le_bytes()].concat();
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let words = |values: &[u32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let ones: Vec<u8> = (0..ROWS).flat_map(|_| 1.0_f64.to_le_bytes()).collect();
    for name in [&b"kk"[..], b"mm"] {
        let parts = [
            element(6, &words(&[5, 1])),
            element(5, &words(&[ROWS, ROWS])),
            element(1, name),
            element(5, &words(&(0..ROWS).collect::<Vec<_>>())),
            element(5, &words(&(0..=ROWS).collect::<Vec<_>>())),
            element(9, &ones),
        ];
        file.extend(element(14, &parts.concat()));
    }
    fs::write(folder.path().join("model.mat"), file).unwrap();
    let nodes: String = (0..=ROWS / 5).map(|node| format!("{node},{node}\n")).collect();
    fs::write(folder.path().join("nodes.csv"), format!("node,z_m\n{nodes}")).unwrap();
    with("matrices = { file = \"model.mat\", stiffness = \"kk\", mass = \"mm\", nodes = \"nodes.csv\" }");
    let (status, said) = within_memory(4_000_000, &["compare", path]);
    assert_eq!(status, 1, "{said}");
    for part in ["[model] matrices", "11000 unknowns", "77 GB", "GB are free"] {
        assert!(said.contains(part), "no {part:?} in: {said}");
    }
}

#[cfg(unix)]
#[test]
fn a_pipe_in_place_of_a_file_is_refused_and_not_waited_for() {
    // A recording that is one is no file that a pattern finds.
    for (pipe, reason) in [("study.toml", "a pipe"), ("beam.csv", "a pipe"), ("data.csv", "no file matches")] {
        let folder = tempfile::tempdir().unwrap();
        study(folder.path(), &[("first", "data.csv", RATE_HZ as f64)], CHANNELS);
        fs::write(folder.path().join("data.csv"), csv(&recording()[..4000], plain)).unwrap();
        let file = folder.path().join("study.toml");
        let text = fs::read_to_string(&file).unwrap() + "\n[model]\nbeam = \"beam.csv\"\n";
        fs::write(&file, text).unwrap();
        // Whoever waits would wait for ever.
        let _ = fs::remove_file(folder.path().join(pipe));
        assert!(std::process::Command::new("mkfifo").arg(folder.path().join(pipe)).status().unwrap().success());
        let command: &[&str] =
            if pipe == "beam.csv" { &["plan", "--effect", "added-mass@5m=1e3"] } else { &["identify"] };
        let mut waits = std::process::Command::new("timeout");
        let output =
            waits.arg("20").arg(belfry_command().get_program()).args(command).arg(folder.path()).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{pipe}: {said}");
        assert!(said.contains(pipe) && said.contains(reason), "{pipe}: {said}");
    }
}

/// Of a study that somebody else has sent: links lead out of it, and its names are no names.
#[cfg(unix)]
#[test]
fn a_study_from_somebody_else_writes_into_no_other_file_and_not_on_the_terminal() {
    use std::os::unix::fs::symlink;
    let (folder, own) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    study(folder.path(), &[("first", "data.csv", RATE_HZ as f64)], CHANNELS);
    fs::write(folder.path().join("data.csv"), csv(&recording(), plain)).unwrap();
    let file = folder.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("Test mast", "mast\\u001b[2J\\u0007\\u202e")).unwrap();
    fs::create_dir(folder.path().join("results")).unwrap();
    let results = ["modes.json", "singular_values.svg", "fits.svg", "stabilisation.svg", "report.html", "spectra.json"];
    let links: Vec<String> = results.iter().map(|name| format!("results/{name}")).collect();
    for link in &links {
        let mine = own.path().join(link.replace('/', "-"));
        fs::write(&mine, "mine").unwrap();
        symlink(&mine, folder.path().join(link)).unwrap();
    }
    let mut said = Vec::new();
    for command in ["identify", "report"] {
        let output = belfry_command().arg(command).arg(folder.path()).output().unwrap();
        assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
        said.extend(output.stdout);
        said.extend(output.stderr);
    }
    for link in &links {
        assert_eq!(fs::read_to_string(own.path().join(link.replace('/', "-"))).unwrap(), "mine", "{link}");
    }
    let said = String::from_utf8(said).unwrap();
    assert!(!said.contains(['\u{1b}', '\u{7}', '\u{202e}']), "{said:?}");
    let picture = fs::read_to_string(folder.path().join("results/singular_values.svg")).unwrap();
    assert!(picture.contains("mast\u{fffd}[2J") && !picture.contains('\u{1b}'));

    // The folder of results leads out of it as a whole.
    let (results, elsewhere) = (folder.path().join("results"), own.path().join("documents"));
    fs::rename(&results, &elsewhere).unwrap();
    symlink(&elsewhere, &results).unwrap();
    let state = || -> Vec<_> {
        let files = fs::read_dir(&elsewhere).unwrap().map(|file| file.unwrap());
        let mut state: Vec<_> = files.map(|file| (file.path(), file.metadata().unwrap().modified().unwrap())).collect();
        state.sort();
        state
    };
    let before = state();
    for command in ["identify", "report", "export"] {
        let output = belfry_command().arg(command).arg(folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains("it is a link"), "{command}: {said}");
    }
    assert_eq!(state(), before);
}
