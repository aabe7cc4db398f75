//! Standard deviations from replicates: estimates that leave out a group of windows each.

use nalgebra::DMatrix;

use super::shape::Shape;

/// Standard deviation of an estimate from its delete-a-group replicates, or from what leaving out each group changes (Efron and
/// Tibshirani 1993, eq. 11.5); infinite where there are fewer than two, which no uncertainty can be read from.
pub(super) fn jackknife(replicates: &[f64]) -> f64 {
    deviation(&changes(replicates))
}

/// The same from [`changes`].
pub(super) fn deviation(changes: &[f64]) -> f64 {
    if changes.len() < 2 {
        return f64::INFINITY;
    }
    changes.iter().map(|change| change * change).sum::<f64>().sqrt()
}

/// By how much a standard deviation from so many replicates is widened: it is uncertain itself, so that errors divided by it follow
/// Student's distribution, whose variance is larger than 1, and infinite for fewer than four, which count as four.
pub(super) fn student(replicates: usize) -> f64 {
    let freedom = (replicates as f64 - 1.0).max(3.0);
    (freedom / (freedom - 2.0)).sqrt()
}

/// By how much each replicate differs from their mean, scaled so that the squares add up to the jackknife's variance.
pub(super) fn changes(replicates: &[f64]) -> Vec<f64> {
    let count = replicates.len() as f64;
    let mean = replicates.iter().sum::<f64>() / count;
    let scale = ((count - 1.0) / count).sqrt();
    replicates.iter().map(|value| scale * (value - mean)).collect()
}

/// What each group of windows changes in a mode's numbers, as [`changes`] has it; empty where that is not known.
#[derive(Debug, Clone)]
pub(super) struct GroupChanges {
    pub(super) frequency_hz: Vec<f64>,
    pub(super) damping_ratio: Vec<f64>,
    /// Of the shape's real parts, components x groups.
    pub(super) shape: DMatrix<f64>,
    /// Errors of the shape's real parts that no group shows, independent of these and of each other, components x errors.
    pub(super) beside: DMatrix<f64>,
}

impl GroupChanges {
    /// Of a method that has no replicates.
    pub(super) fn unknown(components: usize) -> Self {
        Self {
            frequency_hz: Vec::new(),
            damping_ratio: Vec::new(),
            shape: DMatrix::zeros(components, 0),
            beside: DMatrix::zeros(components, 0),
        }
    }

    pub(super) fn groups(&self) -> usize {
        self.frequency_hz.len()
    }
}

/// Scatter of a shape's components, from replicates of the same sign and scale.
pub(super) struct ShapeScatter {
    /// Standard deviations of the imaginary parts.
    pub(super) imaginary: Vec<f64>,
    /// Those of a component, which its real and imaginary part share.
    pub(super) component: Vec<f64>,
    /// What each replicate changes in the real parts, components x replicates.
    pub(super) real_changes: DMatrix<f64>,
}

impl ShapeScatter {
    pub(super) fn of(components: usize, replicates: &[Shape]) -> Self {
        let of = |row: usize, part: fn(&num_complex::Complex64) -> f64| {
            changes(&replicates.iter().map(|shape| part(&shape[row])).collect::<Vec<_>>())
        };
        let real: Vec<Vec<f64>> = (0..components).map(|row| of(row, |component| component.re)).collect();
        let imaginary: Vec<f64> = (0..components).map(|row| deviation(&of(row, |component| component.im))).collect();
        let both = real.iter().zip(&imaginary);
        let component = both.map(|(re, im)| deviation(re).hypot(*im) / std::f64::consts::SQRT_2).collect();
        let real_changes = DMatrix::from_fn(components, replicates.len(), |row, replicate| real[row][replicate]);
        Self { imaginary, component, real_changes }
    }
}

/// How much of a shape is scatter: the length of its components' standard deviations over its own.
pub(super) fn noise_share(shape: &Shape, component_std: &[f64]) -> f64 {
    (component_std.iter().map(|std| 2.0 * std * std).sum::<f64>() / shape.norm_squared()).sqrt()
}

/// [`noise_share`] of what leaves the plane of a shape and its partners: modes so close that their directions in that plane are not
/// known can be known as a pair all the same.
pub(super) fn noise_outside(shape: &Shape, partners: &[&Shape], replicates: &[Shape]) -> f64 {
    let columns: Vec<Shape> = std::iter::once(shape).chain(partners.iter().copied()).cloned().collect();
    let plane = DMatrix::from_columns(&columns).qr().q();
    let outside: Vec<Shape> = replicates.iter().map(|other| other - &plane * (plane.adjoint() * other)).collect();
    noise_share(shape, &ShapeScatter::of(shape.len(), &outside).component)
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;

    #[test]
    fn what_stays_in_the_plane_of_a_pair_is_not_noise_of_the_pair() {
        let at = |parts: [f64; 4]| Shape::from_iterator(4, parts.map(Complex64::from));
        let (own, partner) = (at([1.0, 0.0, 0.0, 0.0]), at([0.0, 1.0, 0.0, 0.0]));
        let turned = |by: f64| at([1.0, by, 0.0, 0.01 * by]);
        let replicates: Vec<Shape> = (0..10).map(|group| turned(if group < 5 { 0.1 } else { -0.1 })).collect();
        let alone = noise_outside(&own, &[], &replicates);
        let as_pair = noise_outside(&own, &[&partner], &replicates);
        assert!((as_pair / alone - 0.01).abs() < 1e-5, "{as_pair} {alone}");
    }

    #[test]
    fn errors_over_widened_deviations_have_unit_variance() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};

        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for count in [8, 12, 24] {
            const DRAWS: usize = 20_000;
            let mut squares = 0.0;
            for _ in 0..DRAWS {
                let values: Vec<f64> = (0..count).map(|_| StandardNormal.sample(&mut random)).collect();
                let total: f64 = values.iter().sum();
                let replicates: Vec<f64> = values.iter().map(|value| (total - value) / (count as f64 - 1.0)).collect();
                squares += (total / count as f64 / (student(count) * jackknife(&replicates))).powi(2);
            }
            assert!((squares / DRAWS as f64 - 1.0).abs() < 0.05, "{count} replicates: {}", squares / DRAWS as f64);
        }
        assert_eq!(student(1), student(4));
    }

    #[test]
    fn the_jackknife_of_a_mean_is_its_standard_error() {
        let values = [1.0, 4.0, 2.0, 8.0, 5.0, 7.0];
        let total: f64 = values.iter().sum();
        let replicates: Vec<f64> = values.iter().map(|value| (total - value) / 5.0).collect();
        let mean = total / 6.0;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 5.0;
        assert!((jackknife(&replicates) - (variance / 6.0).sqrt()).abs() < 1e-12);
    }
}
