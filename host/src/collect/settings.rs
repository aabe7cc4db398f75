//! What nodes are to measure: rate, segment and lines, before there are data to choose them by.

use std::path::PathBuf;

use belfry_shared::message::Summary;
use thiserror::Error;

use super::words::seconds_in_words;
use crate::archive::{Archive, ArchiveError};
use crate::keys::Keys;
use crate::spectra::{LineGrid, PlanError, SetupExtent, SpectralPlan};
use crate::study::{Analysis, Setup, Study};
use crate::window::{node_configuration, node_lines};

/// Hours that are measured where nothing is said.
const HOURS: f64 = 24.0;
/// Bits per component where nothing is said: frequencies within 0.0002 %.
const BITS: u8 = 10;

/// How to collect.
#[derive(Debug, Clone, Default)]
pub struct CollectOptions {
    /// The live setup, where the study has several.
    pub setup: Option<String>,
    /// Hours that will be measured, for the choice of the segment; 24 where nothing is said.
    pub hours: Option<f64>,
    /// Bits per component of the spectral lines; 10 where nothing is said, or what was collected with before.
    pub bits: Option<u8>,
    /// Whether windows that nodes hold for another study are dropped.
    pub drop_foreign: bool,
    /// Baud rate of the lines.
    pub baud: u32,
    /// The nodes' keys.
    pub keys: Keys,
}

/// Why a study cannot be collected.
#[derive(Debug, Error)]
pub enum CollectionError {
    /// It has no live setup.
    #[error(
        "the study has no live setup: write `live = true` instead of `files` into the [[setup]] of {file} that nodes measure", file = .file.display()
    )]
    NoLiveSetup {
        /// The study's file.
        file: PathBuf,
    },
    /// It has several.
    #[error("the study has several live setups, {names}: say which with --setup")]
    SeveralLiveSetups {
        /// Their names.
        names: String,
    },
    /// It has none of this name.
    #[error("\"{name}\" is no live setup of the study; these are: {names}")]
    NotLive {
        /// The name.
        name: String,
        /// The live ones' names.
        names: String,
    },
    /// It does not say what band to measure.
    #[error(
        "nodes must know the band before there are data: give band_hz in [analysis] of {file}, such as band_hz = [0.05, 1.5]", file = .file.display()
    )]
    NoBand {
        /// The study's file.
        file: PathBuf,
    },
    /// What it asks for cannot be had.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The archive fails.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// The settings do not fit into a node's configuration.
    #[error("node {node} cannot be told these settings")]
    Inexpressible {
        /// The node.
        node: u16,
    },
}

impl CollectionError {
    /// Whether it will pass: another program has the archive, or the disk is full.
    pub fn will_pass(&self) -> bool {
        matches!(self, Self::Archive(error) if error.will_pass())
    }
}

/// What a setup's nodes are to measure.
pub(super) struct Settings {
    pub(super) grid: LineGrid,
    pub(super) decimation: u32,
    pub(super) bits: u8,
    /// Why, in a line.
    pub(super) reason: String,
}

/// The file of a study.
pub(super) fn study_file(study: &Study) -> PathBuf {
    study.folder.join("study.toml")
}

/// Below this sampling rate in Hz a node's sensor lets too much through that folds down.
const FEW_HZ: f64 = 400.0;

/// What the setup's nodes are to measure, and what is to be said of its sampling rate.
pub(super) fn settings(
    study: &Study,
    setup: &Setup,
    archive: &Archive,
    options: &CollectOptions,
) -> Result<Settings, CollectionError> {
    let mut settings = lines_settings(study, setup, archive, options)?;
    if setup.sampling_rate_hz < FEW_HZ {
        settings.reason += &format!(
            "\nThe sensor's filters are slow: of motion above half of sampling_rate_hz = {}, up to 2 % comes out in the band. At 1000 (or 500) nodes filter themselves and leave less than 0.01 %; they send as much as now.",
            setup.sampling_rate_hz
        );
    }
    Ok(settings)
}

/// What they are to measure: as before where \[analysis\] still asks for that, else what suits it.
fn lines_settings(
    study: &Study,
    setup: &Setup,
    archive: &Archive,
    options: &CollectOptions,
) -> Result<Settings, CollectionError> {
    let band_hz = study.analysis.band_hz.ok_or_else(|| CollectionError::NoBand { file: study_file(study) })?;
    let rows = (options.hours.unwrap_or(HOURS) * 3600.0 * setup.sampling_rate_hz) as u64;
    let extent =
        SetupExtent { sampling_rate_hz: setup.sampling_rate_hz, rows, channels: setup.sensors.len(), block_rows: None };
    let before = archive.configurations(Some(&setup.name))?;
    // Another setup of the study, that was collected before, fixes the lines as well: they are analysed together.
    let others = study.setups.iter().filter(|other| other.live && other.name != setup.name);
    let mut candidates = before.clone();
    for other in others {
        candidates.extend(archive.configurations(Some(&other.name))?.into_iter().take(1));
    }
    for known in &candidates {
        let (Summary::Lines { bits }, Some((lines, _))) = (known.summary, node_lines(known)) else { continue };
        let rate_hz = lines.sampling_rate_hz;
        let asks_for_it = study.analysis.segment.is_none_or(|segment| segment == lines.segment)
            && study.analysis.decimated_rate_hz.is_none_or(|wanted| (wanted / rate_hz - 1.0).abs() < 1e-6);
        let analysis =
            Analysis { decimated_rate_hz: Some(rate_hz), segment: Some(lines.segment), ..study.analysis.clone() };
        let long = SetupExtent { rows: u64::MAX >> 16, ..extent };
        let Ok(plan) = SpectralPlan::choose(&[long], &analysis) else { continue };
        let (grid, decimation) = (plan.grid, plan.decimations.first().copied().unwrap_or(1));
        let bits = options.bits.unwrap_or(bits);
        let channels = usize::from(known.channels);
        let same = node_configuration(setup.sampling_rate_hz, decimation, &grid, channels, known.summary);
        if asks_for_it && same.as_ref() == Some(known) {
            let mut reason = format!("As collected before: {}", in_words(&grid, bits));
            if options.hours.is_some() && study.analysis.segment.is_none() {
                reason +=
                    " (--hours only counts when a setup is collected first; a segment = ... in [analysis] changes it.)";
            }
            return Ok(Settings { grid, decimation, bits, reason });
        }
    }
    let plan = SpectralPlan::choose(&[extent], &study.analysis)?;
    let (grid, decimation) = (plan.grid, plan.decimations.first().copied().unwrap_or(1));
    let bits = options.bits.unwrap_or(BITS);
    let mut reason = in_words(&grid, bits);
    if !before.is_empty() {
        reason += &format!(
            "\nThe settings differ from those of the earlier collection (band {} to {} Hz, segment, rate): earlier windows stay in the archive, but cannot be averaged with new ones.",
            band_hz[0], band_hz[1]
        );
    }
    Ok(Settings { grid, decimation, bits, reason })
}

fn in_words(grid: &LineGrid, bits: u8) -> String {
    let segment_s = 1.0 / grid.spacing_hz();
    format!(
        "Segments of {} points at {} Hz, {} s, and a window every {} s; {} lines from {:.4} to {:.4} Hz in {bits} bits.",
        grid.segment,
        // To a ten-thousandth, without zeros.
        (grid.sampling_rate_hz * 1e4).round() / 1e4,
        seconds_in_words(segment_s),
        seconds_in_words(0.5 * segment_s),
        grid.lines,
        grid.frequency_hz(0),
        grid.frequency_hz(grid.lines.saturating_sub(1)),
    )
}
