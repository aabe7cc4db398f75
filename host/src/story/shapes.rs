//! Whose mode shapes predict: the model's as first given, after the last update, with the study's effects, the measured ones.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::case::Case;
use super::error::{CovalidateError, StoryError};
use super::updated::UpdateReport;
use crate::compare::{ModelView, Pair, pair};
use crate::results::{Results, UPDATE_FILE};

/// Whose shapes predict.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    Model,
    Updated,
    WithEffects,
    MeasuredShapes,
}

/// A figure for each of those whose shapes predict; null where there is no such model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
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

impl Source {
    pub(super) fn slot(self, figures: &mut BySource) -> &mut Option<f64> {
        match self {
            Self::Model => &mut figures.model,
            Self::Updated => &mut figures.updated,
            Self::WithEffects => &mut figures.with_effects,
            Self::MeasuredShapes => &mut figures.measured_shapes,
        }
    }

    pub(super) fn of(self, mut figures: BySource) -> Option<f64> {
        *self.slot(&mut figures)
    }

    pub(super) fn label(self) -> &'static str {
        match self {
            Self::Model => "model",
            Self::Updated => "updated",
            Self::WithEffects => "with_effects",
            Self::MeasuredShapes => "measured_shapes",
        }
    }
}

/// Shapes of the same modes from every source.
pub(super) struct Shapes {
    /// Numbers of the measured modes that have a partner in the model, with and without effects.
    pub(super) modes: Vec<usize>,
    /// Shapes at all of the study's sensors, sensors x modes; the model as first given first.
    pub(super) sources: Vec<(Source, DMatrix<f64>)>,
    /// What the reader should know.
    pub(super) warnings: Vec<String>,
}

impl Shapes {
    /// The shapes that a case has. E_d of two sources is only to be set side by side where both have the same modes, so a
    /// mode without a partner in one of them is left out of all.
    pub(super) fn of(case: &Case) -> Result<Self, StoryError> {
        let given = case.view_as_given()?;
        let modes = &case.measured.modes;
        let with_effects = (!case.model.effects.is_empty()).then(|| case.pairs());
        let in_both = |one: &Pair| {
            with_effects.as_ref().is_none_or(|pairs| pairs.iter().any(|other| other.measured == one.measured))
        };
        let (pairs, alone): (Vec<Pair>, Vec<Pair>) = pair(&given, modes).into_iter().partition(in_both);
        if pairs.is_empty() {
            return Err(CovalidateError::NoPairs.into());
        }
        let numbers: Vec<usize> = pairs.iter().map(|pair| modes[pair.measured].number).collect();
        let mut warnings = Vec::new();
        let gained: Vec<usize> = with_effects
            .iter()
            .flatten()
            .map(|pair| modes[pair.measured].number)
            .filter(|number| !numbers.contains(number))
            .collect();
        let lost: Vec<usize> = alone.iter().map(|pair| modes[pair.measured].number).collect();
        for (numbers, whose) in [(&gained, "with the effects only"), (&lost, "without the effects only")] {
            if !numbers.is_empty() {
                warnings.push(format!(
                    "mode {}: has a partner in the model {whose}, so it is left out of all predictions",
                    list(numbers)
                ));
            }
        }
        let mut sources = vec![(Source::Model, columns(&given, &pairs))];
        let update: Option<UpdateReport> = Results::of(&case.study).read_json(UPDATE_FILE, "update")?;
        if let Some(update) = &update {
            match updated_shapes(case, &given, &numbers, update) {
                Ok(shapes) => sources.push((Source::Updated, shapes)),
                Err(reason) => warnings.push(format!("after Psi: left out, because {reason}")),
            }
        }
        if let Some(with_effects) = with_effects {
            let common: Vec<Pair> =
                with_effects.into_iter().filter(|pair| numbers.contains(&modes[pair.measured].number)).collect();
            sources.push((Source::WithEffects, columns(&case.view, &common)));
            if update.is_some_and(|update| !update.effects.is_empty()) {
                warnings.push(
                    "the last update started from the model with its effects: hold \"after Psi\" against \"with effects\""
                        .to_owned(),
                );
            }
        }
        match measured_shapes(case, &pairs) {
            Ok(shapes) => sources.push((Source::MeasuredShapes, shapes)),
            Err(reason) => warnings.push(format!("measured shapes: left out, because {reason}")),
        }
        Ok(Self { modes: numbers, sources, warnings })
    }
}

