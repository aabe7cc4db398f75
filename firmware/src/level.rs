//! The level meter: a rough RMS of each channel, and what its readings say about the sensor, for the heartbeat.

use belfry_shared::message::{MAX_CHANNELS, SensorState};
use heapless::Vec;

/// White noise of this RMS in m/s² is a hundred times that of the sensor, sampled at 50 Hz.
const NOISY_M_S2: f32 = 0.1;
/// Where this share of the power is white, little of it is motion of the structure.
const WHITE: f32 = 0.5;

/// Sums over one channel's readings.
#[derive(Debug, Clone, Copy)]
struct Meter {
    rows: u32,
    missing: u32,
    clipped: u32,
    changed: bool,
    /// Of squares about the bias, and of squared second differences.
    squares: f32,
    roughness: f32,
    /// The last two readings about the bias.
    before: [Option<f32>; 2],
}

impl Meter {
    const START: Self =
        Self { rows: 0, missing: 0, clipped: 0, changed: false, squares: 0.0, roughness: 0.0, before: [None; 2] };

    fn add(&mut self, reading: Option<f32>, about_bias: f32, full_scale: f32) {
        self.rows = self.rows.saturating_add(1);
        let Some(reading) = reading else {
            self.missing += 1;
            self.before = [None; 2];
            return;
        };
        self.clipped += u32::from(reading.abs() >= full_scale);
        self.squares += about_bias * about_bias;
        self.changed |= self.before[1].is_some_and(|before| before != about_bias);
        if let [Some(first), Some(second)] = self.before {
            let bend = first - 2.0 * second + about_bias;
            self.roughness += bend * bend;
        }
        self.before = [self.before[1], Some(about_bias)];
    }

    fn state(&self) -> SensorState {
        let taken = self.rows.saturating_sub(self.missing).max(1) as f32;
        // Second differences of white noise have six times its variance.
        let (power, white) = (self.squares / taken, self.roughness / (6.0 * taken));
        if self.missing == self.rows {
            SensorState::Absent
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

    /// The square root is micromath's, up to 6 % off: enough to tell a live sensor from a dead one.
    fn level(&self) -> f32 {
        match self.rows.saturating_sub(self.missing) {
            0 => 0.0,
            taken => micromath::F32(self.squares / taken as f32).sqrt().0,
        }
    }
}

/// Sums until it is read, then starts again.
#[derive(Debug, Clone)]
pub(crate) struct LevelMeter {
    channels: [Meter; MAX_CHANNELS],
}

impl LevelMeter {
    /// A meter that has seen nothing.
    pub(crate) const START: Self = Self { channels: [Meter::START; MAX_CHANNELS] };

    /// Adds a reading of a channel in m/s², as it is and about its bias; `None` where it is missing.
    pub(crate) fn add(&mut self, channel: usize, reading: Option<f32>, about_bias: f32, full_scale: f32) {
        if let Some(meter) = self.channels.get_mut(channel) {
            meter.add(reading, about_bias, full_scale);
        }
    }

    /// The levels of the first `channels` channels in m/s² and the states of their sensors since the last call.
    pub(crate) fn take(&mut self, channels: usize) -> (Vec<f32, MAX_CHANNELS>, Vec<SensorState, MAX_CHANNELS>) {
        let taken = core::mem::replace(self, Self::START);
        let meters = taken.channels.iter().take(channels);
        (meters.clone().map(Meter::level).collect(), meters.map(Meter::state).collect())
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
                meter.add(0, Some(value), value, f32::INFINITY);
            }
            let level = meter.take(1).0[0];
            let rms = amplitude / 2.0_f32.sqrt();
            assert!((level / rms - 1.0).abs() < 0.065, "{level} for {rms}");
        }
        let mut unused = LevelMeter::START;
        assert_eq!(unused.take(2).0.as_slice(), &[0.0, 0.0]);
    }

    #[test]
    fn a_sensor_that_is_absent_stuck_failing_clipped_or_noisy_is_told_from_a_sound_one() {
        let state = |reading: &dyn Fn(u32) -> Option<f32>| {
            let mut meter = LevelMeter::START;
            for n in 0..500 {
                let value = reading(n);
                meter.add(0, value, value.unwrap_or(0.0) - 9.81, 19.6);
            }
            meter.take(1).1[0]
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
}
