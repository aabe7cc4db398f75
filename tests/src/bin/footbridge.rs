//! Writes a study of the footbridge of `../shared/pedestrian-bridge`:
//! `cargo run --release -p belfry-tests --bin footbridge -- FOLDER`, then `belfry compare FOLDER` and `belfry update FOLDER`.

use std::path::PathBuf;
use std::process::ExitCode;

use belfry_tests::{footbridge_data, write_footbridge_study};

fn main() -> ExitCode {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("usage: footbridge FOLDER");
        return ExitCode::from(2);
    };
    let Some(data) = footbridge_data() else {
        eprintln!("error: ../shared/pedestrian-bridge is not there; it holds the bridge's matrices and measured modes");
        return ExitCode::FAILURE;
    };
    match write_footbridge_study(&data, &folder) {
        Ok(modes) => {
            println!("study in {} (measured modes in {})", folder.display(), modes.display());
            println!("next: belfry compare {}", folder.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
