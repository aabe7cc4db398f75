//! Identification against truths: synthetic structures and a real building.

use super::*;
use crate::simulate::modal::score::{identified, mac, median_of_magnitudes, rms, score};
use crate::simulate::modal::{Recording, Truth, points, setup};
use crate::spectra::CrossSpectrum;
use crate::spectra::SetupExtent;
use crate::spectra::plan::SpectralPlan;
use crate::study::{Analysis, Setup};

/// The two chains at 2.5 Hz, decimated from 10 Hz.
fn chain_record(seed: u64, hours: f64) -> (Truth, CrossSpectrum) {
    let truth = Truth::chains();
    let band_hz = [0.03, 1.0];
    let recording = Recording { band_hz, ..Recording::of(10.0, hours, seed) };
    let analysis =
        Analysis { band_hz: Some(band_hz), decimated_rate_hz: Some(2.5), segment: None, ..Analysis::default() };
    let extent =
        SetupExtent { sampling_rate_hz: 10.0, rows: (hours * 36_000.0) as u64, channels: 20, block_rows: None };
    let plan = SpectralPlan::choose(&[extent], &analysis).unwrap();
    let spectrum = truth.recorded_along(&recording, &plan).unwrap();
    (truth, spectrum)
}

#[test]
fn a_day_of_close_modes_is_found_whole_and_as_precisely_as_the_record_allows() {
    // Ten hours keep the test short: at 2.5 Hz decimated 20 channels leave 42 windows of 2048.
    let (truth, spectrum) = chain_record(5, 10.0);
    let found = identified(&truth, spectrum).unwrap();
    let score = score(&found, &truth);
    println!("{}", score.line());
    assert_eq!((score.missed_hz.len(), score.spurious_hz.len()), (0, 0));
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
        let (truth, spectrum) = short_tower(None, [0.05, 1.5], 50.0, seed);
        let found = identified(&truth, spectrum).unwrap();
        let score = score(&found, &truth);
        println!("{}", score.line());
        assert_eq!((score.missed_hz.len(), score.spurious_hz.len()), (0, 0), "{}", score.line());
        assert!(score.macs.iter().all(|&mac| mac > 0.99), "{}", score.line());
        assert!(found.harmonics.is_empty(), "{:?}", found.harmonics);
        assert!(found.modes.iter().all(|mode| mode.phase_collinearity > 0.98));
    }
}

#[test]
fn an_hours_narrow_modes_are_fitted_to_finer_lines() {
    let mut zs = Vec::new();
    for seed in 1..=4 {
        let (truth, spectrum) = short_tower(None, [0.05, 1.5], 12.5, seed);
        let spacing_hz = spectrum.grid().spacing_hz();
        let found = identified(&truth, spectrum).unwrap();
        let score = score(&found, &truth);
        assert_eq!((score.missed_hz.len(), score.spurious_hz.len()), (0, 0), "{}", score.line());
        // The first mode's bandwidth is a sixth of the distance between the spectrum's lines.
        let first = &found.modes[0];
        assert!(first.lines_in_bandwidth > 3.0 * first.bandwidth_hz() / spacing_hz, "{}", first.lines_in_bandwidth);
        zs.extend(score.frequency_z.iter().chain(&score.damping_z).copied());
    }
    // Over 96 numbers of unit variance the rms is 1 ± 0.07.
    assert!((0.8..1.2).contains(&rms(&zs)), "{}", rms(&zs));
}

fn short_tower(harmonic: Option<(f64, f64)>, band_hz: [f64; 2], rate_hz: f64, seed: u64) -> (Truth, CrossSpectrum) {
    let truth = Truth::tower();
    let recording = Recording { band_hz, harmonic, ..Recording::of(rate_hz, 1.0, seed) };
    let spectrum = truth.recorded(&recording).unwrap();
    (truth, spectrum)
}

