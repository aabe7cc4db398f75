//! Measuring: from a study's recordings to each setup's cross-spectral matrices, through simulated nodes or directly, or from
//! what real nodes have sent into the archive.
//!
//! A study flows in; averaged cross spectra flow out, with what was left out, what the link did and where the time went. A
//! setup that cannot be measured is left out with a warning as long as another can.

mod copies;
mod error;
mod faults;
mod fill;
mod flat;
mod gains;
mod glance;
mod intervals;
mod jumps;
mod limits;
mod overview;
mod ring;
mod scout;
mod spikes;
mod stream;

use std::path::Path;
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::archive::{Archive, Collected, TimeRange, damage_in_words};
use crate::fleet::{FleetOptions, FleetReport};
use crate::identify::{Drift, MeasuredSetup};
use crate::record::Recording;
use crate::spectra::{
    Alone, CrossSpectrum, CrossSpectrumAccumulator, LineGrid, Lines, PlanError, SetupExtent, SpectraError,
    SpectralPlan, WindowLines, rows_for,
};
use crate::study::{Analysis, Sensor, Setup, Study};
use faults::{
    alone_sentence, copy_sentences, drift_sentences, fault_sentences, left_out_sentences, noisy_sentence,
    reader_sentences, silenced_sentences,
};
use gains::Gains;
use limits::{CutOff, MOST_CUT_OFF};
use stream::{Streamed, Task};

pub use error::MeasureError;
pub(crate) use error::may_be_why;
pub use glance::{ChannelLook, ClippedLook, GapLook, HeldLook, SetupLook, glance};
pub use intervals::{Interval, Intervals, measure_intervals};
pub use overview::{Overview, Ranges, Waterfall};

/// How spectra are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Route {
    /// By simulated sensor nodes: the firmware, a serial line, the host's protocol.
    Nodes(FleetOptions),
    /// Straight from the recording.
    Direct,
}

impl Route {
    /// Decimation, segment and lines by this route.
    fn plan(self, setups: &[SetupExtent], analysis: &Analysis, lines: Lines) -> Result<SpectralPlan, PlanError> {
        SpectralPlan::choose_lines(setups, analysis, lines, matches!(self, Self::Nodes(_)))
    }
}

/// Where the time went. Reading, spectra and averaging run side by side, so their times do not add up.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timings {
    /// Counting rows, and a first look where the study names no band, to choose the analysis.
    pub counting: Duration,
    /// Reading the recordings and checking their rows.
    pub reading: Duration,
    /// Waiting for nodes and link, or computing spectra directly.
    pub spectra: Duration,
    /// Averaging outer products.
    pub averaging: Duration,
}

/// From when to when the windows of a live setup are that were averaged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CollectedSpan {
    /// The setup.
    pub setup: String,
    /// When the first begins, in UTC.
    pub from: String,
    /// When the last ends, in UTC.
    pub to: String,
}

/// What measuring gave.
#[derive(Debug)]
pub struct Measurement<'a> {
    /// Decimation, segment and lines.
    pub plan: SpectralPlan,
    /// Why this band (where it was chosen), rate and segment, a line each.
    pub reasons: Vec<String>,
    /// From when to when the windows of live setups are.
    pub collected: Vec<CollectedSpan>,
    /// The setups that could be measured.
    pub setups: Vec<MeasuredSetup<'a>>,
    /// Each of them at one glance.
    pub overviews: Vec<Overview>,
    /// What the nodes and lines did, for each of them (nothing on the direct route).
    pub fleets: Vec<FleetReport>,
    /// The channels of each setup whose gains drift.
    pub drifts: Vec<Vec<Drift>>,
    /// The channels of each setup that have nothing in common with its others.
    pub alone: Vec<Alone>,
    /// What the reader should know.
    pub warnings: Vec<String>,
    /// Duration of all recordings in s.
    pub duration_s: f64,
    /// Where the time went.
    pub timings: Timings,
}

/// Rows that are read, of how many; for a progress bar.
pub type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// Sees every window on its way into the averages, in the order of the grid.
pub type Observer<'a> = &'a mut dyn FnMut(&Setup, &LineGrid, &WindowLines);

/// Measures all setups of a study.
///
/// # Errors
/// When no setup can be measured; what is wrong with a single one among others becomes a warning.
pub fn measure<'a>(
    study: &'a Study,
    route: Route,
    lines: Lines,
    progress: Progress<'_>,
) -> Result<Measurement<'a>, MeasureError> {
    measure_prepared(prepare_lines(study, route, lines)?, route, progress, &mut |_, _, _| {})
}

