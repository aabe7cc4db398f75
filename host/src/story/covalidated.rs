//! Co-validation: left-out channels predicted from the others through the shapes of the model, before and after.

use std::path::PathBuf;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::case::Case;
use super::error::StoryError;
use super::left_out::{MOST_NOISE_GAIN, Split, best_seen, find_setup};
use super::motion::{Stretch, collect, curves};
use super::shapes::{BySource, Shapes, Source};
use crate::compare::Comparison;
use crate::covalidate::{PredictError, Predictor};
use crate::measure::Route;
use crate::picture::Curves;
use crate::progress::OnProgress;
use crate::results::Results;

/// The file of the curves.
pub(crate) const CURVES_FILE: &str = "covalidation.csv";

/// What is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct CovalidationRequest {
    /// The channels to leave out and to predict; none for the two that the others predict best.
    pub channels: Vec<String>,
    /// Numbers of the measured modes whose partners predict; none for all that have one.
    pub modes: Vec<usize>,
    /// The setup, where several have the channels.
    pub setup: Option<String>,
    /// Which part of the recording.
    pub stretch: Stretch,
    /// How it is read.
    pub route: Route,
}

impl CovalidationRequest {
    /// These channels, over the whole recording and with all modes.
    pub fn of_channels(channels: Vec<String>, route: Route) -> Self {
        Self { channels, modes: Vec::new(), setup: None, stretch: Stretch::ALL, route }
    }
}

/// What `belfry covalidate --json` prints and `results/covalidation.json` holds.
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
    /// Root mean square of its measured motion in the band, in the unit of its spectra: m/s², or m/s.
    pub rms_measured: f64,
    /// The same of its predictions.
    pub rms_predicted: BySource,
    /// Standard deviation of the model's prediction where every kept channel has independent noise of standard deviation 1.
    pub noise_gain: f64,
    /// E_d in percent.
    pub error_percent: BySource,
}

/// What a co-validation gives.
#[derive(Debug)]
pub struct Covalidation {
    /// The figures.
    pub report: CovalidationReport,
    /// The left-out channels' curves, for a picture.
    pub curves: Vec<Curves>,
}

/// The channel at which the model fails most, of those whose motion the others see.
///
/// # Errors
/// When the study has no recording, or no mode has a partner.
pub fn worst_channel(case: &Case, comparison: &Comparison) -> Result<Option<String>, StoryError> {
    let shapes = Shapes::of(case)?;
    let gain = |channel: &str| -> f64 {
        let channels = [channel.to_owned()];
        let split = find_setup(case, &channels, None).and_then(|setup| Split::of(case, setup, &channels));
        let predictors = split.ok().and_then(|split| predictors(&shapes.sources, &split, &mut Vec::new()).ok());
        let first = predictors.as_ref().and_then(|predictors| predictors.first());
        first.map_or(f64::INFINITY, |(_, predictor)| predictor.weights.row(0).norm())
    };
    let mut sensors: Vec<_> = comparison.by_sensor.iter().collect();
    sensors.sort_by(|a, b| b.misfit.total_cmp(&a.misfit));
    let seen = sensors.iter().find(|sensor| gain(&sensor.channel) < MOST_NOISE_GAIN);
    Ok(seen.or(sensors.first()).map(|sensor| sensor.channel.clone()))
}

/// Predicts channels from the others, and holds the prediction against what was measured; writes nothing.
///
/// # Errors
/// When the study has no recording, a channel is unknown, or the kept sensors cannot tell the modes apart.
pub fn covalidate(
    case: &Case,
    request: &CovalidationRequest,
    on_progress: OnProgress<'_>,
) -> Result<Covalidation, StoryError> {
    let setup = find_setup(case, &request.channels, request.setup.as_deref())?;
    let Shapes { modes, sources, mut warnings } = Shapes::of(case)?;
    let left_out = match (&request.channels[..], sources.first()) {
        ([], Some((_, shapes))) => best_seen(case, setup, shapes)?,
        (channels, _) => channels.to_vec(),
    };
    let mut split = Split::of(case, setup, &left_out)?;
    // Before hours of recording are read.
    predictors(&sources, &split, &mut Vec::new())?;
    let mut collected = collect(case, setup, request.stretch, request.route, on_progress)?;
    let motion = collected.motion(setup, &mut split, request.stretch.start_s)?;
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
    for (source, predictor) in &predictors {
        let errors = motion.error_percent(predictor, &split.kept, &split.left_out);
        let predicted = motion.rms_predicted(predictor, &split.kept);
        for (channel, (error, rms)) in channels.iter_mut().zip(errors.into_iter().zip(predicted)) {
            *source.slot(&mut channel.error_percent) = error;
            *source.slot(&mut channel.rms_predicted) = Some(rms);
        }
    }
    let errors_percent: Vec<BySource> = channels.iter().map(|channel| channel.error_percent).collect();
    let curves = curves(setup, &split, &collected, &predictors, &errors_percent);
    let report = CovalidationReport {
        channels,
        modes,
        kept_channels: split.kept.iter().map(|&channel| setup.sensors[channel].channel.clone()).collect(),
        compared_s: collected.seconds(motion.samples()),
        band_hz: collected.band_hz,
        curves: Results::of(&case.study).path(CURVES_FILE),
        warnings,
    };
    Ok(Covalidation { report, curves })
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
