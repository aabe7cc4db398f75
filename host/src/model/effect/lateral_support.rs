//! `lateral-support@z`: guys, a tie to a neighbour or a floor that leans on one hold the structure at a height.

use super::ground_springs::{GroundSprings, Motion};
use super::kind::{About, LookAlike};
use super::parameter::Parameter;

const ABOUT: About = About {
    name: "lateral-support",
    physics: "Guys, a tie to a neighbour, or a floor that leans on one resist sway at one height, and twist where they \
         hold the structure away from its axis. The model leaves them out.",
    formula: "K += k (n_x^T n_x + n_y^T n_y) + k_z n_rz^T n_rz, n the motion of the axis at z",
    fingerprint: "frequencies too high, most in modes that move most at z, and not in those with a node there; shapes held back at z",
    look_alikes: &[
        LookAlike { kind: "stiffness-scale", separated_by: "modes with a node at z, which a support leaves alone" },
        LookAlike { kind: "outrigger", separated_by: "which modes rise: an outrigger holds those that turn at z" },
        LookAlike {
            kind: "soil-springs",
            separated_by: "sensors below z: a support holds one point, soil the whole length below",
        },
    ],
    source: "H. M. Irvine (1981), Cable Structures, chapter 4",
    examples: &[
        "lateral-support@60m=5e6",
        "lateral-support@60m=stiffness_x=5e6,stiffness_y=0",
        "lateral-support@60m=stiffness_x=5e6,stiffness_y=0,stiffness_z=1e8",
    ],
};

const fn stiffness(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "N/m", meaning)
}

const ALONG_X: Parameter = stiffness("stiffness_x", "the same along X");
const ALONG_Y: Parameter = stiffness("stiffness_y", "the same along Y");
const TWIST: Parameter = Parameter::positive(
    "stiffness_z",
    "N m/rad",
    "moment for a unit twist; springs at a distance r from the axis have r² times their stiffness across r",
);

/// See [`ABOUT`].
pub(super) const KIND: GroundSprings = GroundSprings {
    about: &ABOUT,
    parameter_sets: &[
        &[stiffness("stiffness", "force to the ground for a unit displacement along X or Y")],
        &[ALONG_X, ALONG_Y],
        &[ALONG_X, ALONG_Y, TWIST],
    ],
    resisted: Motion::Sway,
    looked_for_above: 0.1,
};
