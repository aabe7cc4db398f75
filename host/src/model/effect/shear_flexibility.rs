//! `shear-flexibility`: the beam gives way in shear more than modelled.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::beam::Segment;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "shear-flexibility",
    physics: "Frames, coupled walls and tubes with openings deform in shear far more than a plain section would. The \
         deflection grows with shear force, which higher modes have more of.",
    formula: "1/kGA becomes (1 + relative)/kGA; where the table is rigid in shear, 1/kGA becomes the flexibility",
    fingerprint: "frequencies too low, the more the higher the mode",
    look_alikes: &[
        LookAlike {
            kind: "rotary-inertia",
            separated_by: "shapes of the highest modes; rotational sensors. On a uniform beam with frequencies alone they are \
                 twins",
        },
        LookAlike { kind: "base-translation", separated_by: "sensors in the lower third" },
    ],
    source: "S. P. Timoshenko (1921), Phil. Mag. 41, 744; J. S. Przemieniecki (1968), eq. 5.116",
    examples: &["shear-flexibility=0.3", "shear-flexibility=flexibility=1e-11"],
};

const RELATIVE: Parameter = Parameter::ranged(
    "relative",
    "-",
    [0.0, 100.0],
    0.5,
    "shear flexibility is that of the table times (1 + relative)",
);
const FLEXIBILITY: Parameter = Parameter::positive(
    "flexibility",
    "1/N",
    "added to 1/kGA of every segment, also where the table is rigid in shear",
);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct ShearFlexibility;

impl EffectKind for ShearFlexibility {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[RELATIVE], &[FLEXIBILITY]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_beam(self, structure)?;
        let is_rigid = |segment: &Segment| segment.shear_n == [None; 2];
        if given.value(RELATIVE.name).is_some() && structure.segments().is_some_and(|all| all.iter().all(is_rigid)) {
            return Err(EffectError::NothingToScale {
                kind: ABOUT.name,
                missing: "the table is rigid in shear, so there is nothing to scale",
                instead: "flexibility = ... in 1/N",
            });
        }
        let (factor, added_per_n) = (1.0 + given.or_zero(RELATIVE.name), given.or_zero(FLEXIBILITY.name));
        Ok(Arc::new(SofterInShear { factor, added_per_n }))
    }
}

/// Shear flexibility times a factor, and more besides.
#[derive(Debug)]
struct SofterInShear {
    factor: f64,
    added_per_n: f64,
}

impl Contribution for SofterInShear {
    fn change_segments(&self, segments: &mut [Segment]) {
        for segment in segments {
            segment.shear_n = segment.shear_n.map(|shear_n| {
                let flexibility = shear_n.map_or(0.0, |shear_n| self.factor / shear_n) + self.added_per_n;
                (flexibility > 0.0).then(|| 1.0 / flexibility)
            });
        }
    }
}
