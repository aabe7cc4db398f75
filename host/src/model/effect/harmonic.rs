//! `harmonic@f`: a machine or a vortex street drives the structure at one frequency.

use super::target::wrong_place;
use super::{About, EffectError, EffectKind, Evidence, Given, LookAlike, Parameter, Place, Where};
use crate::model::Structure;

const ABOUT: About = About {
    name: "harmonic",
    physics: "A fan, a pump or shed vortices force the structure at one frequency. The line looks like a mode, but it is \
         what drives the structure and not how the structure swings.",
    formula: "none of M, C and K: the line at f is left out of the modes",
    fingerprint: "kurtosis of the band-passed response 1.5 (a mode's is 3), no finite damping, several singular values rise \
         together",
    look_alikes: &[LookAlike { kind: "tuned-mass-damper", separated_by: "its damping: a damper's twin peak is wide" }],
    source: "R. Brincker, P. Andersen, N. Moller (2000), An indicator for separation of structural and harmonic modes, \
         IMAC 18",
};

const FREQUENCY: Parameter = Parameter::given("frequency", "Hz", [0.0, f64::INFINITY], "the frequency of the line");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct Harmonic;

impl EffectKind for Harmonic {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Frequency
    }

    fn evidence(&self) -> Evidence {
        Evidence::Kurtosis
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[], &[FREQUENCY]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        match given.place {
            Some(&Where::Frequency(frequency_hz)) => structure.forced_hz.push(frequency_hz),
            _ => return Err(wrong_place(ABOUT.name, given, "needs a frequency such as @0.83hz")),
        }
        Ok(())
    }
}
