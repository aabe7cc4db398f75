//! What a configuration means for this node: checked once, then only read.

use belfry_shared::decimation::Stages;
use belfry_shared::message::{Configuration, MAX_CHANNELS, MAX_DATA_BYTES, RefusalReason, Summary};
use belfry_shared::quantise::{BLOCK_LINES, MAX_BITS, MIN_BITS, encoded_bytes, lines_that_fit};

use crate::outbox::MAX_PARTS;
use crate::schedule::Schedule;
use crate::spectrum::SUPPORTED_SEGMENTS;

/// Words of memory that the running averages and the outbox share.
pub(crate) const ARENA_WORDS: usize = 6272;
/// Most bytes of a data part beside its code; also of a head.
const PART_OVERHEAD_BYTES: usize = 32;
/// Most bytes of a peaks part.
const PEAKS_BYTES: usize = 96;

/// A configuration that this node can run.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// The configuration itself.
    pub(crate) configuration: Configuration,
    /// Its hash.
    pub(crate) hash: u32,
    /// Its decimation.
    pub(crate) stages: Stages,
    /// Its windows.
    pub(crate) schedule: Schedule,
    /// Words of the arena for running averages; the rest is the outbox.
    pub(crate) cells: usize,
}

impl Plan {
    /// Checks a configuration for a node with `available` channels that can be sampled at `highest_mhz`.
    pub(crate) fn new(configuration: Configuration, available: u8, highest_mhz: u32) -> Result<Self, RefusalReason> {
        let channels = configuration.channels;
        if channels == 0 || channels > available || usize::from(channels) > MAX_CHANNELS {
            return Err(RefusalReason::Channels { available });
        }
        if !(1..=1000 * u64::from(highest_mhz)).contains(&configuration.sampling_rate_uhz) {
            return Err(RefusalReason::SamplingRate { highest_mhz });
        }
        let stages = Stages::of(configuration.decimation).ok_or(RefusalReason::Decimation)?;
        if !SUPPORTED_SEGMENTS.contains(&configuration.segment) {
            return Err(RefusalReason::Segment);
        }
        check_bands(&configuration)?;
        let (cells, window_bytes, window_parts) = match configuration.summary {
            Summary::Lines { bits } if (MIN_BITS..=MAX_BITS).contains(&bits) => {
                let (bytes, parts) = lines_size(&configuration, bits);
                (0, bytes, parts)
            }
            Summary::Psd { segments } if segments > 0 => {
                let (bytes, parts) = densities_size(&configuration);
                (configuration.lines() * usize::from(channels), bytes, parts)
            }
            _ => return Err(RefusalReason::Summary),
        };
        // Room for one message may stay unused at the ring's end.
        let needed = 4 * cells + window_bytes + MAX_DATA_BYTES + PART_OVERHEAD_BYTES;
        if needed > 4 * ARENA_WORDS || window_parts > MAX_PARTS {
            return Err(RefusalReason::Memory { needed: needed as u32, available: 4 * ARENA_WORDS as u32 });
        }
        let schedule = Schedule::new(&configuration);
        Ok(Self { hash: configuration.hash(), configuration, stages, schedule, cells })
    }

    /// Whether averaged densities alone are sent, which are to take half a byte a second and channel.
    pub(crate) fn is_sparing(&self) -> bool {
        matches!(self.configuration.summary, Summary::Psd { .. })
    }

    /// Channels measured.
    pub(crate) fn channels(&self) -> usize {
        usize::from(self.configuration.channels)
    }

    /// Decimated samples a segment.
    pub(crate) fn segment(&self) -> usize {
        usize::from(self.configuration.segment)
    }
}

/// Lines in a full data part: whole blocks, so that blocks do not depend on the partition.
pub(crate) fn lines_a_part(bits: u8) -> usize {
    lines_that_fit(MAX_DATA_BYTES, bits) / BLOCK_LINES * BLOCK_LINES
}

fn check_bands(configuration: &Configuration) -> Result<(), RefusalReason> {
    let mut free_from = 1;
    for band in &configuration.bands {
        let end = u32::from(band.first_line) + u32::from(band.lines);
        if u32::from(band.first_line) < free_from || band.lines == 0 || end > u32::from(configuration.segment / 2) {
            return Err(RefusalReason::Bands);
        }
        free_from = end;
    }
    if configuration.bands.is_empty() { Err(RefusalReason::Bands) } else { Ok(()) }
}

