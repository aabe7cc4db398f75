//! `clock-offset@node`: a node's samples come late.

use super::target::node;
use super::{About, EffectError, EffectKind, Evidence, Given, LookAlike, Parameter, Place};
use crate::model::{SensorChange, Structure};

const ABOUT: About = About {
    name: "clock-offset",
    physics: "The clock of a node is off, so its samples are taken for others. Its channels lag in every mode, by a phase \
         that grows with frequency.",
    formula: "the rows of the node's channels times exp(-i 2 pi f delay)",
    fingerprint: "phase of one node against the others linear in frequency, through zero",
    look_alikes: &[
        LookAlike { kind: "sensor-gain", separated_by: "the phase: a gain has none" },
        LookAlike { kind: "sensor-polarity", separated_by: "the lowest modes, where a delay is a small phase" },
    ],
    source: "J. S. Bendat, A. G. Piersol (2010), Random Data, section 5.2.7",
};

const DELAY: Parameter = Parameter::ranged("delay", "s", [-1e4, 1e4], 0.02, "positive: the node's samples come late");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct ClockOffset;

impl EffectKind for ClockOffset {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Node
    }

    fn evidence(&self) -> Evidence {
        Evidence::Phases
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[DELAY]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let node = node(ABOUT.name, given)?;
        structure.sensing.changes.push(SensorChange::Delay { node, delay_s: given.or_zero(DELAY.name) });
        Ok(())
    }
}
