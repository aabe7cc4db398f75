//! Recordings of given modes, without a model: what identification is measured by, in tests and in the study of its figures.
//!
//! Every mode is an exact discrete oscillator under white force of its own. [`score`] holds an identification against them.

pub mod score;

use nalgebra::DMatrix;
use num_complex::Complex64;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

use crate::spectra::direct::Welch;
use crate::spectra::{CrossSpectrum, CrossSpectrumAccumulator, PlanError, SetupExtent, SpectraError, SpectralPlan};
use crate::study::{Analysis, Sensor, Setup};

/// Why there is no spectrum of a recording.
#[derive(Debug, Error)]
pub enum ModalError {
    /// The recording is too short for the band, or the rate too low.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The windows gave no spectrum.
    #[error(transparent)]
    Spectra(#[from] SpectraError),
}

/// Modes of a structure.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Natural frequencies in Hz, rising.
    pub frequencies_hz: Vec<f64>,
    /// Damping ratio of all modes.
    pub damping_ratio: f64,
    /// Mode shapes: channels x modes.
    pub shapes: DMatrix<f64>,
}

/// A recording to make.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Rows a second.
    pub sampling_rate_hz: f64,
    /// Length.
    pub hours: f64,
    /// Sensor noise as a share of each channel's RMS.
    pub noise: f64,
    /// The band that is analysed.
    pub band_hz: [f64; 2],
    /// Same seed, same recording.
    pub seed: u64,
    /// Whether velocity is recorded instead of acceleration.
    pub velocity: bool,
    /// A harmonic on all channels: frequency in Hz, amplitude as a share of the first channel's RMS.
    pub harmonic: Option<(f64, f64)>,
}

impl Recording {
    /// Accelerations, analysed from 0.05 to 1.5 Hz, with 5 % of noise and no harmonic.
    pub fn of(sampling_rate_hz: f64, hours: f64, seed: u64) -> Self {
        let band_hz = [0.05, 1.5];
        Self { sampling_rate_hz, hours, noise: 0.05, band_hz, seed, velocity: false, harmonic: None }
    }
}

/// A setup whose channels are "1", "2", ... and whose points are named the same.
pub fn setup(name: &str, points: &[String], references: &[bool]) -> Setup {
    let sensor = |(at, point): (usize, &String)| Sensor {
        point: point.clone(),
        reference: references.get(at).copied().unwrap_or(false),
        ..Sensor::new((at + 1).to_string(), 1)
    };
    Setup::new(name, 1.0, points.iter().enumerate().map(sensor).collect())
}

/// Names of points, counted from 1.
pub fn points(count: usize) -> Vec<String> {
    (1..=count).map(|at| at.to_string()).collect()
}

impl Truth {
    /// Two ten-storey chains, coupled by weak springs at every floor; the second 1.8 % stiffer in frequency. Scaled so
    /// that the first six modes of each lie below 1 Hz. 20 channels, 12 modes.
    pub fn chains() -> Self {
        let storeys = 10;
        let mut stiffness = DMatrix::<f64>::zeros(2 * storeys, 2 * storeys);
        for (chain, k) in [1.0, 1.018_f64.powi(2)].into_iter().enumerate() {
            for storey in 0..storeys {
                let i = chain * storeys + storey;
                stiffness[(i, i)] += k;
                if storey > 0 {
                    stiffness[(i - 1, i - 1)] += k;
                    stiffness[(i - 1, i)] -= k;
                    stiffness[(i, i - 1)] -= k;
                }
            }
        }
        for storey in 0..storeys {
            let coupling = 1e-4;
            let (i, j) = (storey, storeys + storey);
            stiffness[(i, i)] += coupling;
            stiffness[(j, j)] += coupling;
            stiffness[(i, j)] -= coupling;
            stiffness[(j, i)] -= coupling;
        }
        let eigen = nalgebra::SymmetricEigen::new(stiffness);
        let mut order: Vec<usize> = (0..2 * storeys).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let highest = eigen.eigenvalues[order[11]].sqrt();
        let order = &order[..12];
        Self {
            frequencies_hz: order.iter().map(|&mode| 0.93 * eigen.eigenvalues[mode].sqrt() / highest).collect(),
            damping_ratio: 0.01,
            shapes: DMatrix::from_fn(2 * storeys, 12, |row, mode| eigen.eigenvectors[(row, order[mode])]),
        }
    }

