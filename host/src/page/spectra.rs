//! What pictures of spectra and recordings need of an identification, small enough for a page: `spectra.json` and `record.json`.

use serde::Serialize;

use super::packed::Packed;
use crate::identify::{FittedSpectrum, Identification, MeasuredSetup, peaks_of};
use crate::measure::Overview;
use crate::spectra::LineGrid;
use crate::study::Setup;

/// Lines of a setup that are shown at most; more are taken together by their largest.
const LINES: usize = 8192;
/// Singular values that the page draws.
const SHOWN_VALUES: usize = 4;

/// What `results/spectra.json` holds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Spectra {
    /// The setups.
    setups: Vec<SetupSpectra>,
    /// Every mode in every setup, measured and fitted.
    fitted: Vec<FittedMode>,
}

/// A setup's spectra.
#[derive(Debug, Clone, Serialize)]
struct SetupSpectra {
    setup: String,
    /// The first frequency, and from one to the next, in Hz.
    first_hz: f64,
    spacing_hz: f64,
    lines: usize,
    averages: usize,
    /// The channels' names, as shapes have them.
    channels: Vec<String>,
    unit: String,
    /// Singular values of the cross-spectral matrix, the largest first.
    singular: Vec<Packed>,
    /// Where peaks of the singular values that are shown stand out, in Hz: those of the largest first.
    peaks_hz: Vec<f64>,
    /// Power spectral densities, channel by channel.
    psd: Vec<Packed>,
}

/// A mode's spectrum behind its modal filter.
#[derive(Debug, Clone, Serialize)]
struct FittedMode {
    mode: usize,
    setup: String,
    frequency_hz: Vec<f64>,
    measured: Packed,
    fitted: Packed,
    /// What the fit expects at the lines of the setup's spectra, where its own are finer.
    on_lines: Option<OnLines>,
    /// Relative standard deviation of a measured density.
    scatter: f64,
    is_misfit: bool,
}

/// Densities at lines of a setup, one after the other.
#[derive(Debug, Clone, Serialize)]
struct OnLines {
    /// Index of the first.
    first_line: usize,
    values: Packed,
}

