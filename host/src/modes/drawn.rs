//! Errors of a measured mode, drawn from its covariance: what another measurement as good as this one might have found.

use nalgebra::DVector;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::measured::MeasuredMode;

/// Errors of a mode's numbers, in the units of these.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnErrors {
    /// Of the frequency in Hz.
    pub frequency_hz: f64,
    /// Of the shape's components; empty where the mode has no shape.
    pub shape: DVector<f64>,
    /// Of the components' imaginary parts.
    pub imaginary: DVector<f64>,
}

/// Independent normal numbers of unit variance.
pub(crate) fn normals(count: usize, random: &mut ChaCha8Rng) -> DVector<f64> {
    DVector::from_fn(count, |_, _| StandardNormal.sample(random))
}

impl MeasuredMode {
    /// Errors with the mode's covariance, as far as that is known; errors of different modes are independent. The sensors' own
    /// errors are drawn last, so that more sensors change nothing for those that were there.
    pub fn drawn_errors(&self, random: &mut ChaCha8Rng) -> DrawnErrors {
        let frequency_hz = self.frequency_std_hz.unwrap_or(0.0) * normals(1, random)[0];
        let Some(shape) = &self.shape else {
            return DrawnErrors { frequency_hz, shape: DVector::zeros(0), imaginary: DVector::zeros(0) };
        };
        let count = shape.values.len();
        let factor = self.covariance_factor.as_ref().filter(|factor| factor.shape.nrows() == count);
        let columns = factor.map_or(0, |factor| factor.shape.ncols());
        let common = [normals(columns, random), normals(columns, random)];
        let own = normals(2 * count, random);
        let errors = |part: usize| {
            DVector::from_fn(count, |row, _| {
                let std = shape.stds.as_ref().map_or(0.0, |stds| stds[row]);
                let (joint, variance) = factor.map_or((0.0, 0.0), |factor| {
                    let row = factor.shape.row(row);
                    (row.transpose().dot(&common[part]), row.norm_squared())
                });
                joint + (std * std - variance).max(0.0).sqrt() * own[2 * row + part]
            })
        };
        DrawnErrors { frequency_hz, shape: errors(0), imaginary: errors(1) }
    }

    /// The mode as it is found with these errors.
    #[must_use]
    pub fn with_errors(mut self, errors: &DrawnErrors) -> Self {
        self.frequency_hz += errors.frequency_hz;
        if let Some(shape) = &mut self.shape {
            shape.values += &errors.shape;
            if let Some(imaginary) = &mut shape.imaginary {
                *imaginary += &errors.imaginary;
            }
        }
        self
    }
}
