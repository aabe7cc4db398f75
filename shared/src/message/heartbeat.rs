//! Signs of life: which windows there are, what was lost, and the state of sensors and board.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::configuration::MAX_CHANNELS;
use super::growth;

/// A sign of life.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Heartbeat {
    /// The node's id.
    pub node: u16,
    /// The node's boot id.
    pub boot: u32,
    /// The number the next window will have. All lower ones exist or existed.
    pub next_window: u32,
    /// The oldest window still in the outbox (`next_window` if it is empty).
    pub oldest_window: u32,
    /// Windows dropped from a full outbox since the start.
    pub lost_windows: u32,
    /// Frames from the host that arrived damaged or could not be understood, since the start.
    pub damaged_frames: u32,
    /// Messages from hosts that it did not take, since the start: of a host that had not greeted last, or acknowledgements of
    /// windows that there are not yet.
    pub refused_messages: u32,
    /// Each channel's level: the RMS of the raw reading about its mean in m/s² since the last heartbeat. Good to 6 % only (a
    /// fast square root): enough to tell a live sensor from a dead one, not a measurement.
    pub level: Vec<f32, MAX_CHANNELS>,
    /// What each channel's readings since the last heartbeat say about its sensor.
    pub sensors: Vec<SensorState, MAX_CHANNELS>,
    /// Samples that never arrived since the start, in rows of all channels.
    pub lost_rows: u32,
    /// State of its board.
    #[serde(with = "growth::delimited")]
    pub board: BoardState,
    /// Messages from hosts that only a later version of its program would know, since the start.
    pub unknown_messages: u32,
    /// Messages from hosts without a seal, with a wrong one, or heard before, since the start; 0 of a node without a key.
    pub unsealed_messages: u32,
    /// Rows since the start for which the sensor answered and had taken no new sample.
    #[serde(default)]
    pub stale_rows: u32,
    /// The variance of each channel's raw readings about their mean since the last heartbeat, in (m/s²)². Empty of a node that does not say: one
    /// that sends densities has no bytes for it.
    #[serde(default)]
    pub variance: Vec<f32, MAX_CHANNELS>,
    /// That mean in steps of [`MEAN_STEP_M_S2`], which are fewer bytes. Empty of a node that does not say.
    #[serde(default)]
    pub mean: Vec<i32, MAX_CHANNELS>,
}

/// The step of means in m/s²: 10 µg, below what a sensor's offset keeps for a minute.
pub const MEAN_STEP_M_S2: f32 = 1e-4;

impl Heartbeat {
    /// Means of channels in m/s², as a heartbeat has them.
    pub fn means_of(mean_m_s2: &[f32]) -> Vec<i32, MAX_CHANNELS> {
        // Beyond its range the conversion keeps the nearest number, and 0 of what is none.
        mean_m_s2.iter().map(|mean| libm::roundf(mean / MEAN_STEP_M_S2) as i32).take(MAX_CHANNELS).collect()
    }

    /// Each channel's mean since the last heartbeat in m/s². Empty of a node that does not say.
    pub fn mean_m_s2(&self) -> Vec<f32, MAX_CHANNELS> {
        self.mean.iter().map(|&mean| mean as f32 * MEAN_STEP_M_S2).collect()
    }

    /// Each channel's RMS about its mean since the last heartbeat in m/s²: the root of its variance where the node says that, else its level.
    pub fn rms(&self) -> Vec<f32, MAX_CHANNELS> {
        if self.variance.is_empty() {
            return self.level.clone();
        }
        self.variance.iter().map(|&variance| libm::sqrtf(variance)).collect()
    }
}

/// What readings say about a sensor; the first that is true.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SensorState {
    /// There was no reading.
    #[error("absent: it gives no readings")]
    Absent,
    /// All readings were equal.
    #[error("stuck: all readings are identical")]
    Stuck,
    /// Some readings were missing.
    #[error("failing: readings are missing")]
    Failing,
    /// Some readings were at the end of the range.
    #[error("clipped: readings at the end of its range")]
    Clipped,
    /// Readings jump more than any structure moves.
    #[error("noisy: readings jump more than any structure moves")]
    Noisy,
    /// Nothing is wrong.
    #[error("sound")]
    Sound,
    /// It answers, and takes no samples.
    #[error("without pulses: it answers and takes no samples; check the wire to its DRDY pin")]
    Unsynchronised,
    /// Something of which only a later version knows.
    #[error("in a state that this version of Belfry does not know")]
    #[serde(other)]
    Unknown,
}

/// State of a node's board; zeros for a node without one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BoardState {
    /// Size of the stack in bytes.
    pub stack_bytes: u32,
    /// Bytes of the stack that were never used since the start.
    pub stack_free_bytes: u32,
    /// Longest time between looks at the queue of samples since the start, in µs. While the program works (on a spectrum,
    /// mostly), interrupts still fetch samples on time, but the queue must hold them for this long.
    pub longest_step_us: u32,
    /// Longest delay of a sample's interrupt since the start, in ns after the timer requested it. The timer's pulse, which
    /// nothing delays, makes the sensor sample; the interrupt has to fetch the sample before the next pulse.
    pub latest_sample_ns: u32,
    /// The sensor's temperature in units of 0.01 °C; `None` without a sensor.
    pub temperature_centi_c: Option<i16>,
    /// Frames from the host that were dropped since the start, because they came faster than the program could take them. Some of
    /// them count as damaged as well.
    pub dropped_frames: u32,
    /// How much the sensor's own oscillator was fast when it started, in ppm; `None` without a sensor, or of a node that does not say.
    #[serde(default)]
    pub oscillator_ppm: Option<i32>,
    /// Longest time since the start from a sample's request to its end in memory, in µs; 0 of a node that does not say. Times the sampling rate,
    /// it is the most of the processor's time that sampling takes.
    #[serde(default)]
    pub longest_fetch_us: u32,
}
