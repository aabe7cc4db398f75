//! The truth of a simulated recording: what identification, comparison and diagnosis are held against.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::Options;
use crate::model::effect::{Effect, EffectRecord};
use crate::study::Setup;

/// What is true of a simulated recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Effects in the simulated structure.
    pub effects: Vec<EffectRecord>,
    /// The modes in the recording, lowest first: all below 0.9 of the Nyquist rate, however weak.
    pub modes: Vec<TrueMode>,
    /// The sensors that the shapes run over, setup by setup.
    pub channels: Vec<TrueChannel>,
    /// Sensor noise in percent of each channel's RMS.
    pub noise_percent: f64,
    /// The seed.
    pub seed: u64,
}

/// A mode of the simulated structure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrueMode {
    /// Undamped frequency in Hz.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Motion at each of the truth's channels in their positive directions, the largest +1; all zero where no sensor
    /// sees the mode.
    pub shape: Vec<f64>,
    /// The largest component before it was made one, in the mass-normalised shape (1/√kg): the modal mass that belongs
    /// to `shape` is the inverse of its square.
    pub largest_mass_normalised: f64,
    /// RMS of this mode's part in each channel's samples, in its setup's unit: tells the modes that a recording shows
    /// from those that are only there.
    pub rms: Vec<f64>,
}

/// A sensor of a simulated recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrueChannel {
    /// The setup's name.
    pub setup: String,
    /// The channel's name.
    pub channel: String,
}

impl Truth {
    /// The truth of one setup. `motion` and `sensor_shapes` are channels x modes, in m and in the setup's unit;
    /// `modal_covariance` is that of the modal outputs.
    pub(super) fn new(
        setup: &Setup,
        effects: &[Effect],
        options: &Options,
        frequencies_hz: &[f64],
        motion: &DMatrix<f64>,
        sensor_shapes: &DMatrix<f64>,
        modal_covariance: &DMatrix<f64>,
    ) -> Self {
        let modes = frequencies_hz.iter().enumerate().map(|(mode, &frequency_hz)| {
            let modal_rms = modal_covariance[(mode, mode)].max(0.0).sqrt();
            TrueMode {
                frequency_hz,
                damping_ratio: options.damping_ratio,
                shape: motion.column(mode).iter().copied().collect(),
                largest_mass_normalised: 1.0,
                rms: sensor_shapes.column(mode).iter().map(|value| value.abs() * modal_rms).collect(),
            }
        });
        let channels = setup
            .sensors
            .iter()
            .map(|sensor| TrueChannel { setup: setup.name.clone(), channel: sensor.channel.clone() });
        let mut truth = Self {
            effects: effects.iter().map(Effect::record).collect(),
            modes: modes.collect(),
            channels: channels.collect(),
            noise_percent: options.noise_percent,
            seed: options.seed,
        };
        truth.normalise();
        truth
    }

    /// One truth over the sensors of several setups on the same structure, with the modes that all their bands hold.
    /// `None` for no setup.
    pub fn joined<'a>(truths: impl IntoIterator<Item = &'a Truth>) -> Option<Truth> {
        let mut truths = truths.into_iter();
        let mut joined = truths.next()?.clone();
        joined.scale_back();
        for truth in truths {
            let mut part = truth.clone();
            part.scale_back();
            joined.modes.truncate(part.modes.len());
            for (mode, part) in joined.modes.iter_mut().zip(part.modes) {
                mode.shape.extend(part.shape);
                mode.rms.extend(part.rms);
            }
            joined.channels.extend(part.channels);
        }
        joined.normalise();
        Some(joined)
    }

    /// From mass-normalised shapes to a largest component of one.
    fn normalise(&mut self) {
        for mode in &mut self.modes {
            let largest = mode.shape.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
            mode.largest_mass_normalised = largest;
            if largest != 0.0 {
                mode.shape.iter_mut().for_each(|value| *value /= largest);
            }
        }
    }

    /// Back to mass-normalised shapes, whose signs and sizes agree between setups.
    fn scale_back(&mut self) {
        for mode in &mut self.modes {
            let largest = mode.largest_mass_normalised;
            mode.shape.iter_mut().for_each(|value| *value *= largest);
        }
    }
}
