//! Spectra straight from a recording, without nodes, in f64.
//!
//! Rows flow in one by one, windows flow out on the grid that nodes use, with the filter that nodes use; everything else
//! (arithmetic, FFT, code) is independent of the firmware, so that one checks the other. Memory does not grow with the record.

use std::f64::consts::TAU;

use belfry_numerics::{ForwardTransform, forward_transform};
use belfry_shared::decimation::{MAX_STAGES, Stages, TAPS_PER_RATIO, fill_taps, tap_count};
use num_complex::{Complex32, Complex64};

use super::grid::{LineGrid, WindowLines};

/// Outputs that an input sample contributes to.
const ACCUMULATORS: usize = TAPS_PER_RATIO + 1;
/// Outputs centred on samples before the first.
const WARM_UP: usize = TAPS_PER_RATIO / 2;

/// One decimating stage of all channels.
struct Stage {
    /// Taps by input phase, in the order of the accumulators.
    taps: Vec<[f64; ACCUMULATORS]>,
    /// One row of channels an output that is being summed.
    accumulators: Vec<f64>,
    phase: usize,
    warm_up: usize,
}

impl Stage {
    fn new(ratio: u8, channels: usize) -> Self {
        let mut taps = vec![0.0; tap_count(ratio)];
        fill_taps(ratio, &mut taps);
        let ratio = usize::from(ratio);
        // While input q * ratio + phase is added, accumulator i holds output q - 13 + i (phase 0) or q - 12 + i (others).
        let row = |phase: usize| {
            let newest = if phase == 0 { TAPS_PER_RATIO } else { TAPS_PER_RATIO - 1 };
            std::array::from_fn(|i| newest.checked_sub(i).map_or(0.0, |j| taps[phase + j * ratio]))
        };
        let taps = (0..ratio).map(row).collect();
        Self { taps, accumulators: vec![0.0; ACCUMULATORS * channels], phase: 0, warm_up: WARM_UP }
    }

    /// Adds a row in place of which, each `ratio` calls, an output row stands; returns whether it does.
    #[inline(always)]
    fn push(&mut self, row: &mut [f64]) -> bool {
        let channels = row.len();
        let taps = &self.taps[self.phase];
        for (sums, tap) in self.accumulators.chunks_exact_mut(channels).zip(taps) {
            for (sum, value) in sums.iter_mut().zip(&*row) {
                *sum += tap * value;
            }
        }
        let first_phase = self.phase == 0;
        self.phase = (self.phase + 1) % self.taps.len();
        if !first_phase {
            return false;
        }
        row.copy_from_slice(&self.accumulators[..channels]);
        self.accumulators.copy_within(channels.., 0);
        let last = self.accumulators.len() - channels;
        self.accumulators[last..].fill(0.0);
        if self.warm_up > 0 {
            self.warm_up -= 1;
            return false;
        }
        true
    }
}

/// What is known of a channel's soundness.
#[derive(Clone, Copy)]
struct Soundness {
    last_value: f64,
    unchanged_since: u64,
    /// The last decimated sample that a missing value reaches, plus one.
    spoilt_until: u64,
}

