//! `belfry covalidate`: predicts left-out sensors through the model's shapes.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::case::{Case, results_folder, write_json, write_result};
use super::compare::or_dash;
use super::identify::align_right;
use super::update::UpdateReport;
use super::{Console, RouteArguments};
use crate::compare::{ModelView, pair};
use crate::covalidate::{OverlapAdd, Predictor, Witness};
use crate::measure::{Route, measure_observed};
use crate::measured::MeasuredMode;
use crate::picture::{self, Curves, Prediction};
use crate::study::{Sensor, Setup};

const EXAMPLES: &str = "Examples:
  belfry covalidate canton --channels 09,12                    from windows that simulated nodes collect
  belfry covalidate canton --channels 09,12 --direct           straight from the recording
  belfry covalidate canton --channels 09,12 --start-s 3600 --duration-s 2000

The left-out channels' motion in the analysis band is predicted from the others: y_d = chi_d (chi_sᵀ chi_s)⁻¹ chi_sᵀ y_s
(Lei, Wang, Shen 2012, eq. 16), and E_d = |prediction - measured| / |measured|. Columns: the model as first given, after
the last `belfry update`, with the study's effects, and with the measured mode shapes themselves, which is what noise alone
leaves. Writes covalidation.json, covalidation.csv (the curves) and covalidation.svg into `results`.";

/// Predict left-out sensors from the others through the model's shapes
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Channels to leave out and to predict
    #[arg(long, value_name = "CHANNELS", value_delimiter = ',', required = true)]
    pub channels: Vec<String>,
    /// Numbers of the measured modes whose partners predict, as in 1,2,5 [default: all that have one]
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    pub modes: Vec<usize>,
    /// The setup to take, where several have the channels [default: the first]
    #[arg(long, value_name = "NAME")]
    pub setup: Option<String>,
    /// Where in the recording to start, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = seconds)]
    pub start_s: f64,
    /// How much of it to take, in seconds [default: all]
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub duration_s: Option<f64>,
    /// How the recording is read
    #[command(flatten)]
    pub route: RouteArguments,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds >= 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected seconds, 0 or more".to_owned()),
    }
}

/// What `--json` prints and `results/covalidation.json` holds.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CovalidationReport {
    /// The left-out channels.
    pub channels: Vec<ChannelReport>,
    /// Numbers of the measured modes whose partners predict.
    pub modes: Vec<usize>,
    /// Channels that predict.
    pub kept_channels: Vec<String>,
    /// Length of what was compared, in s.
    pub compared_s: f64,
    /// The band of the comparison.
    pub band_hz: [f64; 2],
    /// The file of the curves.
    pub curves: PathBuf,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// A left-out channel.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ChannelReport {
    /// Its name.
    pub channel: String,
    /// Root mean square of its measured motion in the band, in the setup's unit.
    pub rms_measured: f64,
    /// Standard deviation of the model's prediction where every kept channel has independent noise of standard deviation 1.
    pub noise_gain: f64,
    /// E_d.
    pub error_percent: Errors,
}

/// E_d in percent; null where there is no such model.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Errors {
    /// The model as first given.
    pub model: Option<f64>,
    /// After Psi.
    pub updated: Option<f64>,
    /// With the study's effects.
    pub with_effects: Option<f64>,
    /// With the measured mode shapes: what noise alone leaves.
    pub measured_shapes: Option<f64>,
}

/// What is asked for, apart from the study.
pub(super) struct Request<'a> {
    pub(super) channels: &'a [String],
    pub(super) setup: Option<&'a str>,
    pub(super) start_s: f64,
    pub(super) duration_s: Option<f64>,
    pub(super) route: Route,
}

/// Length of the curves that are kept and drawn, in s: as the paper's Fig. 4.
const CURVES_S: f64 = 2000.0;

/// Runs the command.
///
/// # Errors
/// When the study has no recording or no model, a channel is unknown, or the kept sensors cannot tell the modes apart.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let mut case = Case::load(&arguments.study, console)?;
    case.keep_modes(&arguments.modes)?;
    let request = Request {
        channels: &arguments.channels,
        setup: arguments.setup.as_deref(),
        start_s: arguments.start_s,
        duration_s: arguments.duration_s,
        route: arguments.route.route(),
    };
    let report = covalidate_case(&case, &request, console)?;
    console.json(&report)
}

