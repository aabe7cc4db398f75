//! Places where all channels jump at once: where rows are missing, or parts are joined that do not continue one another.
//!
//! Rows flow in, what was found flows out. A recorder's filter leaves next to nothing just below half of the sampling rate, and a
//! jump is as strong there as anywhere. So the part of all channels there is looked at, a window of rows after the other. Where it is
//! suddenly far above what is usual in most channels, and as usual again on both sides of one row, something happened between two
//! rows. No structure does that, but for a hard blow that the recorder's filter lets through.

use std::collections::VecDeque;

use super::ring::Rows;
use crate::processor::{Arithmetic, on_this_processor, weighted_sum};
use crate::statistics::{MEDIAN_OF_ABSOLUTE, median};

/// Rows of a window, and from one to the next. The window (three terms, Harris 1978, table 1: side lobes of -71 dB) passes what lies
/// above 0.45 of the sampling rate.
const WINDOW: usize = 64;
const HOP: usize = 8;
const TERMS: [f64; 3] = [0.423_23, -0.497_55, 0.079_22];
/// Windows that the usual power is learnt from at first, and over which it is averaged later; a single one counts as no more than
/// this many times the mean.
const LEARNT: usize = 64;
const MEMORY: f64 = 512.0;
const MOST: f64 = 9.0;
/// Mean of the channels' powers, over the usual one, that begins an event, with this much in at least half of the channels.
const HOT: f64 = 20.0;
const HOT_CHANNEL: f64 = 6.0;
/// What counts as usual.
const CALM: f64 = 5.0;
/// Windows of an event, at most: those that one row is in.
const LONGEST: usize = WINDOW / HOP + 1;
/// Rows that are kept to look at an event.
const KEPT: usize = 2 * WINDOW + 2 * (LONGEST + 2) * HOP;
/// Fewer places may be chance: so many, and this share of all windows. Where the channels have their noise in common, a window is hot
/// by chance once in 100 000.
const LEAST_PLACES: f64 = 5.0;
const CHANCE_A_WINDOW: f64 = 5e-5;
/// Places that are kept to tell whether they come at one distance: so many; of the distances from one to the next so many at least, and
/// this share, are whole multiples of it, within rows of this number, which are at most the last share of it.
const PLACES_KEPT: usize = 4096;
const LEAST_AT_ONE: f64 = 4.0;
const AT_ONE_DISTANCE: f64 = 0.6;
const NEAR: f64 = 2.0 * HOP as f64;
const NEAR_SHARE: f64 = 0.02;
/// Many places make every candidate dear; the first of them will do.
const CANDIDATES: usize = 64;
/// Found places may all be several times the distance apart.
const MOST_BETWEEN: usize = 3;
/// Fewer channels cannot tell what happens to all of them.
const LEAST_CHANNELS: f64 = 3.0;

/// Where all channels jump.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Jumps {
    /// At how many places, of which not all are found; 0 where too few were.
    pub(super) places: u64,
    /// The first: about the recording's row, from 0, before which it lies.
    pub(super) first_row: u64,
    /// The number of rows from one to the next, or to one of the next, where that is always the same.
    pub(super) every: Option<u64>,
}

/// Looks for jumps of all channels.
pub(super) struct JumpFinder {
    rows: Rows,
    window: Vec<f64>,
    /// Where the next window begins.
    next: u64,
    windows: u64,
    /// Powers of the first windows in which something is, channel by channel.
    learnt: Vec<Vec<f64>>,
    /// The usual power of each channel; NaN while it is learnt.
    usual: Vec<f64>,
    /// First window of an event and the one after its last, while it goes on.
    event: Option<[u64; 2]>,
    /// Events whose rows have not all come yet.
    ended: VecDeque<[u64; 2]>,
    found: Jumps,
    /// The rows of the places.
    places: Vec<u64>,
}

impl JumpFinder {
    pub(super) fn new(channels: usize) -> Self {
        let term = |row: usize, order: usize| {
            let turn = std::f64::consts::TAU * order as f64 * row as f64 / (WINDOW - 1) as f64;
            TERMS[order] * turn.cos()
        };
        let at = |row: usize| {
            let weight: f64 = (0..TERMS.len()).map(|order| term(row, order)).sum();
            if row.is_multiple_of(2) { weight } else { -weight }
        };
        let window: Vec<f64> = (0..WINDOW).map(at).collect();
        let power: f64 = window.iter().map(|weight| weight * weight).sum();
        Self {
            rows: Rows::new(channels, KEPT),
            window: window.iter().map(|weight| weight / power.sqrt()).collect(),
            next: 0,
            windows: 0,
            learnt: vec![Vec::new(); channels],
            usual: vec![f64::NAN; channels],
            event: None,
            ended: VecDeque::new(),
            found: Jumps::default(),
            places: Vec::new(),
        }
    }

