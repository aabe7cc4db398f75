//! The grid of spectral lines that all windows of a setup share, and a window on it.
//!
//! The plan makes the grid; nodes and recordings make windows on it, which flow into the average.

use num_complex::Complex32;

/// The spectral lines that every window of one setup carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineGrid {
    /// Decimated sampling rate in Hz.
    pub sampling_rate_hz: f64,
    /// Points a segment; the line spacing is `sampling_rate_hz / segment`.
    pub segment: usize,
    /// Index of the first line (its frequency is `first_line` times the line spacing); at least 1.
    pub first_line: usize,
    /// Number of consecutive lines.
    pub lines: usize,
}

impl LineGrid {
    /// Distance between lines in Hz.
    pub fn spacing_hz(&self) -> f64 {
        self.sampling_rate_hz / self.segment as f64
    }

    /// Frequency of the `index`-th line of the grid in Hz.
    pub fn frequency_hz(&self, index: usize) -> f64 {
        (self.first_line + index) as f64 * self.spacing_hz()
    }

    /// The line of the grid nearest to a frequency.
    pub fn nearest_line(&self, frequency_hz: f64) -> usize {
        let line = (frequency_hz / self.spacing_hz()).round() - self.first_line as f64;
        line.clamp(0.0, self.lines.saturating_sub(1) as f64) as usize
    }
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