#[test]
fn a_machine_is_reported_as_a_harmonic_and_costs_no_mode() {
    let (truth, spectrum) = short_tower(Some((0.633, 0.5)), [0.05, 1.5], 12.5, 3);
    let found = identified(&truth, spectrum).unwrap();
    assert_eq!(found.harmonics.len(), 1, "{:?}", found.harmonics);
    assert!((found.harmonics[0].frequency_hz - 0.633).abs() < 0.1 * found.frequency_resolution_hz);
    assert!((found.harmonics[0].kurtosis - 1.5).abs() < 0.1);
    let score = score(&found, &truth);
    assert_eq!((score.missed_hz.len(), score.spurious_hz.len()), (0, 0), "{}", score.line());
}

#[test]
fn tails_of_modes_outside_the_band_are_no_modes() {
    // The band ends between modes: 0.366 and 1.150 Hz lie just outside.
    let (truth, spectrum) = short_tower(None, [0.39, 1.10], 12.5, 4);
    let found = identified(&truth, spectrum).unwrap();
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
        let recording = Recording { noise: 30.0, ..Recording::of(12.5, 1.0, seed) };
        let found = identified(&silent, silent.recorded(&recording).unwrap()).unwrap();
        assert!(found.modes.is_empty(), "seed {seed}: {:?}", found.modes[0].frequency_hz);
        assert!(found.harmonics.is_empty());
    }
}

#[test]
fn one_channel_is_enough_for_frequencies() {
    let whole = Truth::tower();
    let truth = Truth { shapes: whole.shapes.rows(18, 1).into_owned(), ..whole };
    let recording = Recording::of(12.5, 6.0, 1);
    let found = identified(&truth, truth.recorded(&recording).unwrap()).unwrap();
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
    let recording = Recording { velocity: true, ..Recording::of(12.5, 1.0, 6) };
    let spectrum = truth.recorded(&recording).unwrap();
    let mut velocity = setup("velocity", &points(20), &[]);
    velocity.unit = crate::study::Unit::MetrePerSecond;
    let found = identify(&[MeasuredSetup { setup: &velocity, spectrum }], &ModeChoice::default()).unwrap();
    let score = score(&found, &truth);
    assert_eq!((score.missed_hz.len(), score.spurious_hz.len()), (0, 0), "{}", score.line());
    // As with acceleration: no bias beyond the stated scatter.
    assert!(rms(&score.frequency_z) < 1.7, "{}", score.line());
}

/// Channels of the tower in two measurements: three references at the top, which see both directions and torsion, and the levels shared out.
const TWO_SETUPS: [&[usize]; 2] =
    [&[16, 17, 18, 0, 1, 4, 5, 8, 9, 12, 13], &[16, 17, 18, 2, 3, 6, 7, 10, 11, 14, 15, 19]];

/// The tower in two measurements of two hours, in the second with other frequencies; and its shapes in the order of the merged points.
fn two_setups(changed: f64) -> (Identification, Truth) {
    let truth = Truth::tower();
    let analysis =
        Analysis { band_hz: Some([0.05, 1.5]), decimated_rate_hz: None, segment: None, ..Analysis::default() };
    let extent = SetupExtent { sampling_rate_hz: 12.5, rows: 90_000, channels: 12, block_rows: None };
    let plan = SpectralPlan::choose(&[extent; 2], &analysis).unwrap();
    let measured: Vec<(Setup, CrossSpectrum)> = TWO_SETUPS
        .iter()
        .enumerate()
        .map(|(at, rows)| {
            let factor = if at == 0 { 1.0 } else { changed };
            let frequencies_hz = truth.frequencies_hz.iter().map(|hz| factor * hz).collect();
            let part = Truth { shapes: truth.shapes.select_rows(*rows), frequencies_hz, ..truth.clone() };
            let recording = Recording::of(12.5, 2.0, 10 + at as u64);
            let names: Vec<String> = rows.iter().map(|row| format!("p{row}")).collect();
            let references: Vec<bool> = rows.iter().map(|&row| (16..=18).contains(&row)).collect();
            (setup(&format!("s{at}"), &names, &references), part.recorded_along(&recording, &plan).unwrap())
        })
        .collect();
    let views: Vec<MeasuredSetup<'_>> =
        measured.iter().map(|(setup, spectrum)| MeasuredSetup { setup, spectrum: spectrum.clone() }).collect();
    let found = identify(&views, &ModeChoice::default()).unwrap();
    let shapes = truth.shapes.select_rows(&[TWO_SETUPS[0], &TWO_SETUPS[1][3..]].concat());
    (found, Truth { shapes, ..truth })
}

