//! Machines on a structure: forces of one frequency at one place.

use std::f64::consts::TAU;

use nalgebra::{Complex, DVector};
use rand::{Rng, RngExt};

use super::structure::Structure;

/// A machine near a mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Machine {
    /// The mode that it is above, counted from 0.
    pub(super) mode: usize,
    /// By how many of its half-power bandwidths.
    pub(super) bandwidths: f64,
    /// How it runs.
    pub(super) runs: Runs,
}

/// How a machine runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Runs {
    /// At one speed.
    Steadily,
    /// Its frequency wanders by this share to either side, up and down in ten minutes or so.
    Wandering(f64),
    /// It goes on and off, for so many seconds on average.
    OnAndOff(f64),
}

/// Root mean square of what it adds to the channel that it moves most, over that channel's own.
const SIZE: f64 = 0.5;

impl Machine {
    /// Its mean frequency in Hz.
    pub(super) fn frequency_hz(&self, structure: &Structure) -> f64 {
        structure.frequencies_hz[self.mode] * (1.0 + 2.0 * self.bandwidths * structure.damping[self.mode])
    }

    /// Adds its motion to samples, row by row.
    pub(super) fn shake(&self, samples: &mut [f32], structure: &Structure, rate_hz: f64, random: &mut impl Rng) {
        let channels = structure.places.len();
        let hz = self.frequency_hz(structure);
        let stands_at = random.random_range(0..channels);
        let modes = structure.frequencies_hz.iter().zip(&structure.damping).enumerate();
        let motion = modes.fold(DVector::from_element(channels, Complex::from(0.0)), |sum, (mode, (own_hz, zeta))| {
            let response = Complex::from(-hz * hz) / Complex::new(own_hz * own_hz - hz * hz, 2.0 * zeta * own_hz * hz);
            let shape = structure.shapes.column(mode);
            sum + shape.map(Complex::from) * (response * shape[stands_at])
        });
        let most = motion.icamax();
        let rows = samples.len() / channels;
        let power: f64 = samples.iter().skip(most).step_by(channels).map(|value| f64::from(*value).powi(2)).sum();
        let motion = motion.scale(SIZE * (2.0 * power / rows as f64).sqrt() / motion[most].norm());
        let (mut phase, mut is_on, start) = (random.random_range(0.0..TAU), true, random.random_range(0.0..TAU));
        for (row, values) in samples.chunks_mut(channels).enumerate() {
            let here_hz = match self.runs {
                Runs::Wandering(share) => hz * (1.0 + share * (start + TAU * row as f64 / rate_hz / 600.0).sin()),
                Runs::Steadily | Runs::OnAndOff(_) => hz,
            };
            if let Runs::OnAndOff(seconds) = self.runs
                && random.random_bool(1.0 / (seconds * rate_hz))
            {
                is_on = !is_on;
            }
            phase = (phase + TAU * here_hz / rate_hz) % TAU;
            if is_on {
                let turn = Complex::from_polar(1.0, phase);
                values.iter_mut().zip(&motion).for_each(|(value, motion)| *value += (motion * turn).re as f32);
            }
        }
    }
}
