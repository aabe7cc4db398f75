//! A model of OpenSees, run here: K and M of a concrete frame of 2304 degrees of freedom, a group a storey, and modes of a truth in which one
//! storey is softer.

use std::process::Command;

use belfry_tests::repository;

use crate::said::json;

/// The storey that the script softens is named, and its value met within three of its deviations; rows are numbered as the script's table has them.
#[test]
#[cfg_attr(not(opensees), ignore = "installs OpenSees: ./test --all runs it")]
fn a_frame_of_opensees_is_read_reduced_and_diagnosed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    let script = repository().join("tests/foreign/opensees_frame.py");
    let run = Command::new("python3").arg(script).arg(path).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    // `truth: storey1 +0.1 %, storey2 +2.7 %, ...`
    let said = String::from_utf8(run.stdout).unwrap();
    let truth = said.split("storey5 ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    let truth = truth.parse::<f64>().unwrap() / 100.0;
    let comparison = json(&["compare", path]);
    assert_eq!(comparison["pairs"].as_array().unwrap().len(), 12);
    let warnings = comparison["warnings"].to_string();
    assert!(!warnings.contains("numbered") && !warnings.contains("masses in t"), "{warnings}");
    let diagnosis = json(&["diagnose", path]);
    assert_eq!(diagnosis["verdict"], "effect", "{diagnosis}");
    let best = &diagnosis["candidates"][0];
    assert_eq!((best["effect"].as_str(), best["where"].as_str()), (Some("group"), Some("storey5")), "{best}");
    let value = &best["parameters"][0];
    let (value, std) = (value["value"].as_f64().unwrap(), value["std"].as_f64().unwrap());
    assert!((value - truth).abs() < 3.0 * std, "{value} ± {std}, not {truth}");
}