#[test]
fn setups_merge_through_their_references() {
    let (found, by_point) = two_setups(1.0);
    let score = score(&found, &by_point);
    println!("{}", score.line());
    assert_eq!((score.missed_hz.len(), score.spurious_hz.len()), (0, 0), "{}", score.line());
    // Torsion moves the references as little as anything here; its scale is the least certain.
    assert!(score.macs.iter().all(|&mac| mac > 0.97), "{}", score.line());
    assert!(found.modes.iter().all(|mode| mode.shape.len() == 20));
    assert!(found.warnings.iter().all(|warning| !warning.contains("changed between setups")), "{:?}", found.warnings);
}

#[test]
fn a_structure_that_changed_between_setups_keeps_its_modes_and_is_told() {
    let (found, truth) = two_setups(0.992);
    for hz in &truth.frequencies_hz {
        let is_between = |mode: &&Mode| (0.99..1.002).contains(&(mode.frequency_hz / hz));
        assert!(
            found.modes.iter().any(|mode| is_between(&mode)),
            "{hz} Hz of {:?}",
            found.modes.iter().map(|mode| mode.frequency_hz).collect::<Vec<_>>()
        );
    }
    // The low modes are not known so well.
    let told: Vec<&String> = found.warnings.iter().filter(|text| text.contains("changed between setups")).collect();
    assert!(told.len() >= 4 && told.iter().all(|text| text.contains("\"s0\"") && text.contains("\"s1\"")), "{told:?}");
    let of_wide = |mode: &&Mode| mode.frequency_std_hz > 0.001 * mode.frequency_hz;
    assert!(found.modes.iter().filter(of_wide).count() >= found.modes.len() / 2, "they are that uncertain");
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
    let extent =
        SetupExtent { sampling_rate_hz: 12.5, rows: (hours * 45_000.0) as u64, channels: 20, block_rows: None };
    let plan = SpectralPlan::choose(&[extent], &analysis).unwrap();
    let recording = Recording::of(12.5, hours, 1);
    let spectrum = truth.recorded_along(&recording, &plan).unwrap();
    (truth, setup("brief", &points(20), &[]), spectrum)
}

#[test]
fn too_little_record_is_refused_with_what_it_takes() {
    let (_, setup, spectrum) = brief_tower(0.2);
    let error = identify(&[MeasuredSetup { setup: &setup, spectrum }], &ModeChoice::default()).unwrap_err();
    let IdentifyError::RankDeficient { averages, channels: 20, .. } = error else { panic!("{error}") };
    assert!(averages < 20 && error.to_string().contains("times as long"), "{error}");
    assert!(matches!(identify(&[], &ModeChoice::default()), Err(IdentifyError::NoSetup)));
}

