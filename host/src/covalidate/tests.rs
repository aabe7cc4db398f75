//! Overlap-adding gives the samples back, predictions depend on the span of the shapes alone, errors are what they say.

use nalgebra::DMatrix;
use num_complex::Complex32;
use proptest::prelude::*;

use super::*;
use crate::spectra::direct::Welch;
use crate::spectra::{LineGrid, WindowLines};

const GRID: LineGrid = LineGrid { sampling_rate_hz: 10.0, segment: 256, first_line: 4, lines: 90 };

/// Tones inside the band, one a channel and one of both.
fn motion(time_s: f64, channel: usize) -> f64 {
    let tone = |hz: f64| (std::f64::consts::TAU * hz * time_s).sin();
    [1.0, -0.5][channel] * tone(0.7) + [0.2, 0.9][channel] * tone(2.13)
}

fn hops(windows: &[WindowLines]) -> Vec<(f64, Vec<Option<Vec<f64>>>)> {
    let mut overlap = OverlapAdd::new(GRID, 0.0, 2);
    windows.iter().filter_map(|window| overlap.push(window).map(|hop| (hop.start_s, hop.channels.to_vec()))).collect()
}

fn windows(seconds: f64) -> Vec<WindowLines> {
    let mut welch = Welch::new(GRID, 1, 2).unwrap();
    let mut windows = Vec::new();
    for sample in 0..(seconds * GRID.sampling_rate_hz) as usize {
        let time_s = sample as f64 / GRID.sampling_rate_hz;
        welch.push(&[motion(time_s, 0), motion(time_s, 1)], &mut |window| windows.push(window));
    }
    windows
}

#[test]
fn windows_overlap_and_add_to_the_samples_they_were_made_of() {
    let hops = hops(&windows(200.0));
    assert!(hops.len() > 10);
    for (start_s, channels) in hops {
        for (channel, samples) in channels.iter().enumerate() {
            for (index, sample) in samples.as_ref().unwrap().iter().enumerate() {
                let expected = motion(start_s + index as f64 / GRID.sampling_rate_hz, channel);
                // Each window's trend is removed and the band cuts the tails of the window's side lobes.
                assert!((sample - expected).abs() < 0.01, "{start_s} s + {index}: {sample} {expected}");
            }
        }
    }
}

#[test]
fn a_window_that_is_missing_or_not_sound_silences_the_halves_it_belongs_to() {
    let mut all = windows(200.0);
    all[3].channels[1] = None;
    all.remove(7);
    let hops = hops(&all);
    // Windows 0..; the half of windows i-1 and i starts at i hops. Window 7 is gone: no halves at 7 and 8.
    let starts: Vec<u64> = hops.iter().map(|(start_s, _)| (start_s * 10.0 / 128.0).round() as u64).collect();
    assert!(!starts.contains(&7) && !starts.contains(&8) && starts.contains(&6) && starts.contains(&9));
    for ((_, channels), start) in hops.iter().zip(&starts) {
        assert!(channels[0].is_some());
        assert_eq!(channels[1].is_none(), [3, 4].contains(start), "half {start}");
    }
}

#[test]
fn the_error_is_that_of_the_samples_themselves() {
    let mut overlap = OverlapAdd::new(GRID, 0.0, 2);
    let mut witness = Witness::new(2);
    let mut samples: Vec<[f64; 2]> = Vec::new();
    for window in windows(120.0) {
        let Some(hop) = overlap.push(&window) else { continue };
        witness.add(&hop);
        let [one, two] = [0, 1].map(|channel: usize| hop.channels[channel].clone().unwrap());
        samples.extend(one.into_iter().zip(two).map(|(one, two)| [one, two]));
    }
    let predictor = Predictor { weights: DMatrix::from_element(1, 1, -0.4) };
    let motion = witness.motion(&[0, 1]);
    let found = motion.error_percent(&predictor, &[0], &[1])[0].unwrap();
    let norm = |value: fn(&[f64; 2]) -> f64| samples.iter().map(|sample| value(sample).powi(2)).sum::<f64>().sqrt();
    let expected = 100.0 * norm(|[kept, left_out]| -0.4 * kept - left_out) / norm(|[_, left_out]| *left_out);
    assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    assert!((motion.rms_predicted(&predictor, &[0])[0] / (0.4 * motion.rms(0)) - 1.0).abs() < 1e-12);
    assert!((motion.rms(0) - norm(|[kept, _]| *kept) / (samples.len() as f64).sqrt()).abs() < 1e-12);
    assert_eq!(motion.samples(), samples.len() as u64);
}

