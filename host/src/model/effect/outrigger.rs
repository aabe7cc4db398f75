//! `outrigger@z`: arms to outer columns hold the structure upright at a height.

use super::ground_springs::{GroundSprings, Motion};
use super::kind::{About, LookAlike};
use super::parameter::Parameter;

const ABOUT: About = About {
    name: "outrigger",
    physics: "Stiff arms to outer columns resist the rotation of the core at one height. The model leaves them out.",
    formula: "K += k (n_rx^T n_rx + n_ry^T n_ry), n the rotation of the axis at z",
    fingerprint: "frequencies too high, most in modes that turn at z; rank one in each direction",
    look_alikes: &[
        LookAlike { kind: "stiffness-scale", separated_by: "modes that hardly turn at z" },
        LookAlike { kind: "lateral-support", separated_by: "which modes rise: a support holds those that move at z" },
        LookAlike {
            kind: "base-rotation",
            separated_by: "a base that is stiffer than modelled cannot raise frequencies above those of a clamped one",
        },
    ],
    source: "B. S. Smith, A. Coull (1991), Tall Building Structures, chapter 14",
    examples: &["outrigger@300m=1e12", "outrigger@300m=stiffness_x=1e12,stiffness_y=3e11"],
};

const fn stiffness(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "N m/rad", meaning)
}

/// See [`ABOUT`].
pub(super) const KIND: GroundSprings = GroundSprings {
    about: &ABOUT,
    parameter_sets: &[
        &[stiffness("stiffness", "moment to the ground for a unit rotation about X or Y")],
        &[
            stiffness("stiffness_x", "the same about X (motion along Y)"),
            stiffness("stiffness_y", "the same about Y (motion along X)"),
        ],
    ],
    resisted: Motion::Rotation,
    // They are built where the structure turns: at half of the height and above (Smith and Coull, chapter 14).
    looked_for_above: 0.2,
};
