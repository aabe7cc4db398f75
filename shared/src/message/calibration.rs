//! What a node's axes read at rest, which its host finds out, and heartbeats that come often, by which it does.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::configuration::MAX_CHANNELS;
use crate::time::HostTime;

/// What is known of a node's axes. The node keeps it for hosts to ask, and measures as without it: its windows hold what the sensor says, so
/// that a calibration that is found later counts for them as well.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Calibration {
    /// When it was found.
    pub time: HostTime,
    /// Its axes, in the order of its channels.
    pub axes: Vec<AxisCalibration, MAX_CHANNELS>,
}

/// What an axis reads: an acceleration is (reading - offset) x gain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisCalibration {
    /// By how much the gain is above 1, in parts per million.
    pub gain_ppm: i32,
    /// The gain's standard deviation, in parts per million.
    pub gain_std_ppm: u32,
    /// The offset in µm/s².
    pub offset_um_s2: i32,
}

impl AxisCalibration {
    /// What readings are to be multiplied by.
    pub fn gain(&self) -> f64 {
        1.0 + 1e-6 * f64::from(self.gain_ppm)
    }

    /// The standard deviation of that.
    pub fn gain_std(&self) -> f64 {
        1e-6 * f64::from(self.gain_std_ppm)
    }

    /// What the axis reads without acceleration, in m/s².
    pub fn offset_m_s2(&self) -> f64 {
        1e-6 * f64::from(self.offset_um_s2)
    }
}

/// Asks for heartbeats at another pace, for a while.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pace {
    /// Time between heartbeats in ms; the node takes [`LEAST_PACE_MS`] for less.
    pub period_ms: u32,
    /// How many, from now on; 0 ends an earlier one.
    pub heartbeats: u16,
}

/// The shortest time between heartbeats.
pub const LEAST_PACE_MS: u32 = 100;
