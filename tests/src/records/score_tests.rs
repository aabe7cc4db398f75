//! Counts and judgements, on reports written by hand.

use nalgebra::DMatrix;
use serde_json::json;

use super::*;
use crate::records::case;

/// Modes at 1, 2 and 9 Hz of three channels. At 20 Hz the last one is too near half the sampling rate to be missed.
fn structure() -> Structure {
    Structure {
        frequencies_hz: vec![1.0, 2.0, 9.0],
        damping: vec![0.01; 3],
        shapes: DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.0, 0.5, 1.0, 0.0, -0.5, 0.0, 1.0]),
        places: vec![(10.0, 0.0), (20.0, 0.0), (30.0, 0.0)],
        levels: Vec::new(),
    }
}

/// What a case's score is after these answers.
fn judged(name: &str, signs: &[Sign], answers: &[Result<&Value, &str>]) -> CaseScore {
    let (case, structure) = (case(name).unwrap(), structure());
    let mut score = CaseScore::default();
    for (seed, answer) in (0..).zip(answers) {
        score.judge(&Recorded { case, seed, structure: &structure, signs }, *answer);
    }
    score
}

/// A mode of `modes.json`; a component is its value and its deviation.
fn mode(frequency_hz: f64, stds: [Option<f64>; 2], shape: [(f64, Option<f64>); 3]) -> Value {
    let part = |(at, (re, std)): (usize, (f64, Option<f64>))| json!({"point": (at + 1).to_string(), "re": re, "im": 0.0, "std": std});
    let shape: Vec<Value> = shape.into_iter().enumerate().map(part).collect();
    json!({
        "frequency_hz": frequency_hz,
        "frequency_std_hz": stds[0],
        "damping_ratio": 0.012,
        "damping_ratio_std": stds[1],
        "shape": shape,
    })
}

fn missed(score: &CaseScore) -> Vec<usize> {
    score.modes.iter().map(|mode| mode.missed).collect()
}

#[test]
fn errors_are_counted_in_stated_deviations_and_what_is_no_mode_is_invented() {
    let known = Some(0.1);
    let first = mode(1.004, [Some(0.002), Some(0.001)], [(1.0, known), (0.5, known), (-0.5, known)]);
    let other = mode(1.5, [known; 2], [(1.0, known), (0.0, known), (0.0, known)]);
    let score = judged("wind", &[], &[Ok(&json!({"modes": [first, other], "warnings": ["doubt"]}))]);
    assert_eq!(missed(&score), [0, 1, 0]);
    assert_eq!(score.invented_hz, [(0, 1.5)]);
    let found = &score.modes[0];
    assert!((found.frequency_z[0] - 2.0).abs() < 1e-9 && (found.damping_z[0] - 2.0).abs() < 1e-9);
    // The lower bound is 1 Hz · sqrt(0.01 / (2 π · 21600)).
    assert!((found.frequency_over_bound[0] - 0.004 / 2.714_5e-4).abs() < 0.01, "{:?}", found.frequency_over_bound);
    assert!(found.shape_z.iter().all(|z| z.abs() < 1e-9) && found.shape_z.len() == 2, "but of the largest");
    assert_eq!(score.warnings, ["seed 0: doubt"]);
}

#[test]
fn the_modes_of_a_refused_record_are_missed() {
    let score = judged("wind", &[], &[Err("too short"), Ok(&json!({}))]);
    assert_eq!(missed(&score), [2, 2, 0]);
    assert_eq!(score.refused, [(0, "too short".to_owned())]);
    let line = score.line();
    assert!(line.starts_with("all: 0 found, 4 missed, 0 invented;"), "{line}");
    assert!(line.ends_with("; 1 refused; 0.00 s and 0.00 s"), "{line}");
}

#[test]
fn what_stands_still_is_refused_rightly_where_no_modes_were_found() {
    let right = judged("still", &[], &[Err("no modes were found from 0.1 to 9 Hz")]);
    assert!(right.refused.is_empty() && right.modes.is_empty());
    assert!(!right.line().contains("refused"));
    let crashed = judged("still", &[], &[Err("the disk is full")]);
    assert!(crashed.line().contains("0 missed") && crashed.line().contains("; 1 refused;"), "{}", crashed.line());
}

#[test]
fn a_machine_is_not_told_where_the_record_is_refused() {
    // The fifth mode counts for these cases.
    let machine = case("tone-1").unwrap();
    let structure =
        Structure { frequencies_hz: vec![1.0; 5], damping: vec![0.01; 5], shapes: DMatrix::zeros(3, 5), ..structure() };
    let mut score = CaseScore::default();
    // A bandwidth, 2 · 0.01 of 1 Hz, above it.
    let [told, another] = [1.022, 1.03].map(|hz| json!({"harmonics": [{"frequency_hz": hz}]}));
    for answer in [Ok(&told), Ok(&another), Err("too short")] {
        score.judge(&Recorded { case: machine, seed: 0, structure: &structure, signs: &[] }, answer);
    }
    assert_eq!(score.machines, [1, 3]);
}

#[test]
fn what_has_no_deviation_is_counted_and_stays_in_the_mac() {
    let shape = [(1.0, Some(0.1)), (0.5, Some(0.1)), (0.0, None)];
    let found = mode(1.0, [Some(0.001), None], shape);
    let score = judged("wind", &[], &[Ok(&json!({"modes": [found]}))]);
    // (1 + 0.25)² / (1.5 · 1.25); without the third component it would be 1.
    assert!((score.modes[0].least_mac.unwrap() - 1.25 / 1.5).abs() < 1e-12);
    assert!(score.modes[0].whole.is_empty());
    let line = score.line();
    assert!(line.starts_with("all: 1 found, 1 missed"), "{line}");
    assert!(line.ends_with("; 2 of unknown deviation; 0.00 s and 0.00 s"), "{line}");
}

#[test]
fn a_fault_is_told_in_warnings_or_in_the_refusal() {
    let [reversed, exchanged] = ["channel 10 seems to be reversed", "channels 14 and 17 seem to be exchanged"];
    let report = |warnings: &[&str]| json!({"warnings": warnings});
    let signs = Fault::Miswired.signs(0);
    let (all, half) = (report(&[reversed, exchanged]), report(&[reversed]));
    let refusal = format!("error: too short\n  {reversed}\n  {exchanged}");
    let score = judged("miswired", &signs, &[Ok(&all), Ok(&half), Err(&refusal), Err("too short")]);
    assert_eq!(score.faults, [2, 4]);
    let line = score.line();
    assert!(line.ends_with("; fault told in 2 of 4 records; 2 refused; 0.00 s and 0.00 s"), "{line}");
    // No fault, nothing to tell.
    assert!(!judged("wind", &[], &[Ok(&all)]).line().contains("fault"));
}
