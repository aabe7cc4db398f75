//! `belfry history`: how the error fell, step by step.

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;

use super::Console;
use super::case::write_result;
use super::compare::{mac_text, or_dash};
use super::diagnose::p_text;
use super::identify::align_right;
use super::steps::read_history;
use crate::diagnose::steps::StepRecord;
use crate::picture;
use crate::study::Study;

const EXAMPLES: &str = "Examples:
  belfry history canton            after `belfry add`, `belfry remove` or `belfry diagnose --auto`
  belfry history canton --json

Errors are those of the model with its effects, without the scatter of segments that the fit allows itself; left out are
each sensor and each mode in turn, predicted by a model that was fitted without it. An effect that is true lowers both; one
that only fits lowers the first. Writes history.svg into `results`.";

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
    let study = Study::load(&arguments.study)?;
    let steps = show_history(&study, console)?;
    console.json(&Report { steps })
}

/// Tells the steps and draws them.
pub(super) fn show_history(study: &Study, console: &Console) -> anyhow::Result<Vec<StepRecord>> {
    let steps = read_history(study)?;
    if steps.is_empty() {
        bail!(
            "{}: the model has no history yet; `belfry diagnose {0}` names what it lacks, `belfry add {0} EFFECT` makes the first step",
            study.folder.display()
        );
    }
    tell_history(&steps, console);
    let path = write_result(study, "history.svg", picture::history(&study.structure.name, &steps)?.as_bytes())?;
    console.say(format!("Picture: {}", path.display()));
    Ok(steps)
}

/// The steps as a table.
fn tell_history(steps: &[StepRecord], console: &Console) {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(vec![
        "step",
        "what",
        "chi-squared",
        "p",
        "frequency error %",
        "MAC",
        "left-out sensors %",
        "left-out modes %",
    ]);
    for step in steps {
        table.add_row(vec![
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
    align_right(&mut table, 8);
    console.say(table);
}
