//! `sensor-rotation@node`, or of all: horizontal sensors point elsewhere than the study says.

use super::target::node;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{SensorChange, Structure};

const ABOUT: About = About {
    name: "sensor-rotation",
    physics: "The azimuths of a node's sensors, or of all, were noted against the wrong north or the box was mounted \
         turned. What each records is a mix of two directions.",
    formula: "azimuth becomes azimuth + angle",
    fingerprint: "shapes turned at one node (or at all) by one angle in all modes; frequencies right",
    look_alikes: &[
        LookAlike {
            kind: "axis-rotation",
            separated_by: "exact twin of all sensors turned: survey the azimuth of a few sensors",
        },
        LookAlike { kind: "sensor-gain", separated_by: "whether other channels of the node are off as well" },
    ],
    source: "Any survey of sensor azimuths",
};

const ANGLE: Parameter = Parameter::ranged("angle", "deg", [-180.0, 180.0], 10.0, "true azimuth less the stated one");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorRotation;

impl EffectKind for SensorRotation {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::NodeOrAll
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[ANGLE]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let node = match given.place {
            Some(_) => Some(node(ABOUT.name, given)?),
            None => None,
        };
        structure.sensing.changes.push(SensorChange::Turn { node, angle_deg: given.or_zero(ANGLE.name) });
        Ok(())
    }
}
