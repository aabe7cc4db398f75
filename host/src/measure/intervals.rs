//! Measuring a recording piece by piece: one averaged spectrum an hour, or any other interval.

use std::sync::mpsc::channel;

use super::faults::left_out_sentences;
use super::stream::{self, Task};
use super::{Material, MeasureError, Opened, Progress, Route, Timings, as_collected};
use crate::spectra::{
    CrossSpectrum, CrossSpectrumAccumulator, Lines, PlanError, SetupExtent, SpectraError, SpectralPlan, WindowLines,
};
use crate::study::{Analysis, Setup, Study};

/// Averages an interval needs: its jackknife has as many groups at most, and fewer do not say how sure they are.
const LEAST_AVERAGES: usize = 12;
/// Times of day are known to a microsecond: a middle that is before an interval's begin by less is not.
const CLOCK_STEP_S: f64 = 1e-6;
/// An interval needs this share of the windows that it has room for.
const LEAST_SHARE: f64 = 0.5;

/// One interval of a setup's recording.
#[derive(Debug)]
pub struct Interval {
    /// When the setup's time begins, in s of Unix time where it was collected live; 0 for a recording.
    pub origin_s: f64,
    /// Start after the recording's first row, or after the first window, in s.
    pub start_s: f64,
    /// End, in s.
    pub end_s: f64,
    /// Its spectrum, or why there is none.
    pub spectrum: Result<CrossSpectrum, SpectraError>,
    /// What was left out of it.
    pub warnings: Vec<String>,
    /// Whether something of a later time has come.
    pub is_over: bool,
}

/// Which intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intervals {
    /// Their length in s.
    pub every_s: f64,
    /// When the first begins, in s of Unix time, of what was collected live; with the first row or window where nothing is said.
    pub from_s: Option<f64>,
}

/// Measures the setup's recording in intervals, each with segments that suit its length, and gives them to
/// `on_interval` in the order of time, on a thread of its own. Memory does not grow with the record.
///
/// # Errors
/// When the recording cannot be read, the nodes fail, or an interval is too short for a segment.
pub fn measure_intervals(
    study: &Study,
    setup: &Setup,
    analysis: &Analysis,
    Intervals { every_s, from_s }: Intervals,
    route: Route,
    progress: Progress<'_>,
    mut on_interval: impl FnMut(Interval) + Send,
) -> Result<(), MeasureError> {
    let opened = Opened::open(setup, &study.folder, &study.range)?;
    let interval_rows = (every_s * setup.sampling_rate_hz).round() as u64;
    let extent = SetupExtent { rows: interval_rows.min(opened.rows), ..opened.extent() };
    let analysis = &opened.settled().map_or_else(|| analysis.clone(), |grid| as_collected(analysis, &grid));
    let Opened { material, rows, .. } = opened;
    let too_short = |averages: usize, segment_s: f64| MeasureError::IntervalTooShort {
        every_s,
        averages,
        needed_s: ((LEAST_AVERAGES + 2) as f64 * 0.5 * segment_s).ceil(),
    };
    let plan = match route.plan(&[extent], analysis, Lines::Enough) {
        Err(PlanError::TooShort { segment, decimated_rate_hz, .. }) if interval_rows < rows => {
            return Err(too_short(0, segment as f64 / decimated_rate_hz));
        }
        plan => plan?,
    };
    let averages = plan.windows.iter().sum();
    if averages < LEAST_AVERAGES {
        return Err(too_short(averages, 1.0 / plan.grid.spacing_hz()));
    }
    let decimation = plan.decimations.first().copied().unwrap_or(1);
    let hop_s = 0.5 / plan.grid.spacing_hz();
    let (origin_s, lead_s) = match &material {
        Material::Recording(_) => (0.0, SpectralPlan::lead_rows(decimation) as f64 / setup.sampling_rate_hz),
        Material::Archive(collected) => {
            let start_s = collected.setup.start_s;
            from_s.map_or((start_s, 0.0), |from_s| (from_s, start_s - from_s))
        }
    };
    let fitting = (every_s / hop_s).floor().max(1.0);
    let rounding_s = from_s.map_or(0.0, |_| CLOCK_STEP_S);
    // A window belongs to the interval that holds its middle.
    let interval_of = |window: u64| ((lead_s + (window + 1) as f64 * hop_s + rounding_s) / every_s).floor() as u64;
    let (broken_sender, broken) = channel();
    let mut open: Option<(u64, CrossSpectrumAccumulator, usize)> = None;
    let spectra_failed = |source| MeasureError::Spectra { setup: setup.name.clone(), source };
    let mut close = move |open: Option<(u64, CrossSpectrumAccumulator, usize)>, is_over: bool| {
        let Some((number, accumulator, windows)) = open else { return };
        if (windows as f64) < LEAST_SHARE * fitting {
            return;
        }
        let (spectrum, warnings) = match accumulator.finish() {
            Ok((spectrum, left_out)) => (Ok(spectrum), left_out),
            Err(error) => (Err(error), Vec::new()),
        };
        let warnings = left_out_sentences(setup, &warnings);
        let (start_s, end_s) = (number as f64 * every_s, (number + 1) as f64 * every_s);
        on_interval(Interval { origin_s, start_s, end_s, spectrum, warnings, is_over });
    };
    let mut timings = Timings::default();
    let (grid, channels) = (plan.grid, setup.sensors.len());
    let take = |window: WindowLines| {
        let number = interval_of(window.grid_index);
        if open.as_ref().is_none_or(|(current, _, _)| *current != number) {
            close(open.take(), true);
            // Whether a mode has changed is tested with deviations from equally many groups, so that all intervals take the same
            // lines.
            match CrossSpectrumAccumulator::expecting(grid, channels, fitting as usize) {
                Ok(fresh) => open = Some((number, fresh.keeping_none(), 0)),
                Err(error) => drop(broken_sender.send(error)),
            }
        }
        if let Some((_, accumulator, windows)) = &mut open {
            *windows += 1;
            if let Err(error) = accumulator.add(window) {
                let _ = broken_sender.send(error);
            }
        }
    };
    let task = Task { setup, material, plan: &plan, decimation, route, rows, windows: fitting as usize };
    let mut on_rows = |done: u64| progress(done, rows);
    stream::stream(task, &mut on_rows, &mut |_, _, _| {}, take, &mut timings)?;
    close(open.take(), false);
    match broken.try_iter().next() {
        Some(error) => Err(spectra_failed(error)),
        None => Ok(()),
    }
}