/// Bytes and parts of a window of lines.
fn lines_size(configuration: &Configuration, bits: u8) -> (usize, usize) {
    let (mut bytes, mut parts) = (0, 0);
    for band in &configuration.bands {
        let lines = usize::from(band.lines);
        let full_parts = lines.div_ceil(lines_a_part(bits));
        bytes += encoded_bytes(lines, bits) + full_parts * (1 + PART_OVERHEAD_BYTES);
        parts += full_parts;
    }
    let channels = usize::from(configuration.channels);
    (channels * bytes + PART_OVERHEAD_BYTES, channels * parts + 1)
}

/// Bytes and parts of a window of densities and peaks.
fn densities_size(configuration: &Configuration) -> (usize, usize) {
    let (mut bytes, mut parts) = (PEAKS_BYTES, 1);
    for band in &configuration.bands {
        let lines = usize::from(band.lines);
        bytes += lines + lines.div_ceil(MAX_DATA_BYTES) * PART_OVERHEAD_BYTES;
        parts += lines.div_ceil(MAX_DATA_BYTES);
    }
    let channels = usize::from(configuration.channels);
    (channels * bytes + PART_OVERHEAD_BYTES, channels * parts + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use belfry_shared::message::Band;
    use heapless::Vec;

    const HIGHEST_MHZ: u32 = 4_000_000;

    fn configuration() -> Configuration {
        Configuration {
            channels: 4,
            sampling_rate_uhz: 50_000_000,
            decimation: 10,
            segment: 4096,
            summary: Summary::Lines { bits: 6 },
            bands: Vec::from_slice(&[Band { first_line: 41, lines: 1188 }]).unwrap(),
        }
    }

    fn refusal(change: impl FnOnce(&mut Configuration)) -> Option<RefusalReason> {
        let mut configuration = configuration();
        change(&mut configuration);
        Plan::new(configuration, 4, HIGHEST_MHZ).err()
    }

    #[test]
    fn the_reference_configuration_runs_with_room_for_three_windows() {
        let plan = Plan::new(configuration(), 4, HIGHEST_MHZ).unwrap();
        assert_eq!(plan.cells, 0);
        assert!(3 * lines_size(&plan.configuration, 6).0 < 4 * ARENA_WORDS);
        assert_eq!(refusal(|c| c.summary = Summary::Psd { segments: 8 }), None);
    }

    #[test]
    fn every_impossible_setting_is_refused_with_its_reason() {
        use RefusalReason as Reason;
        assert_eq!(refusal(|c| c.channels = 0), Some(Reason::Channels { available: 4 }));
        assert_eq!(refusal(|c| c.channels = 5), Some(Reason::Channels { available: 4 }));
        assert_eq!(refusal(|c| c.sampling_rate_uhz = 0), Some(Reason::SamplingRate { highest_mhz: HIGHEST_MHZ }));
        assert_eq!(
            refusal(|c| c.sampling_rate_uhz = 4_000_000_001),
            Some(Reason::SamplingRate { highest_mhz: HIGHEST_MHZ })
        );
        assert_eq!(refusal(|c| c.decimation = 13), Some(Reason::Decimation));
        assert_eq!(refusal(|c| c.segment = 300), Some(Reason::Segment));
        assert_eq!(refusal(|c| c.summary = Summary::Lines { bits: 2 }), Some(Reason::Summary));
        assert_eq!(refusal(|c| c.summary = Summary::Psd { segments: 0 }), Some(Reason::Summary));
        for bands in [
            &[][..],
            &[Band { first_line: 0, lines: 5 }],
            &[Band { first_line: 2040, lines: 9 }],
            &[Band { first_line: 5, lines: 5 }, Band { first_line: 9, lines: 5 }],
            &[Band { first_line: 5, lines: 0 }],
            &[Band { first_line: u16::MAX, lines: u16::MAX }],
        ] {
            assert_eq!(refusal(|c| c.bands = Vec::from_slice(bands).unwrap()), Some(Reason::Bands));
        }
        let too_much = refusal(|c| {
            c.summary = Summary::Lines { bits: 16 };
            c.bands = Vec::from_slice(&[Band { first_line: 1, lines: 2047 }]).unwrap();
        });
        assert!(matches!(too_much, Some(Reason::Memory { needed, available: 25_088 }) if needed > 32_000));
    }
}