/// Streaming Welch spectra of one setup's recording.
pub struct Welch {
    grid: LineGrid,
    decimation: u64,
    reach_rows: u64,
    first_full: u64,
    stages: Vec<Stage>,
    soundness: Vec<Soundness>,
    row: Vec<f64>,
    rows: u64,
    samples: u64,
    /// The running segment, channel by channel.
    segment: Vec<f64>,
    filled: usize,
    windows: u64,
    hann: Vec<f64>,
    fft: ForwardTransform,
    buffer: Vec<f64>,
    spectrum: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

impl Welch {
    /// For `channels` channels; `decimation` must be one that [`Stages::of`] splits (plans have no others), or `None` comes back.
    pub fn new(grid: LineGrid, decimation: u32, channels: usize) -> Option<Self> {
        let stages = Stages::of(decimation)?;
        let fft = forward_transform(grid.segment);
        debug_assert!(stages.ratios().len() <= MAX_STAGES);
        Some(Self {
            grid,
            decimation: u64::from(decimation),
            reach_rows: u64::from(stages.reach_rows()),
            first_full: u64::from(stages.first_full_output()),
            stages: stages.ratios().iter().map(|&ratio| Stage::new(ratio, channels)).collect(),
            soundness: vec![Soundness { last_value: 0.0, unchanged_since: 0, spoilt_until: 0 }; channels],
            row: vec![0.0; channels],
            rows: 0,
            samples: 0,
            segment: vec![0.0; grid.segment * channels],
            filled: 0,
            windows: 0,
            hann: (0..grid.segment).map(|n| 0.5 - 0.5 * (TAU * n as f64 / grid.segment as f64).cos()).collect(),
            buffer: fft.make_input_vec(),
            spectrum: fft.make_output_vec(),
            scratch: fft.make_scratch_vec(),
            fft,
        })
    }

    /// Takes rows (row-major, a value a channel, NaN where one is missing) and hands out the windows that are complete with
    /// them.
    pub fn push(&mut self, rows: &[f64], on_window: &mut dyn FnMut(WindowLines)) {
        let channels = self.row.len().max(1);
        // The same loops, compiled for what this processor can do.
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || rows.chunks_exact(channels).for_each(|row| self.push_row(row, on_window)),
        );
    }

    #[inline(always)]
    fn push_row(&mut self, values: &[f64], on_window: &mut dyn FnMut(WindowLines)) {
        let row = self.rows;
        self.rows += 1;
        for ((value, place), soundness) in values.iter().zip(&mut self.row).zip(&mut self.soundness) {
            if value.is_finite() {
                if *value != soundness.last_value || row == 0 {
                    soundness.unchanged_since = row;
                }
                soundness.last_value = *value;
            } else {
                soundness.spoilt_until = (row + self.reach_rows) / self.decimation + 1;
            }
            *place = soundness.last_value;
        }
        for stage in &mut self.stages {
            if !stage.push(&mut self.row) {
                return;
            }
        }
        self.samples += 1;
        if self.samples <= self.first_full {
            return;
        }
        let length = self.grid.segment;
        for (samples, value) in self.segment.chunks_exact_mut(length).zip(&self.row) {
            samples[self.filled] = *value;
        }
        self.filled += 1;
        if self.filled == length {
            let window = self.window();
            on_window(window);
            self.windows += 1;
            for samples in self.segment.chunks_exact_mut(length) {
                samples.copy_within(length / 2.., 0);
            }
            self.filled = length / 2;
        }
    }

    fn window(&mut self) -> WindowLines {
        let length = self.grid.segment;
        let start = self.samples - length as u64;
        let channels = (0..self.soundness.len())
            .map(|channel| {
                let Soundness { unchanged_since, spoilt_until, .. } = self.soundness[channel];
                // The filter still rings with what it heard before a channel fell silent.
                let silent = unchanged_since + self.reach_rows <= start * self.decimation;
                let sound = spoilt_until <= start && !silent;
                sound.then(|| self.lines(channel))
            })
            .collect();
        WindowLines { grid_index: self.windows, channels }
    }

