//! `belfry add`: puts an effect into the model and refits all of them together.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;

use super::Console;
use super::case::Case;
use super::steps::{ChangeReport, adopt, starting_record};
use crate::model::effect::{self, Effect, EffectKind, Evidence, PlaceKind, Where};
use crate::study::Sensor;

const EXAMPLES: &str = "Examples:
  belfry add canton base-rotation              the value is fitted
  belfry add canton added-mass@443.6m          at this height
  belfry add canton added-mass                 where it explains most
  belfry add canton sensor-polarity@07
  belfry add canton harmonic@0.83hz            the line there is no mode
  belfry add canton stiffness-loss@150m=relative=0.3,length=20    from these values

The values of all effects in the model are fitted together, with the model's own tolerance taken into account, and
written into study.toml (comments and order stay); the step goes into the history. Nothing is changed on disk when the
effect cannot be: a place off the structure, a twin of an effect that is there, a sign that no structure has.";

/// Put an effect into the model and refit all effects together
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// The effect; see `belfry effects`
    #[arg(value_name = "KIND[@WHERE][=VALUE]")]
    pub effect: String,
}

/// Runs the command.
///
/// # Errors
/// When the effect cannot be added; nothing is changed then.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let case = Case::load(&arguments.study, console)?;
    let report = add(&case, &arguments.effect, console)?;
    console.json(&report)
}

/// Adds an effect as typed.
pub(super) fn add(case: &Case, word: &str, console: &Console) -> anyhow::Result<ChangeReport> {
    let (head, value) = word.split_once('=').map_or((word, None), |(head, value)| (head, Some(value)));
    let (kind, place) = named(head, &case.sensors)?;
    let is_there = |known: &Effect| known.of_kind() == kind && known.place() == place.as_ref();
    if (place.is_some() || kind.place() == PlaceKind::Nowhere) && case.model.effects.iter().any(is_there) {
        bail!("{head} is in the model already; `belfry remove {} {head}` takes it out", case.study.folder.display());
    }
    let setting = case.setting()?;
    let start = starting_record(case)?;
    let action = format!("add {head}");
    let with = |effect: Effect| -> anyhow::Result<Vec<Effect>> {
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
    adopt(case, start, &step, console)
}

/// `KIND[@WHERE]` with the study's names, where a located kind may leave its place open.
fn named(head: &str, sensors: &[Sensor]) -> anyhow::Result<(&'static dyn EffectKind, Option<Where>)> {
    if !head.contains('@') {
        let kind = effect::find(head.trim())?;
        if matches!(kind.evidence(), Evidence::Modes | Evidence::Phases | Evidence::TwinPeaks)
            && kind.place() != PlaceKind::Name
        {
            return Ok((kind, None));
        }
    }
    Ok(effect::named_in_study(head, sensors)?)
}

/// Whether the effect has a place there, at a value that does nothing.
fn check_place(case: &Case, kind: &'static dyn EffectKind, place: &Where) -> anyhow::Result<()> {
    let parameters = kind.parameter_sets().first().copied().unwrap_or(&[]);
    let neutral: Vec<f64> =
        parameters.iter().map(|parameter| parameter.neutral.clamp(parameter.least, parameter.greatest)).collect();
    let effect = Effect::with_parameters(kind, Some(place.clone()), parameters, &neutral)?;
    effect.contribution(&case.model.structure()?)?;
    Ok(())
}

/// An effect whose value identification has measured.
fn signalled(case: &Case, kind: &'static dyn EffectKind, place: Option<&Where>) -> anyhow::Result<Effect> {
    if kind.evidence() == Evidence::Kurtosis {
        return Ok(Effect::with_parameters(kind, place.cloned(), &[], &[])?);
    }
    let shown = crate::diagnose::shown_effects(&case.signals()?, &case.model.effects);
    let study = case.study.folder.display();
    shown.into_iter().find(|effect| effect.of_kind() == kind).with_context(|| match kind.evidence() {
        Evidence::TemperatureTrend | Evidence::LevelTrend => format!(
            "{} shows over the hours, and the study has no trends; run `belfry identify {study} --every 1h` first, or give its value",
            kind.name()
        ),
        _ => format!("{} needs its values: see `belfry effects {}`", kind.name(), kind.name()),
    })
}
