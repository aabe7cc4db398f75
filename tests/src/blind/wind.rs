//! Recordings under wind, line by line: forces along X and Y and moments about Z at the top of every segment, coloured as in Davenport
//! (1961), coherent over the height. A case flows in, accelerations at the sensors flow out, each channel at its own clock.

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};
use rand::{Rng, RngExt};

use super::banded::Modes;
use super::body::{Body, DOFS};
use super::cases::Case;
use super::damped::DampedMode;
use crate::spectral::{columns_of, gust_above, gust_coherence, gust_density, normal, simulated_length};

/// Bounds of a mean speed in m/s.
const SPEED_M_S: [f64; 2] = [8.0, 20.0];
/// Forces grow with the height to this power, as speed squared does over open country.
const GROWTH: f64 = 0.3;
/// Moments over forces, in units of the radius of gyration.
const TURNING: f64 = 0.3;
/// RMS of the strongest channel in m/s².
const LEVEL: f64 = 1e-3;
/// Nothing near half the sampling rate: recorders have a filter there.
const HIGHEST: f64 = 0.45;

/// Wind on a body.
struct Wind {
    speed_m_s: f64,
    /// From one height to the next.
    apart_m: Vec<f64>,
    /// Forces on the modes by a gust at each height, along X, along Y and about Z: modes x heights.
    directions: [DMatrix<f64>; 3],
}

impl Wind {
    fn on(body: &Body, modes: &Modes, random: &mut impl Rng) -> Self {
        // The top of each segment: wind changes little over one.
        let is_top = |node: &usize| {
            body.elements.get(*node).is_none_or(|above| above.segment != body.elements[node - 1].segment)
        };
        let tops: Vec<usize> = (1..body.nodes.len()).filter(is_top).collect();
        let z_m = |at: usize| body.nodes[tops[at]].z_m - body.base_m();
        let below_m = |at: usize| if at == 0 { z_m(0) } else { z_m(at) - z_m(at - 1) };
        let top_m = z_m(tops.len() - 1);
        let gyration_m =
            (body.nodes[tops[0]].inertia_kg_m2[2] / body.nodes[tops[0]].mass_kg.max(f64::MIN_POSITIVE)).sqrt();
        // The wind blows along one direction, and shakes less across.
        let (along_x, along_y) = (random.random_range(0.5..1.0), random.random_range(0.5..1.0));
        let direction = |(dof, share): (usize, f64)| {
            let force = |at: usize| share * below_m(at) * (z_m(at) / top_m).powf(GROWTH);
            let modal = |mode: usize, at: usize| modes.shapes[(tops[at] * DOFS + dof, mode)] * force(at);
            DMatrix::from_fn(modes.shapes.ncols(), tops.len(), modal)
        };
        Self {
            speed_m_s: random.random_range(SPEED_M_S[0]..SPEED_M_S[1]),
            apart_m: (1..tops.len()).map(below_m).collect(),
            directions: [(0, along_x), (1, along_y), (4, TURNING * gyration_m)].map(direction),
        }
    }

    /// Forces on the modes in a line of unit bandwidth.
    fn draw(&self, frequency_hz: f64, random: &mut impl Rng) -> DVector<Complex<f64>> {
        let amplitude = gust_density(frequency_hz, self.speed_m_s).sqrt();
        let mut sum: DVector<Complex<f64>> = DVector::zeros(self.directions[0].nrows());
        for modal in &self.directions {
            let mut gust = normal(random);
            for (at, modal) in modal.column_iter().enumerate() {
                if let Some(below) = at.checked_sub(1) {
                    let coherence = gust_coherence(frequency_hz, self.apart_m[below], self.speed_m_s);
                    gust = gust_above(gust, coherence, random);
                }
                sum.iter_mut().zip(modal.iter()).for_each(|(sum, share)| *sum += gust * (*share * amplitude));
            }
        }
        sum
    }
}

