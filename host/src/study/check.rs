//! What has to hold between the values of a study: names that stand once, nodes with room, references that tie setups
//! together, a band that the recordings can show.

use std::collections::HashMap;

use belfry_shared::decimation::{Stages, USABLE_FRACTION};

use super::error::StudyError;
use super::section::Section;
use super::types::{Analysis, CustomSource, Motion, Sensor, Setup, Unit};

/// Channels that one sensor node can have.
const CHANNELS_PER_NODE: usize = 4;

/// How far a ratio of sampling rates may be from a whole number: rates are typed with a few digits (33.333), and a
/// node's crystal is no better than 20 ppm anyway.
const RATIO_TOLERANCE: f64 = 2e-5;

/// The sensors of one setup against each other; `sections` are theirs, in the same order.
pub(super) fn sensors(setup: &Setup, sections: &[Section<'_>]) -> Result<(), StudyError> {
    places(&setup.sensors, sections)?;
    let mut node_channels: HashMap<u16, usize> = HashMap::new();
    for (sensor, section) in setup.sensors.iter().zip(sections) {
        let taken = node_channels.entry(sensor.node).or_default();
        *taken += 1;
        if *taken > CHANNELS_PER_NODE {
            return Err(StudyError::NodeFull {
                position: section.position_of("node"),
                setup: setup.name.clone(),
                channel: sensor.channel.clone(),
                node: sensor.node,
                limit: CHANNELS_PER_NODE,
            });
        }
        sensitivity(setup, sensor, section)?;
        if let Some(entry) =
            section.get("offset_m_s2").filter(|_| setup.unit_of(sensor).motion() != Motion::Acceleration)
        {
            return Err(entry.out_of_range("left out, where the sensor measures no acceleration"));
        }
        if setup.live && setup.unit_of(sensor) != Unit::MetrePerSecondSquared {
            let expected = "left out, or \"m/s2\", in which nodes measure, where the setup is `live`";
            return section.get("unit").map_or(Ok(()), |entry| Err(entry.out_of_range(expected)));
        }
    }
    Ok(())
}

/// Notes `name` with its line, or fails with the line where it stood before.
fn unique<'n>(
    lines: &mut HashMap<&'n str, usize>,
    name: &'n str,
    section: &Section<'_>,
    key: &str,
    advice: &'static str,
) -> Result<(), StudyError> {
    let position = section.position_of(key);
    match lines.insert(name, position.line) {
        Some(first_line) => Err(StudyError::Duplicate { position, name: name.to_owned(), first_line, advice }),
        None => Ok(()),
    }
}

