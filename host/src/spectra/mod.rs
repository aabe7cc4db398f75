//! Spectra: from windows of complex lines to an averaged cross-spectral matrix.
//!
//! Windows come from sensor nodes or straight from a recording ([`direct`]), in the same units either way.

use num_complex::Complex32;

/// The spectral lines that every window of one setup carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineGrid {
    /// Decimated sampling rate in Hz.
    pub sampling_rate_hz: f64,
    /// Points a segment; the line spacing is `sampling_rate_hz / segment`.
    pub segment: usize,
    /// Index of the first line (its frequency is `first_line` times the line spacing).
    pub first_line: usize,
    /// Number of consecutive lines.
    pub lines: usize,
}

/// One measurement window: the spectral lines of one Hann segment, all channels of one setup.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowLines {
    /// Start of the segment, counted in hops (half segments) from the recording's epoch.
    pub grid_index: u64,
    /// Lines in m/s²/√Hz, one vector a channel in the setup's channel order: |line|² is the one-sided power spectral
    /// density, the phase refers to the segment's start. `None` where the channel has no sound data in this window.
    pub channels: Vec<Option<Vec<Complex32>>>,
}
