//! `chord-drift`: a frame bends as one, and a model of storeys leaves that out.

use super::frame_bending::FrameBending;
use super::kind::{About, LookAlike};
use super::parameter::Parameter;
use crate::model::storeys::Bending;

const ABOUT: About = About {
    name: "chord-drift",
    physics: "A tall frame drifts as its columns, the chords, get shorter on one side and longer on the other. Storeys of a stiffness by drawings, \
         12 EI / h^3 of their columns, have nothing of it, and are too stiff.",
    formula: "K becomes (K^-1 + c F)^-1: F sways of a cantilever of EI = 1, c = ratio u(top) / (F m z)(top) with u the sway of the storeys under \
         loads m z",
    fingerprint: "frequencies too high in the model, the first most; upper storeys look softer than drawn, lower ones less",
    look_alikes: &[
        LookAlike {
            kind: "base-rotation",
            separated_by: "shapes: a base that turns adds a straight line, chord drift a curve",
        },
        LookAlike {
            kind: "overall-bending",
            separated_by: "the first mode: bending that the storeys have in their shear already leaves it",
        },
        LookAlike { kind: "stiffness-scale", separated_by: "ratios of frequencies: a scale leaves them" },
    ],
    source: "B. Stafford Smith, A. Coull (1991), Tall Building Structures, chapter 7 (drift by overall bending)",
    examples: &["chord-drift=0.2", "chord-drift=ratio_x=0.2,ratio_y=0.1"],
};

/// A slender frame of stiff storeys bends more than it shears.
const LARGEST: f64 = 5.0;

const fn ratio(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "-", [0.0, LARGEST], 0.15, meaning)
}

/// See [`ABOUT`].
pub(super) const KIND: FrameBending = FrameBending {
    about: &ABOUT,
    parameter_sets: &[
        &[ratio(
            "ratio",
            "sway of the top by chord drift, over its sway by the storeys, both under loads in proportion to mass and height",
        )],
        &[ratio("ratio_x", "the same of motion along X"), ratio("ratio_y", "the same of motion along Y")],
    ],
    bending: Bending::LeftOut,
};
