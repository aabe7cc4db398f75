//! Identification against truths: synthetic structures and a real building.

mod score;

use super::synthetic::{Recording, Truth, points, setup};
use super::*;
use crate::spectra::plan::{SetupExtent, SpectralPlan};
use crate::study::{Analysis, Setup};
use score::{Score, identified, mac, median_of_magnitudes, rms, score};

/// The two chains at 2.5 Hz, decimated from 10 Hz.
fn chain_record(seed: u64, hours: f64) -> (Truth, CrossSpectrum) {
    let truth = Truth::chains(20);
    let band_hz = [0.03, 1.0];
    let recording =
        Recording { sampling_rate_hz: 10.0, hours, noise: 0.05, band_hz, seed, harmonic: None, velocity: false };
    let analysis = Analysis { band_hz: Some(band_hz), decimated_rate_hz: Some(2.5), segment: None, ..Analysis::default() };
    let extent = SetupExtent { sampling_rate_hz: 10.0, rows: (hours * 36_000.0) as u64, channels: 20 };
    let plan = SpectralPlan::choose(&[extent], &analysis).unwrap();
    let spectrum = truth.recorded_along(&recording, &plan);
    (truth, spectrum)
}

fn chain_day(seed: u64) -> (Truth, CrossSpectrum) {
    chain_record(seed, 24.0)
}

fn chain_hour(seed: u64) -> (Truth, CrossSpectrum) {
    let truth = Truth::chains(20);
    let recording = Recording {
        sampling_rate_hz: 50.0,
        hours: 1.0,
        noise: 0.05,
        band_hz: [0.03, 1.2],
        seed,
        harmonic: None,
        velocity: false,
    };
    let spectrum = truth.recorded(&recording);
    (truth, spectrum)
}

fn tower_hour(seed: u64) -> (Truth, CrossSpectrum) {
    let truth = Truth::tower();
    let recording = Recording {
        sampling_rate_hz: 50.0,
        hours: 1.0,
        noise: 0.05,
        band_hz: [0.05, 1.5],
        seed,
        harmonic: None,
        velocity: false,
    };
    let spectrum = truth.recorded(&recording);
    (truth, spectrum)
}

