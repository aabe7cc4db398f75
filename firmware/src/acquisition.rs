//! Acquisition: raw readings in, checked and decimated history out.
//!
//! Readings are checked for faults, reduced by their first value (so that f32 keeps its digits for the vibration, not for
//! gravity), decimated, and kept in a ring a little longer than the longest segment. Nothing else keeps samples: a segment must be
//! fetched before newer ones replace it.

use belfry_shared::decimation::Stages;
use belfry_shared::message::{ChannelState, MAX_CHANNELS};
use heapless::Vec;

use crate::decimator::Decimator;
use crate::spectrum::LONGEST_SEGMENT;

/// Decimated samples kept: the longest segment, and the time until it is fetched.
const RING: usize = LONGEST_SEGMENT + 16;

/// Every channel's decimated samples.
pub(crate) type Rings = [[f32; RING]; MAX_CHANNELS];
/// No samples.
pub(crate) const fn empty_rings() -> Rings {
    [[0.0; RING]; MAX_CHANNELS]
}
/// Separate faults remembered per channel; further ones are joined to the last.
const MAX_FAULTS: usize = 6;

/// Decimated samples that a fault has spoilt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Fault {
    first: u64,
    last: u64,
    state: ChannelState,
}

/// One channel's filter and faults.
#[derive(Debug, Clone)]
struct Channel {
    decimator: Decimator,
    bias: Option<f32>,
    last_value: f32,
    /// The raw row since which the reading has not changed.
    unchanged_since: u64,
    faults: Vec<Fault, MAX_FAULTS>,
}

impl Channel {
    const START: Self =
        Self { decimator: Decimator::START, bias: None, last_value: 0.0, unchanged_since: 0, faults: Vec::new() };

    fn restart(&mut self) {
        self.decimator = Decimator::START;
        self.bias = None;
        self.last_value = 0.0;
        self.unchanged_since = 0;
        self.faults.clear();
    }

    fn add_fault(&mut self, fault: Fault) {
        if let Some(last) = self.faults.last_mut()
            && last.state == fault.state
            && fault.first <= last.last + 1
        {
            last.last = last.last.max(fault.last);
            return;
        }
        if self.faults.is_full()
            && let Some(last) = self.faults.last_mut()
        {
            last.last = last.last.max(fault.last);
            return;
        }
        // Cannot fail: there is room.
        let _ = self.faults.push(fault);
    }
}

/// The node's recent past, except for the samples themselves, which lie in [`Rings`].
#[derive(Debug, Clone)]
pub(crate) struct Acquisition {
    channels: [Channel; MAX_CHANNELS],
    /// Raw rows taken.
    rows: u64,
    /// Decimated samples made.
    samples: u64,
}

impl Acquisition {
    /// No past.
    pub(crate) const START: Self = Self { channels: [Channel::START; MAX_CHANNELS], rows: 0, samples: 0 };

    /// Forgets everything; for a new configuration or after an interruption.
    pub(crate) fn restart(&mut self) {
        for channel in &mut self.channels {
            channel.restart();
        }
        self.rows = 0;
        self.samples = 0;
    }

    /// Raw rows taken since the start.
    pub(crate) fn rows(&self) -> u64 {
        self.rows
    }

    /// Decimated samples made since the start.
    pub(crate) fn samples(&self) -> u64 {
        self.samples
    }

    /// Takes the first `channels` of a row of readings in m/s²; one that is absent or not a number counts as missing. Returns
    /// whether a decimated sample was made.
    pub(crate) fn push(
        &mut self,
        rings: &mut Rings,
        stages: &Stages,
        readings: &[f32],
        channels: usize,
        full_scale: f32,
    ) -> bool {
        let row = self.rows;
        self.rows += 1;
        let mut made = false;
        for (index, (channel, ring)) in self.channels.iter_mut().zip(rings).enumerate().take(channels) {
            let reading = readings.get(index).copied().filter(|reading| reading.is_finite());
            let fault = match reading {
                None => Some(ChannelState::Missing),
                Some(reading) if reading.abs() >= full_scale => Some(ChannelState::Clipped),
                Some(_) => None,
            };
            if let Some(state) = fault {
                let reach = u64::from(stages.reach_rows());
                let ratio = u64::from(stages.ratio());
                let first = row.saturating_sub(reach).div_ceil(ratio);
                channel.add_fault(Fault { first, last: (row + reach) / ratio, state });
            }
            // The last reading bridges a missing one, so that the filter does not ring. The window is not used.
            let value = reading.unwrap_or(channel.last_value);
            if value != channel.last_value || channel.bias.is_none() {
                channel.unchanged_since = row;
            }
            channel.last_value = value;
            if reading.is_some() && channel.bias.is_none() {
                channel.bias = reading;
            }
            let centred = channel.bias.map_or(0.0, |bias| value - bias);
            if let Some(sample) = channel.decimator.push(stages, centred) {
                ring[(self.samples % RING as u64) as usize] = sample;
                made = true;
            }
        }
        if made {
            self.samples += 1;
        }
        made
    }

