//! Spikes of single samples, as bad contacts and bit errors make them, are replaced by the mean of their neighbours.
//!
//! Rows flow in, rows flow out some later, and a tally. A sample is a spike where it alone is off: its distance from the mean of its
//! neighbours is many times what is usual for the channel, and what is usual just before and just after; and the neighbours agree
//! with each other. Nothing that a structure does looks like that, for a recorder's own filter spreads it over several samples.
//! Missing samples and those of a channel that stands still say nothing of what is usual.

use crate::processor::{OnChannels, by_channels, loaded, on_this_processor, store, whole_rows};

/// A spike is this many root mean squares of the usual distance away.
const FAR: f64 = 12.0;
/// Of that distance, how much the neighbours may differ.
const AGREE: f64 = 0.25;
/// Samples over which the usual distance is averaged; a single one counts as no more than this many times the mean square. Once it is
/// learnt, every so many rows count, which is as good and costs less.
const MEMORY: f64 = 512.0;
const LEARN_EVERY: u64 = 4;
const MOST: f64 = 25.0;
/// Moving samples of a channel that are only learnt from, and rows after which a channel's weight is brought up to date.
const LEARNT: f64 = 128.0;
const WEIGHED: u64 = 64;
/// Rows on either side of a sample that is far: it must be this many times as far off as is usual on either side, so that a load that
/// sets in is no spike.
const BESIDE: usize = 12;
const FAR_BESIDE: f64 = 8.0;
/// Fewer known distances tell nothing of a side.
const LEAST_BESIDE: usize = 5;

/// What was replaced in one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Spikes {
    /// Samples replaced.
    pub(super) count: u64,
    /// The first of them: the recording's row, from 0.
    pub(super) first_row: u64,
}

/// Replaces spikes in the rows of a recording.
pub(super) struct SpikeFilter {
    channels: usize,
    /// Rows that have been handed out, then those that have been, or will be, judged, and those that have come since.
    held: Vec<f64>,
    /// Rows that have been judged.
    rows: u64,
    /// Mean square of the distance from the mean of the neighbours, the samples that it was learnt from, and what the next counts.
    usual: Vec<f64>,
    seen: Vec<f64>,
    weight: Vec<f64>,
    /// The least step between two samples that was seen: distances of a few of them are how a converter counts.
    least_step: Vec<f64>,
    found: Vec<Spikes>,
}

impl SpikeFilter {
    pub(super) fn new(channels: usize) -> Self {
        Self {
            channels,
            held: vec![f64::NAN; BESIDE * channels],
            rows: 0,
            usual: vec![0.0; channels],
            seen: vec![0.0; channels],
            weight: vec![1.0; channels],
            least_step: vec![f64::INFINITY; channels],
            found: vec![Spikes::default(); channels],
        }
    }

    /// Takes rows, row-major, NaN where a sample is missing; hands out those that are complete with them.
    pub(super) fn push(&mut self, rows: &[f64]) -> &[f64] {
        let (channels, beside) = (self.channels, BESIDE * self.channels);
        self.held.drain(..self.held.len().saturating_sub(2 * beside));
        self.held.extend_from_slice(whole_rows(rows, channels));
        let end = self.held.len().saturating_sub(beside);
        on_this_processor(
            #[inline(always)]
            |_| {
                let mut at = beside;
                while at < end {
                    self.judge(at);
                    at += channels;
                }
            },
        );
        self.held.get(beside..end).unwrap_or_default()
    }

    /// Judges the row that begins at `at`, between its neighbours.
    #[inline(always)]
    fn judge(&mut self, at: usize) {
        self.rows += 1;
        if self.rows < WEIGHED || self.rows.is_multiple_of(WEIGHED) {
            self.weigh();
        }
        if self.is_any_far(at) {
            self.replace_spikes(at);
        }
        if self.rows < MEMORY as u64 || self.rows.is_multiple_of(LEARN_EVERY) {
            self.learn(at);
        }
    }

    /// Whether any channel is far from the mean of its neighbours; takes note of the steps.
    #[inline(always)]
    fn is_any_far(&mut self, at: usize) -> bool {
        let rows = Triple::at(&self.held, at, self.channels);
        let mut look = Look { rows, usual: &self.usual, least_step: &mut self.least_step, far: 0 };
        by_channels(self.channels, &mut look);
        look.far != 0
    }

