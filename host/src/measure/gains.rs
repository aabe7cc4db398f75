//! Channels whose gain drifts over the record.
//!
//! Windows flow in; which channels' gains drift, and how far, flows out. In a narrow band few modes take part, so that a straight regression over
//! the whole record tells a channel's motion from that of the others. A channel whose own motion, beside that, grows or falls steadily from
//! the first part of the record to the last, alike in many bands, has a gain that drifts. Whatever the load does, all channels take part in it;
//! a mode that changes does so in its own bands.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::identify::Drift;
use crate::regression::slopes;
use crate::spectra::WindowLines;
use crate::statistics::median;

/// Parts of the record: there are between half of so many and so many.
const PARTS: usize = 32;
/// Windows that a part has at least.
const LEAST_WINDOWS: usize = 2;
/// Bands at most, lines that one has at least, and lines of it that are looked at, about.
const MOST_BANDS: usize = 48;
const LEAST_LINES: usize = 4;
const LINES: usize = 16;
/// Channels between which a drift can be told, at least, and that are looked at, at most.
const LEAST_CHANNELS: usize = 4;
const MOST_CHANNELS: usize = 48;
/// The others must tell so much of a channel's motion, in so many bands...
const TOLD: f64 = 0.8;
const LEAST_BANDS: usize = 3;
/// ...and its gain must change by so much (ln) from one end of the record to the other...
const LEAST_CHANGE: f64 = 0.1;
/// ...which is so many standard errors of a straight line through the parts.
const ERRORS: f64 = 8.0;
/// Channels that are tried in turn, how often the drift of one is measured anew, and what more of it (ln) is not worth another time.
const MOST_TRIED: usize = 4;
const MOST_ROUNDS: usize = 20;
const ENOUGH: f64 = 2e-3;
/// Errors (ln) below this are not believed.
const LEAST_ERROR: f64 = 5e-3;
/// A drift of one channel explains all as well as that of another where it leaves no more than so many times the other's squares, and so many more.
const AS_WELL: f64 = 3.0;
const AS_WELL_MORE: f64 = 20.0;
/// What the others tell is only as sure as so many times the mean power of a channel.
const RIDGE: f64 = 1e-6;
/// More channels than this share do not drift by chance: then it is not the channels.
const MOST_SHARE: f64 = 0.34;

/// A part of the record: sums of products of channels in each band, and windows in which both of two channels were sound.
#[derive(Debug, Clone)]
struct Part {
    products: Vec<f64>,
    sound: Vec<f64>,
    windows: usize,
}

impl Part {
    fn join(&mut self, other: &Self) {
        let both = self.products.iter_mut().zip(&other.products).chain(self.sound.iter_mut().zip(&other.sound));
        both.for_each(|(sum, other)| *sum += other);
        self.windows += other.windows;
    }
}

/// Watches the gains of a setup's channels.
#[derive(Debug)]
pub(super) struct Gains {
    channels: usize,
    lines: usize,
    bands: usize,
    /// Windows of a part.
    length: usize,
    parts: Vec<Part>,
}

impl Gains {
    /// For so many channels, in windows of so many lines.
    pub(super) fn new(channels: usize, lines: usize) -> Self {
        Self { channels, lines, bands: (lines / LEAST_LINES).clamp(1, MOST_BANDS), length: 1, parts: Vec::new() }
    }

    /// Takes a window.
    pub(super) fn push(&mut self, window: &WindowLines) {
        let count = self.channels;
        if !(LEAST_CHANNELS..=MOST_CHANNELS).contains(&count) || window.channels.len() != count {
            return;
        }
        if self.parts.last().is_none_or(|part| part.windows >= self.length) {
            if self.parts.len() == PARTS {
                let joined = self.parts.chunks(2).map(|pair| {
                    let mut sum = pair[0].clone();
                    pair[1..].iter().for_each(|other| sum.join(other));
                    sum
                });
                self.parts = joined.collect();
                self.length *= 2;
            }
            let (products, sound) = (vec![0.0; self.bands * count * count], vec![0.0; count * count]);
            self.parts.push(Part { products, sound, windows: 0 });
        }
        let Some(part) = self.parts.last_mut() else { return };
        part.windows += 1;
        let width = self.lines.div_ceil(self.bands).max(1);
        let step = width.div_ceil(LINES).max(1);
        for (first, one) in window.channels.iter().enumerate() {
            let Some(one) = one else { continue };
            for (second, other) in window.channels.iter().enumerate().take(first + 1) {
                let Some(other) = other else { continue };
                let at = first * count + second;
                part.sound[at] += 1.0;
                for (band, (one, other)) in one.chunks(width).zip(other.chunks(width)).enumerate().take(self.bands) {
                    let lines = one.iter().zip(other).step_by(step);
                    part.products[band * count * count + at] +=
                        lines.map(|(a, b)| f64::from(a.re * b.re + a.im * b.im)).sum::<f64>();
                }
            }
        }
    }

