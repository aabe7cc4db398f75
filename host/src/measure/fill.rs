//! Up to three samples that are missing are filled by a straight line between those beside them.
//!
//! Rows flow in, rows flow out a few later, and a tally. A segment of some minutes would otherwise be lost for one sample.

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
    /// The last rows, and before them those that were handed out last.
    held: Vec<f64>,
    handed_out: usize,
    /// The recording's row that they begin with.
    first: u64,
    filled: Vec<Filled>,
}

impl Filler {
    pub(super) fn new(channels: usize) -> Self {
        Self { channels, held: Vec::new(), handed_out: 0, first: 0, filled: vec![Filled::default(); channels] }
    }

    /// Takes rows, row-major, NaN where a sample is missing; hands out those that are complete with them.
    pub(super) fn push(&mut self, rows: &[f64]) -> &[f64] {
        self.first += (self.handed_out / self.channels.max(1)) as u64;
        self.held.drain(..self.handed_out);
        let new = self.held.len();
        self.held.extend_from_slice(rows);
        // Most recordings miss nothing: they are only passed on.
        if self.held.iter().any(|value| value.is_nan()) {
            for at in new.max(self.channels)..self.held.len() {
                if self.held[at].is_finite() && self.held[at - self.channels].is_nan() {
                    self.fill_before(at);
                }
            }
        }
        self.handed_out = self.held.len().saturating_sub((MOST_IN_A_ROW + 1) * self.channels);
        &self.held[..self.handed_out]
    }

    /// Fills what is missing of a channel just before the sample `at`.
    fn fill_before(&mut self, at: usize) {
        let (channel, row) = (at % self.channels, at / self.channels);
        let place = |row: usize| row * self.channels + channel;
        let gap = (0..row).rev().take_while(|&row| self.held[place(row)].is_nan()).count();
        // The recording's row.
        let here = self.first + row as u64;
        let filled = &mut self.filled[channel];
        if gap == row || gap > MOST_IN_A_ROW || filled.count as f64 >= MOST_SHARE * here as f64 + ALWAYS {
            return;
        }
        let (before, after) = (self.held[place(row - gap - 1)], self.held[at]);
        if !before.is_finite() {
            return;
        }
        for step in 1..=gap {
            let share = step as f64 / (gap + 1) as f64;
            self.held[place(row - gap - 1 + step)] = before + share * (after - before);
        }
        if filled.count == 0 {
            filled.first_row = here - gap as u64;
        }
        filled.count += gap as u64;
    }

    /// The last rows, and what was filled, channel by channel.
    pub(super) fn finish(mut self) -> (Vec<f64>, Vec<Filled>) {
        self.held.drain(..self.handed_out);
        (self.held, self.filled)
    }
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
        let mut filler = Filler::new(2);
        let mut out: Vec<f64> = samples.chunks(2 * 700).flat_map(|part| filler.push(part).to_vec()).collect();
        let (last, filled) = filler.finish();
        out.extend(last);
        assert_eq!(out.len(), samples.len());
        assert_eq!(out[2000], 0.5 * (value(999) + value(1001)));
        assert!((out[2 * 1201] - 0.5 * (value(1199) + value(1203))).abs() < 1e-15);
        assert_eq!(filled[0], Filled { first_row: 1000, count: 4 });
        assert!((1500..1504).all(|row| out[2 * row + 1].is_nan()));
        assert!(filled[1].first_row == 2002 && (90..120).contains(&filled[1].count), "{filled:?}");
        let mut short = Filler::new(2);
        assert!(short.push(&[1.0, 2.0]).is_empty());
        assert_eq!(short.finish().0, [1.0, 2.0]);
    }
}
