//! How sure a measured frequency and shape are, never surer than their floors.
//!
//! A measured mode flows in; standard deviations flow out, assumed ones where the file of modes has none.

use crate::modes::{MeasuredMode, MeasuredShape};

/// Least relative standard deviation of a measured frequency: what else may be wrong with it (temperature, amplitude).
const FREQUENCY_FLOOR: f64 = 2e-4;
/// Least standard deviation of a component of a shape of unit length.
const SHAPE_FLOOR: f64 = 2e-3;
/// What stands for an unknown standard deviation of a frequency, relative.
pub(super) const FREQUENCY_ASSUMED: f64 = 5e-3;
/// What stands for an unknown standard deviation of a component of a shape of unit length.
pub(super) const SHAPE_ASSUMED: f64 = 2e-2;

/// Relative standard deviation of a measured frequency, never below its floor.
pub(super) fn frequency_deviation(mode: &MeasuredMode) -> f64 {
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
