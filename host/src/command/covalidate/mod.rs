//! `belfry covalidate`: predicts left-out sensors through the model's shapes.

mod motion;
mod shapes;

use std::path::PathBuf;

use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use self::motion::{Split, collect, curves, curves_csv, find_setup};
use self::shapes::{Shapes, Source};
use super::case::{Case, write_json, write_result};
use super::compare::or_dash;
use super::identify::align_right;
use super::{Console, RouteArguments};
use crate::covalidate::{PredictError, Predictor};
use crate::measure::Route;
use crate::picture;

const EXAMPLES: &str = "Examples:
  belfry covalidate canton --channels 09,12                    from windows that simulated nodes collect
  belfry covalidate canton --channels 09,12 --direct           straight from the recording
  belfry covalidate canton --channels 09,12 --start-s 3600 --duration-s 2000

The left-out channels' motion in the analysis band is predicted from the others: y_d = chi_d (chi_sᵀ chi_s)⁻¹ chi_sᵀ y_s
(Lei, Wang, Shen 2012, eq. 16), and E_d = |prediction - measured| / |measured|. Columns: the model as first given, after
the last `belfry update`, with the effects that study.toml puts into the model ([[model.effect]]), and with the measured
mode shapes themselves, which is about what noise and other modes leave. Writes covalidation.json, covalidation.csv (the curves) and covalidation.svg into `results`.";

/// Predict left-out sensors from the others through the model's shapes
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Channels to leave out and to predict
    #[arg(long, value_name = "CHANNELS", value_delimiter = ',', required = true, value_parser = name)]
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

fn name(text: &str) -> Result<String, String> {
    match text.trim() {
        "" => Err("expected names of channels, with a comma between two".to_owned()),
        name => Ok(name.to_owned()),
    }
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
    /// Root mean square of its measured motion in the band, in m/s².
    pub rms_measured: f64,
    /// The same of its predictions.
    pub rms_predicted: BySource,
    /// Standard deviation of the model's prediction where every kept channel has independent noise of standard deviation 1.
    pub noise_gain: f64,
    /// E_d in percent.
    pub error_percent: BySource,
}

/// A figure for each of those whose shapes predict; null where there is no such model.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct BySource {
    /// The model as first given.
    pub model: Option<f64>,
    /// After Psi.
    pub updated: Option<f64>,
    /// With the study's effects.
    pub with_effects: Option<f64>,
    /// With the measured mode shapes: about what noise and other modes leave.
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

/// A prediction that multiplies noise by more says little.
pub(super) const MOST_NOISE_GAIN: f64 = 4.0;

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

/// By how much the noise of the kept channels is raised in the first channel that a request leaves out; no recording is read.
pub(super) fn noise_gain(case: &Case, request: &Request<'_>) -> anyhow::Result<f64> {
    let split = Split::of(case, find_setup(case, request)?, request.channels)?;
    let predictors = predictors(&Shapes::of(case)?.sources, &split, &mut Vec::new())?;
    Ok(predictors.first().map_or(f64::INFINITY, |(_, predictor)| predictor.weights.row(0).norm()))
}

/// Predicts, tells and stores.
pub(super) fn covalidate_case(
    case: &Case,
    request: &Request<'_>,
    console: &Console,
) -> anyhow::Result<CovalidationReport> {
    let setup = find_setup(case, request)?;
    let mut split = Split::of(case, setup, request.channels)?;
    let Shapes { modes, sources, mut warnings } = Shapes::of(case)?;
    // Before hours of recording are read.
    predictors(&sources, &split, &mut Vec::new())?;
    let mut collected = collect(case, setup, request, console)?;
    let motion = collected.motion(setup, &mut split, request.start_s)?;
    let predictors = predictors(&sources, &split, &mut warnings)?;
    warnings.append(&mut collected.warnings);
    let mut channels: Vec<ChannelReport> = split
        .left_out
        .iter()
        .enumerate()
        .map(|(index, &channel)| ChannelReport {
            noise_gain: predictors.first().map_or(f64::NAN, |(_, predictor)| predictor.weights.row(index).norm()),
            channel: setup.sensors[channel].channel.clone(),
            rms_measured: motion.rms(channel),
            rms_predicted: BySource::default(),
            error_percent: BySource::default(),
        })
        .collect();
    let poor: Vec<String> = channels
        .iter()
        .filter(|channel| channel.noise_gain > MOST_NOISE_GAIN)
        .map(|channel| format!("{} (noise gain {:.0})", channel.channel, channel.noise_gain))
        .collect();
    if !poor.is_empty() {
        warnings.push(format!(
            "the kept channels hardly see the motion of channel {}: its E_d is mostly their noise; leave fewer channels out, or use fewer modes (--modes)",
            poor.join(", ")
        ));
    }
    for warning in &warnings {
        console.warn(warning);
    }
    for (source, predictor) in &predictors {
        let errors = motion.error_percent(predictor, &split.kept, &split.left_out);
        let predicted = motion.rms_predicted(predictor, &split.kept);
        for (channel, (error, rms)) in channels.iter_mut().zip(errors.into_iter().zip(predicted)) {
            *source.slot(&mut channel.error_percent) = error;
            *source.slot(&mut channel.rms_predicted) = Some(rms);
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
        modes,
        kept_channels: split.kept.iter().map(|&channel| setup.sensors[channel].channel.clone()).collect(),
        compared_s: collected.seconds(motion.samples()),
        band_hz: collected.band_hz,
        curves: curves_path,
        warnings,
    };
    tell(&report, &picture_path, console);
    write_json(&case.study, "covalidation.json", &report)?;
    Ok(report)
}

/// A predictor from each source. The measured shapes are left out, with a warning, where they cannot be told apart.
fn predictors(
    sources: &[(Source, DMatrix<f64>)],
    split: &Split,
    warnings: &mut Vec<String>,
) -> Result<Vec<(Source, Predictor)>, PredictError> {
    let mut predictors = Vec::new();
    for (source, shapes) in sources {
        let predictor =
            Predictor::new(&shapes.select_rows(&split.kept_rows), &shapes.select_rows(&split.left_out_rows));
        match predictor {
            Ok(predictor) => predictors.push((*source, predictor)),
            Err(error) if *source == Source::MeasuredShapes => {
                warnings.push(format!("measured shapes: left out, because {error}"));
            }
            Err(error) => return Err(error),
        }
    }
    Ok(predictors)
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
        "RMS m/s²",
        "predicted",
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
            channel.rms_predicted.model.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.3e}")),
            format!("{:.2}", channel.noise_gain),
            or_dash(errors.model, 2),
            or_dash(errors.updated, 2),
            or_dash(errors.with_effects, 2),
            or_dash(errors.measured_shapes, 2),
        ]);
    }
    align_right(&mut table, 8);
    console.say(table);
    console.say(
        "E_d judges the span of the model's shapes, not its frequencies. A Psi update turns the shapes within that span, so it
cannot change E_d, however good its frequencies and MAC look; E_d falls when physics is put into the model that its shapes
lacked. It does not fall to zero: noise of the kept channels (times the noise gain) and of the channel itself stays, and
so does motion of modes that are not among those used. The measured shapes show about how much that is (they have seen the left-out
channels, so they may be a little better than true shapes). Set side by side only what has the same modes and channels.",
    );
    console.say(format!("Curves: {}", report.curves.display()));
    console.say(format!("Picture: {}", picture.display()));
}
