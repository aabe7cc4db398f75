//! `base-rotation`: the foundation turns under moment, as on soil.

use super::target::base;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "base-rotation",
    physics: "The foundation turns under the overturning moment, as soil and piles give way, where the model is clamped. \
         Without axes both turn alike.",
    formula: "a rotational spring under the base: x_b = -(I + C K_bb)^-1 C K_bf x_f with C the flexibility; springs in \
         series add",
    fingerprint: "the lowest modes are too low and move at the base; high modes hardly change",
    look_alikes: &[
        LookAlike {
            kind: "base-translation",
            separated_by: "a sensor at the base, or one just above it: turning grows with height, sliding does not",
        },
        LookAlike { kind: "p-delta", separated_by: "higher bending modes, which weight does not move" },
        LookAlike {
            kind: "connection-flexibility",
            separated_by: "sensors just above the base: a joint higher up leaves what is below it at rest",
        },
        LookAlike { kind: "stiffness-loss", separated_by: "sensors on both sides of the lowest segments" },
        LookAlike { kind: "stiffness-scale", separated_by: "the higher modes, which a base spring hardly moves" },
    ],
    source: "G. Gazetas (1991), Formulas and charts for impedances of surface and embedded foundations, J. Geotech. Eng. \
         117",
};

const fn flexibility(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "rad/(N m)", meaning)
}

const BOTH: &[Parameter] = &[flexibility("flexibility", "rotation of the base under a unit moment about X or Y")];
const EACH: &[Parameter] = &[
    flexibility("flexibility_x", "the same about X (motion along Y)"),
    flexibility("flexibility_y", "the same about Y (motion along X)"),
];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct BaseRotation;

impl EffectKind for BaseRotation {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[BOTH, EACH]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let flexibilities = given.by_axis("flexibility", ["flexibility_x", "flexibility_y"]);
        for (total, value) in base(ABOUT.name, structure)?.rotation_rad_n_m.iter_mut().zip(flexibilities) {
            *total += value;
        }
        Ok(())
    }
}
