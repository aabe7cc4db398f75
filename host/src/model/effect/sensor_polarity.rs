//! `sensor-polarity@ch`: a channel is wired or mounted the wrong way round.

use super::target::channels;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{SensorChange, Structure};

const ABOUT: About = About {
    name: "sensor-polarity",
    physics: "A channel records the opposite of the true motion: a sensor mounted upside down, swapped wires. Every mode \
         shows it at that channel.",
    formula: "the row of the channel in every shape times -1",
    fingerprint: "one channel of the wrong sign in all modes; frequencies right",
    look_alikes: &[
        LookAlike { kind: "sensor-gain", separated_by: "the sign" },
        LookAlike { kind: "sensor-rotation", separated_by: "half a turn of a node of one sensor is the same" },
    ],
    source: "C. R. Farrar, K. Worden (2013), Structural Health Monitoring, section 4.11",
};

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorPolarity;

impl EffectKind for SensorPolarity {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Channel
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        for channel in channels(ABOUT.name, given)? {
            structure.sensing.changes.push(SensorChange::Gain { channel: channel.clone(), factor: -1.0 });
        }
        Ok(())
    }
}
