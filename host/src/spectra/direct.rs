//! Spectra straight from a recording, without nodes, in f64.
//!
//! Rows flow in one by one, windows flow out on the grid that nodes use, with the filter that nodes use; everything else
//! (arithmetic, FFT, code) is independent of the firmware, so that one checks the other. Memory does not grow with the record.

use belfry_numerics::{ForwardTransform, forward_transform};
use belfry_shared::decimation::{MAX_STAGES, Stages, fill_taps, tap_count};
use num_complex::{Complex32, Complex64};

use super::grid::{LineGrid, WindowLines, hann};
use crate::processor::{
    Arithmetic, OnChannels, by_channels, loaded, on_this_processor, store, weighted_sum, whole_rows,
};

/// Rows that a stage takes in before it moves the last ones to the front again, at least.
const STAGE_ROWS: usize = 256;

/// One decimating stage of all channels.
struct Stage {
    ratio: usize,
    taps: Vec<f64>,
    /// The last rows that came, row-major; as many as there are taps at least, zeros before the first.
    rows: Vec<f64>,
    /// Where the next row goes.
    end: usize,
    /// Rows until the next output is complete.
    missing: usize,
}

impl Stage {
    fn new(ratio: u8, channels: usize) -> Self {
        let mut taps = vec![0.0; tap_count(ratio)];
        fill_taps(ratio, &mut taps);
        let reach = taps.len() / 2;
        let rows = vec![0.0; (taps.len() + STAGE_ROWS.max(taps.len())) * channels];
        Self { ratio: usize::from(ratio), taps, rows, end: reach * channels, missing: reach + 1 }
    }

    /// Adds a row; whether an output row is complete with it, as each `ratio` calls one is.
    #[inline(always)]
    fn is_complete_with(&mut self, row: &[f64]) -> bool {
        if self.end + row.len() > self.rows.len() {
            let reach = self.taps.len() * row.len();
            self.rows.copy_within(self.end - reach..self.end, 0);
            self.end = reach;
        }
        self.rows[self.end..self.end + row.len()].copy_from_slice(row);
        self.end += row.len();
        self.missing -= 1;
        if self.missing > 0 {
            return false;
        }
        self.missing = self.ratio;
        true
    }

    /// Puts the output row that is complete into `row`.
    #[inline(always)]
    fn output(&self, row: &mut [f64], arithmetic: Arithmetic) {
        weighted_sum(arithmetic, &self.taps, &self.rows[self.end - self.taps.len() * row.len()..self.end], row);
    }
}

/// What is known of the channels' soundness.
struct Soundness {
    /// The last value of each that was there.
    last: Vec<f64>,
    /// The row since which it has been that.
    unchanged_since: Vec<u64>,
    /// The last decimated sample that a missing value reaches, plus one.
    spoilt_until: Vec<u64>,
}

impl Soundness {
    fn new(channels: usize) -> Self {
        Self { last: vec![0.0; channels], unchanged_since: vec![0; channels], spoilt_until: vec![0; channels] }
    }

    /// Takes a row; what is missing in it reaches the samples up to `spoilt`.
    #[inline(always)]
    fn take(&mut self, values: &[f64], row: u64, spoilt: impl Fn() -> u64) {
        // No branch a channel where none is missing: this is done for each sample of a recording.
        let mut update =
            Update { values, row, last: &mut self.last, unchanged_since: &mut self.unchanged_since, missing: 0 };
        by_channels(values.len(), &mut update);
        if update.missing != 0 {
            self.spoil(values, spoilt());
        }
    }

    #[cold]
    fn spoil(&mut self, values: &[f64], spoilt: u64) {
        for (until, value) in self.spoilt_until.iter_mut().zip(values) {
            if !value.is_finite() {
                *until = spoilt;
            }
        }
    }
}

/// What [`Soundness::take`] does with a row.
struct Update<'a> {
    values: &'a [f64],
    row: u64,
    last: &'a mut [f64],
    unchanged_since: &'a mut [u64],
    /// Other than 0 where any value is missing; as wide as a sample.
    missing: u64,
}

