//! `mass-scale`: all of M times (1 + value), as a wrong density or dead load would do.

use super::kind::{About, LookAlike};
use super::scale::Scale;
use crate::model::contribution::Factors;

const ABOUT: About = About {
    name: "mass-scale",
    physics: "All of the structure is heavier or lighter than modelled by one factor, for instance because finishes and live \
         load were estimated. Every frequency moves alike and no shape changes.",
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
    examples: &["mass-scale=0.05"],
};

/// See [`ABOUT`].
pub(super) const KIND: Scale = Scale {
    about: &ABOUT,
    parameter_sets: &[&[Scale::relative("all mass is that of the model times (1 + relative)")]],
    factors: |mass| Factors { mass, stiffness: 1.0 },
};
