//! The simulator against the physics that it states: spectra and decay of the record, its level, and its stationarity.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use belfry_numerics::forward_transform;
use num_complex::Complex64;

use super::*;
use crate::archive::TimeRange;
use crate::model::tests::canton;
use crate::study::alarms::Alarms;
use crate::study::{Analysis, Direction, Sensor, Structure as Named, Study};

fn sensor(channel: &str, elevation_m: f64, azimuth_deg: f64, offset_m: [f64; 2]) -> Sensor {
    Sensor {
        channel: channel.into(),
        point: channel.into(),
        node: 1,
        elevation_m: Some(elevation_m),
        direction: Some(Direction::AzimuthDeg(azimuth_deg)),
        offset_m,
        reference: false,
        unit: None,
        sensitivity_v_per_m_s2: Some(2.0),
        gain: None,
        gain_std: None,
        offset_m_s2: None,
        dof: None,
        model_node: None,
    }
}

fn setup(sensors: Vec<Sensor>, sampling_rate_hz: f64) -> Setup {
    Setup {
        name: "january".into(),
        files: vec!["accdata_*.txt".into()],
        live: false,
        block_s: None,
        utc_offset_h: None,
        variable: None,
        sampling_rate_hz,
        unit: Unit::MetrePerSecondSquared,
        temperature: None,
        sensors,
    }
}

/// A mast of 100 m, modes from 0.16 Hz on, with different stiffness in X and Y.
fn mast() -> BeamTable {
    let mut text = String::from(
        "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2\n",
    );
    for index in 0..10 {
        let (bottom, top) = (10 * index, 10 * (index + 1));
        text.push_str(&format!("{bottom},{top},1e11,2.3e11,0,5e9,2e10,1e5,1e5,1e5,5e5\n"));
    }
    BeamTable::from_reader(text.as_bytes(), Path::new("mast.csv")).unwrap()
}

fn two_levels() -> Setup {
    let sensors = vec![
        sensor("01", 55.0, 0.0, [0.0; 2]),
        sensor("02", 55.0, 90.0, [0.0; 2]),
        sensor("03", 100.0, 0.0, [0.0; 2]),
        sensor("04", 100.0, 90.0, [0.0; 2]),
    ];
    setup(sensors, 20.0)
}

fn of(setup: &Setup, effects: &[&str], options: &Options) -> Simulation {
    let effects: Vec<Effect> = effects.iter().map(|word| word.parse().unwrap()).collect();
    Simulation::of_beam(mast(), &effects, setup, options).unwrap()
}

/// The first `rows` rows, one vector a channel.
fn record(simulation: &mut Simulation, rows: usize) -> Vec<Vec<f64>> {
    let channels = simulation.channels();
    let mut record = vec![Vec::with_capacity(rows); channels];
    while record[0].len() < rows {
        let block = simulation.next_rows(rows - record[0].len()).to_vec();
        for row in block.chunks_exact(channels) {
            row.iter().zip(&mut record).for_each(|(&value, channel)| channel.push(f64::from(value)));
        }
    }
    record
}

fn rms(samples: &[f64]) -> f64 {
    (samples.iter().map(|value| value * value).sum::<f64>() / samples.len() as f64).sqrt()
}

/// Welch's one-sided density with a Hann window at half overlap, and the line spacing.
fn welch(samples: &[f64], sampling_rate_hz: f64, segment: usize) -> (Vec<f64>, f64) {
    let transform = forward_transform(segment);
    let window: Vec<f64> = (0..segment).map(|n| 0.5 - 0.5 * (TAU * n as f64 / segment as f64).cos()).collect();
    let power: f64 = window.iter().map(|w| w * w).sum();
    let mut density = vec![0.0; segment / 2 + 1];
    let mut averages = 0.0;
    for start in (0..samples.len() + 1 - segment).step_by(segment / 2) {
        let mut part: Vec<f64> = samples[start..start + segment].iter().zip(&window).map(|(s, w)| s * w).collect();
        let mut lines = transform.make_output_vec();
        transform.process(&mut part, &mut lines).unwrap();
        for (total, line) in density.iter_mut().zip(&lines) {
            *total += 2.0 * line.norm_sqr() / (power * sampling_rate_hz);
        }
        averages += 1.0;
    }
    density.iter_mut().for_each(|value| *value /= averages);
    (density, sampling_rate_hz / segment as f64)
}

