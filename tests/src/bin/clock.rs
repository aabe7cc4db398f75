//! How well crystals and lines are timed out of the shapes: `cargo run --release -p belfry-tests --bin clock -- --hours 24`.

use std::process::ExitCode;

use belfry_tests::clock::{ClockStudy, MAC_LOSS, PHASE_DEG, run};

const USAGE: &str = "usage: clock [--hours H] [--ppm P] [--swing-ppm P] [--jitter-ms J] [--seed S]";

fn main() -> ExitCode {
    let mut study = ClockStudy { hours: 24.0, crystal_ppm: 50.0, swing_ppm: 0.0, jitter_ms: 5.0, seed: 1 };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let Some(value) = arguments.next().and_then(|value| value.parse::<f64>().ok()).filter(|value| *value >= 0.0)
        else {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        };
        match name.as_str() {
            "--hours" => study.hours = value,
            "--ppm" => study.crystal_ppm = value,
            "--swing-ppm" => study.swing_ppm = value,
            "--jitter-ms" => study.jitter_ms = value,
            "--seed" => study.seed = value as u64,
            _ => {
                eprintln!("{USAGE}");
                return ExitCode::from(2);
            }
        }
    }
    match run(&study) {
        Ok(report) => {
            println!("{report}");
            let reached = report.worst_mac_loss() <= MAC_LOSS && report.worst_phase_deg() <= PHASE_DEG;
            if reached { ExitCode::SUCCESS } else { ExitCode::FAILURE }
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