    /// What the next sample of each channel counts for what is usual.
    #[inline(always)]
    fn weigh(&mut self) {
        for (weight, seen) in self.weight.iter_mut().zip(&self.seen) {
            *weight = 1.0 / (seen + 1.0).min(MEMORY);
        }
    }

    /// Lets a row count for what is usual.
    #[inline(always)]
    fn learn(&mut self, at: usize) {
        let rows = Triple::at(&self.held, at, self.channels);
        let mut learn = Learn { rows, weight: &self.weight, usual: &mut self.usual, seen: &mut self.seen };
        by_channels(self.channels, &mut learn);
    }

    /// Replaces the spikes of a row with a sample that is far.
    #[cold]
    fn replace_spikes(&mut self, at: usize) {
        let spikes: Vec<Option<f64>> = (0..self.channels).map(|channel| self.spike(at, channel)).collect();
        for ((spike, here), found) in spikes.iter().zip(&mut self.held[at..]).zip(&mut self.found) {
            let Some(mean) = spike else { continue };
            if found.count == 0 {
                found.first_row = self.rows - 1;
            }
            found.count += 1;
            *here = *mean;
        }
    }

    /// The mean of a channel's neighbours, where its sample is a spike.
    fn spike(&self, at: usize, channel: usize) -> Option<f64> {
        let rows = Triple::at(&self.held, at, self.channels);
        let (before, after) = (rows.before[channel], rows.next[channel]);
        let mean = 0.5 * (before + after);
        let distance = rows.here[channel] - mean;
        // What is still learnt from is not judged.
        let is_spike = self.weight[channel] < 1.0 / LEARNT
            && is_far(distance, self.usual[channel], self.least_step[channel])
            && (after - before).abs() < AGREE * distance.abs()
            && distance.abs() > FAR_BESIDE * self.usual_beside(at, channel);
        is_spike.then_some(mean)
    }

    /// How far a channel's samples are usually from the mean of their neighbours just before a row, or just after: the larger.
    fn usual_beside(&self, at: usize, channel: usize) -> f64 {
        let row = at / self.channels;
        let value = |row: usize| self.held.get(row * self.channels + channel).copied().unwrap_or(f64::NAN);
        let distance = |row: usize| (value(row) - 0.5 * (value(row - 1) + value(row + 1))).abs();
        let middle = |rows: std::ops::Range<usize>| {
            let mut known: Vec<f64> = rows.map(distance).filter(|distance| distance.is_finite()).collect();
            known.sort_by(f64::total_cmp);
            // A spike is in three distances; one on either side changes nothing here.
            if known.len() < LEAST_BESIDE { 0.0 } else { known[(known.len() - 1) / 2] }
        };
        middle(row + 1 - BESIDE..row - 1).max(middle(row + 2..row + BESIDE))
    }

    /// The last rows, and what was replaced, channel by channel.
    pub(super) fn finish(mut self) -> (Vec<f64>, Vec<Spikes>) {
        let behind_last = vec![f64::NAN; BESIDE * self.channels];
        let last = self.push(&behind_last).to_vec();
        (last, self.found)
    }
}

/// A row between its neighbours.
struct Triple<'a> {
    before: &'a [f64],
    here: &'a [f64],
    next: &'a [f64],
}

impl<'a> Triple<'a> {
    #[inline(always)]
    fn at(held: &'a [f64], at: usize, channels: usize) -> Self {
        Self {
            before: &held[at - channels..at],
            here: &held[at..at + channels],
            next: &held[at + channels..at + 2 * channels],
        }
    }

    #[inline(always)]
    fn loaded<const WIDTH: usize>(&self, first: usize) -> ([f64; WIDTH], [f64; WIDTH], [f64; WIDTH]) {
        (loaded(self.before, first), loaded(self.here, first), loaded(self.next, first))
    }
}

/// What [`SpikeFilter::is_any_far`] does.
struct Look<'a> {
    rows: Triple<'a>,
    usual: &'a [f64],
    least_step: &'a mut [f64],
    /// Other than 0 where any is far; as wide as a sample.
    far: u64,
}

