//! A structure that differs from its model as far as the study says that the model is trusted.

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::compare::one_factor_covariance;
use crate::model::{BeamTable, Structure};
use crate::study::Model;

/// No segment keeps less than this of its stiffness or mass.
const LEAST_FACTOR: f64 = 0.2;

/// Groups draw from here; segments from the start.
const GROUPS: u64 = 1 << 40;

/// Changes the groups of a structure, each by itself, `share` times as far as the study trusts it to in one standard deviation; the same seed gives
/// the same structure.
pub fn scatter_groups(structure: &mut Structure, share: f64, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(GROUPS);
    let mut change = |std: f64| {
        let normal: f64 = StandardNormal.sample(&mut random);
        (share * std * normal).max(LEAST_FACTOR - 1.0)
    };
    let changes: Vec<f64> = structure.groups().map(|(_, terms)| change(terms.std)).collect();
    structure.change_groups(&changes);
}

/// The table with its segments' stiffness and mass scattered smoothly over the height, `share` times as far as `background_*`
/// of the study allow in one standard deviation; the same seed gives the same structure.
pub fn scattered(mut beam: BeamTable, model: &Model, share: f64, seed: u64) -> BeamTable {
    let Some(covariance) = one_factor_covariance(&beam, model) else { return beam };
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let eigen = covariance.symmetric_eigen();
    let mut normal = |variance: f64| {
        let normal: f64 = StandardNormal.sample(&mut random);
        share * variance.max(0.0).sqrt() * normal
    };
    let normals = DVector::from_iterator(eigen.eigenvalues.len(), eigen.eigenvalues.iter().map(|&v| normal(v)));
    let changes = eigen.eigenvectors * normals;
    let segments = beam.segments().len();
    let mut factors = changes.iter().map(|change| (1.0 + change).max(LEAST_FACTOR));
    let mut next = |deviation: Option<f64>| -> Vec<f64> {
        let wanted = deviation.is_some_and(|deviation| deviation > 0.0);
        if wanted { factors.by_ref().take(segments).collect() } else { vec![1.0; segments] }
    };
    let (stiffness, mass) = (next(model.background_stiffness), next(model.background_mass));
    for (segment, (stiffness, mass)) in beam.segments_mut().iter_mut().zip(stiffness.into_iter().zip(mass)) {
        segment.scale_stiffness(stiffness);
        segment.scale_mass(mass);
    }
    beam
}
