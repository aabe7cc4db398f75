//! The modal oscillators: modal forces flow in, modal accelerations or velocities flow out, sample by sample, exactly.
//!
//! With `q'' + 2 zeta w q' + w² q = p` and the pole `l = -zeta w + i w sqrt(1 - zeta²)`, the complex state `s = q' - conj(l) q`
//! obeys `s' = l s + p`. A force held over a sample of length dt (zero-order hold) therefore gives, without error,
//! `s(k+1) = z s(k) + (z - 1)/l p(k)` with `z = exp(l dt)` (Franklin, Powell, Workman, "Digital Control of Dynamic
//! Systems", section 4.3): poles, and so frequencies and damping, are those of the structure at any sampling rate.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// What comes out of an oscillator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// q'', the force of the coming sample included.
    Acceleration,
    /// q'.
    Velocity,
}

/// Oscillators of unit modal mass side by side; one vector a coefficient, so that a step is a loop over modes.
#[derive(Debug, Clone)]
pub(super) struct OscillatorBank {
    /// z, real and imaginary.
    turn: [Vec<f64>; 2],
    /// (z - 1)/l, real and imaginary.
    gain: [Vec<f64>; 2],
    /// Output from the state's real and imaginary part.
    output: [Vec<f64>; 2],
    /// Output from the present force: 1 for accelerations, 0 for velocities.
    feedthrough: f64,
    /// s, real and imaginary.
    state: [Vec<f64>; 2],
}

impl OscillatorBank {
    /// Oscillators at rest.
    pub(super) fn new(frequencies_hz: &[f64], damping_ratio: f64, sampling_rate_hz: f64, quantity: Quantity) -> Self {
        let modes = frequencies_hz.len();
        let pair = || [Vec::with_capacity(modes), Vec::with_capacity(modes)];
        let (mut turn, mut gain, mut output) = (pair(), pair(), pair());
        let push = |pair: &mut [Vec<f64>; 2], [first, second]: [f64; 2]| {
            pair[0].push(first);
            pair[1].push(second);
        };
        for frequency_hz in frequencies_hz {
            let omega = TAU * frequency_hz;
            let damped = omega * (1.0 - damping_ratio * damping_ratio).sqrt();
            let pole = Complex64::new(-damping_ratio * omega, damped);
            let z = (pole / sampling_rate_hz).exp();
            let held = (z - 1.0) / pole;
            push(&mut turn, [z.re, z.im]);
            push(&mut gain, [held.re, held.im]);
            // q = Im s / damped and q' = Re s - zeta w q, so q'' = p - 2 zeta w q' - w² q.
            let lag = damping_ratio * omega / damped;
            push(
                &mut output,
                match quantity {
                    Quantity::Velocity => [1.0, -lag],
                    Quantity::Acceleration => {
                        let friction = 2.0 * damping_ratio * omega;
                        [-friction, friction * lag - omega * omega / damped]
                    }
                },
            );
        }
        let feedthrough = match quantity {
            Quantity::Acceleration => 1.0,
            Quantity::Velocity => 0.0,
        };
        Self { turn, gain, output, feedthrough, state: [vec![0.0; modes], vec![0.0; modes]] }
    }

    /// One sample: takes the modal forces and leaves the output in their place.
    pub(super) fn step(&mut self, forces: &mut [f64]) {
        let [real, imaginary] = &mut self.state;
        let ([turn_re, turn_im], [gain_re, gain_im], [out_re, out_im]) = (&self.turn, &self.gain, &self.output);
        // Equal lengths, said once, spare the loop its bounds checks.
        let modes = forces.len().min(real.len());
        let (real, imaginary, forces) = (&mut real[..modes], &mut imaginary[..modes], &mut forces[..modes]);
        let (turn_re, turn_im) = (&turn_re[..modes], &turn_im[..modes]);
        let (gain_re, gain_im) = (&gain_re[..modes], &gain_im[..modes]);
        let (out_re, out_im) = (&out_re[..modes], &out_im[..modes]);
        for mode in 0..modes {
            let (re, im, force) = (real[mode], imaginary[mode], forces[mode]);
            forces[mode] = self.feedthrough * force + out_re[mode] * re + out_im[mode] * im;
            real[mode] = turn_re[mode] * re - turn_im[mode] * im + gain_re[mode] * force;
            imaginary[mode] = turn_im[mode] * re + turn_re[mode] * im + gain_im[mode] * force;
        }
    }