/// Frequency and damping from the free decay that the autocorrelation of one band-passed mode is: the slope of the
/// logarithm of its envelope and of its phase. `band` in Hz.
fn decay(samples: &[f64], sampling_rate_hz: f64, band: [f64; 2], lags_s: [f64; 2]) -> (f64, f64) {
    let size = (2 * samples.len()).next_power_of_two();
    let mut padded = samples.to_vec();
    padded.resize(size, 0.0);
    let mut lines = Complex64::default();
    let transform = forward_transform(size);
    let mut spectrum = transform.make_output_vec();
    transform.process(&mut padded, &mut spectrum).unwrap();
    let spacing = sampling_rate_hz / size as f64;
    let (first, last) = ((band[0] / spacing) as usize, (band[1] / spacing) as usize);
    let mut points = Vec::new();
    let steps = 60;
    for step in 0..steps {
        let lag = lags_s[0] + (lags_s[1] - lags_s[0]) * f64::from(step) / f64::from(steps - 1);
        // The analytic autocorrelation at this lag: the band's positive lines only.
        lines = (first..=last)
            .map(|k| Complex64::from_polar(spectrum[k].norm_sqr(), TAU * k as f64 * spacing * lag))
            .sum::<Complex64>();
        // Unbiased: fewer products at longer lags.
        let length = samples.len() as f64 / sampling_rate_hz;
        points.push((lag, (lines.norm() / (1.0 - lag / length)).ln(), lines.arg()));
    }
    assert!(lines.norm() > 0.0);
    let centre = (band[0] + band[1]) / 2.0;
    let mut turned = 0.0;
    let mut phases = vec![(points[0].0, points[0].2)];
    for pair in points.windows(2) {
        let lag_step = pair[1].0 - pair[0].0;
        let expected = TAU * centre * lag_step;
        let change = pair[1].2 - pair[0].2;
        turned += change + TAU * ((expected - change) / TAU).round();
        phases.push((pair[1].0, points[0].2 + turned));
    }
    let envelope: Vec<_> = points.iter().map(|&(lag, log, _)| (lag, log)).collect();
    let frequency_hz = slope(&phases) / TAU;
    (frequency_hz, -slope(&envelope) / (TAU * frequency_hz))
}

fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let (mean_x, mean_y) =
        (points.iter().map(|p| p.0).sum::<f64>() / count, points.iter().map(|p| p.1).sum::<f64>() / count);
    let above: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    above / points.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>()
}

#[test]
fn the_record_decays_as_the_truth_says() {
    let options = Options { seed: 11, damping_ratio: 0.01, ..Options::default() };
    let mut simulation = of(&two_levels(), &[], &options);
    let truth = simulation.truth().modes[0].clone();
    let hours = 6.0;
    let samples = record(&mut simulation, (hours * 3600.0 * 20.0) as usize);
    let channel = truth.shape.iter().position(|&value| value == 1.0).unwrap();
    let band = [truth.frequency_hz * 0.8, truth.frequency_hz * 1.2];
    // Lags from where the band's edges no longer matter to where the decay is e^-1.5.
    let lags = [2.0, 1.5 / (TAU * truth.frequency_hz * truth.damping_ratio)];
    let (frequency_hz, damping_ratio) = decay(&samples[channel], 20.0, band, lags);
    // Au's law for the best possible with N cycles: std f/f = sqrt(zeta/(2 pi N)), std zeta/zeta = 1/sqrt(2 pi zeta N).
    // A plain decay fit scatters up to twice that; four such standard deviations.
    let cycles = hours * 3600.0 * truth.frequency_hz;
    let frequency_std = truth.frequency_hz * (truth.damping_ratio / (TAU * cycles)).sqrt();
    let damping_std = truth.damping_ratio / (TAU * truth.damping_ratio * cycles).sqrt();
    assert!((frequency_hz - truth.frequency_hz).abs() < 8.0 * frequency_std, "{frequency_hz} {truth:?}");
    assert!((damping_ratio - truth.damping_ratio).abs() < 8.0 * damping_std, "{damping_ratio} {truth:?}");
}

