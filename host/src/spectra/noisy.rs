//! Channels that are nothing but noise: no other channel knows of what they show.
//!
//! An averaged cross-spectral matrix flows in; the channels to leave out, and those to name, flow out. What the other channels
//! explain of a channel is its multiple coherence, `1 - 1 / (G_cc (G⁻¹)_cc)` (Bendat and Piersol 2010, "Random Data", section 7.3).
//! A loud one is left out: where the structure moves its noise is more than the others' motion, or it shows as much as they do over all
//! lines and nowhere anything of theirs. A sensor that hardly moves is mostly noise as well, and stays: its noise is small beside the
//! others' motion, and that it hardly moves is worth knowing. It is named, for one that is not connected looks the same.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::cross_spectrum::CrossSpectrum;
use crate::statistics::median;

/// With fewer channels it cannot be said which of them is wrong.
const LEAST_CHANNELS: usize = 4;
/// Averages that coherence needs, per channel.
const AVERAGES_FOR_COHERENCE: usize = 2;
/// Lines that are looked at, at most, and the share of them at which the channels agree best: where the structure moves.
const LINES: usize = 512;
const MOVING: f64 = 0.25;
/// A noisy channel's coherence there is below the first, the median channel's above the second.
const INCOHERENT: f64 = 0.2;
const COHERENT: f64 = 0.5;
/// Its noise is this many times the power of the median channel there.
const LOUD: f64 = 3.0;

/// Lines side by side, of those that are looked at, over which a channel that has a mode of its own is coherent for once: it is named
/// only where its coherence is below this in all such bands.
const BAND: usize = 16;
const INCOHERENT_IN_ALL: f64 = 0.35;

/// Channels that have nothing in common with the others, as in `CrossSpectrum::channels`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Alone {
    /// Those that are louder than the others.
    pub loud: Vec<usize>,
    /// Those that are not.
    pub quiet: Vec<usize>,
}

/// What one line says of every channel.
struct Line {
    /// Share of its power that the others explain, free of what chance explains.
    coherence: Vec<f64>,
    power: Vec<f64>,
}

impl CrossSpectrum {
    /// The channels that have nothing in common with the others.
    fn alone(&self) -> Alone {
        let channels = self.channels().len();
        if channels < LEAST_CHANNELS || self.averages() < AVERAGES_FOR_COHERENCE * channels {
            return Alone::default();
        }
        let step = self.grid().lines.div_ceil(LINES).max(1);
        let mut lines: Vec<Line> =
            (0..self.grid().lines).step_by(step).filter_map(|line| self.line(&self.matrix(line))).collect();
        let in_band = |band: &[Line], channel: usize| {
            band.iter().map(|line| line.coherence[channel]).sum::<f64>() / band.len() as f64
        };
        let is_nowhere_coherent: Vec<bool> = (0..channels)
            .map(|channel| lines.chunks_exact(BAND).all(|band| in_band(band, channel) < INCOHERENT_IN_ALL))
            .collect();
        let all: Vec<f64> = (0..channels).map(|channel| lines.iter().map(|line| line.power[channel]).sum()).collect();
        let usual_in_all = middle_of(&all);
        let agreement = |line: &Line| middle_of(&line.coherence);
        lines.sort_by(|a, b| agreement(b).total_cmp(&agreement(a)));
        lines.truncate(((MOVING * lines.len() as f64) as usize).max(1));
        let mean = |value: &dyn Fn(&Line) -> f64| lines.iter().map(value).sum::<f64>() / lines.len().max(1) as f64;
        let coherence: Vec<f64> = (0..channels).map(|channel| mean(&|line| line.coherence[channel])).collect();
        let usual = mean(&|line| middle_of(&line.power));
        if middle_of(&coherence) < COHERENT {
            return Alone::default();
        }
        let noise = |channel: usize| mean(&|line| line.power[channel] * (1.0 - line.coherence[channel]));
        let mut alone = Alone::default();
        for channel in (0..channels).filter(|channel| coherence[*channel] < INCOHERENT) {
            if noise(channel) > LOUD * usual || (is_nowhere_coherent[channel] && all[channel] > usual_in_all) {
                alone.loud.push(self.channels()[channel]);
            } else if is_nowhere_coherent[channel] {
                alone.quiet.push(self.channels()[channel]);
            }
        }
        alone
    }