    /// Covariance of the stationary state (all real parts, then all imaginary parts) under white modal forces of this
    /// covariance: the discrete Lyapunov equation, which for single complex poles is a geometric series each.
    pub(super) fn stationary_covariance(&self, forces: &DMatrix<f64>) -> DMatrix<f64> {
        let modes = self.state[0].len();
        let complex = |pair: &[Vec<f64>; 2], mode: usize| Complex64::new(pair[0][mode], pair[1][mode]);
        let mut covariance = DMatrix::zeros(2 * modes, 2 * modes);
        for r in 0..modes {
            let (z_r, g_r) = (complex(&self.turn, r), complex(&self.gain, r));
            for s in 0..modes {
                let (z_s, g_s) = (complex(&self.turn, s), complex(&self.gain, s));
                // E[s_r conj(s_s)] and E[s_r s_s].
                let hermitian = g_r * g_s.conj() * forces[(r, s)] / (1.0 - z_r * z_s.conj());
                let plain = g_r * g_s * forces[(r, s)] / (1.0 - z_r * z_s);
                covariance[(r, s)] = 0.5 * (hermitian + plain).re;
                covariance[(modes + r, modes + s)] = 0.5 * (hermitian - plain).re;
                covariance[(r, modes + s)] = 0.5 * (plain - hermitian).im;
                covariance[(modes + r, s)] = 0.5 * (plain + hermitian).im;
            }
        }
        covariance
    }

    /// Covariance of the outputs, modes x modes; the present force is independent of the state.
    pub(super) fn output_covariance(&self, state: &DMatrix<f64>, forces: &DMatrix<f64>) -> DMatrix<f64> {
        let modes = self.state[0].len();
        let output = DMatrix::from_fn(modes, 2 * modes, |mode, column| match column.checked_sub(modes) {
            None if column == mode => self.output[0][mode],
            Some(imaginary) if imaginary == mode => self.output[1][mode],
            _ => 0.0,
        });
        &output * state * output.transpose() + forces * (self.feedthrough * self.feedthrough)
    }

    /// Puts the oscillators into a state of this covariance, drawn with unit normals (two a mode).
    pub(super) fn start_from(&mut self, covariance: &DMatrix<f64>, normals: &DVector<f64>) {
        let start = semidefinite_factor(covariance) * normals;
        let modes = self.state[0].len();
        for mode in 0..modes {
            self.state[0][mode] = start[mode];
            self.state[1][mode] = start[modes + mode];
        }
    }
}

/// Lower triangular L with L Lᵀ the given covariance; a direction without variance (up to rounding) gets none. Modes
/// that no load reaches and twins that all loads drive alike make the covariance singular.
fn semidefinite_factor(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let size = covariance.nrows();
    let mut lower = DMatrix::<f64>::zeros(size, size);
    for column in 0..size {
        let known = lower.row(column).columns(0, column).norm_squared();
        let pivot = covariance[(column, column)] - known;
        if pivot <= 1e-12 * covariance[(column, column)] {
            continue;
        }
        let root = pivot.sqrt();
        lower[(column, column)] = root;
        for row in column + 1..size {
            let shared = lower.row(row).columns(0, column).dot(&lower.row(column).columns(0, column));
            lower[(row, column)] = (covariance[(row, column)] - shared) / root;
        }
    }
    lower
}