#[test]
fn a_channel_that_drops_out_takes_no_other_channels_motion_along() {
    let mut all = windows(200.0);
    for window in all.iter_mut().skip(4) {
        window.channels[1] = None;
    }
    let (mut overlap, mut witness) = (OverlapAdd::new(GRID, 0.0, 2), Witness::new(2));
    for window in &all {
        if let Some(hop) = overlap.push(window) {
            witness.add(&hop);
        }
    }
    assert_eq!(witness.hops(), all.len() as u64 - 1);
    assert_eq!((witness.sound_hops(&[0]), witness.sound_hops(&[0, 1])), (witness.hops(), 3));
    assert_eq!(witness.motion(&[0]).samples(), witness.hops() * 128);
    assert_eq!(witness.motion(&[0, 1]).samples(), 3 * 128);
    assert!((witness.motion(&[0]).rms(0) - (0.5 * 1.04_f64).sqrt()).abs() < 0.02);
}

#[test]
fn shapes_that_the_kept_sensors_cannot_tell_apart_are_refused() {
    let kept = DMatrix::from_row_slice(3, 2, &[1.0, 2.0, 0.5, 1.0, -1.0, -2.0]);
    let left_out = DMatrix::from_row_slice(1, 2, &[1.0, -1.0]);
    let refused = Predictor::new(&kept, &left_out).unwrap_err();
    assert_eq!(refused, PredictError::RankDeficient { modes: 2, sensors: 3, rank: 1 });
    assert!(refused.to_string().contains("rank 1 only: 1 of their combinations"));
    let refused = Predictor::new(&DMatrix::zeros(2, 3), &DMatrix::zeros(1, 3)).unwrap_err();
    assert_eq!(refused, PredictError::TooManyModes { modes: 3, sensors: 2 });
    // Zero shapes have no rank either.
    assert!(Predictor::new(&DMatrix::zeros(3, 1), &DMatrix::zeros(1, 1)).is_err());
}

#[test]
fn true_shapes_predict_without_error() {
    let shapes = DMatrix::from_fn(6, 3, |sensor, mode| ((sensor + 1) as f64 * (mode as f64 + 0.7)).sin());
    let predictor = Predictor::new(&shapes.rows(0, 4).into_owned(), &shapes.rows(4, 2).into_owned()).unwrap();
    let coordinates = nalgebra::DVector::from_column_slice(&[0.3, -2.0, 1.1]);
    let all = &shapes * coordinates;
    assert!((predictor.weights * all.rows(0, 4) - all.rows(4, 2)).amax() < 1e-12);
}

proptest! {
    /// Whatever Psi is, the updated shapes are Phi1 V with V orthogonal: the prediction, and with it E_d, stays the same.
    #[test]
    fn no_psi_update_changes_a_prediction(
        shapes in proptest::collection::vec(-1.0..1.0f64, 8 * 4),
        psi in proptest::collection::vec(-1.0..1.0f64, 4 * 4),
    ) {
        let shapes = DMatrix::from_column_slice(8, 4, &shapes);
        let kept = shapes.rows(0, 6).into_owned();
        prop_assume!(kept.singular_values().min() > 0.05);
        // V are the eigenvectors of Lambda1 + Psi, for an arbitrary symmetric Psi.
        let psi = DMatrix::from_column_slice(4, 4, &psi);
        let lambda = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[1.0, 2.0, 3.0, 4.0]));
        let rotation = (lambda + &psi + psi.transpose()).symmetric_eigen().eigenvectors;
        let updated = &shapes * rotation;
        let before = Predictor::new(&kept, &shapes.rows(6, 2).into_owned()).unwrap();
        let after = Predictor::new(&updated.rows(0, 6).into_owned(), &updated.rows(6, 2).into_owned()).unwrap();
        prop_assert!((before.weights - after.weights).amax() < 1e-9);
    }

    /// Lines of any value make no panic.
    #[test]
    fn any_lines_are_added(values in proptest::collection::vec(proptest::num::f32::ANY, 180), indices in proptest::collection::vec(0u64..5, 6)) {
        let lines: Vec<Complex32> = values.chunks(2).map(|pair| Complex32::new(pair[0], pair[1])).collect();
        let mut overlap = OverlapAdd::new(GRID, 0.0, 1);
        let mut witness = Witness::new(1);
        for grid_index in indices {
            let window = WindowLines { grid_index, channels: vec![Some(lines.clone())] };
            if let Some(hop) = overlap.push(&window) {
                witness.add(&hop);
            }
        }
    }
}
