//! What effects that put the base of a beam on springs have in common: one flexibility for all axes, or one each.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given};
use super::parameter::Parameter;
use crate::model::base::BaseFlexibility;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

/// A kind of effect on the base. Its parameters are `flexibility`, or `flexibility_x` and `flexibility_y`; others may stand beside them.
#[derive(Debug)]
pub(super) struct BaseSprings {
    pub(super) about: &'static About,
    pub(super) parameter_sets: &'static [&'static [Parameter]],
    /// The base with these flexibilities of X and Y, and what else is given.
    pub(super) base: fn([f64; 2], &Given<'_>) -> BaseFlexibility,
}

impl EffectKind for BaseSprings {
    fn about(&self) -> &'static About {
        self.about
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        self.parameter_sets
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_base(self, structure)?;
        let each = given.of_axes("flexibility", ["flexibility_x", "flexibility_y"]);
        Ok(Arc::new((self.base)(each, given)))
    }
}

impl Contribution for BaseFlexibility {
    fn base_flexibility(&self) -> BaseFlexibility {
        *self
    }
}