#[test]
fn below_two_averages_a_channel_modes_are_not_picked_but_can_be_named() {
    let (truth, setup, spectrum) = brief_tower(0.25);
    let measured = [MeasuredSetup { setup: &setup, spectrum }];
    let error = identify(&measured, &ModeChoice::default()).unwrap_err();
    let IdentifyError::TooFewAverages { averages, channels: 20, wanted: 40, missing_min } = error else {
        panic!("{error}")
    };
    // A window more every half segment of 40.96 s.
    assert_eq!(missing_min, ((40 - averages) as f64 * 40.96 / 60.0).ceil());
    assert!(error.to_string().contains("modes_hz"), "{error}");
    let outside = ModeChoice { only_hz: Some(vec![7.0]), ..ModeChoice::default() };
    assert!(matches!(identify(&measured, &outside), Err(IdentifyError::NoneInBand { .. })));
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
    // Nothing is at 0.65 Hz, which is said with the nearest peak, and the others stay as they are.
    let added = identify(&measured, &ModeChoice { add_hz: vec![0.65], ..ModeChoice::default() }).unwrap();
    assert!(
        added.modes == automatic.modes,
        "{:?}",
        added.modes.iter().map(|mode| mode.frequency_hz).collect::<Vec<_>>()
    );
    let off = |mode: &&Mode| (mode.frequency_hz - 0.65).abs();
    let nearest = automatic.modes.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
    let said = added.warnings.iter().find(|warning| warning.contains("no peak stands out at 0.65 Hz")).unwrap();
    let peak_hz: f64 = said.split("the nearest peak is at ").nth(1).unwrap().trim_end_matches(" Hz").parse().unwrap();
    assert!(said.contains("so none is added") && (peak_hz / nearest.frequency_hz - 1.0).abs() < 0.02, "{said}");
    // What is picked already is not added a second time.
    let again = identify(&measured, &ModeChoice { add_hz: vec![0.3665], ..ModeChoice::default() }).unwrap();
    let asked: Vec<(usize, f64)> = again.modes.iter().filter_map(|mode| Some((mode.number, mode.asked_hz?))).collect();
    assert_eq!(asked, [(3, 0.3665)]);
    let others = again.modes.iter().map(|mode| Mode { asked_hz: None, ..mode.clone() }).collect::<Vec<_>>();
    assert!(others == automatic.modes, "the values are the same");
    let fixed = ModeChoice { only_hz: Some(truth.frequencies_hz.clone()), ..ModeChoice::default() };
    let fixed = identify(&measured, &fixed).unwrap();
    assert!(fixed.warnings.is_empty(), "{:?}", fixed.warnings);
    assert_eq!(fixed.modes.len(), 12);
    for (fixed, automatic) in fixed.modes.iter().zip(&automatic.modes) {
        let difference = (fixed.frequency_hz - automatic.frequency_hz).abs();
        assert!(difference < automatic.frequency_std_hz, "{} {}", fixed.frequency_hz, automatic.frequency_hz);
    }
}

#[test]
fn a_mode_is_fitted_to_the_band_that_the_user_has_chosen() {
    let (_, setup, spectrum) = brief_tower(2.0);
    let measured = [MeasuredSetup { setup: &setup, spectrum }];
    let automatic = identify(&measured, &ModeChoice::default()).unwrap();
    assert!(automatic.modes.iter().all(|mode| mode.band_hz.is_none()));
    // The one that stands most alone.
    let hz = |at: usize| automatic.modes[at].frequency_hz;
    let room = |at: &usize| (hz(*at) - hz(*at - 1)).min(hz(*at + 1) - hz(*at));
    let at = (1..automatic.modes.len() - 1).max_by(|a, b| room(a).total_cmp(&room(b))).unwrap();
    let own = &automatic.modes[at];
    let lines_of = |mode: &Mode| {
        let lines = &mode.fitted[0].frequency_hz;
        [lines[0], *lines.last().unwrap()]
    };
    let spacing_hz = automatic.frequency_resolution_hz;
    let band = [own.frequency_hz - 2.6 * spacing_hz, own.frequency_hz + 4.4 * spacing_hz];
    let idle = [1.29, 1.4];
    let choice = ModeChoice { bands_hz: vec![band, idle, [0.9, 0.9 + 2.0 * spacing_hz]], ..ModeChoice::default() };
    let mut chosen = identify(&measured, &choice).unwrap();
    note_idle_bands(&mut chosen);
    assert_eq!(chosen.modes.len(), automatic.modes.len());
    let fitted = &chosen.modes[at];
    assert_eq!(fitted.band_hz, Some(band));
    let [from, to] = lines_of(fitted);
    assert!(lines_of(own) != [from, to], "the test's band is that of the data");
    assert!((from - band[0]).abs() <= 0.5 * spacing_hz && (to - band[1]).abs() <= 0.5 * spacing_hz, "{from} {to}");
    // Fewer lines, the same mode.
    assert!((fitted.frequency_hz - own.frequency_hz).abs() < 3.0 * own.frequency_std_hz);
    assert_eq!(chosen.modes.iter().filter(|mode| mode.band_hz.is_some()).count(), 1);
    let says = |words: &str| chosen.warnings.iter().any(|warning| warning.contains(words));
    assert!(says("no mode was found between 1.29 and 1.4 Hz"), "{:?}", chosen.warnings);
    assert!(says("holds 2 spectral lines, and a fit needs 7"), "{:?}", chosen.warnings);
}