    /// Takes rows, row-major, NaN where a sample is missing.
    pub(super) fn push(&mut self, rows: &[f64]) {
        self.rows.push(rows);
        on_this_processor(
            #[inline(always)]
            |arithmetic| {
                while self.rows.end() >= self.next + WINDOW as u64 {
                    self.take_window(arithmetic);
                    self.next += HOP as u64;
                }
            },
        );
    }

    /// What was found.
    pub(super) fn finish(self) -> Jumps {
        let least = LEAST_PLACES + CHANCE_A_WINDOW * self.windows as f64;
        if (self.found.places as f64) < least {
            return Jumps::default();
        }
        Jumps { every: every(&self.places), ..self.found }
    }

    #[inline(always)]
    fn take_window(&mut self, arithmetic: Arithmetic) {
        self.windows += 1;
        let parts = self.parts(self.next, arithmetic);
        let [power, many] = self.power(&parts);
        let end = self.next + HOP as u64;
        self.event = match (self.event, power > HOT && many >= 0.5) {
            (None, true) => Some([self.next, end]),
            (Some([first, _]), true) => Some([first, end]),
            (event, false) => {
                self.ended.extend(event);
                None
            }
        };
        // The rows after it are wanted too.
        while let Some(&event) = self.ended.front()
            && event[0] + WINDOW as u64 <= self.next
        {
            self.ended.pop_front();
            self.look_at(event);
        }
        self.learn(&parts);
    }

    fn learn(&mut self, parts: &[f64]) {
        for ((usual, learnt), part) in self.usual.iter_mut().zip(&mut self.learnt).zip(parts) {
            let square = part * part;
            if !usual.is_nan() {
                if square.is_finite() {
                    *usual += (square.min(MOST * *usual) - *usual) / MEMORY;
                }
            } else if square.is_finite() && square > 0.0 {
                learnt.push(square);
                if learnt.len() == LEARNT {
                    // The median of squares is the square of the median of magnitudes.
                    *usual = median(learnt).unwrap_or(f64::NAN) / (MEDIAN_OF_ABSOLUTE * MEDIAN_OF_ABSOLUTE);
                }
            }
        }
    }

    /// What each channel has just below half of the sampling rate in the window from a row on.
    #[inline(always)]
    fn parts(&self, first: u64, arithmetic: Arithmetic) -> Vec<f64> {
        let mut parts = vec![0.0; self.rows.channels()];
        weighted_sum(arithmetic, &self.window, self.rows.from(first), &mut parts);
        parts
    }

    /// The mean of the channels' powers over what is usual, and the share of channels with much more than that.
    fn power(&self, parts: &[f64]) -> [f64; 2] {
        let (mut sum, mut many, mut channels) = (0.0, 0.0, 0.0);
        for (part, usual) in parts.iter().zip(&self.usual) {
            let power = part * part / usual;
            if power.is_finite() {
                sum += power;
                many += f64::from(u8::from(power > HOT_CHANNEL));
                channels += 1.0;
            }
        }
        if channels >= LEAST_CHANNELS { [sum / channels, many / channels] } else { [0.0, 0.0] }
    }

    /// Counts an event, whose windows begin at the rows from `first` to before `end`, where it is a jump.
    #[cold]
    fn look_at(&mut self, [first, end]: [u64; 2]) {
        if end - first > (LONGEST * HOP) as u64 {
            return;
        }
        // The row after the jump is in all hot windows, and neither side has anything of it.
        let parts = |row: u64| {
            on_this_processor(
                #[inline(always)]
                |arithmetic| self.parts(row, arithmetic),
            )
        };
        let power_from = |row: u64| self.power(&parts(row))[0];
        let sides = |row: &u64| power_from(row - WINDOW as u64).max(power_from(*row));
        let from = end.saturating_sub(HOP as u64).max(self.rows.start() + WINDOW as u64);
        let to = (first + WINDOW as u64).min(self.rows.end() - WINDOW as u64);
        let calmest = (from..=to).map(|row| (sides(&row), row)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, row)) = calmest.filter(|(power, _)| *power < CALM) {
            if self.found.places == 0 {
                self.found.first_row = row;
            }
            self.found.places += 1;
            if self.places.len() < PLACES_KEPT {
                self.places.push(row);
            }
        }
    }
}

