//! Diagnosis: derivatives are those of what is fitted, hidden effects are found, sound models are left alone.

use std::path::Path;

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::compare::ModelView;
use crate::measured::{MeasuredMode, MeasuredShape};
use crate::model::effect::Effect;
use crate::model::{BeamTable, Structure};
use crate::study::{Model, Sensor, Study, template};

fn study() -> (Structure, Model, Vec<Sensor>) {
    let beam = BeamTable::from_reader(template::CANTON_BEAM.as_bytes(), Path::new("beam.csv")).unwrap();
    let study = Study::from_text(template::CANTON_STUDY, Path::new("canton")).unwrap();
    (Structure::new(beam), study.model.clone().unwrap(), study.sensors())
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// The first modes of a structure with effects, measured with relative deviations of 0.05 % on frequencies and 0.3 % of
/// the length on shapes.
fn measured(structure: &Structure, sensors: &[Sensor], modes: usize, random: &mut ChaCha8Rng) -> Vec<MeasuredMode> {
    let view = ModelView::of(&structure.assemble(), sensors).unwrap();
    let one = |mode: usize| {
        let shape = DVector::from_column_slice(view.shape(mode)).normalize();
        let imaginary = view.imaginary(mode).map_or_else(
            || DVector::zeros(shape.len()),
            |imaginary| imaginary / DVector::from_column_slice(view.shape(mode)).norm(),
        );
        let frequency_hz = view.modes.frequency_hz[mode];
        MeasuredMode {
            number: mode + 1,
            frequency_hz: frequency_hz * (1.0 + 5e-4 * normal(random)),
            frequency_std_hz: Some(5e-4 * frequency_hz),
            damping_ratio: None,
            shape: Some(MeasuredShape {
                sensors: (0..shape.len()).collect(),
                imaginary: Some(imaginary.map(|value| value + 3e-3 * normal(random))),
                stds: Some(DVector::from_element(shape.len(), 3e-3)),
                values: shape.map(|value| value + 3e-3 * normal(random)),
            }),
        }
    };
    (0..modes).map(one).collect()
}

fn effects(words: &[&str]) -> Vec<Effect> {
    words.iter().map(|word| word.parse().unwrap()).collect()
}

/// The Jacobian against central differences, background and every kind of effect, at a point away from nothing.
#[test]
fn derivatives_are_those_of_the_differences() {
    let (structure, model, sensors) = study();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let modes = measured(&structure, &sensors, 12, &mut random);
    let words = [
        "base-rotation=flexibility_x=3e-15,flexibility_y=2e-15",
        "added-mass@350m=1e6",
        "connection-flexibility@443.6m=1e-13",
        "stiffness-loss@150m=0.2",
        "mass-eccentricity=x=0.3,y=-0.2",
        "outrigger@200m=1e12",
        "sensor-gain@ch07=1.1",
        "sensor-rotation@node3=4",
        "clock-offset@node4=0.03",
        "p-delta=0.4",
    ];
    let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
    let effects = effects(&words);
    let numbers = DVector::from_fn(problem.background.size(), |_, _| 0.3 * normal(&mut random));
    let state = problem.state(effects.clone(), numbers.clone(), None).unwrap();
    let modes = state.modes.len();
    let close = |exact: &DVector<f64>, slope: &DVector<f64>, name: &str| {
        // How the phases of a late clock follow the structure is left out.
        let rows = if name.starts_with("clock") { exact.len() } else { modes };
        let error = (exact.rows(0, rows) - slope.rows(0, rows)).norm() / exact.rows(0, rows).norm();
        // One-sided differences, and the weight that the background's mass has on what is below it.
        assert!(error < 0.05, "{name}: off by {error:.3} of {:.3e}", exact.norm());
    };
    let by_background = state.by_background(&problem);
    for index in 0..numbers.len() {
        let at = |step: f64| {
            let mut moved = numbers.clone();
            moved[index] += step;
            problem.state(effects.clone(), moved, None).unwrap().differences()
        };
        let slope = (at(1e-3) - at(-1e-3)) / 2e-3;
        if slope.norm() > 1e-2 {
            close(&slope, &by_background.column(index).into_owned(), &format!("background {index}"));
        }
    }
    for knob in problem.all_knobs(&state) {
        let at = |units: f64| {
            let value = state.value(&knob) + units * knob.scale;
            let moved = super::state::with_values(&effects, &[knob], &[value]);
            problem.state(moved, numbers.clone(), None).unwrap().differences()
        };
        let slope = (at(1e-3) - at(-1e-3)) / 2e-3;
        close(&slope, &state.by_knob(&problem, &knob).unwrap(), words[knob.effect]);
    }
}
