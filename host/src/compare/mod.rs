//! Comparison: a model's modes and measured modes flow in; pairs, and where they disagree, flow out.
//!
//! `pairing` says which belongs to which, `residual` makes whitened differences of the pairs, `misfit` looks at them sensor
//! by sensor, `tolerance` says how far the model itself is trusted. What is computed here is printed and stored by the commands.

mod misfit;
mod pairing;
mod residual;
mod result;
#[cfg(test)]
mod tests;
mod tolerance;
mod view;

use crate::modes::{MeasuredMode, MeasuredShape};
use crate::study::Sensor;

pub(crate) use pairing::pair_above;
pub use pairing::{Pair, pair};
pub(crate) use residual::{Block, Residual, complement, exceeding};
pub use residual::{ChiSquared, chi_squared};
pub use result::{Comparison, HeightMisfit, PairReport, SensorMisfit, Side, Unpaired};
pub(crate) use result::{frequency_z, levels};
pub use tolerance::Tolerance;
pub use view::{ModelView, ViewError};

/// Modal assurance criterion of a model's shape (at all sensors) and a measured one (at some): the squared cosine of their
/// angle, 0 where either vanishes (Allemang and Brown 1982).
pub fn mac(model: &[f64], measured: &MeasuredShape) -> f64 {
    let (mut product, mut model_square, mut measured_square) = (0.0, 0.0, 0.0);
    for (&sensor, &value) in measured.sensors.iter().zip(measured.values.iter()) {
        let there = model.get(sensor).copied().unwrap_or(0.0);
        product += there * value;
        model_square += there * there;
        measured_square += value * value;
    }
    let squares = model_square * measured_square;
    if squares > 0.0 { (product * product / squares).min(1.0) } else { 0.0 }
}

/// The factor that brings a model's shape nearest to a measured one: least squares over the measured components.
pub(crate) fn scale(model: &[f64], measured: &MeasuredShape) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for (&sensor, &value) in measured.sensors.iter().zip(measured.values.iter()) {
        let there = model.get(sensor).copied().unwrap_or(0.0);
        product += there * value;
        square += there * there;
    }
    if square > 0.0 { product / square } else { 0.0 }
}

/// Least relative standard deviation of a measured frequency: what else may be wrong with it (temperature, amplitude).
const FREQUENCY_FLOOR: f64 = 2e-4;
/// Least standard deviation of a component of a shape of unit length.
const SHAPE_FLOOR: f64 = 2e-3;
/// What stands for an unknown standard deviation of a frequency, relative.
const FREQUENCY_ASSUMED: f64 = 5e-3;
/// What stands for an unknown standard deviation of a component of a shape of unit length.
const SHAPE_ASSUMED: f64 = 2e-2;

/// Relative standard deviation of a measured frequency, never below its floor.
fn frequency_deviation(mode: &MeasuredMode) -> f64 {
    mode.frequency_std_hz.map_or(FREQUENCY_ASSUMED, |std| std / mode.frequency_hz).max(FREQUENCY_FLOOR)
}

/// Standard deviations of a shape's components after it is brought to unit length, never below their floor.
pub(crate) fn shape_deviations(shape: &MeasuredShape) -> Vec<f64> {
    let length = shape.values.norm();
    match &shape.stds {
        Some(stds) => stds
            .iter()
            .map(|std| if std.is_finite() { (std / length).max(SHAPE_FLOOR) } else { SHAPE_ASSUMED })
            .collect(),
        None => vec![SHAPE_ASSUMED; shape.values.len()],
    }
}

/// Compares a model with measured modes: pairs them, sums up where they disagree.
///
/// `tolerance` is how far the model is trusted; without it every difference counts against it that the measurement can
/// resolve.
pub fn compare(
    view: &ModelView,
    measured: &[MeasuredMode],
    sensors: &[Sensor],
    tolerance: Option<&Tolerance>,
) -> Comparison {
    let pairs = pair(view, measured);
    let chi_squared = chi_squared(view, measured, &pairs, tolerance);
    result::comparison(view, measured, sensors, &pairs, chi_squared)
}
