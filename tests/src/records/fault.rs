//! What goes wrong with sensors and recorders.

use rand::{Rng, RngExt};

use super::machine::Machine;
use super::structure::Structure;

/// A fault of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// One sample of one channel is off by 9.81 m/s².
    Spike,
    /// One in a hundred samples of one channel is off by ten times its root mean square.
    Spikes,
    /// One channel jumps by 9.81 m/s² once.
    Step,
    /// One channel has added noise of ten times its root mean square.
    Noise,
    /// One in a hundred rows is missing, and nothing says so.
    MissingRows,
    /// One channel is cut at one and a half times its root mean square.
    Clipped,
    /// Channel 10 is reversed, and channels 14 and 17 are exchanged.
    Miswired,
    /// The structure stands still: there is nothing but noise, of another size in each channel.
    StandsStill,
    /// A machine shakes it.
    Machine(Machine),
}

const G: f64 = 9.81;

impl Fault {
    /// Damages samples of a structure, row by row.
    pub(super) fn damage(self, samples: &mut Vec<f32>, structure: &Structure, rate_hz: f64, random: &mut impl Rng) {
        let channels = structure.places.len();
        let rows = samples.len() / channels;
        let channel = random.random_range(0..channels);
        let sum: f64 = samples.iter().skip(channel).step_by(channels).map(|value| f64::from(*value).powi(2)).sum();
        let rms = (sum / rows as f64).sqrt();
        let at = random.random_range(rows / 4..3 * rows / 4);
        let own = |samples: &mut Vec<f32>, change: &mut dyn FnMut(usize, &mut f32)| {
            for (row, value) in samples.iter_mut().skip(channel).step_by(channels).enumerate() {
                change(row, value);
            }
        };
        match self {
            Self::Spike => samples[at * channels + channel] += G as f32,
            Self::Step => own(samples, &mut |row, value| *value += if row >= at { G as f32 } else { 0.0 }),
            Self::Spikes => own(samples, &mut |_, value| {
                if random.random_bool(0.01) {
                    *value += (10.0 * rms) as f32;
                }
            }),
            Self::Noise => own(samples, &mut |_, value| {
                let noise: f64 = rand_distr::Distribution::sample(&rand_distr::StandardNormal, random);
                *value += (10.0 * rms * noise) as f32;
            }),
            Self::Clipped => own(samples, &mut |_, value| *value = value.clamp(-1.5 * rms as f32, 1.5 * rms as f32)),
            Self::StandsStill => {
                let sizes: Vec<f64> = (0..channels).map(|_| random.random_range(0.3..3.0) * rms).collect();
                for row in samples.chunks_mut(channels) {
                    for (value, size) in row.iter_mut().zip(&sizes) {
                        let noise: f64 = rand_distr::Distribution::sample(&rand_distr::StandardNormal, random);
                        *value = (size * noise) as f32;
                    }
                }
            }
            Self::Miswired => {
                for row in samples.chunks_mut(channels) {
                    row[9] = -row[9];
                    row.swap(13, 16);
                }
            }
            Self::Machine(machine) => machine.shake(samples, structure, rate_hz, random),
            Self::MissingRows => {
                let kept: Vec<bool> = (0..rows).map(|_| !random.random_bool(0.01)).collect();
                let mut row = 0;
                samples.retain(|_| {
                    row += 1;
                    kept[(row - 1) / channels]
                });
            }
        }
    }
}
