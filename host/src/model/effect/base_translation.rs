//! `base-translation`: the foundation slides under shear, as on soil or piles.

use super::{EffectError, EffectKind, Parameter, Where, base};
use crate::model::Structure;

const fn flexibility(name: &'static str) -> Parameter {
    Parameter { name, unit: "m/N", least: 0.0, greatest: f64::INFINITY }
}

const BOTH: &[Parameter] = &[flexibility("flexibility")];
const EACH: &[Parameter] = &[flexibility("flexibility_x"), flexibility("flexibility_y")];

/// A translational spring under the base in series with what is there; `flexibility_x` is along X.
#[derive(Debug)]
pub(super) struct BaseTranslation;

impl EffectKind for BaseTranslation {
    fn name(&self) -> &'static str {
        "base-translation"
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[BOTH, EACH]
    }

    fn apply(&self, values: &[f64], _place: Option<&Where>, structure: &mut Structure) -> Result<(), EffectError> {
        // One value serves both axes. Springs in series: their flexibilities add.
        for (total, value) in base(self.name(), structure)?.translation_m_n.iter_mut().zip(values.iter().cycle()) {
            *total += value;
        }
        Ok(())
    }
}
