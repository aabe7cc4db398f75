//! Pieces in which a channel that moves otherwise holds one value: a sensor, a cable or a recorder that hangs.
//!
//! Rows flow in; samples of such pieces become missing, and a tally flows out. Every sixteenth row is compared with the one before;
//! only where both are equal are the rows between looked at. Where the steps before a piece are mostly none, the channel is quiet
//! for its converter's counts, and does not hang.

/// Rows from one that is looked at to the next.
const STRIDE: usize = 16;
/// The shortest piece in s, within these numbers of rows.
const LEAST_S: f64 = 1.0;
const LEAST: [usize; 2] = [64, 512];
/// Rows before a piece that tell whether the channel moves: of so many known steps at least half. Where fewer are known, as at the
/// start of a recording, a piece must be long.
const BEFORE: usize = 64;
const LEAST_KNOWN: usize = 32;
const LONG: usize = 2048;
/// A channel that holds one value for more than this share of the time does not move otherwise.
const MOST: f64 = 0.98;

/// Pieces of one value in one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Flat {
    /// The first: the recording's row, from 0.
    pub(super) first_row: u64,
    /// How many.
    pub(super) pieces: u64,
    /// Samples in them.
    pub(super) samples: u64,
}

/// A run of equal samples.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: u64,
    /// So many make it a piece.
    least: usize,
    /// Whether they do.
    is_piece: bool,
}

/// Looks for pieces of one value.
pub(super) struct FlatFinder {
    least: usize,
    /// The next row to look at.
    next: u64,
    /// What the channels had at the one before.
    values: Vec<f64>,
    runs: Vec<Option<Run>>,
    going: usize,
    found: Vec<Flat>,
}

impl FlatFinder {
    pub(super) fn new(channels: usize, sampling_rate_hz: f64) -> Self {
        Self {
            least: ((LEAST_S * sampling_rate_hz) as usize).clamp(LEAST[0], LEAST[1]),
            next: 0,
            values: vec![f64::NAN; channels],
            runs: vec![None; channels],
            going: 0,
            found: vec![Flat::default(); channels],
        }
    }

    pub(super) fn channels(&self) -> usize {
        self.values.len()
    }

    /// Rows that are to be held before new ones.
    pub(super) fn held(&self) -> usize {
        self.least + BEFORE + 2 * STRIDE
    }

    /// Takes rows, row-major, of which the first has the number `first`: those that are held, then new ones.
    pub(super) fn mark(&mut self, rows: &mut [f64], first: u64) {
        let channels = self.values.len();
        let end = first + (rows.len() / channels.max(1)) as u64;
        while self.next < end {
            let at = (self.next - first) as usize * channels;
            let here = &rows[at..at + channels];
            let is_any_equal = here.iter().zip(&self.values).fold(false, |any, (here, before)| any | (here == before));
            if is_any_equal || self.going > 0 {
                (0..channels).for_each(|channel| self.look(rows, first, channel));
            } else {
                self.values.copy_from_slice(here);
            }
            self.next += STRIDE as u64;
        }
    }

    /// Looks at a channel's samples since the last look.
    fn look(&mut self, rows: &mut [f64], first: u64, channel: usize) {
        let channels = self.values.len();
        let row = (self.next - first) as usize;
        let here = rows[row * channels + channel];
        let before = std::mem::replace(&mut self.values[channel], here);
        let from = (row + 1).saturating_sub(STRIDE);
        let equal = (from..=row).take_while(|row| rows[row * channels + channel] == before).count();
        let goes_on = equal == STRIDE;
        let run = match self.runs[channel].take() {
            None if !goes_on => return,
            None => {
                self.going += 1;
                self.begun(rows, first, from, channel)
            }
            Some(run) => run,
        };
        let length = (first + (from + equal) as u64).saturating_sub(run.start);
        let is_piece = run.is_piece || length >= run.least as u64;
        if is_piece {
            let marked = if run.is_piece { from } else { run.start.saturating_sub(first) as usize };
            (marked..from + equal).for_each(|row| rows[row * channels + channel] = f64::NAN);
            let found = &mut self.found[channel];
            if found.pieces == 0 {
                found.first_row = run.start;
            }
            found.pieces += u64::from(!run.is_piece);
            found.samples += if run.is_piece { equal as u64 } else { length };
        }
        if goes_on {
            self.runs[channel] = Some(Run { is_piece, ..run });
        } else {
            self.going -= 1;
        }
    }

