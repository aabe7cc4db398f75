//! A user steers the analysis of half a day of the tower: fewer bytes on the wire, modes chosen by hand, the hours one by
//! one, no band given, and the modes taken elsewhere.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;

/// Twelve hours of the stand-in tower, simulated once for all tests: segments of 4096 points are right for it.
static RECORDED: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("half-a-day");
    let _ = fs::remove_dir_all(&folder);
    belfry_command().arg("init").arg(&folder).args(["--template", "canton"]).assert().success();
    let file = folder.join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("sampling_rate_hz = 50.0", "sampling_rate_hz = 12.5")).unwrap();
    let arguments = ["--effect", "base-rotation=7.21e-15", "--hours", "12", "--seed", "4", "--adopt"];
    belfry_command().arg("simulate").arg(&folder).args(arguments).assert().success();
    folder
});

/// A study of its own on the recording, `edit`ed.
fn study(edit: impl Fn(String) -> String) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(RECORDED.join("study.toml")).unwrap();
    let recording = RECORDED.join("simulated-january.npy");
    let text = text.replace("simulated-january.npy", recording.to_str().unwrap());
    fs::write(folder.path().join("study.toml"), edit(text)).unwrap();
    fs::copy(RECORDED.join("beam.csv"), folder.path().join("beam.csv")).unwrap();
    folder
}

fn with_analysis(line: &'static str) -> impl Fn(String) -> String {
    move |text| text.replace("band_hz = [0.05, 1.5]", &format!("band_hz = [0.05, 1.5]\n{line}"))
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    let mut command = belfry_command();
    command.arg("identify").arg(folder).args(arguments).arg("--json");
    serde_json::from_slice(&command.assert().success().get_output().stdout).expect("one JSON object")
}

fn modes(report: &Value) -> &Vec<Value> {
    report["modes"].as_array().expect("modes are a list")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn frequencies(report: &Value) -> Vec<f64> {
    modes(report).iter().map(|mode| number(&mode["frequency_hz"])).collect()
}

fn mac(a: &Value, b: &Value) -> f64 {
    let parts = |mode: &Value| -> Vec<(f64, f64)> {
        let shape = mode["shape"].as_array().unwrap();
        shape.iter().map(|part| (number(&part["re"]), number(&part["im"]))).collect()
    };
    let (a, b) = (parts(a), parts(b));
    let product =
        a.iter().zip(&b).fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a.0 * b.0 + a.1 * b.1, sum.1 + a.0 * b.1 - a.1 * b.0));
    let square = |shape: &[(f64, f64)]| shape.iter().map(|part| part.0 * part.0 + part.1 * part.1).sum::<f64>();
    (product.0 * product.0 + product.1 * product.1) / (square(&a) * square(&b))
}

#[test]
fn six_bits_a_component_keep_frequencies_within_a_third_of_their_deviation_at_five_bytes_a_second() {
    let folder = study(|text| text);
    let direct = json(folder.path(), &["--direct"]);
    let nodes = json(folder.path(), &["--bits", "6"]);
    assert_eq!(nodes["segments"]["points"], 4096);
    assert!(number(&nodes["link"]["bytes_per_second_and_channel"]) <= 5.0, "{}", nodes["link"]);
    assert_eq!(modes(&nodes).len(), modes(&direct).len());
    for (node, direct) in modes(&nodes).iter().zip(modes(&direct)) {
        let (a, b) = (number(&node["frequency_hz"]), number(&direct["frequency_hz"]));
        // The furthest are weak modes beside strong ones, whose lines share the bits: 1.01e-4 and 0.29 deviations, the median 0.06.
        assert!((a / b - 1.0).abs() < 1.2e-4, "{a} Hz through nodes, {b} Hz directly");
        assert!((a - b).abs() < 0.33 * number(&direct["frequency_std_hz"]), "{a} Hz through nodes, {b} Hz directly");
        assert!(mac(node, direct) > 1.0 - 1e-4, "{a} Hz: {}", mac(node, direct));
    }
}