    /// The same averages without the channels that are loud and have nothing in common with the others; which these were, and which
    /// have nothing in common with the others and stay.
    pub fn without_noisy_channels(self) -> (Self, Alone) {
        let alone = self.alone();
        (self.without_channels(&alone.loud), alone)
    }

    fn line(&self, matrix: &DMatrix<Complex64>) -> Option<Line> {
        let power: Vec<f64> = matrix.diagonal().iter().map(|value| value.re).collect();
        if power.iter().any(|&power| power <= 0.0) {
            return None;
        }
        let alike = DMatrix::from_fn(power.len(), power.len(), |i, j| matrix[(i, j)] / (power[i] * power[j]).sqrt());
        let inverse = alike.cholesky()?.inverse();
        // Of nothing in common, M averages of n channels show (n - 1) / M.
        let chance = (power.len() - 1) as f64 / self.averages() as f64;
        let coherence = (0..power.len()).map(|channel| {
            let seen = 1.0 - 1.0 / inverse[(channel, channel)].re.max(1.0);
            ((seen - chance) / (1.0 - chance)).clamp(0.0, 1.0)
        });
        Some(Line { coherence: coherence.collect(), power })
    }
}

fn middle_of(values: &[f64]) -> f64 {
    median(&mut values.to_vec()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use num_complex::Complex32;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::Alone;
    use crate::spectra::{CrossSpectrum, CrossSpectrumAccumulator, LineGrid, WindowLines};

    /// Motion that all channels share, of the given size in each, and noise of each channel's own.
    fn spectrum(motion: &[f64], noise: &[f64]) -> CrossSpectrum {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let mut normal = move || {
            let (re, im): (f64, f64) = (StandardNormal.sample(&mut random), StandardNormal.sample(&mut random));
            num_complex::Complex64::new(re, im)
        };
        let grid = LineGrid { sampling_rate_hz: 5.0, segment: 256, first_line: 5, lines: 40 };
        let mut accumulator = CrossSpectrumAccumulator::new(grid, motion.len()).unwrap();
        for number in 0..60 {
            let shared: Vec<_> = (0..40).map(|_| normal()).collect();
            let channel = |channel: usize, normal: &mut dyn FnMut() -> num_complex::Complex64| -> Vec<Complex32> {
                let line = |shared: &num_complex::Complex64| {
                    let value = shared * motion[channel] + normal() * noise[channel];
                    Complex32::new(value.re as f32, value.im as f32)
                };
                shared.iter().map(line).collect()
            };
            let channels = (0..motion.len()).map(|index| Some(channel(index, &mut normal))).collect();
            accumulator.add(WindowLines { grid_index: number, channels }).unwrap();
        }
        accumulator.finish().unwrap().0
    }

    #[test]
    fn a_loud_channel_that_no_other_knows_of_is_noisy_and_a_quiet_one_is_not() {
        let motion = [1.0, 0.8, -0.6, 1.2, 0.9, 0.0];
        assert_eq!(spectrum(&motion, &[0.1, 0.1, 0.1, 0.1, 9.0, 0.1]).alone().loud, [4]);
        assert!(spectrum(&motion, &[0.1; 6]).alone().loud.is_empty());
        // Where all are noise, none is to blame.
        assert!(spectrum(&motion, &[9.0; 6]).alone().loud.is_empty());
        // As loud as the others over all lines, and nowhere coherent.
        assert_eq!(spectrum(&motion, &[0.1, 0.1, 0.1, 0.1, 0.1, 1.5]).alone().loud, [5]);
        assert!(spectrum(&motion[..3], &[0.1, 9.0, 0.1]).alone().loud.is_empty(), "two against one prove nothing");
    }

    #[test]
    fn a_channel_that_no_other_knows_of_is_named_however_quiet_it_is() {
        let motion = [1.0, 0.8, -0.6, 1.2, 0.9, 0.0, 0.0];
        let alone = spectrum(&motion, &[0.1, 0.1, 0.1, 0.1, 0.1, 0.001, 0.8]).alone();
        assert_eq!((alone.loud, alone.quiet), (vec![], vec![5, 6]));
        // One that moves a little is not.
        let motion = [1.0, 0.8, -0.6, 1.2, 0.9, 0.1];
        assert_eq!(spectrum(&motion, &[0.1; 6]).alone(), Alone::default());
    }
}
