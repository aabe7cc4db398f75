//! Single samples that are missing are filled with the mean of those beside them.
//!
//! Rows flow in, rows flow out one later, and a tally. A segment of some minutes would otherwise be lost for one sample.

/// Of a channel's samples, those that may be filled: a channel that misses more is recorded at another rate, or broken.
const MOST_SHARE: f64 = 0.03;
/// Some are filled whatever their share.
const ALWAYS: f64 = 10.0;

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
    /// The last two rows, the later of which has not been handed out.
    before: Vec<f64>,
    last: Vec<f64>,
    rows: u64,
    filled: Vec<Filled>,
    out: Vec<f64>,
}

impl Filler {
    pub(super) fn new(channels: usize) -> Self {
        let before = vec![f64::NAN; channels];
        Self { before, last: Vec::new(), rows: 0, filled: vec![Filled::default(); channels], out: Vec::new() }
    }

    /// Takes rows, row-major, NaN where a sample is missing; hands out those that are complete with them.
    pub(super) fn push(&mut self, rows: &[f64]) -> &[f64] {
        self.out.clear();
        for row in rows.chunks_exact(self.before.len().max(1)) {
            self.push_row(row);
        }
        &self.out
    }

    fn push_row(&mut self, next: &[f64]) {
        if self.rows > 0 {
            let most = MOST_SHARE * self.rows as f64 + ALWAYS;
            for (((here, before), after), filled) in
                self.last.iter_mut().zip(&self.before).zip(next).zip(&mut self.filled)
            {
                let mean = 0.5 * (before + after);
                if here.is_nan() && mean.is_finite() && (filled.count as f64) < most {
                    *here = mean;
                    if filled.count == 0 {
                        filled.first_row = self.rows - 1;
                    }
                    filled.count += 1;
                }
            }
            self.out.extend_from_slice(&self.last);
            std::mem::swap(&mut self.before, &mut self.last);
        }
        self.last.clear();
        self.last.extend_from_slice(next);
        self.rows += 1;
    }

    /// The last row, and what was filled, channel by channel.
    pub(super) fn finish(self) -> (Vec<f64>, Vec<Filled>) {
        (self.last, self.filled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_that_are_missing_alone_are_filled_and_longer_gaps_stay() {
        let rows = 3000;
        let value = |row: usize| (0.01 * row as f64).sin();
        let mut samples: Vec<f64> = (0..rows).flat_map(|row| [value(row), value(row)]).collect();
        // One missing in the first channel, two in the second, which then misses every other sample.
        (samples[2 * 1000], samples[2 * 1500 + 1], samples[2 * 1501 + 1]) = (f64::NAN, f64::NAN, f64::NAN);
        (1001..1500).for_each(|half| samples[2 * (2 * half) + 1] = f64::NAN);
        let mut filler = Filler::new(2);
        let mut out: Vec<f64> = samples.chunks(2 * 700).flat_map(|part| filler.push(part).to_vec()).collect();
        let (last, filled) = filler.finish();
        out.extend(last);
        assert_eq!(out.len(), samples.len());
        assert_eq!(out[2000], 0.5 * (value(999) + value(1001)));
        assert_eq!(filled[0], Filled { first_row: 1000, count: 1 });
        assert!(out[2 * 1500 + 1].is_nan() && out[2 * 1501 + 1].is_nan());
        assert!(filled[1].first_row == 2002 && (90..120).contains(&filled[1].count), "{filled:?}");
    }
}