    /// The lines of a channel's running segment.
    fn lines(&mut self, channel: usize) -> Vec<Complex32> {
        let length = self.grid.segment;
        let samples = &self.segment[channel * length..(channel + 1) * length];
        let count = length as f64;
        let centre = (count - 1.0) / 2.0;
        let mean = samples.iter().sum::<f64>() / count;
        let moment: f64 = samples.iter().enumerate().map(|(n, sample)| (n as f64 - centre) * (sample - mean)).sum();
        let slope = moment / (count * (count * count - 1.0) / 12.0);
        // The sum over a periodic Hann window's squares is 3 N / 8.
        let scale = (2.0 / (self.grid.sampling_rate_hz * 0.375 * count)).sqrt();
        for (n, (place, sample)) in self.buffer.iter_mut().zip(samples).enumerate() {
            *place = (sample - mean - slope * (n as f64 - centre)) * self.hann[n] * scale;
        }
        // Fails only for buffers of another length; these are the plan's own.
        let transformed = self.fft.process_with_scratch(&mut self.buffer, &mut self.spectrum, &mut self.scratch);
        debug_assert!(transformed.is_ok());
        let lines = self.spectrum.iter().skip(self.grid.first_line).take(self.grid.lines);
        lines.map(|line| Complex32::new(line.re as f32, line.im as f32)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(welch: &mut Welch, rows: usize, value: impl Fn(usize, usize) -> f64) -> Vec<WindowLines> {
        let mut windows = Vec::new();
        let channels = welch.row.len();
        for row in 0..rows {
            let values: Vec<f64> = (0..channels).map(|channel| value(row, channel)).collect();
            welch.push(&values, &mut |window| windows.push(window));
        }
        windows
    }

    fn grid() -> LineGrid {
        LineGrid { sampling_rate_hz: 5.0, segment: 256, first_line: 5, lines: 70 }
    }

    #[test]
    fn a_tone_on_a_line_has_the_density_of_its_power_in_the_hann_windows_bandwidth() {
        let mut welch = Welch::new(grid(), 10, 1).unwrap();
        let frequency = 40.0 * 5.0 / 256.0;
        let windows = windows(&mut welch, 50 * 300, |row, _| 0.2 * (TAU * frequency * row as f64 / 50.0).cos() + 3.0);
        let lines = windows[0].channels[0].as_ref().unwrap();
        // Power a²/2 over the window's noise bandwidth of 1.5 lines; the filter is flat to 1e-4.
        let expected = 0.02 / (1.5 * 5.0 / 256.0);
        assert!((f64::from(lines[35].norm_sqr()) / expected - 1.0).abs() < 4e-4);
        // Row 130 is at the epoch (13 samples of the filter), where the tone's phase is that of 130 rows.
        let phase = (TAU * frequency * 130.0 / 50.0).rem_euclid(TAU);
        assert!((f64::from(lines[35].arg()).rem_euclid(TAU) - phase).abs() < 1e-3);
    }

    #[test]
    fn the_number_of_windows_is_the_plans() {
        for (decimation, rows) in [(1, 1000), (8, 20_000), (10, 2819), (10, 2820), (12, 40_000)] {
            let mut welch = Welch::new(grid(), decimation, 1).unwrap();
            let count = windows(&mut welch, rows, |row, _| (row as f64).sin()).len();
            assert_eq!(count, super::super::plan::window_count(rows as u64, decimation, 256), "{decimation}, {rows}");
        }
    }

    #[test]
    fn missing_and_constant_values_silence_their_channel_in_the_windows_they_touch_and_no_other() {
        let mut welch = Welch::new(grid(), 10, 3).unwrap();
        let windows = windows(&mut welch, 50 * 400, |row, channel| match channel {
            1 if row == 4000 => f64::NAN,
            2 => 7.0,
            _ => (0.1 * row as f64).sin(),
        });
        let sound: Vec<Vec<bool>> = windows.iter().map(|w| w.channels.iter().map(Option::is_some).collect()).collect();
        // Row 4000 is sample 400, spoilt are 387 to 413; windows cover samples 13 + 128 g .. 269 + 128 g.
        let expected = |g: u64| !(13 + 128 * g..269 + 128 * g).any(|sample| (387..=413).contains(&sample));
        for (g, sound) in sound.iter().enumerate() {
            assert_eq!(*sound, [true, expected(g as u64), false], "window {g}");
        }
        assert!(sound.len() > 5 && sound.iter().any(|s| !s[1]) && sound.iter().filter(|s| s[1]).count() > 3);
    }
}
