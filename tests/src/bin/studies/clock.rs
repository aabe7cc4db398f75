//! How well crystals and lines are timed out of the shapes.

use belfry_tests::clock::{ClockStudy, MAC_LOSS, PHASE_DEG};
use clap::Args;

/// Nodes with crystals of their own over lines that jitter: how much do mode shapes suffer?
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Length of the recording
    #[arg(long, default_value_t = 24.0)]
    hours: f64,
    /// How far crystals are off, every other node's fast, the others' slow
    #[arg(long, default_value_t = 50.0)]
    ppm: f64,
    /// How much further they drift as they warm and cool in the course of a day
    #[arg(long, value_name = "PPM", default_value_t = 0.0)]
    swing_ppm: f64,
    /// How late frames may arrive, either way
    #[arg(long, default_value_t = 5.0)]
    jitter_ms: f64,
    /// Draws loads, noise, boots and jitter
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let &Arguments { hours, ppm: crystal_ppm, swing_ppm, jitter_ms, seed } = arguments;
    let report = belfry_tests::clock::run(&ClockStudy { hours, crystal_ppm, swing_ppm, jitter_ms, seed })?;
    println!("{report}");
    if report.worst_mac_loss() <= MAC_LOSS && report.worst_phase_deg() <= PHASE_DEG {
        return Ok(());
    }
    Err(format!("1 - MAC is to stay below {MAC_LOSS:.0e} and phases within {PHASE_DEG} degrees").into())
}
