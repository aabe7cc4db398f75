//! Before anything is measured, a user asks which effect a measurement would find, how long it takes, and where one more sensor
//! helps.

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use serde_json::Value;

use crate::said::json;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// What a command that must fail with this status says.
fn refusal(arguments: &[&str], status: i32) -> String {
    let output = belfry_command().args(arguments).assert().code(status).stdout("").get_output().stderr.clone();
    let text = String::from_utf8(output).unwrap();
    assert!(!text.contains("panicked"), "{text}");
    text
}

const PLACES: &str = "channel,elevation_m,azimuth_deg,offset_x_m,offset_y_m
antenna,600,18,,
waist,280,108,3.5,-2
";

/// The Canton template, of which nothing was measured.
fn unmeasured(folder: &Path) -> String {
    let study = folder.join("canton").to_str().unwrap().to_owned();
    belfry_command().args(["init", &study, "--template", "canton"]).assert().success();
    fs::write(folder.join("places.csv"), PLACES).unwrap();
    study
}

#[test]
fn a_measurement_is_planned_before_it_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let study = unmeasured(folder.path());
    let places = folder.path().join("places.csv").to_str().unwrap().to_owned();
    let effect = ["plan", &study, "--effect", "added-mass@443.6m=6.5e5", "--hours", "24,1"];
    let plan = json(&[&effect[..], &["--places", &places]].concat());
    assert_eq!(plan["effect"], "added-mass@443.6m");
    assert_eq!((number(&plan["parameters"][0]["value"]), &plan["parameters"][0]["unit"]), (6.5e5, &Value::from("kg")));
    assert_eq!(plan["assumed"]["frequencies_hz"].as_array().unwrap().len(), 14);
    assert!(plan["rivals"].as_array().unwrap().iter().any(|rival| rival == "rotary-inertia"));
    let options = plan["options"].as_array().unwrap();
    assert_eq!(options.len(), 2);
    assert_eq!((&options[0]["added"], &options[0]["sensors"]), (&Value::from(Vec::<Value>::new()), &Value::from(20)));
    assert!(options[1]["sensors"] == 21 && ["antenna", "waist"].contains(&options[1]["added"][0].as_str().unwrap()));
    for option in options {
        let records = option["records"].as_array().unwrap();
        assert_eq!((number(&records[0]["hours"]), number(&records[1]["hours"])), (1.0, 24.0));
        for record in records {
            let [found, named] = ["probability_found", "probability_named"].map(|key| number(&record[key]));
            assert!((0.0..=found).contains(&named) && found <= 1.0, "{record}");
            assert!(record["strongest_rival"].is_string() && record["log_bayes_factor_over_rival"].is_number());
        }
        // An hour is too short for 650 t, a day is enough.
        assert!(number(&records[0]["probability_named"]) < 0.95 && number(&records[1]["probability_named"]) > 0.95);
        assert!((1.0..24.0).contains(&number(&option["shortest_hours"])) && option["obstacle"].is_null(), "{option}");
    }
    let stored: Value =
        serde_json::from_str(&fs::read_to_string(Path::new(&study).join("results/plan.json")).unwrap()).unwrap();
    assert_eq!(stored, plan);

    let said = belfry_command()
        .args(effect)
        .args(["--against", "stiffness-loss@430m", "--against", "p-delta"])
        .assert()
        .success();
    let said = String::from_utf8(said.get_output().stdout.clone()).unwrap();
    assert!(said.contains("stiffness-loss@430m") && said.contains("With 20 sensors:"), "{said}");
    // 500 t are seen, and are what the tolerance looks like: no record makes a finding of them.
    let hidden = json(&["plan", &study, "--effect", "added-mass@443.6m=5e5", "--hours", "24"]);
    let (record, obstacle) = (&hidden["options"][0]["records"][0], &hidden["options"][0]["obstacle"]);
    assert!(number(&record["probability_found"]) > 0.95 && number(&record["probability_named"]) < 0.6, "{record}");
    assert_eq!(obstacle["kind"], "tolerance", "{hidden}");
    assert!((5e5..6.5e5).contains(&number(&obstacle["findable"]["value"])), "{obstacle}");
    let tiny = json(&["plan", &study, "--effect", "added-mass@443.6m=1e4", "--hours", "1"]);
    let obstacle = &tiny["options"][0]["obstacle"];
    assert_eq!(obstacle["kind"], "tolerance", "{tiny}");
    // The longest record, of a month, is thirty times as long as one that finds 650 t.
    assert!(number(&obstacle["findable"]["value"]) > 3e4, "{obstacle}");
    let twins = json(&["plan", &study, "--effect", "mass-scale=-0.1", "--hours", "1", "--against", "stiffness-scale"]);
    assert_eq!(twins["options"][0]["obstacle"]["kind"], "twins", "{twins}");
}

#[test]
fn what_cannot_be_meant_is_refused_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let study = unmeasured(folder.path());
    let places = folder.path().join("places.csv").to_str().unwrap().to_owned();
    let mass = ["plan", &study, "--effect", "added-mass@443.6m=5e5"];
    for (table, expected) in [
        (PLACES.replace("280", "high"), "line 3, column `elevation_m`: `high` where a height in metres"),
        (PLACES.replace("108", "north"), "line 3, column `azimuth_deg`: `north`"),
        (PLACES.replace("-2", "left"), "line 3, column `offset_y_m`: `left`"),
        (PLACES.replace("waist", "antenna"), "line 3, column `channel`: `antenna`"),
        (PLACES.replace("waist", "01"), "line 3, column `channel`: `01`"),
        (PLACES.replace("elevation_m", "height"), "line 1: the column `height` is unknown"),
        ("channel,elevation_m\na,3\n".to_owned(), "line 1: the column `azimuth_deg` is missing"),
        ("channel,elevation_m,azimuth_deg\na,3\n".to_owned(), "line 2: not a CSV row"),
        ("channel,elevation_m,azimuth_deg\n".to_owned(), "no places"),
        (PLACES.replace("600", "900"), "antenna"),
    ] {
        fs::write(&places, &table).unwrap();
        let error = refusal(&[&mass[..], &["--places", &places]].concat(), 1);
        assert!(error.contains(expected), "{table}: {error}");
    }
    for (arguments, status, expected) in [
        (vec!["--effect", "added-mas@443.6m=5e5"], 2, "added-mass"),
        (vec!["--effect", "added-mass@443.6m"], 2, "added-mass"),
        (vec!["--effect", "added-mass@900m=5e5"], 1, "the beam stands from -10 m to 618 m"),
        (vec!["--effect", "sensor-gain@ch99=1.2"], 1, "the study has no channel 99"),
        (vec!["--effect", "harmonic@0.8hz"], 1, "does not show in how frequencies and shapes follow it"),
        (vec!["--effect", "mass-scale=0.1", "--against", "mass-scale"], 1, "is the effect itself"),
        (vec!["--effect", "mass-scale=0.1", "--hours", "1,soon"], 2, "expected hours, from 0.1 to 720"),
        (vec!["--effect", "mass-scale=0.1", "--add", "2"], 2, "--places"),
        (vec!["--effect", "mass-scale=0.1", "--damping-ratio", "2"], 2, "a damping ratio"),
    ] {
        let error = refusal(&[&["plan", study.as_str()][..], &arguments[..]].concat(), status);
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
}