#[test]
fn modes_are_added_dropped_and_fixed_in_the_study() {
    let automatic = json(study(|text| text).path(), &["--direct"]);
    let all = frequencies(&automatic);
    assert!(all.len() >= 13, "{all:?}");
    let dropped = study(with_analysis("drop_modes_hz = [0.1525]     # not of interest"));
    let report = json(dropped.path(), &["--direct"]);
    assert_eq!(frequencies(&report).len(), all.len() - 1);
    assert!(frequencies(&report).iter().all(|hz| (hz - 0.1525).abs() > 0.01));
    let added = study(with_analysis("add_modes_hz = [0.65]"));
    let report = json(added.path(), &["--direct"]);
    assert_eq!(frequencies(&report), all);
    let warnings = report["warnings"].to_string();
    assert!(
        warnings.contains("no peak stands out at 0.65 Hz") && warnings.contains("the nearest peak is at"),
        "{warnings}"
    );
    let fixed = study(with_analysis("modes_hz = [0.341, 0.1085]"));
    let report = json(fixed.path(), &["--direct"]);
    let found = frequencies(&report);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!((found[0] / 0.1085 - 1.0).abs() < 0.01 && (found[1] / 0.341 - 1.0).abs() < 0.01, "{found:?}");
    for (line, expected) in [
        ("modes_hz = [0.341]\nadd_modes_hz = [0.5]", "left out beside modes_hz"),
        ("modes_hz = [2.4]", "within band_hz"),
        ("modes_hz = [0.341, 0.341]", "each once"),
        ("modes_hz = []", "a list of frequencies"),
        ("drop_modes_hz = 0.3", "a list of frequencies"),
        ("drop_mode_hz = [0.3]", "drop_modes_hz"),
    ] {
        let wrong = study(with_analysis(line));
        belfry_command().arg("identify").arg(wrong.path()).assert().code(1).stderr(contains(expected));
    }
}

#[test]
fn the_subspace_alone_says_which_poles_it_rejects_and_one_is_kept_by_its_name() {
    let study = study(|text| text);
    let report = json(study.path(), &["--direct", "--method", "subspace"]);
    let rejected = report["rejected"].as_array().unwrap();
    let reasons = ["weak", "unstable", "damping"];
    assert!(
        !rejected.is_empty() && rejected.iter().all(|one| reasons.contains(&one["because"].as_str().unwrap())),
        "{rejected:?}"
    );
    let first_hz = number(&rejected[0]["frequency_hz"]);
    let before = frequencies(&report);
    let mut command = belfry_command();
    command.arg("identify").arg(study.path()).args(["--direct", "--method", "subspace"]);
    let keep = format!("To keep one, name it: add_modes_hz = [{first_hz:.4}] in [analysis].");
    command.assert().success().stdout(contains(keep).and(contains("Rejected: ")));
    let file = study.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    let band = "band_hz = [0.05, 1.5]";
    fs::write(&file, text.replace(band, &format!("{band}\nadd_modes_hz = [{first_hz:.4}]"))).unwrap();
    let kept = json(study.path(), &["--direct", "--method", "subspace"]);
    assert_eq!(frequencies(&kept).len(), before.len() + 1);
    assert!(frequencies(&kept).iter().any(|hz| (hz - first_hz).abs() < 1e-9), "{kept}");
    let left = kept["rejected"].as_array().unwrap();
    assert!(!left.iter().any(|one| one["frequency_hz"] == rejected[0]["frequency_hz"]), "{left:?}");
}

#[test]
fn modes_that_are_older_than_their_study_are_told_where_they_are_used() {
    let folder = study(|text| text);
    let found = frequencies(&json(folder.path(), &["--direct"]));
    let compare = || belfry_command().arg("compare").arg(folder.path()).assert().success();
    compare().stderr(contains("is older than").not());
    let file = folder.path().join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, with_analysis("DROPPED")(text.clone()).replace("DROPPED", &format!("drop_modes_hz = {found:?}")))
        .unwrap();
    let failed = belfry_command().arg("identify").arg(folder.path()).arg("--direct").assert().code(1);
    failed.stderr(contains("modes.json keeps the modes of an earlier run"));
    compare().stderr(contains("modes.json is older than these changes: [analysis]; run `belfry identify"));
    // As it was.
    fs::write(&file, text).unwrap();
    compare().stderr(contains("is older than").not());
}

