//! The grid of spectral lines that all windows of a setup share, and a window on it.
//!
//! The plan makes the grid; nodes and recordings make windows on it, which flow into the average.

use std::f64::consts::TAU;

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
    /// Lines in m/s²/√Hz (m/s/√Hz of a velocity), one vector a channel in the setup's channel order: |line|² is the one-sided power spectral
    /// density, the phase refers to the segment's start. `None` where the channel has no sound data in this window.
    pub channels: Vec<Option<Vec<Complex32>>>,
}

impl WindowLines {
    /// Differentiates each channel as often as `orders` says, in time: a velocity's lines become an acceleration's.
    ///
    /// Lines are multiplied by 2πif. What the window has leaked from a resonance to a line turns with the resonance, so that
    /// it is too large by the share that the line is above it; over a resonance these errors cancel.
    pub fn differentiate(&mut self, orders: &[u8], grid: &LineGrid) {
        for (lines, &order) in self.channels.iter_mut().zip(orders).filter(|(_, order)| **order > 0) {
            for (index, value) in lines.iter_mut().flatten().enumerate() {
                let turn = Complex32::new(0.0, (TAU * grid.frequency_hz(index)) as f32);
                *value *= turn.powu(u32::from(order));
            }
        }
    }
}

/// The periodic Hann window.
pub(super) fn hann(length: usize) -> Vec<f64> {
    (0..length).map(|n| 0.5 - 0.5 * (TAU * n as f64 / length as f64).cos()).collect()
}

/// The lines from `reach` below a line to `reach` above, of as many as there are.
pub(crate) fn around(line: usize, reach: usize, lines: usize) -> std::ops::Range<usize> {
    line.saturating_sub(reach)..(line + reach + 1).min(lines)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectra::direct::Welch;

    /// Lines of a sum of tones about 1 Hz as a displacement, a velocity and an acceleration.
    fn windows(grid: LineGrid) -> Vec<WindowLines> {
        let tones: Vec<(f64, f64)> = (0..40).map(|k| (0.97 + 0.0017 * f64::from(k), 1.3 * f64::from(k * k))).collect();
        let at = |t: f64, order: i32| -> f64 {
            tones
                .iter()
                .map(|(hz, phase)| {
                    (TAU * hz).powi(order) * (TAU * hz * t + phase + 0.25 * TAU * f64::from(order)).cos()
                })
                .sum()
        };
        let rows: Vec<f64> = (0..20_000)
            .flat_map(|row| [0, 1, 2].map(|order| at(f64::from(row) / grid.sampling_rate_hz, order)))
            .collect();
        let mut windows = Vec::new();
        Welch::new(grid, 1, 3).unwrap().push(&rows, &mut |window| windows.push(window));
        windows
    }

    #[test]
    fn velocities_and_displacements_become_the_accelerations_that_they_are() {
        let grid = LineGrid { sampling_rate_hz: 10.0, segment: 1024, first_line: 80, lines: 50 };
        let (mut away, mut power) = ([0.0; 2], 0.0);
        for mut window in windows(grid) {
            window.differentiate(&[2, 1, 0], &grid);
            let [displacement, velocity, acceleration] =
                [0, 1, 2].map(|channel| window.channels[channel].take().unwrap());
            for line in 0..grid.lines {
                away[0] += (displacement[line] - acceleration[line]).norm_sqr();
                away[1] += (velocity[line] - acceleration[line]).norm_sqr();
                power += acceleration[line].norm_sqr();
            }
        }
        // One line is 1 % of the frequency here, and Hann's window spreads a tone over three.
        let [displacement, velocity] = away.map(|away| (away / power).sqrt());
        assert!(velocity < 0.01 && displacement < 0.02, "{velocity} {displacement}");
    }
}
