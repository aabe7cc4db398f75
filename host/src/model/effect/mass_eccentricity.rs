//! `mass-eccentricity`: the centre of mass stands beside the beam axis.

use super::target::check_line;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "mass-eccentricity",
    physics: "Cores and plant stand to one side, so the centre of mass of the floors lies off the axis about which the \
         structure twists. Bending and torsion then couple.",
    formula: "M[uy,rz] += m x, M[ux,rz] -= m y, M[rz,rz] += m (x^2 + y^2) at the nodes of the main body",
    fingerprint: "torsion in the bending modes, bending in the torsional ones",
    look_alikes: &[
        LookAlike { kind: "axis-rotation", separated_by: "sensors at one level on opposite sides, which see torsion" },
        LookAlike { kind: "sensor-rotation", separated_by: "sensors at one level on opposite sides" },
    ],
    source: "A. K. Chopra (2012), Dynamics of Structures, section 9.6",
};

const X: Parameter = Parameter::ranged("x", "m", [-1e3, 1e3], 1.0, "centre of mass from the beam axis along X");
const Y: Parameter = Parameter::ranged("y", "m", [-1e3, 1e3], 1.0, "centre of mass from the beam axis along Y");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct MassEccentricity;

impl EffectKind for MassEccentricity {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[X, Y]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        check_line(ABOUT.name, structure)?;
        for (offset, name) in structure.mass_offset_m.iter_mut().zip([X.name, Y.name]) {
            *offset += given.or_zero(name);
        }
        Ok(())
    }
}
