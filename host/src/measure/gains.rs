//! Channels whose gain drifts over the record.
//!
//! Windows flow in; which channels' gains drift, and how far, flows out. What the other channels tell of a channel's motion is a straight
//! regression over the whole record. A channel whose own motion, beside that, grows or falls steadily from the first part of the record to the
//! last has a gain that drifts. Whatever the load does, all channels take part in it.

use nalgebra::{DMatrix, DVector};

use crate::spectra::WindowLines;
use crate::statistics::median;

/// Parts of the record: there are between half of so many and so many.
const PARTS: usize = 32;
/// Windows that a part has at least.
const LEAST_WINDOWS: usize = 2;
/// Lines of a window that are looked at, at most.
const MOST_LINES: usize = 256;
/// Channels between which a drift can be told, at least, and that are looked at, at most.
const LEAST_CHANNELS: usize = 4;
const MOST_CHANNELS: usize = 256;
/// The others must tell so much of a channel's motion...
const TOLD: f64 = 0.8;
/// ...and its gain must change by so much (ln) from one end of the record to the other...
const LEAST_CHANGE: f64 = 0.1;
/// ...which is so many standard errors of a straight line through the parts.
const ERRORS: f64 = 8.0;
/// How often a drift that was found is measured anew, and what more of it (ln) is not worth another time.
const MOST_ROUNDS: usize = 20;
const ENOUGH: f64 = 2e-3;
/// What the others tell is only as sure as so many times the mean power of a channel.
const RIDGE: f64 = 1e-6;
/// More channels than this share do not drift by chance: then it is not the channels.
const MOST_SHARE: f64 = 0.34;

/// A channel whose gain drifts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drift {
    /// The channel, in the setup's order.
    pub(super) channel: usize,
    /// By how much its gain changes from the record's beginning to its end: 0.1 for a tenth more.
    pub(super) change: f64,
}

/// A part of the record: sums of products of channels, and windows in which both of two were sound.
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
    /// Windows of a part.
    length: usize,
    parts: Vec<Part>,
}

impl Gains {
    /// For so many channels.
    pub(super) fn new(channels: usize) -> Self {
        Self { channels, length: 1, parts: Vec::new() }
    }

    fn is_watched(&self) -> bool {
        (LEAST_CHANNELS..=MOST_CHANNELS).contains(&self.channels)
    }