#[test]
#[ignore = "figures: cargo test --release -p belfry-host identify::tests::figures -- --ignored --nocapture"]
fn figures() {
    // SEEDS: how many; CASE: part of a case's name; MODES: list every mode.
    let seeds: u64 = std::env::var("SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(3);
    let which = std::env::var("CASE").unwrap_or_default();
    for (name, case) in [
        ("chains 24 h", chain_day as fn(u64) -> (Truth, CrossSpectrum)),
        ("chains 1 h", chain_hour),
        ("tower 1 h", tower_hour),
        ("tower day", |seed| {
            let truth = Truth::tower();
            let recording = Recording {
                sampling_rate_hz: 12.5,
                hours: 24.0,
                noise: 0.05,
                band_hz: [0.05, 1.5],
                seed,
                harmonic: None,
                velocity: false,
            };
            let spectrum = truth.recorded(&recording);
            (truth, spectrum)
        }),
    ] {
        if !name.contains(&which) {
            continue;
        }
        let mut all = Score::default();
        for seed in 1..=seeds {
            let (truth, spectrum) = case(seed);
            let started = std::time::Instant::now();
            let found = identified(&truth, &spectrum);
            let score = score(&found, &truth);
            if !found.harmonics.is_empty() {
                println!("harmonics {:?}", found.harmonics);
            }
            println!("{name} seed {seed}: {:?} | {} ", started.elapsed(), score.line());
            if std::env::var("MODES").is_ok() {
                println!("  truth {:.4?}", truth.frequencies_hz);
                for mode in &found.modes {
                    let best = (0..truth.frequencies_hz.len())
                        .max_by(|&a, &b| mac(mode, &truth, a).total_cmp(&mac(mode, &truth, b)))
                        .unwrap();
                    println!(
                        "  {:.5} ± {:.5} ({:.4}) damping {:.4} ± {:.4} mpc {:.4} best {} MAC {:.4}",
                        mode.frequency_hz,
                        mode.frequency_std_hz,
                        truth.frequencies_hz[best],
                        mode.damping_ratio,
                        mode.damping_ratio_std,
                        mode.phase_collinearity,
                        best,
                        mac(mode, &truth, best)
                    );
                }
            }
            all.absorb(score);
        }
        println!("{name} all: {}", all.line());
    }
}

#[test]
fn a_day_of_close_modes_is_found_whole_and_as_precisely_as_the_record_allows() {
    // Ten hours keep the test short: at 2.5 Hz decimated 20 channels leave 42 windows of 2048.
    let (truth, spectrum) = chain_record(5, 10.0);
    let found = identified(&truth, &spectrum);
    let score = score(&found, &truth);
    println!("{}", score.line());
    assert_eq!((score.missed, score.spurious), (0, 0));
    // Au's bound for 10 h is 0.03 to 0.08 % on f and 3 to 7 % on damping; of 12 modes the worst may be 3.5 of them off.
    assert!(median_of_magnitudes(&score.frequency_errors) < 0.06);
    assert!(score.damping.iter().all(|ratio| (ratio - 1.0).abs() < 0.25));
    assert!(score.macs.iter().all(|&mac| mac > 0.98));
    // Twelve values of unit variance have an rms of 1 ± 0.2, and their own standard deviations are known to 15 %.
    assert!((0.5..1.7).contains(&rms(&score.frequency_z)), "{}", score.line());
    assert!((0.6..1.5).contains(&rms(&score.shape_z)), "{}", score.line());
}

#[test]
fn an_hour_of_a_tower_shows_all_twelve_modes_and_nothing_else() {
    for seed in [1, 2] {
        let (truth, spectrum) = tower_hour(seed);
        let found = identified(&truth, &spectrum);
        let score = score(&found, &truth);
        println!("{}", score.line());
        assert_eq!((score.missed, score.spurious), (0, 0), "{}", score.line());
        assert!(score.macs.iter().all(|&mac| mac > 0.99), "{}", score.line());
        assert!(found.harmonics.is_empty(), "{:?}", found.harmonics);
        assert!(found.modes.iter().all(|mode| mode.phase_collinearity > 0.98));
    }
}

fn short_tower(harmonic: Option<(f64, f64)>, band_hz: [f64; 2], rate_hz: f64, seed: u64) -> (Truth, CrossSpectrum) {
    let truth = Truth::tower();
    let recording =
        Recording { sampling_rate_hz: rate_hz, hours: 1.0, noise: 0.05, band_hz, seed, harmonic, velocity: false };
    let spectrum = truth.recorded(&recording);
    (truth, spectrum)
}

#[test]
fn a_machine_is_reported_as_a_harmonic_and_costs_no_mode() {
    let (truth, spectrum) = short_tower(Some((0.633, 0.5)), [0.05, 1.5], 12.5, 3);
    let found = identified(&truth, &spectrum);
    assert_eq!(found.harmonics.len(), 1, "{:?}", found.harmonics);
    assert!((found.harmonics[0].frequency_hz - 0.633).abs() < 0.1 * found.frequency_resolution_hz);
    assert!((found.harmonics[0].kurtosis - 1.5).abs() < 0.1);
    let score = score(&found, &truth);
    assert_eq!((score.missed, score.spurious), (0, 0), "{}", score.line());
}

#[test]
fn tails_of_modes_outside_the_band_are_no_modes() {
    // The band ends between modes: 0.366 and 1.150 Hz lie just outside.
    let (truth, spectrum) = short_tower(None, [0.39, 1.10], 12.5, 4);
    let found = identified(&truth, &spectrum);
    let frequencies: Vec<f64> = found.modes.iter().map(|mode| mode.frequency_hz).collect();
    assert_eq!(frequencies.len(), 6, "{frequencies:?}");
    for (found, truth) in frequencies.iter().zip([0.424, 0.475, 0.505, 0.522, 0.795, 0.964]) {
        assert!((found / truth - 1.0).abs() < 0.01, "{frequencies:?}");
    }
}

#[test]
fn sensor_noise_alone_has_no_modes() {
    let silent =
        Truth { frequencies_hz: vec![3.0], damping_ratio: 0.01, shapes: nalgebra::DMatrix::from_element(20, 1, 1.0) };
    for seed in 1..=5 {
        // The only mode lies above the band; its tail is 50 dB below the noise.
        let recording = Recording {
            sampling_rate_hz: 12.5,
            hours: 1.0,
            noise: 30.0,
            band_hz: [0.05, 1.5],
            seed,
            harmonic: None,
            velocity: false,
        };
        let found = identified(&silent, &silent.recorded(&recording));
        assert!(found.modes.is_empty(), "seed {seed}: {:?}", found.modes[0].frequency_hz);
        assert!(found.harmonics.is_empty());
    }
}

#[test]
fn one_channel_is_enough_for_frequencies() {
    let whole = Truth::tower();
    let truth = Truth { shapes: whole.shapes.rows(18, 1).into_owned(), ..whole };
    let recording = Recording {
        sampling_rate_hz: 12.5,
        hours: 6.0,
        noise: 0.05,
        band_hz: [0.05, 1.5],
        seed: 1,
        harmonic: None,
        velocity: false,
    };
    let found = identified(&truth, &truth.recorded(&recording));
    // No shape to tell modes apart by: only what one channel shows as peaks of its own. The two at 0.505 and 0.522 Hz,
    // four bandwidths apart and of unlike strength, may be one.
    assert!(found.modes.len() >= 8, "{:?}", found.modes.len());
    for mode in &found.modes {
        let near = truth.frequencies_hz.iter().map(|f| (f - mode.frequency_hz).abs()).fold(f64::INFINITY, f64::min);
        let blend = (0.505..0.522).contains(&mode.frequency_hz);
        assert!(blend || near < 0.005 * mode.frequency_hz, "{}", mode.frequency_hz);
        assert_eq!((mode.shape[0].re, mode.shape[0].im), (1.0, 0.0));
    }
}

#[test]
fn a_recorded_velocity_gives_the_same_modes() {
    let truth = Truth::tower();
    let recording = Recording {
        sampling_rate_hz: 12.5,
        hours: 1.0,
        noise: 0.05,
        band_hz: [0.05, 1.5],
        seed: 6,
        harmonic: None,
        velocity: true,
    };
    let spectrum = truth.recorded(&recording);
    let mut velocity = setup("velocity", &points(20), &[]);
    velocity.unit = crate::study::Unit::MetrePerSecond;
    let found = identify(&[MeasuredSetup { setup: &velocity, spectrum }], &ModeChoice::default()).unwrap();
    let score = score(&found, &truth);
    assert_eq!((score.missed, score.spurious), (0, 0), "{}", score.line());
    // As with acceleration: no bias beyond the stated scatter.
    assert!(rms(&score.frequency_z) < 1.7, "{}", score.line());
}

#[test]
fn setups_merge_through_their_references() {
    let truth = Truth::tower();
    // Three references at the top, which see both directions and torsion; the levels shared out over two measurements.
    let rows = [vec![16, 17, 18, 0, 1, 4, 5, 8, 9, 12, 13], vec![16, 17, 18, 2, 3, 6, 7, 10, 11, 14, 15, 19]];
    let analysis = Analysis { band_hz: Some([0.05, 1.5]), decimated_rate_hz: None, segment: None, ..Analysis::default() };
    let extent = SetupExtent { sampling_rate_hz: 12.5, rows: 90_000, channels: 12 };
    let plan = SpectralPlan::choose(&[extent; 2], &analysis).unwrap();
    let measured: Vec<(Setup, CrossSpectrum)> = rows
        .iter()
        .enumerate()
        .map(|(at, rows)| {
            let part = Truth { shapes: truth.shapes.select_rows(rows), ..truth.clone() };
            let recording = Recording {
                sampling_rate_hz: 12.5,
                hours: 2.0,
                noise: 0.05,
                band_hz: [0.05, 1.5],
                seed: 10 + at as u64,
                harmonic: None,
                velocity: false,
            };
            let names: Vec<String> = rows.iter().map(|row| format!("p{row}")).collect();
            let references: Vec<bool> = rows.iter().map(|&row| (16..=18).contains(&row)).collect();
            (setup(&format!("s{at}"), &names, &references), part.recorded_along(&recording, &plan))
        })
        .collect();
    let views: Vec<MeasuredSetup<'_>> =
        measured.iter().map(|(setup, spectrum)| MeasuredSetup { setup, spectrum: spectrum.clone() }).collect();
    let found = identify(&views, &ModeChoice::default()).unwrap();
    let by_point =
        Truth { shapes: truth.shapes.select_rows(&[rows[0].clone(), rows[1][3..].to_vec()].concat()), ..truth.clone() };
    let score = score(&found, &by_point);
    println!("{}", score.line());
    assert_eq!((score.missed, score.spurious), (0, 0), "{}", score.line());
    // Torsion moves the references as little as anything here; its scale is the least certain.
    assert!(score.macs.iter().all(|&mac| mac > 0.97), "{}", score.line());
    assert!(found.modes.iter().all(|mode| mode.shape.len() == 20));
}

/// The tower at 6.25 Hz in segments of 512, for `hours`: the setup and its spectrum.
fn brief_tower(hours: f64) -> (Truth, Setup, CrossSpectrum) {
    let truth = Truth::tower();
    let analysis = Analysis {
        band_hz: Some([0.05, 1.5]),
        decimated_rate_hz: Some(6.25),
        segment: Some(512),
        ..Analysis::default()
    };
    let extent = SetupExtent { sampling_rate_hz: 12.5, rows: (hours * 45_000.0) as u64, channels: 20 };
    let plan = SpectralPlan::choose(&[extent], &analysis).unwrap();
    let recording = Recording {
        sampling_rate_hz: 12.5,
        hours,
        noise: 0.05,
        band_hz: [0.05, 1.5],
        seed: 1,
        harmonic: None,
        velocity: false,
    };
    let spectrum = truth.recorded_along(&recording, &plan);
    (truth, setup("brief", &points(20), &[]), spectrum)
}

#[test]
fn too_little_record_is_refused_with_what_it_takes() {
    let (_, setup, spectrum) = brief_tower(0.2);
    let error = identify(&[MeasuredSetup { setup: &setup, spectrum }], &ModeChoice::default()).unwrap_err();
    let IdentifyError::RankDeficient { averages, channels: 20 } = error else { panic!("{error}") };
    assert!(averages < 20 && error.to_string().contains("times as long"), "{error}");
    assert!(matches!(identify(&[], &ModeChoice::default()), Err(IdentifyError::NoSetup)));
}

#[test]
fn below_four_averages_a_channel_modes_are_not_picked_but_can_be_named() {
    let (truth, setup, spectrum) = brief_tower(0.6);
    let measured = [MeasuredSetup { setup: &setup, spectrum }];
    let error = identify(&measured, &ModeChoice::default()).unwrap_err();
    let IdentifyError::TooFewAverages { averages, channels: 20, wanted: 80, missing_min } = error else {
        panic!("{error}")
    };
    // A window more every half segment of 40.96 s.
    assert_eq!(missing_min, ((80 - averages) as f64 * 40.96 / 60.0).ceil());
    assert!(error.to_string().contains("modes_hz"), "{error}");
    let only = ModeChoice { only_hz: Some(vec![0.366, 0.795]), ..ModeChoice::default() };
    let found = identify(&measured, &only).unwrap();
    assert_eq!(found.modes.len(), 2);
    for (mode, at) in found.modes.iter().zip([2, 7]) {
        assert!((mode.frequency_hz / truth.frequencies_hz[at] - 1.0).abs() < 0.01, "{}", mode.frequency_hz);
        assert!(mac(mode, &truth, at) > 0.95);
    }
}

#[test]
fn a_user_adds_drops_and_fixes_modes() {
    let (truth, setup, spectrum) = brief_tower(2.0);
    let measured = [MeasuredSetup { setup: &setup, spectrum }];
    let automatic = identify(&measured, &ModeChoice::default()).unwrap();
    assert_eq!(automatic.modes.len(), 12);
    let choice = ModeChoice { drop_hz: vec![0.366, 0.7], ..ModeChoice::default() };
    let dropped = identify(&measured, &choice).unwrap();
    assert_eq!(dropped.modes.len(), 11);
    assert!(dropped.modes.iter().all(|mode| (mode.frequency_hz - 0.366).abs() > 0.02));
    assert!(dropped.warnings.iter().any(|w| w.contains("0.7 Hz") && w.contains("none is dropped")), "{dropped:?}");
    // Nothing is at 0.65 Hz: it stays, as asked, and that is said.
    let added = identify(&measured, &ModeChoice { add_hz: vec![0.65], ..ModeChoice::default() }).unwrap();
    assert_eq!(added.modes.len(), 13);
    assert!(added.warnings.iter().any(|w| w.contains("no peak of its own")), "{:?}", added.warnings);
    let fixed = ModeChoice { only_hz: Some(truth.frequencies_hz.clone()), ..ModeChoice::default() };
    let fixed = identify(&measured, &fixed).unwrap();
    assert!(fixed.warnings.is_empty(), "{:?}", fixed.warnings);
    for (fixed, automatic) in fixed.modes.iter().zip(&automatic.modes) {
        let difference = (fixed.frequency_hz - automatic.frequency_hz).abs();
        assert!(difference < automatic.frequency_std_hz, "{} {}", fixed.frequency_hz, automatic.frequency_hz);
    }
}

#[test]
fn the_result_serialises_under_the_names_of_the_design() {
    let (truth, spectrum) = short_tower(None, [0.3, 1.5], 12.5, 6);
    let json = serde_json::to_value(identified(&truth, &spectrum)).unwrap();
    let mode = &json["modes"][0];
    for key in
        ["number", "frequency_hz", "frequency_std_hz", "damping_ratio", "damping_ratio_std", "phase_collinearity"]
    {
        assert!(mode[key].is_number(), "{key}: {mode}");
    }
    for key in ["re", "im", "std"] {
        assert!(mode["shape"][0][key].is_number(), "{key}");
    }
    assert!(mode["shape"][0]["channel"].is_string());
    assert!(json["averages"].is_number() && json["frequency_resolution_hz"].is_number());
    assert!(json["harmonics"].is_array() && json["warnings"].is_array());
}