/// Every sensor of an arrangement has a channel and a point of its own.
pub(super) fn places(sensors: &[Sensor], sections: &[Section<'_>]) -> Result<(), StudyError> {
    let mut channels = HashMap::new();
    let mut points = HashMap::new();
    for (sensor, section) in sensors.iter().zip(sections) {
        let advice = "each channel has one sensor in its arrangement";
        unique(&mut channels, &sensor.channel, section, "channel", advice)?;
        let advice = "give every point of an arrangement its own `point` (it is the channel's name unless given)";
        unique(&mut points, &sensor.point, section, "point", advice)?;
    }
    Ok(())
}

/// Every hypothesis and every group has a name of its own.
pub(super) fn custom_names(customs: &[CustomSource], sections: &[Section<'_>]) -> Result<(), StudyError> {
    let mut names = HashMap::new();
    for (custom, section) in customs.iter().zip(sections) {
        unique(&mut names, &custom.name, section, "name", "give every hypothesis and every group its own name")?;
    }
    Ok(())
}

/// What the channels of a group are.
pub(super) const CHANNELS: &str = "a list of channels of the study's sensors, in quotes, such as [\"07\", \"08\"]";

/// The sensors at a group are sensors of the study; `sections` are those of the groups.
pub(super) fn channels_of_groups(sensors: &[Sensor], sections: &[Section<'_>]) -> Result<(), StudyError> {
    for entry in sections.iter().filter_map(|section| section.get("channels")) {
        for channel in entry.list(CHANNELS)? {
            let name = channel.text(CHANNELS)?;
            if sensors.iter().all(|sensor| sensor.channel != name) {
                return Err(channel.out_of_range(CHANNELS));
            }
        }
    }
    Ok(())
}

/// A group is tied to another one that is tied to none.
pub(super) fn ties(customs: &[CustomSource], sections: &[Section<'_>]) -> Result<(), StudyError> {
    const FREE: &str = "the name of another [[model.group]] that is itself not tied, in quotes";
    for (custom, section) in customs.iter().zip(sections) {
        let Some(name) = &custom.tied_to else { continue };
        let is_free = |other: &CustomSource| {
            other.name == *name && other.name != custom.name && other.group.is_some() && other.tied_to.is_none()
        };
        if !customs.iter().any(is_free) {
            return Err(section.required("tied_to", FREE)?.out_of_range(FREE));
        }
    }
    Ok(())
}

fn sensitivity(setup: &Setup, sensor: &Sensor, section: &Section<'_>) -> Result<(), StudyError> {
    let position = section.position_of("sensitivity_v_per_m_s2");
    let (setup_name, channel) = (setup.name.clone(), sensor.channel.clone());
    match (setup.unit_of(sensor) == Unit::Volt, sensor.sensitivity_v_per_m_s2) {
        (true, None) => Err(StudyError::NoSensitivity { position, setup: setup_name, channel }),
        (false, Some(_)) => Err(StudyError::NeedlessSensitivity { position, setup: setup_name, channel }),
        _ => Ok(()),
    }
}

/// The setups against each other; `sections` are theirs, in the same order.
pub(super) fn setups(setups: &[Setup], sections: &[Section<'_>]) -> Result<(), StudyError> {
    let mut names = HashMap::new();
    for (setup, section) in setups.iter().zip(sections) {
        unique(&mut names, &setup.name, section, "name", "give every setup its own name")?;
    }
    if setups.len() > 1 {
        common_references(setups, sections)?;
        references_stay_in_place(setups, sections)?;
    }
    Ok(())
}

fn references(setup: &Setup) -> impl Iterator<Item = &Sensor> {
    setup.sensors.iter().filter(|sensor| sensor.reference)
}

/// At least one point is a reference in every setup: shapes of parts are put together over it.
fn common_references(setups: &[Setup], sections: &[Section<'_>]) -> Result<(), StudyError> {
    let mut common: Option<Vec<&str>> = None;
    for (setup, section) in setups.iter().zip(sections) {
        let here = || references(setup).map(|sensor| sensor.point.as_str());
        let shared = match common {
            None => here().collect::<Vec<_>>(),
            Some(before) => before.into_iter().filter(|point| here().any(|here| here == *point)).collect(),
        };
        if shared.is_empty() {
            return Err(StudyError::NoCommonReference {
                position: section.position(),
                references: setups.iter().map(references_in_words).collect::<Vec<_>>().join("; "),
            });
        }
        common = Some(shared);
    }
    Ok(())
}

fn references_in_words(setup: &Setup) -> String {
    let points = references(setup).map(|sensor| sensor.point.as_str()).collect::<Vec<_>>();
    let points = if points.is_empty() { "none".to_owned() } else { points.join(", ") };
    format!("{:?} has {points}", setup.name)
}

/// A reference that moved or turned would bend every shape that is put together over it.
fn references_stay_in_place(setups: &[Setup], sections: &[Section<'_>]) -> Result<(), StudyError> {
    let mut first: HashMap<&str, (&Sensor, usize)> = HashMap::new();
    for (setup, section) in setups.iter().zip(sections) {
        let sensor_sections = section.tables("sensor")?;
        for (sensor, section) in setup.sensors.iter().zip(&sensor_sections).filter(|(sensor, _)| sensor.reference) {
            let position = section.position();
            let (before, first_line) = *first.entry(&sensor.point).or_insert((sensor, position.line));
            let same = before.is_of_a_point() == sensor.is_of_a_point()
                && before.elevation_m == sensor.elevation_m
                && before.direction == sensor.direction
                && before.offset_m == sensor.offset_m;
            if !same {
                return Err(StudyError::ReferenceMoved { position, point: sensor.point.clone(), first_line });
            }
        }
    }
    Ok(())
}

/// The analysis against the recordings it is meant for.
pub(super) fn analysis(analysis: &Analysis, section: &Section<'_>, setups: &[Setup]) -> Result<(), StudyError> {
    if let Some([low_hz, high_hz]) = analysis.band_hz
        && low_hz >= high_hz
    {
        return Err(StudyError::BandReversed { position: section.position_of("band_hz"), low_hz, high_hz });
    }
    for setup in setups {
        let ratio = match analysis.decimated_rate_hz {
            Some(decimated_rate_hz) => {
                Some(decimation_ratio(setup.sampling_rate_hz, decimated_rate_hz).ok_or_else(|| {
                    StudyError::DecimatedRate {
                        position: section.position_of("decimated_rate_hz"),
                        setup: setup.name.clone(),
                        decimated_rate_hz,
                        sampling_rate_hz: setup.sampling_rate_hz,
                    }
                })?)
            }
            None => None,
        };
        if let Some([_, high_hz]) = analysis.band_hz {
            let decimated = ratio.is_some_and(|ratio| ratio > 1);
            let (limit_hz, reason) = match analysis.decimated_rate_hz {
                Some(rate_hz) if decimated => (USABLE_FRACTION * rate_hz, "0.4 times the decimated rate"),
                _ => (setup.sampling_rate_hz / 2.0, "half the sampling rate"),
            };
            // 0.4 is no binary fraction: a band that ends exactly at the limit must not fail by a rounding.
            if high_hz > limit_hz * (1.0 + 1e-9) {
                let (position, setup) = (section.position_of("band_hz"), setup.name.clone());
                return Err(StudyError::BandTooHigh { position, setup, high_hz, limit_hz, reason, decimated });
            }
        }
    }
    Ok(())
}

/// The whole number that brings one rate to the other, where the shared decimating filter has stages for it.
fn decimation_ratio(sampling_rate_hz: f64, decimated_rate_hz: f64) -> Option<u32> {
    let ratio = sampling_rate_hz / decimated_rate_hz;
    let whole = ratio.round();
    let fits = whole >= 1.0 && whole <= f64::from(u32::MAX) && (ratio - whole).abs() <= RATIO_TOLERANCE * whole;
    fits.then(|| Stages::of(whole as u32)).flatten().map(|stages| stages.ratio())
}
