//! What the demo says, for every outcome that there can be.

use std::path::Path;

use super::*;
use crate::diagnose::{Discrepancy, Estimate, GoodnessOfFit, ModeMisfit, Part, Probabilities, Unexplained};
use crate::study::template;

fn beam() -> BeamTable {
    BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap()
}

/// A candidate with these odds that leaves misfit of this probability.
fn candidate(name: &str, log_bayes_factor: f64, p_value: f64) -> CandidateReport {
    let (effect, place) = name.split_once('@').map_or((name, None), |(kind, place)| (kind, Some(place.to_owned())));
    CandidateReport {
        effect: effect.to_owned(),
        r#where: place,
        parameters: vec![Estimate {
            name: "mass".to_owned(),
            value: 7.9e6,
            std: Some(2e5),
            unit: "kg".to_owned(),
            typical_sizes: None,
        }],
        log_bayes_factor: Some(log_bayes_factor),
        prior_odds: Some(1.0),
        probability: None,
        chi_squared: 100.0,
        p_value,
        errors_left: None,
        admissible: true,
        where_std_m: None,
        near: Vec::new(),
    }
}

fn diagnosis(verdict: Verdict, best: &[&str], ambiguous: &[&str], candidates: Vec<CandidateReport>) -> Diagnosis {
    let p_value = if verdict == Verdict::Unknown { 1e-9 } else { 0.4 };
    let test = GoodnessOfFit { chi_squared: 100.0, degrees_of_freedom: 90, p_value, worst: Part::All };
    let odd = ModeMisfit { measured: 7, measured_hz: 0.5, frequency_error_percent: 3.0, mean_square: 12.0 };
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    Diagnosis {
        verdict,
        candidates,
        best: names(best),
        ambiguous: if ambiguous.is_empty() { Vec::new() } else { vec![names(ambiguous)] },
        next_measurement: None,
        goodness_of_fit: test,
        discrepancy: Discrepancy::default(),
        probabilities: Probabilities::default(),
        elsewise: Vec::new(),
        partial: None,
        present: test,
        present_beside_best: None,
        unexplained: Unexplained {
            by_mode: vec![odd],
            by_sensor: Vec::new(),
            by_height: Vec::new(),
            by_group: Vec::new(),
        },
        explained: Vec::new(),
        effects: Vec::new(),
        joint: None,
        fingerprints: None,
        reason: None,
        warnings: Vec::new(),
    }
}

/// The ending where 8e6 kg were hidden at 300 m.
fn ending(diagnosis: &Diagnosis) -> Ending {
    let (effect, beam) = ("added-mass@300m=8e6".parse().unwrap(), beam());
    Ending::of(&Hidden { effect: &effect, beam: &beam }, diagnosis, None)
}

fn said(ending: &Ending) -> String {
    ending.sentences.join("\n")
}

#[test]
fn an_effect_that_is_named_is_right_or_wrong() {
    let right =
        ending(&diagnosis(Verdict::Effect, &["added-mass@300m"], &[], vec![candidate("added-mass@300m", 532.0, 0.4)]));
    assert!(right.right && right.likeness == Some(Likeness::Same));
    assert!(said(&right).contains("named added-mass@300m: right."), "{}", said(&right));
    assert!(said(&right).contains("mass fitted 7.90e6 ± 2.00e5 kg, true 8.00e6 kg (0.5 standard deviations off)"));

    let candidates = vec![candidate("p-delta", 40.0, 0.3), candidate("added-mass@310m", 20.0, 0.2)];
    let wrong = ending(&diagnosis(Verdict::Effect, &["p-delta"], &[], candidates));
    assert!(!wrong.right && wrong.rank_of_hidden == Some(2));
    assert!(said(&wrong).contains("named p-delta: wrong. What was hidden is number 2"), "{}", said(&wrong));

    let absent = ending(&diagnosis(Verdict::Effect, &["p-delta"], &[], vec![candidate("p-delta", 40.0, 0.3)]));
    assert!(said(&absent).contains("What was hidden is not among"), "{}", said(&absent));
}