/// As [`measure`] with lines that are fine enough, and lets `observer` see the windows.
///
/// # Errors
/// As [`measure`].
pub fn measure_observed<'a>(
    study: &'a Study,
    route: Route,
    progress: Progress<'_>,
    observer: Observer<'_>,
) -> Result<Measurement<'a>, MeasureError> {
    measure_prepared(prepare(study, route)?, route, progress, observer)
}

fn measure_prepared<'a>(
    prepared: Prepared<'a>,
    route: Route,
    progress: Progress<'_>,
    observer: Observer<'_>,
) -> Result<Measurement<'a>, MeasureError> {
    let Prepared { setups: opened, plan, reasons, mut warnings, mut failure, counting } = prepared;
    let mut timings = Timings { counting, ..Timings::default() };
    let total_rows: u64 = opened.iter().map(|opened| opened.rows).sum();
    let collected = opened.iter().filter_map(Opened::span).collect();
    let mut done_rows = 0;
    let (mut setups, mut overviews, mut drifts, mut fleets) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut alone = Vec::new();
    let mut duration_s = 0.0;
    for ((Opened { setup, material, rows }, &decimation), &windows) in
        opened.into_iter().zip(&plan.decimations).zip(&plan.windows)
    {
        let mut on_rows = |rows: u64| progress(done_rows + rows, total_rows);
        let task = Task { setup, material, plan: &plan, decimation, route, rows, windows };
        let outcome = measure_setup(task, &mut on_rows, observer, &mut timings);
        done_rows += rows;
        match outcome {
            Ok(measured) => {
                warnings.extend(measured.warnings);
                fleets.extend(measured.fleet);
                duration_s += rows as f64 / setup.sampling_rate_hz;
                setups.push(measured.setup);
                overviews.push(measured.overview);
                drifts.push(measured.drifts);
                alone.push(measured.alone);
            }
            Err(error) => leave_out(&mut warnings, &mut failure, error),
        }
    }
    if setups.is_empty() {
        return Err(failure.unwrap_or(MeasureError::NoSetups));
    }
    Ok(Measurement {
        plan,
        reasons,
        collected,
        setups,
        overviews,
        drifts,
        alone,
        fleets,
        warnings,
        duration_s,
        timings,
    })
}

/// Where a setup's windows come from.
#[derive(Debug)]
pub enum Material {
    /// A recording, whose windows are still to be made.
    Recording(Box<Recording>),
    /// The archive, which holds those that nodes have sent.
    Archive(Box<Collected>),
}

/// A setup that can be measured.
#[derive(Debug)]
pub struct Opened<'a> {
    /// The setup.
    pub setup: &'a Setup,
    /// Where its windows come from.
    pub material: Material,
    /// Rows of the recording; of an archive those that its windows stand for.
    pub rows: u64,
}

impl<'a> Opened<'a> {
    /// Opens a setup's recording, or its part of the archive.
    fn open(setup: &'a Setup, folder: &Path, range: &TimeRange) -> Result<Self, MeasureError> {
        let name = || setup.name.clone();
        if setup.live {
            let failed = |source| MeasureError::Archive { setup: name(), source: Box::new(source) };
            let nothing = || MeasureError::NothingCollected { setup: name() };
            let Some(archive) = Archive::open(folder).map_err(failed)? else {
                Archive::refuse_empty(folder).map_err(failed)?;
                return Err(nothing());
            };
            let collected = archive.collected(setup, range).map_err(failed)?.ok_or_else(nothing)?;
            let rows = rows_for(collected.setup.windows, collected.setup.decimation, collected.setup.grid.segment);
            return Ok(Self { setup, material: Material::Archive(Box::new(collected)), rows });
        }
        let failed = |source| MeasureError::Record { setup: name(), source: Box::new(source) };
        let recording = Recording::open(setup, folder).map_err(failed)?;
        let rows = recording.total_rows().map_err(failed)?;
        Ok(Self { setup, material: Material::Recording(Box::new(recording)), rows })
    }

    /// The lines that its windows have already.
    fn settled(&self) -> Option<LineGrid> {
        match &self.material {
            Material::Archive(collected) => Some(collected.setup.grid),
            Material::Recording(_) => None,
        }
    }