/// Predicts, tells and stores.
pub(super) fn covalidate_case(
    case: &Case,
    request: &Request<'_>,
    console: &Console,
) -> anyhow::Result<CovalidationReport> {
    let setup = find_setup(case, request)?;
    let split = Split::of(case, setup, request.channels)?;
    let mut warnings = Vec::new();
    let sources = sources(case, &mut warnings)?;
    let mut predictors: Vec<(Source, Predictor)> = Vec::new();
    for (source, shapes) in sources {
        let predictor =
            Predictor::new(&shapes.select_rows(&split.kept_rows), &shapes.select_rows(&split.left_out_rows));
        match (source, predictor) {
            (_, Ok(predictor)) => predictors.push((source, predictor)),
            // Without the measured shapes only the floor is missing.
            (Source::MeasuredShapes, Err(_)) => {}
            (_, Err(error)) => return Err(error.into()),
        }
    }
    let collected = collect(case, setup, request, console)?;
    warnings.extend(collected.warnings.iter().cloned());
    for warning in &warnings {
        console.warn(warning);
    }
    if collected.witness.samples() == 0 {
        bail!(
            "no two neighbouring windows from {} s on are sound on all channels: nothing to compare; choose another --start-s",
            request.start_s
        );
    }
    let mut channels: Vec<ChannelReport> = split
        .left_out
        .iter()
        .enumerate()
        .map(|(index, &channel)| ChannelReport {
            noise_gain: predictors.first().map_or(f64::NAN, |(_, predictor)| predictor.weights.row(index).norm()),
            channel: setup.sensors[channel].channel.clone(),
            rms_measured: collected.witness.rms(channel),
            error_percent: Errors::default(),
        })
        .collect();
    for (source, predictor) in &predictors {
        let errors = collected.witness.error_percent(predictor, &split.kept, &split.left_out);
        for (channel, error) in channels.iter_mut().zip(errors) {
            *source.slot(&mut channel.error_percent) = error;
        }
    }
    let curves = curves(setup, &split, &collected, &predictors);
    let curves_path = write_result(&case.study, "covalidation.csv", curves_csv(&curves).as_bytes())?;
    let picture_path = write_result(
        &case.study,
        "covalidation.svg",
        picture::covalidation(&case.study.structure.name, &curves)?.as_bytes(),
    )?;
    let report = CovalidationReport {
        channels,
        modes: case.pairs().iter().map(|pair| case.measured.modes[pair.measured].number).collect(),
        kept_channels: split.kept.iter().map(|&channel| setup.sensors[channel].channel.clone()).collect(),
        compared_s: collected.witness.samples() as f64 / collected.rate_hz,
        band_hz: collected.band_hz,
        curves: curves_path,
        warnings,
    };
    tell(&report, &picture_path, console);
    write_json(&case.study, "covalidation.json", &report)?;
    Ok(report)
}

/// Whose shapes predict.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    Model,
    Updated,
    WithEffects,
    MeasuredShapes,
}

impl Source {
    fn slot(self, errors: &mut Errors) -> &mut Option<f64> {
        match self {
            Self::Model => &mut errors.model,
            Self::Updated => &mut errors.updated,
            Self::WithEffects => &mut errors.with_effects,
            Self::MeasuredShapes => &mut errors.measured_shapes,
        }
    }

    fn label(self) -> &'static str {
        match self {
            Self::Model => "model",
            Self::Updated => "updated",
            Self::WithEffects => "with_effects",
            Self::MeasuredShapes => "measured_shapes",
        }
    }
}

/// Channels that predict and channels that are predicted, as places in the setup and as rows of the shapes.
struct Split {
    kept: Vec<usize>,
    left_out: Vec<usize>,
    kept_rows: Vec<usize>,
    left_out_rows: Vec<usize>,
}

