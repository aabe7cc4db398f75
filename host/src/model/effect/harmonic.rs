//! `harmonic@f`: a machine or a vortex street drives the structure at one frequency.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Evidence, Given, LookAlike};
use super::parameter::Parameter;
use super::place::{PlaceKind, Where};
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "harmonic",
    physics: "A fan, a pump or shed vortices force the structure at one frequency. The line looks like a mode, but it \
         belongs to the machine and not to the structure.",
    formula: "none of M, C and K: the line at f is left out of the modes",
    fingerprint: "kurtosis of the band-passed response 1.5 (a mode's is 3), no finite damping, several singular values rise \
         together",
    look_alikes: &[LookAlike { kind: "tuned-mass-damper", separated_by: "its damping: a damper's twin peak is wide" }],
    source: "R. Brincker, P. Andersen, N. Moller (2000), An indicator for separation of structural and harmonic modes, \
         IMAC 18",
    examples: &["harmonic@0.83hz", "harmonic@0.83hz=0.83"],
};

const FREQUENCY: Parameter = Parameter::given("frequency", "Hz", [0.0, f64::INFINITY], "the frequency of the line");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct Harmonic;

impl EffectKind for Harmonic {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Frequency
    }

    fn evidence(&self) -> Evidence {
        Evidence::Kurtosis
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[], &[FREQUENCY]]
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let Some(&Where::Frequency(frequency_hz)) = given.place() else { return Err(given.wrong_place(self)) };
        Ok(Arc::new(ForcedLine { frequency_hz }))
    }
}

/// A line of the spectrum that is no mode.
#[derive(Debug)]
struct ForcedLine {
    frequency_hz: f64,
}

impl Contribution for ForcedLine {
    fn forced_hz(&self) -> Option<f64> {
        Some(self.frequency_hz)
    }
}
