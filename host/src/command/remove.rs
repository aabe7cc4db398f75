//! `belfry remove`: takes an effect out of the model and refits the others.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::steps;
use crate::story::Project;

const EXAMPLES: &str = "Examples:
  belfry remove canton base-rotation
  belfry remove canton added-mass@443.6m

The other effects are fitted anew and written into study.toml. The step goes into the history.";

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
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    console.warn_all(&project.case()?.warnings);
    let report = console.with_progress(|on_progress| project.remove(&arguments.effect, on_progress))?;
    console.warn_all(&report.warnings);
    steps::tell(&report, project.study(), console);
    console.json("remove-1", &report)
}
