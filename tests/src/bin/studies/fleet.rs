//! What a fleet costs.

use belfry_tests::fleet::{self, FleetCase};
use clap::Args;

/// Structures of 20 channels on one machine, at one set of modes an hour.
const WANTED: f64 = 20_000.0;

/// Many structures through a NATS server to one worker: processor time and bytes of each
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Structures, of 20 channels each
    #[arg(long, default_value_t = 200)]
    structures: usize,
    /// Hours of each
    #[arg(long, default_value_t = 3)]
    hours: usize,
    /// Days before them of which there are results already
    #[arg(long, default_value_t = 0)]
    history_days: usize,
    /// Draws loads, noise and boots
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let Arguments { structures, hours, history_days, seed } = *arguments;
    let cost = fleet::run(&FleetCase { structures, hours, history_days, seed })?;
    println!("{cost}");
    // Two cores, which the server shares.
    let carried = 2.0 * 3600.0 / (cost.worker_s + cost.server_s);
    println!("on two cores: {carried:.0} structures");
    if carried >= WANTED { Ok(()) } else { Err(format!("at least {WANTED} structures are wanted").into()) }
}
