//! What effects that scale all of K or of M have in common.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given};
use super::parameter::Parameter;
use crate::model::contribution::{Contribution, Factors};
use crate::model::structure::Structure;

/// A kind of effect that multiplies a whole matrix with 1 + `relative`.
#[derive(Debug)]
pub(super) struct Scale {
    pub(super) about: &'static About,
    pub(super) parameter_sets: &'static [&'static [Parameter]],
    /// The factors on K and M by the one that it scales.
    pub(super) factors: fn(f64) -> Factors,
}

const RELATIVE: &str = "relative";

impl Scale {
    /// Its parameter.
    pub(super) const fn relative(meaning: &'static str) -> Parameter {
        Parameter::ranged(RELATIVE, "-", [-0.9, 9.0], 0.1, meaning)
    }
}

impl EffectKind for Scale {
    fn about(&self) -> &'static About {
        self.about
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        self.parameter_sets
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        Ok(Arc::new((self.factors)(1.0 + given.or_zero(RELATIVE))))
    }
}

impl Contribution for Factors {
    fn factors(&self) -> Factors {
        *self
    }
}