#[test]
fn the_hours_one_by_one_show_what_goes_with_temperature() {
    let folder =
        study(|text| text.replace("sampling_rate_hz = 12.5", "sampling_rate_hz = 12.5\ntemperature = \"station.csv\""));
    let station = "time_s,temperature_degc\n0,12.0\n21600,18.0\n43200,13.0\n";
    fs::write(folder.path().join("station.csv"), station).unwrap();
    let report = json(folder.path(), &["--direct", "--every", "1h"]);
    let trend = &report["trends"];
    let intervals = trend["intervals"].as_array().unwrap();
    assert_eq!(intervals.len(), 12);
    assert_eq!(number(&intervals[5]["temperature_degc"]), 17.5);
    let followed = trend["modes"].as_array().unwrap();
    assert_eq!(followed.len(), modes(&report).len());
    // The tower does not change: hardly a mode is said to, and none goes with the temperature by much.
    let changing = followed.iter().filter(|mode| number(&mode["p_value_of_no_change"]) < 1e-3).count();
    assert!(changing <= 1, "{trend:#}");
    for mode in followed {
        let slope = &mode["percent_per_kelvin"];
        if slope.is_object() {
            assert!(number(&slope["value"]).abs() < 4.0 * number(&slope["std"]), "{mode}");
        }
    }
    let table = fs::read_to_string(folder.path().join("results/trends.csv")).unwrap();
    let rows: usize = intervals.iter().map(|interval| interval["modes"].as_array().unwrap().len()).sum();
    assert_eq!(table.lines().count(), rows + 1);
    assert!(fs::read_to_string(folder.path().join("results/trends.svg")).unwrap().contains("temperature"));
    let identify = |every: &str| {
        let mut command = belfry_command();
        command.arg("identify").arg(folder.path()).args(["--direct", "--every", every]);
        command.assert()
    };
    identify("1 fortnight").code(2);
    identify("0h").code(2);
    identify("5s").code(1).stderr(contains("an interval of 5 s gives 0 averages").and(contains("take intervals of")));
    // What is identified stays where it cannot be followed.
    assert!(folder.path().join("results/modes.json").exists());
    fs::write(folder.path().join("station.csv"), "time_s,temperature_degc\n0,12.0\n0,18.0\n").unwrap();
    identify("1h").code(1).stderr(contains("station.csv, line 3").and(contains("does not rise")));
}

#[test]
fn modes_that_were_followed_are_not_left_behind_in_silence() {
    let folder = study(|text| text);
    let report = json(folder.path(), &["--direct", "--every", "6h"]);
    // One number says on the page and in the table whether a mode changes.
    for mode in report["trends"]["modes"].as_array().unwrap() {
        assert_eq!(mode["changes"], number(&mode["p_value_of_no_change"]) < 1e-3, "{mode}");
    }
    let again = json(folder.path(), &["--direct"]);
    assert!(again["trends"].is_null());
    let warnings = again["warnings"].to_string();
    assert!(warnings.contains("`--every 6h` follows them"), "{warnings}");
}

#[test]
fn what_the_analysis_was_chosen_by_and_what_more_record_would_bring_is_said() {
    let folder = study(|text| text.replace("band_hz = [0.05, 1.5]", ""));
    let report = json(folder.path(), &["--direct", "--frequency-within", "0.01", "--damping-within", "2"]);
    let reasons = report["segments"]["reasons"].as_array().unwrap();
    assert!(reasons[0].as_str().unwrap().starts_with("Band: 0.0"), "{reasons:?}");
    assert!(reasons[1].as_str().unwrap().contains("free of aliases"), "{reasons:?}");
    // The band holds the tower's first modes, and no more than can be told apart.
    let found = frequencies(&report);
    assert!((12..=18).contains(&found.len()) && (found[0] / 0.1085 - 1.0).abs() < 0.01, "{found:?}");
    for (needed, mode) in report["record_needed"].as_array().unwrap().iter().zip(modes(&report)) {
        let bound = number(&mode["frequency_std_bound_hz"]) / number(&mode["frequency_hz"]);
        let expected = number(&report["record_s"]) / 3600.0 * (bound / 1e-4).powi(2);
        assert!((number(&needed["frequency_best_h"]) / expected - 1.0).abs() < 1e-9);
        assert!(number(&needed["frequency_h"]) >= number(&needed["frequency_best_h"]));
        assert!(number(&needed["damping_h"]) > 12.0);
    }
    belfry_command()
        .arg("identify")
        .arg(folder.path())
        .args(["--direct", "--damping-within", "2"])
        .assert()
        .success()
        .stdout(contains("To determine every damping within 2 %, record").and(contains("Rate: ")));
    belfry_command().arg("identify").arg(folder.path()).args(["--damping-within", "0"]).assert().code(2);
}

#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all runs it")]
fn a_tower_that_is_sampled_fast_keeps_its_lowest_modes_without_a_band() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("fast");
    belfry_command().arg("init").arg(&place).args(["--template", "canton"]).assert().success();
    let file = place.join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    let text = text.replace("sampling_rate_hz = 50.0", "sampling_rate_hz = 100.0").replace("band_hz = [0.05, 1.5]", "");
    fs::write(&file, text).unwrap();
    belfry_command().arg("simulate").arg(&place).args(["--hours", "1", "--adopt"]).assert().success();
    let found = frequencies(&json(&place, &["--direct"]));
    // At 100 Hz the first line of a first look is at 0.098 Hz, and its lowest peaks cannot be told from its edge.
    assert!((found[0] / 0.110 - 1.0).abs() < 0.02 && (found[1] / 0.159 - 1.0).abs() < 0.02, "{found:?}");
}
