//! The level meter: a rough RMS of each channel, and what its readings say about the sensor, for the heartbeat.

use belfry_shared::message::{MAX_CHANNELS, SensorState};
use heapless::Vec;

/// White noise of this RMS in m/s² is some thirty times that of the sensor, sampled at 1000 Hz, and a hundred times that at 50 Hz.
const NOISY_M_S2: f32 = 0.1;
/// Where this share of the power is white, by its second differences, little of it is motion of the structure: a tone has it above 0.15 of the
/// sampling rate. The sensor's noise passes its filters, a fifth power of a sinc: 0.3 of it is white where their rate is the sampling rate, 0.16 where
/// it is 0.8 of that, the least that it can be, and 0.5 at 50 Hz.
const WHITE: f32 = 0.125;

/// A sum in two steps: a minute at 1000 Hz has 60 000 terms, more than an f32 bears one by one.
#[derive(Debug, Clone, Copy)]
struct Sum {
    total: f32,
    part: f32,
}

impl Sum {
    const ZERO: Self = Self { total: 0.0, part: 0.0 };

    fn add(&mut self, term: f32) {
        self.part += term;
    }

    /// Puts what has gathered to the rest.
    fn gather(&mut self) {
        self.total += self.part;
        self.part = 0.0;
    }

    fn value(&self) -> f32 {
        self.total + self.part
    }
}

/// Rows after which sums are gathered.
const GATHER: u32 = 256;

/// Sums over one channel's readings.
#[derive(Debug, Clone, Copy)]
struct Meter {
    rows: u32,
    missing: u32,
    clipped: u32,
    stale: u32,
    changed: bool,
    /// The first reading: sums about it keep their digits, and an offset that has drifted since the node's start counts for nothing.
    reference: Option<f32>,
    /// Of readings about the reference, of their squares, and of squared second differences.
    sum: Sum,
    squares: Sum,
    roughness: Sum,
    /// The last two readings about the reference.
    before: [Option<f32>; 2],
}

impl Meter {
    const START: Self = Self {
        rows: 0,
        missing: 0,
        clipped: 0,
        stale: 0,
        changed: false,
        reference: None,
        sum: Sum::ZERO,
        squares: Sum::ZERO,
        roughness: Sum::ZERO,
        before: [None; 2],
    };

    fn add(&mut self, reading: Option<f32>, full_scale: f32) {
        self.rows = self.rows.saturating_add(1);
        let Some(reading) = reading else {
            self.missing += 1;
            self.before = [None; 2];
            return;
        };
        self.clipped += u32::from(reading.abs() >= full_scale);
        let about = reading - *self.reference.get_or_insert(reading);
        self.sum.add(about);
        self.squares.add(about * about);
        self.changed |= self.before[1].is_some_and(|before| before != about);
        if let [Some(first), Some(second)] = self.before {
            let bend = first - 2.0 * second + about;
            self.roughness.add(bend * bend);
        }
        self.before = [self.before[1], Some(about)];
        if self.rows.is_multiple_of(GATHER) {
            [&mut self.sum, &mut self.squares, &mut self.roughness].into_iter().for_each(Sum::gather);
        }
    }

    fn state(&self) -> SensorState {
        // Second differences of white noise have six times its variance.
        let (power, white) = (self.variance(), self.roughness.value() / (6.0 * self.taken()));
        if self.missing == self.rows {
            // While it is started anew it gives none.
            if 2 * self.stale > self.rows { SensorState::Unsynchronised } else { SensorState::Absent }
        } else if !self.changed {
            SensorState::Stuck
        } else if self.missing > 0 {
            SensorState::Failing
        } else if self.clipped > 0 {
            SensorState::Clipped
        } else if white > NOISY_M_S2 * NOISY_M_S2 && white > WHITE * power {
            SensorState::Noisy
        } else {
            SensorState::Sound
        }
    }

    /// Readings, to divide sums by; 1 where there are none, whose sums are 0.
    fn taken(&self) -> f32 {
        self.rows.saturating_sub(self.missing).max(1) as f32
    }

    fn mean_about_reference(&self) -> f32 {
        self.sum.value() / self.taken()
    }

    fn variance(&self) -> f32 {
        let mean = self.mean_about_reference();
        (self.squares.value() / self.taken() - mean * mean).max(0.0)
    }

    fn mean(&self) -> f32 {
        self.reference.unwrap_or(0.0) + self.mean_about_reference()
    }

    /// The square root is micromath's, up to 6 % off: enough to tell a live sensor from a dead one. Who wants more takes the variance.
    fn level(&self) -> f32 {
        let variance = self.variance();
        // The fast root of 0 is a little more than 0.
        if variance > 0.0 { micromath::F32(variance).sqrt().0 } else { 0.0 }
    }
}

