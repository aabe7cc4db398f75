//! The background: how a sound structure differs from its table. Smooth Gaussian factors over the height, one on stiffness
//! and one on mass.

use nalgebra::{DMatrix, DVector};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::body::Body;

/// A Gaussian process with squared-exponential covariance at some heights, unit variance.
pub(super) fn smooth(heights_m: &[f64], correlation_length_m: f64, random: &mut impl Rng) -> Vec<f64> {
    let covariance = DMatrix::from_fn(heights_m.len(), heights_m.len(), |i, j| {
        let apart = (heights_m[i] - heights_m[j]) / correlation_length_m;
        // The kernel's own matrix is singular to working precision; this much makes it a Cholesky's.
        (-0.5 * apart * apart).exp() + if i == j { 1e-9 } else { 0.0 }
    });
    let normals = DVector::from_fn(heights_m.len(), |_, _| StandardNormal.sample(random));
    match covariance.cholesky() {
        Some(factor) => (factor.l() * normals).iter().copied().collect(),
        None => vec![0.0; heights_m.len()],
    }
}

/// Scatters stiffness (bending, shear and torsion together) and mass by relative standard deviations.
pub(super) fn scatter(body: &mut Body, stiffness: f64, mass: f64, correlation_length_m: f64, random: &mut impl Rng) {
    let middles: Vec<f64> = (0..body.elements.len()).map(|element| body.middle_m(element)).collect();
    for (element, normal) in body.elements.iter_mut().zip(smooth(&middles, correlation_length_m, random)) {
        element.scale(1.0 + stiffness * normal);
    }
    let heights: Vec<f64> = body.nodes.iter().map(|node| node.z_m).collect();
    for (node, normal) in body.nodes.iter_mut().zip(smooth(&heights, correlation_length_m, random)) {
        node.scale(1.0 + mass * normal);
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn covariance_is_the_kernel() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let (mut variance, mut at_length) = (0.0, 0.0);
        let draws = 4000;
        for _ in 0..draws {
            let values = smooth(&[0.0, 7.0, 20.0, 40.0], 20.0, &mut random);
            variance += values[1] * values[1] / f64::from(draws);
            at_length += values[0] * values[2] / f64::from(draws);
        }
        // Four standard errors: sqrt(2/4000) each.
        assert!((variance - 1.0).abs() < 0.09, "{variance}");
        assert!((at_length - (-0.5_f64).exp()).abs() < 0.09, "{at_length}");
    }
}
