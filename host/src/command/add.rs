//! `belfry add`: puts an effect into the model and refits all of them together.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::steps;
use crate::story::Project;

const EXAMPLES: &str = "Examples:
  belfry add canton base-rotation              the value is fitted
  belfry add canton added-mass@443.6m          at this height
  belfry add canton added-mass                 where it explains most
  belfry add canton sensor-polarity@07
  belfry add canton harmonic@0.83hz            the line there is no mode
  belfry add canton stiffness-loss@150m=relative=0.3,length=20

The values of all effects in the model are fitted together, with the model's own tolerance taken into account, and written into study.toml (comments and order stay). A value that is given is where the fit starts. The step goes into the history.

Nothing is changed on disk when the effect cannot be added: its place is off the structure, it is in the model already, the data cannot tell it from another effect in the model, or its value would have a sign that no structure has.";

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
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    console.warn_all(&project.case()?.warnings);
    let report = console.with_progress(|on_progress| project.add(&arguments.effect, on_progress))?;
    steps::tell(&report, project.study(), console);
    console.json("add-1", &report)
}
