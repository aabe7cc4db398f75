//! Simulation: recordings of a structure whose truth is known.
//!
//! A beam or imported matrices with effects and a setup's sensors flow in; rows of samples in the setup's unit flow out, as many as asked for,
//! in blocks of constant memory, and with them the [`Truth`] that an identification should find.
//!
//! The structure is a sum of its modes below 0.9 of the Nyquist rate, all with one damping ratio. It is loaded by white
//! noise: forces in X and Y, coherent over a tenth of the height, and a small torsional moment at every node; upward forces as well where nodes
//! stand in space (see the `loading` module for their levels). A force is held over each sample, which leaves sinc²(f/fs) of its density: 0.4 % less at a thirtieth of the
//! sampling rate, 60 % at the Nyquist rate. The response is stationary from the first row; white sensor noise is added.
//! A `harmonic` is a sine beside the random force, growing in from the first row; late clocks delay channels.

mod file;
mod late;
mod loading;
pub mod modal;
mod oscillator;
mod plan;
mod scatter;
#[cfg(test)]
mod tests;
mod truth;

use std::f64::consts::TAU;
use std::path::PathBuf;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

use crate::model::effect::{Effect, EffectError, EffectKind, Evidence, Where};
use crate::model::{Assembly, BeamTable, EigenError, SensorError, Structure};
use crate::study::{Motion, STANDARD_GRAVITY_M_S2, Setup, Unit};
use late::LateChannels;
pub(crate) use loading::Loading;
use oscillator::{OscillatorBank, Quantity};
pub use plan::{AdoptError, PlanError, PlannedRecording, adopt, plan};
pub use scatter::{scatter_groups, scattered};
pub use truth::{TrueChannel, TrueMode, Truth};

/// Rows that are made at once: the matrix products are efficient and the block stays in the cache.
const BLOCK_ROWS: usize = 256;

/// Modes above this share of the Nyquist rate are left out: the record could not show them.
const HIGHEST_MODE_IN_NYQUIST: f64 = 0.9;

/// How to simulate.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Damping ratio of every mode, 0.0001 to 0.5.
    pub damping_ratio: f64,
    /// Standard deviation of the white sensor noise in percent of each channel's own RMS response (whole band).
    pub noise_percent: f64,
    /// Square root of the one-sided spectral density of the acceleration that the total horizontal load would give the
    /// whole mass if it moved rigidly, in m/s²/√Hz, each in X and Y.
    pub load_level_m_s2_per_root_hz: f64,
    /// Same seed and stream, same bytes.
    pub seed: u64,
    /// Distance over which loads are coherent: forces so far apart have the correlation 1/e. 0 for independent ones; `None` for a
    /// tenth of the height.
    pub coherence_length_m: Option<f64>,
    /// Which of many independent recordings of one seed; a study's setups count through.
    pub stream: u32,
}

impl Default for Options {
    /// 0.8 % damping, 2 % noise, and a load that shakes the top of the Canton Tower's body (443.6 m) by 3e-4 m/s² RMS
    /// over the whole band of a 50 Hz recording, 1.9e-4 m/s² of it below 1.5 Hz.
    fn default() -> Self {
        Self {
            damping_ratio: 0.008,
            noise_percent: 2.0,
            load_level_m_s2_per_root_hz: 7.8e-6,
            coherence_length_m: None,
            seed: 0,
            stream: 0,
        }
    }
}

