//! From a study's recordings to its modes, with what stands behind them.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::blocks::block_warnings;
use super::error::StoryError;
use super::inputs::Inputs;
use crate::fleet::FleetReport;
use crate::identify::accuracy::RecordNeeded;
use crate::identify::lean::lean_suspicions;
use crate::identify::phases::phase_suspicions;
use crate::identify::ssi::{add_second_opinion, identify_by_subspace};
use crate::identify::suspect::suspicions;
use crate::identify::{
    Identification, hold_to_standards, identify as identify_setups, note_idle_bands, widen_drifting,
};
use crate::measure::{CollectedSpan, MeasureError, Measurement, Progress, Route, measure};
use crate::page::{Records, Spectra};
use crate::progress::{OnProgress, rows_of};
use crate::spectra::plan::{AVERAGES_A_CHANNEL, SHORTEST_SEGMENT};
use crate::spectra::{AfterGaps, LineGrid, Lines};
use crate::study::{ModeChoice, Study};
use crate::trend::Trend;

/// How modes are identified from spectra.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// A fit of the spectra gives modes, the subspace a second opinion on them.
    #[default]
    Both,
    /// A fit of the spectra alone.
    Spectra,
    /// The subspace alone.
    Subspace,
}

/// What `belfry identify --json` prints and `results/modes.json` holds.
#[derive(Debug, Clone, Serialize)]
pub struct ModesReport {
    /// The modes.
    #[serde(flatten)]
    pub identification: Identification,
    /// How the recordings were cut.
    pub segments: SegmentReport,
    /// From when to when the windows are that nodes have sent; nothing of recordings.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub collected: Vec<CollectedSpan>,
    /// The record that a wished accuracy would need.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub record_needed: Option<Vec<RecordNeeded>>,
    /// What the link between nodes and host did; none where spectra were made straight from the recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkReport>,
    /// The modes over the hours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trends: Option<Trend>,
    /// Where the time went.
    pub timings: TimingReport,
    /// The choice of modes that they were identified with.
    pub choice: ModeChoice,
    /// What was identified from.
    pub inputs: Inputs,
    /// What a page draws of spectra and recordings.
    #[serde(skip)]
    pub spectra: Spectra,
    /// See `spectra`.
    #[serde(skip)]
    pub records: Records,
    /// The lines of the spectra.
    #[serde(skip)]
    pub(super) grid: LineGrid,
    /// Whether there are finer ones, of fewer averages.
    #[serde(skip)]
    has_finer_lines: bool,
}

/// How the recordings were cut.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentReport {
    /// Points of a segment.
    pub points: usize,
    /// Sampling rate after decimation.
    pub decimated_rate_hz: f64,
    /// Length of a segment in s.
    pub duration_s: f64,
    /// Why these, and the band where it was chosen.
    pub reasons: Vec<String>,
}

/// What the link between nodes and host did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkReport {
    /// Windows that came.
    pub windows: u64,
    /// Windows that no longer exist anywhere.
    pub lost_windows: u64,
    /// Frames that were damaged, in both directions.
    pub damaged_frames: u64,
    /// Ranges of parts that the host asked for again.
    pub parts_asked_again: u64,
    /// Bytes on the wire, towards the host.
    pub bytes_per_second_and_channel: f64,
}

/// Where the time went. Reading, spectra and averaging run side by side, so their times do not add up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimingReport {
    /// Length of all recordings in s.
    pub recorded_s: f64,
    /// Counting rows and choosing the analysis.
    pub counting_s: f64,
    /// Reading the recordings.
    pub reading_s: f64,
    /// Nodes and link, or spectra straight from the recording.
    pub spectra_s: f64,
    /// Averaging outer products.
    pub averaging_s: f64,
    /// Identification.
    pub modes_s: f64,
    /// The second opinion on it.
    pub second_opinion_s: f64,
    /// Seconds of recording a second of all this.
    pub times_faster_than_real_time: f64,
}

/// Measures a study's recordings and identifies their modes; writes nothing.
///
/// # Errors
/// When no recording can be read, or all of them hold too little. A report without modes is no error here.
pub fn identify(
    study: &Study,
    route: Route,
    method: Method,
    on_progress: OnProgress<'_>,
) -> Result<ModesReport, StoryError> {
    let start = Instant::now();
    let found = identify_lines(study, route, method, Lines::Enough, start, on_progress)?;
    // Fewer averages may be too few, once gaps have cost some.
    if is_segment_free(study)
        && found.has_finer_lines
        && found.identification.has_narrow_modes()
        && let Ok(finer) = identify_lines(study, route, method, Lines::Finest, start, on_progress)
        && finer.identification.modes.len() >= found.identification.modes.len()
    {
        return Ok(finer);
    }
    Ok(found)
}

