//! `stiffness-scale`: all of K times (1 + value), as a wrong modulus of elasticity would do.

use super::kind::{About, LookAlike};
use super::scale::Scale;
use crate::model::contribution::Factors;

const ABOUT: About = About {
    name: "stiffness-scale",
    physics: "All of the structure is stiffer or softer than modelled by one factor, for instance because the modulus of \
         elasticity of the concrete was taken from a standard. Every frequency moves alike and no shape changes.",
    formula: "K becomes (1 + relative) K; springs under the base (base-rotation and its like) are soil, and stay as they are",
    fingerprint: "all frequencies off by the same percentage, shapes right",
    look_alikes: &[
        LookAlike {
            kind: "mass-scale",
            separated_by: "exact twin from modes alone: (1 + stiffness) = 1 / (1 + mass). Weigh: a known mass added (a full \
                 water tank, a vehicle), or a static load and its deflection",
        },
        LookAlike {
            kind: "base-rotation",
            separated_by: "shapes near the base, and the higher modes, which a base spring hardly moves",
        },
        LookAlike {
            kind: "temperature-stiffness",
            separated_by: "days at another temperature: identify --every with a temperature file",
        },
    ],
    source: "M. I. Friswell, J. E. Mottershead (1995), Finite Element Model Updating in Structural Dynamics, section 2.5",
    examples: &["stiffness-scale=0.1"],
};

/// See [`ABOUT`].
pub(super) const KIND: Scale = Scale {
    about: &ABOUT,
    parameter_sets: &[&[Scale::relative("all stiffness is that of the model times (1 + relative)")]],
    factors: |stiffness| Factors { stiffness, mass: 1.0 },
};
