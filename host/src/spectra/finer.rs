//! Finer lines than windows have, from the windows themselves.
//!
//! Windows at half overlap flow in; windows of several times their length flow out. The periodic Hann window and itself half a
//! segment later add up to one, so the sum of the segments, each where it was, is the signal, as far as the lines reach (weighted
//! overlap-add; Allen and Rabiner 1977). It is the same whether a node or the host has made the windows. Where a channel was silent
//! there is no signal, and no long window reaches over that place.

use std::ops::Range;

use belfry_numerics::{ComplexTransform, complex_transform, inverse_complex_transform};
use nalgebra::DMatrix;
use num_complex::{Complex32, Complex64};

use super::accumulate::MAX_GROUPS;
use super::cross_spectrum::hermitian;
use super::grid::{LineGrid, WindowLines, hann};
use super::sums::triangle;

/// Windows that take more than this are not kept: so long a record has fine lines as it is, or many averages. While long windows are made
/// of them there are three times as many bytes.
const MOST_BYTES: usize = 64 << 20;

/// The windows of one setup as they went into its average.
#[derive(Debug, Clone)]
pub(super) struct KeptWindows {
    grid: LineGrid,
    windows: Vec<WindowLines>,
    most: usize,
}

impl KeptWindows {
    /// None yet, of about so many that will come; `None` where that is not known or they would take too much memory.
    pub(super) fn expecting(grid: LineGrid, channels: usize, windows: usize) -> Option<Self> {
        let most = MOST_BYTES / (channels * grid.lines * size_of::<Complex32>()).max(1);
        (1..=most).contains(&windows).then(|| Self { grid, windows: Vec::with_capacity(windows), most })
    }

    /// With the next window, in the order of the grid; `None` where that is one too many.
    #[must_use]
    pub(super) fn with(mut self, window: &WindowLines) -> Option<Self> {
        self.windows.push(window.clone());
        (self.windows.len() <= self.most).then_some(self)
    }

    /// Windows of these channels as long as leaves `least`, half overlapping, up to `most` times; and how many times. `None` where they are
    /// no longer.
    pub(super) fn finest(&self, channels: &[usize], most: usize, least: usize) -> Option<(FinerSpectrum, usize)> {
        let runs = self.runs(channels);
        let count = |times: usize| runs.iter().map(|run| long_windows(run.len(), times)).sum::<usize>();
        let times = (2..=most).rev().find(|&times| count(times) >= least)?;
        Some((self.finer(channels, &runs, times)?, times))
    }

    /// Windows of `times` their length of these channels in runs of theirs; `None` where there is none.
    fn finer(&self, channels: &[usize], runs: &[Range<usize>], times: usize) -> Option<FinerSpectrum> {
        let grid = LineGrid {
            segment: self.grid.segment * times,
            first_line: self.grid.first_line * times,
            lines: (self.grid.lines - 1) * times + 1,
            ..self.grid
        };
        let stitcher = Stitcher::new(&self.grid, times);
        let mut windows: Vec<Vec<Vec<Complex32>>> = Vec::new();
        for run in runs.iter().filter(|run| long_windows(run.len(), times) > 0) {
            let mut by_channel: Vec<Vec<Vec<Complex32>>> = channels
                .iter()
                .map(|&channel| {
                    let segments = self.windows[run.clone()].iter().map(|window| lines(window, channel));
                    stitcher.windows(segments, run.len())
                })
                .collect();
            windows.extend(
                (0..long_windows(run.len(), times))
                    .map(|window| by_channel.iter_mut().map(|windows| std::mem::take(&mut windows[window])).collect()),
            );
        }
        (!windows.is_empty()).then_some(FinerSpectrum { grid, windows })
    }

    /// Runs of consecutive windows in which all these channels are sound.
    fn runs(&self, channels: &[usize]) -> Vec<Range<usize>> {
        let is_sound = |window: &WindowLines| {
            channels.iter().all(|&channel| window.channels.get(channel).is_some_and(Option::is_some))
        };
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (index, window) in self.windows.iter().enumerate().filter(|(_, window)| is_sound(window)) {
            match runs.last_mut() {
                Some(run) if run.end == index && self.windows[index - 1].grid_index + 1 == window.grid_index => {
                    run.end += 1;
                }
                _ => runs.push(index..index + 1),
            }
        }
        runs
    }
}

fn lines(window: &WindowLines, channel: usize) -> &[Complex32] {
    window.channels[channel].as_deref().unwrap_or_default()
}

/// Windows of `times` the length, half overlapping, in a run of windows: where two of the run lie over each other.
fn long_windows(run: usize, times: usize) -> usize {
    // In half segments: there are `run - 1` with two windows over them, a long window has `2 * times` and follows after `times`.
    (run.saturating_sub(1)).checked_sub(2 * times).map_or(0, |spare| spare / times + 1)
}

/// Makes long windows of short ones.
struct Stitcher {
    times: usize,
    first_line: usize,
    lines: usize,
    /// Samples of a segment, shifted to the band: an even number, no less than there are lines.
    samples: usize,
    inverse: ComplexTransform,
    forward: ComplexTransform,
    hann: Vec<f64>,
    /// From lines of short windows to lines of long ones.
    scale: f64,
}

