//! What a node is to measure and send, and why it may refuse to.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::frame::{self, MAX_MESSAGE_BYTES};

/// Most channels a node has.
pub const MAX_CHANNELS: usize = 4;
/// Most frequency bands a configuration has.
pub const MAX_BANDS: usize = 8;

/// What a node is to measure. It does not grow within a version: its hash is over all of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Configuration {
    /// Channels to measure, 1 to [`MAX_CHANNELS`].
    pub channels: u8,
    /// Raw sampling rate in µHz.
    pub sampling_rate_uhz: u64,
    /// Raw samples per decimated sample; [`crate::decimation::Stages`] says which ratios are possible.
    pub decimation: u32,
    /// Decimated samples per segment: 256, 512, 1024, 2048 or 4096.
    pub segment: u16,
    /// What to send.
    pub summary: Summary,
    /// Which lines to send, in ascending order and without overlap.
    pub bands: Vec<Band, MAX_BANDS>,
}

impl Configuration {
    /// The hash by which node and host name a configuration: CRC-32 of its encoding.
    pub fn hash(&self) -> u32 {
        // A hash of 0 would only make the host send it again.
        self.bytes(&mut [0; MAX_MESSAGE_BYTES]).map_or(0, frame::crc32)
    }

    /// Its encoding, of 70 bytes at most; `None` where `buffer` is shorter than that.
    pub fn bytes<'b>(&self, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
        postcard::to_slice(self, buffer).ok().map(|bytes| &*bytes)
    }

    /// Lines per channel in all bands together.
    pub fn lines(&self) -> usize {
        self.bands.iter().map(|band| usize::from(band.lines)).sum()
    }

    /// Raw samples between the starts of neighbouring windows' segments (half a segment).
    pub fn hop_samples(&self) -> u64 {
        u64::from(self.segment / 2) * u64::from(self.decimation)
    }
}

/// What a node makes of its segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Summary {
    /// The complex lines of every segment, for modes: a window is one segment.
    Lines {
        /// Bits per component, [`crate::quantise::MIN_BITS`] to [`crate::quantise::MAX_BITS`].
        bits: u8,
    },
    /// Power spectral densities averaged over segments, and their peaks, for slow radios: a window covers `segments` segments.
    Psd {
        /// Number of segments averaged, at least 1.
        segments: u16,
    },
}

/// A run of consecutive spectral lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Band {
    /// Index of the first line.
    pub first_line: u16,
    /// Number of lines.
    pub lines: u16,
}

/// A configuration the node cannot run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Refusal {
    /// [`Configuration::hash`] of the refused configuration.
    pub configuration_hash: u32,
    /// Why.
    pub reason: RefusalReason,
}

/// Why a node refuses a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RefusalReason {
    /// More channels than the node has, or none.
    #[error("the node has {available} channels")]
    Channels {
        /// Number of channels the node has.
        available: u8,
    },
    /// The sampling rate is 0, or higher than the sensor's highest.
    #[error("the sampling rate is not possible: the node samples up to {} Hz", f64::from(*highest_mhz) * 1e-3)]
    SamplingRate {
        /// The highest rate that the node samples at, in mHz.
        highest_mhz: u32,
    },
    /// The decimation does not split into stages.
    #[error("the decimation has no split into at most three stages of 2 to 10")]
    Decimation,
    /// The segment is no power of two from 256 to 4096.
    #[error("the segment is no power of two from 256 to 4096")]
    Segment,
    /// A band is empty, out of order, or reaches beyond the last line.
    #[error("a band is empty, out of order or beyond the last line")]
    Bands,
    /// The summary's bits or segments are out of range.
    #[error("the summary's bits or segments are out of range")]
    Summary,
    /// One window, or the running averages, would not fit into the node's memory.
    #[error("a window needs {needed} bytes, the node has {available}")]
    Memory {
        /// Bytes one window needs.
        needed: u32,
        /// Bytes there are.
        available: u32,
    },
    /// The node runs on its internal clock, which is off by up to a percent.
    #[error("the node's external clock does not run, and its own is too inexact to measure with")]
    Clock,
    /// Something of which only a later version knows.
    #[error("for a reason that this version of Belfry does not know: update it")]
    #[serde(other)]
    Unknown,
}