/// Beside the other bending mode, which is fitted with it where it has no band.
#[test]
fn one_of_a_close_pair_is_fitted_to_its_band_as_well() {
    let (_, setup, spectrum) = brief_tower(2.0);
    let measured = [MeasuredSetup { setup: &setup, spectrum }];
    let automatic = identify(&measured, &ModeChoice::default()).unwrap();
    let hz = |at: usize| automatic.modes[at].frequency_hz;
    let at =
        (0..automatic.modes.len() - 1).min_by(|a, b| (hz(a + 1) - hz(*a)).total_cmp(&(hz(b + 1) - hz(*b)))).unwrap();
    let own = &automatic.modes[at];
    let spacing_hz = automatic.frequency_resolution_hz;
    let band = [own.frequency_hz - 7.2 * spacing_hz, 0.5 * (hz(at) + hz(at + 1))];
    let chosen = identify(&measured, &ModeChoice { bands_hz: vec![band], ..ModeChoice::default() }).unwrap();
    let banded = |mode: &&Mode| mode.band_hz == Some(band);
    let fitted =
        chosen.modes.iter().filter(banded).min_by(|a, b| {
            (a.frequency_hz - own.frequency_hz).abs().total_cmp(&(b.frequency_hz - own.frequency_hz).abs())
        });
    let fitted = fitted.expect("the mode of the pair");
    let lines = &fitted.fitted[0].frequency_hz;
    assert!(lines.iter().all(|hz| *hz >= band[0] - 0.5 * spacing_hz && *hz <= band[1] + 0.5 * spacing_hz), "{lines:?}");
    let own_lines = &own.fitted[0].frequency_hz;
    assert!(own_lines.iter().any(|hz| *hz > band[1] + 0.5 * spacing_hz), "without the band the fit has others");
}

#[test]
fn the_result_serialises_under_the_names_of_the_design() {
    let (truth, spectrum) = short_tower(None, [0.3, 1.5], 12.5, 6);
    let json = serde_json::to_value(identified(&truth, spectrum).unwrap()).unwrap();
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

/// The density that Welch's method expects of the acceleration of an oscillator under white force (f^4 / ((f0² - f²)² +
/// (2 zeta f0 f)²), its whole density and not its neighbourhood alone), in Hann segments of `duration_s`: by quadrature with the
/// window's kernel sinc(x) / (1 - x²), x in lines.
fn exact_welch_density(frequency_hz: f64, damping_ratio: f64, line_hz: f64, duration_s: f64) -> f64 {
    let density = |f: f64| {
        let (f2, f02) = (f * f, frequency_hz * frequency_hz);
        f2 * f2 / ((f02 - f2).powi(2) + (2.0 * damping_ratio * frequency_hz * f).powi(2))
    };
    let kernel = |x: f64| {
        let sinc = if x == 0.0 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) };
        let beside = 1.0 - x * x;
        if beside.abs() < 1e-9 { 0.25 } else { (sinc / beside).powi(2) }
    };
    // Lines to either side; beyond, the kernel is below 1e-12 of its peak. A step is a small part of the bandwidth.
    let reach = 100.0;
    let step = (0.02 * damping_ratio * frequency_hz * duration_s).min(0.02);
    let count = (reach / step) as i64;
    let (mut sum, mut norm) = (0.0, 0.0);
    for at in -count..=count {
        // Off the kernel's removable poles.
        let x = (at as f64 + 0.137) * step;
        let weight = kernel(x);
        sum += weight * density(line_hz - x / duration_s);
        norm += weight;
    }
    sum / norm
}

