//! `mass-scale`: all of M times (1 + value), as a wrong density or dead load would do.

use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "mass-scale",
    physics: "All of the structure is heavier or lighter than modelled by one factor, as where finishes and live load were \
         guessed. Every frequency moves alike and no shape changes.",
    formula: "M becomes (1 + relative) M",
    fingerprint: "all frequencies off by the same percentage, shapes right",
    look_alikes: &[
        LookAlike {
            kind: "stiffness-scale",
            separated_by: "exact twin from modes alone: (1 + mass) = 1 / (1 + stiffness). Weigh: a known mass added, or a \
                 static load and its deflection",
        },
        LookAlike {
            kind: "added-mass",
            separated_by: "shapes and the spread over the modes: a mass at a height moves those modes that move there",
        },
    ],
    source: "M. I. Friswell, J. E. Mottershead (1995), Finite Element Model Updating in Structural Dynamics, section 2.5",
};

const RELATIVE: Parameter =
    Parameter::ranged("relative", "-", [-0.9, 9.0], 0.1, "all mass is that of the model times (1 + relative)");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct MassScale;

impl EffectKind for MassScale {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[RELATIVE]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        structure.mass_factor *= 1.0 + given.or_zero(RELATIVE.name);
        Ok(())
    }
}