#[test]
fn welch_peaks_stand_at_the_true_frequencies_and_move_as_the_eigenproblem_says() {
    let peak = |effects: &[&str]| {
        let mut simulation = of(&two_levels(), effects, &Options { seed: 5, ..Options::default() });
        let truth = simulation.truth().clone();
        let samples = record(&mut simulation, 20 * 3600 * 4);
        let (density, spacing) = welch(&samples[2], 20.0, 4096);
        let near = |frequency_hz: f64| {
            let lines = ((frequency_hz * 0.85 / spacing) as usize)..((frequency_hz * 1.15 / spacing) as usize);
            lines.max_by(|&a, &b| density[a].total_cmp(&density[b])).unwrap() as f64 * spacing
        };
        let along_x = truth.modes.iter().filter(|mode| mode.shape[2].abs() > 0.5).take(2);
        along_x.map(|mode| (mode.frequency_hz, near(mode.frequency_hz), spacing)).collect::<Vec<_>>()
    };
    let (sound, soft) = (peak(&[]), peak(&["base-rotation=4e-10"]));
    for (frequency_hz, peak_hz, spacing) in sound.iter().chain(&soft) {
        // A line, and half the half-power bandwidth (the averaged bell is flat and noisy inside it).
        let tolerance = spacing + 0.008 * frequency_hz;
        assert!((frequency_hz - peak_hz).abs() < tolerance, "{frequency_hz} Hz, peak at {peak_hz} Hz");
    }
    let moved = sound[0].0 - soft[0].0;
    assert!(
        moved > 5.0 * (sound[0].2 + 0.016 * sound[0].0),
        "the effect must move the peak by more than the tolerance"
    );
}

/// Mean squares over many seeds, at the first rows and much later.
#[test]
fn the_response_is_stationary_from_the_first_row_at_the_stated_level() {
    let (rows, seeds) = (8, 1500);
    let (mut early, mut late) = (vec![0.0; 4], vec![0.0; 4]);
    let mut stated = Vec::new();
    let mut sound = of(&two_levels(), &[], &Options { noise_percent: 0.0, ..Options::default() });
    for seed in 0..seeds {
        // Only the draws differ between seeds; the structure is solved once.
        sound.load_random = ChaCha8Rng::seed_from_u64(seed);
        let kept = sound.truth.modes.len();
        let normals = DVector::from_fn(2 * kept, |_, _| StandardNormal.sample(&mut sound.load_random));
        let forces = &sound.modal_loads * sound.modal_loads.transpose();
        let covariance = sound.bank.stationary_covariance(&forces);
        sound.bank.start_from(&covariance, &normals);
        sound.used_rows = BLOCK_ROWS;
        let samples = record(&mut sound, BLOCK_ROWS);
        for channel in 0..4 {
            early[channel] += rms(&samples[channel][..rows]).powi(2) / seeds as f64;
            late[channel] += rms(&samples[channel][BLOCK_ROWS - rows..]).powi(2) / seeds as f64;
        }
        stated = sound.channel_rms().to_vec();
    }
    for channel in 0..4 {
        // Variances of 1500 independent starts, at least one independent value each: sqrt(2/1500) = 3.7 %, three times.
        for found in [early[channel], late[channel]] {
            let ratio = found / stated[channel].powi(2);
            assert!((ratio - 1.0).abs() < 0.11, "channel {channel}: variance {ratio} of the stated");
        }
    }
}

