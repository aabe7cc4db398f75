//! What windows take in the archive, and how long a range of them takes to read.

use std::path::PathBuf;

use belfry_tests::archive::BYTES_A_DAY;
use clap::Args;

/// An archive of many days of a simulated tower: bytes a day, and the time to average a range of it
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Days in the archive; one is simulated, and comes again and again
    #[arg(long, default_value_t = 30)]
    days: u64,
    /// Draws loads, noise and boots
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where to leave the study with its archive [default: nowhere]
    #[arg(long, value_name = "FOLDER")]
    keep: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let elsewhere = tempfile::tempdir()?;
    let folder = arguments.keep.as_deref().unwrap_or(elsewhere.path());
    std::fs::create_dir_all(folder)?;
    let report = belfry_tests::archive::run(arguments.days, arguments.seed, folder)?;
    println!("{report}");
    if report.bytes_a_day() <= BYTES_A_DAY {
        return Ok(());
    }
    Err(format!("a day is to take {BYTES_A_DAY} bytes at most").into())
}
