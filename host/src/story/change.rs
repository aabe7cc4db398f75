//! Effects put into a study's model and taken out of it: refitted together, written into `study.toml`, noted in the history.

use belfry_shared::frame::crc32;
use serde::Serialize;

use super::case::Case;
use super::error::StoryError;
use crate::compare::Comparison;
use crate::diagnose::steps::{FittedEffect, Step, StepRecord};
use crate::diagnose::{Estimate, Options, shown_effects};
use crate::model::effect::{self, Effect, EffectError, EffectKind, Evidence, PlaceKind, Where};
use crate::modes::are_known;
use crate::progress::Tally;
use crate::results::Results;
use crate::study::Sensor;
use crate::study::edit::{EffectEntry, set_effects};

/// What `belfry add --json` and `belfry remove --json` print.
#[derive(Debug, Clone, Serialize)]
pub struct ChangeReport {
    /// What was done.
    pub action: String,
    /// The effects of the model now.
    pub effects: Vec<EffectReport>,
    /// The model before, its modes compared.
    pub before: Comparison,
    /// The model now.
    pub after: Comparison,
    /// The step of the history.
    pub step: StepRecord,
    /// The step before.
    pub previous: Option<StepRecord>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// An effect in the model.
#[derive(Debug, Clone, Serialize)]
pub struct EffectReport {
    /// The kind.
    pub effect: String,
    /// The part after the @.
    pub r#where: Option<String>,
    /// Its values.
    pub parameters: Vec<Estimate>,
}

/// How adding and dropping effects until nothing is gained ended.
#[derive(Debug, Clone, PartialEq)]
pub enum AutoEnd {
    /// No effect is called for; the model stays as it is.
    NothingGained,
    /// Only frequencies were measured, and which mode is which is not known; nothing was written.
    FrequenciesAlone,
    /// The effects together do not explain the measurement; nothing was written.
    Unexplained {
        /// Probability of as much misfit as they leave.
        p_value: f64,
    },
    /// The effects stand in `study.toml`.
    Adopted,
}

/// Adds an effect as typed: `KIND[@WHERE][=VALUE]`.
///
/// # Errors
/// When the effect cannot be added; nothing is changed then.
pub fn add(case: &Case, word: &str, tally: &Tally) -> Result<ChangeReport, StoryError> {
    let (head, value) = word.split_once('=').map_or((word, None), |(head, value)| (head, Some(value)));
    let (kind, place) = named(head, &case.sensors)?;
    let is_there = |known: &Effect| known.of_kind() == kind && known.place() == place.as_ref();
    if (place.is_some() || kind.place() == PlaceKind::Nowhere) && case.model.effects.iter().any(is_there) {
        return Err(StoryError::EffectIsThere { effect: head.to_owned(), study: case.study.folder.clone() });
    }
    let setting = case.setting(tally)?;
    let start = starting_record(case, tally)?;
    let action = format!("add {head}");
    let with = |effect: Effect| -> Result<Vec<Effect>, StoryError> {
        let effect = effect.in_study(&case.sensors)?;
        case.model.structure()?.and(std::slice::from_ref(&effect))?;
        Ok(case.model.effects.iter().cloned().chain([effect]).collect())
    };
    let step = match (value, kind.evidence()) {
        (Some(_), _) => setting.refit_beside(&action, &with(word.parse()?)?, &case.model.effects)?,
        (None, Evidence::Modes | Evidence::Phases | Evidence::TwinPeaks) => {
            if let Some(place) = &place {
                check_place(case, kind, place)?;
            }
            setting.add(&case.model.effects, kind, place.as_ref())?
        }
        (None, _) => setting.refit(&action, &with(signalled(case, kind, place.as_ref())?)?)?,
    };
    adopt(case, start, &step, Vec::new())
}

/// Takes an effect out of the model and refits the others.
///
/// # Errors
/// When the model has no such effect, or the others cannot be refitted; nothing is changed then.
pub fn remove(case: &Case, name: &str, tally: &Tally) -> Result<ChangeReport, StoryError> {
    let effects = &case.model.effects;
    let is_it = |effect: &Effect| match effect::named_in_study(name, &case.sensors) {
        Ok((kind, Some(place))) => effect.of_kind() == kind && effect.place() == Some(&place),
        _ => effect.kind() == name,
    };
    let candidates: Vec<usize> = (0..effects.len()).filter(|&index| is_it(&effects[index])).collect();
    let index = match candidates[..] {
        [index] => index,
        // One like the other: either will do.
        [.., last] if candidates.iter().all(|&index| effects[index].to_string() == effects[last].to_string()) => last,
        [] if effects.is_empty() => return Err(StoryError::NothingToRemove { effect: name.to_owned() }),
        [] => return Err(StoryError::NoSuchEffect { effect: name.to_owned(), known: case.effect_names().join(", ") }),
        _ => return Err(StoryError::SeveralEffects { known: case.effect_names().join(", ") }),
    };
    let mut warnings = Vec::new();
    // Effects that cannot be fitted together have no errors to start from; taking one out is what mends that.
    let start = starting_record(case, tally).unwrap_or_else(|error| {
        warnings.push(format!("the model as it is: {error}"));
        None
    });
    let left: Vec<Effect> =
        effects.iter().enumerate().filter(|(at, _)| *at != index).map(|(_, effect)| effect.clone()).collect();
    let setting = case.setting(tally)?;
    let step = setting.refit_beside(&format!("remove {}", effects[index]), &left, effects)?;
    adopt(case, start, &step, warnings)
}

/// Adds and drops effects until nothing is gained, and writes them where together they explain the measurement. `on_step` hears
/// of every step; kinds named in `without` are left out.
///
/// # Errors
/// When the effects in the model cannot be fitted, or the study cannot be written.
pub fn add_until_nothing_gains(
    case: &Case,
    without: &[String],
    tally: &Tally,
    on_step: &mut dyn FnMut(&Step),
) -> Result<AutoEnd, StoryError> {
    let mut records: Vec<StepRecord> = starting_record(case, tally)?.into_iter().collect();
    let began = records.len();
    let options = Options { without: without.to_vec() };
    let mut last = None;
    let mut note = |step: &Step| {
        on_step(step);
        records.push(step.record.clone());
        last = Some((entries(&step.effects), step.record.p_value, step.explains));
    };
    let setting = case.setting(tally)?;
    setting.auto(&case.model.effects, &case.signals()?, &options, &mut note)?;
    let results = Results::of(&case.study);
    let Some((entries, p_value, explains)) = last else {
        results.append_history(&records, &data_mark(case)?)?;
        return Ok(AutoEnd::NothingGained);
    };
    if !are_known(&case.measured.modes) {
        return Ok(AutoEnd::FrequenciesAlone);
    }
    if !explains {
        // Effects that together explain too little are made up as likely as not.
        return Ok(AutoEnd::Unexplained { p_value });
    }
    let data = data_mark(case)?;
    // As in `adopt`.
    results.append_history(&records[..began], &data)?;
    set_effects(&case.study.folder, &entries)?;
    results.append_history(&records[began..], &data)?;
    Ok(AutoEnd::Adopted)
}

/// `KIND[@WHERE]` with the study's names, where a located kind may leave its place open.
pub(super) fn named(head: &str, sensors: &[Sensor]) -> Result<(&'static dyn EffectKind, Option<Where>), EffectError> {
    if !head.contains('@') {
        let kind = effect::find(head.trim())?;
        if matches!(kind.evidence(), Evidence::Modes | Evidence::Phases | Evidence::TwinPeaks)
            && kind.place() != PlaceKind::Name
        {
            return Ok((kind, None));
        }
    }
    effect::named_in_study(head, sensors)
}

/// Whether the effect has a place there, at a value that does nothing.
fn check_place(case: &Case, kind: &'static dyn EffectKind, place: &Where) -> Result<(), StoryError> {
    let parameters = kind.parameter_sets().first().copied().unwrap_or(&[]);
    let neutral: Vec<f64> =
        parameters.iter().map(|parameter| parameter.neutral.clamp(parameter.least, parameter.greatest)).collect();
    let effect = Effect::with_parameters(kind, Some(place.clone()), parameters, &neutral)?;
    effect.contribution(&case.model.structure()?)?;
    Ok(())
}

/// An effect whose value identification has measured.
fn signalled(case: &Case, kind: &'static dyn EffectKind, place: Option<&Where>) -> Result<Effect, StoryError> {
    if kind.evidence() == Evidence::Kurtosis {
        return Ok(Effect::with_parameters(kind, place.cloned(), &[], &[])?);
    }
    let shown = shown_effects(&case.signals()?, &case.model.effects);
    shown.into_iter().find(|effect| effect.of_kind() == kind).ok_or_else(|| match kind.evidence() {
        Evidence::TemperatureTrend | Evidence::LevelTrend => {
            StoryError::NeedsTrends { effect: kind.name(), study: case.study.folder.clone() }
        }
        _ => StoryError::NeedsValues { effect: kind.name() },
    })
}

/// Says which measured modes and which model as given a step is of.
pub(crate) fn data_mark(case: &Case) -> Result<String, StoryError> {
    // The modes themselves: how long their identification took stands beside them.
    let modes: Vec<u8> = case.measured.modes.iter().flat_map(|mode| mode.canonical_bytes()).collect();
    Ok(format!("{:08x}{:08x}", crc32(&modes), crc32(&case.model.bytes())))
}

/// The record of the model as it is, where the history does not end with it.
fn starting_record(case: &Case, tally: &Tally) -> Result<Option<StepRecord>, StoryError> {
    let history = Results::of(&case.study).history()?;
    let effects = case.effect_names();
    let data = data_mark(case)?;
    let action = match history.last() {
        None => "start",
        Some(last) if last.data != data => "new measurement or model",
        Some(last) if last.effects == effects && last.modes > 0 => return Ok(None),
        Some(_) => "edited by hand",
    };
    let setting = case.setting(tally)?;
    Ok(Some(setting.refit(action, &case.model.effects)?.record))
}

/// Writes the effects of a step into study.toml and the step into the history.
fn adopt(
    case: &Case,
    start: Option<StepRecord>,
    step: &Step,
    mut warnings: Vec<String>,
) -> Result<ChangeReport, StoryError> {
    let results = Results::of(&case.study);
    warnings.extend(results.history_damage()?);
    let previous = match &start {
        Some(start) => Some(start.clone()),
        None => results.history()?.pop(),
    };
    let effects: Vec<Effect> = step.effects.iter().map(|fitted| fitted.effect.clone()).collect();
    let (before, after) = rayon::join(|| case.compare(), || case.compare_with(&effects));
    let after = after?;
    let data = data_mark(case)?;
    // What the step started from stands there even if the program is killed before the step does.
    results.append_history(start.as_slice(), &data)?;
    set_effects(&case.study.folder, &entries(&step.effects))?;
    let record = results.append_history(std::slice::from_ref(&step.record), &data)?.pop();
    let record = record.unwrap_or_else(|| step.record.clone());
    Ok(ChangeReport {
        action: step.action.clone(),
        effects: step
            .effects
            .iter()
            .map(|fitted| EffectReport {
                effect: fitted.effect.kind().to_owned(),
                r#where: fitted.effect.place().map(ToString::to_string),
                parameters: fitted.parameters.clone(),
            })
            .collect(),
        before,
        after,
        step: record,
        previous,
        warnings,
    })
}

/// Effects as study.toml has them.
fn entries(effects: &[FittedEffect]) -> Vec<EffectEntry> {
    let entry = |fitted: &FittedEffect| EffectEntry {
        kind: fitted.effect.kind().to_owned(),
        location: fitted.effect.place().map(ToString::to_string),
        parameters: fitted
            .parameters
            .iter()
            .map(|parameter| (parameter.name.clone(), parameter.value, parameter.std))
            .collect(),
    };
    effects.iter().map(entry).collect()
}