    /// The channels whose gains drift, of those that `are_used`, in their order.
    pub(super) fn finish(mut self, are_used: &[usize]) -> Vec<Drift> {
        // The last part may be a short one.
        if let [.., before, last] = self.parts.as_mut_slice()
            && last.windows < self.length
        {
            before.join(last);
            self.parts.pop();
        }
        if self.length < LEAST_WINDOWS || self.parts.len() < PARTS / 2 - 1 {
            return Vec::new();
        }
        let channels: Vec<usize> =
            are_used.iter().copied().filter(|&channel| channel < self.channels && self.is_there(channel)).collect();
        if channels.len() < LEAST_CHANNELS {
            return Vec::new();
        }
        Regressions::new(&self, channels).drifts()
    }

    /// Whether a channel is sound in half of all windows of each part.
    fn is_there(&self, channel: usize) -> bool {
        let at = channel * self.channels + channel;
        self.parts.iter().all(|part| 2.0 * part.sound[at] >= part.windows as f64)
    }

    /// Mean products of some channels in a part of a band.
    fn matrix(&self, part: &Part, band: usize, channels: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(channels.len(), channels.len(), |row, column| {
            let (first, second) = (channels[row].max(channels[column]), channels[row].min(channels[column]));
            let at = first * self.channels + second;
            part.products[band * self.channels * self.channels + at] / part.sound[at].max(1.0)
        })
    }
}

/// Drifts (ln) by channel.
type Known = BTreeMap<usize, f64>;
/// Gains (ln) of a channel, part by part.
type Told = (usize, Vec<f64>);

/// What channels tell of one another. Channels are numbered as they come.
struct Regressions {
    channels: Vec<usize>,
    /// By band and part.
    bands: Vec<Vec<DMatrix<f64>>>,
    /// How loud each part is (ln).
    levels: Vec<f64>,
}

impl Regressions {
    fn new(gains: &Gains, channels: Vec<usize>) -> Self {
        let of_band = |band| -> Option<Vec<DMatrix<f64>>> {
            let parts: Vec<DMatrix<f64>> = gains.parts.iter().map(|part| gains.matrix(part, band, &channels)).collect();
            // Channels of any unit count alike.
            let mean_power = |at: usize| parts.iter().map(|part| part[(at, at)]).sum::<f64>() / parts.len() as f64;
            let powers: Vec<f64> = (0..channels.len()).map(mean_power).collect();
            let alike = |part: &DMatrix<f64>| {
                DMatrix::from_fn(channels.len(), channels.len(), |row, column| {
                    part[(row, column)] / (powers[row] * powers[column]).sqrt()
                })
            };
            powers.iter().all(|power| power.is_normal()).then(|| parts.iter().map(alike).collect())
        };
        let bands: Vec<Vec<DMatrix<f64>>> = (0..gains.bands).filter_map(of_band).collect();
        let loud =
            |part: usize| bands.iter().map(|parts| parts[part].trace().ln()).sum::<f64>() / bands.len().max(1) as f64;
        let levels = (0..gains.parts.len()).map(loud).collect();
        Self { channels, bands, levels }
    }

    /// How much values change over all parts along a straight line, and the standard error of that. What goes with the level of the motion is taken
    /// off at the same time: noise makes channels that are known less well seem to fall as the motion does.
    fn line(&self, values: &[f64]) -> (f64, f64) {
        let count = values.len();
        let time = (0..count).map(|part| part as f64).collect();
        // Of their deviations nothing is known but how they scatter, which is more than this.
        let slope = slopes(values, &vec![1e-9; count], &[time, self.levels.clone()]);
        let slope = slope.and_then(|slopes| slopes.first().copied());
        slope.map_or((0.0, f64::INFINITY), |slope| (slope.value * count as f64, slope.std * count as f64))
    }

