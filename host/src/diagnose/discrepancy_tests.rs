//! A model that misses modes for reasons of its own is sound all the same, and effects must beat what it misses.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::testing::{measured, normal, scattered, study};
use super::*;
use crate::model::effect::Effect;

/// The tower's modes, where the structure misses its model's frequencies and shapes by these shares at random, and has an effect.
fn missed(word: Option<&str>, [by_frequency, by_shape]: [f64; 2], seed: u64) -> Diagnosis {
    let (structure, model, sensors) = study();
    let effects: Vec<Effect> = word.iter().map(|word| word.parse().unwrap()).collect();
    let truth = scattered(&structure, &model, 0.5, seed).and(&effects).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut modes = measured(&truth, &sensors, 13, &mut random);
    for mode in &mut modes {
        mode.frequency_hz *= 1.0 + by_frequency * normal(&mut random);
        let shape = mode.shape.as_mut().unwrap();
        let largest = shape.values.amax();
        shape.values.iter_mut().for_each(|value| *value += by_shape * largest * normal(&mut random));
    }
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap()
}

#[test]
fn what_a_model_misses_is_found_and_is_no_effect() {
    are_missed_and_no_effect(1..2);
}

fn are_missed_and_no_effect(seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let diagnosis = missed(None, [0.008, 0.01], seed);
        assert!(diagnosis.best.is_empty(), "seed {seed}: {:?}", diagnosis.candidates.first());
        let Discrepancy { frequency, shape, .. } = diagnosis.discrepancy;
        assert!((0.0005..0.02).contains(&frequency) && (0.006..0.015).contains(&shape), "{:?}", diagnosis.discrepancy);
    }
}

#[test]
fn an_effect_beats_what_the_model_misses() {
    let diagnosis = missed(Some("added-mass@443.6m=5e6"), [0.004, 0.01], 5);
    assert_eq!(diagnosis.verdict, Verdict::Effect, "{:?}", diagnosis.candidates.first());
    assert!(diagnosis.best[0].starts_with("added-mass@4"), "{:?}", diagnosis.best);
    let mass = &diagnosis.candidates[0].parameters[0];
    assert!((mass.value - 5e6).abs() < 3.0 * mass.std.unwrap(), "{mass:?}");
    assert!(diagnosis.discrepancy.frequency > 0.001, "{:?}", diagnosis.discrepancy);
}

/// Where nothing is missed, nothing is found missing; that segments scatter half as far as stated is.
#[test]
fn without_a_discrepancy_none_is_found() {
    let diagnosis = missed(None, [0.0, 0.0], 7);
    assert_eq!(diagnosis.verdict, Verdict::Adequate);
    let scatter = diagnosis.discrepancy.scatter;
    assert_eq!(diagnosis.discrepancy, Discrepancy { scatter, ..Discrepancy::NONE });
    assert!((0.4..0.9).contains(&scatter), "{scatter}");
}

/// More of what the tests above try.
mod long {
    use super::*;

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn more_than_a_model_of_its_kind_can_miss_is_unknown() {
        let diagnosis = missed(None, [0.06, 0.1], 6);
        assert_eq!(diagnosis.verdict, Verdict::Unknown);
    }

    #[test]
    #[ignore = "long: ./test --all runs it"]
    fn what_more_models_miss_is_found_and_is_no_effect() {
        are_missed_and_no_effect(2..6);
    }
}
