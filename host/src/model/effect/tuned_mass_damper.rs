//! `tuned-mass-damper@z`: a mass on a spring and a dashpot.

use super::target::height;
use super::{About, EffectError, EffectKind, Evidence, Given, LookAlike, Parameter, Place, Prior};
use crate::model::{Structure, TunedMass};

const ABOUT: About = About {
    name: "tuned-mass-damper",
    physics: "A damper that the model does not know is tuned to a mode: a pendulum, a water tank, a mass on rubber. It \
         splits the peak of that mode into two with high damping and like shapes.",
    formula: "one more DOF for each direction: k = m (2 pi f)^2 and c = 4 pi f zeta m to the axis at z",
    fingerprint: "split peak: twins with a MAC near 1 and high damping",
    look_alikes: &[LookAlike { kind: "added-mass", separated_by: "the twin peak: a mass that is fixed has none" }],
    source: "J. P. Den Hartog (1956), Mechanical Vibrations, section 3.3",
};

const MASS: Parameter = Parameter { prior: Prior::Share(1.0), ..Parameter::positive("mass", "kg", "the moving mass") };
const FREQUENCY: Parameter = Parameter {
    prior: Prior::Share(0.1),
    ..Parameter::ranged("frequency", "Hz", [1e-4, 1e4], 1.0, "its own frequency")
};
// Without a dashpot at all, nothing would say what one does.
const DAMPING: Parameter = Parameter::ranged("damping_ratio", "-", [1e-4, 0.5], 0.05, "its own damping ratio");
const AXIS: Parameter =
    Parameter::given("axis", "x or y", [1.0, 2.0], "the direction in which it moves; both without it");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct TunedMassDamper;

impl EffectKind for TunedMassDamper {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Height
    }

    fn evidence(&self) -> Evidence {
        Evidence::TwinPeaks
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[MASS, FREQUENCY, DAMPING], &[MASS, FREQUENCY, DAMPING, AXIS]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let z_m = height(ABOUT.name, given, structure)?;
        structure.tuned_masses.push(TunedMass {
            z_m,
            mass_kg: given.or_zero(MASS.name),
            frequency_hz: given.or_zero(FREQUENCY.name),
            damping_ratio: given.or_zero(DAMPING.name),
            moves: match given.value(AXIS.name) {
                Some(axis) => [axis < 1.5, axis >= 1.5],
                None => [true; 2],
            },
        });
        Ok(())
    }
}
