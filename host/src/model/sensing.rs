//! What sensors really are where that differs from what the study says: turned, swapped, of another sensitivity, or late.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, RowDVector};

use crate::study::{Direction, Sensor};

/// Everything that is different about the sensors, in the order in which it was found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sensing {
    /// The changes.
    pub changes: Vec<SensorChange>,
}

/// One thing that is different.
#[derive(Debug, Clone, PartialEq)]
pub enum SensorChange {
    /// A channel records `factor` times the true motion.
    Gain {
        /// The channel's name.
        channel: String,
        /// Recorded over true.
        factor: f64,
    },
    /// Two channels are each other's.
    Swap {
        /// Their names.
        channels: [String; 2],
    },
    /// Horizontal sensors point elsewhere.
    Turn {
        /// The sensor node whose sensors are turned; all where there is none.
        node: Option<u16>,
        /// True azimuth less stated azimuth in degrees.
        angle_deg: f64,
    },
    /// A sensor node's samples come late.
    Delay {
        /// The node.
        node: u16,
        /// By how much, in s.
        delay_s: f64,
    },
}

impl Sensing {
    /// A sensor as it really points.
    pub(super) fn turned(&self, sensor: &Sensor) -> Sensor {
        let mut turned = sensor.clone();
        for change in &self.changes {
            if let (SensorChange::Turn { node, angle_deg }, Some(Direction::AzimuthDeg(azimuth_deg))) =
                (change, &mut turned.direction)
                && node.is_none_or(|node| node == sensor.node)
            {
                *azimuth_deg += angle_deg;
            }
        }
        turned
    }

    /// What channels record, given what their sensors see: gains and swaps on rows, sensors x anything.
    pub(super) fn record(&self, rows: &mut DMatrix<f64>, sensors: &[Sensor]) {
        let place = |channel: &str| sensors.iter().position(|sensor| sensor.channel == channel);
        for change in &self.changes {
            match change {
                SensorChange::Gain { channel, factor } => {
                    if let Some(index) = place(channel) {
                        let mut row = rows.row_mut(index);
                        row *= *factor;
                    }
                }
                SensorChange::Swap { channels: [one, other] } => {
                    if let (Some(one), Some(other)) = (place(one), place(other)) {
                        rows.swap_rows(one, other);
                    }
                }
                SensorChange::Turn { .. } | SensorChange::Delay { .. } => {}
            }
        }
    }

    /// By how many seconds each sensor's samples come late; `None` where none does.
    pub fn delays_s(&self, sensors: &[Sensor]) -> Option<RowDVector<f64>> {
        let mut delays = RowDVector::zeros(sensors.len());
        for change in &self.changes {
            if let SensorChange::Delay { node, delay_s } = change {
                for (delay, sensor) in delays.iter_mut().zip(sensors) {
                    if sensor.node == *node {
                        *delay += delay_s;
                    }
                }
            }
        }
        delays.iter().any(|delay| *delay != 0.0).then_some(delays)
    }
}

/// The phases in rad at which sensors record a real shape of a mode, turned so that the recorded shape is the most real:
/// `-2 pi f tau` each, less what all have in common (the phase of the sum of squares, halved).
pub fn phases_rad(shape: &[f64], delays_s: &RowDVector<f64>, frequency_hz: f64) -> Vec<f64> {
    let phases: Vec<f64> = delays_s.iter().map(|delay| -TAU * frequency_hz * delay).collect();
    let squares = shape.iter().zip(&phases).map(|(value, phase)| {
        let (sin, cos) = (2.0 * phase).sin_cos();
        (value * value * cos, value * value * sin)
    });
    let (re, im) = squares.fold((0.0, 0.0), |(re, im), (a, b)| (re + a, im + b));
    let common = 0.5 * im.atan2(re);
    phases.iter().map(|phase| phase - common).collect()
}