#[test]
fn noise_is_white_and_as_strong_as_asked() {
    let quiet = Options { seed: 3, noise_percent: 0.0, ..Options::default() };
    let noisy = Options { noise_percent: 5.0, ..quiet.clone() };
    let (mut without, mut with) = (of(&two_levels(), &[], &quiet), of(&two_levels(), &[], &noisy));
    let (clean, dirty) = (record(&mut without, 40_000), record(&mut with, 40_000));
    for channel in 0..4 {
        // The load is the same stream, so the difference is the noise.
        let noise: Vec<f64> = clean[channel].iter().zip(&dirty[channel]).map(|(a, b)| b - a).collect();
        let expected = 0.05 * with.channel_rms()[channel];
        // std of an RMS of 40 000 samples: 0.35 %; four times.
        assert!((rms(&noise) / expected - 1.0).abs() < 0.015);
        let neighbours: f64 = noise.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 40_000.0;
        assert!(
            (neighbours / expected.powi(2)).abs() < 4.0 / 200.0,
            "white: neighbours correlate by 1/sqrt(40 000) at most"
        );
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_however_they_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let options = Options { seed: 42, ..Options::default() };
    let files = ["a.npy", "b.npy"].map(|name| folder.path().join(name));
    let mut heard = 0;
    for file in &files {
        of(&two_levels(), &[], &options).write(file, 1000, |rows| heard += rows).unwrap();
    }
    assert_eq!(heard, 2000);
    let bytes = files.each_ref().map(|file| std::fs::read(file).unwrap());
    assert_eq!(bytes[0], bytes[1]);
    let npy = npyz::NpyFile::new(&bytes[0][..]).unwrap();
    assert_eq!((npy.shape(), npy.order()), (&[1000, 4][..], npyz::Order::C));
    let written: Vec<f32> = npy.into_vec().unwrap();

    let mut by_sevens = of(&two_levels(), &[], &options);
    let mut rows = Vec::new();
    while rows.len() < written.len() {
        rows.extend_from_slice(by_sevens.next_rows(7));
    }
    assert_eq!(rows[..written.len()], written);
    for other in [Options { seed: 43, ..options.clone() }, Options { stream: 1, ..options.clone() }] {
        assert_ne!(of(&two_levels(), &[], &other).next_rows(1), &written[..4]);
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "no partial files stay behind: {left:?}");
}

#[test]
fn other_units_are_the_same_motion() {
    let options = Options { seed: 9, noise_percent: 0.0, ..Options::default() };
    let of_unit = |unit| record(&mut of(&Setup { unit, ..two_levels() }, &[], &options), 4000);
    let (metres, gravities, volts) =
        (of_unit(Unit::MetrePerSecondSquared), of_unit(Unit::StandardGravity), of_unit(Unit::Volt));
    // f32 rounding: 6e-8, with a margin.
    for row in 0..4000 {
        let scale = metres[2][row].abs() + 1e-12;
        assert!((gravities[2][row] * 9.80665 - metres[2][row]).abs() < 1e-6 * scale);
        assert!((volts[2][row] / 2.0 - metres[2][row]).abs() < 1e-6 * scale);
    }
    // Of a mode under white noise of density G, var(v) = pi f G/(4 zeta w²) and var(a) = w² var(v) + G fs/2, the mass
    // line up to the Nyquist rate. Sampling makes (w dt)²/12 of difference, 2e-4, and friction 4 zeta², 3e-4.
    let of = |unit| of(&Setup { unit, ..two_levels() }, &[], &options).truth().modes[0].clone();
    let (acceleration, velocity) = (of(Unit::MetrePerSecondSquared), of(Unit::MetrePerSecond));
    let (frequency_hz, zeta) = (acceleration.frequency_hz, acceleration.damping_ratio);
    let ratio = acceleration.rms[2] / velocity.rms[2];
    let expected = TAU * frequency_hz * (1.0 + 2.0 * zeta * 20.0 / (PI * frequency_hz)).sqrt();
    assert!((ratio / expected - 1.0).abs() < 1e-3, "{ratio} {expected}");
}

/// A single oscillator under white noise of one-sided density G: var(a) = pi f G/(4 zeta), in the limit of fast sampling
/// (Crandall and Mark 1963), and the sampled feedthrough G fs/2 besides.
#[test]
fn an_oscillator_has_the_textbook_variance() {
    let (frequency_hz, damping_ratio, sampling_rate_hz, density) = (0.5, 0.01, 200.0, 3.0);
    let bank = OscillatorBank::new(&[frequency_hz], damping_ratio, sampling_rate_hz, Quantity::Acceleration);
    let force = DMatrix::from_element(1, 1, density * sampling_rate_hz / 2.0);
    let state = bank.stationary_covariance(&force);
    let output = bank.output_covariance(&state, &force)[(0, 0)] - force[(0, 0)];
    let expected = PI * frequency_hz * density / (4.0 * damping_ratio);
    // Sampling: (w dt)²-ish, 1e-3, and the friction's share of the acceleration, 4 zeta² = 4e-4.
    assert!((output / expected - 1.0).abs() < 3e-3, "{output} {expected}");
}

#[test]
fn options_and_setups_that_cannot_be_are_refused() {
    let refusal =
        |setup: &Setup, options: Options| Simulation::of_beam(mast(), &[], setup, &options).err().unwrap().to_string();
    let good = Options::default;
    let damped = refusal(&two_levels(), Options { damping_ratio: 0.0, ..good() });
    assert_eq!(damped, "damping ratio = 0 is out of range; it must be 0.0001 to 0.5");
    assert!(refusal(&two_levels(), Options { noise_percent: f64::NAN, ..good() }).starts_with("noise = NaN"));
    assert!(refusal(&setup(vec![], 20.0), good()).contains("no sensors"));
    assert!(refusal(&Setup { sampling_rate_hz: 0.2, ..two_levels() }, good()).contains("sample faster"));
    let above = setup(vec![sensor("09", 130.0, 0.0, [0.0; 2])], 20.0);
    assert!(refusal(&above, good()).starts_with("setup january: channel 09: elevation_m = 130"));
    let mut volts = Setup { unit: Unit::Volt, ..two_levels() };
    volts.sensors[1].sensitivity_v_per_m_s2 = None;
    assert!(refusal(&volts, good()).contains("channel 02"));
}

#[test]
fn setups_join_into_one_truth() {
    let whole = two_levels();
    let (lower, upper) = (setup(whole.sensors[..2].to_vec(), 20.0), setup(whole.sensors[2..].to_vec(), 20.0));
    let truth = |setup: &Setup| of(setup, &[], &Options::default()).truth().clone();
    let joined = Truth::joined([&truth(&lower), &truth(&upper)]).unwrap();
    let at_once = truth(&whole);
    assert_eq!(joined.modes.len(), at_once.modes.len());
    for (one, other) in joined.modes.iter().zip(&at_once.modes) {
        assert!(one.shape.iter().zip(&other.shape).all(|(a, b)| (a - b).abs() < 1e-9), "{one:?} {other:?}");
    }
    let json = serde_json::to_string(&joined).unwrap();
    let back: Truth = serde_json::from_str(&json).unwrap();
    assert_eq!(back.channels, joined.channels);
}

fn study(folder: &Path, setups: Vec<Setup>) -> Study {
    Study {
        folder: folder.to_owned(),
        structure: Named { name: "mast".into(), place_deg: None },
        setups,
        analysis: Analysis { band_hz: None, decimated_rate_hz: None, segment: None, ..Analysis::default() },
        model: None,
        alarms: Alarms::default(),
        range: TimeRange::ALL,
        measured: None,
    }
}

#[test]
fn recordings_go_where_the_study_reads_them_or_are_adopted() {
    let folder = tempfile::tempdir().unwrap();
    let named = Setup { name: "b/2".into(), files: vec!["own.npy".into()], ..two_levels() };
    let study = study(folder.path(), vec![two_levels(), named]);
    let planned = plan(&study, None).unwrap();
    assert_eq!(planned[0].path, folder.path().join("simulated-january.npy"));
    assert_eq!(planned[0].adopt_as.as_deref(), Some("simulated-january.npy"));
    assert_eq!((&planned[1].path, &planned[1].adopt_as), (&folder.path().join("own.npy"), &None));
    let inside = plan(&study, Some(&folder.path().join("sub"))).unwrap();
    assert_eq!(inside[1].adopt_as.as_deref(), Some("sub/own.npy"));

    let text = "# mine\n[[setup]]\nname = \"january\"   # cold\nfiles = [\"a_*.txt\"] # raw\nsampling_rate_hz = 20.0\n\n[[setup]]\nname = \"b/2\"\nfiles = [\"own.npy\"]\n";
    std::fs::write(folder.path().join("study.toml"), text).unwrap();
    adopt(folder.path(), &planned).unwrap();
    let adopted = std::fs::read_to_string(folder.path().join("study.toml")).unwrap();
    assert_eq!(adopted, text.replace("a_*.txt", "simulated-january.npy"), "comments and order stay");
    std::fs::write(folder.path().join("study.toml"), text.replace('\n', "\r\n")).unwrap();
    adopt(folder.path(), &planned).unwrap();
    let again = std::fs::read_to_string(folder.path().join("study.toml")).unwrap();
    assert_eq!(again, adopted.replace('\n', "\r\n"), "line ends stay");

    let twice = plan(&super::tests::study(folder.path(), vec![two_levels(), two_levels()]), None);
    assert!(matches!(twice, Err(PlanError::SameFile { .. })));
    assert_eq!(plan(&super::tests::study(folder.path(), vec![]), None), Err(PlanError::NoSetups));
}

/// The benchmark's twenty channels, 18 degrees and 108 degrees from X.
fn canton_setup() -> (BeamTable, Setup) {
    let mut rows = csv::Reader::from_path(canton("channels.csv")).unwrap();
    let sensors = rows.records().map(|row| {
        let row = row.unwrap();
        let number = |column: usize| row[column].parse::<f64>().unwrap();
        sensor(&row[0], number(2), number(4), [number(5), number(6)])
    });
    (BeamTable::read(&canton("beam_field.csv")).unwrap(), setup(sensors.collect(), 50.0))
}

#[test]
fn the_top_of_the_canton_tower_moves_as_documented() {
    let (beam, setup) = canton_setup();
    let effects: Vec<Effect> = vec!["base-rotation=7.21e-15".parse().unwrap()];
    let mut simulation = Simulation::of_beam(beam, &effects, &setup, &Options::default()).unwrap();
    assert_eq!(setup.sensors.last().unwrap().elevation_m, Some(446.8));
    let stated = simulation.channel_rms().to_vec();
    let samples = record(&mut simulation, 50 * 600);
    for channel in 16..20 {
        assert!((2.4e-4..3.6e-4).contains(&stated[channel]), "about 3e-4 m/s²: {}", stated[channel]);
        // Ten minutes of a broad-band response: its variance is known to a few per cent.
        assert!((rms(&samples[channel]) / stated[channel] - 1.0).abs() < 0.06);
    }
}