/// The distance that places come at, of which some are not found, and some may be others.
fn every(places: &[u64]) -> Option<u64> {
    let gaps: Vec<f64> = places.windows(2).map(|pair| pair[1].saturating_sub(pair[0]) as f64).collect();
    let whole = |distance: f64| {
        let fits = move |gap: &&f64| {
            let times = (*gap / distance).round();
            times >= 1.0 && (*gap - times * distance).abs() <= NEAR
        };
        gaps.iter().filter(fits)
    };
    let candidates =
        gaps.iter().take(CANDIDATES).flat_map(|gap| (1..=MOST_BETWEEN).map(move |parts| gap / parts as f64));
    let least = LEAST_AT_ONE.max(AT_ONE_DISTANCE * gaps.len() as f64);
    let is_one = |distance: &f64| NEAR <= NEAR_SHARE * distance && whole(*distance).count() as f64 >= least;
    let distance = candidates.filter(is_one).max_by(f64::total_cmp)?;
    // Places far apart tell it best.
    let first = &places[..places.len().min(CANDIDATES)];
    let pairs = first
        .iter()
        .enumerate()
        .flat_map(|(at, one)| first[at + 1..].iter().map(move |other| other.saturating_sub(*one)));
    let times = |apart: f64| (apart / distance).round();
    let apart: Vec<f64> = pairs.map(|rows| rows as f64).filter(|apart| times(*apart) >= 1.0).collect();
    let most = apart.iter().copied().map(times).fold(0.0, f64::max);
    let mut of_each: Vec<f64> =
        apart.into_iter().filter(|apart| 2.0 * times(*apart) >= most).map(|apart| apart / times(apart)).collect();
    median(&mut of_each).map(|distance| distance.round() as u64)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const CHANNELS: usize = 5;

    /// Motions below 0.4 of the sampling rate, and a little noise.
    struct Motion {
        tones: Vec<[f64; 2]>,
        noise: f64,
        random: ChaCha8Rng,
    }

    impl Motion {
        fn new(seed: u64) -> Self {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let tones = (0..40).map(|_| [random.random_range(0.01..0.4), random.random_range(-3.0..3.0)]).collect();
            Self { tones, noise: 0.02, random }
        }

        fn row(&mut self, row: f64) -> Vec<f64> {
            let tone = |channel: usize, index: usize, [frequency, phase]: [f64; 2]| {
                let amplitude = 0.2 * (1.0 + ((channel * 7 + index * 3) % 5) as f64);
                amplitude * (std::f64::consts::TAU * frequency * row + phase).sin()
            };
            (0..CHANNELS)
                .map(|channel| {
                    let sum: f64 =
                        self.tones.iter().enumerate().map(|(index, tone_of)| tone(channel, index, *tone_of)).sum();
                    sum + self.noise * self.random.random_range(-1.7..1.7)
                })
                .collect()
        }
    }

    fn found(rows: impl Iterator<Item = Vec<f64>>) -> Jumps {
        let mut finder = JumpFinder::new(CHANNELS);
        let flat: Vec<f64> = rows.flatten().collect();
        flat.chunks(700 * CHANNELS).for_each(|part| finder.push(part));
        finder.finish()
    }

    #[test]
    fn a_sound_recording_has_no_jumps_however_loud_it_gets() {
        let mut motion = Motion::new(1);
        assert_eq!(found((0..20_000).map(|row| motion.row(f64::from(row)))), Jumps::default());
        // A gust with more noise in it, and blows that ring.
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let loud = found((0..40_000).map(|row| {
            let gust = if (8000..12_000).contains(&row) { 6.0 } else { 1.0 };
            let ring = if row > 1000 { 3.0 * (-f64::from(row % 1000) / 60.0).exp() } else { 0.0 };
            let mut values = motion.row(f64::from(row));
            for value in &mut values {
                *value = gust * (*value + ring * random.random_range(-1.0..1.0));
            }
            values
        }));
        assert_eq!(loud, Jumps::default());
    }

    #[test]
    fn noise_that_all_channels_share_has_no_jumps() {
        let mut random = ChaCha8Rng::seed_from_u64(9);
        let mut finder = JumpFinder::new(CHANNELS);
        for _ in 0..2_000_000 {
            let value: f64 = (0..4).map(|_| random.random_range(-1.0..1.0)).sum();
            finder.push(&[value; CHANNELS]);
        }
        assert_eq!(finder.finish(), Jumps::default());
    }

    #[test]
    fn places_where_rows_are_missing_are_found() {
        let mut motion = Motion::new(3);
        let gone = [5003, 7777, 9000, 9001, 12_345, 15_000, 17_171];
        let jumps = found((0..20_000).filter(|row| !gone.contains(row)).map(|row| motion.row(f64::from(row))));
        assert!((5..=6).contains(&jumps.places), "{jumps:?}");
        assert!(jumps.first_row.abs_diff(5003) <= HOP as u64 && jumps.every.is_none(), "{jumps:?}");
    }

    #[test]
    fn parts_that_are_joined_are_found_and_a_single_jump_is_no_news() {
        let mut motion = Motion::new(4);
        let jumps = found((0..20_000).map(|row| motion.row(f64::from(row) + 1234.5 * f64::from(row / 2048))));
        assert!(jumps.places >= 8, "{jumps:?}");
        assert!(jumps.first_row.abs_diff(2048) <= HOP as u64, "{jumps:?}");
        assert!(jumps.every.is_some_and(|every| every.abs_diff(2048) <= 2), "{jumps:?}");
        let once = found((0..20_000).map(|row| motion.row(f64::from(row) + 1234.5 * f64::from(row / 12_048))));
        assert_eq!(once, Jumps::default());
    }

    #[test]
    fn dead_channels_and_missing_samples_disturb_nothing() {
        let mut motion = Motion::new(5);
        let rows = (0..20_000).filter(|row| row % 3000 != 2999).map(|row| {
            let mut values = motion.row(f64::from(row));
            values[1] = 0.0;
            if row > 10_000 && row < 11_000 {
                values[2] = f64::NAN;
            }
            values
        });
        let jumps = found(rows);
        assert!(jumps.places >= 5, "{jumps:?}");
        // Rows that are known to be missing, in a recording that begins late.
        let empty = |row: i32| row < 2000 || row % 1500 == 1499;
        let rows =
            (0..20_000).map(|row| if empty(row) { vec![f64::NAN; CHANNELS] } else { motion.row(f64::from(row)) });
        assert_eq!(found(rows), Jumps::default());
        let late = (0..20_000).filter(|row| row % 2500 != 2499);
        let rows = late.map(|row| if row < 2000 { vec![0.0; CHANNELS] } else { motion.row(f64::from(row)) });
        assert!(found(rows).places >= 5);
        assert_eq!(found(std::iter::empty()), Jumps::default());
        assert_eq!(found(std::iter::repeat_n(vec![0.0; CHANNELS], 5000)), Jumps::default());
    }

    #[test]
    fn many_channels_are_learnt_as_each_alone_and_jump_as_few_do() {
        const MANY: usize = 21;
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let finder_of = |channels: usize, rows: &[f64]| {
            let mut finder = JumpFinder::new(channels);
            rows.chunks(700 * channels).for_each(|part| finder.push(part));
            finder
        };
        // Noise of another size in each channel; some miss samples.
        let rows: Vec<f64> = (0..4000 * MANY)
            .map(|at| {
                let (row, channel) = (at / MANY, at % MANY);
                let is_missing = channel % 3 == 1 && (row + 50 * channel) % 500 == 7;
                if is_missing { f64::NAN } else { (1 + channel) as f64 * random.random_range(-1.0..1.0) }
            })
            .collect();
        for (channel, usual) in finder_of(MANY, &rows).usual.into_iter().enumerate() {
            let samples: Vec<f64> = rows.iter().skip(channel).step_by(MANY).copied().collect();
            let alone = finder_of(1, &samples).usual[0];
            // The order of additions is another.
            assert!((usual / alone - 1.0).abs() < 1e-9, "channel {channel}: {usual} {alone}");
        }
        // Each of three channels seven times.
        let mut motion = Motion::new(7);
        let rows: Vec<Vec<f64>> =
            (0..20_000).filter(|row| row % 1500 != 1499).map(|row| motion.row(f64::from(row))).collect();
        let jumps = |channels: usize| {
            let flat: Vec<f64> = rows.iter().flat_map(|row| (0..channels).map(|channel| row[channel % 3])).collect();
            finder_of(channels, &flat).finish()
        };
        assert!(jumps(3).places > 5, "{:?}", jumps(3));
        assert_eq!(jumps(MANY), jumps(3));
    }

    #[test]
    fn places_at_one_distance_are_told_from_others() {
        // Some are not found, and one is another.
        let places = [9003, 27_000, 36_001, 62_996, 71_431, 71_999, 81_002, 90_000, 98_998, 117_001, 126_000, 134_999];
        assert!(every(&places).is_some_and(|every| every.abs_diff(9000) <= 2));
        assert_eq!(every(&[5003, 7777, 9000, 12_345, 15_000, 17_171]), None);
        assert_eq!(every(&[]), None);
    }
}
