//! A study of the footbridge, for `belfry compare FOLDER` and `belfry update FOLDER`.

use std::path::PathBuf;

use belfry_tests::{find_published, write_footbridge_study};
use clap::Args;

/// Write a study of the footbridge of `../shared/pedestrian-bridge`: 946 degrees of freedom, five measured modes
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Where the study is written
    folder: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let data = find_published("pedestrian-bridge")
        .ok_or("../shared/pedestrian-bridge is not there; it holds the bridge's matrices and measured modes")?;
    let modes = write_footbridge_study(&data, &arguments.folder)?;
    println!("study in {} (measured modes in {})", arguments.folder.display(), modes.display());
    println!("next: belfry compare {}", arguments.folder.display());
    Ok(())
}
