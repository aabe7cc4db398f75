//! What collecting costs.

use std::time::Duration;

use belfry_tests::live;
use clap::Args;

/// Share of one core.
const MOST_CORE_SHARE: f64 = 0.2;
const MOST_BYTES: u64 = 200_000_000;
/// Wake-ups a second and node: one to look for a stop, the rest for bytes and what is due.
const MOST_WAKEUPS: f64 = 2.0;
/// Wake-ups a second to show how the nodes do, however many there are.
const SHOWING: f64 = 5.0;

/// Many nodes on one host: what share of a core and how much memory does `belfry collect` take, and how often does it wake up?
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Nodes, of four channels each, with a window every 25.6 s
    #[arg(long, default_value_t = 64)]
    nodes: u16,
    /// Time over which it is measured
    #[arg(long, default_value_t = 240.0)]
    seconds: f64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let report = live::load(arguments.nodes, Duration::try_from_secs_f64(arguments.seconds)?)?;
    println!("{report}");
    let most_wakeups = SHOWING + MOST_WAKEUPS * f64::from(report.nodes);
    let is_asleep = report.wakeups_per_second <= most_wakeups;
    if report.core_share <= MOST_CORE_SHARE && report.most_bytes <= MOST_BYTES && is_asleep {
        return Ok(());
    }
    Err(format!("at most {MOST_CORE_SHARE} of one core, {MOST_BYTES} bytes and {most_wakeups} wake-ups a second")
        .into())
}
