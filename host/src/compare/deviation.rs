//! How sure a measured frequency and shape are.
//!
//! A measured mode flows in; standard deviations flow out as they are stated, assumed ones where the file of modes has none. What
//! else may be wrong with a frequency or a shape is the model's discrepancy, whose size the data say; floors of 0.02 % and 0.2 %,
//! which stood here, made chi-squared of whole modes 0.20 of its degrees of freedom where it is 0.77 without (243 modes of 24
//! cases of the blind bench, against their exact modes).

use nalgebra::{DMatrix, DVector};

use crate::identify::OWN_SHARE;
use crate::modes::{MeasuredCovarianceFactor, MeasuredMode, MeasuredShape};

/// Files round: a frequency is not known better than this share of it, nor a component of a shape than this share of its length.
const FREQUENCY_DIGITS: f64 = 1e-6;
const SHAPE_DIGITS: f64 = 1e-5;
/// A component whose phase is off, as of a late clock, is no surer than this share of its imaginary part: phases that identification
/// finds of a node that is 0.1 s late are 1 % off in one strong mode or another, which their deviations do not say (14 records of six
/// hours: delays of 0.0985 to 0.0996 s, 2 to 6 deviations off without).
const PHASE_SHARE: f64 = 0.02;
/// What stands for an unknown standard deviation of a frequency, relative.
pub(super) const FREQUENCY_ASSUMED: f64 = 5e-3;
/// What stands for an unknown standard deviation of a component of a shape of unit length.
pub(super) const SHAPE_ASSUMED: f64 = 2e-2;

/// Relative standard deviation of a measured frequency.
pub(super) fn frequency_deviation(mode: &MeasuredMode) -> f64 {
    mode.frequency_std_hz.map_or(FREQUENCY_ASSUMED, |std| std / mode.frequency_hz).max(FREQUENCY_DIGITS)
}

/// How the errors of a mode are correlated, after its frequency is relative and its shape of unit length.
pub(crate) struct Errors {
    /// The part of each number's variance that is its own: the frequency, then the shape's components.
    pub(crate) own: DVector<f64>,
    /// Rows whose products are the covariances; no columns where they are not known.
    pub(crate) joint: DMatrix<f64>,
}

impl Errors {
    /// Of a mode and, where it is compared, its shape.
    pub(crate) fn of(mode: &MeasuredMode, shape: Option<&MeasuredShape>) -> Self {
        let mut deviations = vec![frequency_deviation(mode)];
        deviations.extend(shape.map(shape_deviations).unwrap_or_default());
        let is_known = |scatter: &&MeasuredCovarianceFactor| {
            mode.frequency_std_hz.is_some()
                && shape.is_none_or(|shape| {
                    shape.stds.is_some() && scatter.shape.shape() == (shape.sensors.len(), scatter.frequency_hz.len())
                })
        };
        let scatter = mode.covariance_factor.as_ref().filter(is_known);
        let mut joint = DMatrix::zeros(deviations.len(), scatter.map_or(0, |scatter| scatter.frequency_hz.len()));
        if let Some(scatter) = scatter {
            joint.row_mut(0).copy_from(&(&scatter.frequency_hz / mode.frequency_hz));
            if let Some(shape) = shape {
                joint.rows_mut(1, shape.sensors.len()).copy_from(&(&scatter.shape / shape.values.norm()));
            }
        }
        let own = deviations.iter().zip(joint.row_iter()).map(|(deviation, row)| {
            (deviation * deviation - row.norm_squared()).max(OWN_SHARE * deviation * deviation)
        });
        Self { own: DVector::from_iterator(deviations.len(), own), joint }
    }
}

/// Standard deviations of a shape's components after it is brought to unit length.
pub(crate) fn shape_deviations(shape: &MeasuredShape) -> Vec<f64> {
    let length = shape.values.norm();
    let imaginary = |row: usize| shape.imaginary.as_ref().map_or(0.0, |imaginary| imaginary[row] / length);
    let stated = |row: usize| match shape.stds.as_ref().map(|stds| stds[row]) {
        Some(std) if std.is_finite() => (std / length).max(SHAPE_DIGITS),
        _ => SHAPE_ASSUMED,
    };
    (0..shape.values.len()).map(|row| stated(row).hypot(PHASE_SHARE * imaginary(row))).collect()
}