impl Split {
    fn of(case: &Case, setup: &Setup, channels: &[String]) -> anyhow::Result<Self> {
        let rows: Vec<usize> = setup
            .sensors
            .iter()
            .map(|sensor| {
                let row = case.sensors.iter().position(|known| same_place(known, sensor, setup));
                row.with_context(|| format!("channel {}: it has no place among the study's sensors", sensor.channel))
            })
            .collect::<Result<_, _>>()?;
        let is_left_out =
            |sensor: &Sensor| channels.iter().any(|name| *name == sensor.channel || *name == sensor.point);
        let (left_out, kept): (Vec<usize>, Vec<usize>) =
            (0..setup.sensors.len()).partition(|&channel| is_left_out(&setup.sensors[channel]));
        if kept.is_empty() {
            bail!("--channels names every channel of setup \"{}\"; leave some to predict from", setup.name);
        }
        let row_of = |channels: &[usize]| channels.iter().map(|&channel| rows[channel]).collect();
        Ok(Self { kept_rows: row_of(&kept), left_out_rows: row_of(&left_out), kept, left_out })
    }
}

fn same_place(known: &Sensor, sensor: &Sensor, setup: &Setup) -> bool {
    let own = known.channel == sensor.channel || known.channel == format!("{}/{}", setup.name, sensor.channel);
    known.point == sensor.point && (own || (known.reference && sensor.reference))
}

fn find_setup<'a>(case: &'a Case, request: &Request<'_>) -> anyhow::Result<&'a Setup> {
    let setups = &case.study.setups;
    if setups.is_empty() {
        bail!(
            "the study has [measured] modes and no recording: co-validation predicts motion, so it needs a [[setup]]"
        );
    }
    let has = |setup: &Setup, name: &String| {
        setup.sensors.iter().any(|sensor| sensor.channel == *name || sensor.point == *name)
    };
    if let Some(name) = request.setup
        && setups.iter().all(|setup| setup.name != name)
    {
        let names: Vec<&str> = setups.iter().map(|setup| setup.name.as_str()).collect();
        bail!("--setup: there is no setup \"{name}\"; the study has {}", names.join(", "));
    }
    let candidates: Vec<&Setup> =
        setups.iter().filter(|setup| request.setup.is_none_or(|name| setup.name == name)).collect();
    if let Some(setup) = candidates.iter().find(|setup| request.channels.iter().all(|name| has(setup, name))) {
        return Ok(setup);
    }
    let unknown = request.channels.iter().find(|name| candidates.iter().all(|setup| !has(setup, name)));
    match unknown {
        Some(name) => {
            let known: Vec<&str> =
                candidates.iter().flat_map(|setup| &setup.sensors).map(|sensor| sensor.channel.as_str()).collect();
            bail!("--channels: there is no channel {name}; the study has {}", known.join(", "))
        }
        None => bail!("--channels: no single setup has all of {}", request.channels.join(", ")),
    }
}

/// Shapes at all sensors (sensors x modes) that are to predict, the model as first given first.
fn sources(case: &Case, warnings: &mut Vec<String>) -> anyhow::Result<Vec<(Source, DMatrix<f64>)>> {
    let modes = &case.measured.modes;
    let paired = |view: &ModelView| {
        let models: Vec<usize> = pair(view, modes).iter().map(|pair| pair.model).collect();
        view.at_sensors.select_columns(&models)
    };
    let given = case.view_as_given()?;
    if pair(&given, modes).is_empty() {
        bail!("no measured mode has a partner in the model; look at `belfry compare`");
    }
    let mut sources = vec![(Source::Model, paired(&given))];
    if let Some(shapes) = updated_shapes(case, &given, warnings)? {
        sources.push((Source::Updated, shapes));
    }
    if !case.model.effects.is_empty() {
        sources.push((Source::WithEffects, paired(&case.view)));
    }
    if let Some(shapes) = measured_shapes(case) {
        sources.push((Source::MeasuredShapes, shapes));
    }
    Ok(sources)
}

