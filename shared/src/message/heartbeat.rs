//! Signs of life: what windows there are, what was lost, and how sensors and board are.

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::configuration::MAX_CHANNELS;

/// A sign of life.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Heartbeat {
    /// The node's id.
    pub node: u16,
    /// The node's boot id.
    pub boot: u32,
    /// The number the next window will have: all lower ones exist or existed.
    pub next_window: u32,
    /// The oldest window still in the outbox (`next_window` where it is empty).
    pub oldest_window: u32,
    /// Windows dropped from a full outbox since the start.
    pub lost_windows: u32,
    /// Frames from the host that were damaged or not understood, since the start.
    pub damaged_frames: u32,
    /// Each channel's level: the RMS of the raw reading about its bias in m/s² since the last heartbeat. Good to 6 % only
    /// (a fast square root); it tells a live sensor from a dead one, and is no measurement.
    pub level: Vec<f32, MAX_CHANNELS>,
    /// What each channel's readings say of its sensor, since the last heartbeat.
    pub sensors: Vec<SensorState, MAX_CHANNELS>,
    /// Rows that stayed out since the start.
    pub lost_rows: u32,
    /// How its board is.
    pub board: BoardState,
}

/// What readings say of a sensor; the first that is true.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SensorState {
    /// There was no reading.
    #[error("absent: it gives no readings")]
    Absent,
    /// All readings were alike.
    #[error("stuck: all readings are alike")]
    Stuck,
    /// Some readings were missing.
    #[error("failing: readings are missing")]
    Failing,
    /// Some readings were at the end of the range.
    #[error("clipped: readings at the end of its range")]
    Clipped,
    /// Readings jump about as no structure moves.
    #[error("noisy: readings jump about as no structure moves")]
    Noisy,
    /// Nothing is wrong.
    #[error("sound")]
    Sound,
}

/// How a node's board is; zeros where it has none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BoardState {
    /// Bytes the stack has.
    pub stack_bytes: u32,
    /// Bytes of it that were never used since the start.
    pub stack_free_bytes: u32,
    /// Longest time between looks at the queue of samples since the start, in µs: what the program was busy with then (a
    /// spectrum, mostly) kept no sample waiting for its interrupt, but the queue must outlast it.
    pub longest_step_us: u32,
    /// Latest that the interrupt of a sample has come since the start, in ns after the timer had called it. The sensor
    /// samples by the timer's pulse, which nothing delays; the interrupt has to fetch the sample before the next pulse.
    pub latest_sample_ns: u32,
    /// The sensor's temperature in units of 0.01 °C; `None` where there is no sensor.
    pub temperature_centi_c: Option<i16>,
    /// Frames from the host that were dropped since the start, because they came faster than the program could take them. Some of
    /// them count as damaged as well.
    pub dropped_frames: u32,
}
