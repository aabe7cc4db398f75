//! The background: how a sound structure differs from its table. Gaussian factors over the height, on stiffness and on mass.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::body::Body;
use super::world::{Kernel, World};

/// Variance along a principal direction, as a share of the largest, that is left out.
const HARDLY: f64 = 1e-3;

/// Correlations of the scatter at some heights; `segments` says which of them move together where each segment is by itself.
fn correlations(kernel: Kernel, heights_m: &[f64], segments: &[usize], correlation_length_m: f64) -> DMatrix<f64> {
    let correlation = |i: usize, j: usize| {
        let apart = (heights_m[i] - heights_m[j]).abs() / correlation_length_m;
        match kernel {
            Kernel::SquaredExponential => (-0.5 * apart * apart).exp(),
            Kernel::Exponential => (-apart).exp(),
            Kernel::White => f64::from(u8::from(segments[i] == segments[j])),
        }
    };
    DMatrix::from_fn(heights_m.len(), heights_m.len(), correlation)
}

/// A Gaussian process of unit variance with these correlations.
fn process(mut correlations: DMatrix<f64>, random: &mut impl Rng) -> Vec<f64> {
    let count = correlations.nrows();
    // The smooth kernel's own matrix is singular to working precision; this much makes it a Cholesky's.
    (0..count).for_each(|at| correlations[(at, at)] += 1e-9);
    let normals = DVector::from_fn(count, |_, _| StandardNormal.sample(random));
    match correlations.cholesky() {
        Some(factor) => (factor.l() * normals).iter().copied().collect(),
        None => vec![0.0; count],
    }
}

/// How the segments of a body scatter.
#[derive(Debug, Clone)]
pub(super) struct Scatter {
    /// Relative standard deviation of stiffness and of mass.
    stiffness: f64,
    mass: f64,
    is_apart: bool,
    of_elements: DMatrix<f64>,
    of_nodes: DMatrix<f64>,
}

impl Scatter {
    /// Relative deviations as the study states them, over the height of this body, in a world.
    pub(super) fn of(body: &Body, [stiffness, mass]: [f64; 2], correlation_length_m: f64, world: &World) -> Self {
        let length_m = world.length * correlation_length_m;
        let segments: Vec<usize> = body.elements.iter().map(|element| element.segment).collect();
        let middles: Vec<f64> = (0..body.elements.len()).map(|element| body.middle_m(element)).collect();
        let heights: Vec<f64> = body.nodes.iter().map(|node| node.z_m).collect();
        // A node goes with the segment below it.
        let of_nodes: Vec<usize> = segments.first().into_iter().chain(&segments).copied().collect();
        Self {
            stiffness: stiffness * world.scatter,
            mass: mass * world.scatter,
            is_apart: world.apart,
            of_elements: correlations(world.kernel, &middles, &segments, length_m),
            of_nodes: correlations(world.kernel, &heights, &of_nodes, length_m),
        }
    }

    /// How many factors an element's stiffnesses have: one for all, or bending and shear along each axis and torsion by themselves.
    fn kinds(&self) -> usize {
        if self.is_apart { 5 } else { 1 }
    }

    /// Scatters a body.
    pub(super) fn draw(&self, body: &mut Body, random: &mut impl Rng) {
        for kind in 0..self.kinds() {
            self.change_stiffness(body, kind, &process(self.of_elements.clone(), random));
        }
        self.change_mass(body, &process(self.of_nodes.clone(), random));
    }

    /// The body, changed by one deviation along each principal direction of its scatter: those that hardly scatter left out.
    pub(super) fn along_each(&self, body: &Body) -> Vec<Body> {
        let directions = |correlations: &DMatrix<f64>| -> Vec<Vec<f64>> {
            let eigen = SymmetricEigen::new(correlations.clone());
            let largest = eigen.eigenvalues.max();
            let kept = (0..eigen.eigenvalues.len()).filter(|&at| eigen.eigenvalues[at] > HARDLY * largest);
            kept.map(|at| (eigen.eigenvectors.column(at) * eigen.eigenvalues[at].sqrt()).iter().copied().collect())
                .collect()
        };
        let (of_elements, of_nodes) = (directions(&self.of_elements), directions(&self.of_nodes));
        let changed = |change: &dyn Fn(&mut Body)| {
            let mut body = body.clone();
            change(&mut body);
            body
        };
        let stiffer = (0..self.kinds())
            .flat_map(|kind| of_elements.iter().map(move |normals| (kind, normals)))
            .map(|(kind, normals)| changed(&|body| self.change_stiffness(body, kind, normals)));
        let heavier = of_nodes.iter().map(|normals| changed(&|body| self.change_mass(body, normals)));
        stiffer.chain(heavier).collect()
    }

    fn change_stiffness(&self, body: &mut Body, kind: usize, normals: &[f64]) {
        for (element, normal) in body.elements.iter_mut().zip(normals) {
            let factor = 1.0 + self.stiffness * normal;
            match kind {
                _ if !self.is_apart => element.scale(factor),
                0 | 1 => element.bending_n_m2[kind] *= factor,
                2 | 3 => element.shear_compliance_per_n[kind - 2] /= factor,
                _ => element.torsion_n_m2 *= factor,
            }
        }
    }

    fn change_mass(&self, body: &mut Body, normals: &[f64]) {
        body.nodes.iter_mut().zip(normals).for_each(|(node, normal)| node.scale(1.0 + self.mass * normal));
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
                let values = process(correlations(kernel, &[0.0, 7.0, 20.0, 40.0], &[0, 0, 1, 2], 20.0), &mut random);
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
            Scatter::of(&body, [0.03, 0.01], structure.correlation_length_m(), &world).draw(&mut body, &mut random);
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