    fn drifts(&self) -> Vec<Drift> {
        let most = (MOST_SHARE * self.channels.len() as f64).max(1.0) as usize;
        let mut known = Known::new();
        let mut names: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for _ in 0..=most {
            let Some((channel, change, others)) = self.next(&known) else { break };
            known.insert(channel, change);
            names.insert(channel, others);
            // Beside one that drifts, others seem to drift the other way: each anew, with what is known of all.
            for channel in known.keys().copied().collect::<Vec<_>>() {
                match self.settled(&known, channel) {
                    Some(change) => known.insert(channel, change),
                    None => known.remove(&channel),
                };
            }
        }
        if known.len() > most {
            return Vec::new();
        }
        let drift = |(channel, change): (usize, f64)| {
            let others = names.get(&channel).into_iter().flatten().copied();
            let channels = std::iter::once(channel).chain(others).map(|at| self.channels[at]).collect();
            Drift { channels, change: change.exp_m1() }
        };
        known.into_iter().map(drift).collect()
    }

    /// The channel whose drift explains most of what is not known yet, how far it drifts, and other channels whose drift explains as much.
    fn next(&self, known: &Known) -> Option<(usize, f64, Vec<usize>)> {
        let told = self.told(known)?;
        let common = common(&told);
        let mut candidates: Vec<(usize, f64)> = Vec::new();
        for (channel, gains) in told.iter().filter(|(channel, _)| !known.contains_key(channel)) {
            let (change, error) = self.line(&beside(gains, &common));
            if change.abs() > 0.5 * LEAST_CHANGE && change.abs() > 0.5 * ERRORS * error {
                candidates.push((*channel, change));
            }
        }
        candidates.sort_by(|one, other| other.1.abs().total_cmp(&one.1.abs()));
        let tried = candidates.into_iter().take(MOST_TRIED).filter_map(|(channel, change)| {
            let mut with = known.clone();
            with.insert(channel, change);
            let change = self.settled(&with, channel)?;
            with.insert(channel, change);
            Some((self.misfit(&with)?, channel, change))
        });
        let mut tried: Vec<(f64, usize, f64)> = tried.collect();
        tried.sort_by(|one, other| one.0.total_cmp(&other.0));
        let &(least, channel, change) = tried.first()?;
        let as_well = tried[1..].iter().filter(|(misfit, ..)| *misfit < AS_WELL * least + AS_WELL_MORE);
        Some((channel, change, as_well.map(|(_, channel, _)| *channel).collect()))
    }

    /// How far a channel drifts, beginning from what is known, if it does. The regression believes a channel most where it moves most. So what is
    /// known of its drift is taken off, and the regression made again.
    fn settled(&self, known: &Known, channel: usize) -> Option<f64> {
        let mut known = known.clone();
        for _ in 0..MOST_ROUNDS {
            let told = self.told(&known)?;
            let (_, gains) = told.iter().find(|(other, _)| *other == channel)?;
            let (more, error) = self.line(&beside(gains, &common(&told)));
            let change = known.entry(channel).or_default();
            *change += more;
            if more.abs() < ENOUGH {
                return (change.abs() > LEAST_CHANGE && change.abs() > ERRORS * error).then_some(*change);
            }
        }
        None
    }

    /// Squares of what is left of drifts, in their standard errors.
    fn misfit(&self, known: &Known) -> Option<f64> {
        let told = self.told(known)?;
        let common = common(&told);
        let left = told.iter().map(|(_, gains)| {
            let (change, error) = self.line(&beside(gains, &common));
            (change / error.max(LEAST_ERROR)).powi(2)
        });
        Some(left.sum())
    }

