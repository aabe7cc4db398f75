//! A window as a node sends it: lines or densities of its channels over one interval, with where it stands on the grid.

use belfry_shared::message::{ChannelState, Peak, WindowName};
use num_complex::Complex32;

/// A whole window as a node sent it.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeWindow {
    /// Its name.
    pub name: WindowName,
    /// Hash of the configuration it was measured with.
    pub configuration_hash: u32,
    /// Start in hops since the epoch.
    pub grid_index: u64,
    /// When the segment's middle was, minus when it should have been by the grid, in µs.
    pub middle_offset_us: i32,
    /// How much faster the host's clock runs than the node's, in parts per thousand million.
    pub drift_ppb: i32,
    /// Each channel's data.
    pub channels: Vec<ChannelData>,
}

/// One channel's data in a window.
#[derive(Debug, Clone, PartialEq)]
pub enum ChannelData {
    /// No sound data, and why.
    Unsound(ChannelState),
    /// Complex lines of all bands, one after the other, in m/s²/√Hz.
    Lines(Vec<Complex32>),
    /// Averaged densities of all bands in (m/s²)²/Hz, and the highest peaks.
    Psd {
        /// Segments averaged.
        segments: u16,
        /// The densities.
        densities: Vec<f32>,
        /// The peaks, highest first.
        peaks: Vec<Peak>,
    },
}