    /// From when to when its windows are, where nodes have sent them.
    fn span(&self) -> Option<CollectedSpan> {
        let Material::Archive(collected) = &self.material else { return None };
        let [from, to] = collected.setup.span.clone();
        Some(CollectedSpan { setup: self.setup.name.clone(), from, to })
    }

    fn extent(&self) -> SetupExtent {
        SetupExtent {
            sampling_rate_hz: self.setup.sampling_rate_hz,
            rows: self.rows,
            channels: self.setup.sensors.len(),
            block_rows: self.setup.block_rows(),
        }
    }
}

/// Setups that can be measured, and how.
#[derive(Debug)]
pub struct Prepared<'a> {
    /// The setups.
    pub setups: Vec<Opened<'a>>,
    /// Decimation, segment and lines, for these setups in this order.
    pub plan: SpectralPlan,
    /// Why this band (where it was chosen), rate and segment, a line each.
    pub reasons: Vec<String>,
    /// What the reader should know: setups that were left out and why.
    pub warnings: Vec<String>,
    failure: Option<MeasureError>,
    counting: Duration,
}

/// Opens a study's recordings and chooses how to analyse them by this route.
///
/// # Errors
/// When no setup can be measured.
pub fn prepare(study: &Study, route: Route) -> Result<Prepared<'_>, MeasureError> {
    prepare_lines(study, route, Lines::Enough)
}

fn prepare_lines(study: &Study, route: Route, lines: Lines) -> Result<Prepared<'_>, MeasureError> {
    let mut warnings: Vec<String> = Vec::new();
    let start = Instant::now();
    let mut failure = None;
    let mut opened: Vec<Opened<'_>> = Vec::new();
    let mut settled: Option<(LineGrid, &str)> = None;
    for setup in &study.setups {
        match Opened::open(setup, &study.folder, &study.range) {
            Ok(next) => match (next.settled(), settled) {
                (Some(grid), Some((first_grid, first))) if grid != first_grid => {
                    let (setup, first) = (setup.name.clone(), first.to_owned());
                    leave_out(&mut warnings, &mut failure, MeasureError::OtherLines { setup, first });
                }
                (grid, _) => {
                    settled = settled.or(grid.map(|grid| (grid, setup.name.as_str())));
                    opened.push(next);
                }
            },
            Err(error) => leave_out(&mut warnings, &mut failure, error),
        }
    }
    let mut analysis = study.analysis.clone();
    let mut reasons = Vec::new();
    if let Some((grid, _)) = settled {
        analysis = as_collected(&analysis, &grid);
    } else if analysis.band_hz.is_none() && analysis.decimated_rate_hz.is_none() {
        let setups: Vec<&Setup> = opened.iter().map(|opened| opened.setup).collect();
        if let Some((band_hz, reason)) = scout::band(&study.folder, &setups, &extents(&opened), &analysis) {
            analysis.band_hz = Some(band_hz);
            reasons.push(reason);
        }
    }
    let counting = start.elapsed();
    let plan = loop {
        let extents = extents(&opened);
        if extents.is_empty() {
            return Err(failure.unwrap_or(MeasureError::NoSetups));
        }
        match route.plan(&extents, &analysis, lines) {
            Ok(plan) => break plan,
            Err(source @ (PlanError::TooShort { setup, .. } | PlanError::BlocksTooShort { setup, .. }))
                if opened.len() > 1 =>
            {
                let Opened { setup, .. } = opened.remove(setup);
                leave_out(&mut warnings, &mut failure, MeasureError::TooShort { setup: setup.name.clone(), source });
            }
            Err(error) => return Err(error.into()),
        }
    };
    warnings.extend(plan.few_averages.map(|few| few.to_string()));
    warnings.extend(opened.iter().filter_map(other_windows));
    reasons.push(match settled {
        Some((grid, setup)) => collected_reason(&grid, setup, plan.windows.iter().sum()),
        None => plan.reason.clone(),
    });
    let spans = opened.iter().filter_map(Opened::span);
    reasons.extend(
        spans.map(|CollectedSpan { setup, from, to }| format!("Setup \"{setup}\": windows from {from} to {to}.")),
    );
    reasons.extend(opened.iter().filter_map(|opened| gains_in_words(opened.setup)));
    Ok(Prepared { setups: opened, plan, reasons, warnings, failure, counting })
}

