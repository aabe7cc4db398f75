//! `rotary-inertia`: floors and sections resist turning more than modelled.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::beam::Segment;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "rotary-inertia",
    physics: "Wide floors and ring beams resist turning about a horizontal axis. Models with lumped translational masses \
         ignore this.",
    formula: "rotary inertias about X and Y times (1 + relative); where the table has none, mass times radius squared",
    fingerprint: "frequencies too low, the more the higher the mode; torsion unchanged",
    look_alikes: &[LookAlike {
        kind: "shear-flexibility",
        separated_by: "shapes of the highest modes; rotational sensors. On a uniform beam with frequencies alone they are \
                 twins",
    }],
    source: "Lord Rayleigh (1894), The Theory of Sound, section 162",
    examples: &["rotary-inertia=0.5", "rotary-inertia=radius=2"],
};

/// Tables count the inertia of sections and leave out that of floors, which is some times as large.
const MOST: f64 = 10.0;
/// Half of the width of the widest floors.
const GREATEST_RADIUS_M: f64 = 50.0;
const RELATIVE: Parameter =
    Parameter::ranged("relative", "-", [0.0, MOST], 1.0, "rotary inertias are those of the table times (1 + relative)");
const RADIUS: Parameter = Parameter::squared(
    "radius",
    "m",
    GREATEST_RADIUS_M,
    "radius of gyration: mass times radius squared is added at every node",
);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct RotaryInertia;

impl EffectKind for RotaryInertia {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[RELATIVE], &[RADIUS]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_beam(self, structure)?;
        let has_none = |segment: &Segment| segment.inertia_kg_m2[..2] == [0.0; 2];
        if given.value(RELATIVE.name).is_some() && structure.segments().is_some_and(|all| all.iter().all(has_none)) {
            return Err(EffectError::NothingToScale {
                kind: ABOUT.name,
                missing: "the table has no rotary inertia to scale",
                instead: "radius = ... in m",
            });
        }
        Ok(Arc::new(MoreInertia { factor: 1.0 + given.or_zero(RELATIVE.name), radius_m: given.or_zero(RADIUS.name) }))
    }
}

/// Inertias times a factor, and mass times radius squared besides.
#[derive(Debug)]
struct MoreInertia {
    factor: f64,
    radius_m: f64,
}

impl Contribution for MoreInertia {
    fn change_segments(&self, segments: &mut [Segment]) {
        for segment in segments {
            let added = segment.mass_top_kg * self.radius_m * self.radius_m;
            for inertia in &mut segment.inertia_kg_m2[..2] {
                *inertia = *inertia * self.factor + added;
            }
        }
    }
}
