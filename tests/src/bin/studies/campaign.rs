//! Whether anything is lost, whatever fails.

use belfry_tests::campaign::Campaign;
use clap::Args;

/// Eight nodes and a host over days of simulated time, with faults of lines, nodes, host, disk and sensors: is every window stored once,
/// or listed as lost?
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Days times nodes
    #[arg(long, default_value_t = 1000.0)]
    node_days: f64,
    /// Simulated days of a run
    #[arg(long, value_name = "DAYS", default_value_t = 2.5)]
    days_a_run: f64,
    /// How often things fail, as a multiple of the usual; 0 for faults of lines alone
    #[arg(long, default_value_t = 1.0)]
    intensity: f64,
    /// Share of frames that every line damages; as many are duplicated, reordered, split or late [default: drawn line by line from 0 to 0.2]
    #[arg(long, value_name = "SHARE")]
    damaged: Option<f64>,
    /// Draws everything [default: drawn, and printed]
    #[arg(long)]
    seed: Option<u64>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let &Arguments { node_days, days_a_run, intensity, damaged, seed } = arguments;
    let seed = seed.unwrap_or_else(|| u64::from(rand::random::<u32>()));
    let campaign = Campaign { node_days, days_a_run, intensity, damaged, seed };
    println!("seed {seed}");
    let report = belfry_tests::campaign::run(&campaign, &|report| {
        eprintln!(
            "{:.1} node-days, {} windows made, {} things are wrong",
            report.node_days,
            report.made,
            report.violations.len()
        );
    })?;
    println!("{report}");
    if report.violations.is_empty() {
        return Ok(());
    }
    Err("not every window is stored once or listed as lost".into())
}
