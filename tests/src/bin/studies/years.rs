//! Years of weather, with and without a loss of stiffness.

use belfry_tests::years::watch_years;
use clap::Args;
use rand::RngExt;

/// Watch structures for a year each: false alarms, and how soon a hidden loss of stiffness is found
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Sound structures, and as many with a loss
    #[arg(long, default_value_t = 20)]
    years: u64,
    /// The first seed; drawn at the run where none is given
    #[arg(long)]
    seed: Option<u64>,
    /// Stiffness that is lost, of the whole structure; each mode feels a fifth of it to all
    #[arg(long, default_value_t = 1.0)]
    loss_percent: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let seed = arguments.seed.unwrap_or_else(|| rand::rng().random_range(0..1 << 31));
    println!("seed {seed}");
    let said = |done: usize| eprint!("\r{done} of {} years", 2 * arguments.years);
    let report = watch_years(seed, arguments.years, arguments.loss_percent, said);
    println!("\n{report}");
    Ok(())
}