    /// A tower: cantilever shapes in two directions and torsion at eight levels; 20 channels, 12 modes, the closest
    /// pair 3.3 % apart.
    pub fn tower() -> Self {
        let frequencies_hz = vec![0.094, 0.138, 0.366, 0.424, 0.475, 0.505, 0.522, 0.795, 0.964, 1.150, 1.191, 1.250];
        // Direction (0, 1, torsion 2) and bending order of each.
        let kinds = [(0, 0), (1, 0), (0, 1), (0, 2), (1, 1), (2, 0), (1, 2), (0, 3), (1, 3), (2, 1), (0, 4), (1, 4)];
        let roots = [1.875_104, 4.694_091, 7.854_757, 10.995_541, 14.137_168];
        let bending = |order: usize, x: f64| {
            let beta: f64 = roots[order];
            let ratio = (beta.cosh() + beta.cos()) / (beta.sinh() + beta.sin());
            let phase = beta * x;
            phase.cosh() - phase.cos() - ratio * (phase.sinh() - phase.sin())
        };
        let heights = [0.07, 0.26, 0.36, 0.44, 0.58, 0.73, 0.86, 1.0];
        // Levels 4 and 8 have four channels, the others two; a third and fourth channel stand off the axis.
        let mut places: Vec<(f64, f64, f64)> = Vec::new();
        for (level, &height) in heights.iter().enumerate() {
            places.push((height, 0.3, 0.4));
            places.push((height, std::f64::consts::FRAC_PI_2 + 0.3, 0.4));
            if level == 3 || level == 7 {
                places.push((height, 0.3 + std::f64::consts::PI, 0.4));
                places.push((height, std::f64::consts::PI * 1.5 + 0.3, 0.4));
            }
        }
        let shapes = DMatrix::from_fn(places.len(), kinds.len(), |row, mode| {
            let (height, azimuth, arm) = places[row];
            match kinds[mode] {
                (0, order) => bending(order, height) * azimuth.cos(),
                (1, order) => bending(order, height) * azimuth.sin(),
                (_, order) => arm * (std::f64::consts::FRAC_PI_2 * (2 * order + 1) as f64 * height).sin() * 2.0,
            }
        });
        Self { frequencies_hz, damping_ratio: 0.008, shapes }
    }

    /// The averaged spectrum of a recording, along the plan that suits its length.
    ///
    /// # Errors
    /// When the recording is too short for the band.
    pub fn recorded(&self, recording: &Recording) -> Result<CrossSpectrum, ModalError> {
        let analysis = Analysis { band_hz: Some(recording.band_hz), ..Analysis::default() };
        let plan = SpectralPlan::choose(&[self.extent(recording)], &analysis)?;
        self.recorded_along(recording, &plan)
    }

    /// What a plan needs to know of a recording.
    pub fn extent(&self, recording: &Recording) -> SetupExtent {
        SetupExtent {
            sampling_rate_hz: recording.sampling_rate_hz,
            rows: (recording.hours * 3600.0 * recording.sampling_rate_hz) as u64,
            channels: self.shapes.nrows(),
            block_rows: None,
        }
    }

