//! `base-translation`: the foundation slides under shear, as on soil or piles.

use super::target::base;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "base-translation",
    physics: "The foundation slides under the base shear, as soil and piles give way, where the model is clamped. Without \
         axes both directions slide alike.",
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
};

const fn flexibility(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "m/N", meaning)
}

const BOTH: &[Parameter] = &[flexibility("flexibility", "translation of the base under a unit force along X or Y")];
const EACH: &[Parameter] =
    &[flexibility("flexibility_x", "the same along X"), flexibility("flexibility_y", "the same along Y")];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct BaseTranslation;

impl EffectKind for BaseTranslation {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[BOTH, EACH]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let flexibilities = given.by_axis("flexibility", ["flexibility_x", "flexibility_y"]);
        for (total, value) in base(ABOUT.name, structure)?.translation_m_n.iter_mut().zip(flexibilities) {
            *total += value;
        }
        Ok(())
    }
}
