//! Two measurements of one structure: a study, its modes before and now flow in; what has changed flows out, with a model also where.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::case::{Case, measured_modes};
use super::climate::{Climate, at_one_temperature};
use super::error::StoryError;
use crate::change::{Changes, changes};
use crate::diagnose::{ChangeDiagnosis, Options, diagnose_change};
use crate::model::effect::{self, Where};
use crate::modes::{MeasuredModes, read};
use crate::progress::UNHEARD;
use crate::study::{Sensor, Study};

/// Which measurements are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct SinceRequest {
    /// A file of modes or the folder of a study: the measurement before.
    pub before: PathBuf,
    /// The same of the measurement now; the study's own modes where none is given.
    pub now: Option<PathBuf>,
    /// Kinds of effects that are not considered.
    pub without: Vec<String>,
}

/// What has changed: what `belfry change --json` prints and `results/change.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SinceReport {
    /// The file of the modes before.
    pub before: PathBuf,
    /// The file of those of now.
    pub now: PathBuf,
    /// Mode by mode, without a model.
    #[serde(flatten)]
    pub changes: Changes,
    /// Temperatures of both measurements, where both state them.
    pub climate: Option<Climate>,
    /// What has changed by the model; null for a study without one.
    pub diagnosis: Option<ChangeDiagnosis>,
    /// Base and top of the model in m.
    #[serde(skip)]
    pub z_range_m: Option<[f64; 2]>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// Compares two measurements of a study's structure.
///
/// # Errors
/// When modes or the model cannot be read, sensors of the two differ, or they have no mode in common.
pub(super) fn since(study: &Study, request: &SinceRequest) -> Result<SinceReport, StoryError> {
    let sensors = study.sensors();
    let mut before = modes_of(&request.before, study, &sensors)?;
    let mut now = match &request.now {
        Some(now) => modes_of(now, study, &sensors)?,
        None => measured_modes(study, &sensors)?,
    };
    let mut warnings = [before.warnings.clone(), now.warnings.clone()].concat();
    let climate = at_one_temperature(&mut before, &mut now);
    warnings.extend(assumed(&before).into_iter().chain(assumed(&now)));
    let changes = changes(&before.modes, &now.modes);
    let Some(test) = &changes.test else {
        return Err(StoryError::NoCommonModes { before: before.file, now: now.file });
    };
    if !test.may_be_wrong.is_empty() {
        let numbers: Vec<String> = test.may_be_wrong.iter().map(usize::to_string).collect();
        warnings.push(format!(
            "all that differs is in mode {}: so many are identified wrongly, and nothing counts as changed for that; is each a single mode, and well identified in both measurements?",
            numbers.join(", ")
        ));
    }
    let p_value = test.p_value;
    let (before_file, now_file) = (before.file.clone(), now.file.clone());
    let (mut diagnosis, mut z_range_m) = (None, None);
    if study.model.is_some() {
        let case = Case::of(study.clone(), before)?;
        let more = case.warnings.iter().filter(|warning| !warnings.contains(warning)).cloned();
        warnings.extend(more.collect::<Vec<_>>());
        let options = Options { without: request.without.clone() };
        z_range_m = case.model.bare().z_range_m();
        match diagnose_change(&case.setting(&UNHEARD)?, &case.model.effects, &now.modes, p_value, &options) {
            Ok(mut found) => {
                warnings.append(&mut found.warnings);
                diagnosis = Some(found);
            }
            Err(error) => warnings.push(format!("the model cannot say what has changed: {error}")),
        }
    }
    Ok(SinceReport { before: before_file, now: now_file, changes, climate, diagnosis, z_range_m, warnings })
}

impl SinceReport {
    /// The height of the effect that has come or gone, with its deviation in m, where one at a height is named.
    pub fn height_m(&self) -> Option<(f64, Option<f64>)> {
        let diagnosis = self.diagnosis.as_ref()?;
        let best = diagnosis.best.first()?;
        let candidate = diagnosis.candidates.iter().find(|candidate| candidate.name() == *best)?;
        match effect::named(best).ok()?.1? {
            Where::Height(z_m) => Some((z_m, candidate.where_std_m)),
            _ => None,
        }
    }
}

/// Modes from a file, or from a study whose sensors are those of this one.
fn modes_of(path: &Path, study: &Study, sensors: &[Sensor]) -> Result<MeasuredModes, StoryError> {
    let is_study = path.is_dir() || path.extension().is_some_and(|extension| extension == "toml");
    if !is_study {
        return Ok(read(path, sensors)?);
    }
    let other = Study::load(path)?;
    for sensor in other.sensors() {
        check_sensor(&sensor, &other, study, sensors)?;
    }
    measured_modes(&other, sensors)
}

/// Heights and plan positions that differ by less than this are one.
const SAME_M: f64 = 0.01;

/// Whether a sensor of another study is where this study has it.
fn check_sensor(sensor: &Sensor, other: &Study, study: &Study, sensors: &[Sensor]) -> Result<(), StoryError> {
    let differs = |reason: String| StoryError::OtherSensors {
        channel: sensor.channel.clone(),
        other: other.folder.clone(),
        study: study.folder.clone(),
        reason,
    };
    // Files of modes name the point besides, which is the same whatever the setups are called.
    let by_channel = sensors.iter().find(|own| own.channel == sensor.channel);
    let own = by_channel.or_else(|| sensors.iter().find(|own| own.point == sensor.point));
    let Some(own) = own else { return Err(differs("the latter has no such channel".to_owned())) };
    let height = |sensor: &Sensor| sensor.elevation_m.map_or_else(|| "no height".to_owned(), |z_m| format!("{z_m} m"));
    let apart = |a: Option<f64>, b: Option<f64>| match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() > SAME_M,
        (a, b) => a.is_some() != b.is_some(),
    };
    if apart(own.elevation_m, sensor.elevation_m) {
        return Err(differs(format!("{} there, {} here", height(sensor), height(own))));
    }
    if own.direction != sensor.direction {
        return Err(differs("its direction is another".to_owned()));
    }
    let moved = own.offset_m.iter().zip(sensor.offset_m).any(|(a, b)| (a - b).abs() > SAME_M);
    if moved {
        return Err(differs("its plan position is another".to_owned()));
    }
    if own.dof != sensor.dof {
        return Err(differs("it stands at another degree of freedom".to_owned()));
    }
    Ok(())
}

/// A warning where a file states no deviations.
fn assumed(modes: &MeasuredModes) -> Option<String> {
    let is_assumed = modes
        .modes
        .iter()
        .any(|mode| mode.frequency_std_hz.is_none() || mode.shape.as_ref().is_some_and(|shape| shape.stds.is_none()));
    is_assumed.then(|| {
        format!(
            "{} does not state all deviations; 0.5 % of frequencies and 2 % of shapes are assumed, and whether anything has changed rests on that",
            modes.file.display()
        )
    })
}
