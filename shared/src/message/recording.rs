//! Measuring a recording instead of the sensor.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::time::HostTime;

/// Most readings in a [`FeedPart`].
pub const MAX_FEED: usize = 120;

/// Tells a node to measure a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Replay {
    /// When row 0 was sampled, in the recording's time. Row n follows n sampling periods of the configuration later.
    pub start: HostTime,
}

/// Rows of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FeedPart {
    /// Number of the first row in this part. The node takes rows in order and ignores a part that does not start with the row it
    /// expects.
    pub first_row: u64,
    /// Readings in m/s², row by row, one per channel of the configuration; NaN for a missing one.
    pub readings: Vec<f32, MAX_FEED>,
}

/// How much of a recording a node has taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fed {
    /// The row it expects next.
    pub next_row: u64,
}
