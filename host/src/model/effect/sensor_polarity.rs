//! `sensor-polarity@ch`: a channel is wired or mounted the wrong way round.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use super::sensor_gain::Gain;
use crate::model::contribution::{Contribution, OnSensors};
use crate::model::structure::Structure;

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
    examples: &["sensor-polarity@07"],
};

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorPolarity;

impl EffectKind for SensorPolarity {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Channel
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[]]
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        Ok(OnSensors::only(Gain { channels: given.channels(self)?.to_vec(), factor: -1.0 }))
    }
}