    /// Of the channels that the others tell of, the gain in each part: what a channel shows beside what they tell, in the mean of bands, each of
    /// which counts as much as it scatters little. Drifts that are known are taken off their channels.
    fn told(&self, known: &Known) -> Option<Vec<Told>> {
        let count = self.channels.len();
        let mut sums: Vec<(usize, f64, Vec<f64>)> = vec![(0, 0.0, Vec::new()); count];
        for parts in &self.bands {
            let parts = without(parts, known);
            let whole = parts.iter().fold(DMatrix::zeros(count, count), |sum, part| sum + part) / parts.len() as f64;
            let power = whole.diagonal();
            let ridge = DMatrix::identity(count, count) * RIDGE;
            let Some(inverse) = (whole + ridge).cholesky().map(|factors| factors.inverse()) else { continue };
            for (at, (bands, weight, sum)) in sums.iter_mut().enumerate() {
                // The regression on the others, and what it leaves, stand in the inverse (Whittaker 1990, section 5.8).
                if 1.0 - 1.0 / (power[at] * inverse[(at, at)]) < TOLD {
                    continue;
                }
                let mut weights: DVector<f64> = -inverse.column(at) / inverse[(at, at)];
                weights[at] = 0.0;
                let gain = |part: &DMatrix<f64>| {
                    let expected = part * &weights;
                    (expected[at] / weights.dot(&expected)).ln()
                };
                let gains: Vec<f64> = parts.iter().map(gain).collect();
                if !gains.iter().all(|gain| gain.is_finite()) {
                    continue;
                }
                let steps: f64 = gains.iter().zip(&gains[1..]).map(|(one, next)| (next - one).powi(2)).sum();
                let scatter = (0.5 * steps / (gains.len() - 1) as f64).max(1e-6);
                let mean = gains.iter().sum::<f64>() / gains.len() as f64;
                sum.resize(gains.len(), 0.0);
                sum.iter_mut().zip(gains).for_each(|(sum, gain)| *sum += (gain - mean) / scatter);
                *weight += 1.0 / scatter;
                *bands += 1;
            }
        }
        let told: Vec<Told> = sums
            .into_iter()
            .enumerate()
            .filter(|(_, (bands, ..))| *bands >= LEAST_BANDS)
            .map(|(at, (_, weight, sum))| (at, sum.into_iter().map(|sum| sum / weight).collect()))
            .collect();
        (told.len() >= LEAST_CHANNELS - 1).then_some(told)
    }
}

/// The parts without drifts that are known.
fn without(parts: &[DMatrix<f64>], known: &Known) -> Vec<DMatrix<f64>> {
    let count = parts.len().max(1) as f64;
    let without = |(number, part): (usize, &DMatrix<f64>)| {
        let mut part = part.clone();
        for (&at, change) in known {
            let gain = (change * ((number as f64 + 0.5) / count - 0.5)).exp();
            part.row_mut(at).scale_mut(1.0 / gain);
            part.column_mut(at).scale_mut(1.0 / gain);
        }
        part
    };
    parts.iter().enumerate().map(without).collect()
}

/// What the gains of all channels have in common, part by part: in a calm one noise makes what the others tell too large.
fn common(told: &[Told]) -> Vec<f64> {
    let parts = told.first().map_or(0, |(_, gains)| gains.len());
    let of_part = |part: usize| {
        let mut gains: Vec<f64> = told.iter().map(|(_, gains)| gains[part]).collect();
        median(&mut gains).unwrap_or(0.0)
    };
    (0..parts).map(of_part).collect()
}

