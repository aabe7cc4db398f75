//! `base-rotation`: the foundation turns under moment, as on soil.

use super::{EffectError, EffectKind, Parameter, Where, base};
use crate::model::Structure;

const fn flexibility(name: &'static str) -> Parameter {
    Parameter { name, unit: "rad/(N m)", least: 0.0, greatest: f64::INFINITY }
}

const BOTH: &[Parameter] = &[flexibility("flexibility")];
const EACH: &[Parameter] = &[flexibility("flexibility_x"), flexibility("flexibility_y")];

/// A rotational spring under the base in series with what is there; `flexibility_x` is about X (motion in Y).
#[derive(Debug)]
pub(super) struct BaseRotation;

impl EffectKind for BaseRotation {
    fn name(&self) -> &'static str {
        "base-rotation"
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[BOTH, EACH]
    }

    fn apply(&self, values: &[f64], _place: Option<&Where>, structure: &mut Structure) -> Result<(), EffectError> {
        // One value serves both axes. Springs in series: their flexibilities add.
        for (total, value) in base(self.name(), structure)?.rotation_rad_n_m.iter_mut().zip(values.iter().cycle()) {
            *total += value;
        }
        Ok(())
    }
}
