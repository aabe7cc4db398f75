//! How far a model is trusted: its study's background tolerance, as sensitivities and a smooth covariance.

use nalgebra::DMatrix;

use crate::model::{Body, Change, Structure};
use crate::study::Model;

/// Segments' stiffness and mass as uncertain quantities.
#[derive(Debug, Clone)]
pub struct Tolerance {
    /// What each relative change of one segment's stiffness or mass does to K and M.
    pub(super) changes: Vec<Change>,
    /// Covariance of these relative changes, changes x changes.
    pub(super) covariance: DMatrix<f64>,
}

/// Where the study gives no correlation length: this share of the structure's height.
const DEFAULT_CORRELATION: f64 = 1.0 / 6.0;

impl Tolerance {
    /// From `background_stiffness`, `background_mass` and `correlation_length_m` of a beam model; `None` where the study
    /// trusts its model, or the model has no segments.
    ///
    /// One relative factor a segment on bending, shear and torsion together, another on its mass; a Gaussian kernel over
    /// the heights of the segments' middles.
    pub fn of(structure: &Structure, model: &Model) -> Option<Self> {
        let Body::Beam(beam) = &structure.body else { return None };
        let deviations = [model.background_stiffness.unwrap_or(0.0), model.background_mass.unwrap_or(0.0)];
        if deviations == [0.0; 2] {
            return None;
        }
        let default_length = DEFAULT_CORRELATION * (beam.z_top_m() - beam.z_base_m());
        let length_m = model.correlation_length_m.unwrap_or(default_length);
        let given = structure.assemble();
        let mut changes = Vec::new();
        let mut places = Vec::new();
        for (quantity, &deviation) in deviations.iter().enumerate().filter(|(_, deviation)| **deviation > 0.0) {
            for (index, segment) in beam.segments().iter().enumerate() {
                changes.push(change(structure, &given, index, quantity == 1));
                places.push((quantity, deviation, 0.5 * (segment.z_bottom_m + segment.z_top_m)));
            }
        }
        let covariance = DMatrix::from_fn(places.len(), places.len(), |i, j| {
            let ((one, one_deviation, one_z), (other, other_deviation, other_z)) = (places[i], places[j]);
            if one != other {
                return 0.0;
            }
            let distance = (one_z - other_z) / length_m;
            one_deviation * other_deviation * (-0.5 * distance * distance).exp()
        });
        Some(Self { changes, covariance })
    }
}

/// K and M are linear in a segment's mass and (but for a flexible base, where it is smooth) in its stiffness.
const STEP: f64 = 1e-3;

fn change(structure: &Structure, given: &crate::model::Assembly, index: usize, of_mass: bool) -> Change {
    let with = |factor: f64| {
        let mut changed = structure.clone();
        if let Body::Beam(beam) = &mut changed.body
            && let Some(segment) = beam.segments_mut().get_mut(index)
        {
            if of_mass {
                segment.mass_top_kg *= factor;
                segment.inertia_kg_m2 = segment.inertia_kg_m2.map(|inertia| inertia * factor);
            } else {
                segment.bending_n_m2 = segment.bending_n_m2.map(|bending| bending * factor);
                segment.shear_n = segment.shear_n.map(|shear| shear.map(|shear| shear * factor));
                segment.torsion_n_m2 *= factor;
            }
        }
        changed.assemble()
    };
    let (above, below) = (with(1.0 + STEP), with(1.0 - STEP));
    let slope = |above: DMatrix<f64>, below: DMatrix<f64>, given: &DMatrix<f64>| {
        let mut slope = (above - below) / (2.0 * STEP);
        // Rounding of what did not change.
        slope.zip_apply(given, |slope, given| {
            if slope.abs() < 1e-10 * given.abs() {
                *slope = 0.0
            }
        });
        slope
    };
    Change::of(&slope(above.stiffness, below.stiffness, &given.stiffness), &slope(above.mass, below.mass, &given.mass))
}