    /// State of a channel in the `count` decimated samples from `start`, as far as its readings tell.
    pub(crate) fn state(&self, stages: &Stages, channel: usize, start: u64, count: usize) -> ChannelState {
        let end = start + count as u64;
        let Some(channel) = self.channels.get(channel) else { return ChannelState::Missing };
        if self.is_gone(start) {
            return ChannelState::Overrun;
        }
        if let Some(fault) = channel.faults.iter().find(|fault| fault.first < end && fault.last >= start) {
            return fault.state;
        }
        // The filter still rings from before the readings became constant.
        if channel.unchanged_since + u64::from(stages.reach_rows()) <= start * u64::from(stages.ratio()) {
            return ChannelState::Constant;
        }
        ChannelState::Sound { segments: 1 }
    }

    /// Whether a decimated sample has been replaced by newer ones.
    fn is_gone(&self, sample: u64) -> bool {
        self.samples > sample + RING as u64
    }

    /// Copies a channel's decimated samples from `start` on; false if some are gone or not there yet.
    pub(crate) fn fetch(&self, rings: &Rings, channel: usize, start: u64, samples: &mut [f32]) -> bool {
        let Some(ring) = rings.get(channel) else { return false };
        if self.is_gone(start) || start + samples.len() as u64 > self.samples || samples.len() > RING {
            return false;
        }
        let offset = (start % RING as u64) as usize;
        let (older, newer) = samples.split_at_mut(samples.len().min(RING - offset));
        older.copy_from_slice(&ring[offset..offset + older.len()]);
        newer.copy_from_slice(&ring[..newer.len()]);
        true
    }

    /// Forgets the faults of samples before `start`.
    pub(crate) fn forget_faults_before(&mut self, start: u64) {
        for channel in &mut self.channels {
            channel.faults.retain(|fault| fault.last >= start);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    fn filled(stages: &Stages, rows: u64, reading: impl Fn(u64) -> f32) -> (Acquisition, std::boxed::Box<Rings>) {
        let (mut acquisition, mut rings) = (Acquisition::START, std::boxed::Box::new(empty_rings()));
        for row in 0..rows {
            acquisition.push(&mut rings, stages, &[reading(row)], 1, 19.6);
        }
        (acquisition, rings)
    }

    fn running(stages: &Stages, rows: u64, reading: impl Fn(u64) -> f32) -> Acquisition {
        filled(stages, rows, reading).0
    }

    #[test]
    fn the_ring_gives_back_the_newest_segment_and_refuses_what_is_gone() {
        let stages = Stages::of(1).unwrap();
        let (acquisition, rings) = filled(&stages, 10_000, |row| 1.0 + row as f32 * 1e-3);
        let mut segment = vec![0.0; 4096];
        assert!(acquisition.fetch(&rings, 0, 10_000 - 4096, &mut segment));
        for (n, sample) in segment.iter().enumerate() {
            assert!((sample - (10_000 - 4096 + n) as f32 * 1e-3).abs() < 1e-5);
        }
        assert!(!acquisition.fetch(&rings, 0, 10_000 - 4096 - 17, &mut segment), "replaced by newer samples");
        assert!(!acquisition.fetch(&rings, 0, 10_000 - 4095, &mut segment), "not yet measured");
    }

    #[test]
    fn a_missing_reading_spoils_exactly_the_samples_its_filter_reaches() {
        let stages = Stages::of(10).unwrap();
        let acquisition = running(&stages, 20_000, |row| if row == 10_004 { f32::NAN } else { (row as f32).sin() });
        let spoilt: std::vec::Vec<u64> =
            (0..1900).filter(|&sample| acquisition.state(&stages, 0, sample, 1) == ChannelState::Missing).collect();
        // Row 10 004 is within 130 rows of samples 988 (row 9880: 124 away) to 1013 (row 10 130: 126 away).
        assert_eq!((spoilt.first(), spoilt.last(), spoilt.len()), (Some(&988), Some(&1013), 26));
    }

    #[test]
    fn clipped_and_constant_readings_are_told_apart() {
        let stages = Stages::of(2).unwrap();
        let clipped = running(&stages, 2000, |row| if row == 1000 { -20.0 } else { row as f32 * 1e-3 });
        assert_eq!(clipped.state(&stages, 0, 400, 256), ChannelState::Clipped);
        assert_eq!(clipped.state(&stages, 0, 600, 256), ChannelState::Sound { segments: 1 });
        let stuck = running(&stages, 2000, |row| if row < 600 { row as f32 * 1e-2 } else { 0.25 });
        assert_eq!(stuck.state(&stages, 0, 200, 256), ChannelState::Sound { segments: 1 });
        assert_eq!(stuck.state(&stages, 0, 400, 256), ChannelState::Constant);
    }

    #[test]
    fn more_faults_than_are_remembered_are_joined_not_lost() {
        let stages = Stages::of(1).unwrap();
        let acquisition =
            running(&stages, 4000, |row| if row > 0 && row % 200 == 0 { f32::INFINITY } else { row as f32 * 1e-3 });
        for start in (0..3700).step_by(100) {
            assert_eq!(acquisition.state(&stages, 0, start, 256), ChannelState::Missing, "{start}");
        }
    }
}
