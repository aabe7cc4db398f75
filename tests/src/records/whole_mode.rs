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
    /// modes.json, and the true shape, whose length is the estimate's by least squares. `None` where no covariance is stated, or it is none,
    /// and where a deviation is not known.
    pub fn of(errors: &DVector<f64>, stds: &DVector<f64>, scatter: &Value, truth: &DVector<f64>) -> Option<Self> {
        let row = |row: &Value| row.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
        let mut rows = vec![row(&scatter["frequency_hz"])?];
        for component in scatter["shape"].as_array()? {
            rows.push(row(component)?);
        }
        let columns = rows[0].len();
        let fits = rows.len() == errors.len() && rows.iter().all(|row| row.len() == columns);
        (fits && stds.iter().all(|std| std.is_finite())).then_some(())?;
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

    /// Probability of so large a squared length, or a larger one, by chi-squared, which takes the covariance as exact.
    ///
    /// It is not: it is estimated from 24 groups of windows at most, for up to 40 numbers. Hotelling's T², which allows for that, does not
    /// apply, as belfry shrinks correlations and adds variances that no group shows. So the shares below 0.05 compare programs and cases
    /// with each other; they are no test at the level of 5 %.
    pub fn p_value(self, square: f64) -> f64 {
        ChiSquared::new(self.numbers as f64).map_or(f64::NAN, |distribution| distribution.sf(square))
    }
}

/// In words: the root mean square by either covariance, and the shares that chance exceeds in one of twenty.
pub(super) fn in_words(modes: &[WholeMode]) -> String {
    if modes.is_empty() {
        return "whole modes: -".to_owned();
    }
    let numbers = modes.iter().map(|mode| mode.numbers).sum::<usize>().max(1) as f64;
    let of = |square: fn(&WholeMode) -> f64| {
        let rms = (modes.iter().map(square).sum::<f64>() / numbers).sqrt();
        let beyond = modes.iter().filter(|mode| mode.p_value(square(mode)) < 0.05).count();
        format!("{rms:.2} ({:.0} % below p = 0.05)", 100.0 * beyond as f64 / modes.len() as f64)
    };
    format!("whole modes: {}, as if independent {}", of(|mode| mode.joint), of(|mode| mode.independent))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Errors of the frequency and of two components, of which the first lies along the true shape, where no error counts.
    fn whole_mode(stds: [f64; 3], scatter: &Value) -> Option<WholeMode> {
        let errors = DVector::from_column_slice(&[0.1, 7.0, 0.5]);
        let truth = DVector::from_column_slice(&[-2.0, 0.0]);
        WholeMode::of(&errors, &DVector::from_column_slice(&stds), scatter, &truth)
    }

    #[test]
    fn errors_that_go_together_weigh_less_than_independent_ones() {
        // Both errors are one deviation, and their correlation is 0.06 · 0.4 / (0.1 · 0.5) = 0.48.
        let scatter = json!({"frequency_hz": [0.06], "shape": [[0.0], [0.4]]});
        let whole = whole_mode([0.1, 0.3, 0.5], &scatter).unwrap();
        assert_eq!(whole.numbers, 2);
        assert!((whole.independent - 2.0).abs() < 1e-9, "{whole:?}");
        // (1 + 1 - 2 ρ) / (1 - ρ²) = 2 / (1 + ρ).
        assert!((whole.joint - 2.0 / 1.48).abs() < 1e-9, "{whole:?}");
    }

    #[test]
    fn a_deviation_that_is_not_known_leaves_the_whole_mode_out() {
        let scatter = json!({"frequency_hz": [0.06], "shape": [[0.0], [0.0]]});
        assert!(whole_mode([0.1, 0.3, 0.5], &scatter).is_some());
        assert!(whole_mode([0.1, 0.3, f64::NAN], &scatter).is_none());
        assert!(whole_mode([0.1, 0.3, 0.5], &Value::Null).is_none());
        assert!(whole_mode([0.1, 0.3, 0.5], &json!({"frequency_hz": [null], "shape": [[0.0], [0.0]]})).is_none());
        assert!(whole_mode([0.1, 0.3, 0.5], &json!({"frequency_hz": [0.06], "shape": [[0.0]]})).is_none());
    }

    #[test]
    fn two_numbers_are_beyond_a_square_with_the_probability_of_an_exponential() {
        let whole = |joint| WholeMode { joint, independent: 2.0, numbers: 2 };
        // exp(-2 / 2) = 0.37, and exp(-6 / 2) = 0.0498.
        assert!((whole(2.0).p_value(2.0) - (-1.0_f64).exp()).abs() < 1e-9);
        // sqrt((2 + 6) / 4) and sqrt((2 + 2) / 4).
        assert_eq!(
            in_words(&[whole(2.0), whole(6.0)]),
            "whole modes: 1.41 (50 % below p = 0.05), as if independent 1.00 (0 % below p = 0.05)"
        );
    }
}
