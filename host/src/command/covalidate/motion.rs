//! The recorded motion: which channels predict which, what their windows add up to, the curves of a picture.

use std::fmt::Write as _;

use anyhow::{Context, bail};

use super::super::Console;
use super::super::case::Case;
use super::Request;
use super::shapes::Source;
use crate::covalidate::{Hop, Motion, OverlapAdd, Predictor, Witness};
use crate::measure::{epoch_s, measure_observed};
use crate::picture::{Curves, Prediction};
use crate::study::{Sensor, Setup};

/// Channels that predict and channels that are predicted, as places in the setup and as rows of the shapes.
pub(super) struct Split {
    pub(super) kept: Vec<usize>,
    pub(super) left_out: Vec<usize>,
    pub(super) kept_rows: Vec<usize>,
    pub(super) left_out_rows: Vec<usize>,
}

impl Split {
    pub(super) fn of(case: &Case, setup: &Setup, channels: &[String]) -> anyhow::Result<Self> {
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

impl Split {
    fn retain_kept(&mut self, stays: impl Fn(usize) -> bool) {
        let (kept, rows) = self
            .kept
            .iter()
            .zip(&self.kept_rows)
            .filter(|&(&channel, _)| stays(channel))
            .map(|(&a, &b)| (a, b))
            .unzip();
        (self.kept, self.kept_rows) = (kept, rows);
    }
}

fn same_place(known: &Sensor, sensor: &Sensor, setup: &Setup) -> bool {
    let own = known.channel == sensor.channel || known.channel == format!("{}/{}", setup.name, sensor.channel);
    known.point == sensor.point && (own || (known.reference && sensor.reference))
}

pub(super) fn find_setup<'a>(case: &'a Case, request: &Request<'_>) -> anyhow::Result<&'a Setup> {
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
    request: &Request<'_>,
    console: &Console,
) -> anyhow::Result<Collected> {
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
            let overlap = overlap.get_or_insert_with(|| OverlapAdd::new(*grid, epoch_s(setup, grid), channels));
            let samples = overlap.hop();
            let Some(hop) = overlap.push(window) else { return };
            let length_s = samples as f64 / grid.sampling_rate_hz;
            if hop.start_s >= request.start_s && hop.start_s + length_s <= end_s {
                collected.rate_hz = grid.sampling_rate_hz;
                collected.witness.add(&hop);
                collected.keep(&hop, samples);
            }
        },
    );
    bar.finish_and_clear();
    let measurement = measurement?;
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
    pub(super) fn motion(&mut self, setup: &Setup, split: &mut Split, start_s: f64) -> anyhow::Result<Motion> {
        let name = |channel: usize| setup.sensors[channel].channel.as_str();
        if self.witness.hops() == 0 {
            bail!(
                "from {start_s} s on the time asked for holds no half segment of the analysis; choose an earlier --start-s, or a longer --duration-s"
            );
        }
        let silent: Vec<&str> = split
            .left_out
            .iter()
            .filter(|&&channel| self.witness.motion(&[channel]).rms(channel) <= 0.0)
            .map(|&channel| name(channel))
            .collect();
        if !silent.is_empty() {
            bail!(
                "--channels: {} has no sound data, or does not move, in setup \"{}\" from {start_s} s on; choose other channels",
                silent.join(", "),
                setup.name
            );
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
            bail!(
                "from {start_s} s on, at no time are all channels of setup \"{}\" sound: nothing to compare",
                setup.name
            );
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

/// The left-out channels' curves, measured and predicted.
pub(super) fn curves(
    setup: &Setup,
    split: &Split,
    collected: &Collected,
    predictors: &[(Source, Predictor)],
) -> Vec<Curves> {
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
