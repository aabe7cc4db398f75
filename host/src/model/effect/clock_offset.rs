//! `clock-offset@node`: a node's samples come late.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Evidence, Given, LookAlike};
use super::parameter::Parameter;
use super::place::{PlaceKind, Where};
use crate::model::contribution::{Contribution, OnSensors};
use crate::model::sensing::SensorChange;
use crate::model::structure::Structure;
use crate::study::Sensor;

const ABOUT: About = About {
    name: "clock-offset",
    physics: "The clock of a node is off, so its samples carry the wrong time. Its channels lag in every mode, by a phase \
         that grows with frequency.",
    formula: "the rows of the node's channels times exp(-i 2 pi f delay)",
    fingerprint: "phase of one node against the others linear in frequency, through zero",
    look_alikes: &[
        LookAlike { kind: "sensor-gain", separated_by: "the phase: a gain has none" },
        LookAlike { kind: "sensor-polarity", separated_by: "the lowest modes, where a delay is a small phase" },
    ],
    source: "J. S. Bendat, A. G. Piersol (2010), Random Data, section 5.2.7",
    examples: &["clock-offset@node3=0.05"],
};

/// A minute is what a crystal of 50 ppm drifts by in two weeks. Clocks that are further off take the lines of two nodes from other
/// minutes, whose coherence is gone; there is no shape to turn back.
const LONGEST_S: f64 = 60.0;
const DELAY: Parameter =
    Parameter::ranged("delay", "s", [-LONGEST_S, LONGEST_S], 0.02, "positive: the node's samples come late");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct ClockOffset;

impl EffectKind for ClockOffset {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Node
    }

    fn evidence(&self) -> Evidence {
        Evidence::Phases
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[DELAY]]
    }

    fn contribution(&self, given: &Given<'_>, _structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let Some(&Where::Node(node)) = given.place() else { return Err(given.wrong_place(self)) };
        Ok(OnSensors::only(LateNode { node, delay_s: given.or_zero(DELAY.name) }))
    }
}

/// A node whose samples come late.
#[derive(Debug)]
struct LateNode {
    node: u16,
    delay_s: f64,
}

impl SensorChange for LateNode {
    fn delay_s(&self, sensor: &Sensor) -> f64 {
        if sensor.node == self.node { self.delay_s } else { 0.0 }
    }
}