/// Phi1 V of the last update, beside the other paired modes; `None` without an update, or where the model has changed since.
fn updated_shapes(case: &Case, given: &ModelView, warnings: &mut Vec<String>) -> anyhow::Result<Option<DMatrix<f64>>> {
    let path = results_folder(&case.study).join("update.json");
    let Ok(text) = std::fs::read_to_string(&path) else { return Ok(None) };
    let update: UpdateReport = serde_json::from_str(&text)
        .with_context(|| format!("{}: not what `belfry update` writes; run it again", path.display()))?;
    let view = if update.effects.is_empty() { given } else { &case.view };
    let fits = (update.effects.is_empty() || update.effects == case.effect_names())
        && update.rotation.len() == update.pairs.len()
        && update.rotation.iter().all(|row| row.len() == update.pairs.len())
        && update.pairs.iter().all(|pair| {
            let there = pair.model.checked_sub(1).and_then(|model| view.modes.frequency_hz.get(model));
            there.is_some_and(|hz| (hz / pair.before.model_hz - 1.0).abs() < 1e-9)
        });
    if !fits {
        warnings.push(format!("{} is of another model than the study's; run `belfry update` again", path.display()));
        return Ok(None);
    }
    let used: Vec<usize> = update.pairs.iter().map(|pair| pair.model - 1).collect();
    let rotation = DMatrix::from_fn(used.len(), used.len(), |row, column| update.rotation[row][column]);
    let turned = view.at_sensors.select_columns(&used) * rotation;
    let others: Vec<usize> =
        pair(view, &case.measured.modes).iter().map(|pair| pair.model).filter(|model| !used.contains(model)).collect();
    let mut shapes = turned.insert_columns(used.len(), others.len(), 0.0);
    for (index, &model) in others.iter().enumerate() {
        shapes.set_column(used.len() + index, &view.at_sensors.column(model));
    }
    Ok(Some(shapes))
}

/// The measured shapes of the paired modes, where every one is known at every sensor.
fn measured_shapes(case: &Case) -> Option<DMatrix<f64>> {
    let sensors = case.sensors.len();
    let columns: Option<Vec<_>> = case
        .pairs()
        .iter()
        .map(|pair| {
            let mode: &MeasuredMode = case.measured.modes.get(pair.measured)?;
            mode.shape.as_ref().filter(|shape| shape.sensors.len() == sensors).map(|shape| shape.values.clone())
        })
        .collect();
    columns.filter(|columns| !columns.is_empty()).map(|columns| DMatrix::from_columns(&columns))
}

/// What the recording gave.
struct Collected {
    witness: Witness,
    /// Channels' samples in the time of the curves, row-major; NaN where not sound.
    samples: Vec<Vec<f64>>,
    first_sample_s: f64,
    rate_hz: f64,
    band_hz: [f64; 2],
    warnings: Vec<String>,
}

fn collect(case: &Case, setup: &Setup, request: &Request<'_>, console: &Console) -> anyhow::Result<Collected> {
    // The other setups' recordings are not needed.
    let mut study = case.study.clone();
    study.setups.retain(|other| other.name == setup.name);
    let channels = setup.sensors.len();
    let end_s = request.duration_s.map_or(f64::INFINITY, |duration_s| request.start_s + duration_s);
    let mut collected = Collected {
        witness: Witness::new(channels),
        samples: Vec::new(),
        first_sample_s: 0.0,
        rate_hz: 1.0,
        band_hz: [0.0, 0.0],
        warnings: Vec::new(),
    };
    let mut overlap: Option<OverlapAdd> = None;
    let bar = console.progress(0, "windows");
    let measurement = measure_observed(
        &study,
        request.route,
        &mut |done, total| {
            bar.set_length(total);
            bar.set_position(done);
        },
        &mut |_, grid, window| {
            let overlap = overlap.get_or_insert_with(|| OverlapAdd::new(*grid, channels));
            let length_s = overlap.hop() as f64 / grid.sampling_rate_hz;
            let Some(hop) = overlap.push(window) else { return };
            if hop.start_s < request.start_s || hop.start_s + length_s > end_s {
                return;
            }
            collected.rate_hz = grid.sampling_rate_hz;
            collected.witness.add(&hop);
            let wanted = (CURVES_S * grid.sampling_rate_hz) as usize;
            if collected.samples.is_empty() {
                collected.first_sample_s = hop.start_s;
            }
            let room = wanted.saturating_sub(collected.samples.len());
            let hop_length = (length_s * grid.sampling_rate_hz).round() as usize;
            for sample in 0..hop_length.min(room) {
                let value = |channel: &Option<Vec<f64>>| {
                    channel.as_ref().and_then(|samples| samples.get(sample)).copied().unwrap_or(f64::NAN)
                };
                collected.samples.push(hop.channels.iter().map(value).collect());
            }
        },
    );
    bar.finish_and_clear();
    let measurement = measurement?;
    let grid = measurement.plan.grid;
    collected.band_hz = [grid.frequency_hz(0), grid.frequency_hz(grid.lines.saturating_sub(1))];
    collected.warnings.extend(measurement.warnings);
    if collected.witness.left_out_hops() > 0 {
        collected.warnings.push(format!(
            "{} half segments are left out: a channel is not sound in them",
            collected.witness.left_out_hops()
        ));
    }
    Ok(collected)
}