impl OnChannels for Update<'_> {
    #[inline(always)]
    fn take<const WIDTH: usize>(&mut self, first: usize) {
        let values = loaded::<f64, WIDTH>(self.values, first);
        let mut last = loaded::<f64, WIDTH>(self.last, first);
        let mut since = loaded::<u64, WIDTH>(self.unchanged_since, first);
        for lane in 0..WIDTH {
            let is_there = values[lane].is_finite();
            let is_other = is_there & ((values[lane] != last[lane]) | (self.row == 0));
            since[lane] = if is_other { self.row } else { since[lane] };
            last[lane] = if is_there { values[lane] } else { last[lane] };
            self.missing |= u64::from(!is_there);
        }
        store(self.last, first, &last);
        store(self.unchanged_since, first, &since);
    }
}

/// Streaming Welch spectra of one setup's recording.
pub struct Welch {
    grid: LineGrid,
    decimation: u64,
    reach_rows: u64,
    first_full: u64,
    stages: Vec<Stage>,
    soundness: Soundness,
    row: Vec<f64>,
    rows: u64,
    samples: u64,
    /// The running segment, channel by channel.
    segment: Vec<f64>,
    filled: usize,
    windows: u64,
    hann: Vec<f64>,
    /// How far each point of a segment is from its middle.
    from_middle: Vec<f64>,
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
            soundness: Soundness::new(channels),
            row: vec![0.0; channels],
            rows: 0,
            samples: 0,
            segment: vec![0.0; grid.segment * channels],
            filled: 0,
            windows: 0,
            hann: hann(grid.segment),
            from_middle: (0..grid.segment).map(|n| n as f64 - (grid.segment as f64 - 1.0) / 2.0).collect(),
            buffer: fft.make_input_vec(),
            spectrum: fft.make_output_vec(),
            scratch: fft.make_scratch_vec(),
            fft,
        })
    }

    /// Takes rows (row-major, a value a channel, NaN where one is missing) and hands out the windows that are complete with
    /// them.
    pub fn push(&mut self, rows: &[f64], on_window: &mut dyn FnMut(WindowLines)) {
        let channels = self.row.len();
        let rows = whole_rows(rows, channels);
        on_this_processor(
            #[inline(always)]
            |arithmetic| {
                let mut at = 0;
                while at < rows.len() {
                    self.push_row(&rows[at..at + channels], arithmetic, on_window);
                    at += channels;
                }
            },
        );
    }

    #[inline(always)]
    fn push_row(&mut self, values: &[f64], arithmetic: Arithmetic, on_window: &mut dyn FnMut(WindowLines)) {
        let row = self.rows;
        self.rows += 1;
        let (reach_rows, decimation) = (self.reach_rows, self.decimation);
        self.soundness.take(values, row, || (row + reach_rows) / decimation + 1);
        if self.stages.is_empty() {
            self.row.copy_from_slice(&self.soundness.last);
        }
        for stage in 0..self.stages.len() {
            let row = if stage == 0 { &self.soundness.last } else { &self.row };
            if !self.stages[stage].is_complete_with(row) {
                return;
            }
            self.stages[stage].output(&mut self.row, arithmetic);
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
        let channels = (0..self.row.len())
            .map(|channel| {
                // The filter still rings with what it heard before a channel fell silent.
                let silent = self.soundness.unchanged_since[channel] + self.reach_rows <= start * self.decimation;
                let sound = self.soundness.spoilt_until[channel] <= start && !silent;
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
        // The sum over a periodic Hann window's squares is 3 N / 8.
        let scale = (2.0 / (self.grid.sampling_rate_hz * 0.375 * count)).sqrt();
        let (hann, from_middle, buffer) =
            (&self.hann[..length], &self.from_middle[..length], &mut self.buffer[..length]);
        on_this_processor(
            #[inline(always)]
            |_| {
                let mean = sum_over(length, |n| samples[n]) / count;
                let moment = sum_over(length, |n| from_middle[n] * (samples[n] - mean));
                let slope = moment / (count * (count * count - 1.0) / 12.0);
                for n in 0..length {
                    buffer[n] = (samples[n] - mean - slope * from_middle[n]) * hann[n] * scale;
                }
            },
        );
        // Fails only for buffers of another length; these are the plan's own.
        let transformed = self.fft.process_with_scratch(&mut self.buffer, &mut self.spectrum, &mut self.scratch);
        debug_assert!(transformed.is_ok());
        let lines = self.spectrum.iter().skip(self.grid.first_line).take(self.grid.lines);
        lines.map(|line| Complex32::new(line.re as f32, line.im as f32)).collect()
    }
}

/// The sum of `term` from 0 to before `count`, in parts, so that one addition need not wait for the other.
#[inline(always)]
fn sum_over(count: usize, term: impl Fn(usize) -> f64) -> f64 {
    const PARTS: usize = 16;
    let mut parts = [0.0; PARTS];
    let whole = count - count % PARTS;
    let mut first = 0;
    while first < whole {
        let mut part = 0;
        while part < PARTS {
            parts[part] += term(first + part);
            part += 1;
        }
        first += PARTS;
    }
    for n in whole..count {
        parts[0] += term(n);
    }
    parts.iter().sum()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

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
            assert_eq!(count, super::super::extent::window_count(rows as u64, decimation, 256), "{decimation}, {rows}");
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

    /// A sample of one of 21 channels: some miss samples, some stand still for a while.
    fn sample(row: usize, channel: usize) -> f64 {
        match (row + 613 * channel) % 9000 {
            0..2 if channel.is_multiple_of(3) => f64::NAN,
            2000..7000 if channel % 4 == 1 => 0.5,
            _ => ((0.03 + 0.005 * channel as f64) * row as f64).sin(),
        }
    }

    #[test]
    fn many_channels_are_as_sound_as_each_alone() {
        let mut together = Soundness::new(21);
        let mut alone: Vec<Soundness> = (0..21).map(|_| Soundness::new(1)).collect();
        for row in 0..10_000 {
            let values: Vec<f64> = (0..21).map(|channel| sample(row, channel)).collect();
            together.take(&values, row as u64, || row as u64 + 5);
            for (channel, alone) in alone.iter_mut().enumerate() {
                alone.take(&values[channel..=channel], row as u64, || row as u64 + 5);
                assert_eq!(alone.last, [together.last[channel]], "row {row}, channel {channel}");
                assert_eq!(alone.unchanged_since, [together.unchanged_since[channel]], "row {row}, channel {channel}");
                assert_eq!(alone.spoilt_until, [together.spoilt_until[channel]], "row {row}, channel {channel}");
            }
        }
        assert!(together.spoilt_until.iter().any(|&until| until > 0));
    }

    #[test]
    fn many_channels_have_the_windows_that_each_has_alone() {
        let together = windows(&mut Welch::new(grid(), 10, 21).unwrap(), 20_000, sample);
        let mut silent = [0; 2];
        for channel in 0..21 {
            let mut welch = Welch::new(grid(), 10, 1).unwrap();
            let alone = windows(&mut welch, 20_000, |row, _| sample(row, channel));
            assert_eq!(together.len(), alone.len());
            for (together, alone) in together.iter().zip(&alone) {
                let (together, alone) = (&together.channels[channel], &alone.channels[0]);
                silent[usize::from(together.is_none())] += 1;
                assert_eq!(together.is_some(), alone.is_some(), "channel {channel}");
                // In single precision, of additions in another order.
                let mut pairs = together.iter().flatten().zip(alone.iter().flatten());
                assert!(pairs.all(|(a, b)| (a - b).norm() < 1e-5), "channel {channel}");
            }
        }
        assert!(silent.iter().all(|&count| count > 20), "{silent:?}");
    }

    #[test]
    fn a_part_of_a_row_is_no_row_and_without_channels_there_is_none() {
        let mut welch = Welch::new(grid(), 1, 3).unwrap();
        welch.push(&[1.0; 8], &mut |_| {});
        assert_eq!(welch.rows, 2);
        let mut empty = Welch::new(grid(), 1, 0).unwrap();
        empty.push(&[1.0; 8], &mut |_| {});
        assert_eq!(empty.rows, 0);
    }
}
