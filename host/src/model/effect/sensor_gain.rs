//! `sensor-gain@ch`: a channel records too much or too little.

use super::target::channels;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{SensorChange, Structure};

const ABOUT: About = About {
    name: "sensor-gain",
    physics: "The sensitivity of a channel is not what the study says: a wrong range, a wrong factor, a weak amplifier. \
         Every mode shows it at that channel by the same factor.",
    formula: "the row of the channel in every shape times factor",
    fingerprint: "one channel off by one factor in all modes; frequencies right",
    look_alikes: &[
        LookAlike { kind: "sensor-polarity", separated_by: "the sign" },
        LookAlike { kind: "sensor-rotation", separated_by: "whether other channels of the node are off as well" },
    ],
    source: "M. Brownjohn et al. (2003), handling of sensor errors in ambient vibration surveys; any calibration",
};

const FACTOR: Parameter = Parameter::factor("factor", [0.0, 100.0], 0.3, "recorded over true motion");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorGain;

impl EffectKind for SensorGain {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Channel
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[FACTOR]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let factor = given.value(FACTOR.name).unwrap_or(1.0);
        for channel in channels(ABOUT.name, given)? {
            structure.sensing.changes.push(SensorChange::Gain { channel: channel.clone(), factor });
        }
        Ok(())
    }
}
