//! The parts of a structure that effects act on, or why a structure has none.

use super::{EffectError, Given, Where};
use crate::model::{BaseFlexibility, Body, Segment, Structure};
use crate::study::Sensor;

/// The base of a beam.
pub(super) fn base<'a>(
    kind: &'static str,
    structure: &'a mut Structure,
) -> Result<&'a mut BaseFlexibility, EffectError> {
    match structure.body {
        Body::Beam(_) => Ok(&mut structure.base),
        Body::Matrices(_) => Err(EffectError::NeedsBeam { kind }),
    }
}

/// The segments of a beam.
pub(super) fn segments<'a>(kind: &'static str, structure: &'a mut Structure) -> Result<&'a mut [Segment], EffectError> {
    match &mut structure.body {
        Body::Beam(beam) => Ok(beam.segments_mut()),
        Body::Matrices(_) => Err(EffectError::NeedsBeam { kind }),
    }
}

/// Whether heights mean something.
pub(super) fn check_line(kind: &'static str, structure: &Structure) -> Result<[f64; 2], EffectError> {
    structure.z_range_m().ok_or(EffectError::NoHeights { kind })
}

/// The height of a located effect, on the beam.
pub(super) fn height(kind: &'static str, given: &Given<'_>, structure: &Structure) -> Result<f64, EffectError> {
    let Some(&Where::Height(z_m)) = given.place else {
        return Err(wrong_place(kind, given, "needs a height such as @225.2m"));
    };
    let [z_base_m, z_top_m] = check_line(kind, structure)?;
    if !(z_base_m..=z_top_m).contains(&z_m) {
        return Err(EffectError::OutsideBeam { kind, z_m, z_base_m, z_top_m });
    }
    Ok(z_m)
}

/// The channels of an effect on sensors.
pub(super) fn channels<'a>(kind: &'static str, given: &Given<'a>) -> Result<&'a [String], EffectError> {
    match given.place {
        Some(Where::Channels(channels)) => Ok(channels),
        _ => Err(wrong_place(kind, given, "needs a channel such as @ch07")),
    }
}

/// The sensor node of an effect on sensors.
pub(super) fn node(kind: &'static str, given: &Given<'_>) -> Result<u16, EffectError> {
    match given.place {
        Some(&Where::Node(node)) => Ok(node),
        _ => Err(wrong_place(kind, given, "needs a sensor node such as @node3")),
    }
}

pub(super) fn wrong_place(kind: &'static str, given: &Given<'_>, expected: &'static str) -> EffectError {
    let found = given.place.map_or_else(|| "nothing".to_owned(), |place| format!("@{place}"));
    EffectError::WrongPlace { kind, expected, found }
}

/// Whether the channels or the node of a place are among the sensors.
pub(super) fn check_sensors(kind: &'static str, place: Option<&Where>, sensors: &[Sensor]) -> Result<(), EffectError> {
    match place {
        Some(Where::Channels(channels)) => {
            let unknown = channels.iter().find(|channel| sensors.iter().all(|sensor| sensor.channel != **channel));
            unknown.map_or(Ok(()), |channel| {
                let known = sensors.iter().map(|sensor| sensor.channel.as_str()).collect::<Vec<_>>().join(", ");
                Err(EffectError::NoChannel { kind, channel: channel.clone(), known: or_none(known) })
            })
        }
        Some(&Where::Node(node)) if sensors.iter().all(|sensor| sensor.node != node) => {
            let mut nodes: Vec<u16> = sensors.iter().map(|sensor| sensor.node).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let known = nodes.iter().map(u16::to_string).collect::<Vec<_>>().join(", ");
            Err(EffectError::NoNode { kind, node, known: or_none(known) })
        }
        _ => Ok(()),
    }
}

fn or_none(known: String) -> String {
    if known.is_empty() { "none".to_owned() } else { known }
}
