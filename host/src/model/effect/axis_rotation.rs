//! `axis-rotation`: the principal axes of the structure point elsewhere.

use std::sync::Arc;

use nalgebra::{DMatrix, Matrix2};

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::beam::Segment;
use crate::model::contribution::Contribution;
use crate::model::structure::{Body, Structure};

const ABOUT: About = About {
    name: "axis-rotation",
    physics: "The directions of largest and least stiffness are not where the drawings put them, for instance because \
         walls were moved. Mode shapes turn in plan; frequencies stay.",
    formula: "K becomes T^T K T, T turning X and Y at every node",
    fingerprint: "shapes turn by the same angle in all bending modes, frequencies stay",
    look_alikes: &[
        LookAlike {
            kind: "sensor-rotation",
            separated_by: "exact twin of all sensors turned: survey the azimuth of a few sensors",
        },
        LookAlike { kind: "mass-eccentricity", separated_by: "torsion: turned axes bring none into bending" },
    ],
    source: "A. K. Chopra (2012), Dynamics of Structures, section 9.5",
    examples: &["axis-rotation=10"],
};

const ANGLE: Parameter =
    Parameter::ranged("angle", "deg", [-90.0, 90.0], 10.0, "how far the axes are turned anticlockwise");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct AxisRotation;

impl EffectKind for AxisRotation {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[ANGLE]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_line(self, structure)?;
        let angle_deg = given.or_zero(ANGLE.name);
        Ok(match structure.body {
            Body::Beam(_) => Arc::new(TurnedSegments { angle_deg }),
            Body::Matrices(_) => Arc::new(TurnedStiffness { angle_deg }),
        })
    }
}

/// Principal axes of a beam, turned before they become a matrix.
#[derive(Debug)]
struct TurnedSegments {
    angle_deg: f64,
}

impl Contribution for TurnedSegments {
    fn change_segments(&self, segments: &mut [Segment]) {
        for segment in segments {
            segment.axis_deg += self.angle_deg;
        }
    }
}

/// Principal axes of imported matrices: K becomes Tᵀ K T, T turning each node's X and Y.
#[derive(Debug)]
struct TurnedStiffness {
    angle_deg: f64,
}

impl Contribution for TurnedStiffness {
    fn rearrange(&self, assembly: &mut Assembly) {
        if self.angle_deg == 0.0 {
            return;
        }
        let (sin, cos) = self.angle_deg.to_radians().sin_cos();
        let part = Matrix2::new(cos, sin, -sin, cos);
        let mut turn = DMatrix::identity(assembly.dofs(), assembly.dofs());
        for rows in assembly.node_rows() {
            for (x, y) in [(rows[0], rows[1]), (rows[2], rows[3])] {
                if let (Some(x), Some(y)) = (x, y) {
                    for (i, row) in [x, y].into_iter().enumerate() {
                        for (j, column) in [x, y].into_iter().enumerate() {
                            turn[(row, column)] = part[(i, j)];
                        }
                    }
                }
            }
        }
        let turned = turn.tr_mul(&(&assembly.stiffness * &turn));
        assembly.stiffness = (&turned + turned.transpose()) * 0.5;
    }
}
