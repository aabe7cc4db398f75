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
    pub(crate) covariance: DMatrix<f64>,
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
        let segment_changes = structure.segment_changes();
        let mut changes = Vec::new();
        let mut places = Vec::new();
        for (quantity, &deviation) in deviations.iter().enumerate().filter(|(_, deviation)| **deviation > 0.0) {
            for (segment, change) in beam.segments().iter().zip(&segment_changes) {
                changes.push(if quantity == 1 { change.mass.clone() } else { change.stiffness.clone() });
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
