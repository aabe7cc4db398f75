//! Channels that are cut off: the sensor or the recorder reaches the end of its range.
//!
//! Rows flow in; which channels were cut off, how often and since when, flows out. The largest values of a signal that is not cut
//! off are rarer than those a little smaller; where it is cut off, one value stands there again and again.

use crate::processor::{OnChannels, by_channels, loaded, on_this_processor, store, whole_rows};

/// Visits of a channel's end that make it cut off...
const LEAST_VISITS: u64 = 10;
/// ...where they are this many times those of the next value. A sensor that is switched off for a minute stays at one value, which is
/// one visit.
const MORE_THAN_NEXT: u64 = 5;

/// Of a channel's samples, those that may be cut off: what more is missing of its motion shows in shapes.
pub(super) const MOST_CUT_OFF: f64 = 2e-3;

/// What was cut off in one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct CutOff {
    /// Samples at either end of the range.
    pub(super) samples: u64,
    /// The first of them: the recording's row, from 0.
    pub(super) first_row: u64,
    /// The end of the range, as the recording has it.
    pub(super) limit: f64,
    /// Their share of the channel's samples.
    pub(super) share: f64,
}

/// One end of a channel's range.
#[derive(Debug, Clone, Copy)]
struct End {
    /// The outermost value so far (its negative, at the lower end): its samples, how often the channel came to it, and its first row.
    value: f64,
    samples: u64,
    visits: u64,
    first_row: u64,
    /// The next value, and how often the channel came to that.
    next: f64,
    next_visits: u64,
}

impl End {
    const NONE: Self =
        Self { value: f64::NEG_INFINITY, samples: 0, visits: 0, first_row: 0, next: f64::NEG_INFINITY, next_visits: 0 };

    fn take(&mut self, value: f64, before: f64, row: u64) {
        if value < self.next {
            return;
        }
        let visit = u64::from(value != before);
        if value > self.value {
            (self.next, self.next_visits) = (self.value, self.visits);
            (self.value, self.samples, self.visits, self.first_row) = (value, 1, 1, row);
        } else if value == self.value {
            self.samples += 1;
            self.visits += visit;
        } else if value > self.next {
            (self.next, self.next_visits) = (value, 1);
        } else if value == self.next {
            self.next_visits += visit;
        }
    }

    fn is_cut_off(&self) -> bool {
        self.visits >= LEAST_VISITS && self.visits > MORE_THAN_NEXT * self.next_visits && self.next.is_finite()
    }
}

/// Watches the ends of all channels' ranges.
pub(super) struct Limits {
    ends: Vec<[End; 2]>,
    /// The next value of each end, from where on samples matter, upper and lower.
    from: [Vec<f64>; 2],
    samples: Vec<u64>,
    before: Vec<f64>,
    rows: u64,
}

impl Limits {
    pub(super) fn new(channels: usize) -> Self {
        Self {
            ends: vec![[End::NONE; 2]; channels],
            from: [vec![f64::NEG_INFINITY; channels], vec![f64::INFINITY; channels]],
            samples: vec![0; channels],
            before: vec![f64::NAN; channels],
            rows: 0,
        }
    }

    /// Takes rows, row-major, NaN where a sample is missing.
    pub(super) fn push(&mut self, rows: &[f64]) {
        let channels = self.ends.len();
        let rows = whole_rows(rows, channels);
        on_this_processor(
            #[inline(always)]
            |_| {
                let mut at = 0;
                while at < rows.len() {
                    if self.matters(&rows[at..at + channels]) {
                        self.take(rows, at);
                    }
                    self.rows += 1;
                    at += channels;
                }
            },
        );
        if let Some(last) = rows.len().checked_sub(channels) {
            self.before.copy_from_slice(&rows[last..]);
        }
    }

    /// Rows that were taken.
    pub(super) fn rows(&self) -> u64 {
        self.rows
    }

    /// Whether a channel is near an end; counts what is there.
    #[inline(always)]
    fn matters(&mut self, row: &[f64]) -> bool {
        let [upper, lower] = &self.from;
        let mut look = Look { row, upper, lower, samples: &mut self.samples, near: 0 };
        by_channels(row.len(), &mut look);
        look.near != 0
    }

    /// Takes the row that begins at `at`, in which a channel is near an end.
    #[cold]
    fn take(&mut self, rows: &[f64], at: usize) {
        let channels = self.ends.len();
        let before = if at == 0 { &self.before } else { &rows[at - channels..at] };
        let [upper, lower] = &mut self.from;
        let each = self.ends.iter_mut().zip(before).zip(&rows[at..]).zip(upper.iter_mut().zip(lower));
        for (((ends, &before), &value), (upper, lower)) in each {
            ends[0].take(value, before, self.rows);
            ends[1].take(-value, -before, self.rows);
            (*upper, *lower) = (ends[0].next, -ends[1].next);
        }
    }

