//! Spikes of single samples, as bad contacts and bit errors make them, are replaced by the mean of their neighbours.
//!
//! Rows flow in, rows flow out one later, and a tally. A sample is a spike where it alone is off: its distance from the mean of its
//! neighbours is many times what is usual for the channel, and the neighbours agree with each other. Nothing that a structure does
//! looks like that, for a recorder's own filter spreads it over several samples.

use crate::processor::for_each_row;

/// A spike is this many root mean squares of the usual distance away.
const FAR: f64 = 12.0;
/// Of that distance, how much the neighbours may differ.
const AGREE: f64 = 0.25;
/// Samples over which the usual distance is averaged; a single one counts as no more than this many times the mean square.
const MEMORY: f64 = 2048.0;
const MOST: f64 = 25.0;
/// Samples that are only learnt from.
const LEARNT: u64 = 64;

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
    /// The last two rows, the later of which has not been handed out.
    before: Vec<f64>,
    last: Vec<f64>,
    rows: u64,
    /// Mean square of the distance from the mean of the neighbours.
    usual: Vec<f64>,
    /// The least step between two samples that was seen: distances of a few of them are how a converter counts.
    least_step: Vec<f64>,
    found: Vec<Spikes>,
    out: Vec<f64>,
}

impl SpikeFilter {
    pub(super) fn new(channels: usize) -> Self {
        Self {
            before: vec![f64::NAN; channels],
            last: Vec::new(),
            rows: 0,
            usual: vec![0.0; channels],
            least_step: vec![f64::INFINITY; channels],
            found: vec![Spikes::default(); channels],
            out: Vec::new(),
        }
    }

    /// Takes rows, row-major, NaN where a sample is missing; hands out those that are complete with them.
    pub(super) fn push(&mut self, rows: &[f64]) -> &[f64] {
        self.out.clear();
        for_each_row(
            rows,
            self.before.len(),
            #[inline(always)]
            |row| self.push_row(row),
        );
        &self.out
    }

    #[inline(always)]
    fn push_row(&mut self, next: &[f64]) {
        if self.rows > 0 {
            // What is learnt from is not yet judged.
            if self.is_any_far(next) && self.rows > LEARNT {
                self.replace_spikes(next);
            } else {
                self.learn(next);
            }
            self.out.extend_from_slice(&self.last);
            std::mem::swap(&mut self.before, &mut self.last);
        }
        self.last.clear();
        self.last.extend_from_slice(next);
        self.rows += 1;
    }

    /// Whether any channel is far from the mean of its neighbours; takes note of the steps.
    #[inline(always)]
    fn is_any_far(&mut self, next: &[f64]) -> bool {
        let count = next.len();
        let (before, here) = (&self.before[..count], &self.last[..count]);
        let (usual, least_step) = (&self.usual[..count], &mut self.least_step[..count]);
        let mut is_any_far = false;
        for channel in 0..count {
            let distance = here[channel] - 0.5 * (before[channel] + next[channel]);
            let step = (here[channel] - before[channel]).abs();
            // Where a sample is missing, nothing is known.
            let is_least = (step > 0.0) & (step < least_step[channel]) & distance.is_finite();
            least_step[channel] = if is_least { step } else { least_step[channel] };
            is_any_far |= is_far(distance, usual[channel], least_step[channel]);
        }
        is_any_far
    }

    /// Lets a row whose neighbours are `self.before` and `next` count for what is usual.
    #[inline(always)]
    fn learn(&mut self, next: &[f64]) {
        let weight = 1.0 / MEMORY.min(self.rows as f64);
        let most = if self.rows > LEARNT { MOST } else { f64::INFINITY };
        let count = next.len();
        let (before, here, usual) = (&self.before[..count], &self.last[..count], &mut self.usual[..count]);
        for channel in 0..count {
            let distance = here[channel] - 0.5 * (before[channel] + next[channel]);
            let square = distance * distance;
            let counted = if square > most * usual[channel] { most * usual[channel] } else { square };
            let change = weight * (counted - usual[channel]);
            usual[channel] += if distance.is_finite() { change } else { 0.0 };
        }
    }

    /// The same for a row with a sample that is far, and perhaps a spike.
    #[cold]
    fn replace_spikes(&mut self, next: &[f64]) {
        let spikes: Vec<Option<f64>> = (0..next.len()).map(|channel| self.spike(next, channel)).collect();
        self.learn(next);
        for ((spike, last), found) in spikes.iter().zip(&mut self.last).zip(&mut self.found) {
            let Some(mean) = spike else { continue };
            if found.count == 0 {
                found.first_row = self.rows - 1;
            }
            found.count += 1;
            *last = *mean;
        }
    }

    /// The mean of a channel's neighbours, where its sample is a spike.
    fn spike(&self, next: &[f64], channel: usize) -> Option<f64> {
        let (before, after) = (self.before[channel], next[channel]);
        let mean = 0.5 * (before + after);
        let distance = self.last[channel] - mean;
        let is_spike = is_far(distance, self.usual[channel], self.least_step[channel])
            && (after - before).abs() < AGREE * distance.abs();
        is_spike.then_some(mean)
    }

    /// The last row, and what was replaced, channel by channel.
    pub(super) fn finish(self) -> (Vec<f64>, Vec<Spikes>) {
        (self.last, self.found)
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
}
