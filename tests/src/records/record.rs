//! The recording: responses line by line, transformed to samples, sensor noise added.

use std::f64::consts::TAU;

use belfry_numerics::{forward_transform, inverse_transform};
use nalgebra::{Complex, DVector};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Exp1, StandardNormal};

use super::load::{Forces, Load};
use super::structure::Structure;
use crate::spectral::{columns_of, simulated_length};

/// Forces that come in bursts: how long one lasts, the mean time from one to the next, and what the force has between them.
const BURST_S: f64 = 15.0;
const PAUSE_S: f64 = 60.0;
const BETWEEN: f64 = 0.1;

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
    let length = simulated_length(rows);
    let channels = structure.shapes.nrows();
    let forces = Forces::new(load, structure, random);
    let mut lines = vec![vec![Complex::from(0.0); length / 2 + 1]; channels];
    // Nothing near half the sampling rate: recorders have a filter there.
    let highest = (0.45 * length as f64) as usize;
    let at_hz = |line: usize| line as f64 * rate_hz / length as f64;
    let mut drawn: Vec<DVector<Complex<f64>>> = (1..highest).map(|line| forces.draw(at_hz(line), random)).collect();
    if load.comes_in_bursts() {
        come_in_bursts(&mut drawn, length, rate_hz, random);
    }
    for (line, drawn) in (1..highest).zip(drawn) {
        let modal = DVector::from_iterator(
            drawn.len(),
            drawn.iter().enumerate().map(|(mode, force)| {
                let (own_hz, zeta) = (structure.frequencies_hz[mode], structure.damping[mode]);
                // Acceleration of an oscillator of unit mass.
                let (w, w0) = (TAU * at_hz(line), TAU * own_hz);
                force * (-w * w) / Complex::new(w0 * w0 - w * w, 2.0 * zeta * w0 * w)
            }),
        );
        for (channel, line_of) in lines.iter_mut().enumerate() {
            let shape = structure.shapes.row(channel);
            line_of[line] = shape.iter().zip(modal.iter()).map(|(shape, response)| *response * *shape).sum();
        }
    }
    let mut columns = columns_of(&mut lines, length, rows);
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

/// Makes steady forces, line by line from line 1 on, come in bursts: in time each is multiplied by one envelope that is small
/// but for some seconds now and then, as where vehicles pass.
fn come_in_bursts(drawn: &mut [DVector<Complex<f64>>], length: usize, rate_hz: f64, random: &mut impl Rng) {
    let (mut envelope, mut at) = (vec![BETWEEN; length], 0.0);
    while at < length as f64 {
        let size = random.random_range(0.3..3.0);
        let lasts = (BURST_S * rate_hz) as usize;
        for (step, value) in envelope.iter_mut().skip(at as usize).take(lasts).enumerate() {
            *value += size * (std::f64::consts::PI * step as f64 / lasts as f64).sin();
        }
        let pause: f64 = Exp1.sample(random);
        at += pause * PAUSE_S * rate_hz;
    }
    let (inverse, forward) = (inverse_transform(length), forward_transform(length));
    for mode in 0..drawn.first().map_or(0, DVector::len) {
        let mut lines = vec![Complex::from(0.0); length / 2 + 1];
        lines[1..].iter_mut().zip(&*drawn).for_each(|(line, forces)| *line = forces[mode]);
        let mut samples = vec![0.0; length];
        inverse.process(&mut lines, &mut samples).expect("lengths match, and the ends are real");
        samples.iter_mut().zip(&envelope).for_each(|(sample, share)| *sample *= share / length as f64);
        forward.process(&mut samples, &mut lines).expect("lengths match");
        drawn.iter_mut().zip(&lines[1..]).for_each(|(forces, line)| forces[mode] = *line);
    }
}
