//! Columns: which of a file's columns each sensor of the setup is, and what makes SI units of its numbers.

use std::fmt;
use std::path::Path;

use super::error::{RecordError, listed};
use super::response_name::{ResponseName, find_response, same_responses};
use crate::study::{STANDARD_GRAVITY_M_S2, Sensor, Setup, Unit};

/// Names of columns that mean time, in lower case and without `[s]` behind them: seconds, or timestamps where the format has them.
const TIME_NAMES: [&str; 12] =
    ["time", "t", "time_s", "t_s", "time s", "seconds", "timestamp", "zeit", "zeit_s", "temps", "tempo", "tiempo"];

/// Whether a column of this name is the time, and no sensor's channel.
pub(super) fn is_time_column(name: &str, sensors: &[Sensor]) -> bool {
    let lower = name.to_lowercase();
    let bare = ["[s]", "(s)"].iter().find_map(|unit| lower.strip_suffix(unit)).unwrap_or(&lower);
    TIME_NAMES.contains(&bare.trim_end()) && !sensors.iter().any(|sensor| sensor.channel.trim() == name)
}

/// A file's columns.
#[derive(Debug, Clone)]
pub(super) enum Columns {
    /// Named by a header, in the file's order.
    Named(Vec<String>),
    /// Known by their position, from 1.
    Numbered(usize),
    /// Named in several steps, as `group/channel` or `NET.STA.LOC.CHA`: the last ones are enough where they are unlike those of all others.
    Paths(Vec<String>),
    /// The time responses of a universal file, in its order.
    Responses(Vec<ResponseName>),
}

/// Whether what stands in one file's columns stands in the other's.
impl PartialEq for Columns {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Columns::Named(one), Columns::Named(other)) => one == other,
            (Columns::Paths(one), Columns::Paths(other)) => one == other,
            (Columns::Numbered(one), Columns::Numbered(other)) => one == other,
            (Columns::Responses(one), Columns::Responses(other)) => same_responses(one, other),
            _ => false,
        }
    }
}

impl fmt::Display for Columns {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Columns::Named(names) => write!(formatter, "the columns {}", listed(names, "`")),
            Columns::Paths(names) => write!(formatter, "the channels {}", listed(names, "`")),
            Columns::Numbered(1) => write!(formatter, "1 column without a name, which is channel 1"),
            Columns::Numbered(count) => {
                write!(formatter, "{count} columns without names, which are channels 1 to {count}")
            }
            Columns::Responses(names) => write!(formatter, "the time responses {}", listed(names, "`")),
        }
    }
}

impl Columns {
    /// The column (from 0) of each sensor.
    pub(super) fn find_all(&self, sensors: &[Sensor], file: &Path) -> Result<Vec<usize>, RecordError> {
        sensors.iter().map(|sensor| self.find(&sensor.channel, file)).collect()
    }

    /// The column (from 0) that a sensor's `channel` names.
    pub(super) fn find(&self, channel: &str, file: &Path) -> Result<usize, RecordError> {
        let unknown = || RecordError::UnknownChannel {
            file: file.to_owned(),
            channel: channel.to_owned(),
            available: self.to_string(),
        };
        match self {
            Columns::Named(names) => {
                let mut found = (0..).zip(names).filter(|(_, name)| *name == channel.trim()).map(|(column, _)| column);
                match (found.next(), found.next()) {
                    (Some(column), None) => Ok(column),
                    (Some(_), Some(_)) => {
                        Err(RecordError::AmbiguousChannel { file: file.to_owned(), channel: channel.to_owned() })
                    }
                    (None, _) => Err(unknown()),
                }
            }
            Columns::Numbered(count) => match channel.trim().parse::<usize>() {
                Ok(position) if (1..=*count).contains(&position) => Ok(position - 1),
                _ => Err(unknown()),
            },
            Columns::Paths(names) => {
                let channel = channel.trim();
                let is_tail = |name: &str| {
                    name.strip_suffix(channel).is_some_and(|before| before.is_empty() || before.ends_with(['/', '.']))
                };
                if let Some(whole) = names.iter().position(|name| name == channel) {
                    return Ok(whole);
                }
                let mut found = (0..).zip(names).filter(|(_, name)| !channel.is_empty() && is_tail(name));
                match (found.next(), found.next(), channel.parse::<usize>()) {
                    (Some((column, _)), None, _) => Ok(column),
                    (Some(_), Some(_), _) => {
                        Err(RecordError::AmbiguousChannel { file: file.to_owned(), channel: channel.to_owned() })
                    }
                    (None, _, Ok(position)) if (1..=names.len()).contains(&position) => Ok(position - 1),
                    _ => Err(unknown()),
                }
            }
            Columns::Responses(names) => find_response(names, channel, file, unknown),
        }
    }
}