/// Why there is no simulation.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// An option is outside its range.
    #[error("{option} = {value} is out of range; it must be {range}")]
    Option {
        /// The option.
        option: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        range: &'static str,
    },
    /// Sensors of different kinds, or of displacement.
    #[error(
        "setup {setup}: only accelerations, or only velocities, can be simulated; give all its sensors such a unit"
    )]
    Motion {
        /// The setup.
        setup: String,
    },
    /// A setup without sensors.
    #[error("setup {setup}: no sensors; nothing would be recorded")]
    NoSensors {
        /// The setup.
        setup: String,
    },
    /// A setup in volts without a sensitivity.
    #[error(
        "setup {setup}, channel {channel}: the setup is in V, so the sensor needs a sensitivity above 0 in V per m/s²"
    )]
    NoSensitivity {
        /// The setup.
        setup: String,
        /// The channel.
        channel: String,
    },
    /// No mode in the band.
    #[error(
        "the lowest mode is at {lowest_hz:.4} Hz, above 0.9 of the Nyquist rate of {sampling_rate_hz} Hz sampling; sample faster"
    )]
    NoModeInBand {
        /// The structure's lowest frequency.
        lowest_hz: f64,
        /// The setup's sampling rate.
        sampling_rate_hz: f64,
    },
    /// The structure's matrices have no modes.
    #[error(transparent)]
    Eigen(#[from] EigenError),
    /// A sensor has no place on the structure.
    #[error("setup {setup}: {source}")]
    Sensor {
        /// The setup.
        setup: String,
        /// Which sensor and why.
        source: SensorError,
    },
    /// An effect does not fit this beam.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// An effect that this simulation does not show.
    #[error(
        "{kind} cannot be simulated; possible are effects of the structure's matrices, of its sensors and their clocks, and steady forces"
    )]
    NotShown {
        /// The kind.
        kind: &'static str,
    },
    /// The recording cannot be written.
    #[error("{file}: cannot be written ({source})", file = .file.display())]
    Write {
        /// The recording.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Of the structure's height, or its longest side, how far loads are coherent where nothing else is said: gusts of 40 m at the lowest modes of a tower of
/// 400 m.
const COHERENT_SHARE: f64 = 0.1;

/// The distance over which loads are coherent where nothing else is said.
pub(crate) fn default_coherence_length_m(assembly: &Assembly) -> f64 {
    COHERENT_SHARE * assembly.size_m()
}

/// A running simulation of one setup.
#[derive(Debug, Clone)]
pub struct Simulation {
    truth: Truth,
    sampling_rate_hz: f64,
    bank: OscillatorBank,
    /// Modal forces from unit normals, modes x loads.
    modal_loads: DMatrix<f64>,
    /// Modal response to channels, channels x modes, in the setup's unit.
    sensor_shapes: DMatrix<f64>,
    channel_rms: Vec<f64>,
    noise_std: Vec<f64>,
    load_random: ChaCha8Rng,
    noise_random: ChaCha8Rng,
    normals: DMatrix<f64>,
    modal: DMatrix<f64>,
    response: DMatrix<f64>,
    block: Vec<f32>,
    /// Rows of `block` already handed out.
    used_rows: usize,
    /// Steady forces.
    tones: Vec<Tone>,
    /// Where clocks are off.
    late: Option<LateChannels>,
}

/// A steady force at one frequency: its amplitude on each mode, and its phase at the next sample.
#[derive(Debug, Clone)]
struct Tone {
    modal_force: DVector<f64>,
    phase_rad: f64,
    step_rad: f64,
}

/// Amplitude of a steady force in standard deviations of the random one, in each sample.
const TONE: f64 = 0.3;
/// Delays beyond this are no matter of clocks, s.
const LONGEST_DELAY_S: f64 = 60.0;

impl Simulation {
    /// A simulation of a beam, clamped but for what the effects free, as `setup` would record it.
    ///
    /// # Errors
    /// [`SimulationError`], as [`Simulation::new`], and effects that do not fit the beam.
    pub fn of_beam(
        beam: BeamTable,
        effects: &[Effect],
        setup: &Setup,
        options: &Options,
    ) -> Result<Self, SimulationError> {
        let assembly = Structure::with_effects(beam, effects)?.assemble();
        Self::new(&assembly, effects, setup, options)
    }

    /// A simulation of an assembled structure; `effects` are what is already in it, for the truth to name.
    ///
    /// # Errors
    /// [`SimulationError`]: an option out of range, a sensor off the structure, no mode in the recording's band.
    pub fn new(
        assembly: &Assembly,
        effects: &[Effect],
        setup: &Setup,
        options: &Options,
    ) -> Result<Self, SimulationError> {
        check(options, setup)?;
        if let Some(effect) = effects.iter().find(|effect| !can_show(effect.of_kind())) {
            return Err(SimulationError::NotShown { kind: effect.kind() });
        }
        let sampling_rate_hz = setup.sampling_rate_hz;
        let modes = assembly.modes()?;
        let highest_hz = HIGHEST_MODE_IN_NYQUIST * sampling_rate_hz / 2.0;
        let kept = modes.frequency_hz.partition_point(|&frequency_hz| frequency_hz <= highest_hz);
        if kept == 0 {
            let lowest_hz = modes.frequency_hz.first().copied().unwrap_or(f64::INFINITY);
            return Err(SimulationError::NoModeInBand { lowest_hz, sampling_rate_hz });
        }
        let frequencies_hz = modes.frequency_hz.get(..kept).unwrap_or(&modes.frequency_hz);
        let shapes = modes.shapes.columns(0, kept).into_owned();

        let rows = assembly
            .sensor_rows(&setup.sensors)
            .map_err(|source| SimulationError::Sensor { setup: setup.name.clone(), source })?;
        let motion = rows * &shapes;
        let mut sensor_shapes = motion.clone();
        for (mut row, factor) in sensor_shapes.row_iter_mut().zip(unit_factors(setup)?) {
            row *= factor;
        }

        let length_m = options.coherence_length_m.unwrap_or_else(|| default_coherence_length_m(assembly));
        let loading = Loading::new(assembly, options.load_level_m_s2_per_root_hz, length_m, sampling_rate_hz);
        let modal_loads = loading.on_modes(assembly.at_rows(&shapes).as_ref());
        let quantity = match setup.common_motion() {
            Some(Motion::Acceleration) => Quantity::Acceleration,
            Some(Motion::Velocity) => Quantity::Velocity,
            Some(Motion::Displacement | Motion::Tilt | Motion::Strain) | None => {
                return Err(SimulationError::Motion { setup: setup.name.clone() });
            }
        };
        let mut bank = OscillatorBank::new(frequencies_hz, options.damping_ratio, sampling_rate_hz, quantity);

        let force_covariance = &modal_loads * modal_loads.transpose();
        let state_covariance = bank.stationary_covariance(&force_covariance);
        let modal_covariance = bank.output_covariance(&state_covariance, &force_covariance);
        let channel_covariance = &sensor_shapes * &modal_covariance * sensor_shapes.transpose();
        let channel_rms: Vec<f64> =
            channel_covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
        let noise_std = channel_rms.iter().map(|rms| rms * options.noise_percent / 100.0).collect();

        // Independent streams, so that more channels do not change the load.
        let stream = |part: u64| {
            let mut random = ChaCha8Rng::seed_from_u64(options.seed);
            // Two streams for each recording; what else is drawn stands far from them.
            random.set_stream(2 * u64::from(options.stream) + (part % 2) + ((part / 2) << 40));
            random
        };
        let (mut load_random, noise_random) = (stream(0), stream(1));
        let start = DVector::from_fn(2 * kept, |_, _| StandardNormal.sample(&mut load_random));
        bank.start_from(&state_covariance, &start);

        let tone = |forced_hz: f64| -> Result<Tone, SimulationError> {
            let (option, range) = ("harmonic: frequency", "above 0, and below 0.9 of the Nyquist rate");
            if !(forced_hz > 0.0 && forced_hz < highest_hz) {
                return Err(SimulationError::Option { option, value: forced_hz, range });
            }
            // As a machine stands: at some nodes more than at others.
            let mut random = stream(2);
            let direction = DVector::from_fn(modal_loads.ncols(), |_, _| StandardNormal.sample(&mut random));
            let step_rad = TAU * forced_hz / sampling_rate_hz;
            Ok(Tone { modal_force: &modal_loads * direction * TONE, phase_rad: 0.0, step_rad })
        };
        let forced = effects.iter().filter_map(|effect| match effect.place() {
            Some(Where::Frequency(hz)) => Some(*hz),
            _ => None,
        });
        let tones: Vec<Tone> = forced.map(tone).collect::<Result<_, _>>()?;
        let delays_s = assembly.sensing.delays_s(&setup.sensors);
        if let Some(&value) = delays_s.iter().flatten().find(|delay| delay.abs() > LONGEST_DELAY_S) {
            return Err(SimulationError::Option { option: "clock-offset: delay", value, range: "-60 to 60 s" });
        }
        let late = delays_s.map(|delays_s| LateChannels::new(&delays_s, sampling_rate_hz, BLOCK_ROWS));

        let truth = Truth::new(setup, effects, options, frequencies_hz, &motion, &sensor_shapes, &modal_covariance);
        let (channels, loads) = (setup.sensors.len(), modal_loads.ncols());
        let mut simulation = Self {
            truth,
            sampling_rate_hz,
            bank,
            modal_loads,
            sensor_shapes,
            channel_rms,
            noise_std,
            load_random,
            noise_random,
            normals: DMatrix::zeros(loads, BLOCK_ROWS),
            modal: DMatrix::zeros(kept, BLOCK_ROWS),
            response: DMatrix::zeros(channels, BLOCK_ROWS),
            block: vec![0.0; channels * BLOCK_ROWS],
            used_rows: BLOCK_ROWS,
            tones,
            late,
        };
        for _ in 0..simulation.late.as_ref().map_or(0, |late| late.blocks_of_silence(BLOCK_ROWS)) {
            simulation.make_block();
        }
        simulation.used_rows = BLOCK_ROWS;
        Ok(simulation)
    }

    /// What an identification of this recording should find.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// Number of channels, in the setup's order.
    pub fn channels(&self) -> usize {
        self.noise_std.len()
    }

    /// Rows per second.
    pub fn sampling_rate_hz(&self) -> f64 {
        self.sampling_rate_hz
    }

    /// Expected RMS of each channel's response over the whole band, in the setup's unit, without the sensor noise.
    pub fn channel_rms(&self) -> &[f64] {
        &self.channel_rms
    }

    /// The next rows, at least one and at most `most`, row after row, each in the setup's channel order and unit. What
    /// they hold does not depend on how many are asked for at a time. Empty only for `most` = 0.
    pub fn next_rows(&mut self, most: usize) -> &[f32] {
        if self.used_rows == BLOCK_ROWS && most > 0 {
            self.make_block();
        }
        let first = self.used_rows;
        self.used_rows = (first + most).min(BLOCK_ROWS);
        let channels = self.channels();
        self.block.get(first * channels..self.used_rows * channels).unwrap_or_default()
    }

    fn make_block(&mut self) {
        self.normals.iter_mut().for_each(|value| *value = StandardNormal.sample(&mut self.load_random));
        self.modal.gemm(1.0, &self.modal_loads, &self.normals, 0.0);
        for mut step in self.modal.column_iter_mut() {
            for tone in &mut self.tones {
                step.axpy(tone.phase_rad.sin(), &tone.modal_force, 1.0);
                tone.phase_rad = (tone.phase_rad + tone.step_rad) % TAU;
            }
            self.bank.step(step.as_mut_slice());
        }
        self.response.gemm(1.0, &self.sensor_shapes, &self.modal, 0.0);
        if let Some(late) = &mut self.late {
            late.delay(&mut self.response);
        }
        let noise_random = &mut self.noise_random;
        let noisy = self.response.iter().zip(self.noise_std.iter().cycle()).map(|(&value, &std)| {
            let normal: f64 = StandardNormal.sample(noise_random);
            (value + std * normal) as f32
        });
        self.block.iter_mut().zip(noisy).for_each(|(slot, value)| *slot = value);
        self.used_rows = 0;
    }
}

/// Whether a simulation can have an effect: those that change with time or damping are not in it.
pub fn can_show(kind: &dyn EffectKind) -> bool {
    matches!(kind.evidence(), Evidence::Modes | Evidence::Phases | Evidence::Kurtosis)
}

fn check(options: &Options, setup: &Setup) -> Result<(), SimulationError> {
    let in_range = |option, value: f64, range: std::ops::RangeInclusive<f64>, words| {
        // NaN lies in no range.
        if range.contains(&value) { Ok(()) } else { Err(SimulationError::Option { option, value, range: words }) }
    };
    in_range("damping ratio", options.damping_ratio, 1e-4..=0.5, "0.0001 to 0.5")?;
    in_range("noise", options.noise_percent, 0.0..=1e4, "0 to 10000 %")?;
    in_range("coherence length", options.coherence_length_m.unwrap_or(0.0), 0.0..=1e6, "0 to 1e6 m")?;
    in_range("load level", options.load_level_m_s2_per_root_hz, 1e-15..=1e3, "1e-15 to 1000 m/s²/√Hz")?;
    in_range("sampling_rate_hz", setup.sampling_rate_hz, 1e-3..=1e6, "0.001 to 1000000 Hz")?;
    if setup.sensors.is_empty() {
        return Err(SimulationError::NoSensors { setup: setup.name.clone() });
    }
    Ok(())
}

/// What each channel's motion in SI units is multiplied with to be in the setup's unit.
fn unit_factors(setup: &Setup) -> Result<Vec<f64>, SimulationError> {
    let factor = |sensor: &crate::study::Sensor| match setup.unit_of(sensor) {
        Unit::MetrePerSecondSquared | Unit::MetrePerSecond | Unit::Metre | Unit::Radian | Unit::Strain => Ok(1.0),
        Unit::StandardGravity => Ok(1.0 / STANDARD_GRAVITY_M_S2),
        Unit::Volt => sensor.sensitivity_v_per_m_s2.filter(|&sensitivity| sensitivity > 0.0).ok_or_else(|| {
            SimulationError::NoSensitivity { setup: setup.name.clone(), channel: sensor.channel.clone() }
        }),
    };
    // What is recorded is what a reader's gain makes right again.
    setup.sensors.iter().map(|sensor| Ok(factor(sensor)? / sensor.gain.unwrap_or(1.0))).collect()
}
