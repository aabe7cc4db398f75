//! The paper's study with its own model: the published matrices of the Canton Tower against a day of the stand-in tower,
//! through nodes and link, and the paper's Tables 1 and 2 beside ours.

use std::path::PathBuf;

use belfry_tests::{CantonRun, belfry_command, find_published, run_canton};
use clap::Args;

/// The Canton Tower's published matrices against a simulated day of the stand-in tower, beside the paper's tables
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Where the study is written
    folder: PathBuf,
    /// Length of the recording
    #[arg(default_value_t = 24.0)]
    hours: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let data = find_published("canton").ok_or("../shared/canton is not there; it holds the published matrices")?;
    let CantonRun { tables, .. } = run_canton(belfry_command, &data, &arguments.folder, arguments.hours)?;
    println!("{tables}");
    println!("The study is in {0}; next: belfry compare {0}", arguments.folder.display());
    Ok(())
}
