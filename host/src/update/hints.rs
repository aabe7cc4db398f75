//! What Psi suggests: hints, not a diagnosis.
//!
//! Two nested tests of the measured shapes. Span: a Psi update stays within the span of the model's shapes, so shapes that lie
//! outside of it by more than their deviations point to physics other than a change of K within that span, or to sensors that
//! are described wrongly. Orthogonality: within the span, the true shapes of a structure of the model's mass are
//! orthogonal by mass; where the measured ones are not, it is the mass (or the sensors) that is wrong, not the stiffness.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::compare::{ChiSquared, ModelView, Pair, complement, shape_deviations};
use crate::modes::MeasuredMode;

/// What Psi suggests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hints {
    /// How far each measured shape lies outside the span of the model's shapes; empty with too few sensors.
    pub span: Vec<SpanTest>,
    /// Probability that all of them lie inside it; null without shapes.
    pub span_p_value: Option<f64>,
    /// Whether the parts inside are orthogonal by mass; null with fewer than two shapes.
    pub orthogonality: Option<OrthogonalityTest>,
}

/// A measured shape against the span of the model's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpanTest {
    /// Number of the measured mode.
    pub measured: usize,
    /// Length of its part outside the span, in percent of the whole.
    pub outside_percent: f64,
    /// The same squared, in deviations.
    pub chi_squared: f64,
    /// Sensors less shapes.
    pub degrees_of_freedom: usize,
}

/// The parts of measured shapes inside the span, pair by pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OrthogonalityTest {
    /// Squared cosines by mass of all pairs, in deviations.
    pub chi_squared: f64,
    /// Pairs.
    pub degrees_of_freedom: usize,
    /// Probability of as much of orthogonal shapes.
    pub p_value: f64,
    /// The measured modes that are the least orthogonal.
    pub worst: [usize; 2],
    /// Their cosine.
    pub cosine: f64,
    /// Its standard deviation.
    pub cosine_std: f64,
}

/// The tests of the paired modes.
pub fn hints(view: &ModelView, measured: &[MeasuredMode], pairs: &[Pair]) -> Hints {
    let models: Vec<usize> = pairs.iter().map(|pair| pair.model).collect();
    let mut span = Vec::new();
    let mut inside: Vec<(usize, DVector<f64>, DMatrix<f64>)> = Vec::new();
    for pair in pairs {
        let mode = &measured[pair.measured];
        let Some(shape) = &mode.shape else { continue };
        let shapes = view.at_sensors.select_rows(&shape.sensors).select_columns(&models);
        let values = shape.values.normalize();
        let variances = DVector::from_vec(shape_deviations(shape)).map(|deviation| deviation * deviation);
        let covariance = DMatrix::from_diagonal(&variances);
        if shape.sensors.len() > models.len()
            && let Some(outside) = complement(&shapes)
            && let Some(factor) = Cholesky::new(outside.tr_mul(&(&covariance * &outside)))
        {
            let part = outside.tr_mul(&values);
            span.push(SpanTest {
                measured: mode.number,
                outside_percent: 100.0 * part.norm(),
                chi_squared: part.dot(&factor.solve(&part)),
                degrees_of_freedom: part.len(),
            });
        }
        // With fewer sensors than modes any share would do.
        if shape.sensors.len() >= models.len()
            && let Ok(inverse) = shapes.pseudo_inverse(1e-12)
        {
            let share = &inverse * &values;
            let length = share.norm();
            if length > 0.0 {
                let spread = &inverse * &covariance * inverse.transpose() / (length * length);
                inside.push((mode.number, share / length, spread));
            }
        }
    }
    let total = span.iter().fold((0.0, 0), |sum, test| (sum.0 + test.chi_squared, sum.1 + test.degrees_of_freedom));
    Hints {
        span_p_value: (total.1 > 0).then(|| ChiSquared::of(total.0, total.1).p_value),
        orthogonality: orthogonality(&inside),
        span,
    }
}

fn orthogonality(inside: &[(usize, DVector<f64>, DMatrix<f64>)]) -> Option<OrthogonalityTest> {
    let (mut chi_squared, mut pairs, mut worst) = (0.0, 0, None::<(f64, [usize; 2], f64, f64)>);
    for (index, (one, share, spread)) in inside.iter().enumerate() {
        for (other, other_share, other_spread) in &inside[..index] {
            // Mass-normalised shapes of the model are orthonormal by mass, and so are their combinations.
            let cosine = share.dot(other_share);
            let variance = other_share.dot(&(spread * other_share)) + share.dot(&(other_spread * share));
            let square = cosine * cosine / variance;
            chi_squared += square;
            pairs += 1;
            if worst.is_none_or(|worst| square > worst.0) {
                worst = Some((square, [*other, *one], cosine, variance.sqrt()));
            }
        }
    }
    let (_, worst, cosine, cosine_std) = worst?;
    let p_value = ChiSquared::of(chi_squared, pairs).p_value;
    Some(OrthogonalityTest { chi_squared, degrees_of_freedom: pairs, p_value, worst, cosine, cosine_std })
}
