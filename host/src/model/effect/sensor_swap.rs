//! `sensor-swap@a+b`: two channels are each other's.

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
    name: "sensor-swap",
    physics: "Two cables, or two lines of the sensor table, were exchanged. Each channel shows the motion of the other's \
         place in all modes.",
    formula: "the rows of the two channels exchanged in every shape",
    fingerprint: "two channels wrong in all modes, each right at the other's place; frequencies right",
    look_alikes: &[LookAlike {
        kind: "sensor-rotation",
        separated_by: "whether turning the node explains both channels",
    }],
    source: "C. R. Farrar, K. Worden (2013), Structural Health Monitoring, section 4.11",
    examples: &["sensor-swap@04+05"],
};

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorSwap;

impl EffectKind for SensorSwap {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::TwoChannels
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[]]
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        match given.channels(self)? {
            [one, other] => Ok(OnSensors::only(Swap { channels: [one.clone(), other.clone()] })),
            _ => Err(given.wrong_place(self)),
        }
    }
}

/// Two channels that are each other's.
#[derive(Debug)]
struct Swap {
    channels: [String; 2],
}

impl SensorChange for Swap {
    fn record(&self, rows: &mut DMatrix<f64>, sensors: &[Sensor]) {
        if let [Some(one), Some(other)] = self.channels.each_ref().map(|channel| row_of(channel, sensors)) {
            rows.swap_rows(one, other);
        }
    }
}
