//! How right and how honest modes are on recordings that Belfry's own simulation could not make.

use std::path::PathBuf;

use belfry_tests::records::{self, CASES, CaseScore, case};
use clap::Args;

use crate::cases::cases_in_words;

/// Recordings with correlated loads, close pairs, any damping and faults: errors and honesty mode by mode
///
/// z is (estimate - truth) / stated deviation. "Whole modes" holds a mode's frequency and shape against their joint covariance; its p takes
/// that covariance as exact, which is estimated from 24 groups of windows at most: read the share below 0.05 beside that of other programs
/// and cases, not as a test. The modes of a refused record count as missed.
#[derive(Debug, Args)]
#[command(after_help = cases_in_words(CASES.map(|case| (case.name, case.what))))]
pub(super) struct Arguments {
    /// How many seeds
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// The first seed [default: drawn from the clock]
    #[arg(long, value_name = "SEED")]
    first: Option<u64>,
    /// A case; repeat for more [default: all]
    #[arg(long = "case", value_name = "NAME", value_parser = CASES.map(|case| case.name))]
    cases: Vec<String>,
    /// The method of `belfry identify` to judge; with `both` its modes, and how often the second opinion agrees
    #[arg(long, default_value = "both", value_parser = ["both", "spectra", "subspace"])]
    method: String,
    /// Keep each record's study in a folder of this one, with the pictures and the JSON of its modes
    #[arg(long, value_name = "FOLDER")]
    keep: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let first = match arguments.first {
        Some(first) => first,
        None => std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH)?.as_secs(),
    };
    let all: Vec<&str> = CASES.iter().map(|case| case.name).collect();
    let wanted: Vec<&str> =
        if arguments.cases.is_empty() { all } else { arguments.cases.iter().map(String::as_str).collect() };
    for case in wanted.into_iter().filter_map(case) {
        let mut score = CaseScore::default();
        for seed in first..first + arguments.seeds {
            let scratch = tempfile::tempdir()?;
            let kept = arguments.keep.as_ref().map(|keep| keep.join(format!("{}-{seed}", case.name)));
            records::run(case, seed, &arguments.method, kept.as_deref().unwrap_or(scratch.path()), &mut score)?;
        }
        println!("{}: {} (seeds {first} to {})", case.name, case.what, first + arguments.seeds - 1);
        println!("{}", score.table());
    }
    Ok(())
}
