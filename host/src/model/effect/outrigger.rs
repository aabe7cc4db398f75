//! `outrigger@z`: arms to outer columns, or cables, hold the structure upright at a height.

use super::target::height;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{GroundSpring, Structure};

const ABOUT: About = About {
    name: "outrigger",
    physics: "Stiff arms to outer columns, or stays, resist the rotation of the core at one height. The model leaves them \
         out.",
    formula: "K += k (n_rx^T n_rx + n_ry^T n_ry), n the rotation of the axis at z",
    fingerprint: "frequencies too high, most in modes that turn at z; rank one in each direction",
    look_alikes: &[
        LookAlike { kind: "stiffness-scale", separated_by: "modes that hardly turn at z" },
        LookAlike {
            kind: "base-rotation",
            separated_by: "a base that is stiffer than modelled cannot raise frequencies above those of a clamped one",
        },
    ],
    source: "B. S. Smith, A. Coull (1991), Tall Building Structures, chapter 14",
};

const STIFFNESS: Parameter = Parameter::positive("stiffness", "N m/rad", "moment to the ground for a unit rotation");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct Outrigger;

impl EffectKind for Outrigger {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[STIFFNESS]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let z_m = height(ABOUT.name, given, structure)?;
        structure.ground_springs.push(GroundSpring { z_m, stiffness_n_m: given.or_zero(STIFFNESS.name) });
        Ok(())
    }
}
