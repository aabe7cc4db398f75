//! How accurate and how honest identification is, over many seeds.
//!
//! Every seed is a new recording of a structure whose modes are known. A line a seed, and one for all of a case: modes
//! missed and invented, errors of frequency, damping and shape, and the root mean square of (estimate - truth) over the
//! stated standard deviation, which is 1 where the deviations are honest.

use std::time::Instant;

use belfry_host::simulate::modal::score::{Score, identified, identified_by_both, score};
use belfry_host::simulate::modal::{ModalError, Recording, Truth};
use belfry_host::spectra::{CrossSpectrum, SpectralPlan};
use belfry_host::study::Analysis;
use clap::Args;

use crate::cases::cases_in_words;

/// Recordings of structures whose modes are known: modes missed and invented, errors, and how honest deviations are
#[derive(Debug, Args)]
#[command(after_help = cases_in_words(CASES))]
pub(super) struct Arguments {
    /// How many seeds
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    first: u64,
    /// A case; repeat for more [default: all]
    #[arg(long = "case", value_name = "NAME", value_parser = CASES.map(|(name, _)| name))]
    cases: Vec<String>,
    /// By the fit of spectra alone, without the second opinion that `belfry identify` asks
    #[arg(long)]
    without_opinion: bool,
}

/// A case: its name and what it is.
const CASES: [(&str, &str); 5] = [
    (
        "chains-day",
        "two coupled chains, 24 h at 2.5 Hz (decimated from 10 Hz), 12 modes to 0.93 Hz, the closest 1.8 % apart",
    ),
    ("chains-hour", "the same twenty times as fast, to 18.6 Hz, 1 h at 50 Hz (decimated from 200 Hz)"),
    (
        "chains-short",
        "the chains to 0.93 Hz in 1 h at 50 Hz: the closest pair is a seventh of a line apart, beyond resolution",
    ),
    ("tower-day", "a tower, 24 h, 12 modes, the closest 3.3 % apart"),
    ("tower-hour", "the same, 1 h"),
];

pub(super) fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    let &Arguments { seeds, first, .. } = arguments;
    let is_wanted = |case: &str| arguments.cases.is_empty() || arguments.cases.iter().any(|wanted| wanted == case);
    for (case, _) in CASES.into_iter().filter(|(case, _)| is_wanted(case)) {
        let mut all = Score::default();
        for seed in first..first + seeds {
            let (truth, spectrum) = record(case, seed)?;
            let start = Instant::now();
            let found = if arguments.without_opinion {
                identified(&truth, spectrum)?
            } else {
                identified_by_both(&truth, spectrum)?
            };
            let elapsed_s = start.elapsed().as_secs_f64();
            let score = score(&found, &truth);
            println!("{case} seed {seed}: {elapsed_s:.2} s | {}", score.line());
            for (what, all_hz) in [("missed", &score.missed_hz), ("no mode", &score.spurious_hz)] {
                all_hz.iter().for_each(|hz| println!("    {what}: {hz:.4} Hz"));
            }
            all.absorb(score);
        }
        println!("{case}, {seeds} seeds: {}", all.line());
    }
    Ok(())
}

fn record(case: &str, seed: u64) -> Result<(Truth, CrossSpectrum), ModalError> {
    let hours = if case.ends_with("day") { 24.0 } else { 1.0 };
    let mut truth = if case.starts_with("chains") { Truth::chains() } else { Truth::tower() };
    // Rate, band, and the rate that the case is about where the recording is made finer: what is recorded is the
    // acceleration averaged over a step.
    let (sampling_rate_hz, band_hz, decimated_rate_hz) = match case {
        "chains-day" => (10.0, [0.03, 1.0], Some(2.5)),
        "chains-hour" => (200.0, [0.6, 20.0], Some(50.0)),
        "chains-short" => (50.0, [0.03, 1.2], None),
        "tower-day" => (12.5, [0.05, 1.5], None),
        _ => (50.0, [0.05, 1.5], None),
    };
    if case == "chains-hour" {
        truth.frequencies_hz.iter_mut().for_each(|hz| *hz *= 20.0);
    }
    // Of each channel's RMS, white over the band of the rate that the case is about.
    let oversampled: f64 = sampling_rate_hz / decimated_rate_hz.unwrap_or(sampling_rate_hz);
    let noise = 0.05 * oversampled.sqrt();
    let recording = Recording { noise, band_hz, ..Recording::of(sampling_rate_hz, hours, seed) };
    let analysis = Analysis { band_hz: Some(band_hz), decimated_rate_hz, ..Analysis::default() };
    let plan = SpectralPlan::choose(&[truth.extent(&recording)], &analysis)?;
    let spectrum = truth.recorded_along(&recording, &plan)?;
    Ok((truth, spectrum))
}