impl OnChannels for Look<'_> {
    #[inline(always)]
    fn take<const WIDTH: usize>(&mut self, first: usize) {
        let (before, here, next) = self.rows.loaded::<WIDTH>(first);
        let usual = loaded::<f64, WIDTH>(self.usual, first);
        let mut least_step = loaded::<f64, WIDTH>(self.least_step, first);
        for lane in 0..WIDTH {
            let distance = here[lane] - 0.5 * (before[lane] + next[lane]);
            let step = (here[lane] - before[lane]).abs();
            // Where a sample is missing, nothing is known.
            let is_least = (step > 0.0) & (step < least_step[lane]) & distance.is_finite();
            least_step[lane] = if is_least { step } else { least_step[lane] };
            self.far |= u64::from(is_far(distance, usual[lane], least_step[lane]));
        }
        store(self.least_step, first, &least_step);
    }
}

/// What [`SpikeFilter::learn`] does.
struct Learn<'a> {
    rows: Triple<'a>,
    weight: &'a [f64],
    usual: &'a mut [f64],
    seen: &'a mut [f64],
}

impl OnChannels for Learn<'_> {
    #[inline(always)]
    fn take<const WIDTH: usize>(&mut self, first: usize) {
        let (before, here, next) = self.rows.loaded::<WIDTH>(first);
        let weight = loaded::<f64, WIDTH>(self.weight, first);
        let mut usual = loaded::<f64, WIDTH>(self.usual, first);
        let mut seen = loaded::<f64, WIDTH>(self.seen, first);
        for lane in 0..WIDTH {
            let distance = here[lane] - 0.5 * (before[lane] + next[lane]);
            let square = distance * distance;
            let most = MOST * usual[lane];
            let counted = if (square > most) & (weight[lane] < 1.0 / LEARNT) { most } else { square };
            let change = weight[lane] * (counted - usual[lane]);
            let moves = square.is_finite() & (square > 0.0);
            usual[lane] += if moves { change } else { 0.0 };
            seen[lane] += if moves { 1.0 } else { 0.0 };
        }
        store(self.usual, first, &usual);
        store(self.seen, first, &seen);
    }
}