/// By what a setup's readings are multiplied, where study.toml says so.
fn gains_in_words(setup: &Setup) -> Option<String> {
    let of = |sensor: &Sensor| {
        let std = sensor.gain_std.map_or(String::new(), |std| format!(" ± {std}"));
        Some(format!("{} by {}{std}", sensor.channel, sensor.gain?))
    };
    let gains: Vec<String> = setup.sensors.iter().filter_map(of).collect();
    (!gains.is_empty()).then(|| format!("Setup \"{}\": readings multiplied, {}.", setup.name, gains.join(", ")))
}

/// The analysis whose lines are those that were collected.
fn as_collected(analysis: &Analysis, grid: &LineGrid) -> Analysis {
    Analysis {
        band_hz: Some([grid.frequency_hz(0), grid.frequency_hz(grid.lines.saturating_sub(1))]),
        decimated_rate_hz: Some(grid.sampling_rate_hz),
        segment: Some(grid.segment),
        ..analysis.clone()
    }
}

fn collected_reason(grid: &LineGrid, setup: &str, averages: usize) -> String {
    format!(
        "As the nodes of setup \"{setup}\" were asked to measure: {} Hz, segments of {} points, {:.1} s; {} lines from {:.4} to {:.4} Hz; {averages} averages.",
        grid.sampling_rate_hz,
        grid.segment,
        1.0 / grid.spacing_hz(),
        grid.lines,
        grid.frequency_hz(0),
        grid.frequency_hz(grid.lines.saturating_sub(1)),
    )
}

/// What the reader should know of windows that cannot be averaged with the newest.
fn other_windows(opened: &Opened<'_>) -> Option<String> {
    let Material::Archive(collected) = &opened.material else { return None };
    let other = collected.setup.other_windows;
    (other > 0).then(|| {
        format!(
            "setup \"{}\": {other} windows of nodes were measured with other lines before, or averaged on the node, and are left out",
            opened.setup.name
        )
    })
}

/// When the grid of a setup's windows begins: after its recording's first row, for its epoch is the first sample that the
/// decimating filter sees whole; with its first window where it was collected live. In s.
pub fn epoch_s(setup: &Setup, grid: &LineGrid) -> f64 {
    if setup.live {
        return 0.0;
    }
    let decimation = (setup.sampling_rate_hz / grid.sampling_rate_hz).round() as u32;
    SpectralPlan::lead_rows(decimation) as f64 / setup.sampling_rate_hz
}

/// What the plan needs to know of the setups that were opened.
fn extents(opened: &[Opened<'_>]) -> Vec<SetupExtent> {
    opened.iter().map(Opened::extent).collect()
}

/// Keeps the first failure, for the case that nothing remains, and says every one.
fn leave_out(warnings: &mut Vec<String>, failure: &mut Option<MeasureError>, error: MeasureError) {
    warnings.push(format!("left out: {error}"));
    failure.get_or_insert(error);
}

struct OneSetup<'a> {
    setup: MeasuredSetup<'a>,
    overview: Overview,
    drifts: Vec<Drift>,
    alone: Alone,
    fleet: Option<FleetReport>,
    warnings: Vec<String>,
}