    /// Takes a window.
    pub(super) fn push(&mut self, window: &WindowLines) {
        if !self.is_watched() || window.channels.len() != self.channels {
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
            let size = self.channels * self.channels;
            self.parts.push(Part { products: vec![0.0; size], sound: vec![0.0; size], windows: 0 });
        }
        let Some(part) = self.parts.last_mut() else { return };
        part.windows += 1;
        for (first, one) in window.channels.iter().enumerate() {
            let Some(one) = one else { continue };
            let step = one.len().div_ceil(MOST_LINES).max(1);
            for (second, other) in window.channels.iter().enumerate().take(first + 1) {
                let Some(other) = other else { continue };
                let lines = one.iter().zip(other).step_by(step);
                let product: f64 = lines.map(|(a, b)| f64::from(a.re * b.re + a.im * b.im)).sum();
                let at = first * self.channels + second;
                part.products[at] += product;
                part.sound[at] += 1.0;
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
        let mut channels: Vec<usize> =
            are_used.iter().copied().filter(|&channel| channel < self.channels && self.is_there(channel)).collect();
        let most = (MOST_SHARE * channels.len() as f64) as usize;
        let mut drifts = Vec::new();
        while channels.len() >= LEAST_CHANNELS {
            // Beside one that drifts a lot, others seem to drift the other way: the furthest goes first.
            let Some(drift) = self.furthest(&channels) else { break };
            channels.retain(|&channel| channel != drift.channel);
            drifts.push(drift);
            if drifts.len() > most {
                return Vec::new();
            }
        }
        drifts.sort_unstable_by_key(|drift| drift.channel);
        drifts
    }

    /// Whether a channel is sound in half of all windows of each part.
    fn is_there(&self, channel: usize) -> bool {
        let at = channel * self.channels + channel;
        self.parts.iter().all(|part| 2.0 * part.sound[at] >= part.windows as f64 && part.products[at] > 0.0)
    }

    /// Mean products of some channels in a part.
    fn matrix(&self, part: &Part, channels: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(channels.len(), channels.len(), |row, column| {
            let (first, second) = (channels[row].max(channels[column]), channels[row].min(channels[column]));
            let at = first * self.channels + second;
            part.products[at] / part.sound[at].max(1.0)
        })
    }

    /// The channel of these whose gain drifts furthest, if any does.
    fn furthest(&self, channels: &[usize]) -> Option<Drift> {
        let told = self.told(channels, None)?;
        let common = common(&told);
        let lines = told.iter().map(|(channel, gains)| (*channel, line(&beside(gains, &common))));
        let may_drift = |(_, (change, error)): &(usize, (f64, f64))| {
            change.abs() > 0.5 * LEAST_CHANGE && change.abs() > 0.5 * ERRORS * error
        };
        let mut candidates: Vec<(usize, (f64, f64))> = lines.filter(may_drift).collect();
        candidates.sort_by(|(_, one), (_, other)| other.0.abs().total_cmp(&one.0.abs()));
        candidates.into_iter().find_map(|(channel, (change, _))| self.settled(channels, channel, change))
    }

    /// A drift (ln) of about this size, if it is one. The regression believes a channel most where it moves most. So what is known of the drift is
    /// taken off, and the regression made again.
    fn settled(&self, channels: &[usize], channel: usize, mut change: f64) -> Option<Drift> {
        for _ in 0..MOST_ROUNDS {
            let told = self.told(channels, Some((channel, change)))?;
            let (_, gains) = told.iter().find(|(other, _)| *other == channel)?;
            let (more, error) = line(&beside(gains, &common(&told)));
            change += more;
            if more.abs() < ENOUGH {
                let is_sure = change.abs() > LEAST_CHANGE && change.abs() > ERRORS * error;
                return is_sure.then(|| Drift { channel, change: change.exp_m1() });
            }
        }
        None
    }

    /// Of the channels that the others tell of, the gain (ln) in each part: what a channel shows beside what they tell. A drift (ln) that is known is
    /// taken off its channel.
    fn told(&self, channels: &[usize], known: Option<(usize, f64)>) -> Option<Vec<(usize, Vec<f64>)>> {
        let count = channels.len();
        let mut parts: Vec<DMatrix<f64>> = self.parts.iter().map(|part| self.matrix(part, channels)).collect();
        if let Some((channel, change)) = known
            && let Some(at) = channels.iter().position(|&other| other == channel)
        {
            let last = (parts.len() - 1).max(1) as f64;
            for (number, part) in parts.iter_mut().enumerate() {
                let gain = (change * (number as f64 / last - 0.5)).exp();
                part.row_mut(at).scale_mut(1.0 / gain);
                part.column_mut(at).scale_mut(1.0 / gain);
            }
        }
        // Channels of any unit count alike.
        let powers: Vec<f64> =
            (0..count).map(|at| parts.iter().map(|part| part[(at, at)]).sum::<f64>() / parts.len() as f64).collect();
        if powers.iter().any(|power| !power.is_normal()) {
            return None;
        }
        let alike = |part: &DMatrix<f64>| {
            DMatrix::from_fn(count, count, |row, column| part[(row, column)] / (powers[row] * powers[column]).sqrt())
        };
        let parts: Vec<DMatrix<f64>> = parts.iter().map(alike).collect();
        let whole = parts.iter().fold(DMatrix::zeros(count, count), |sum, part| sum + part) / parts.len() as f64;
        let ridge = DMatrix::identity(count, count) * RIDGE;
        let inverse = (whole + ridge).cholesky()?.inverse();
        let mut told: Vec<(usize, Vec<f64>)> = Vec::new();
        for at in 0..count {
            // The regression on the others, and what it leaves, stand in the inverse (Whittaker 1990, section 5.8).
            if 1.0 - 1.0 / inverse[(at, at)] < TOLD {
                continue;
            }
            let mut weights: DVector<f64> = -inverse.column(at) / inverse[(at, at)];
            weights[at] = 0.0;
            let gain = |part: &DMatrix<f64>| {
                let expected = part * &weights;
                (expected[at] / weights.dot(&expected)).ln()
            };
            let gains: Vec<f64> = parts.iter().map(gain).collect();
            if gains.iter().all(|gain| gain.is_finite()) {
                told.push((channels[at], gains));
            }
        }
        (told.len() >= LEAST_CHANNELS - 1).then_some(told)
    }
}

/// What the gains of all channels have in common, part by part: in a calm one noise makes what the others tell too large.
fn common(told: &[(usize, Vec<f64>)]) -> Vec<f64> {
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

/// How much a straight line through values at equal steps changes from the first to the last, and the standard error of that.
fn line(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let (middle, mean) = (0.5 * (count - 1.0), values.iter().sum::<f64>() / count);
    let (mut products, mut squares) = (0.0, 0.0);
    for (at, value) in values.iter().enumerate() {
        let from = at as f64 - middle;
        products += from * (value - mean);
        squares += from * from;
    }
    let slope = products / squares;
    let left = values.iter().enumerate().map(|(at, value)| (value - mean - slope * (at as f64 - middle)).powi(2));
    let error = (left.sum::<f64>() / (count - 2.0) / squares).sqrt();
    (slope * (count - 1.0), error * (count - 1.0))
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
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let shape = |mode: usize, channel: usize| ((mode + 1) as f64 * (channel + 1) as f64 * 0.4).sin();
        let mut gains = Gains::new(CHANNELS);
        let (mut levels, lines) = ([0.0_f64; 3], 40);
        for window in 0..WINDOWS {
            let share = window as f64 / (WINDOWS - 1) as f64;
            // Each mode's load wanders by a factor of e, up and down, and one grows steadily.
            levels.iter_mut().for_each(|level| *level = 0.9 * *level + 0.4 * normal());
            let mut channels = vec![vec![Complex32::default(); lines]; CHANNELS];
            for line in 0..lines {
                let modes: [Complex32; 3] = std::array::from_fn(|mode| {
                    let level = (levels[mode] + if mode == 1 { 1.5 * share } else { 0.0 }).exp();
                    Complex32::new((level * normal()) as f32, (level * normal()) as f32)
                });
                for (channel, lines) in channels.iter_mut().enumerate() {
                    let motion: Complex32 =
                        modes.iter().enumerate().map(|(mode, at)| at * shape(mode, channel) as f32).sum();
                    let noise = Complex32::new(0.1 * normal() as f32, 0.1 * normal() as f32);
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
                assert_eq!(found.iter().map(|drift| drift.channel).collect::<Vec<_>>(), [2], "{found:?}");
                assert!((found[0].change - change).abs() < 0.05, "{change}: {found:?}");
            }
        }
        let two = |channel: usize, share: f64| match channel {
            1 => 1.0 + 0.4 * share,
            5 => 1.0 - 0.3 * share,
            _ => 1.0,
        };
        assert_eq!(drifts(9, two).iter().map(|drift| drift.channel).collect::<Vec<_>>(), [1, 5]);
    }

    #[test]
    fn all_at_once_and_few_windows_tell_nothing() {
        assert_eq!(drifts(3, |_, share| 1.0 + share), [], "that is the load, or the recorder");
        let mut gains = Gains::new(CHANNELS);
        gains.push(&WindowLines { grid_index: 0, channels: vec![None; CHANNELS] });
        assert_eq!(gains.finish(&[0, 1, 2, 3]), []);
        assert_eq!(Gains::new(2).finish(&[0, 1]), []);
    }
}
