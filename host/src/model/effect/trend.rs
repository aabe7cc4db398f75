//! What effects that show over the hours of a record have in common.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Evidence, Given};
use super::parameter::Parameter;
use crate::model::contribution::{Contribution, OnlyOverTime};
use crate::model::structure::Structure;

/// A kind of effect by which a structure moves about the record's mean. The model is that of the mean, so it contributes
/// nothing to it.
#[derive(Debug)]
pub(super) struct Trend {
    pub(super) about: &'static About,
    pub(super) evidence: Evidence,
    pub(super) parameter_sets: &'static [&'static [Parameter]],
}

impl EffectKind for Trend {
    fn about(&self) -> &'static About {
        self.about
    }

    fn evidence(&self) -> Evidence {
        self.evidence
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        self.parameter_sets
    }

    fn contribution(&self, _given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        Ok(Arc::new(OnlyOverTime))
    }
}
