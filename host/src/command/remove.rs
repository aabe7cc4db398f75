//! `belfry remove`: takes an effect out of the model and refits the others.

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;

use super::Console;
use super::case::Case;
use super::steps::{adopt, starting_record};
use crate::model::effect::{Effect, named_in_study};

const EXAMPLES: &str = "Examples:
  belfry remove canton base-rotation
  belfry remove canton added-mass@443.6m

The others are fitted anew and written into study.toml; the step goes into the history.";

/// Take an effect out of the model and refit the others
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// The effect
    #[arg(value_name = "KIND[@WHERE]")]
    pub effect: String,
}

/// Runs the command.
///
/// # Errors
/// When the model has no such effect, or the others cannot be refitted; nothing is changed then.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let case = Case::load(&arguments.study, console)?;
    let effects = &case.model.effects;
    let is_named = |effect: &Effect| match named_in_study(&arguments.effect, &case.sensors) {
        Ok((kind, Some(place))) => effect.of_kind() == kind && effect.place() == Some(&place),
        _ => effect.kind() == arguments.effect,
    };
    let named: Vec<usize> = (0..effects.len()).filter(|&index| is_named(&effects[index])).collect();
    let names = case.effect_names();
    let index = match named[..] {
        [index] => index,
        // One like the other: either will do.
        [.., last] if named.iter().all(|&index| effects[index].to_string() == effects[last].to_string()) => last,
        [] if names.is_empty() => bail!("the model has no effects to remove, nor any {}", arguments.effect),
        [] => bail!("the model has no effect {}; it has {}", arguments.effect, names.join(", ")),
        _ => bail!("the model has several: name one of {}", names.join(", ")),
    };
    // Effects that cannot be fitted together have no errors to start from; taking one out is what mends that.
    let start = match starting_record(&case) {
        Ok(start) => start,
        Err(error) => {
            console.warn(format!("the model as it is: {error:#}"));
            None
        }
    };
    let left: Vec<Effect> =
        effects.iter().enumerate().filter(|(at, _)| *at != index).map(|(_, effect)| effect.clone()).collect();
    let step = case.setting()?.refit_beside(&format!("drop {}", effects[index]), &left, effects)?;
    let report = adopt(&case, start, &step, console)?;
    console.json(&report)
}
