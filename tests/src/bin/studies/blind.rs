//! The blind bench of `belfry diagnose`.
//!
//! Each case is a structure of which the study's model lacks something, or nothing; a line says what was hidden and what belfry
//! said, and the score of all of them follows.

use std::path::PathBuf;

use belfry_tests::belfry_command;
use belfry_tests::blind::{self, Bench, Case, Kinds, Options, Worlds, line, print_summary};
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
    /// Draws all cases [default: drawn now, and printed]
    #[arg(long)]
    seed: Option<u64>,
    /// Whether scatter, loads and sizes are what belfry assumes
    #[arg(long, value_enum, default_value_t = World::Drawn)]
    world: World,
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
    /// What shakes all structures
    #[arg(long, value_enum)]
    loads: Option<Loads>,
    /// How far the segments of all structures scatter, in units of what the study states
    #[arg(long, value_parser = scatter)]
    scatter: Option<f64>,
    /// The program to judge [default: this workspace's]
    #[arg(long, value_name = "PROGRAM")]
    belfry: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum World {
    /// Each case draws kernel, length and size of its scatter, its loads, and effects that move frequencies by 0.5 to 15 %
    Drawn,
    /// As belfry assumes them, and effects that move frequencies by 3 to 15 %
    Assumed,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Loads {
    /// Noise that drives all modes alike
    Even,
    /// Noise that drives them together
    Uneven,
    /// Coherent, coloured wind
    Wind,
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
    let seed = arguments.seed.unwrap_or_else(|| u64::from(rand::random::<u32>()));
    println!("seed {seed}");
    let loads = arguments.loads.map(|loads| match loads {
        Loads::Even => blind::Loads::Even,
        Loads::Uneven => blind::Loads::Uneven,
        Loads::Wind => blind::Loads::Wind,
    });
    let options = Options {
        seed,
        structure: arguments.structure.clone(),
        kinds: arguments.only.clone(),
        hours: arguments.hours,
        worlds: Worlds { are_drawn: arguments.world == World::Drawn, scatter: arguments.scatter, loads },
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
