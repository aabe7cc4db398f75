//! The background: how a sound structure differs from its table. Gaussian factors over the height, on stiffness and on mass.

use nalgebra::{DMatrix, DVector};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::body::Body;
use super::world::{Kernel, World};

/// A Gaussian process of unit variance at some heights; `segments` says which of them move together where each segment is by itself.
fn process(
    kernel: Kernel,
    heights_m: &[f64],
    segments: &[usize],
    correlation_length_m: f64,
    random: &mut impl Rng,
) -> Vec<f64> {
    let correlation = |i: usize, j: usize| {
        let apart = (heights_m[i] - heights_m[j]).abs() / correlation_length_m;
        match kernel {
            Kernel::SquaredExponential => (-0.5 * apart * apart).exp(),
            Kernel::Exponential => (-apart).exp(),
            Kernel::White => f64::from(u8::from(segments[i] == segments[j])),
        }
    };
    let covariance = DMatrix::from_fn(heights_m.len(), heights_m.len(), |i, j| {
        // The smooth kernel's own matrix is singular to working precision; this much makes it a Cholesky's.
        correlation(i, j) + if i == j { 1e-9 } else { 0.0 }
    });
    let normals = DVector::from_fn(heights_m.len(), |_, _| StandardNormal.sample(random));
    match covariance.cholesky() {
        Some(factor) => (factor.l() * normals).iter().copied().collect(),
        None => vec![0.0; heights_m.len()],
    }
}

/// Scatters stiffness and mass by relative standard deviations: all stiffnesses of an element by one factor, or each by its own.
pub(super) fn scatter(
    body: &mut Body,
    [stiffness, mass]: [f64; 2],
    correlation_length_m: f64,
    world: &World,
    random: &mut impl Rng,
) {
    let length_m = world.length * correlation_length_m;
    let [stiffness, mass] = [stiffness, mass].map(|relative| relative * world.scatter);
    let segments: Vec<usize> = body.elements.iter().map(|element| element.segment).collect();
    let middles: Vec<f64> = (0..body.elements.len()).map(|element| body.middle_m(element)).collect();
    let mut factors = || {
        let normals = process(world.kernel, &middles, &segments, length_m, random);
        normals.into_iter().map(|normal| 1.0 + stiffness * normal).collect::<Vec<f64>>()
    };
    if world.apart {
        let [bending_1, bending_2, shear_1, shear_2, torsion] = [0; 5].map(|_| factors());
        for (at, element) in body.elements.iter_mut().enumerate() {
            element.bending_n_m2[0] *= bending_1[at];
            element.bending_n_m2[1] *= bending_2[at];
            element.shear_compliance_per_n[0] /= shear_1[at];
            element.shear_compliance_per_n[1] /= shear_2[at];
            element.torsion_n_m2 *= torsion[at];
        }
    } else {
        body.elements.iter_mut().zip(factors()).for_each(|(element, factor)| element.scale(factor));
    }
    let heights: Vec<f64> = body.nodes.iter().map(|node| node.z_m).collect();
    // A node goes with the segment below it.
    let of_nodes: Vec<usize> = segments.first().into_iter().chain(&segments).copied().collect();
    for (node, normal) in body.nodes.iter_mut().zip(process(world.kernel, &heights, &of_nodes, length_m, random)) {
        node.scale(1.0 + mass * normal);
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::structures::Structure;
    use super::*;

    #[test]
    fn covariance_is_the_kernels() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let expected = [
            (Kernel::SquaredExponential, (-0.5_f64).exp()),
            (Kernel::Exponential, (-1.0_f64).exp()),
            (Kernel::White, 0.0),
        ];
        for (kernel, covariance) in expected {
            let (mut variance, mut at_length, mut beside) = (0.0, 0.0, 0.0);
            let draws = 4000;
            for _ in 0..draws {
                let values = process(kernel, &[0.0, 7.0, 20.0, 40.0], &[0, 0, 1, 2], 20.0, &mut random);
                variance += values[1] * values[1] / f64::from(draws);
                at_length += values[0] * values[2] / f64::from(draws);
                beside += values[0] * values[1] / f64::from(draws);
            }
            // Four standard errors: sqrt(2/4000) each.
            assert!((variance - 1.0).abs() < 0.09, "{kernel:?}: {variance}");
            assert!((at_length - covariance).abs() < 0.09, "{kernel:?}: {at_length}");
            assert!(kernel != Kernel::White || (beside - 1.0).abs() < 0.09, "one segment is one: {beside}");
        }
    }

    #[test]
    fn stiffnesses_that_scatter_apart_have_a_factor_each() {
        let structure = Structure::named("chimney").expect("it is written here");
        let sound = Body::fine(&structure);
        let ratios = |apart| {
            let mut body = sound.clone();
            let mut random = ChaCha8Rng::seed_from_u64(2);
            let world = World { apart, scatter: 2.0, ..World::ASSUMED };
            scatter(&mut body, [0.03, 0.01], structure.correlation_length_m(), &world, &mut random);
            let (is, was) = (&body.elements[9], &sound.elements[9]);
            [
                is.bending_n_m2[0] / was.bending_n_m2[0],
                is.bending_n_m2[1] / was.bending_n_m2[1],
                was.shear_compliance_per_n[0] / is.shear_compliance_per_n[0],
                was.shear_compliance_per_n[1] / is.shear_compliance_per_n[1],
                is.torsion_n_m2 / was.torsion_n_m2,
            ]
        };
        let [first, others @ ..] = ratios(false);
        assert!(first != 1.0 && others.iter().all(|other| (other / first - 1.0).abs() < 1e-12));
        let mut apart = ratios(true).map(|ratio| (ratio * 1e9).round() as i64).to_vec();
        apart.sort_unstable();
        apart.dedup();
        assert_eq!(apart.len(), 5);
    }
}
