//! `sensor-swap@a+b`: two channels are each other's.

use super::target::channels;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{SensorChange, Structure};

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
};

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorSwap;

impl EffectKind for SensorSwap {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::TwoChannels
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        if let [one, other] = channels(ABOUT.name, given)? {
            structure.sensing.changes.push(SensorChange::Swap { channels: [one.clone(), other.clone()] });
        }
        Ok(())
    }
}
