//! A glance at a setup: what its recording, or what its nodes have sent, holds channel by channel, before any spectrum is made of it.
//!
//! A setup flows in; rates, spans, gaps, levels and faults flow out, with the range of every channel over time for a picture. Rows go through
//! the same checks as on their way into spectra.

use num_complex::Complex32;
use serde::Serialize;

use super::faults::{copy_sentences, fault_sentences, reader_sentences};
use super::flat::Flat;
use super::limits::CutOff;
use super::overview::Ranges;
use super::stream::{Checks, Faults};
use super::{Material, MeasureError, Opened, Progress};
use crate::archive::{Collected, damage_in_words};
use crate::record::{Block, ChannelReport, Gap, RecordReport, RecordWarning, Recording, utc};
use crate::spectra::WindowLines;
use crate::study::{Sensor, Setup, Study};

/// What a setup holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetupLook {
    /// Its name.
    pub setup: String,
    /// Whether nodes have sent it; `rows` and `missing` then count windows, and levels are those in the band that the nodes send.
    pub live: bool,
    /// Rows per second.
    pub sampling_rate_hz: f64,
    /// Rows, those included that are missing by their times; windows of a live setup.
    pub rows: u64,
    /// From the first row to the last, or the first window to the last.
    pub duration_s: f64,
    /// When the first row was, in UTC, where it is known.
    pub start_utc: Option<String>,
    /// When the last one was.
    pub end_utc: Option<String>,
    /// Rows that are missing by their times.
    pub filled_rows: u64,
    /// Places where all channels jump at once.
    pub jumps: u64,
    /// Each channel, in the setup's order.
    pub channels: Vec<ChannelLook>,
    /// Copies, each with the channel that it is one of.
    pub copies: Vec<[String; 2]>,
    /// What the reader should know, in sentences.
    #[serde(skip)]
    pub warnings: Vec<String>,
    /// The range of every channel over time; of a live setup the level of its windows.
    #[serde(skip)]
    pub ranges: Ranges,
}

/// What a channel holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelLook {
    /// Its name.
    pub channel: String,
    /// The unit of its levels.
    pub unit: String,
    /// Samples that are missing; windows of a live setup.
    pub missing: u64,
    /// Their share.
    pub missing_percent: f64,
    /// Runs of missing samples.
    pub gaps: u64,
    /// The first few of them.
    pub first_gaps: Vec<GapLook>,
    /// Mean; none of a live setup, or without samples.
    pub mean: Option<f64>,
    /// Root mean square about the mean; of a live setup that of its windows' levels. None without samples.
    pub rms: Option<f64>,
    /// The smallest sample; none of a live setup, or without samples.
    pub smallest: Option<f64>,
    /// The largest; of a live setup the largest level of a window. None without samples.
    pub largest: Option<f64>,
    /// Whether all samples are equal.
    pub dead: bool,
    /// Where it is cut off.
    pub clipped: Option<ClippedLook>,
    /// Pieces in which it holds one value.
    pub held: Option<HeldLook>,
    /// Spikes of a single sample.
    pub spikes: u64,
}

/// A run of missing samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GapLook {
    /// Where it begins, in s after the first row.
    pub start_s: f64,
    /// Its length.
    pub duration_s: f64,
}

/// The end of a range that a channel reaches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClippedLook {
    /// The end, in the channel's unit.
    pub at: f64,
    /// Samples there.
    pub samples: u64,
    /// Their share.
    pub percent: f64,
    /// The first of them, in s after the first row.
    pub first_s: f64,
}

/// Pieces of one value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldLook {
    /// How many.
    pub pieces: u64,
    /// Samples in them.
    pub samples: u64,
    /// The first of them, in s after the first row.
    pub first_s: f64,
}

/// Looks at a setup of `study`.
///
/// # Errors
/// When its recording or archive cannot be read, or nothing has been collected.
pub fn glance(study: &Study, setup: &Setup, progress: Progress<'_>) -> Result<SetupLook, MeasureError> {
    let Opened { material, rows, .. } = Opened::open(setup, &study.folder, &study.range)?;
    match material {
        Material::Recording(recording) => at_recording(setup, *recording, rows, progress),
        Material::Archive(collected) => at_windows(setup, &collected, progress),
    }
}

fn at_recording(
    setup: &Setup,
    mut recording: Recording,
    rows: u64,
    progress: Progress<'_>,
) -> Result<SetupLook, MeasureError> {
    let failed = |source| MeasureError::Record { setup: setup.name.clone(), source: Box::new(source) };
    let start_ns = recording.start_ns().map_err(failed)?;
    let mut ranges = Ranges::new(setup.sensors.len(), rows);
    let mut checks = Checks::of(setup);
    let (mut block, mut sound) = (Block::new(), Vec::new());
    while recording.next_block(&mut block).map_err(failed)? {
        ranges.push(block.values());
        checks.push(block.values(), &mut sound);
        progress(ranges.rows, rows);
    }
    let (_, faults) = checks.finish();
    let report = recording.finish();
    let seconds = |row: u64| row as f64 / setup.sampling_rate_hz;
    let mut warnings = reader_sentences(setup, &report.warnings, &faults.filled);
    warnings.extend(copy_sentences(setup, &faults.copies));
    warnings.extend(fault_sentences(setup, &faults, &[]));
    let name = |channel: usize| setup.sensors.get(channel).map(|sensor| sensor.channel.clone()).unwrap_or_default();
    let end_ns = start_ns.map(|start_ns| start_ns.saturating_add((1e9 * seconds(report.rows)) as i64));
    Ok(SetupLook {
        setup: setup.name.clone(),
        live: false,
        sampling_rate_hz: setup.sampling_rate_hz,
        rows: report.rows,
        duration_s: seconds(report.rows),
        start_utc: start_ns.map(utc),
        end_utc: end_ns.map(utc),
        filled_rows: report.filled_rows,
        jumps: faults.jumps.places,
        channels: channels(setup, &report, &faults, &ranges),
        copies: faults.copies.iter().map(|pair| pair.map(name)).collect(),
        warnings,
        ranges,
    })
}

