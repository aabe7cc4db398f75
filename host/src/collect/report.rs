//! What collecting has come to in the end, port by port.

use std::path::{Path, PathBuf};
use std::time::Duration;

use belfry_shared::message::SensorState;
use serde::Serialize;

use super::collector::CollectError;
use super::status::PortStatus;
use super::words::Words;
use crate::archive::{Archive, ArchiveError, Collected, TimeRange, moment};
use crate::study::Setup;

/// The end of a collection.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The setup.
    pub setup: String,
    /// The archive.
    pub archive: PathBuf,
    /// How long it took, in s.
    pub collected_s: f64,
    /// Starts at which the archive now holds a window of at least one node.
    pub windows_in_archive: usize,
    /// The ports.
    pub ports: Vec<PortReport>,
}

/// What a port has come to in the end.
#[derive(Debug, Clone, Serialize)]
pub struct PortReport {
    /// Its name.
    pub port: String,
    /// The node on it.
    pub node: Option<u16>,
    /// What it has come to, in words.
    pub state: String,
    /// Windows that came.
    pub windows: u64,
    /// Those with a channel that was not sound.
    pub windows_with_gaps: u64,
    /// Windows of the node's life since the archive first met it that no longer exist anywhere, also before this run.
    pub lost_windows: u64,
    /// Windows of another study that were dropped.
    pub foreign_windows: u64,
    /// Samples that the node has lost since it started.
    pub lost_rows: u32,
    /// Pulses since it started after which the sensor had taken no new sample.
    pub stale_rows: u32,
    /// Messages to the node that came faster than it could take them.
    pub dropped_frames: u32,
    /// Frames that came damaged.
    pub damaged_frames: u64,
    /// Parts of windows that cannot be: of another node's, or of a time that has not been.
    pub refused_parts: u64,
    /// Messages to the node that it did not take, as another program had greeted it since.
    pub refused_messages: u32,
    /// Bytes that came.
    pub bytes_received: u64,
    /// How much faster the host's clock runs than the node's.
    pub clock_drift_ppm: Option<f64>,
    /// How much the sensor's own oscillator was fast when it started, which its delay is corrected for.
    pub oscillator_ppm: Option<i32>,
    /// The sensor's temperature.
    pub temperature_c: Option<f64>,
    /// Level of each channel: the RMS about the mean since the last heartbeat, of a node that says its variance; else to 6 %.
    pub level_m_s2: Vec<f32>,
    /// Mean of each channel's readings since the last heartbeat: gravity and offset.
    pub mean_m_s2: Vec<f32>,
    /// When it was calibrated, of a node that has kept that. It applies nothing of it: study.toml counts.
    pub calibrated: Option<String>,
    /// Longest time since the node's start that it took to fetch a sample.
    pub longest_fetch_us: u32,
    /// What is wrong with each channel's sensor; nothing where it is sound.
    pub sensors: Vec<Option<String>>,
    /// The highest peaks.
    pub peaks_hz: Vec<f64>,
    /// What the node has recorded of its last end.
    pub last_fault: Option<String>,
    #[serde(skip)]
    is_useless: bool,
}

impl Report {
    /// The report of a collection into the archive of the study in `folder`.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn new(
        setup: &Setup,
        folder: &Path,
        collected: Duration,
        statuses: &[PortStatus],
    ) -> Result<Self, ArchiveError> {
        let words = Words::new(setup);
        let windows = match Archive::open(folder)? {
            Some(archive) => {
                archive.collected(setup, &TimeRange::ALL)?.map_or(0, |Collected { setup, .. }| setup.windows)
            }
            None => 0,
        };
        Ok(Self {
            setup: setup.name.clone(),
            archive: folder.join(crate::archive::ARCHIVE_FILE),
            collected_s: collected.as_secs_f64(),
            windows_in_archive: windows,
            ports: statuses.iter().map(|status| PortReport::new(status, &words)).collect(),
        })
    }

    /// Windows that have come.
    pub fn windows(&self) -> u64 {
        self.ports.iter().map(|port| port.windows).sum()
    }

    /// Windows that have come with gaps.
    pub fn windows_with_gaps(&self) -> u64 {
        self.ports.iter().map(|port| port.windows_with_gaps).sum()
    }

    /// Whether any node was there to collect from.
    ///
    /// # Errors
    /// Where none answered, or none that can be used.
    pub fn verdict(&self) -> Result<(), CollectError> {
        let join = |parts: Vec<&str>, by: &str| parts.join(by);
        if self.windows() == 0 && self.ports.iter().all(|port| port.is_useless) {
            let reasons = join(self.ports.iter().map(|port| port.state.as_str()).collect(), "; ");
            return Err(CollectError::NoUsableNode { reasons });
        }
        if self.ports.iter().all(|port| port.node.is_none()) {
            let ports = join(self.ports.iter().map(|port| port.port.as_str()).collect(), ", ");
            return Err(CollectError::NoAnswer { ports });
        }
        Ok(())
    }
}

impl PortReport {
    fn new(status: &PortStatus, words: &Words) -> Self {
        let heartbeat = status.heartbeat.as_ref();
        let wrong = |&state: &SensorState| (state != SensorState::Sound).then(|| state.to_string());
        Self {
            port: status.port.clone(),
            node: status.node,
            state: words.state(status),
            windows: status.statistics.windows,
            windows_with_gaps: status.gaps.windows,
            lost_windows: status.statistics.lost_windows,
            foreign_windows: status.statistics.foreign_windows,
            lost_rows: heartbeat.map_or(0, |heartbeat| heartbeat.lost_rows),
            stale_rows: heartbeat.map_or(0, |heartbeat| heartbeat.stale_rows),
            dropped_frames: heartbeat.map_or(0, |heartbeat| heartbeat.board.dropped_frames),
            damaged_frames: status.statistics.damaged_frames,
            refused_parts: status.statistics.contradictions,
            refused_messages: heartbeat.map_or(0, |heartbeat| heartbeat.refused_messages),
            bytes_received: status.statistics.bytes_received,
            clock_drift_ppm: status.drift_ppm,
            oscillator_ppm: heartbeat.and_then(|heartbeat| heartbeat.board.oscillator_ppm),
            temperature_c: heartbeat
                .and_then(|heartbeat| heartbeat.board.temperature_centi_c)
                .map(|centi_c| f64::from(centi_c) * 0.01),
            level_m_s2: heartbeat.map_or_else(Vec::new, |heartbeat| heartbeat.rms().to_vec()),
            mean_m_s2: heartbeat.map_or_else(Vec::new, |heartbeat| heartbeat.mean_m_s2().to_vec()),
            calibrated: status.hello.as_ref().and_then(|hello| Some(moment(hello.calibration.as_ref()?.time.0))),
            longest_fetch_us: heartbeat.map_or(0, |heartbeat| heartbeat.board.longest_fetch_us),
            sensors: heartbeat.map_or_else(Vec::new, |heartbeat| heartbeat.sensors.iter().map(wrong).collect()),
            peaks_hz: status.peaks_hz.clone(),
            last_fault: status.hello.as_ref().and_then(|hello| hello.fault.as_ref()).map(ToString::to_string),
            is_useless: status.state.is_useless(),
        }
    }
}
