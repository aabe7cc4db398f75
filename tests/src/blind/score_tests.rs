//! Right and wrong, on plain data.

use super::*;
use crate::blind::answer::Parameter;

fn record(
    category: Category,
    effects: Vec<TrueEffect>,
    verdict: &str,
    best: &[&str],
    ambiguous: &[&str],
) -> CaseRecord {
    let names = |names: &[&str]| names.iter().map(|name| Name::parse(name)).collect::<Vec<_>>();
    CaseRecord {
        index: 0,
        structure: "chimney",
        category,
        truth: String::new(),
        effects,
        outside: None,
        height_m: 100.0,
        world: World::ASSUMED,
        shift: None,
        honesty: Honesty::default(),
        error_before: 5.0,
        error_after: None,
        visibility: None,
        floor: 1.0,
        mac_before: 0.9,
        diagnosis: Some(Diagnosis {
            verdict: verdict.to_owned(),
            best: names(best),
            ambiguous: names(ambiguous),
            p_value: 0.5,
            probability: 0.9,
            parameters: vec![Parameter { name: "mass".to_owned(), value: 12.0, std: 2.0 }],
        }),
        without: None,
        found: None,
        generation_s: 0.0,
        identify_s: 0.0,
        diagnose_s: 0.0,
        failures: Vec::new(),
    }
}

fn effect(kind: &'static str, place: Place) -> TrueEffect {
    TrueEffect { kind, place, parameters: vec![("mass", 9.0)] }
}

#[test]
fn twins_are_one_and_heights_are_free() {
    let scale = || vec![effect("mass-scale", Place::Whole)];
    let twin = record(Category::Single, scale(), "ambiguous", &["stiffness-scale"], &["mass-scale", "base-rotation"]);
    assert_eq!((twin.first_right(), twin.in_set()), (Some(true), Some(true)));
    let set = twin.diagnosis.as_ref().map(|d| named_set(d).len());
    assert_eq!(set, Some(2));
    assert!(twin.parameter_z().is_empty(), "the twin's parameter is another");

    let turned = || vec![effect("axis-rotation", Place::Whole)];
    assert_eq!(record(Category::Single, turned(), "effect", &["sensor-rotation"], &[]).first_right(), Some(true));
    assert_eq!(
        record(Category::Single, turned(), "effect", &["sensor-rotation@node1"], &[]).first_right(),
        Some(false)
    );

    let mass = || vec![effect("added-mass", Place::Height(40.0))];
    let far = record(Category::Single, mass(), "effect", &["added-mass@70.5m"], &[]);
    assert_eq!((far.first_right(), far.location_error_m()), (Some(true), Some(30.5)));
    assert_eq!(far.parameter_z(), [1.5]);
    let second = record(Category::Single, mass(), "ambiguous", &["stiffness-loss@40m"], &["added-mass@40m"]);
    assert_eq!((second.first_right(), second.in_set()), (Some(false), Some(true)));
    // An effect that is named beside the verdict that nothing is wrong does not count.
    assert_eq!(record(Category::Single, mass(), "adequate", &["added-mass@40m"], &[]).first_right(), Some(false));
}

#[test]
fn sensors_must_be_the_right_ones() {
    let swap = || vec![effect("sensor-swap", Place::Label("ch04+ch05".to_owned()))];
    assert_eq!(record(Category::Single, swap(), "effect", &["sensor-swap@ch05+ch04"], &[]).first_right(), Some(true));
    assert_eq!(record(Category::Single, swap(), "effect", &["sensor-swap@ch05+ch06"], &[]).first_right(), Some(false));
}

#[test]
fn sound_and_unknown_structures_are_judged_by_the_verdict() {
    let said = |category, verdict| record(category, Vec::new(), verdict, &[], &[]);
    assert_eq!(said(Category::Nothing, "adequate").false_alarm(), Some(false));
    assert_eq!(said(Category::Nothing, "unknown").false_alarm(), Some(true));
    assert_eq!(said(Category::Outside, "unknown").known_unknown(), Some(true));
    assert_eq!(said(Category::Outside, "ambiguous").known_unknown(), Some(false));
    assert_eq!(said(Category::Outside, "unknown").first_right(), None);
}

#[test]
fn pairs_are_found_at_their_places() {
    let pair = vec![effect("added-mass", Place::Height(40.0)), effect("base-rotation", Place::Whole)];
    let mut record = record(Category::Pair, pair, "effect", &[], &[]);
    assert_eq!(record.both_found(), None);
    let found = |names: &[&str]| Some(names.iter().map(|name| Name::parse(name)).collect::<Vec<_>>());
    record.found = found(&["base-rotation", "added-mass@48m"]);
    assert_eq!(record.both_found(), Some(true));
    record.found = found(&["base-rotation", "added-mass@60m"]);
    assert_eq!(record.both_found(), Some(false));
    record.found = found(&["added-mass@40m"]);
    assert_eq!(record.both_found(), Some(false));
}

#[test]
fn an_error_has_fallen_to_a_tenth_or_to_the_scatter() {
    let mut record = record(Category::Single, Vec::new(), "effect", &[], &[]);
    for (after, fell) in [(0.4, true), (1.25, true), (1.4, false)] {
        record.error_after = Some(after);
        assert_eq!(record.error_fell(), Some(fell));
    }
}

#[test]
fn a_verdict_is_true_where_it_says_what_is_hidden() {
    let mass = || vec![effect("added-mass", Place::Height(50.0))];
    let pair = || vec![effect("added-mass", Place::Height(50.0)), effect("p-delta", Place::Whole)];
    let cases = [
        (Category::Nothing, vec![], "adequate", vec![], true),
        (Category::Nothing, vec![], "effect", vec!["added-mass@50m"], false),
        (Category::Single, mass(), "adequate", vec![], false),
        (Category::Single, mass(), "effect", vec!["added-mass@50m"], true),
        (Category::Single, mass(), "effect", vec!["p-delta"], false),
        (Category::Single, mass(), "unknown", vec![], false),
        (Category::Pair, pair(), "unknown", vec![], true),
        (Category::Pair, pair(), "effect", vec!["added-mass@50m"], false),
        (Category::Outside, vec![], "unknown", vec![], true),
    ];
    for (category, effects, verdict, best, is_true) in cases {
        assert_eq!(
            record(category, effects, verdict, &best, &[]).is_true(),
            Some(is_true),
            "{category:?} {verdict} {best:?}"
        );
    }
    let among = record(Category::Single, mass(), "ambiguous", &["p-delta"], &["added-mass@40m"]);
    assert_eq!(among.is_true(), Some(true));
}
