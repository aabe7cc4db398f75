//! A mode's errors taken together: frequency and all components of its shape, against the covariance that is stated.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde_json::Value;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// The squared length of a mode's errors in units of their covariance.
#[derive(Debug, Clone, Copy)]
pub struct WholeMode {
    /// By the joint covariance.
    pub joint: f64,
    /// As if errors were independent.
    pub independent: f64,
    /// How many numbers these are.
    pub numbers: usize,
}

impl WholeMode {
    /// Of the errors of a mode (frequency in Hz, then the shape's components), their standard deviations, the `covariance_factor` of
    /// modes.json, and the true shape, whose length is the estimate's by least squares. `None` where no covariance is stated, or it is none.
    pub fn of(errors: &DVector<f64>, stds: &DVector<f64>, scatter: &Value, truth: &DVector<f64>) -> Option<Self> {
        let row = |row: &Value| row.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
        let mut rows = vec![row(&scatter["frequency_hz"])?];
        for component in scatter["shape"].as_array()? {
            rows.push(row(component)?);
        }
        let columns = rows[0].len();
        let fits = rows.len() == errors.len() && rows.iter().all(|row| row.len() == columns);
        fits.then_some(())?;
        let joint = DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]);
        let variances = stds.component_mul(stds);
        let own = DVector::from_fn(rows.len(), |row, _| (variances[row] - joint.row(row).norm_squared()).max(0.0));
        // Along the true shape there is no error.
        let along = truth.normalize();
        let outside = DMatrix::identity(along.len(), along.len()) - &along * along.transpose();
        let eigen = outside.symmetric_eigen();
        let kept: Vec<usize> = (0..along.len()).filter(|&at| eigen.eigenvalues[at] > 0.5).collect();
        let mut directions = DMatrix::zeros(1 + kept.len(), errors.len());
        directions[(0, 0)] = 1.0;
        for (row, &at) in kept.iter().enumerate() {
            directions.view_mut((1 + row, 1), (1, along.len())).copy_from(&eigen.eigenvectors.column(at).transpose());
        }
        let error = &directions * errors;
        let square = |covariance: DMatrix<f64>| {
            let projected = &directions * covariance * directions.transpose();
            Some(error.dot(&Cholesky::new(projected)?.solve(&error)))
        };
        Some(Self {
            joint: square(DMatrix::from_diagonal(&own) + &joint * joint.transpose())?,
            independent: square(DMatrix::from_diagonal(&variances))?,
            numbers: error.len(),
        })
    }

    /// Probability of so large a squared length, or a larger one.
    pub fn p_value(self, square: f64) -> f64 {
        ChiSquared::new(self.numbers as f64).map_or(f64::NAN, |distribution| distribution.sf(square))
    }
}

/// In words: the root mean square by either covariance, and the shares that chance exceeds in one of twenty.
pub(super) fn in_words(modes: &[WholeMode]) -> String {
    let numbers = modes.iter().map(|mode| mode.numbers).sum::<usize>().max(1) as f64;
    let of = |square: fn(&WholeMode) -> f64| {
        let rms = (modes.iter().map(square).sum::<f64>() / numbers).sqrt();
        let beyond = modes.iter().filter(|mode| mode.p_value(square(mode)) < 0.05).count();
        format!("{rms:.2} ({:.0} % below p = 0.05)", 100.0 * beyond as f64 / modes.len().max(1) as f64)
    };
    format!("whole modes: {}, as if independent {}", of(|mode| mode.joint), of(|mode| mode.independent))
}
