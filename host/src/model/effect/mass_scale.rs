//! `mass-scale`: all of M times (1 + value), as a wrong density or dead load would do.

use super::{EffectError, EffectKind, Parameter, Where};
use crate::model::Structure;

const RELATIVE: Parameter = Parameter { name: "relative", unit: "-", least: -0.9, greatest: 9.0 };

/// All frequencies fall by the square root of 1 + `relative`, shapes stay. Exact twin: the inverse stiffness scale.
#[derive(Debug)]
pub(super) struct MassScale;

impl EffectKind for MassScale {
    fn name(&self) -> &'static str {
        "mass-scale"
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[RELATIVE]]
    }

    fn apply(&self, values: &[f64], _place: Option<&Where>, structure: &mut Structure) -> Result<(), EffectError> {
        structure.mass_factor *= values.iter().fold(1.0, |factor, relative| factor * (1.0 + relative));
        Ok(())
    }
}
