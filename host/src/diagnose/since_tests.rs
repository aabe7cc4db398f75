//! Diagnosis of a change: the model is wrong before and now, and the change is found all the same.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::steps::Setting;
use super::testing::{measured, scattered, study};
use super::{ChangeDiagnosis, ChangeVerdict, Direction, Options, diagnose_change};
use crate::change::changes;
use crate::model::effect::Effect;
use crate::progress::UNHEARD;

fn effects(words: &[&str]) -> Vec<Effect> {
    words.iter().map(|word| word.parse().unwrap()).collect()
}

/// The tower whose segments scatter as far as the study says, on a foundation that its model has only where it is in `known`; measured with
/// the effects before and with those now.
fn since(known: &[&str], before: &[&str], now: &[&str], seed: u64) -> ChangeDiagnosis {
    let (structure, model, sensors) = study();
    let truth = scattered(&structure, &model, 1.0, seed);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut measure = |words: &[&str]| {
        let structure = truth.clone().and(&effects(words)).unwrap();
        measured(&structure, &sensors, 13, &mut random)
    };
    let (before, now) = (measure(before), measure(now));
    let p_value = changes(&before, &now).test.unwrap().p_value;
    let setting = Setting { bare: &structure, model: &model, sensors: &sensors, measured: &before, tally: &UNHEARD };
    diagnose_change(&setting, &effects(known), &now, p_value, &Options::default()).unwrap()
}

/// The height of what is named.
fn height_m(diagnosis: &ChangeDiagnosis) -> f64 {
    diagnosis.candidates[0].r#where.as_ref().unwrap().trim_end_matches('m').parse().unwrap()
}

const FOUNDATION: &str = "base-rotation=6e-15";

#[test]
fn a_loss_is_found_at_its_height_by_a_model_that_is_wrong() {
    let found = since(&[], &[FOUNDATION, "p-delta=1"], &[FOUNDATION, "p-delta=1", "stiffness-loss@285m=0.25"], 5);
    assert_eq!((found.verdict, found.direction), (ChangeVerdict::Effect, Direction::Come), "{:?}", found.candidates[0]);
    assert_eq!(found.candidates[0].effect, "stiffness-loss");
    assert!((height_m(&found) - 285.0).abs() < 15.0, "{:?}", found.best);
    let value = &found.candidates[0].parameters[0];
    assert!((value.value - 0.25).abs() < 4.0 * value.std.unwrap() + 0.05, "{value:?}");
    // What the effect makes of each frequency is what was measured, to the errors of both and to a tenth by which a wrong model answers it.
    for mode in &found.predicted {
        let left = (mode.predicted_percent.unwrap() - mode.change_percent).abs();
        assert!(left < 0.2 + 0.1 * mode.change_percent.abs(), "{mode:?}");
    }
}

#[test]
fn what_has_not_changed_is_unchanged_however_wrong_the_model() {
    are_unchanged(20..21);
}

fn are_unchanged(seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let found = since(&[], &[FOUNDATION, "p-delta=1"], &[FOUNDATION, "p-delta=1"], seed);
        assert_eq!(found.verdict, ChangeVerdict::Unchanged, "{seed}: {:?}", found.candidates.first());
        assert!(found.best.is_empty() && found.probabilities.unchanged > 0.5);
        // The model itself fails, or needs its tolerance.
        assert!(found.predicted.iter().all(|mode| mode.predicted_percent.is_none()));
    }
}

/// A mass that is taken off is no mass that comes.
#[test]
fn what_has_gone_is_found_from_now_to_before() {
    let found = since(&[], &[FOUNDATION, "added-mass@334m=2e6"], &[FOUNDATION], 7);
    assert_eq!(found.direction, Direction::Gone, "{:?} {:?}", found.verdict, found.candidates[0]);
    assert_eq!(found.candidates[0].effect, "added-mass");
    assert!((height_m(&found) - 334.0).abs() < 15.0, "{:?}", found.best);
    // Frequencies have risen.
    assert!(found.predicted.iter().all(|mode| mode.predicted_percent.unwrap() > -0.01), "{:?}", found.predicted);
}

/// More of what the tests above try.
mod long {
    use super::*;

    /// An effect that the model has grows: what is named is the increase.
    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn an_effect_in_the_model_that_has_grown_is_found_with_its_increase() {
        let found = since(&[FOUNDATION], &[FOUNDATION], &["base-rotation=9e-15"], 9);
        assert_eq!(found.best, ["base-rotation"], "{:?}", found.candidates[0]);
        let value = &found.candidates[0].parameters[0];
        assert!((value.value - 3e-15).abs() < 4.0 * value.std.unwrap() + 0.3e-15, "{value:?}");
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn a_sensor_that_was_replaced_is_no_damage() {
        let found = since(&[], &[FOUNDATION], &[FOUNDATION, "sensor-gain@ch09=1.1"], 11);
        assert_eq!(found.best, ["sensor-gain@ch09"], "{:?}", found.candidates[0]);
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn more_that_have_not_changed_are_unchanged() {
        are_unchanged(21..26);
    }
}
