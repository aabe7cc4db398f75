//! `sensor-gain@ch`: a channel records too much or too little.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::contribution::{Contribution, OnSensors};
use crate::model::sensing::{SensorChange, row_of};
use crate::model::structure::Structure;
use crate::study::Sensor;

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
    examples: &["sensor-gain@07=1.5"],
};

/// MEMS accelerometers leave the factory within 8 % (ADXL355), and calibration in the field brings them within about two.
const CALIBRATION: f64 = 0.02;
const FACTOR: Parameter =
    Parameter::factor("factor", [0.0, 100.0], 0.3, "recorded over true motion").usually_within(CALIBRATION);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorGain;

impl EffectKind for SensorGain {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Channel
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[FACTOR]]
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let factor = given.value(FACTOR.name).unwrap_or(1.0);
        Ok(OnSensors::only(Gain { channels: given.channels(self)?.to_vec(), factor }))
    }
}

/// Channels that record `factor` times the true motion.
#[derive(Debug)]
pub(super) struct Gain {
    pub(super) channels: Vec<String>,
    pub(super) factor: f64,
}

impl SensorChange for Gain {
    fn record(&self, rows: &mut DMatrix<f64>, sensors: &[Sensor]) {
        for index in self.channels.iter().filter_map(|channel| row_of(channel, sensors)) {
            let mut row = rows.row_mut(index);
            row *= self.factor;
        }
    }
}
