//! A recording at one glance: the range of every channel over its length, and spectra over time.
//!
//! Rows and windows flow past on their way into the averages; a picture's worth of numbers flows out, however long the recording is.

use crate::spectra::{LineGrid, WindowLines};

/// Pieces that a recording's length is cut into at most.
const BINS: u64 = 1500;
/// Rows and columns of spectra over time at most.
const SPECTRA: usize = 160;
const COLUMNS: usize = 400;

/// A setup's recording at one glance.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Overview {
    /// The setup's name.
    pub setup: String,
    /// Rows per second of the recording.
    pub sampling_rate_hz: f64,
    /// The range of every channel, piece by piece; nothing of windows that nodes have sent.
    pub ranges: Ranges,
    /// Spectra over time.
    pub waterfall: Waterfall,
}

/// The range of every channel, piece by piece.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ranges {
    channels: usize,
    rows_a_bin: u64,
    /// Rows so far.
    pub rows: u64,
    /// Smallest and largest value in the recording's unit (in SI), bin after bin, channel by channel.
    bins: Vec<[f64; 2]>,
}

/// Nothing seen yet.
const NOTHING: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

impl Ranges {
    /// For a recording of about `rows` rows.
    pub(super) fn new(channels: usize, rows: u64) -> Self {
        Self { channels, rows_a_bin: rows.div_ceil(BINS).max(1), rows: 0, bins: Vec::new() }
    }

    /// Takes rows, row-major.
    pub(super) fn push(&mut self, rows: &[f64]) {
        if self.channels == 0 {
            return;
        }
        let mut rest = rows;
        while !rest.is_empty() {
            let bin = (self.rows / self.rows_a_bin) as usize;
            let room = (self.rows_a_bin - self.rows % self.rows_a_bin) as usize;
            let (here, further) = rest.split_at(rest.len().min(room * self.channels));
            self.bins.resize(((bin + 1) * self.channels).max(self.bins.len()), NOTHING);
            let ranges = &mut self.bins[bin * self.channels..(bin + 1) * self.channels];
            for row in here.chunks_exact(self.channels) {
                for ([low, high], value) in ranges.iter_mut().zip(row) {
                    *low = low.min(*value);
                    *high = high.max(*value);
                }
            }
            self.rows += (here.len() / self.channels) as u64;
            rest = further;
        }
    }

    /// Rows that a piece is made of.
    pub fn rows_a_bin(&self) -> u64 {
        self.rows_a_bin
    }

    /// Smallest and largest value of a channel, piece by piece; NaN where there is none.
    pub fn of(&self, channel: usize) -> impl Iterator<Item = [f64; 2]> + '_ {
        let values = self.bins.iter().skip(channel).step_by(self.channels.max(1));
        values.map(|&[low, high]| if low <= high { [low, high] } else { [f64::NAN; 2] })
    }

    /// Smallest and largest value of a channel; `None` where there is none.
    pub fn extent(&self, channel: usize) -> Option<[f64; 2]> {
        let ranges = self.of(channel).filter(|[low, _]| !low.is_nan());
        ranges.reduce(|[low, high], [least, most]| [low.min(least), high.max(most)])
    }
}

/// Densities over time, the mean of all channels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Waterfall {
    /// Windows that a row is made of, and lines that a column is.
    pub windows_a_row: usize,
    /// See `windows_a_row`.
    pub lines_a_column: usize,
    /// Columns.
    pub columns: usize,
    /// Sums and counts of densities, row after row.
    sums: Vec<[f64; 2]>,
}

impl Waterfall {
    /// For about so many windows on a grid.
    pub(super) fn new(grid: &LineGrid, windows: usize) -> Self {
        let lines_a_column = grid.lines.div_ceil(COLUMNS).max(1);
        Self {
            windows_a_row: windows.div_ceil(SPECTRA).max(1),
            lines_a_column,
            columns: grid.lines.div_ceil(lines_a_column),
            sums: Vec::new(),
        }
    }

    /// Takes a window.
    pub(super) fn push(&mut self, window: &WindowLines) {
        let row = usize::try_from(window.grid_index).unwrap_or(usize::MAX) / self.windows_a_row.max(1);
        // Windows come in order; one far ahead of all others would ask for memory without end.
        if row > 2 * SPECTRA {
            return;
        }
        self.sums.resize(((row + 1) * self.columns).max(self.sums.len()), [0.0; 2]);
        let sums = &mut self.sums[row * self.columns..(row + 1) * self.columns];
        for lines in window.channels.iter().flatten() {
            for (sum, lines) in sums.iter_mut().zip(lines.chunks(self.lines_a_column)) {
                sum[0] += lines.iter().map(|line| f64::from(line.norm_sqr())).sum::<f64>();
                sum[1] += lines.len() as f64;
            }
        }
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.sums.len() / self.columns.max(1)
    }

    /// Mean densities row after row, in (m/s²)²/Hz; NaN where no window was sound.
    pub fn densities(&self) -> impl Iterator<Item = f64> + '_ {
        self.sums.iter().map(|[sum, count]| sum / count)
    }
}

#[cfg(test)]
mod tests {
    use num_complex::Complex32;

    use super::*;

    #[test]
    fn every_sample_is_in_the_range_of_its_piece() {
        let mut ranges = Ranges::new(2, 4000);
        assert_eq!(ranges.rows_a_bin(), 3);
        let rows: Vec<f64> =
            (0..4000).flat_map(|row| [f64::from(row), if row == 7 { f64::NAN } else { 5.0 }]).collect();
        // In parts that do not end with pieces.
        rows.chunks(2 * 701).for_each(|part| ranges.push(part));
        let first: Vec<[f64; 2]> = ranges.of(0).collect();
        assert_eq!(first.len(), 1334);
        assert!(
            first
                .iter()
                .take(1333)
                .enumerate()
                .all(|(bin, range)| *range == [3.0 * bin as f64, 3.0 * bin as f64 + 2.0])
        );
        assert_eq!(first[1333], [3999.0, 3999.0]);
        assert!(ranges.of(1).all(|range| range == [5.0, 5.0]), "a missing sample is in no range");
        let mut missing = Ranges::new(1, 1);
        missing.push(&[f64::NAN]);
        assert!(missing.of(0).all(|[low, high]| low.is_nan() && high.is_nan()));
    }

    #[test]
    fn spectra_over_time_are_means_over_channels_windows_and_lines() {
        let grid = LineGrid { sampling_rate_hz: 10.0, segment: 2048, first_line: 1, lines: 800 };
        let mut waterfall = Waterfall::new(&grid, 320);
        assert_eq!((waterfall.windows_a_row, waterfall.lines_a_column, waterfall.columns), (2, 2, 400));
        for index in 0..320_u64 {
            let lines = |size: f32| Some(vec![Complex32::new(size, 0.0); 800]);
            let channels = vec![lines(1.0), lines(index as f32), None];
            waterfall.push(&WindowLines { grid_index: index, channels });
        }
        let densities: Vec<f64> = waterfall.densities().collect();
        assert_eq!((waterfall.rows(), densities.len()), (160, 160 * 400));
        // Windows 2 and 3: (1 + 4 + 1 + 9) / 4.
        assert!(densities[400..800].iter().all(|density| (density - 3.75).abs() < 1e-6));
        waterfall.push(&WindowLines { grid_index: u64::MAX, channels: vec![None; 3] });
        assert_eq!(waterfall.rows(), 160);
    }
}
