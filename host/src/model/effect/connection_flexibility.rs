//! `connection-flexibility@z`: the structure kinks at a joint.

use super::target::{height, segments};
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{Joint, Structure};

const ABOUT: About = About {
    name: "connection-flexibility",
    physics: "A joint turns under moment where the model is continuous: the foot of an antenna mast, a bolted flange, a \
         transfer floor. Motion along the axis and torsion pass through it.",
    formula: "the segment at z: k becomes k - c v v^T/(1 + c k_tt), v the end forces of a unit kink",
    fingerprint: "modes of the part above, and those that bend there; shapes kink at z",
    look_alikes: &[
        LookAlike { kind: "added-mass", separated_by: "for a mast on top: sensors on the mast itself" },
        LookAlike {
            kind: "stiffness-loss",
            separated_by: "torsion, which a loss lowers and a rotational joint leaves alone",
        },
        LookAlike { kind: "base-rotation", separated_by: "for a joint near the base: a sensor between the two" },
    ],
    source: "M. A. Monforton, T. S. Wu (1963), Matrix analysis of semi-rigidly connected frames, J. Struct. Div. ASCE 89",
};

const FLEXIBILITY: Parameter = Parameter::positive("flexibility", "rad/(N m)", "kink of the joint under a unit moment");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct ConnectionFlexibility;

impl EffectKind for ConnectionFlexibility {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[FLEXIBILITY]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let z_m = height(ABOUT.name, given, structure)?;
        // Only a beam can be cut.
        segments(ABOUT.name, structure)?;
        structure.joints.push(Joint { z_m, flexibility_rad_n_m: given.or_zero(FLEXIBILITY.name) });
        Ok(())
    }
}
