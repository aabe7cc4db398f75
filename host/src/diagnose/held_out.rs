//! How well a model predicts what it was not fitted to: a sensor left out, a mode left out.
//!
//! Misfit falls with every effect that is added, right or wrong; the error on what was left out falls only with effects that
//! are real.

use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::fit::Fit;
use super::problem::Problem;
use super::state::State;
use crate::model::effect::{Effect, PlaceKind, Where};

/// Errors on what was left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Root mean square over modes and sensors, each left out in turn, of predicted less measured motion, in percent of the
    /// measured; `None` where no shape, or too few sensors, were measured.
    pub sensor_error_percent: Option<f64>,
    /// Mean absolute error of the frequency of each mode, left out in turn.
    pub mode_error_percent: Option<f64>,
}

/// Leaves out each sensor and each mode in turn, refits the effects of `fit`, and predicts what was left out from the model
/// with its effects and without the fitted scatter.
pub fn held_out(problem: &Problem, fit: &Fit) -> HeldOut {
    let count = problem.sensors.len() + problem.measured().len();
    problem.tally.stage("sensors and modes left out in turn", count);
    let of_sensor = |sensor: usize| match is_predictable(problem, fit, sensor) {
        true => sensor_squares(problem, fit, sensor),
        false => own_squares(problem, fit, sensor),
    };
    let of_sensor = |sensor: usize| problem.tally.piece(|| of_sensor(sensor));
    let squares: Vec<(f64, f64)> = (0..problem.sensors.len()).into_par_iter().filter_map(of_sensor).collect();
    let (error, measured) = squares.iter().fold((0.0, 0.0), |sum, square| (sum.0 + square.0, sum.1 + square.1));
    let of_mode = |mode: usize| problem.tally.piece(|| mode_error(problem, fit, mode));
    let modes: Vec<f64> = (0..problem.measured().len()).into_par_iter().filter_map(of_mode).collect();
    HeldOut {
        sensor_error_percent: (measured > 0.0).then(|| 100.0 * (error / measured).sqrt()),
        mode_error_percent: (!modes.is_empty()).then(|| 100.0 * modes.iter().sum::<f64>() / modes.len() as f64),
    }
}

/// Whether a sensor can be predicted from the others: not where an effect belongs to that sensor alone.
fn is_predictable(problem: &Problem, fit: &Fit, sensor: usize) -> bool {
    let sensor = &problem.sensors[sensor];
    let alone = |node: u16| problem.sensors.iter().filter(|other| other.node == node).count() == 1;
    fit.effects().iter().all(|effect| match effect.place() {
        Some(Where::Channels(channels)) => !channels.contains(&sensor.channel),
        Some(&Where::Node(node)) => node != sensor.node || !alone(node),
        _ => effect.of_kind().place() != PlaceKind::Channel,
    })
}

fn refitted(problem: &Problem, fit: &Fit) -> Option<Vec<Effect>> {
    if fit.knobs.is_empty() {
        return Some(fit.effects().to_vec());
    }
    // With one number less the best values are near those with all: squares need not bring them there first.
    Some(problem.refitted(fit).ok()?.effects().to_vec())
}

/// Squared error and squared measured motion at a sensor over all modes: each measured shape at the other sensors says how
/// much of the model's shape (of those of close modes together) there is, and that says the motion at the sensor: eq. 16 of
/// Lei, Wang, Shen (2012), mode by mode, which few sensors determine better than all modes at once.
fn sensor_squares(problem: &Problem, fit: &Fit, sensor: usize) -> Option<(f64, f64)> {
    let effects = refitted(&problem.without_sensors(&[sensor]), fit)?;
    let state = problem.state_without_scatter(&effects).ok()?;
    total((0..problem.measured().len()).filter_map(|mode| squares(problem, &state, mode, sensor)))
}

/// The same of a sensor with an effect of its own, which the other modes determine: each mode is left out in turn.
fn own_squares(problem: &Problem, fit: &Fit, sensor: usize) -> Option<(f64, f64)> {
    let of_mode = |mode: usize| {
        let effects = refitted(&problem.without_mode(mode)?, fit)?;
        squares(problem, &problem.state_without_scatter(&effects).ok()?, mode, sensor)
    };
    total((0..problem.measured().len()).filter_map(of_mode))
}

/// Squared error and squared measured motion of a mode at a sensor that is predicted from the others.
fn squares(problem: &Problem, state: &State, mode: usize, sensor: usize) -> Option<(f64, f64)> {
    let shape = problem.measured[mode].shape.as_ref()?;
    let at = shape.sensors.iter().position(|other| *other == sensor)?;
    let kept: Vec<usize> = (0..shape.sensors.len()).filter(|&row| row != at).collect();
    let rows: Vec<usize> = kept.iter().map(|&row| shape.sensors[row]).collect();
    let models: Vec<usize> =
        problem.close[mode].iter().filter_map(|&close| Some(state.pairs.get(close)?.model)).collect();
    let shapes = state.model.view.at_sensors.select_columns(&models);
    let seen: DMatrix<f64> = shapes.select_rows(&rows);
    let measured = shape.values.normalize();
    let share = seen.svd(true, true).solve(&measured.select_rows(&kept), 1e-6).ok()?;
    let predicted = (shapes.row(sensor) * share)[0];
    Some(((predicted - measured[at]).powi(2), measured[at].powi(2)))
}

fn total(squares: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    let (error, measured) = squares.fold((0.0, 0.0), |sum, square| (sum.0 + square.0, sum.1 + square.1));
    (measured > 0.0).then_some((error, measured))
}

/// Relative error of the frequency of a mode that was left out.
fn mode_error(problem: &Problem, fit: &Fit, mode: usize) -> Option<f64> {
    let effects = refitted(&problem.without_mode(mode)?, fit)?;
    let state = problem.state_without_scatter(&effects).ok()?;
    Some((state.frequency_of(mode)? / problem.measured[mode].frequency_hz - 1.0).abs())
}
