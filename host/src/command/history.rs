//! `belfry history`: how the error fell, step by step.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::Console;
use super::interrupt::leave_nothing_unfinished;
use super::text::{Columns, mac_text, or_dash, p_text};
use crate::diagnose::steps::StepRecord;
use crate::story::Project;

const EXAMPLES: &str = "Examples:
  belfry history canton            after `belfry add` or `belfry remove`
  belfry history canton --json

Errors are those of the model with its effects, without the scatter of segments that the fit allows itself. Each sensor and each mode is left out in turn and predicted by a model that was fitted without it. An effect that is true lowers both errors; one that only fits lowers the first.

Writes history.svg into `results`.";

/// Show how the error fell, step by step
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    steps: Vec<StepRecord>,
}

/// Runs the command.
///
/// # Errors
/// When the study or its history cannot be read, or it has none.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let project = Project::open(&arguments.study)?;
    let steps = show_history(&project, console)?;
    console.json("history-1", &Report { steps })
}

/// Tells the steps.
pub(super) fn show_history(project: &Project, console: &Console) -> anyhow::Result<Vec<StepRecord>> {
    project.results().history_damage()?.into_iter().for_each(|damage| console.warn(damage));
    let steps = project.history()?;
    tell_history(&steps, console);
    console.detail(format!("Picture: {}", project.results().path("history.svg").display()));
    Ok(steps)
}

/// The steps as a table.
fn tell_history(steps: &[StepRecord], console: &Console) {
    let mut table = Columns::new([
        "step",
        "what",
        "chi-squared",
        "p",
        "frequency error %",
        "MAC",
        "left-out sensors %",
        "left-out modes %",
    ])
    .expendable(&[5, 2]);
    for step in steps {
        table.row([
            step.step.to_string(),
            step.action.clone(),
            format!("{:.0} / {}", step.chi_squared, step.degrees_of_freedom),
            p_text(step.p_value),
            format!("{:.2}", step.mean_abs_frequency_error_percent),
            mac_text(step.mean_mac, 4),
            or_dash(step.held_out_error_percent, 2),
            or_dash(step.held_out_mode_error_percent, 2),
        ]);
    }
    console.say(table);
    let joint = steps.last().and_then(|step| step.joint.as_ref());
    joint.iter().flat_map(|joint| joint.in_words()).for_each(|sentence| console.say(sentence + "."));
}
