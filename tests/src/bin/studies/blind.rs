//! The blind bench of `belfry diagnose`.
//!
//! Each case is a structure of which the study's model lacks something, or nothing; a line says what was hidden and what belfry
//! said, and the score of all of them follows.

use std::path::PathBuf;

use belfry_tests::belfry_command;
use belfry_tests::blind::{Bench, Case, Kinds, Options, line, print_summary};
use clap::{Args, ValueEnum};

/// Structures that lack one effect, two, none, or one outside the catalogue: what does `belfry diagnose` say?
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// How many cases
    #[arg(long, default_value_t = 60)]
    cases: u64,
    /// The first case
    #[arg(long, value_name = "CASE", default_value_t = 0)]
    first: u64,
    /// Draws all cases
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Keep the studies in this folder
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// One structure alone
    #[arg(long, value_name = "NAME", value_parser = ["tower", "chimney", "shear-building"])]
    structure: Option<String>,
    /// One sort of case alone: nothing, single, pairs, outside, or a kind of effect
    #[arg(long, value_name = "KIND", default_value = "mix", value_parser = kinds)]
    only: Kinds,
    /// Length of each recording
    #[arg(long, default_value_t = 12.0, value_parser = hours)]
    hours: f64,
    /// Whether all modes are driven alike
    #[arg(long, value_enum, default_value_t = Loads::Even)]
    loads: Loads,
    /// How far segments scatter, in units of what the study states
    #[arg(long, default_value_t = 1.0, value_parser = scatter)]
    scatter: f64,
    /// The program to judge [default: this workspace's]
    #[arg(long, value_name = "PROGRAM")]
    belfry: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Loads {
    Even,
    Uneven,
}

fn kinds(word: &str) -> Result<Kinds, String> {
    if word == "mix" {
        return Ok(Kinds::Mix);
    }
    Kinds::named(word).ok_or_else(|| format!("there is no kind {word}"))
}

fn hours(text: &str) -> Result<f64, String> {
    let hours = text.parse().ok().filter(|hours| (0.1..=100.0).contains(hours));
    hours.ok_or_else(|| "expected 0.1 to 100 hours".to_owned())
}

fn scatter(text: &str) -> Result<f64, String> {
    let scatter = text.parse().ok().filter(|scatter| (0.0..=5.0).contains(scatter));
    scatter.ok_or_else(|| "expected 0 to 5".to_owned())
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let program = arguments.belfry.clone().unwrap_or_else(|| belfry_command().get_program().into());
    let options = Options {
        seed: arguments.seed,
        structure: arguments.structure.clone(),
        kinds: arguments.only.clone(),
        hours: arguments.hours,
        uneven: arguments.loads == Loads::Uneven,
        scatter: arguments.scatter,
    };
    let scratch = tempfile::tempdir()?;
    let folder = arguments.keep.clone().unwrap_or_else(|| scratch.path().to_owned());
    let mut bench = Bench { program, folder, keep: arguments.keep.is_some(), diagnoses: true, leaves_out: true };
    let mut records = Vec::new();
    for index in arguments.first..arguments.first + arguments.cases {
        let case = Case::draw(index, &options)?;
        let record = bench.run(&case)?;
        println!("{}", line(&record));
        records.push(record);
    }
    print_summary(&records);
    if !bench.diagnoses {
        println!("\nthis belfry has no `diagnose`: the cases were made, identified and compared, and not judged");
    }
    Ok(())
}