#[test]
fn a_place_is_right_in_the_same_segment_or_near_and_wrong_far_off() {
    let beam = beam();
    let segment = beam.segments().iter().find(|s| s.z_bottom_m < 300.0 && 300.0 < s.z_top_m).unwrap();
    let near_m = segment.z_top_m + 5.0;
    for (found_m, words) in [
        ((300.0 + segment.z_top_m) / 2.0, "right, in the same segment of the beam ("),
        (near_m, "from the true height."),
        (500.0, "wrong."),
    ] {
        let name = format!("added-mass@{found_m}m");
        let ending = ending(&diagnosis(Verdict::Effect, &[&name], &[], vec![candidate(&name, 532.0, 0.4)]));
        assert!(said(&ending).contains(words), "{found_m}: {}", said(&ending));
    }
}

#[test]
fn of_several_that_cannot_be_told_apart_the_right_one_is_pointed_at() {
    let candidates = || vec![candidate("p-delta", 40.0, 0.3), candidate("added-mass@300m", 39.0, 0.3)];
    let second = ending(&diagnosis(Verdict::Ambiguous, &["p-delta"], &["p-delta", "added-mass@300m"], candidates()));
    assert!(!second.right && said(&second).contains("put p-delta first"), "{}", said(&second));
    assert!(said(&second).contains(": added-mass@300m is right."));
    let first =
        ending(&diagnosis(Verdict::Ambiguous, &["added-mass@300m"], &["added-mass@300m", "p-delta"], candidates()));
    assert!(first.right && said(&first).contains(": added-mass@300m is right."), "{}", said(&first));
    let none = ending(&diagnosis(Verdict::Ambiguous, &["p-delta"], &["p-delta", "mass-scale"], candidates()));
    assert!(said(&none).contains("none of them is what was hidden. What was hidden is number 2"), "{}", said(&none));
}

#[test]
fn an_unknown_verdict_says_why_and_what_was_ranked() {
    let first = ending(&diagnosis(Verdict::Unknown, &[], &[], vec![candidate("added-mass@300m", 532.0, 1e-9)]));
    let words = said(&first);
    assert!(words.contains("ranked added-mass@300m first (ln B = +532.0), which is right."), "{words}");
    assert!(words.contains("verdict unknown") && words.contains("p < 0.0001; mode 7 at 0.5000 Hz"), "{words}");
    assert!(!words.contains("uncertain") && !first.right, "{words}");

    let candidates = vec![candidate("p-delta", 540.0, 1e-9), candidate("added-mass@300m", 532.0, 1e-9)];
    let second = ending(&diagnosis(Verdict::Unknown, &[], &[], candidates));
    assert!(said(&second).contains("ranked p-delta first, which is wrong, but did not name it"), "{}", said(&second));
    assert!(said(&second).contains("What was hidden is number 2"), "{}", said(&second));

    let nothing = ending(&diagnosis(Verdict::Unknown, &[], &[], vec![candidate("p-delta", 1.0, 1e-9)]));
    assert!(said(&nothing).contains("no single effect gains 20 to 1"), "{}", said(&nothing));
}

#[test]
fn only_an_adequate_model_leaves_the_effect_within_what_is_uncertain() {
    let adequate = ending(&diagnosis(Verdict::Adequate, &[], &[], vec![candidate("p-delta", 1.0, 0.4)]));
    assert!(said(&adequate).contains("explains this record without one (p = 0.4000), so what was hidden lies within"));
    assert_eq!(to_add(&diagnosis(Verdict::Adequate, &[], &[], vec![candidate("p-delta", 1.0, 0.4)])), None);
}

#[test]
fn what_explains_most_is_added_where_nothing_is_named() {
    let unknown = diagnosis(Verdict::Unknown, &[], &[], vec![candidate("added-mass@300m", 532.0, 1e-9)]);
    assert_eq!(to_add(&unknown).as_deref(), Some("added-mass@300m"));
    let mut impossible = candidate("added-mass@300m", 532.0, 1e-9);
    impossible.admissible = false;
    assert_eq!(to_add(&diagnosis(Verdict::Unknown, &[], &[], vec![impossible])), None);
}

#[test]
fn a_forced_line_is_right_within_a_percent_and_swapped_channels_in_either_order() {
    let beam = beam();
    for (hidden, found, is_right) in [
        ("harmonic@0.6hz", "harmonic@0.6004hz", true),
        ("harmonic@0.6hz", "harmonic@0.7hz", false),
        ("sensor-swap@11+12", "sensor-swap@12+11", true),
        ("sensor-swap@11+12", "sensor-swap@11+13", false),
    ] {
        let effect: Effect = hidden.parse().unwrap();
        let likeness = Hidden { effect: &effect, beam: &beam }.likeness(found);
        assert_eq!(likeness.is_some(), is_right, "{hidden} {found}");
    }
}