impl Stitcher {
    fn new(grid: &LineGrid, times: usize) -> Self {
        let samples = (grid.lines + 2).next_multiple_of(8);
        let long = samples * times;
        // A line of a segment of duration T is sqrt(2 / (0.375 T)) times the integral of hann x exp(-i omega t). Samples are 1 / T times
        // the sum of such integrals, and each stands for T / samples of the long one's integral.
        let scale = 1.0 / (samples as f64 * (times as f64).sqrt());
        Self {
            times,
            first_line: grid.first_line,
            lines: grid.lines,
            samples,
            inverse: inverse_complex_transform(samples),
            forward: complex_transform(long),
            hann: hann(long),
            scale,
        }
    }

    /// Long windows of one channel, from a run of `count` windows.
    fn windows<'a>(&self, run: impl Iterator<Item = &'a [Complex32]>, count: usize) -> Vec<Vec<Complex32>> {
        let half = self.samples / 2;
        // The band is shifted down by its first line, which makes half a turn a line in half a segment.
        let turn = |halves: usize| if (halves * self.first_line).is_multiple_of(2) { 1.0 } else { -1.0 };
        let mut signal = vec![Complex64::ZERO; (count + 1) * half];
        let mut segment = vec![Complex64::ZERO; self.samples];
        for (place, lines) in run.enumerate() {
            segment.fill(Complex64::ZERO);
            for (to, line) in segment.iter_mut().zip(lines) {
                *to = Complex64::new(f64::from(line.re), f64::from(line.im)) * turn(place + 1);
            }
            self.inverse.process(&mut segment);
            for (to, sample) in signal[place * half..].iter_mut().zip(&segment) {
                *to += sample;
            }
        }
        // The first and the last half segment have one window only.
        let long = self.samples * self.times;
        (0..long_windows(count, self.times))
            .map(|window| {
                let from = half + window * self.times * half;
                let mut buffer: Vec<Complex64> =
                    signal[from..from + long].iter().zip(&self.hann).map(|(sample, weight)| sample * *weight).collect();
                self.forward.process(&mut buffer);
                let lines = (self.lines - 1) * self.times + 1;
                buffer.truncate(lines);
                let scale = self.scale * turn(window * self.times);
                buffer.iter().map(|line| Complex32::new((line.re * scale) as f32, (line.im * scale) as f32)).collect()
            })
            .collect()
    }
}

/// Long windows of one setup. Matrices are made of them line by line, where they are asked for.
#[derive(Debug, Clone)]
pub struct FinerSpectrum {
    grid: LineGrid,
    /// Window by window, channel by channel, in the order in which channels were asked for.
    windows: Vec<Vec<Vec<Complex32>>>,
}

impl FinerSpectrum {
    /// The lines.
    pub fn grid(&self) -> &LineGrid {
        &self.grid
    }

    /// Channels.
    pub fn channels(&self) -> usize {
        self.windows.first().map_or(0, Vec::len)
    }

    /// Windows.
    pub fn averages(&self) -> usize {
        self.windows.len()
    }

    /// Groups of consecutive windows, nearly equal, for the jackknife.
    pub fn groups(&self) -> usize {
        self.averages().min(MAX_GROUPS)
    }

