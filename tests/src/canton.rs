//! The paper's study: the published matrices of the Canton Tower against the stand-in tower, through all commands.

use std::fs;
use std::path::Path;
use std::process::Command;

use belfry_host::command::paper;
use belfry_host::story::{CovalidationReport, UpdateReport};
use belfry_host::study::template;

/// What became of the study.
#[derive(Debug)]
pub struct CantonRun {
    /// The update.
    pub update: UpdateReport,
    /// The co-validation of sensors 09 and 12.
    pub covalidation: CovalidationReport,
    /// The paper's tables beside ours.
    pub tables: String,
}

/// Makes the study in `folder`, simulates `hours` of the stand-in tower at 50 Hz, identifies through nodes and link, updates,
/// co-validates; `belfry` gives the program to run.
///
/// # Errors
/// When a command fails, or does not print what it should.
pub fn run_canton(
    belfry: impl Fn() -> Command,
    data: &Path,
    folder: &Path,
    hours: f64,
) -> Result<CantonRun, Box<dyn std::error::Error>> {
    fs::create_dir_all(folder)?;
    let matrices = format!(
        "matrices = {{ file = {:?}, stiffness = \"kk_global\", mass = \"mm_global\", nodes = {:?} }}",
        data.join("system_matrices.mat"),
        data.join("nodes.csv")
    );
    let study = template::CANTON_STUDY.replace("beam = \"beam.csv\"", &matrices);
    fs::write(folder.join("study.toml"), study)?;
    fs::write(folder.join("beam_field.csv"), template::CANTON_BEAM_FIELD)?;
    let run = |arguments: &[&str]| -> Result<String, Box<dyn std::error::Error>> {
        let (command, rest) = arguments.split_first().ok_or("no command")?;
        let output = belfry().arg(command).arg(folder).args(rest).arg("--json").output()?;
        if output.status.success() {
            Ok(String::from_utf8(output.stdout)?)
        } else {
            Err(format!("belfry {command}: {}", String::from_utf8_lossy(&output.stderr)).into())
        }
    };
    let beam = folder.join("beam_field.csv");
    let hours = hours.to_string();
    let beam = beam.to_str().ok_or("the folder's name is no text")?;
    run(&["simulate", "--beam", beam, "--effect", "base-rotation=7.21e-15", "--hours", &hours, "--adopt", "--force"])?;
    run(&["identify"])?;
    let update: UpdateReport = serde_json::from_str(&run(&["update"])?)?;
    let covalidation: CovalidationReport = serde_json::from_str(&run(&["covalidate", "--channels", "09,12"])?)?;
    let tables = paper::tables(&update, &covalidation)?;
    Ok(CantonRun { update, covalidation, tables })
}