    /// What was cut off, channel by channel.
    pub(super) fn finish(self) -> Vec<CutOff> {
        let of = |(ends, samples): (&[End; 2], &u64)| {
            let cut: Vec<(f64, &End)> = [1.0, -1.0].into_iter().zip(ends).filter(|(_, end)| end.is_cut_off()).collect();
            let Some((sign, first)) = cut.iter().min_by_key(|(_, end)| end.first_row) else { return CutOff::default() };
            let count = cut.iter().map(|(_, end)| end.samples).sum();
            let share = count as f64 / (*samples).max(1) as f64;
            CutOff { samples: count, first_row: first.first_row, limit: sign * first.value, share }
        };
        self.ends.iter().zip(&self.samples).map(of).collect()
    }
}

/// What [`Limits::matters`] does.
struct Look<'a> {
    row: &'a [f64],
    upper: &'a [f64],
    lower: &'a [f64],
    samples: &'a mut [u64],
    /// Other than 0 where any is near its end; as wide as a sample.
    near: u64,
}

impl OnChannels for Look<'_> {
    #[inline(always)]
    fn take<const WIDTH: usize>(&mut self, first: usize) {
        let row = loaded::<f64, WIDTH>(self.row, first);
        let (upper, lower) = (loaded::<f64, WIDTH>(self.upper, first), loaded::<f64, WIDTH>(self.lower, first));
        let mut samples = loaded::<u64, WIDTH>(self.samples, first);
        for lane in 0..WIDTH {
            self.near |= u64::from((row[lane] >= upper[lane]) | (row[lane] <= lower[lane]));
            samples[lane] += u64::from(row[lane].is_finite());
        }
        store(self.samples, first, &samples);
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A channel of noise like a structure's, changed by `change`.
    fn of(change: impl Fn(f64) -> f64) -> CutOff {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut motion = 0.0;
        let mut limits = Limits::new(1);
        for _ in 0..50_000 {
            motion = 0.9 * motion + (0..6).map(|_| random.random_range(-1.0..1.0)).sum::<f64>();
            limits.push(&[change(motion)]);
        }
        limits.finish()[0]
    }

    #[test]
    fn a_channel_is_cut_off_where_one_value_stands_at_its_end() {
        assert_eq!(of(|value| value).samples, 0);
        let both = of(|value| value.clamp(-6.0, 6.0));
        assert!(both.samples > 100 && both.limit.abs() == 6.0 && both.share > 0.01, "{both:?}");
        let below = of(|value| value.max(-7.0));
        assert!(below.samples > 100 && below.limit == -7.0, "{below:?}");
        let counts = of(|value| (10.0 * value.clamp(-6.0, 6.0)).round());
        assert!(counts.samples > 100 && counts.limit.abs() == 60.0, "{counts:?}");
    }

    #[test]
    fn coarse_counts_dead_channels_and_missing_samples_are_not_cut_off() {
        for step in [0.5, 2.0, 5.0, 8.0] {
            assert_eq!(of(|value| (value / step).round() * step).samples, 0, "{step}");
        }
        assert_eq!(of(|_| 3.0).samples, 0);
        let rows = std::cell::Cell::new(0);
        let switched_off = of(|value| {
            rows.set(rows.get() + 1);
            if (20_000..23_000).contains(&rows.get()) { -50.0 } else { value }
        });
        assert_eq!(switched_off.samples, 0, "{switched_off:?}");
        assert_eq!(of(|_| f64::NAN).samples, 0);
    }

    #[test]
    fn many_channels_are_cut_off_as_each_alone() {
        const CHANNELS: usize = 21;
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut motion = [0.0; CHANNELS];
        let mut rows = Vec::new();
        for row in 0..20_000 {
            for (channel, motion) in motion.iter_mut().enumerate() {
                *motion = 0.9 * *motion + (0..6).map(|_| random.random_range(-1.0..1.0)).sum::<f64>();
                let limit = 5.0 + 0.2 * channel as f64;
                let value = match channel % 4 {
                    0 => *motion,
                    1 => motion.min(limit),
                    2 => motion.max(-limit),
                    _ => motion.clamp(-limit, limit),
                };
                let is_missing = (row + 31 * channel) % 97 < channel % 5;
                rows.push(if is_missing { f64::NAN } else { value });
            }
        }
        let mut limits = Limits::new(CHANNELS);
        rows.chunks(700 * CHANNELS).for_each(|part| limits.push(part));
        for (channel, together) in limits.finish().into_iter().enumerate() {
            let samples: Vec<f64> = rows.iter().skip(channel).step_by(CHANNELS).copied().collect();
            let mut alone = Limits::new(1);
            alone.push(&samples);
            assert_eq!(alone.finish(), [together], "channel {channel}");
            assert_eq!(together.samples > 0, channel % 4 != 0, "channel {channel}: {together:?}");
        }
    }
}