/// The same with these lines, at first; `start` is when all began.
fn identify_lines(
    study: &Study,
    route: Route,
    method: Method,
    lines: Lines,
    start: Instant,
    on_progress: OnProgress<'_>,
) -> Result<ModesReport, StoryError> {
    let stage = match route {
        Route::Nodes(_) => "nodes and link",
        Route::Direct => "spectra",
    };
    let measurement = measure_between_gaps(study, route, method, lines, &mut rows_of(stage, on_progress))?;
    let modes_start = Instant::now();
    let choice = &study.analysis.modes;
    let identified = match method {
        Method::Both | Method::Spectra => identify_setups(&measurement.setups, choice),
        Method::Subspace => identify_by_subspace(&measurement.setups, choice),
    };
    let mut identification = identified.map_err(|error| {
        let of_blocks = block_warnings(&[], &measurement.setups);
        let warnings: Vec<String> = measurement.warnings.iter().cloned().chain(of_blocks).collect();
        if warnings.is_empty() { error.into() } else { StoryError::Faulty { source: Box::new(error), warnings } }
    })?;
    let modes = modes_start.elapsed();
    let second_start = Instant::now();
    if method == Method::Both {
        add_second_opinion(&measurement.setups, choice, &mut identification)?;
    }
    hold_to_standards(&mut identification);
    for (measured, drifts) in measurement.setups.iter().zip(&measurement.drifts) {
        widen_drifting(&mut identification.modes, measured.setup, drifts);
    }
    note_idle_bands(&mut identification);
    let times = Times { modes, second_opinion: second_start.elapsed(), all: start.elapsed() };
    let mut warnings = measurement.warnings.clone();
    warnings.extend(block_warnings(&identification.modes, &measurement.setups));
    warnings.append(&mut identification.warnings);
    let suspicions = suspicions(&identification.modes, &measurement.setups);
    warnings.extend(suspicions.into_iter().map(|suspicion| suspicion.words));
    warnings.extend(phase_suspicions(&identification.modes, &measurement.setups));
    warnings.extend(lean_suspicions(&identification.modes, &measurement.setups));
    identification.warnings = warnings;
    Ok(report(study, identification, &measurement, &times))
}

/// Measures, with shorter segments where gaps leave too few windows, or none.
pub(super) fn measure_between_gaps<'a>(
    study: &'a Study,
    route: Route,
    method: Method,
    mut lines: Lines,
    progress: Progress<'_>,
) -> Result<Measurement<'a>, MeasureError> {
    loop {
        let measured = measure(study, route, lines, progress);
        let shorter = match &measured {
            // The subspace needs no more averages than there are.
            Ok(measurement) if method != Method::Subspace => after_gaps(measurement, study),
            Err(MeasureError::NoSound { segment, .. }) if is_segment_free(study) && *segment > SHORTEST_SEGMENT => {
                Some(AfterGaps { too_long: *segment, longest: segment / 2 })
            }
            _ => None,
        };
        let Some(after_gaps) = shorter else { return measured };
        lines = Lines::AfterGaps(after_gaps);
    }
}

/// Whether the program may choose how long segments are: what nodes have sent is cut already.
fn is_segment_free(study: &Study) -> bool {
    study.analysis.segment.is_none() && !study.setups.iter().any(|setup| setup.live)
}

/// The segments that gaps leave enough windows of, where they do not of those that were chosen from the record's length.
fn after_gaps(measurement: &Measurement<'_>, study: &Study) -> Option<AfterGaps> {
    let averages: usize = measurement.setups.iter().map(|setup| setup.spectrum.averages()).sum();
    let channels = measurement.setups.iter().map(|setup| setup.spectrum.channels().len()).max()?;
    // Who names all modes gets them from fewer averages, too.
    let is_free = is_segment_free(study) && study.analysis.modes.only_hz.is_none();
    let too_long = measurement.plan.grid.segment;
    let (mut longest, mut left) = (too_long, averages.max(1));
    while left < AVERAGES_A_CHANNEL * channels && longest > SHORTEST_SEGMENT {
        // Windows of half the length are twice as many, and more of them fit between gaps.
        (longest, left) = (longest / 2, 2 * left);
    }
    (is_free && longest < too_long).then_some(AfterGaps { too_long, longest })
}

/// How long identification took, and everything.
struct Times {
    modes: Duration,
    second_opinion: Duration,
    all: Duration,
}

