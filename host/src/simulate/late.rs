//! Channels whose samples come late: a delay line with a windowed sinc between the samples.

use std::f64::consts::PI;

use nalgebra::{DMatrix, RowDVector};

/// Samples on each side of the one that is asked for.
const HALF: usize = 32;

/// Delays the rows of a response; all by what the earliest needs to look ahead.
#[derive(Debug, Clone)]
pub(super) struct LateChannels {
    /// Whole samples of each channel's delay.
    whole: Vec<usize>,
    /// Weights of the samples around it, taps x channels.
    weights: DMatrix<f64>,
    /// Samples so far, channels x samples, the last block at the end.
    samples: DMatrix<f64>,
}

impl LateChannels {
    /// Delays in s; positive comes late.
    pub(super) fn new(delays_s: &RowDVector<f64>, sampling_rate_hz: f64, block_rows: usize) -> Self {
        let earliest = delays_s.iter().map(|delay| delay * sampling_rate_hz).fold(0.0, f64::min);
        let ahead = HALF as f64 - earliest.floor();
        let delays: Vec<f64> = delays_s.iter().map(|delay| ahead + delay * sampling_rate_hz).collect();
        let whole: Vec<usize> = delays.iter().map(|delay| delay.floor() as usize).collect();
        let weights = DMatrix::from_fn(2 * HALF, delays.len(), |tap, channel| {
            weight(tap as f64 - (HALF as f64 - 1.0) - delays[channel].fract())
        });
        let longest = whole.iter().copied().max().unwrap_or(0) + HALF + 1;
        Self { whole, weights, samples: DMatrix::zeros(delays.len(), longest + block_rows) }
    }

    /// Blocks until what comes out is no longer the silence before the first.
    pub(super) fn blocks_of_silence(&self, block_rows: usize) -> usize {
        self.samples.ncols().div_ceil(block_rows)
    }

    /// Replaces a block, channels x samples, by the delayed one.
    pub(super) fn delay(&mut self, block: &mut DMatrix<f64>) {
        let (rows, kept) = (block.ncols(), self.samples.ncols() - block.ncols());
        for column in 0..kept {
            let moved = self.samples.column(column + rows).into_owned();
            self.samples.set_column(column, &moved);
        }
        self.samples.columns_mut(kept, rows).copy_from(block);
        for (channel, &whole) in self.whole.iter().enumerate() {
            for row in 0..rows {
                // The tap HALF - 1 stands at the whole delay.
                let first = kept + row + HALF - 1 - whole;
                let tap = |tap: usize| self.weights[(tap, channel)] * self.samples[(channel, first - tap)];
                block[(channel, row)] = (0..2 * HALF).map(tap).sum();
            }
        }
    }
}

/// A sinc within a Hann window.
fn weight(samples: f64) -> f64 {
    let sinc = if samples == 0.0 { 1.0 } else { (PI * samples).sin() / (PI * samples) };
    let window = (0.5 * PI * samples / HALF as f64).cos().powi(2);
    if samples.abs() < HALF as f64 { sinc * window } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A sine comes late by what was asked for, a fraction of a sample or many, early ones beside it.
    #[test]
    fn a_sine_comes_late() {
        let (fs, hz) = (50.0, 3.3);
        let delays_s = [0.0, 0.0131, 1.5, -0.047];
        let mut late = LateChannels::new(&RowDVector::from_row_slice(&delays_s), fs, 64);
        let mut out: Vec<Vec<f64>> = vec![Vec::new(); 4];
        for block in 0..10 {
            let mut samples = DMatrix::from_fn(4, 64, |_, row| (TAU * hz * (64 * block + row) as f64 / fs).sin());
            late.delay(&mut samples);
            for (channel, values) in out.iter_mut().enumerate() {
                values.extend(samples.row(channel).iter());
            }
        }
        let silent = 64 * late.blocks_of_silence(64);
        // All are late by what the earliest needs.
        let common_s = (HALF as f64 + 3.0) / fs;
        for (values, delay_s) in out.iter().zip(delays_s) {
            for (row, value) in values.iter().enumerate().skip(silent) {
                let expected = (TAU * hz * (row as f64 / fs - common_s - delay_s)).sin();
                assert!((value - expected).abs() < 1e-4, "{delay_s}: {value} for {expected}");
            }
        }
        assert!(silent < 64 * 9);
    }
}