    /// The run of equal samples that goes on from the row `from`.
    fn begun(&self, rows: &[f64], first: u64, from: usize, channel: usize) -> Run {
        let channels = self.values.len();
        let value = |row: usize| rows[row * channels + channel];
        let back = (0..from).rev().take_while(|&row| value(row) == value(from)).count();
        let start = from - back;
        let steps = (start.saturating_sub(BEFORE) + 1..start).map(|row| value(row) - value(row - 1));
        let known: Vec<f64> = steps.filter(|step| step.is_finite()).collect();
        let moving = known.iter().filter(|step| **step != 0.0).count();
        let least = match known.len() {
            ..LEAST_KNOWN => LONG,
            all if 2 * moving >= all => self.least,
            _ => usize::MAX,
        };
        Run { start: first + start as u64, least, is_piece: false }
    }

    /// What was found in a recording of so many rows, channel by channel.
    pub(super) fn finish(self, rows: u64) -> Vec<Flat> {
        let moves = |flat: Flat| (flat.samples as f64) < MOST * rows as f64;
        self.found.into_iter().map(|flat| if moves(flat) { flat } else { Flat::default() }).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::measure::fill::Filler;

    const ROWS: usize = 40_000;

    /// Two channels of noise like a structure's at 50 Hz, the first changed by `change`: what is handed out, and what was found.
    fn of(change: impl Fn(usize, f64) -> f64) -> (Vec<f64>, Vec<Flat>) {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut motion = 0.0;
        let mut rows = Vec::new();
        for row in 0..ROWS {
            motion = 0.9 * motion + (0..6).map(|_| random.random_range(-1.0..1.0)).sum::<f64>();
            rows.extend([change(row, motion), motion]);
        }
        let mut filler = Filler::new(FlatFinder::new(2, 50.0));
        let (mut out, mut part_out) = (Vec::new(), Vec::new());
        for part in rows.chunks(2 * 331) {
            filler.push(part, &mut part_out);
            out.extend_from_slice(&part_out);
        }
        let (last, _, flat) = filler.finish();
        out.extend(last);
        (out.into_iter().step_by(2).collect(), flat)
    }

    #[test]
    fn pieces_of_one_value_become_missing() {
        let is_held = |row: usize| row % 5000 >= 4003 && row % 5000 < 4703;
        let (out, flat) = of(|row, value| if is_held(row) { 7.0 } else { value });
        assert_eq!(flat, [Flat { first_row: 4003, pieces: 8, samples: 5600 }, Flat::default()]);
        assert!(out.iter().enumerate().all(|(row, value)| value.is_nan() == is_held(row)) && out.len() == ROWS);
        // A channel that begins late.
        let (_, flat) = of(|row, value| if row < 9001 { 0.0 } else { value });
        assert_eq!(flat[0], Flat { first_row: 0, pieces: 1, samples: 9001 });
    }

    #[test]
    fn quiet_channels_of_coarse_counts_and_dead_ones_do_not_hang() {
        for step in [0.5, 2.0, 5.0, 10.0] {
            // Lulls, in which the converter shows nothing.
            let lull = |row: usize| 0.5 + 0.5 * (row as f64 / 2000.0).sin();
            let (_, flat) = of(|row, value| (lull(row) * value / step).round() * step);
            assert_eq!(flat[0], Flat::default(), "{step}");
        }
        let (out, flat) = of(|_, _| 3.0);
        assert_eq!((flat[0], out.len()), (Flat::default(), ROWS));
        let (_, flat) = of(|_, _| f64::NAN);
        assert_eq!(flat[0], Flat::default());
    }
}
