//! The plan of a measurement: a study's model and sensors flow in, with what is asked; what records will show flows out.

use std::path::PathBuf;

use super::case::model_warnings;
use super::change::named;
use super::error::StoryError;
use crate::model::effect::Effect;
use crate::model::{Assembly, load_up_to, section};
use crate::plan::{Conditions, Plan, Request, Site, plan, read_places};
use crate::progress::{OnProgress, Progress};
use crate::study::{Sensor, Study};

/// What a measurement is planned for.
#[derive(Debug, Clone)]
pub struct PlanRequest {
    /// The effect that the model may lack.
    pub effect: Effect,
    /// What it is to be told from (`KIND[@WHERE]`); all kinds where none is named.
    pub against: Vec<String>,
    /// Kinds that are not considered.
    pub without: Vec<String>,
    /// Lengths of records.
    pub hours: Vec<f64>,
    /// A table of places where a sensor could stand besides.
    pub places: Option<PathBuf>,
    /// How many of them are added.
    pub add: usize,
    /// Damping ratio of every mode.
    pub damping_ratio: f64,
    /// Noise of each sensor in percent of its RMS response within the band.
    pub noise_percent: f64,
    /// Of what is drawn.
    pub seed: u64,
}

/// Plans a measurement of a study that may have no recording yet.
///
/// # Errors
/// When the study has no model, a name is unknown, the table of places cannot be read, or the effect cannot be planned for.
pub fn planned(study: &Study, request: &PlanRequest, on_progress: OnProgress<'_>) -> Result<Plan, StoryError> {
    // A large model is reduced to what moves within the band, as it will be for the modes of the measurement.
    let model = load_up_to(study, study.analysis.band_hz.map(|band_hz| band_hz[1]))?;
    let sensors = study.sensors();
    let places = request.places.as_deref().map(|file| read_places(file, &sensors)).transpose();
    let places: Vec<Sensor> = places.map_err(crate::plan::PlanError::from)?.unwrap_or_default();
    let effect = request.effect.in_study(&sensors)?;
    let assembly = model.structure()?.assemble();
    let band_hz = match study.analysis.band_hz {
        Some(band_hz) => band_hz,
        None => lowest_modes(&assembly)?,
    };
    let against = request.against.iter().map(|name| named(name, &sensors)).collect::<Result<Vec<_>, _>>()?;
    let bare = model.bare();
    let site = Site { bare: &bare, model: section(study)?, effects: &model.effects, sensors: &sensors };
    let request = Request {
        effect,
        against,
        without: request.without.clone(),
        hours: request.hours.clone(),
        places,
        add: request.add,
        conditions: Conditions { damping_ratio: request.damping_ratio, noise_percent: request.noise_percent, band_hz },
        seed: request.seed,
    };
    let on_option = &mut |done, total| on_progress(Progress { stage: "sets of sensors", done, total });
    let mut plan = plan(&site, &request, on_option)?;
    plan.warnings = model_warnings(study, &model, &assembly, &sensors);
    Ok(plan)
}

/// Modes that are expected where the study names no band.
const LOWEST: usize = 12;
/// How far the band goes beyond them.
const BEYOND: f64 = 0.1;

fn lowest_modes(assembly: &Assembly) -> Result<[f64; 2], StoryError> {
    let modes = assembly.modes().map_err(crate::compare::ViewError::from)?;
    let hz = &modes.frequency_hz;
    let highest_hz = hz.get(LOWEST - 1).or(hz.last()).copied().unwrap_or(1.0);
    Ok([hz.first().copied().unwrap_or(highest_hz) * (1.0 - BEYOND), highest_hz * (1.0 + BEYOND)])
}
