//! `base-translation`: the foundation slides under shear, as on soil or piles.

use super::base::BaseSprings;
use super::kind::{About, LookAlike};
use super::parameter::Parameter;
use crate::model::base::BaseFlexibility;

const ABOUT: About = About {
    name: "base-translation",
    physics: "The foundation slides under the base shear because soil and piles give way; the model is clamped. One \
         value applies to both directions.",
    formula: "a translational spring under the base, eliminated as for base-rotation; springs in series add",
    fingerprint: "the higher the shear at the base, the lower the mode: second and third bending modes most; shapes do not \
         vanish at the base",
    look_alikes: &[
        LookAlike {
            kind: "base-rotation",
            separated_by: "a sensor at the base, or one just above it: sliding is the same at all heights near the base, \
                 turning grows with height",
        },
        LookAlike {
            kind: "shear-flexibility",
            separated_by: "sensors in the lower third: shear is spread over the height",
        },
    ],
    source: "G. Gazetas (1991), Formulas and charts for impedances of surface and embedded foundations, J. Geotech. Eng. \
         117",
    examples: &["base-translation=1e-10", "base-translation=flexibility_x=1e-10,flexibility_y=2e-10"],
};

const fn flexibility(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "m/N", meaning)
}

/// See [`ABOUT`].
pub(super) const KIND: BaseSprings = BaseSprings {
    about: &ABOUT,
    parameter_sets: &[
        &[flexibility("flexibility", "translation of the base under a unit force along X or Y")],
        &[flexibility("flexibility_x", "the same along X"), flexibility("flexibility_y", "the same along Y")],
    ],
    base: |translation_m_n, _| BaseFlexibility { translation_m_n, ..BaseFlexibility::default() },
};