/// A spectrum of exactly these matrices, as often as there are averages to pick by: windows are their factors' columns.
fn exact_spectrum(grid: LineGrid, matrices: &[nalgebra::DMatrix<f64>]) -> CrossSpectrum {
    use crate::spectra::{CrossSpectrumAccumulator, WindowLines};
    let channels = matrices[0].nrows();
    let factors: Vec<nalgebra::DMatrix<f64>> =
        matrices.iter().map(|matrix| matrix.clone().cholesky().unwrap().l() * (channels as f64).sqrt()).collect();
    let mut accumulator = CrossSpectrumAccumulator::new(grid, channels).unwrap();
    for window in 0..48 * channels {
        let line = |channel: usize| {
            factors.iter().map(move |l| num_complex::Complex32::new(l[(channel, window % channels)] as f32, 0.0))
        };
        let lines = (0..channels).map(|channel| Some(line(channel).collect())).collect();
        accumulator.add(WindowLines { grid_index: window as u64, channels: lines }).unwrap();
    }
    accumulator.finish().unwrap().0
}

#[test]
fn damping_on_an_exact_spectrum_is_the_truth() {
    // Lines of 1/8, 1/2 and 1.2 half-power bandwidths; the plain spectrum's half-power width at the last shows 1.8 times the
    // damping.
    let truth = Truth::tower();
    for (frequency_hz, damping_ratio, bandwidths_a_line) in
        [(0.366, 0.01, 0.125), (0.366, 0.01, 0.5), (0.366, 0.01, 1.2), (0.795, 0.005, 0.5), (0.795, 0.02, 0.3)]
    {
        let spacing_hz = bandwidths_a_line * 2.0 * damping_ratio * frequency_hz;
        let grid = LineGrid {
            sampling_rate_hz: 1024.0 * spacing_hz,
            segment: 1024,
            first_line: ((0.75 * frequency_hz / spacing_hz) as usize).max(4),
            lines: (0.5 * frequency_hz / spacing_hz) as usize,
        };
        let shape = truth.shapes.column(2).rows(0, 6).into_owned();
        let matrices: Vec<nalgebra::DMatrix<f64>> = (0..grid.lines)
            .map(|line| {
                let density =
                    exact_welch_density(frequency_hz, damping_ratio, grid.frequency_hz(line), 1.0 / spacing_hz);
                let noise = 1e-6 / (2.0 * damping_ratio).powi(2);
                &shape * shape.transpose() * density + nalgebra::DMatrix::identity(6, 6) * noise
            })
            .collect();
        let setup = setup("exact", &points(6), &[]);
        let measured = [MeasuredSetup { setup: &setup, spectrum: exact_spectrum(grid, &matrices) }];
        let only = ModeChoice { only_hz: Some(vec![frequency_hz]), ..ModeChoice::default() };
        let found = identify(&measured, &only).unwrap();
        let mode = &found.modes[0];
        let (f, zeta) = (mode.frequency_hz / frequency_hz - 1.0, mode.damping_ratio / damping_ratio);

        assert!((zeta - 1.0).abs() < 1e-5, "{frequency_hz} Hz, {damping_ratio}, {bandwidths_a_line}: {zeta}");
        assert!(f.abs() < 1e-6, "{f}");
    }
}
