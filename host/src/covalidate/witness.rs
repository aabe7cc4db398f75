//! Measured motion, summed up as it comes: enough to say how far any prediction is off, without keeping the samples.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use super::overlap::Hop;
use super::predictor::Predictor;

/// Sums of products of the channels' samples, apart for each set of channels that are sound at a time: which channels
/// count is only known when all have been seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Witness {
    channels: usize,
    /// By which channels are sound.
    sums: BTreeMap<Vec<bool>, Sums>,
    hops: u64,
}

#[derive(Debug, Clone, PartialEq)]
struct Sums {
    /// Sum over samples of y yᵀ, channels x channels, zero where one is not sound.
    products: DMatrix<f64>,
    samples: u64,
    hops: u64,
}

/// Sets of sound channels that are kept apart; one set more is left out, so that memory has a bound.
const MOST_SETS: usize = 4096;

impl Witness {
    /// For `channels` channels.
    pub fn new(channels: usize) -> Self {
        Self { channels, sums: BTreeMap::new(), hops: 0 }
    }

    /// Adds half a segment.
    pub fn add(&mut self, hop: &Hop<'_>) {
        self.hops += 1;
        let lengths = hop.channels.iter().flatten().map(Vec::len);
        let (Some(length), true) = (lengths.min(), hop.channels.len() == self.channels) else { return };
        let sound: Vec<bool> = hop.channels.iter().map(Option::is_some).collect();
        if self.sums.len() >= MOST_SETS && !self.sums.contains_key(&sound) {
            return;
        }
        let block = DMatrix::from_fn(length, self.channels, |sample, channel| {
            hop.channels[channel].as_ref().map_or(0.0, |samples| samples[sample])
        });
        let channels = self.channels;
        let empty = || Sums { products: DMatrix::zeros(channels, channels), samples: 0, hops: 0 };
        let sums = self.sums.entry(sound).or_insert_with(empty);
        sums.products += block.tr_mul(&block);
        sums.samples += length as u64;
        sums.hops += 1;
    }

    /// Half segments seen.
    pub fn hops(&self) -> u64 {
        self.hops
    }

    /// Half segments in which all of `channels` are sound.
    pub fn sound_hops(&self, channels: &[usize]) -> u64 {
        self.sound(channels).map(|sums| sums.hops).sum()
    }

    /// The motion while all of `channels` are sound.
    pub fn motion(&self, channels: &[usize]) -> Motion {
        let mut motion = Motion { products: DMatrix::zeros(self.channels, self.channels), samples: 0 };
        for sums in self.sound(channels) {
            motion.products += &sums.products;
            motion.samples += sums.samples;
        }
        motion
    }

    fn sound(&self, channels: &[usize]) -> impl Iterator<Item = &Sums> {
        let all = move |sound: &Vec<bool>| channels.iter().all(|&channel| sound.get(channel) == Some(&true));
        self.sums.iter().filter(move |(sound, _)| all(sound)).map(|(_, sums)| sums)
    }
}

/// Sums of products over the samples at which certain channels are sound; of the others it knows nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    products: DMatrix<f64>,
    samples: u64,
}

impl Motion {
    /// Samples summed.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Root mean square of a channel.
    pub fn rms(&self, channel: usize) -> f64 {
        if self.samples == 0 { 0.0 } else { (self.products[(channel, channel)] / self.samples as f64).sqrt() }
    }

    /// Root mean square of the prediction of each left-out channel: its rows over the channels `kept`.
    pub fn rms_predicted(&self, predictor: &Predictor, kept: &[usize]) -> Vec<f64> {
        let among_kept = self.products.select_rows(kept).select_columns(kept);
        let samples = self.samples.max(1) as f64;
        let square = |weights: nalgebra::RowDVector<f64>| (&weights * &among_kept * weights.transpose())[(0, 0)];
        predictor.weights.row_iter().map(|row| (square(row.into_owned()).max(0.0) / samples).sqrt()).collect()
    }

    /// `E_d = |prediction - measured| / |measured|` (eq. 17) of each left-out channel, in percent; `kept` and `left_out` are
    /// the channels that the predictor's columns and rows stand for. `None` where a channel does not move.
    ///
    /// `|x y_s - y_d|² = x R_ss xᵀ - 2 x R_sd + R_dd`, R the summed products.
    pub fn error_percent(&self, predictor: &Predictor, kept: &[usize], left_out: &[usize]) -> Vec<Option<f64>> {
        let among_kept = self.products.select_rows(kept).select_columns(kept);
        let error = |(index, &channel): (usize, &usize)| {
            let weights = predictor.weights.row(index);
            let measured = self.products[(channel, channel)];
            let cross =
                kept.iter().zip(weights.iter()).map(|(&other, weight)| weight * self.products[(other, channel)]);
            let square = (weights * &among_kept * weights.transpose())[(0, 0)] - 2.0 * cross.sum::<f64>() + measured;
            (measured > 0.0).then(|| 100.0 * (square.max(0.0) / measured).sqrt())
        };
        left_out.iter().enumerate().map(error).collect()
    }
}
