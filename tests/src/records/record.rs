//! The recording: responses line by line, transformed to samples, sensor noise added.

use std::f64::consts::TAU;

use belfry_numerics::inverse_transform;
use nalgebra::{Complex, DVector};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::load::{Forces, Load};
use super::structure::Structure;

/// Extra length, as a share of the record, that is simulated and cut off, because the inverse transform is periodic.
const CUT_OFF: f64 = 0.15;

/// Samples row by row: accelerations in m/s² of about 1 mm/s² on the strongest channel, with white noise of the share `noise` of each
/// channel's root mean square.
pub(super) fn record(
    structure: &Structure,
    load: Load,
    rate_hz: f64,
    seconds: f64,
    noise: f64,
    random: &mut impl Rng,
) -> Vec<f32> {
    let rows = (rate_hz * seconds).round() as usize;
    let length = smooth((rows as f64 * (1.0 + CUT_OFF)) as usize);
    let channels = structure.shapes.nrows();
    let forces = Forces::new(load, structure, random);
    let mut lines = vec![vec![Complex::from(0.0); length / 2 + 1]; channels];
    // Nothing near half the sampling rate: recorders have a filter there.
    let highest = (0.45 * length as f64) as usize;
    for line in 1..highest {
        let frequency_hz = line as f64 * rate_hz / length as f64;
        let drawn = forces.draw(frequency_hz, random);
        let modal = DVector::from_iterator(
            drawn.len(),
            drawn.iter().enumerate().map(|(mode, force)| {
                let (own_hz, zeta) = (structure.frequencies_hz[mode], structure.damping[mode]);
                // Acceleration of an oscillator of unit mass.
                let (w, w0) = (TAU * frequency_hz, TAU * own_hz);
                force * (-w * w) / Complex::new(w0 * w0 - w * w, 2.0 * zeta * w0 * w)
            }),
        );
        for (channel, line_of) in lines.iter_mut().enumerate() {
            let shape = structure.shapes.row(channel);
            line_of[line] = shape.iter().zip(modal.iter()).map(|(shape, response)| *response * *shape).sum();
        }
    }
    let transform = inverse_transform(length);
    let first = (length - rows) / 2;
    let mut columns: Vec<Vec<f64>> = lines
        .iter_mut()
        .map(|lines| {
            let mut samples = vec![0.0; length];
            // Lengths match, and the ends are real: nothing that it refuses.
            let _ = transform.process(lines, &mut samples);
            samples[first..first + rows].to_vec()
        })
        .collect();
    let rms: Vec<f64> = columns
        .iter()
        .map(|column| (column.iter().map(|value| value * value).sum::<f64>() / rows as f64).sqrt())
        .collect();
    let largest = rms.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    for (column, rms) in columns.iter_mut().zip(&rms) {
        for value in column {
            let white: f64 = StandardNormal.sample(random);
            *value = (*value + noise * rms * white) * 1e-3 / largest;
        }
    }
    let mut samples = Vec::with_capacity(rows * channels);
    for row in 0..rows {
        samples.extend(columns.iter().map(|column| column[row] as f32));
    }
    samples
}

/// The next even length with no prime factor above 5.
fn smooth(least: usize) -> usize {
    let is_smooth = |mut length: usize| {
        for factor in [2, 3, 5] {
            while length.is_multiple_of(factor) {
                length /= factor;
            }
        }
        length == 1
    };
    (least.max(2)..).find(|&length| length.is_multiple_of(2) && is_smooth(length)).unwrap_or(least)
}