/// What a meter has read, a value a channel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Levels {
    /// RMS about the mean in m/s², to 6 %.
    pub(crate) level: Vec<f32, MAX_CHANNELS>,
    /// Variance about the mean in (m/s²)².
    pub(crate) variance: Vec<f32, MAX_CHANNELS>,
    /// Mean in m/s².
    pub(crate) mean: Vec<f32, MAX_CHANNELS>,
    /// What the readings say about the sensors.
    pub(crate) sensors: Vec<SensorState, MAX_CHANNELS>,
}

/// Sums until it is read, then starts again.
#[derive(Debug, Clone)]
pub(crate) struct LevelMeter {
    channels: [Meter; MAX_CHANNELS],
}

impl LevelMeter {
    /// A meter that has seen nothing.
    pub(crate) const START: Self = Self { channels: [Meter::START; MAX_CHANNELS] };

    /// Adds a reading of a channel in m/s²; `None` where it is missing.
    pub(crate) fn add(&mut self, channel: usize, reading: Option<f32>, full_scale: f32) {
        if let Some(meter) = self.channels.get_mut(channel) {
            meter.add(reading, full_scale);
        }
    }

    /// Notes that the last row was missing because the sensor had taken no sample.
    pub(crate) fn note_stale(&mut self) {
        for meter in &mut self.channels {
            meter.stale = meter.stale.saturating_add(1);
        }
    }

    /// What the first `channels` channels have shown since the last call.
    pub(crate) fn take(&mut self, channels: usize) -> Levels {
        let taken = core::mem::replace(self, Self::START);
        let meters = taken.channels.iter().take(channels);
        Levels {
            level: meters.clone().map(Meter::level).collect(),
            variance: meters.clone().map(Meter::variance).collect(),
            mean: meters.clone().map(Meter::mean).collect(),
            sensors: meters.map(Meter::state).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_is_within_six_percent_of_the_rms() {
        for exponent in -60..20 {
            let amplitude = 1.37_f32.powi(exponent);
            let mut meter = LevelMeter::START;
            for n in 0..1000 {
                let value = amplitude * (0.3 * n as f32).sin();
                meter.add(0, Some(value), f32::INFINITY);
            }
            let level = meter.take(1).level[0];
            let rms = amplitude / 2.0_f32.sqrt();
            assert!((level / rms - 1.0).abs() < 0.065, "{level} for {rms}");
        }
        let mut unused = LevelMeter::START;
        assert_eq!(unused.take(2).level.as_slice(), &[0.0, 0.0]);
    }

    #[test]
    fn a_sensor_that_is_absent_stuck_failing_clipped_or_noisy_is_told_from_a_sound_one() {
        let state = |reading: &dyn Fn(u32) -> Option<f32>| {
            let mut meter = LevelMeter::START;
            for n in 0..500 {
                let value = reading(n);
                meter.add(0, value, 19.6);
            }
            meter.take(1).sensors[0]
        };
        let swaying = |n: u32| 9.81 + 0.5 * (0.1 * n as f32).sin();
        let noise = |n: u32| (n.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32 - 0.5;
        assert_eq!(state(&|_| None), SensorState::Absent);
        assert_eq!(state(&|_| Some(3.0)), SensorState::Stuck);
        assert_eq!(state(&|n| (n != 100).then(|| swaying(n))), SensorState::Failing);
        assert_eq!(state(&|n| Some(if n == 100 { -19.6 } else { swaying(n) })), SensorState::Clipped);
        assert_eq!(state(&|n| Some(9.81 + noise(n))), SensorState::Noisy);
        assert_eq!(state(&|n| Some(swaying(n) + 0.01 * noise(n))), SensorState::Sound);
        assert_eq!(state(&|n| Some(9.81 + 0.01 * noise(n))), SensorState::Sound, "a quiet night");
    }

    #[test]
    fn the_variance_is_that_of_the_motion_however_far_the_offset_has_drifted() {
        let mut meter = LevelMeter::START;
        // Two minutes at 1000 Hz: 1 mm/s² of motion on 1 g, after an offset that has wandered by 0.1 m/s² since the start.
        meter.add(0, Some(9.7), 19.6);
        meter.take(1);
        for n in 0..120_000 {
            meter.add(0, Some(9.8 + 1e-3 * (0.37 * n as f32).sin()), 19.6);
        }
        let levels = meter.take(1);
        // An f32 has steps of 1 µm/s² at 9.8 m/s², which is 0.1 % of this motion; rounding is evenly spread.
        assert!((levels.variance[0] / 0.5e-6 - 1.0).abs() < 0.005, "{}", levels.variance[0]);
        assert!((levels.mean[0] - 9.8).abs() < 2e-6, "{}", levels.mean[0]);
    }
}
