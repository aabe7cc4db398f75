//! Comparison: a model's modes and measured modes flow in; pairs, and where they disagree, flow out.
//!
//! `pairing` says which belongs to which, `residual` makes whitened differences of the pairs, `following` says how they
//! follow a change of the model, `misfit` looks at them sensor
//! by sensor, `tolerance` says how far the model itself is trusted. What is computed here is printed and stored by the commands.

mod deviation;
mod following;
mod misfit;
mod pairing;
mod residual;
mod result;
mod shape;
#[cfg(test)]
mod tests;
mod tolerance;
mod view;

use crate::modes::MeasuredMode;
use crate::study::Sensor;

pub(crate) use deviation::{Errors, shape_deviations};
pub(crate) use following::Following;
pub use pairing::{Pair, pair};
pub(crate) use pairing::{candidates, pair_above};
pub(crate) use residual::{Block, Residual, ShapeBlock, complement, exceeding};
pub use residual::{ChiSquared, chi_squared};
pub use result::{Comparison, GroupMisfit, HeightMisfit, PairReport, SensorMisfit, Side, Unpaired};
pub(crate) use result::{frequency_z, levels, searched};
pub use shape::mac;
pub(crate) use shape::scale;
pub use tolerance::Tolerance;
pub(crate) use tolerance::{correlation_length_m, one_factor_covariance};
pub use view::{ModelView, ViewError};

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
