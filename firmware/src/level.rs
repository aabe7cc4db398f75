//! The level meter: a rough RMS of each channel, for the heartbeat.

use belfry_shared::message::MAX_CHANNELS;
use heapless::Vec;

/// Sums squares until it is read.
#[derive(Debug, Clone)]
pub(crate) struct LevelMeter {
    sums: [f32; MAX_CHANNELS],
    counts: [u32; MAX_CHANNELS],
}

impl LevelMeter {
    /// A meter that has seen nothing.
    pub(crate) const START: Self = Self { sums: [0.0; MAX_CHANNELS], counts: [0; MAX_CHANNELS] };

    /// Adds a reading (about its bias, in m/s²) of a channel.
    pub(crate) fn add(&mut self, channel: usize, value: f32) {
        if let (Some(sum), Some(count)) = (self.sums.get_mut(channel), self.counts.get_mut(channel)) {
            *sum += value * value;
            *count += 1;
        }
    }

    /// The levels of the first `channels` channels in m/s² since the last call, and starts anew.
    ///
    /// The square root is micromath's, up to 6 % off: enough to tell a live sensor from a dead one.
    pub(crate) fn take(&mut self, channels: usize) -> Vec<f32, MAX_CHANNELS> {
        let levels = self.sums.iter().zip(&self.counts).take(channels);
        let levels =
            levels.map(|(&sum, &count)| if count == 0 { 0.0 } else { micromath::F32(sum / count as f32).sqrt().0 });
        let levels = levels.collect();
        *self = Self::START;
        levels
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
                meter.add(0, amplitude * (0.3 * n as f32).sin());
            }
            let level = meter.take(1)[0];
            let rms = amplitude / 2.0_f32.sqrt();
            assert!((level / rms - 1.0).abs() < 0.065, "{level} for {rms}");
        }
        let mut unused = LevelMeter::START;
        assert_eq!(unused.take(2).as_slice(), &[0.0, 0.0]);
    }
}
