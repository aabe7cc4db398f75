//! Up to three samples that are missing are filled by a straight line between those beside them.
//!
//! Rows flow in, rows flow out some later, and a tally. A segment of some minutes would otherwise be lost for one sample. Pieces in
//! which a channel holds one value become missing first, while the rows are held.

use super::flat::{Flat, FlatFinder};

use crate::processor::whole_rows;

/// Of a channel's samples, those that may be filled: a channel that misses more is recorded at another rate, or broken.
const MOST_SHARE: f64 = 0.03;
/// Some are filled whatever their share.
const ALWAYS: f64 = 10.0;
/// Longer gaps stay.
const MOST_IN_A_ROW: usize = 3;

/// What was filled in one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Filled {
    /// The first sample that was filled: the recording's row, from 0.
    pub(super) first_row: u64,
    /// How many were.
    pub(super) count: u64,
}

/// Fills the rows of a recording.
pub(super) struct Filler {
    channels: usize,
    /// The last rows, which are not handed out yet.
    held: Vec<f64>,
    /// The recording's row that they begin with.
    first: u64,
    flat: FlatFinder,
    filled: Vec<Filled>,
}

impl Filler {
    pub(super) fn new(flat: FlatFinder) -> Self {
        let channels = flat.channels();
        Self { channels, held: Vec::new(), first: 0, flat, filled: vec![Filled::default(); channels] }
    }

    /// Takes rows, row-major, NaN where a sample is missing; puts those that are complete with them into `out`, and nothing else.
    pub(super) fn push(&mut self, rows: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.extend_from_slice(&self.held);
        out.extend_from_slice(whole_rows(rows, self.channels));
        self.flat.mark(out, self.first);
        // Most recordings miss nothing: they are only passed on.
        if is_any_missing(out) {
            for at in self.held.len().max(self.channels)..out.len() {
                if out[at].is_finite() && out[at - self.channels].is_nan() {
                    self.fill_before(at, out);
                }
            }
        }
        let complete = out.len().saturating_sub((MOST_IN_A_ROW + 1).max(self.flat.held()) * self.channels);
        self.held.clear();
        self.held.extend_from_slice(&out[complete..]);
        out.truncate(complete);
        self.first += (complete / self.channels.max(1)) as u64;
    }

    /// Fills what is missing of a channel just before the sample `at` of `rows`.
    fn fill_before(&mut self, at: usize, rows: &mut [f64]) {
        let (channel, row) = (at % self.channels, at / self.channels);
        let place = |row: usize| row * self.channels + channel;
        let gap = (0..row).rev().take_while(|&row| rows[place(row)].is_nan()).count();
        // The recording's row.
        let here = self.first + row as u64;
        let filled = &mut self.filled[channel];
        if gap == row || gap > MOST_IN_A_ROW || filled.count as f64 >= MOST_SHARE * here as f64 + ALWAYS {
            return;
        }
        let (before, after) = (rows[place(row - gap - 1)], rows[at]);
        if !before.is_finite() {
            return;
        }
        for step in 1..=gap {
            let share = step as f64 / (gap + 1) as f64;
            rows[place(row - gap - 1 + step)] = before + share * (after - before);
        }
        if filled.count == 0 {
            filled.first_row = here - gap as u64;
        }
        filled.count += gap as u64;
    }

    /// The last rows, and what was filled and what is flat, channel by channel.
    pub(super) fn finish(self) -> (Vec<f64>, Vec<Filled>, Vec<Flat>) {
        let rows = self.first + (self.held.len() / self.channels.max(1)) as u64;
        (self.held, self.filled, self.flat.finish(rows))
    }
}

/// Whether any value is NaN: without a branch a value, so that several are looked at at once.
fn is_any_missing(values: &[f64]) -> bool {
    values.iter().fold(false, |is_any, value| is_any | value.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_gaps_are_filled_and_longer_ones_stay() {
        let rows = 3000;
        let value = |row: usize| (0.01 * row as f64).sin();
        let mut samples: Vec<f64> = (0..rows).flat_map(|row| [value(row), value(row)]).collect();
        // One and three missing in the first channel, four in the second, which then misses every other sample.
        for row in [1000, 1200, 1201, 1202] {
            samples[2 * row] = f64::NAN;
        }
        (1500..1504).for_each(|row| samples[2 * row + 1] = f64::NAN);
        (1001..1500).for_each(|half| samples[2 * (2 * half) + 1] = f64::NAN);
        let mut filler = Filler::new(FlatFinder::new(2, 50.0));
        let (mut out, mut part_out) = (Vec::new(), Vec::new());
        for part in samples.chunks(2 * 700) {
            filler.push(part, &mut part_out);
            out.extend_from_slice(&part_out);
        }
        let (last, filled, _) = filler.finish();
        out.extend(last);
        assert_eq!(out.len(), samples.len());
        assert_eq!(out[2000], 0.5 * (value(999) + value(1001)));
        assert!((out[2 * 1201] - 0.5 * (value(1199) + value(1203))).abs() < 1e-15);
        assert_eq!(filled[0], Filled { first_row: 1000, count: 4 });
        assert!((1500..1504).all(|row| out[2 * row + 1].is_nan()));
        assert!(filled[1].first_row == 2002 && (90..120).contains(&filled[1].count), "{filled:?}");
        let mut short = Filler::new(FlatFinder::new(2, 50.0));
        short.push(&[1.0, 2.0], &mut part_out);
        assert!(part_out.is_empty());
        assert_eq!(short.finish().0, [1.0, 2.0]);
    }
}