/// Whether a sample is further from the mean of its neighbours than any signal brings it; not where one of them is missing.
#[inline(always)]
fn is_far(distance: f64, usual: f64, least_step: f64) -> bool {
    let least = least_step * least_step;
    let least = if usual > least { usual } else { least };
    distance.is_finite() & (distance * distance > FAR * FAR * least)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filtered(rows: &[Vec<f64>], block: usize) -> (Vec<Vec<f64>>, Vec<Spikes>) {
        let channels = rows[0].len();
        let flat: Vec<f64> = rows.iter().flatten().copied().collect();
        let mut filter = SpikeFilter::new(channels);
        let mut out: Vec<f64> = Vec::new();
        for part in flat.chunks(block * channels) {
            out.extend_from_slice(filter.push(part));
        }
        let (last, found) = filter.finish();
        out.extend(last);
        (out.chunks(channels).map(<[f64]>::to_vec).collect(), found)
    }

    /// Two channels of motion and noise.
    fn motion(count: usize) -> Vec<Vec<f64>> {
        let mut state = 7_u64;
        let mut noise = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
        };
        (0..count).map(|n| vec![(0.3 * n as f64).sin() + 0.1 * noise(), 5.0 + 0.2 * noise()]).collect()
    }

    #[test]
    fn sound_rows_pass_as_they_are_whatever_the_blocks() {
        let rows = motion(5000);
        for block in [1, 7, 5000] {
            let (out, found) = filtered(&rows, block);
            assert_eq!(out, rows);
            assert!(found.iter().all(|found| found.count == 0));
        }
    }

    #[test]
    fn a_spike_is_replaced_by_the_mean_of_its_neighbours() {
        let mut rows = motion(5000);
        let clean = rows.clone();
        for (row, size) in [(999, 9.81), (3000, -30.0), (3011, 12.0)] {
            rows[row][0] += size;
        }
        let (out, found) = filtered(&rows, 1000);
        assert_eq!(found, [Spikes { count: 3, first_row: 999 }, Spikes::default()]);
        for (row, (out, clean)) in out.iter().zip(&clean).enumerate() {
            assert!((out[0] - clean[0]).abs() < 0.3, "row {row}: {} {}", out[0], clean[0]);
            assert_eq!(out[1], clean[1]);
        }
    }

    #[test]
    fn steps_missing_samples_and_coarse_counts_are_no_spikes() {
        let mut rows = motion(3000);
        for row in &mut rows[1500..] {
            row[0] += 9.81;
        }
        rows[2000][1] = f64::NAN;
        // A converter that shows mostly nothing, and one count now and then.
        for (n, row) in rows.iter_mut().enumerate() {
            row.push(if n % 97 == 3 { 1e-3 } else { 0.0 });
        }
        let (out, found) = filtered(&rows, 512);
        assert!(found.iter().all(|found| found.count == 0), "{found:?}");
        assert!(out[2000][1].is_nan() && out[1999] == rows[1999]);
    }

    #[test]
    fn many_channels_are_filtered_as_each_alone() {
        const CHANNELS: usize = 21;
        let noise: Vec<f64> = motion(3000 * CHANNELS).into_iter().map(|values| values[1] - 5.0).collect();
        // Spikes, missing samples, a dead channel and one of coarse counts; each channel has its own size.
        let value = |row: usize, channel: usize| {
            let size = 1.0 + channel as f64;
            match (row + 131 * channel) % 400 {
                0 => size * 9.81,
                17 if channel.is_multiple_of(3) => f64::NAN,
                _ if channel == 6 => 0.0,
                _ if channel == 17 => (4.0 * (0.3 * row as f64).sin()).round(),
                _ => size * ((0.01 * (10 + channel) as f64 * row as f64).sin() + noise[row * CHANNELS + channel]),
            }
        };
        let rows: Vec<Vec<f64>> =
            (0..3000).map(|row| (0..CHANNELS).map(|channel| value(row, channel)).collect()).collect();
        let (together, found) = filtered(&rows, 700);
        for channel in 0..CHANNELS {
            let of = |rows: &[Vec<f64>]| -> Vec<Vec<f64>> { rows.iter().map(|row| vec![row[channel]]).collect() };
            let (alone, found_alone) = filtered(&of(&rows), 3000);
            let bits = |rows: Vec<Vec<f64>>| -> Vec<u64> { rows.iter().map(|row| row[0].to_bits()).collect() };
            assert_eq!(bits(of(&together)), bits(alone), "channel {channel}");
            assert_eq!([found[channel]], found_alone[..], "channel {channel}");
            assert!(found[channel].count > 0 || channel == 6, "channel {channel}");
        }
    }

    #[test]
    fn gaps_zeros_and_flat_pieces_teach_nothing() {
        for still in [f64::NAN, 0.0, 5.0] {
            let mut rows = motion(12_000);
            for (n, row) in rows.iter_mut().enumerate() {
                // One channel begins late, the other stands still at times.
                row[0] = if n < 9000 { still } else { row[0] };
                row[1] = if n % 5000 > 4000 { still } else { row[1] };
            }
            let (out, found) = filtered(&rows, 777);
            assert!(found.iter().all(|found| found.count == 0), "{still}: {found:?}");
            assert_eq!(out.len(), rows.len());
        }
    }

    #[test]
    fn a_storm_has_no_spikes_until_one_comes() {
        let mut rows = motion(30_000);
        for row in &mut rows[10_000..] {
            row.iter_mut().for_each(|value| *value *= 30.0);
        }
        rows[20_003][1] += 900.0;
        let (out, found) = filtered(&rows, 1000);
        assert_eq!(found, [Spikes::default(), Spikes { count: 1, first_row: 20_003 }]);
        assert_eq!(out.len(), rows.len());
    }

    #[test]
    fn many_spikes_are_not_usual() {
        let mut rows = motion(20_000);
        for row in rows.iter_mut().skip(1000).step_by(100) {
            row[1] += 3.0;
        }
        let (_, found) = filtered(&rows, 1000);
        assert_eq!(found, [Spikes::default(), Spikes { count: 190, first_row: 1000 }]);
    }
}
