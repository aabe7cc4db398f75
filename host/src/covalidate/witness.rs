//! Measured motion, summed up as it comes: enough to say how far any prediction is off, without keeping the samples.

use nalgebra::DMatrix;

use super::overlap::Hop;
use super::predictor::Predictor;

/// Sums of products of all channels over the samples at which all of them are sound.
#[derive(Debug, Clone, PartialEq)]
pub struct Witness {
    /// Sum over samples of y yᵀ, channels x channels.
    products: DMatrix<f64>,
    samples: u64,
    left_out_hops: u64,
}

impl Witness {
    /// For `channels` channels.
    pub fn new(channels: usize) -> Self {
        Self { products: DMatrix::zeros(channels, channels), samples: 0, left_out_hops: 0 }
    }

    /// Adds half a segment; one in which a channel is not sound is left out. Says whether it was added.
    pub fn add(&mut self, hop: &Hop<'_>) -> bool {
        let sound: Option<Vec<&Vec<f64>>> = hop.channels.iter().map(Option::as_ref).collect();
        let Some(channels) = sound.filter(|channels| channels.len() == self.products.nrows()) else {
            self.left_out_hops += 1;
            return false;
        };
        let length = channels.iter().map(|channel| channel.len()).min().unwrap_or(0);
        let block = DMatrix::from_fn(length, channels.len(), |sample, channel| channels[channel][sample]);
        self.products += block.tr_mul(&block);
        self.samples += length as u64;
        true
    }

    /// Samples added.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Half segments that were left out.
    pub fn left_out_hops(&self) -> u64 {
        self.left_out_hops
    }

    /// Root mean square of a channel.
    pub fn rms(&self, channel: usize) -> f64 {
        if self.samples == 0 { 0.0 } else { (self.products[(channel, channel)] / self.samples as f64).sqrt() }
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