impl OnLines {
    fn of(spectrum: &FittedSpectrum, measured: &[MeasuredSetup<'_>]) -> Option<Self> {
        let grid = measured.iter().find(|one| one.setup.name == spectrum.setup)?.spectrum.grid();
        let expected = spectrum.on_lines((0..grid.lines).map(|line| grid.frequency_hz(line)), grid.spacing_hz())?;
        // As singular values: the largest of those that are taken together.
        let together = lines_together(grid);
        let line_of = |at: &(f64, f64)| grid.nearest_line(at.0) / together;
        let values = expected
            .chunk_by(|a, b| line_of(a) == line_of(b))
            .map(|group| group.iter().map(|at| at.1).fold(f64::NEG_INFINITY, f64::max));
        Some(Self { first_line: line_of(expected.first()?), values: Packed::fine_log(values) })
    }
}

impl FittedMode {
    fn of(mode: usize, spectrum: &FittedSpectrum, on_lines: Option<OnLines>) -> Self {
        Self {
            mode,
            setup: spectrum.setup.clone(),
            frequency_hz: spectrum.frequency_hz.clone(),
            measured: Packed::fine_log(spectrum.measured.iter().copied()),
            fitted: Packed::fine_log(spectrum.fitted.iter().copied()),
            on_lines,
            scatter: spectrum.scatter,
            is_misfit: spectrum.is_misfit,
        }
    }
}

impl Spectra {
    /// Those that modes were identified from.
    pub fn of(identification: &Identification, measured: &[MeasuredSetup<'_>]) -> Self {
        let setups = measured.iter().map(|setup| setup_spectra(identification, setup, measured)).collect();
        let all = identification.modes.iter().flat_map(|mode| mode.fitted.iter().map(|one| (mode.number, one)));
        let fitted = all.map(|(mode, one)| FittedMode::of(mode, one, OnLines::of(one, measured))).collect();
        Self { setups, fitted }
    }
}

/// So many lines are shown as one.
fn lines_together(grid: &LineGrid) -> usize {
    grid.lines.div_ceil(LINES).max(1)
}

fn setup_spectra(
    identification: &Identification,
    measured: &MeasuredSetup<'_>,
    all: &[MeasuredSetup<'_>],
) -> SetupSpectra {
    let (setup, spectrum) = (measured.setup, &measured.spectrum);
    let grid = spectrum.grid();
    let together = lines_together(grid);
    let largest = |values: &[f64]| -> Vec<f64> {
        values.chunks(together).map(|values| values.iter().copied().fold(f64::NEG_INFINITY, f64::max)).collect()
    };
    let density = |channel: usize| -> Vec<f64> {
        let values: Vec<f64> = (0..grid.lines).map(|line| spectrum.density(line, channel)).collect();
        largest(&values)
    };
    let singular = identification.singular_values.iter().filter(|one| one.setup == setup.name);
    let singular: Vec<Vec<f64>> = singular.flat_map(|one| &one.values).map(|values| largest(values)).collect();
    // The middle of those that are taken together.
    let first_hz = grid.frequency_hz(0) + 0.5 * (together - 1) as f64 * grid.spacing_hz();
    let spacing_hz = together as f64 * grid.spacing_hz();
    let peaks = singular.iter().take(SHOWN_VALUES).flat_map(|values| peaks_of(values, spectrum.averages()));
    SetupSpectra {
        setup: setup.name.clone(),
        first_hz,
        spacing_hz,
        lines: grid.lines.div_ceil(together),
        averages: spectrum.averages(),
        channels: spectrum.channels().iter().map(|channel| channel_name(setup, *channel, all)).collect(),
        unit: format!("({})²/Hz", setup.motion().unit()),
        peaks_hz: peaks.map(|line| first_hz + line as f64 * spacing_hz).collect(),
        singular: singular.into_iter().map(Packed::fine_log).collect(),
        psd: (0..spectrum.channels().len()).map(|channel| Packed::fine_log(density(channel))).collect(),
    }
}

/// A channel's name; `setup/channel` where it recurs in other setups.
fn channel_name(setup: &Setup, channel: usize, all: &[MeasuredSetup<'_>]) -> String {
    let name = setup.sensors.get(channel).map_or("", |sensor| &sensor.channel);
    let sensors = all.iter().flat_map(|one| &one.setup.sensors);
    let recurs = sensors.filter(|sensor| sensor.channel == name).count() > 1;
    if recurs { format!("{}/{name}", setup.name) } else { name.to_owned() }
}

/// What `results/record.json` holds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Records {
    /// The setups' recordings.
    setups: Vec<SetupRecord>,
}

/// A setup's recording at one glance.
#[derive(Debug, Clone, Serialize)]
struct SetupRecord {
    setup: String,
    duration_s: f64,
    /// How long each piece is whose smallest and largest values follow.
    bin_s: f64,
    channels: Vec<String>,
    /// The unit of the first channel, and of each.
    unit: &'static str,
    units: Vec<&'static str>,
    min: Vec<Packed>,
    max: Vec<Packed>,
    waterfall: Option<WaterfallRecord>,
}

/// Densities over time, the mean of all channels.
#[derive(Debug, Clone, Serialize)]
struct WaterfallRecord {
    /// From the start of one row to the next.
    row_s: f64,
    first_hz: f64,
    spacing_hz: f64,
    columns: usize,
    rows: usize,
    /// Row after row.
    values: Packed,
}

impl Records {
    /// Those that were measured.
    pub fn of(overviews: &[Overview], measured: &[MeasuredSetup<'_>]) -> Self {
        let setup = |(overview, one): (&Overview, &MeasuredSetup<'_>)| setup_record(overview, one, measured);
        Self { setups: overviews.iter().zip(measured).map(setup).collect() }
    }
}

fn setup_record(overview: &Overview, measured: &MeasuredSetup<'_>, all: &[MeasuredSetup<'_>]) -> SetupRecord {
    let (setup, ranges) = (measured.setup, &overview.ranges);
    let channels = if ranges.rows == 0 { 0 } else { setup.sensors.len() };
    let side =
        |side: usize| (0..channels).map(|channel| Packed::fine(ranges.of(channel).map(|range| range[side]))).collect();
    let (grid, waterfall) = (measured.spectrum.grid(), &overview.waterfall);
    let hop_s = 0.5 / grid.spacing_hz();
    let waterfall = (waterfall.rows() > 0).then(|| WaterfallRecord {
        row_s: waterfall.windows_a_row as f64 * hop_s,
        first_hz: grid.frequency_hz(0) + 0.5 * (waterfall.lines_a_column - 1) as f64 * grid.spacing_hz(),
        spacing_hz: waterfall.lines_a_column as f64 * grid.spacing_hz(),
        columns: waterfall.columns,
        rows: waterfall.rows(),
        values: Packed::coarse_log(waterfall.densities()),
    });
    let units: Vec<&str> =
        setup.sensors.iter().take(channels).map(|sensor| setup.unit_of(sensor).motion().unit()).collect();
    SetupRecord {
        setup: setup.name.clone(),
        duration_s: ranges.rows as f64 / overview.sampling_rate_hz,
        bin_s: ranges.rows_a_bin() as f64 / overview.sampling_rate_hz,
        channels: (0..channels).map(|channel| channel_name(setup, channel, all)).collect(),
        unit: units.first().copied().unwrap_or_default(),
        units,
        min: side(0),
        max: side(1),
        waterfall,
    }
}
