//! Recordings: white-noise loads on all nodes, modal superposition by exact recursion, or wind; sensor noise. A case flows in, rows of
//! 32-bit samples flow out, and their NPY file.
//!
//! A sample is the acceleration averaged over the step before it: the difference of two velocities, which the modes give exactly
//! and which aliases little.

use std::f64::consts::TAU;
use std::io;
use std::path::Path;

use nalgebra::{Complex, DMatrix};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::cases::{Case, MODES};
use super::damped::DampedMode;
use super::motion::{Clock, Motion, modal_forces};
use super::wind;
use super::world::Loads;

/// Steps that are made at once.
const BLOCK: usize = 256;
/// RMS of a steady tone relative to the strongest channel's.
const TONE: f64 = 0.2;
/// Half the swing of the day's temperature.
const SWING_K: f64 = 8.0;
const MEAN_DEGC: f64 = 12.0;
const DAY_S: f64 = 86_400.0;

/// Samples, row by row, and the temperatures beside them where those matter.
pub(super) struct Recording {
    pub(super) channels: usize,
    pub(super) samples: Vec<f32>,
    /// Seconds and degrees Celsius.
    pub(super) temperatures: Option<Vec<(f64, f64)>>,
}

/// How the air's temperature goes on a day, about its mean over the record, where the model's stiffness is meant to be.
struct Day {
    phase: f64,
    mean_k: f64,
}

impl Day {
    fn of(case: &Case, random: &mut impl Rng) -> Self {
        let day = Self { phase: random.random_range(0.0..TAU), mean_k: 0.0 };
        let seconds = case.hours * 3600.0;
        let mean_k = (0..1000).map(|at| day.above_mean_k(seconds * f64::from(at) / 1000.0)).sum::<f64>() / 1000.0;
        Self { mean_k, ..day }
    }

    fn above_mean_k(&self, t_s: f64) -> f64 {
        SWING_K * (TAU * t_s / DAY_S + self.phase).sin() - self.mean_k
    }
}

/// Records a case.
pub(super) fn record(case: &Case) -> Result<Recording, String> {
    let mut random = case.random.clone();
    let modes = case.body.modes(MODES).ok_or("the structure buckles")?;
    let damped = case.damped_modes()?;
    let rate = case.structure.sampling_rate_hz;
    let channels = case.body.sensors.len();
    let warmth = case.body.stiffness_per_kelvin;
    let forces = modal_forces(&case.body, &modes, case.world.loads != Loads::Even, &mut random);
    let day = Day::of(case, &mut random);
    let mut samples = if case.world.loads == Loads::Wind {
        wind::samples(case, &modes, &damped, &mut random)
    } else {
        under_noise(case, &damped, &forces, &day, &mut random)
    };
    let levels = levels(&samples, channels);
    if let Some(tone_hz) = case.body.tone_hz {
        let deflection = deflection_at(tone_hz, &damped, &forces, &mut random);
        let strongest = levels.iter().copied().fold(0.0, f64::max);
        let largest = deflection.iter().map(|value| value.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let scale = TONE * strongest * 2.0_f64.sqrt() / largest;
        for (row, values) in samples.chunks_exact_mut(channels).enumerate() {
            let wave = scale * (TAU * tone_hz * row as f64 / rate).cos();
            values.iter_mut().zip(&deflection).for_each(|(value, shape)| *value += (wave * shape) as f32);
        }
    }
    let noise: Vec<f64> = levels.iter().map(|level| level * random.random_range(0.03..0.05)).collect();
    for values in samples.chunks_exact_mut(channels) {
        for (value, noise) in values.iter_mut().zip(&noise) {
            let normal: f64 = StandardNormal.sample(&mut random);
            *value += (noise * normal) as f32;
        }
    }
    let temperature = |minutes: u32| {
        let t_s = 60.0 * f64::from(minutes);
        (t_s, MEAN_DEGC + day.above_mean_k(t_s))
    };
    let minutes = (0..=(case.hours * 60.0) as u32).step_by(10);
    let temperatures = (warmth != 0.0).then(|| minutes.map(temperature).collect());
    Ok(Recording { channels, samples, temperatures })
}

/// Accelerations under white forces on the modes, row by row, without the sensors' noise.
fn under_noise(
    case: &Case,
    damped: &[DampedMode],
    forces: &DMatrix<f64>,
    day: &Day,
    random: &mut impl Rng,
) -> Vec<f32> {
    let rate = case.structure.sampling_rate_hz;
    let rows = (case.hours * 3600.0 * rate).round() as usize;
    let channels = case.body.sensors.len();
    let mut samples = vec![0.0_f32; rows * channels];
    let slowest = damped.iter().map(|mode| -mode.pole.re).fold(f64::INFINITY, f64::min);
    let clock = Clock::of(&case.body, rate);
    let margin = clock.late.iter().map(|steps| steps.unsigned_abs() as usize).max().unwrap_or(0);
    let warm_up = (8.0 / slowest * rate) as usize + margin;
    let warmth = case.body.stiffness_per_kelvin;
    let mut motion = Motion::new(damped, forces, &clock, 1.0);
    let mut first = 0;
    while first < warm_up + rows + margin {
        if warmth != 0.0 {
            let t_s = (first as f64 - warm_up as f64).max(0.0) / rate;
            motion.pace(damped, forces, &clock, (1.0 + warmth * day.above_mean_k(t_s)).sqrt());
        }
        let block = motion.run(BLOCK, random);
        for (at, row) in block.column_iter().enumerate() {
            for (channel, value) in row.iter().enumerate() {
                let to = (first + at) as i64 - warm_up as i64 + clock.late[channel];
                if (0..rows as i64).contains(&to) {
                    samples[to as usize * channels + channel] = *value as f32;
                }
            }
        }
        first += BLOCK;
    }
    samples
}

/// Root mean squares of the channels.
fn levels(samples: &[f32], channels: usize) -> Vec<f64> {
    let mut sums = vec![0.0; channels];
    for row in samples.chunks_exact(channels) {
        row.iter().zip(&mut sums).for_each(|(value, sum)| *sum += f64::from(*value).powi(2));
    }
    let rows = (samples.len() / channels.max(1)).max(1);
    sums.into_iter().map(|sum| (sum / rows as f64).sqrt()).collect()
}

/// Steady deflection of the sensors under a tone at one place, damping left out.
fn deflection_at(tone_hz: f64, damped: &[DampedMode], forces: &DMatrix<f64>, random: &mut impl Rng) -> Vec<f64> {
    let weights: Vec<f64> = (0..forces.nrows()).map(|_| StandardNormal.sample(random)).collect();
    let channels = damped.first().map_or(0, |mode| mode.shape.len());
    let turn = Complex::new(0.0, TAU * tone_hz);
    let on = |mode: &DampedMode| mode.input.iter().zip(&weights).map(|(i, w)| i * *w).sum::<Complex<f64>>();
    let part = |mode: &DampedMode, channel: usize| {
        let shape = mode.shape[channel] * on(mode);
        (shape / (turn - mode.pole) + shape.conj() / (turn - mode.pole.conj())).re
    };
    (0..channels).map(|channel| damped.iter().map(|mode| part(mode, channel)).sum()).collect()
}

impl Recording {
    /// Writes an NPY file.
    pub(super) fn write_npy(&self, path: &Path) -> io::Result<()> {
        crate::npy::write_npy(path, &self.samples, self.channels)
    }
}
