//! The paper's study with its own model: the published matrices of the Canton Tower against a day of the stand-in tower,
//! through nodes and link, and the paper's Tables 1 and 2 beside ours:
//! `cargo run --release -p belfry-tests --bin canton -- FOLDER [HOURS]`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use belfry_tests::{CantonRun, canton_data, run_canton};

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1);
    let Some(folder) = arguments.next().map(PathBuf::from) else {
        eprintln!("usage: canton FOLDER [HOURS]");
        return ExitCode::from(2);
    };
    let hours = arguments.next().and_then(|word| word.to_str()?.parse::<f64>().ok()).unwrap_or(24.0);
    match run(&folder, hours) {
        Ok(CantonRun { tables, .. }) => {
            println!("{tables}");
            println!("The study is in {0}; next: belfry compare {0}", folder.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(folder: &Path, hours: f64) -> Result<CantonRun, Box<dyn std::error::Error>> {
    let data = canton_data().ok_or("../shared/canton is not there; it holds the published matrices")?;
    // The program that was built beside this one.
    let belfry = std::env::current_exe()?.with_file_name(format!("belfry{}", std::env::consts::EXE_SUFFIX));
    if !belfry.is_file() {
        return Err("belfry is not built; run `cargo build --release` first".into());
    }
    run_canton(|| std::process::Command::new(&belfry), &data, folder, hours)
}
