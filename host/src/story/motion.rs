//! The recorded motion: what the windows of a setup add up to, and the curves of a picture.

use std::fmt::Write as _;

use super::case::Case;
use super::error::{CovalidateError, StoryError};
use super::left_out::Split;
use super::shapes::{BySource, Source};
use crate::covalidate::{Hop, Motion, OverlapAdd, Predictor, Witness};
use crate::measure::{Route, epoch_s, measure_observed};
use crate::picture::{Curves, Prediction};
use crate::progress::{OnProgress, rows_of};
use crate::study::Setup;

/// The part of a recording that is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// Where it starts, in s.
    pub start_s: f64,
    /// How long it is; `None` for all that follows.
    pub duration_s: Option<f64>,
}

impl Stretch {
    /// All of a recording.
    pub const ALL: Self = Self { start_s: 0.0, duration_s: None };
}

/// What the recording gave.
pub(super) struct Collected {
    witness: Witness,
    /// Samples of the channels in the time of the curves, one vector a time; NaN where not sound.
    samples: Vec<Vec<f64>>,
    first_sample_s: f64,
    rate_hz: f64,
    /// The band of the lines.
    pub(super) band_hz: [f64; 2],
    /// What the reader should know.
    pub(super) warnings: Vec<String>,
}

/// Length of the curves that are kept and drawn, in s: as the paper's Fig. 4.
const CURVES_S: f64 = 2000.0;

/// Plays the recording and adds its windows up.
pub(super) fn collect(
    case: &Case,
    setup: &Setup,
    stretch: Stretch,
    route: Route,
    on_progress: OnProgress<'_>,
) -> Result<Collected, StoryError> {
    // The other setups' recordings are not needed.
    let mut study = case.study.clone();
    study.setups.retain(|other| other.name == setup.name);
    let channels = setup.sensors.len();
    let end_s = stretch.duration_s.map_or(f64::INFINITY, |duration_s| stretch.start_s + duration_s);
    let mut collected = Collected {
        witness: Witness::new(channels),
        samples: Vec::new(),
        first_sample_s: 0.0,
        rate_hz: 1.0,
        band_hz: [0.0, 0.0],
        warnings: Vec::new(),
    };
    let mut overlap: Option<OverlapAdd> = None;
    let measurement = measure_observed(&study, route, &mut rows_of("windows", on_progress), &mut |_, grid, window| {
        let overlap = overlap.get_or_insert_with(|| OverlapAdd::new(*grid, epoch_s(setup, grid), channels));
        let samples = overlap.hop();
        let Some(hop) = overlap.push(window) else { return };
        let length_s = samples as f64 / grid.sampling_rate_hz;
        if hop.start_s >= stretch.start_s && hop.start_s + length_s <= end_s {
            collected.rate_hz = grid.sampling_rate_hz;
            collected.witness.add(&hop);
            collected.keep(&hop, samples);
        }
    })?;
    let grid = measurement.plan.grid;
    collected.band_hz = [grid.frequency_hz(0), grid.frequency_hz(grid.lines.saturating_sub(1))];
    collected.warnings.extend(measurement.warnings);
    Ok(collected)
}

impl Collected {
    /// Keeps half a segment of `samples` samples for the curves, at its own time.
    fn keep(&mut self, hop: &Hop<'_>, samples: usize) {
        if self.samples.is_empty() {
            self.first_sample_s = hop.start_s;
        }
        let wanted = (CURVES_S * self.rate_hz) as usize;
        let first = ((hop.start_s - self.first_sample_s) * self.rate_hz).round().max(0.0) as usize;
        let end = (first + samples).min(wanted);
        if first >= end {
            return;
        }
        // A half segment that is missing leaves a gap.
        self.samples.resize_with(end.max(self.samples.len()), || vec![f64::NAN; hop.channels.len()]);
        for (index, row) in self.samples[first..end].iter_mut().enumerate() {
            for (value, channel) in row.iter_mut().zip(hop.channels) {
                *value = channel.as_ref().and_then(|samples| samples.get(index)).copied().unwrap_or(f64::NAN);
            }
        }
    }

    /// The motion while all channels of the split are sound. A kept channel that mostly is not, or does not move, is taken
    /// out of the split first, with a warning.
    pub(super) fn motion(&mut self, setup: &Setup, split: &mut Split, start_s: f64) -> Result<Motion, CovalidateError> {
        let name = |channel: usize| setup.sensors[channel].channel.as_str();
        if self.witness.hops() == 0 {
            return Err(CovalidateError::TooShort { start_s });
        }
        let silent: Vec<&str> = split
            .left_out
            .iter()
            .filter(|&&channel| self.witness.motion(&[channel]).rms(channel) <= 0.0)
            .map(|&channel| name(channel))
            .collect();
        if !silent.is_empty() {
            let (channels, setup) = (silent.join(", "), setup.name.clone());
            return Err(CovalidateError::Silent { channels, setup, start_s });
        }
        let predicted = self.witness.sound_hops(&split.left_out);
        let mut with = split.left_out.clone();
        let mut poor = Vec::new();
        for &channel in &split.kept {
            with.push(channel);
            let together = self.witness.sound_hops(&with);
            if 2 * together < predicted {
                poor.push(channel);
                self.warnings.push(format!(
                    "channel {} does not help to predict: it is sound in {together} of {predicted} half segments only",
                    name(channel)
                ));
            } else if together > 0 && self.witness.motion(&with).rms(channel) <= 0.0 {
                poor.push(channel);
                self.warnings.push(format!("channel {} does not help to predict: it does not move", name(channel)));
            }
            with.pop();
        }
        split.retain_kept(|channel| !poor.contains(&channel));
        with.extend(&split.kept);
        let motion = self.witness.motion(&with);
        if motion.samples() == 0 {
            return Err(CovalidateError::NeverSound { start_s, setup: setup.name.clone() });
        }
        let lost = self.witness.hops() - self.witness.sound_hops(&with);
        if lost > 0 {
            self.warnings.push(format!("{lost} half segments are left out: a channel is not sound in them"));
        }
        Ok(motion)
    }

    /// Duration of so many samples in s.
    pub(super) fn seconds(&self, samples: u64) -> f64 {
        samples as f64 / self.rate_hz
    }
}

/// The left-out channels' curves, measured and predicted; `errors_percent` has a channel's E_d by source.
pub(super) fn curves(
    setup: &Setup,
    split: &Split,
    collected: &Collected,
    predictors: &[(Source, Predictor)],
    errors_percent: &[BySource],
) -> Vec<Curves> {
    let predict = |predictor: &Predictor, index: usize, sample: &Vec<f64>| {
        split.kept.iter().zip(predictor.weights.row(index).iter()).map(|(&kept, weight)| weight * sample[kept]).sum()
    };
    let one = |(index, &channel): (usize, &usize)| Curves {
        channel: setup.sensors[channel].channel.clone(),
        start_s: collected.first_sample_s,
        rate_hz: collected.rate_hz,
        unit: setup.motion().unit(),
        measured: collected.samples.iter().map(|sample| sample[channel]).collect(),
        predictions: predictors
            .iter()
            .map(|(source, predictor)| Prediction {
                label: source.label(),
                values: collected.samples.iter().map(|sample| predict(predictor, index, sample)).collect(),
                error_percent: errors_percent.get(index).and_then(|errors| source.of(*errors)),
            })
            .collect(),
    };
    split.left_out.iter().enumerate().map(one).collect()
}

/// `time_s`, then for each left-out channel its measured motion and every prediction; empty where not sound.
pub(super) fn curves_csv(curves: &[Curves]) -> String {
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
