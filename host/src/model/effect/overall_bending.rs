//! `overall-bending`: a frame bends as one, and a model of storeys has that in the shear of its storeys.

use super::frame_bending::FrameBending;
use super::kind::{About, LookAlike};
use super::parameter::Parameter;
use crate::model::storeys::Bending;

const ABOUT: About = About {
    name: "overall-bending",
    physics: "A model of storeys lets each floor shear over the next below. A tall frame bends as one besides: columns on one side get \
         shorter, those on the other longer. Storey stiffnesses that were taken from the sway under a load have both in one: right for that \
         load, too soft for higher modes.",
    formula: "K becomes (K_s^-1 + c F)^-1: F sways of a cantilever of EI = 1, c = share u(top) / (F m z)(top) with u the sway of the storeys \
         under loads m z, and K_s storeys of shear / (drift - c bending's drift), which leaves u what it was until a storey is ten times as stiff, its limit",
    fingerprint: "frequencies of higher modes too low in the model, the more the higher, while the first is nearly right; upper storeys look \
         stiffer than drawn, lower ones softer",
    look_alikes: &[
        LookAlike {
            kind: "base-rotation",
            separated_by: "higher modes: a base that turns lowers the first and leaves them",
        },
        LookAlike { kind: "chord-drift", separated_by: "the first mode: chord drift lowers it, and higher ones less" },
        LookAlike { kind: "group", separated_by: "modes of a higher order: one storey does not move all of them" },
    ],
    source: "B. Stafford Smith, A. Coull (1991), Tall Building Structures, chapter 7 (drift by overall bending)",
    examples: &["overall-bending=0.2", "overall-bending=share_x=0.2,share_y=0.1"],
};

/// Shear keeps something of every storey's drift.
const LARGEST: f64 = 0.9;

const fn share(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "-", [0.0, LARGEST], 0.15, meaning)
}

/// See [`ABOUT`].
pub(super) const KIND: FrameBending = FrameBending {
    about: &ABOUT,
    parameter_sets: &[
        &[share(
            "share",
            "of the top's sway under loads in proportion to mass and height, what is bending of the whole",
        )],
        &[share("share_x", "the same of motion along X"), share("share_y", "the same of motion along Y")],
    ],
    bending: Bending::InStoreys,
};