fn report(study: &Study, identification: Identification, measurement: &Measurement<'_>, times: &Times) -> ModesReport {
    let grid = measurement.plan.grid;
    let timings = measurement.timings;
    let (spectra, records) =
        (Spectra::of(&identification, &measurement.setups), Records::of(&measurement.overviews, &measurement.setups));
    ModesReport {
        identification,
        spectra,
        records,
        segments: SegmentReport {
            points: grid.segment,
            decimated_rate_hz: grid.sampling_rate_hz,
            duration_s: 1.0 / grid.spacing_hz(),
            reasons: measurement.reasons.clone(),
        },
        collected: measurement.collected.clone(),
        record_needed: None,
        trends: None,
        choice: study.analysis.modes.clone(),
        inputs: Inputs::of(study),
        grid,
        has_finer_lines: measurement.plan.has_finer_lines,
        link: link_report(&measurement.fleets),
        timings: TimingReport {
            recorded_s: measurement.duration_s,
            counting_s: timings.counting.as_secs_f64(),
            reading_s: timings.reading.as_secs_f64(),
            spectra_s: timings.spectra.as_secs_f64(),
            averaging_s: timings.averaging.as_secs_f64(),
            modes_s: times.modes.as_secs_f64(),
            second_opinion_s: times.second_opinion.as_secs_f64(),
            times_faster_than_real_time: measurement.duration_s / times.all.as_secs_f64(),
        },
    }
}

fn link_report(fleets: &[FleetReport]) -> Option<LinkReport> {
    let nodes = || fleets.iter().flat_map(|fleet| &fleet.nodes);
    let channel_seconds: f64 =
        fleets.iter().map(|f| f.duration_s * f.nodes.iter().map(|node| node.channels as f64).sum::<f64>()).sum();
    (!fleets.is_empty()).then(|| LinkReport {
        windows: nodes().map(|node| node.session.windows).sum(),
        lost_windows: nodes().map(|node| node.session.lost_windows).sum(),
        damaged_frames: nodes().map(|node| node.to_host.damaged() + node.to_node.damaged()).sum(),
        parts_asked_again: nodes().map(|node| node.session.asked_again).sum(),
        bytes_per_second_and_channel: nodes().map(|node| node.to_host.bytes).sum::<u64>() as f64 / channel_seconds,
    })
}

impl ModesReport {
    /// Why there are no modes; `None` where there are some. `picture` shows the singular values, `earlier` holds modes of an
    /// earlier run.
    pub(super) fn no_modes(&self, picture: PathBuf, earlier: Option<PathBuf>) -> Option<StoryError> {
        let mut reason = self.why_no_modes()?;
        if let Some(earlier) = earlier {
            reason += &format!(" {} keeps the modes of an earlier run.", earlier.display());
        }
        let last = self.grid.lines.saturating_sub(1);
        let band_hz = [self.grid.frequency_hz(0), self.grid.frequency_hz(last)];
        Some(StoryError::NoModes { band_hz, reason, picture, warnings: self.identification.warnings.clone() })
    }

    /// Why there are no modes and what to do, in whole sentences; `None` where there are some.
    pub fn why_no_modes(&self) -> Option<String> {
        let (found, choice) = (&self.identification, &self.choice);
        if !found.modes.is_empty() {
            return None;
        }
        Some(if !found.harmonics.is_empty() {
            let lines: Vec<String> =
                found.harmonics.iter().map(|line| format!("{:.4} Hz", line.frequency_hz)).collect();
            format!(
                "what stands out there are forced lines ({}), as of machinery or vortices. Look in another band (band_hz in [analysis]), or record while the machinery stands still.",
                lines.join(", ")
            )
        } else if choice.only_hz.is_some() || !choice.drop_hz.is_empty() {
            "what modes_hz and drop_modes_hz in [analysis] leave is not in the data. Take them out to see what is picked automatically."
                .to_owned()
        } else if let Some(rejected) = found.rejected_in_words() {
            format!("what stands out there is too uncertain for a mode. {rejected} A longer record would tell.")
        } else {
            format!(
                "no peak stands out from the noise in {} averages ({:.1} h of recording). Record for longer, look in another band (band_hz in [analysis]), or check that the sensors move; add_modes_hz = [...] names a mode that you know to be there.",
                found.averages,
                found.record_s / 3600.0
            )
        })
    }
}

/// Where a setup has temperatures, modes are followed without being asked: over this share of the record at a time.
const SHARE_OF_RECORD: f64 = 1.0 / 16.0;

/// The intervals over which modes are followed where nobody asked for any.
pub(super) fn interval_for_temperatures(study: &Study, report: &ModesReport) -> Option<Duration> {
    study.setups.iter().any(|setup| setup.temperature.is_some()).then_some(())?;
    let record_s = report.identification.record_s / study.setups.len() as f64;
    // To a minute, as a user would say it.
    Duration::try_from_secs_f64(60.0 * (SHARE_OF_RECORD * record_s / 60.0).round().max(1.0)).ok()
}