fn curves(setup: &Setup, split: &Split, collected: &Collected, predictors: &[(Source, Predictor)]) -> Vec<Curves> {
    let predict = |predictor: &Predictor, index: usize, sample: &Vec<f64>| {
        split.kept.iter().zip(predictor.weights.row(index).iter()).map(|(&kept, weight)| weight * sample[kept]).sum()
    };
    let one = |(index, &channel): (usize, &usize)| Curves {
        channel: setup.sensors[channel].channel.clone(),
        start_s: collected.first_sample_s,
        rate_hz: collected.rate_hz,
        measured: collected.samples.iter().map(|sample| sample[channel]).collect(),
        predictions: predictors
            .iter()
            .map(|(source, predictor)| Prediction {
                label: source.label(),
                values: collected.samples.iter().map(|sample| predict(predictor, index, sample)).collect(),
            })
            .collect(),
    };
    split.left_out.iter().enumerate().map(one).collect()
}

/// `time_s`, then for each left-out channel its measured motion and every prediction; empty where not sound.
fn curves_csv(curves: &[Curves]) -> String {
    let mut text = String::from("time_s");
    for curve in curves {
        text += &format!(",{}_measured", curve.channel);
        for prediction in &curve.predictions {
            text += &format!(",{}_{}", curve.channel, prediction.label);
        }
    }
    text.push('\n');
    let Some(first) = curves.first() else { return text };
    for sample in 0..first.measured.len() {
        // Writing to a string cannot fail.
        let _ = write!(text, "{:.4}", first.start_s + sample as f64 / first.rate_hz);
        for curve in curves {
            for values in std::iter::once(&curve.measured).chain(curve.predictions.iter().map(|p| &p.values)) {
                let value = values.get(sample).copied().unwrap_or(f64::NAN);
                let _ = if value.is_finite() { write!(text, ",{value:.6e}") } else { write!(text, ",") };
            }
        }
        text.push('\n');
    }
    text
}

fn tell(report: &CovalidationReport, picture: &std::path::Path, console: &Console) {
    console.say(format!(
        "\nLeft-out channels from the {} others, through {} modes, {:.0} s, {:.3} to {:.3} Hz",
        report.kept_channels.len(),
        report.modes.len(),
        report.compared_s,
        report.band_hz[0],
        report.band_hz[1]
    ));
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "channel",
        "RMS measured",
        "noise gain",
        "E_d % model",
        "after Psi",
        "with effects",
        "measured shapes",
    ]);
    for channel in &report.channels {
        let errors = channel.error_percent;
        table.add_row([
            channel.channel.clone(),
            format!("{:.3e}", channel.rms_measured),
            format!("{:.2}", channel.noise_gain),
            or_dash(errors.model, 2),
            or_dash(errors.updated, 2),
            or_dash(errors.with_effects, 2),
            or_dash(errors.measured_shapes, 2),
        ]);
    }
    align_right(&mut table, 7);
    console.say(table);
    console.say(
        "E_d judges the span of the model's shapes and nothing else. A Psi update turns the shapes within that span, so it
cannot change E_d, however good its frequencies and MAC look; E_d falls only when physics that the model lacks is put into
it. The last column is what noise leaves: a model that comes near it has the right shapes, of its frequencies it says nothing.
Noise gain is how much of the other channels' noise gets into the prediction.",
    );
    console.say(format!("Curves: {}", report.curves.display()));
    console.say(format!("Picture: {}", picture.display()));
}