fn channels(setup: &Setup, report: &RecordReport, faults: &Faults, ranges: &Ranges) -> Vec<ChannelLook> {
    let seconds = |row: u64| row as f64 / setup.sampling_rate_hz;
    let is_dead = |name: &String| {
        report.warnings.iter().any(|warning| match warning {
            RecordWarning::Constant { channels, .. } => channels.names().contains(name),
            _ => false,
        })
    };
    let clipped = |cut: &CutOff| ClippedLook {
        at: cut.limit,
        samples: cut.samples,
        percent: 100.0 * cut.share,
        first_s: seconds(cut.first_row),
    };
    let held = |flat: &Flat| HeldLook { pieces: flat.pieces, samples: flat.samples, first_s: seconds(flat.first_row) };
    let gap = |gap: &Gap| GapLook { start_s: seconds(gap.row), duration_s: seconds(gap.rows) };
    let each = setup.sensors.iter().zip(&report.channels).enumerate();
    let of = |(index, (sensor, found)): (usize, (&Sensor, &ChannelReport))| {
        let range = ranges.extent(index);
        ChannelLook {
            gaps: found.gap_count,
            first_gaps: found.gaps.iter().map(gap).collect(),
            mean: Some(found.mean).filter(|mean| mean.is_finite()),
            rms: Some(found.rms).filter(|rms| rms.is_finite()),
            smallest: range.map(|[low, _]| low),
            largest: range.map(|[_, high]| high),
            dead: is_dead(&sensor.channel),
            clipped: faults.cut_off.get(index).filter(|cut| cut.samples > 0).map(clipped),
            held: faults.flat.get(index).filter(|flat| flat.pieces > 0).map(held),
            spikes: faults.spikes.get(index).map_or(0, |spikes| spikes.count),
            ..ChannelLook::new(setup, sensor, found.missing, report.rows)
        }
    };
    each.map(of).collect()
}

impl ChannelLook {
    /// A channel of which nothing is known but how many of its samples, or windows, are missing.
    fn new(setup: &Setup, sensor: &Sensor, missing: u64, of: u64) -> Self {
        Self {
            channel: sensor.channel.clone(),
            unit: setup.unit_of(sensor).motion().unit().to_owned(),
            missing,
            missing_percent: 100.0 * missing as f64 / of.max(1) as f64,
            gaps: 0,
            first_gaps: Vec::new(),
            mean: None,
            rms: None,
            smallest: None,
            largest: None,
            dead: false,
            clipped: None,
            held: None,
            spikes: 0,
        }
    }
}

/// The same of windows that nodes have sent.
fn at_windows(setup: &Setup, collected: &Collected, progress: Progress<'_>) -> Result<SetupLook, MeasureError> {
    let grid = collected.setup.grid;
    let windows = collected.setup.windows as u64;
    let sensors = setup.sensors.len();
    let mut ranges = Ranges::new(sensors, windows);
    let (mut sums, mut present) = (vec![0.0; sensors], vec![0_u64; sensors]);
    let (mut seen, mut last) = (0, 0);
    let mut take = |window: WindowLines| {
        let level = |lines: &Option<Vec<Complex32>>| {
            let square = |line: &Complex32| f64::from(line.norm_sqr());
            lines.as_ref().map_or(f64::NAN, |lines| (grid.spacing_hz() * lines.iter().map(square).sum::<f64>()).sqrt())
        };
        let levels: Vec<f64> = window.channels.iter().map(level).collect();
        for ((sum, present), level) in sums.iter_mut().zip(&mut present).zip(&levels) {
            if level.is_finite() {
                *sum += level * level;
                *present += 1;
            }
        }
        ranges.push(&levels);
        (seen, last) = (seen + 1, window.grid_index);
        progress(seen, windows);
    };
    let damages = collected
        .each_window(setup, &mut take)
        .map_err(|source| MeasureError::Archive { setup: setup.name.clone(), source: Box::new(source) })?;
    let of = |(index, (sensor, (sum, sound))): (usize, (&Sensor, (&f64, &u64)))| ChannelLook {
        // No number without windows.
        rms: Some((sum / *sound as f64).sqrt()).filter(|rms| rms.is_finite()),
        largest: ranges.extent(index).map(|[_, high]| high),
        ..ChannelLook::new(setup, sensor, seen.saturating_sub(*sound), seen)
    };
    let channels = setup.sensors.iter().zip(sums.iter().zip(&present)).enumerate().map(of).collect();
    let [start, end] = collected.setup.span.clone();
    let hop_s = 0.5 * grid.segment as f64 / grid.sampling_rate_hz;
    Ok(SetupLook {
        setup: setup.name.clone(),
        live: true,
        sampling_rate_hz: setup.sampling_rate_hz,
        rows: seen,
        duration_s: last.saturating_add(2) as f64 * hop_s,
        start_utc: Some(start),
        end_utc: Some(end),
        filled_rows: 0,
        jumps: 0,
        channels,
        copies: Vec::new(),
        warnings: damage_in_words(&damages),
        ranges,
    })
}