    /// The same along a given plan.
    ///
    /// # Errors
    /// When the recording is shorter than a segment.
    pub fn recorded_along(&self, recording: &Recording, plan: &SpectralPlan) -> Result<CrossSpectrum, ModalError> {
        let SetupExtent { sampling_rate_hz: rate, rows, channels, .. } = self.extent(recording);
        let mut rng = ChaCha8Rng::seed_from_u64(recording.seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut oscillators: Vec<Oscillator> =
            self.frequencies_hz.iter().map(|&f| Oscillator::new(f, self.damping_ratio, 1.0 / rate)).collect();
        let variances: Vec<f64> = oscillators
            .iter()
            .map(|oscillator| if recording.velocity { oscillator.velocity_variance() } else { oscillator.variance })
            .collect();
        let rms: Vec<f64> = (0..channels)
            .map(|row| (0..variances.len()).map(|m| self.shapes[(row, m)].powi(2) * variances[m]).sum::<f64>().sqrt())
            .collect();
        let decimation = plan.decimations.first().copied().unwrap_or(1);
        let no_window = || ModalError::Spectra(SpectraError::NoWindows);
        let mut welch = Welch::new(plan.grid, decimation, channels).ok_or_else(no_window)?;
        let windows = plan.windows.first().copied().unwrap_or(0);
        let mut accumulator = CrossSpectrumAccumulator::expecting(plan.grid, channels, windows)?;
        let mut refused = None;
        let mut row = vec![0.0; channels];
        for index in 0..rows {
            let motion: Vec<f64> = oscillators
                .iter_mut()
                .map(|oscillator| {
                    let acceleration = oscillator.next(&mut normal);
                    if recording.velocity { oscillator.velocity } else { acceleration }
                })
                .collect();
            for (channel, value) in row.iter_mut().enumerate() {
                *value = recording.noise * rms[channel] * normal();
                for (mode, motion) in motion.iter().enumerate() {
                    *value += self.shapes[(channel, mode)] * motion;
                }
                if let Some((frequency_hz, share)) = recording.harmonic {
                    let phase = std::f64::consts::TAU * frequency_hz * index as f64 / rate;
                    *value += share * rms[0] * std::f64::consts::SQRT_2 * phase.sin() * (1.0 + channel as f64 / 10.0);
                }
            }
            welch.push(&row, &mut |window| refused = accumulator.add(window).err().or(refused.take()));
        }
        refused.map_or(Ok(()), Err)?;
        Ok(accumulator.finish()?.0)
    }
}

/// ẍ + 2ζω ẋ + ω² x = w under white force, sampled exactly: the pair (x, ẋ) as one complex number turns and decays by
/// exp(λ dt) each step and takes a Gaussian increment of the exact covariance. What comes out is the acceleration
/// averaged over a step (the force's own white part has no instantaneous value), so dt should be well below a period.
struct Oscillator {
    pole: Complex64,
    turn: Complex64,
    z: Complex64,
    /// Lower Cholesky factor of the increment's covariance.
    factor: [f64; 3],
    variance: f64,
    velocity: f64,
    dt: f64,
}

impl Oscillator {
    fn new(frequency_hz: f64, damping_ratio: f64, dt: f64) -> Self {
        let omega = std::f64::consts::TAU * frequency_hz;
        let pole = Complex64::new(-damping_ratio * omega, omega * (1.0 - damping_ratio * damping_ratio).sqrt());
        // z = ∫ exp(λ (t - s)) dW has x = Im z / ω_d. The increment's E[I I*] and E[I I]:
        let turn = (pole * dt).exp();
        let power = ((2.0 * pole.re * dt).exp() - 1.0) / (2.0 * pole.re);
        let square = ((2.0 * pole * dt).exp() - 1.0) / (2.0 * pole);
        let (rr, ii, ri) = ((power + square.re) / 2.0, (power - square.re) / 2.0, square.im / 2.0);
        let a = rr.sqrt();
        let b = ri / a;
        let c = (ii - b * b).max(0.0).sqrt();
        // Stationary variance of the acceleration but for the force's own part, Im(λ² z)/ω_d.
        let power = -1.0 / (2.0 * pole.re);
        let square = -1.0 / (2.0 * pole);
        let gain = pole * pole / pole.im;
        let variance = (gain.norm_sqr() * power - (gain * gain * square).re) / 2.0;
        Self { pole, turn, z: Complex64::ZERO, factor: [a, b, c], variance, velocity: 0.0, dt }
    }

    /// 1/(4ζω) under unit force density.
    fn velocity_variance(&self) -> f64 {
        -1.0 / (4.0 * self.pole.re)
    }

    fn next(&mut self, normal: &mut impl FnMut() -> f64) -> f64 {
        let (u, v) = (normal(), normal());
        self.z = self.turn * self.z + Complex64::new(self.factor[0] * u, self.factor[1] * u + self.factor[2] * v);
        let before = self.velocity;
        self.velocity = (self.pole * self.z).im / self.pole.im;
        (self.velocity - before) / self.dt
    }
}