/// The setup's channels as they lie in its files.
#[derive(Debug, Clone)]
pub(super) struct Selection {
    /// The column of each channel, from 0; every one of them exists in the setup's files.
    pub(super) columns: Vec<usize>,
    /// What each channel's numbers are multiplied by.
    pub(super) factors: Vec<f64>,
    /// What is subtracted from each channel then.
    pub(super) offsets: Vec<f64>,
    /// The channels' names as the sensors have them.
    pub(super) channels: Vec<String>,
}

impl Selection {
    /// Finds the setup's sensors among the columns of `file`.
    pub(super) fn new(setup: &Setup, columns: &Columns, file: &Path) -> Result<Self, RecordError> {
        let sensors = &setup.sensors;
        Ok(Self {
            columns: columns.find_all(sensors, file)?,
            factors: sensors.iter().map(|sensor| si_factor(setup.unit_of(sensor), sensor)).collect::<Result<_, _>>()?,
            offsets: sensors
                .iter()
                .map(|sensor| sensor.offset_m_s2.unwrap_or(0.0) * sensor.gain.unwrap_or(1.0))
                .collect(),
            channels: sensors.iter().map(|sensor| sensor.channel.clone()).collect(),
        })
    }

    /// The selections of files beside each other, each with the places of its channels, as one.
    pub(super) fn of_parts<'a>(parts: impl Iterator<Item = (&'a Self, &'a [usize])>) -> Self {
        let mut channels: Vec<(usize, usize, f64, f64, &str)> = Vec::new();
        for (part, places) in parts {
            let numbers = part.columns.iter().zip(&part.factors).zip(&part.offsets);
            for ((place, ((column, factor), offset)), name) in places.iter().zip(numbers).zip(&part.channels) {
                channels.push((*place, *column, *factor, *offset, name));
            }
        }
        channels.sort_by_key(|channel| channel.0);
        Self {
            columns: channels.iter().map(|channel| channel.1).collect(),
            factors: channels.iter().map(|channel| channel.2).collect(),
            offsets: channels.iter().map(|channel| channel.3).collect(),
            channels: channels.iter().map(|channel| channel.4.to_owned()).collect(),
        }
    }

    /// The name of a channel, for errors.
    pub(super) fn channel(&self, index: usize) -> String {
        self.channels.get(index).cloned().unwrap_or_default()
    }
}

/// What makes m/s² (m/s of a velocity, m of a displacement, rad of a tilt) of a recorded number, with the sensor's gain.
pub(crate) fn si_factor(unit: Unit, sensor: &Sensor) -> Result<f64, RecordError> {
    Ok(sensor.gain.unwrap_or(1.0) * unit_factor(unit, sensor)?)
}

fn unit_factor(unit: Unit, sensor: &Sensor) -> Result<f64, RecordError> {
    match unit {
        Unit::MetrePerSecondSquared | Unit::MetrePerSecond | Unit::Metre | Unit::Radian | Unit::Strain => Ok(1.0),
        Unit::StandardGravity => Ok(STANDARD_GRAVITY_M_S2),
        Unit::Volt => match sensor.sensitivity_v_per_m_s2 {
            Some(sensitivity) if sensitivity.is_normal() => Ok(sensitivity.recip()),
            _ => Err(RecordError::NoSensitivity { channel: sensor.channel.clone() }),
        },
    }
}