fn list(numbers: &[usize]) -> String {
    numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
}

fn columns(view: &ModelView, pairs: &[Pair]) -> DMatrix<f64> {
    let models: Vec<usize> = pairs.iter().map(|pair| pair.model).collect();
    view.at_sensors.select_columns(&models)
}

/// Phi1 V of the last update, beside those of `numbers` that it did not use; or why there is none.
fn updated_shapes(
    case: &Case,
    given: &ModelView,
    numbers: &[usize],
    update: &UpdateReport,
) -> Result<DMatrix<f64>, String> {
    let beyond: Vec<usize> =
        update.pairs.iter().map(|pair| pair.measured).filter(|used| !numbers.contains(used)).collect();
    if !beyond.is_empty() {
        return Err(format!(
            "the last update also used mode {}; run `belfry update` with the same --modes",
            list(&beyond)
        ));
    }
    let (used, turned) = turned_by_update(case, given, update)?;
    let view = if update.effects.is_empty() { given } else { &case.view };
    let pairs = numbered_pairs(case, view);
    let others: Vec<usize> = pairs
        .iter()
        .filter(|(number, model)| numbers.contains(number) && !used.contains(model))
        .map(|&(_, model)| model)
        .collect();
    let mut shapes = turned.insert_columns(used.len(), others.len(), 0.0);
    for (index, &model) in others.iter().enumerate() {
        shapes.set_column(used.len() + index, &view.at_sensors.column(model));
    }
    Ok(shapes)
}

/// Partners by a measured mode's number and the index of the model's mode.
fn numbered_pairs(case: &Case, view: &ModelView) -> Vec<(usize, usize)> {
    let modes = &case.measured.modes;
    pair(view, modes).iter().map(|pair| (modes[pair.measured].number, pair.model)).collect()
}

/// The modes that the last update used (indices of the model's modes) and their shapes after it, at all sensors; or why it is no update of
/// the study's model. `given` is the model as first given.
pub(crate) fn turned_by_update(
    case: &Case,
    given: &ModelView,
    update: &UpdateReport,
) -> Result<(Vec<usize>, DMatrix<f64>), String> {
    let view = if update.effects.is_empty() { given } else { &case.view };
    let pairs = numbered_pairs(case, view);
    let size = update.pairs.len();
    let fits = (update.effects.is_empty() || update.effects == case.effect_names())
        && update.rotation.len() == size
        && update.rotation.iter().all(|row| row.len() == size)
        && update.pairs.iter().all(|pair| {
            let same_partner = pairs.iter().any(|&(number, model)| number == pair.measured && model + 1 == pair.model);
            let there = pair.model.checked_sub(1).and_then(|model| view.modes.frequency_hz.get(model));
            same_partner && there.is_some_and(|hz| (hz / pair.before.model_hz - 1.0).abs() < SAME_MODEL)
        });
    if !fits {
        return Err("the last update is of another model than the study's; run `belfry update` again".to_owned());
    }
    let used: Vec<usize> = update.pairs.iter().map(|pair| pair.model - 1).collect();
    let rotation = DMatrix::from_fn(size, size, |row, column| update.rotation[row][column]);
    let turned = view.at_sensors.select_columns(&used) * rotation;
    Ok((used, turned))
}

/// Frequencies of one model, solved twice, differ by less than this share.
const SAME_MODEL: f64 = 1e-9;

/// The measured shapes of the pairs, where every one is known at every sensor.
fn measured_shapes(case: &Case, pairs: &[Pair]) -> Result<DMatrix<f64>, String> {
    let column = |pair: &Pair| {
        let mode = &case.measured.modes[pair.measured];
        let shape = mode.shape.as_ref().filter(|shape| shape.sensors.len() == case.sensors.len());
        shape
            .map(|shape| shape.values.clone())
            .ok_or_else(|| format!("the shape of mode {} is not known at every sensor", mode.number))
    };
    let columns: Vec<_> = pairs.iter().map(column).collect::<Result<_, _>>()?;
    Ok(DMatrix::from_columns(&columns))
}
