//! How accurate and how honest identification is, over many seeds:
//! `cargo run --release -p belfry-tests --bin identification -- [--seeds N] [--first SEED] [--case NAME]...`.
//!
//! Every seed is a new recording of a structure whose modes are known. A line a seed, and one for all of a case: modes
//! missed and invented, errors of frequency, damping and shape, and the root mean square of (estimate - truth) over the
//! stated standard deviation, which is 1 where the deviations are honest.

use std::process::ExitCode;
use std::time::Instant;

use belfry_host::simulate::modal::score::{Score, identified, score};
use belfry_host::simulate::modal::{ModalError, Recording, Truth};
use belfry_host::spectra::{CrossSpectrum, SpectralPlan};
use belfry_host::study::Analysis;

/// A case: its name and what it is.
const CASES: [(&str, &str); 4] = [
    ("chains-day", "two coupled chains, 24 h at 2.5 Hz (decimated from 10 Hz), 12 modes, the closest 1.8 % apart"),
    ("chains-hour", "the same, 1 h at 50 Hz: the closest pair is a seventh of a line apart"),
    ("tower-day", "a tower, 24 h, 12 modes, the closest 3.3 % apart"),
    ("tower-hour", "the same, 1 h"),
];

fn main() -> ExitCode {
    match arguments().and_then(|(cases, first, seeds)| run(&cases, first, seeds).map_err(|error| error.to_string())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            eprintln!("usage: identification [--seeds N] [--first SEED] [--case NAME]...; cases:");
            for (name, what) in CASES {
                eprintln!("  {name:12} {what}");
            }
            ExitCode::from(2)
        }
    }
}

/// Cases, first seed, number of seeds.
fn arguments() -> Result<(Vec<&'static str>, u64, u64), String> {
    let (mut cases, mut first, mut seeds) = (Vec::new(), 1, 3);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word} needs a value"))?;
        let number = || value.parse::<u64>().map_err(|_| format!("{word} needs a number, not {value}"));
        match word.as_str() {
            "--seeds" => seeds = number()?,
            "--first" => first = number()?,
            "--case" => {
                let known = CASES.iter().find(|(name, _)| *name == value);
                cases.push(known.ok_or_else(|| format!("there is no case {value}"))?.0);
            }
            _ => return Err(format!("{word} is no option")),
        }
    }
    if cases.is_empty() {
        cases = CASES.iter().map(|(name, _)| *name).collect();
    }
    Ok((cases, first, seeds))
}

fn run(cases: &[&str], first: u64, seeds: u64) -> Result<(), Box<dyn std::error::Error>> {
    for case in cases {
        let mut all = Score::default();
        for seed in first..first + seeds {
            let (truth, spectrum) = record(case, seed)?;
            let start = Instant::now();
            let found = identified(&truth, spectrum)?;
            let elapsed_s = start.elapsed().as_secs_f64();
            let score = score(&found, &truth);
            println!("{case} seed {seed}: {elapsed_s:.2} s | {}", score.line());
            all.absorb(score);
        }
        println!("{case}, {seeds} seeds: {}", all.line());
    }
    Ok(())
}

fn record(case: &str, seed: u64) -> Result<(Truth, CrossSpectrum), ModalError> {
    let (chains, hours) = (case.starts_with("chains"), if case.ends_with("day") { 24.0 } else { 1.0 });
    let truth = if chains { Truth::chains(20) } else { Truth::tower() };
    let sampling_rate_hz = match case {
        "chains-day" => 10.0,
        "tower-day" => 12.5,
        _ => 50.0,
    };
    let band_hz = match case {
        "chains-day" => [0.03, 1.0],
        "chains-hour" => [0.03, 1.2],
        _ => [0.05, 1.5],
    };
    let recording = Recording { sampling_rate_hz, hours, noise: 0.05, band_hz, seed, velocity: false, harmonic: None };
    if case != "chains-day" {
        let spectrum = truth.recorded(&recording)?;
        return Ok((truth, spectrum));
    }
    let analysis = Analysis { band_hz: Some(band_hz), decimated_rate_hz: Some(2.5), ..Analysis::default() };
    let plan = SpectralPlan::choose(&[truth.extent(&recording)], &analysis)?;
    let spectrum = truth.recorded_along(&recording, &plan)?;
    Ok((truth, spectrum))
}
