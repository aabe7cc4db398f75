//! `sensor-rotation@node`, or of all: horizontal sensors point elsewhere than the study says.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::{PlaceKind, Where};
use crate::model::contribution::{Contribution, OnSensors};
use crate::model::sensing::SensorChange;
use crate::model::structure::Structure;
use crate::study::{Direction, Sensor};

const ABOUT: About = About {
    name: "sensor-rotation",
    physics: "The azimuths of a node's sensors, or of all, were measured from the wrong north, or the box was mounted \
         turned. Each sensor records a mix of two directions.",
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
    examples: &["sensor-rotation@node3=15"],
};

/// By a drawing or a compass, sensors are mounted to about a degree.
const MOUNTING_DEG: f64 = 1.0;
const ANGLE: Parameter = Parameter::ranged("angle", "deg", [-180.0, 180.0], 10.0, "true azimuth less the stated one")
    .usually_within(MOUNTING_DEG);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SensorRotation;

impl EffectKind for SensorRotation {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::NodeOrAll
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[ANGLE]]
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let node = match given.place() {
            Some(&Where::Node(node)) => Some(node),
            Some(_) => return Err(given.wrong_place(self)),
            None => None,
        };
        Ok(OnSensors::only(Turn { node, angle_deg: given.or_zero(ANGLE.name) }))
    }
}

/// Horizontal sensors of a node, or of all, that point elsewhere.
#[derive(Debug)]
struct Turn {
    node: Option<u16>,
    /// True azimuth less stated azimuth.
    angle_deg: f64,
}

impl SensorChange for Turn {
    fn turn(&self, sensor: &mut Sensor) {
        if let Some(Direction::AzimuthDeg(azimuth_deg) | Direction::Inclined { azimuth_deg, .. }) =
            &mut sensor.direction
            && self.node.is_none_or(|node| node == sensor.node)
        {
            *azimuth_deg += self.angle_deg;
        }
    }
}
