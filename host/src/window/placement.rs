//! Where a node's window stands in one of the whole setup: its channels in their columns, its lines at the grid's frequencies,
//! their phases as of the grid's moments.

use std::f64::consts::TAU;

use num_complex::{Complex32, Complex64};

use super::node_window::{ChannelData, NodeWindow};
use crate::spectra::{LineGrid, WindowLines};

/// Crystals drift by less.
const MOST_DRIFT: f64 = 500e-6;

/// Puts a node's lines where its `channels` stand in a window of the whole setup, as if an exact crystal had sampled it on the
/// grid.
///
/// A remainder beyond what a start on the nearest sample and a crystal can leave means that clocks were set meanwhile; such a
/// window has no place.
pub(crate) fn place_lines(grid: &LineGrid, window: NodeWindow, channels: &[usize], whole: &mut WindowLines) {
    let most_us = 1e6 / grid.sampling_rate_hz * (1.5 + 0.5 * grid.segment as f64 * MOST_DRIFT);
    if f64::from(window.middle_offset_us).abs() > most_us {
        return;
    }
    for (data, &channel) in window.channels.into_iter().zip(channels) {
        if let (ChannelData::Lines(mut lines), Some(place)) = (data, whole.channels.get_mut(channel)) {
            move_lines(grid, window.drift_ppb, &mut lines);
            remove_offset(grid, window.middle_offset_us, &mut lines);
            *place = Some(lines);
        }
    }
}

/// The slope of a Hann segment's spectrum, from differences of lines one, two, three to either side: the least-squares sum of
/// sin(a u) for u = 2 pi t / T, weighed by the window's square, for each number of neighbours there is. Six leave 5.5 % of the
/// slope (RMS), four 10 %, two 25 %.
const SLOPES: [&[f32]; 4] = [&[], &[4.0 / 3.0], &[5.0 / 3.0, -5.0 / 12.0], &[9.0 / 5.0, -63.0 / 100.0, 14.0 / 75.0]];

/// Moves lines from the frequencies at which a drifting crystal took them to those of the grid.
///
/// Line k was taken at k (1 - drift): at 1.25 Hz and 50 ppm a sixteenth of a line of 0.001 Hz too low. Two nodes that drift
/// apart see noise at different frequencies, and their coherence, with it the phases' scatter, suffers.
fn move_lines(grid: &LineGrid, drift_ppb: i32, lines: &mut [Complex32]) {
    if drift_ppb == 0 {
        return;
    }
    let taken = lines.to_vec();
    for (index, line) in lines.iter_mut().enumerate() {
        let shift = (grid.first_line + index) as f64 * f64::from(drift_ppb) * 1e-9;
        let neighbours = index.min(taken.len() - 1 - index).min(SLOPES.len() - 1);
        // Phases are those of the segment's start; those of its middle, which change smoothly, alternate in sign.
        for (distance, (weight, sign)) in (1..).zip(SLOPES[neighbours].iter().zip([-1.0, 1.0, -1.0])) {
            let difference = taken[index + distance] - taken[index - distance];
            *line += difference * (0.5 * sign * weight * shift as f32);
        }
    }
}

/// Turns lines of a segment whose middle was `offset_us` late into those of one on the grid: a signal seen from a
/// later moment leads by 2 pi f times the delay.
fn remove_offset(grid: &LineGrid, offset_us: i32, lines: &mut [Complex32]) {
    if offset_us == 0 {
        return;
    }
    let spacing_hz = grid.sampling_rate_hz / grid.segment as f64;
    for (index, line) in lines.iter_mut().enumerate() {
        let frequency_hz = (grid.first_line + index) as f64 * spacing_hz;
        let turn = Complex64::cis(-TAU * frequency_hz * f64::from(offset_us) * 1e-6);
        *line *= Complex32::new(turn.re as f32, turn.im as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of a Hann segment of noise-like tones, by the definition, sampled `stretch` further apart than by the grid, with the
    /// middle where the grid has it.
    fn lines(grid: &LineGrid, stretch: f64) -> Vec<Complex32> {
        let tones = [(0.613, 1.0, 0.3), (0.618, 0.7, 2.0), (0.7214, 1.3, 4.0), (0.7219, 0.4, 1.1), (0.66, 0.9, 5.0)];
        let length = grid.segment as f64;
        let middle_s = length / 2.0 / grid.sampling_rate_hz;
        let samples: Vec<f64> = (0..grid.segment)
            .map(|n| {
                let n = n as f64;
                let t = middle_s + (n - length / 2.0) * (1.0 + stretch) / grid.sampling_rate_hz;
                let window = 0.5 - 0.5 * (TAU * n / length).cos();
                window * tones.iter().map(|(f, a, phase)| a * (TAU * f * t + phase).cos()).sum::<f64>()
            })
            .collect();
        (0..grid.lines)
            .map(|line| {
                let k = (grid.first_line + line) as f64;
                let sum: Complex64 =
                    samples.iter().enumerate().map(|(n, x)| Complex64::cis(-TAU * k * n as f64 / length) * x).sum();
                Complex32::new(sum.re as f32, sum.im as f32)
            })
            .collect()
    }

    #[test]
    fn lines_of_a_drifting_crystal_are_moved_to_where_an_exact_one_takes_them() {
        let grid = LineGrid { sampling_rate_hz: 5.0, segment: 1024, first_line: 110, lines: 50 };
        let exact = lines(&grid, 0.0);
        let difference = |lines: &[Complex32]| {
            let of = |a: &[Complex32], b: &[Complex32]| a.iter().zip(b).map(|(a, b)| (a - b).norm_sqr()).sum::<f32>();
            (of(lines, &exact) / of(&exact, &vec![Complex32::default(); exact.len()])).sqrt()
        };
        for drift_ppb in [400_000, -400_000] {
            let mut drifted = lines(&grid, f64::from(drift_ppb) * 1e-9);
            let before = difference(&drifted);
            move_lines(&grid, drift_ppb, &mut drifted);
            assert!(before > 0.04 && difference(&drifted) < 0.12 * before, "{before} -> {}", difference(&drifted));
        }
    }
}