    /// The matrix of a line, as [`CrossSpectrum::matrix`](super::CrossSpectrum::matrix); without one group of windows, where it is named.
    pub fn matrix(&self, line: usize, without: Option<usize>) -> DMatrix<Complex64> {
        let count = self.channels();
        let mut sums = vec![Complex64::ZERO; triangle(count)];
        let group = |window: usize| window * self.groups() / self.averages();
        let windows = self.windows.iter().enumerate().filter(|(window, _)| without != Some(group(*window)));
        let mut used = 0;
        for (_, window) in windows {
            used += 1;
            let values: Vec<Complex64> = window
                .iter()
                .map(|lines| Complex64::new(f64::from(lines[line].re), f64::from(lines[line].im)))
                .collect();
            let mut places = sums.iter_mut();
            for (row, value) in values.iter().enumerate() {
                for (other, place) in values[row..].iter().zip(&mut places) {
                    *place += value * other.conj();
                }
            }
        }
        hermitian(count, |place| sums[place] / f64::from(used.max(1)))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::spectra::direct::Welch;

    impl KeptWindows {
        fn finer_windows(&self, channels: &[usize], times: usize) -> usize {
            self.runs(channels).iter().map(|run| long_windows(run.len(), times)).sum()
        }

        fn all_finer(&self, channels: &[usize], times: usize) -> Option<FinerSpectrum> {
            self.finer(channels, &self.runs(channels), times)
        }
    }

    const GRID: LineGrid = LineGrid { sampling_rate_hz: 4.0, segment: 256, first_line: 21, lines: 61 };

    /// Rows of two channels: thirty tones in the middle of the band, and the same half as large and later.
    fn rows(range: Range<usize>) -> Vec<f64> {
        let tone = |k: usize, row: f64| (TAU * (0.5 + 0.0137 * k as f64) * row / 4.0 + (k * k) as f64).cos();
        let at = |row: f64| (0..30).map(|k| tone(k, row)).sum::<f64>();
        range.flat_map(|row| [at(row as f64), 0.5 * at(row as f64 - 2.0)]).collect()
    }

    fn kept(segments: usize, grid: LineGrid) -> KeptWindows {
        let mut kept = KeptWindows::expecting(grid, 2, 100);
        let rows = rows(0..256 * segments);
        Welch::new(grid, 1, 2).unwrap().push(&rows, &mut |window| kept = kept.take().unwrap().with(&window));
        kept.unwrap()
    }

    #[test]
    fn long_windows_are_those_of_the_recording_itself() {
        const TIMES: usize = 3;
        let short = kept(12, GRID);
        let finer = short.all_finer(&[0, 1], TIMES).unwrap();
        let long_grid = LineGrid { segment: 256 * TIMES, first_line: 21 * TIMES, lines: 60 * TIMES + 1, ..GRID };
        assert_eq!(*finer.grid(), long_grid);
        assert_eq!(finer.averages(), short.finer_windows(&[0, 1], TIMES));
        // The first long window begins half a segment late.
        let mut windows = Vec::new();
        Welch::new(long_grid, 1, 2).unwrap().push(&rows(128..256 * 12), &mut |window| windows.push(window));
        for (index, window) in finer.windows.iter().enumerate() {
            for (channel, lines) in window.iter().enumerate() {
                let expected = windows[index].channels[channel].as_ref().unwrap();
                let largest = expected.iter().map(|line| line.norm()).fold(0.0, f32::max);
                for (line, (found, expected)) in lines.iter().zip(expected).enumerate() {
                    let error = (found - expected).norm();
                    assert!(error < 1e-3 * largest, "{index}, {channel}, {line}: {found} {expected}");
                }
            }
        }
        let matrix = finer.matrix(50, None);
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let values = finer.windows.iter().map(|window| (window[row][50], window[column][50]));
            let sum: Complex32 = values.map(|(a, b)| a * b.conj()).sum();
            let mean = Complex64::new(f64::from(sum.re), f64::from(sum.im)) / finer.averages() as f64;
            assert!((matrix[(row, column)] - mean).norm() < 1e-5 * matrix[(0, 0)].norm(), "{row} {column}");
        }
        assert_eq!(finer.groups(), finer.averages());
        let others = finer.matrix(50, Some(0)) * Complex64::from((finer.averages() - 1) as f64);
        let own = Complex64::from(f64::from(finer.windows[0][0][50].norm_sqr()));
        let whole = matrix[(0, 0)] * Complex64::from(finer.averages() as f64);
        assert!((others[(0, 0)] + own - whole).norm() < 1e-6);
    }

    #[test]
    fn many_windows_are_left_out_in_groups() {
        let finer = kept(60, GRID).all_finer(&[0], 1).unwrap();
        assert_eq!((finer.averages(), finer.groups()), (117, MAX_GROUPS));
        let power = |line: &[Complex32]| f64::from(line[30].norm_sqr());
        let whole: f64 = finer.windows.iter().map(|window| power(&window[0])).sum();
        // Of 117 windows the first group has five.
        let first: f64 = finer.windows[..5].iter().map(|window| power(&window[0])).sum();
        let left = finer.matrix(30, Some(0))[(0, 0)].re * 112.0;
        assert!((left + first - whole).abs() < 1e-6 * whole);
    }

    #[test]
    fn no_long_window_reaches_over_a_silence() {
        let mut short = kept(20, GRID);
        let whole = short.finer_windows(&[0, 1], 2);
        assert_eq!(whole, (39 - 1 - 4) / 2 + 1);
        short.windows[20].channels[1] = None;
        assert_eq!(short.finer_windows(&[0], 2), whole, "of another channel");
        assert_eq!(short.finer_windows(&[0, 1], 2), (20 - 1 - 4) / 2 + 1 + (18 - 1 - 4) / 2 + 1);
        short.windows.remove(20);
        assert_eq!(short.finer_windows(&[0, 1], 2), (20 - 1 - 4) / 2 + 1 + (18 - 1 - 4) / 2 + 1);
        assert!(short.all_finer(&[0, 1], 12).is_none());
    }

    #[test]
    fn windows_of_a_long_record_are_not_kept() {
        assert!(KeptWindows::expecting(LineGrid { lines: 2000, ..GRID }, 20, 100).is_some());
        assert!(KeptWindows::expecting(LineGrid { lines: 20_000, ..GRID }, 20, 100).is_none());
        assert!(KeptWindows::expecting(GRID, 20, 0).is_none(), "nobody knows how many");
        // More than were expected.
        let large = LineGrid { lines: 1 << 20, ..GRID };
        let mut kept = KeptWindows::expecting(large, 2, 2).unwrap();
        let silent = |grid_index| WindowLines { grid_index, channels: vec![None, None] };
        for window in 0..4 {
            kept = kept.with(&silent(window)).unwrap();
        }
        assert!(kept.with(&silent(4)).is_none());
    }
}
