//! Which channels are left out and predicted, and which predict.

use nalgebra::DMatrix;

use super::case::Case;
use super::error::{CovalidateError, StoryError};
use crate::covalidate::Predictor;
use crate::study::{Sensor, Setup};

/// Channels that predict and channels that are predicted, as places in the setup and as rows of the shapes.
pub(super) struct Split {
    pub(super) kept: Vec<usize>,
    pub(super) left_out: Vec<usize>,
    pub(super) kept_rows: Vec<usize>,
    pub(super) left_out_rows: Vec<usize>,
}

impl Split {
    pub(super) fn of(case: &Case, setup: &Setup, channels: &[String]) -> Result<Self, CovalidateError> {
        let rows: Vec<usize> = setup
            .sensors
            .iter()
            .map(|sensor| {
                let row = case.sensors.iter().position(|known| same_place(known, sensor, setup));
                row.ok_or_else(|| CovalidateError::NoPlace { channel: sensor.channel.clone() })
            })
            .collect::<Result<_, _>>()?;
        let is_left_out =
            |sensor: &Sensor| channels.iter().any(|name| *name == sensor.channel || *name == sensor.point);
        let (left_out, kept): (Vec<usize>, Vec<usize>) =
            (0..setup.sensors.len()).partition(|&channel| is_left_out(&setup.sensors[channel]));
        if kept.is_empty() {
            return Err(CovalidateError::NothingKept { setup: setup.name.clone() });
        }
        let row_of = |channels: &[usize]| channels.iter().map(|&channel| rows[channel]).collect();
        Ok(Self { kept_rows: row_of(&kept), left_out_rows: row_of(&left_out), kept, left_out })
    }
}

impl Split {
    pub(super) fn retain_kept(&mut self, stays: impl Fn(usize) -> bool) {
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

/// The first setup (the one of this name, where one is wanted) that has the channels.
pub(super) fn find_setup<'a>(
    case: &'a Case,
    channels: &[String],
    wanted: Option<&str>,
) -> Result<&'a Setup, CovalidateError> {
    let setups = &case.study.setups;
    if setups.is_empty() {
        return Err(CovalidateError::NoRecording);
    }
    if let Some(name) = wanted
        && setups.iter().all(|setup| setup.name != name)
    {
        let known: Vec<&str> = setups.iter().map(|setup| setup.name.as_str()).collect();
        return Err(CovalidateError::UnknownSetup { name: name.to_owned(), known: known.join(", ") });
    }
    let has = |setup: &Setup, name: &String| {
        setup.sensors.iter().any(|sensor| sensor.channel == *name || sensor.point == *name)
    };
    let candidates: Vec<&Setup> = setups.iter().filter(|setup| wanted.is_none_or(|name| setup.name == name)).collect();
    if let Some(setup) = candidates.iter().find(|setup| channels.iter().all(|name| has(setup, name))) {
        return Ok(setup);
    }
    let unknown = channels.iter().find(|name| candidates.iter().all(|setup| !has(setup, name)));
    Err(match unknown {
        Some(name) => {
            let sensors = candidates.iter().flat_map(|setup| &setup.sensors);
            let known: Vec<&str> = sensors.map(|sensor| sensor.channel.as_str()).collect();
            CovalidateError::UnknownChannel { name: name.clone(), known: known.join(", ") }
        }
        None => CovalidateError::SeveralSetups { channels: channels.join(", ") },
    })
}

/// A prediction that multiplies noise by more says little.
pub const MOST_NOISE_GAIN: f64 = 4.0;

/// Channels that are left out where nobody says which.
const CHOSEN: usize = 2;

/// The two channels that the others predict best, or the one where two are too many: each is left out in turn, and noise in the
/// prediction is held against the channel's own motion in these shapes (sensors x modes, at all sensors of the case).
pub(super) fn best_seen(case: &Case, setup: &Setup, shapes: &DMatrix<f64>) -> Result<Vec<String>, StoryError> {
    let noise_of = |channels: &[String]| -> Option<f64> {
        let split = Split::of(case, setup, channels).ok()?;
        let left_out = shapes.select_rows(&split.left_out_rows);
        let predictor = Predictor::new(&shapes.select_rows(&split.kept_rows), &left_out).ok()?;
        let rows = predictor.weights.row_iter().zip(left_out.row_iter());
        rows.map(|(weights, motion)| weights.norm() / motion.norm()).max_by(f64::total_cmp)
    };
    let mut chosen: Vec<String> = Vec::new();
    while chosen.len() < CHOSEN {
        let others = setup.sensors.iter().map(|sensor| &sensor.channel).filter(|channel| !chosen.contains(channel));
        let with = |channel: &String| chosen.iter().chain([channel]).cloned().collect::<Vec<_>>();
        let candidates = others.filter_map(|channel| Some((noise_of(&with(channel))?, channel)));
        let Some((_, best)) = candidates.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        chosen.push(best.clone());
    }
    if chosen.is_empty() {
        let (setup, channels, modes) = (setup.name.clone(), setup.sensors.len(), shapes.ncols());
        return Err(CovalidateError::TooFewChannels { setup, channels, modes }.into());
    }
    Ok(chosen)
}