fn measure_setup<'a>(
    task: Task<'a, '_>,
    on_rows: &mut dyn FnMut(u64),
    observer: Observer<'_>,
    timings: &mut Timings,
) -> Result<OneSetup<'a>, MeasureError> {
    let setup = task.setup;
    let spectra = |source| MeasureError::Spectra { setup: setup.name.clone(), source };
    let mut accumulator =
        CrossSpectrumAccumulator::expecting(task.plan.grid, setup.sensors.len(), task.windows).map_err(spectra)?;
    let mut refused = None;
    let mut gains = Gains::new(setup.sensors.len(), task.plan.grid.lines);
    let average = |window| {
        gains.push(&window);
        if let Err(error) = accumulator.add(window) {
            refused.get_or_insert(error);
        }
    };
    let grid = task.plan.grid;
    let Streamed { report, fleet, faults, silenced, overview, damages } =
        stream::stream(task, on_rows, observer, average, timings)?;
    if let Some(error) = refused {
        return Err(spectra(error));
    }
    let several = |warning: String| format!("setup \"{}\": {warning}", setup.name);
    let of_recording = report.map(|report| reader_sentences(setup, &report.warnings, &faults.filled));
    let of_recording = of_recording.unwrap_or_default();
    let (spectrum, left_out) = accumulator.finish().map_err(|error| match error {
        SpectraError::NoSoundWindows { sound, windows } => {
            let each = setup.sensors.iter().zip(&sound);
            let each = each.map(|(sensor, sound)| format!("\"{}\" in {sound}", sensor.channel));
            let (channels, segment) = (each.collect::<Vec<_>>().join(", "), grid.segment);
            let faults = fault_sentences(setup, &faults, &[]).into_iter();
            let silenced = silenced_sentences(setup, &grid, &silenced);
            let found =
                of_recording.iter().cloned().chain(damage_in_words(&damages)).chain(faults).chain(silenced).collect();
            MeasureError::NoSound { setup: setup.name.clone(), channels, windows, segment, found }
        }
        error => spectra(error),
    })?;
    let mut warnings: Vec<String> = of_recording.into_iter().map(several).collect();
    warnings.extend(damage_in_words(&damages).into_iter().map(several));
    warnings.extend(copy_sentences(setup, &faults.copies).into_iter().map(several));
    let spectrum = spectrum.without_channels(&faults.copies.iter().map(|&[copy, _]| copy).collect::<Vec<_>>());
    let (spectrum, cut_off) = without_cut_off(spectrum, &faults.cut_off);
    warnings.extend(fault_sentences(setup, &faults, &cut_off).into_iter().map(several));
    warnings.extend(silenced_sentences(setup, &grid, &silenced).into_iter().map(several));
    warnings.extend(left_out_sentences(setup, &left_out).into_iter().map(several));
    let (spectrum, alone) = spectrum.without_noisy_channels();
    warnings.extend(noisy_sentence(setup, &alone.loud).map(several));
    warnings.extend(alone_sentence(setup, &alone.quiet).map(several));
    let drifts = gains.finish(spectrum.channels());
    warnings.extend(drift_sentences(setup, &drifts).into_iter().map(several));
    if let Some(fleet) = &fleet {
        let lost: u64 = fleet.nodes.iter().map(|node| node.session.lost_windows).sum();
        if lost > 0 {
            warnings.push(several(format!(
                "{lost} windows were lost on the way: the line is too slow or too bad for what the nodes send"
            )));
        }
    }
    Ok(OneSetup { setup: MeasuredSetup { setup, spectrum }, overview, drifts, alone, fleet, warnings })
}

/// The spectrum without channels that are cut off too often, and which these are; none where they are most of all.
fn without_cut_off(spectrum: CrossSpectrum, cut_off: &[CutOff]) -> (CrossSpectrum, Vec<usize>) {
    let is_cut_off = |channel: &usize| cut_off.get(*channel).is_some_and(|cut_off| cut_off.share > MOST_CUT_OFF);
    let cut_off: Vec<usize> = spectrum.channels().iter().copied().filter(is_cut_off).collect();
    if 2 * cut_off.len() > spectrum.channels().len() {
        return (spectrum, Vec::new());
    }
    (spectrum.without_channels(&cut_off), cut_off)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where no window can be used, what was found says why.
    #[test]
    fn recordings_of_which_nothing_is_sound_say_what_is_wrong_with_them() {
        let folder = tempfile::tempdir().unwrap();
        let row = |row: usize| if (3..40).contains(&(row % 100)) { "nan 0\n".to_owned() } else { format!("{row} 0\n") };
        std::fs::write(folder.path().join("a.txt"), (0..4000).map(row).collect::<String>()).unwrap();
        let sensors = "[[setup.sensor]]\nchannel = \"1\"\nnode = 1\n[[setup.sensor]]\nchannel = \"2\"\nnode = 1\n";
        let setup = "[[setup]]\nname = \"now\"\nfiles = [\"a.txt\"]\nsampling_rate_hz = 10.0\nunit = \"m/s2\"\n";
        let text = format!("[structure]\nname = \"mast\"\n{setup}{sensors}");
        let study = Study::from_text(&text, folder.path()).unwrap();
        let error = measure(&study, Route::Direct, Lines::Enough, &mut |_, _| ()).map(drop).unwrap_err().to_string();
        let (said, found) = error.split_once("What was found in the recordings may be why:").expect(&error);
        assert!(said.contains("windows of") && said.contains("Sound are: \"1\" in 0"), "{error}");
        assert!(found.contains("a.txt, line 4") && found.contains("channel \"2\" is dead"), "{error}");
    }
}
