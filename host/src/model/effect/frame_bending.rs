//! What the two effects have in common by which a frame bends as one where a model of storeys only shears: a share of the sway, for both
//! directions or for each.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::contribution::{Contribution, Factors};
use crate::model::storeys::{Bending, Storeys};
use crate::model::structure::Structure;

/// A kind of such bending. Its parameters are `NAME`, or `NAME_x` and `NAME_y`.
#[derive(Debug)]
pub(super) struct FrameBending {
    pub(super) about: &'static About,
    pub(super) parameter_sets: &'static [&'static [Parameter]],
    /// What such a share of the sway is.
    pub(super) bending: fn(f64) -> Bending,
}

impl FrameBending {
    /// Along X and Y.
    fn along(&self, given: &Given<'_>) -> [Bending; 2] {
        let both = given.values.first().copied().unwrap_or(0.0);
        [both, given.values.get(1).copied().unwrap_or(both)].map(self.bending)
    }
}

impl EffectKind for FrameBending {
    fn about(&self) -> &'static About {
        self.about
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        self.parameter_sets
    }

    fn caution(&self, given: &Given<'_>, structure: &Structure) -> Option<String> {
        let (along, storeys) = (self.along(given), Storeys::of(structure));
        let limited = along.into_iter().zip(&storeys).zip(["X", "Y"]).filter_map(|((bending, storeys), axis)| {
            let floors_m = storeys.as_ref()?.held_m(bending);
            let floors: Vec<String> = floors_m.iter().map(|floor_m| format!("{floor_m:.1}")).collect();
            (!floors.is_empty()).then(|| format!("{} m (along {axis})", floors.join(", ")))
        });
        let limited: Vec<String> = limited.collect();
        if limited.is_empty() {
            return None;
        }
        Some(format!(
            "{}: with so much bending in their sway, the storeys below {} would be more than ten times as stiff as the model has them, and are held \
             there; some of the bending may not be in the storeys' stiffnesses, or heights or storeys are off",
            self.about.name,
            limited.join(" and ")
        ))
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_storeys(self, structure)?;
        Ok(Arc::new(BendingAsOne { along: self.along(given) }))
    }
}

/// In motion along X and Y.
#[derive(Debug)]
struct BendingAsOne {
    along: [Bending; 2],
}

impl Contribution for BendingAsOne {
    fn reshape(&self, storeys: &[Option<Storeys>; 2], assembly: &mut Assembly, _factors: &Factors) {
        for (storeys, &bending) in storeys.iter().zip(&self.along) {
            if let Some(storeys) = storeys {
                storeys.bend(bending, &mut assembly.stiffness);
            }
        }
    }

    fn reshapes(&self) -> bool {
        true
    }
}
