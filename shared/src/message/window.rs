//! Windows: what was measured in one interval, in parts that each fit into a frame.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::configuration::MAX_CHANNELS;

/// Most peaks per channel that a node reports.
pub const MAX_PEAKS: usize = 8;

/// Most data bytes in a [`LinesPart`] or [`DensityPart`]; the other fields take the rest of
/// [`crate::frame::MAX_MESSAGE_BYTES`].
pub const MAX_DATA_BYTES: usize = 480;

/// A window's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowName {
    /// The node's id.
    pub node: u16,
    /// The node's boot id.
    pub boot: u32,
    /// Counts the node's windows from 0.
    pub number: u32,
}

/// Part 0 of a window.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowHead {
    /// Which window.
    pub name: WindowName,
    /// [`crate::message::Configuration::hash`] of the configuration it was measured with.
    pub configuration_hash: u32,
    /// Start on the grid of host time, in hops since the epoch.
    pub grid_index: u64,
    /// When the segment's middle was, minus when it should have been by the grid, in µs: what the node could not align, and the
    /// drift of its crystal over half a segment. The host removes it as a phase. For densities: that of the first segment.
    pub middle_offset_us: i32,
    /// How much faster the host's clock runs than the node's, in parts per billion (10⁹): samples were that much further apart,
    /// and the lines' frequencies that much lower. The host shifts the lines accordingly.
    pub drift_ppb: i32,
    /// Number of data parts of the window.
    pub data_parts: u16,
    /// State of each channel.
    pub channels: Vec<ChannelState, MAX_CHANNELS>,
}

/// State of a channel in a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ChannelState {
    /// The data are sound; data parts follow.
    Sound {
        /// Number of segments they come from: 1 for lines, the number averaged for densities.
        segments: u16,
    },
    /// Samples were missing, or not numbers.
    Missing,
    /// Samples were at the end of the sensor's range.
    Clipped,
    /// All samples were equal: the sensor is dead or not connected.
    Constant,
    /// New samples replaced the segment before the node had time to transform it.
    Overrun,
    /// Something of which only a later version knows. There are no data.
    #[serde(other)]
    Unknown,
}

/// Complex lines of one channel, coded as in [`crate::quantise`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinesPart<'a> {
    /// Which window.
    pub name: WindowName,
    /// Which part, from 1.
    pub part: u16,
    /// Which channel, from 0.
    pub channel: u8,
    /// Index of the first line.
    pub first_line: u16,
    /// Number of lines.
    pub lines: u16,
    /// Bits per component.
    pub bits: u8,
    /// [`crate::quantise::encode_lines`]'s code.
    pub code: &'a [u8],
}

/// Averaged power spectral densities of one channel, coded as in [`crate::quantise`], one byte per line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DensityPart<'a> {
    /// Which window.
    pub name: WindowName,
    /// Which part, from 1.
    pub part: u16,
    /// Which channel, from 0.
    pub channel: u8,
    /// Index of the first line.
    pub first_line: u16,
    /// Base exponent of the logarithmic code.
    pub base: i16,
    /// [`crate::quantise::encode_densities`]' code.
    pub code: &'a [u8],
}

/// The highest peaks of one channel's averaged density.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeaksPart {
    /// Which window.
    pub name: WindowName,
    /// Which part, from 1.
    pub part: u16,
    /// Which channel, from 0.
    pub channel: u8,
    /// The peaks, highest first.
    pub peaks: Vec<Peak, MAX_PEAKS>,
}

/// A spectral peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Peak {
    /// Frequency in Hz, interpolated between lines.
    pub frequency_hz: f32,
    /// Density at the peak in (m/s²)²/Hz.
    pub density: f32,
}
