//! The averaged cross-spectral matrix of one setup, with what its uncertainty needs.
//!
//! Sums of outer products flow in from the accumulator; matrices line by line, with or without one group of windows, and the
//! kurtosis of each channel flow out.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::grid::LineGrid;
use super::sums::{ChannelSubset, Sums, Total, packed, triangle};

/// Averaged cross-spectral matrices of one setup.
#[derive(Debug, Clone)]
pub struct CrossSpectrum {
    pub(super) grid: LineGrid,
    /// The channels used, as indices in the setup's channel order.
    pub(super) kept: Vec<usize>,
    /// Sums of groups of consecutive windows.
    pub(super) groups: Vec<Sums<f32>>,
    pub(super) total: Total,
}

impl CrossSpectrum {
    /// The lines.
    pub fn grid(&self) -> &LineGrid {
        &self.grid
    }

    /// The channels used, as indices in the setup's channel order; rows and columns of the matrices stand in this order.
    pub fn channels(&self) -> &[usize] {
        &self.kept
    }

    /// The same averages of some of the channels alone; `wanted` as in [`CrossSpectrum::channels`], others are ignored.
    pub fn restricted(self, wanted: &[usize]) -> Self {
        let kept: Vec<usize> = (0..self.kept.len()).filter(|&index| wanted.contains(&self.kept[index])).collect();
        let subset = ChannelSubset { count: self.kept.len(), wanted: kept };
        let lines = self.grid.lines;
        Self {
            grid: self.grid,
            kept: subset.wanted.iter().map(|&index| self.kept[index]).collect(),
            groups: self.groups.into_iter().map(|group| group.restricted(&subset, lines)).collect(),
            total: self.total.restricted(&subset, lines),
        }
    }

    /// The same averages without some of the channels.
    pub fn without_channels(self, unwanted: &[usize]) -> Self {
        let wanted: Vec<usize> = self.kept.iter().copied().filter(|channel| !unwanted.contains(channel)).collect();
        if wanted.len() == self.kept.len() { self } else { self.restricted(&wanted) }
    }

    /// Windows averaged.
    pub fn averages(&self) -> usize {
        self.total.sums.windows
    }

    /// Groups of consecutive windows.
    pub fn group_count(&self) -> usize {
        self.groups.len()
    }

    /// The matrix G of a line in (m/s²)²/Hz: `G[(i, j)]` = mean of `X_i X_j*`, Hermitian.
    pub fn matrix(&self, line: usize) -> DMatrix<Complex64> {
        self.unpack(line, self.averages(), |_| Complex64::ZERO)
    }

    /// The matrix of a line without the windows of one group.
    pub fn matrix_without(&self, group: usize, line: usize) -> DMatrix<Complex64> {
        let group = &self.groups[group];
        let part = |place: usize| Complex64::new(f64::from(group.re[place]), f64::from(group.im[place]));
        self.unpack(line, (self.averages() - group.windows).max(1), part)
    }

    fn unpack(&self, line: usize, windows: usize, minus: impl Fn(usize) -> Complex64) -> DMatrix<Complex64> {
        let count = self.kept.len();
        let from = line * triangle(count);
        let sums = &self.total.sums;
        let mut matrix = DMatrix::zeros(count, count);
        let mut place = from;
        for row in 0..count {
            for column in row..count {
                let value = (Complex64::new(sums.re[place], sums.im[place]) - minus(place)) / windows as f64;
                matrix[(row, column)] = value;
                matrix[(column, row)] = value.conj();
                place += 1;
            }
        }
        matrix
    }

    /// Kurtosis of the band-passed response at a line, by channel: 3 for noise and modes, 1.5 for a steady harmonic.
    ///
    /// From the complex lines: 1.5 <|X|^4> / <|X|^2>^2 (spectral kurtosis; Antoni 2006, eq. 6, for the real signal).
    pub fn kurtosis(&self, line: usize) -> Vec<f64> {
        let count = self.kept.len();
        let windows = self.averages() as f64;
        (0..count)
            .map(|channel| {
                let power = self.total.sums.re[line * triangle(count) + packed(count, channel, channel)] / windows;
                1.5 * self.total.fourths[line * count + channel] / windows / (power * power)
            })
            .collect()
    }
}