/// Accelerations in m/s² under wind, row by row, without the sensors' noise.
pub(super) fn samples(case: &Case, modes: &Modes, damped: &[DampedMode], random: &mut impl Rng) -> Vec<f32> {
    let rate_hz = case.structure.sampling_rate_hz;
    let rows = (case.hours * 3600.0 * rate_hz).round() as usize;
    let length = simulated_length(rows);
    let delays_s: Vec<f64> = case.body.sensors.iter().map(|sensor| sensor.delay_s).collect();
    let wind = Wind::on(&case.body, modes, random);
    let mut lines = vec![vec![Complex::from(0.0); length / 2 + 1]; delays_s.len()];
    for line in 1..(HIGHEST * length as f64) as usize {
        let frequency_hz = line as f64 * rate_hz / length as f64;
        let turn = Complex::new(0.0, TAU * frequency_hz);
        let forces = wind.draw(frequency_hz, random);
        // x = sum of shape s and its twin of the conjugate pole; an acceleration is -w² times that.
        let states: Vec<[Complex<f64>; 2]> = damped
            .iter()
            .map(|mode| {
                let pairs = || mode.input.iter().zip(forces.iter());
                let driven: Complex<f64> = pairs().map(|(input, force)| input * force).sum();
                let twin: Complex<f64> = pairs().map(|(input, force)| input.conj() * force).sum();
                [driven / (turn - mode.pole), twin / (turn - mode.pole.conj())].map(|state| state * (turn * turn))
            })
            .collect();
        for (channel, lines) in lines.iter_mut().enumerate() {
            let of = |(mode, [state, twin]): (&DampedMode, &[Complex<f64>; 2])| {
                mode.shape[channel] * state + mode.shape[channel].conj() * twin
            };
            let motion: Complex<f64> = damped.iter().zip(&states).map(of).sum();
            lines[line] = motion * (-turn * delays_s[channel]).exp();
        }
    }
    let columns = columns_of(&mut lines, length, rows);
    let rms = |column: &Vec<f64>| (column.iter().map(|value| value * value).sum::<f64>() / rows as f64).sqrt();
    let scale = LEVEL / columns.iter().map(rms).fold(f64::MIN_POSITIVE, f64::max);
    (0..rows).flat_map(|row| columns.iter().map(move |column| (scale * column[row]) as f32)).collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Wind along one direction on three heights, each of which is a mode.
    fn wind() -> Wind {
        let (along, none) = (DMatrix::from_diagonal_element(3, 3, 1.0), DMatrix::zeros(3, 3));
        Wind { speed_m_s: 10.0, apart_m: vec![20.0, 60.0], directions: [along, none.clone(), none] }
    }

    #[test]
    fn forces_have_davenports_colour_and_coherence() {
        let (wind, mut random) = (wind(), ChaCha8Rng::seed_from_u64(3));
        let draws = 20_000;
        let mut measured = |frequency_hz: f64| {
            let (mut power, mut cross) = (0.0, [0.0; 2]);
            for _ in 0..draws {
                let forces = wind.draw(frequency_hz, &mut random);
                power += forces[2].norm_sqr() / f64::from(draws);
                cross[0] += (forces[0].conj() * forces[1]).re / f64::from(draws);
                cross[1] += (forces[0].conj() * forces[2]).re / f64::from(draws);
            }
            (power, cross.map(|cross| cross / power))
        };
        let ((_, coherence), (low, _), (high, _)) = (measured(0.02), measured(0.2), measured(2.0));
        // Far above the spectrum's corner it falls with f^(-5/3).
        assert!((high / low / 10.0_f64.powf(-5.0 / 3.0) - 1.0).abs() < 0.1, "{}", high / low);
        // exp(-10 0.02 20 / 10) and exp(-10 0.02 80 / 10), to four standard errors.
        for (found, expected) in coherence.into_iter().zip([(-0.4_f64).exp(), (-1.6_f64).exp()]) {
            assert!((found - expected).abs() < 0.03, "{found}, not {expected}");
        }
    }
}