/// Gains (ln) beside what they have in common with others.
fn beside(gains: &[f64], common: &[f64]) -> Vec<f64> {
    gains.iter().zip(common).map(|(gain, common)| gain - common).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex32;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const CHANNELS: usize = 7;
    const WINDOWS: usize = 400;

    /// Windows of a structure of three modes whose loads come and go, each on its own; each channel has noise of its own, and `gain` by channel
    /// and share of the record.
    fn drifts(seed: u64, gain: impl Fn(usize, f64) -> f64) -> Vec<Drift> {
        drifts_in(seed, |mode, share| if mode == 1 { 1.5 * share } else { 0.0 }, |_| 0.1, gain)
    }

    /// The same with loads (ln) by mode and share of the record, and noise by channel.
    fn drifts_in(
        seed: u64,
        load: impl Fn(usize, f64) -> f64,
        noise_of: impl Fn(usize) -> f64,
        gain: impl Fn(usize, f64) -> f64,
    ) -> Vec<Drift> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let shape = |mode: usize, channel: usize| ((mode + 1) as f64 * (channel + 1) as f64 * 0.4).sin();
        let mut gains = Gains::new(CHANNELS, 40);
        let (mut levels, lines) = ([0.0_f64; 3], 40);
        for window in 0..WINDOWS {
            let share = window as f64 / (WINDOWS - 1) as f64;
            // Each mode's load wanders by a factor of e, up and down, and one grows steadily.
            levels.iter_mut().for_each(|level| *level = 0.9 * *level + 0.4 * normal());
            let mut channels = vec![vec![Complex32::default(); lines]; CHANNELS];
            for line in 0..lines {
                let modes: [Complex32; 3] = std::array::from_fn(|mode| {
                    let level = (levels[mode] + load(mode, share)).exp();
                    Complex32::new((level * normal()) as f32, (level * normal()) as f32)
                });
                for (channel, lines) in channels.iter_mut().enumerate() {
                    let motion: Complex32 =
                        modes.iter().enumerate().map(|(mode, at)| at * shape(mode, channel) as f32).sum();
                    let noise =
                        Complex32::new((noise_of(channel) * normal()) as f32, (noise_of(channel) * normal()) as f32);
                    lines[line] = (motion + noise) * gain(channel, share) as f32;
                }
            }
            gains.push(&WindowLines { grid_index: window as u64, channels: channels.into_iter().map(Some).collect() });
        }
        gains.finish(&(0..CHANNELS).collect::<Vec<_>>())
    }

    #[test]
    fn a_gain_that_drifts_is_found_with_its_change_and_loads_that_wander_are_none() {
        for seed in 1..6 {
            assert_eq!(drifts(seed, |_, _| 1.0), []);
            // Channels that always read too much or too little do not drift.
            assert_eq!(drifts(seed, |channel, _| 1.0 + channel as f64), []);
            for change in [0.3, -0.25] {
                let found = drifts(seed, |channel, share| if channel == 2 { 1.0 + change * share } else { 1.0 });
                assert_eq!(found.iter().map(|drift| &drift.channels[..]).collect::<Vec<_>>(), [&[2]], "{found:?}");
                assert!((found[0].change - change).abs() < 0.05, "{change}: {found:?}");
            }
        }
        let two = |channel: usize, share: f64| match channel {
            1 => 1.0 + 0.4 * share,
            5 => 1.0 - 0.3 * share,
            _ => 1.0,
        };
        assert_eq!(drifts(9, two).iter().map(|drift| drift.channels[0]).collect::<Vec<_>>(), [1, 5]);
    }

    #[test]
    fn a_storm_that_fades_is_no_drift_of_noisy_channels() {
        let noise = |channel: usize| if channel.is_multiple_of(3) { 0.3 } else { 0.02 };
        for seed in 1..6 {
            assert_eq!(drifts_in(seed, |_, share| 1.15 - 2.3 * share, noise, |_, _| 1.0), [], "seed {seed}");
        }
    }

    #[test]
    fn of_two_channels_that_only_tell_of_each_other_both_are_named() {
        // The last two stand together at a place where the others do not move: nobody tells which of them drifts.
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let mut gains = Gains::new(6, 40);
        for window in 0..WINDOWS {
            let gain = 1.0 + 0.4 * window as f64 / WINDOWS as f64;
            let mut channels = vec![Vec::new(); 6];
            for _ in 0..40 {
                let motions = [(); 2].map(|()| Complex32::new(normal() as f32, normal() as f32));
                for (channel, lines) in channels.iter_mut().enumerate() {
                    let noise = Complex32::new(0.05 * normal() as f32, 0.05 * normal() as f32);
                    let motion = motions[usize::from(channel > 3)] + noise;
                    lines.push(motion * if channel == 4 { gain as f32 } else { 1.0 });
                }
            }
            gains.push(&WindowLines { grid_index: window as u64, channels: channels.into_iter().map(Some).collect() });
        }
        let found = gains.finish(&[0, 1, 2, 3, 4, 5]);
        assert_eq!(found.len(), 1, "{found:?}");
        let mut named = found[0].channels.clone();
        named.sort_unstable();
        assert_eq!(named, [4, 5]);
        assert!((found[0].change.abs() - 0.35).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn all_at_once_and_few_windows_tell_nothing() {
        assert_eq!(drifts(3, |_, share| 1.0 + share), [], "that is the load, or the recorder");
        let mut gains = Gains::new(CHANNELS, 40);
        gains.push(&WindowLines { grid_index: 0, channels: vec![None; CHANNELS] });
        assert_eq!(gains.finish(&[0, 1, 2, 3]), []);
        assert_eq!(Gains::new(2, 40).finish(&[0, 1]), []);
    }
}
