//! `rotary-inertia`: floors and sections resist turning more than modelled.

use super::target::segments;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "rotary-inertia",
    physics: "Wide floors and ring beams resist turning about a horizontal axis. Models with lumped translational masses \
         leave that out.",
    formula: "rotary inertias about X and Y times (1 + relative); where the table has none, mass times radius squared",
    fingerprint: "frequencies too low, the more the higher the mode; torsion untouched",
    look_alikes: &[LookAlike {
        kind: "shear-flexibility",
        separated_by: "shapes of the highest modes; rotational sensors. On a uniform beam with frequencies alone they are \
                 twins",
    }],
    source: "Lord Rayleigh (1894), The Theory of Sound, section 162",
};

const RELATIVE: Parameter = Parameter::ranged(
    "relative",
    "-",
    [0.0, 1000.0],
    1.0,
    "rotary inertias are those of the table times (1 + relative)",
);
const RADIUS: Parameter =
    Parameter::positive("radius", "m", "radius of gyration: mass times radius squared is added at every node");

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

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let (factor, radius_m) = (1.0 + given.or_zero(RELATIVE.name), given.or_zero(RADIUS.name));
        let segments = segments(ABOUT.name, structure)?;
        let has_none = segments.iter().all(|segment| segment.inertia_kg_m2[..2] == [0.0; 2]);
        if has_none && given.value(RELATIVE.name).is_some() {
            return Err(EffectError::NothingToScale {
                kind: ABOUT.name,
                missing: "the table has no rotary inertia to scale",
                instead: "radius = ... in m",
            });
        }
        for segment in segments {
            let added = segment.mass_top_kg * radius_m * radius_m;
            for inertia in &mut segment.inertia_kg_m2[..2] {
                *inertia = *inertia * factor + added;
            }
        }
        Ok(())
    }
}
