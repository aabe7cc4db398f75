//! Spectral lines of wind, and from lines to samples.

use std::f64::consts::FRAC_1_SQRT_2;

use belfry_numerics::inverse_transform;
use nalgebra::Complex;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Davenport's decay of coherence along the height, and the length of his spectrum in m.
const DECAY: f64 = 10.0;
const LENGTH_M: f64 = 1200.0;

/// Extra length, as a share of the record, that is simulated and cut off, because the inverse transform is periodic.
const CUT_OFF: f64 = 0.15;

/// A complex normal number whose square is 1 on average.
pub(crate) fn normal(random: &mut impl Rng) -> Complex<f64> {
    let (re, im): (f64, f64) = (StandardNormal.sample(random), StandardNormal.sample(random));
    Complex::new(re, im) * FRAC_1_SQRT_2
}

/// The density of gusts in wind of this mean speed, up to a factor (Davenport 1961, Q. J. R. Meteorol. Soc. 87, 194):
/// f S = x² / (1 + x²)^(4/3), x = 1200 m f / U.
pub(crate) fn gust_density(frequency_hz: f64, speed_m_s: f64) -> f64 {
    let x = LENGTH_M * frequency_hz / speed_m_s;
    x * x / frequency_hz / (1.0 + x * x).powf(4.0 / 3.0)
}

/// The coherence of gusts at two heights: exp(-C f dz / U).
pub(crate) fn gust_coherence(frequency_hz: f64, apart_m: f64, speed_m_s: f64) -> f64 {
    (-DECAY * frequency_hz * apart_m / speed_m_s).exp()
}

/// The gust at the next height: an exponential coherence is that of a Markov chain up the height.
pub(crate) fn gust_above(gust: Complex<f64>, coherence: f64, random: &mut impl Rng) -> Complex<f64> {
    gust * coherence + normal(random) * (1.0 - coherence * coherence).sqrt()
}

/// The length that a record of so many rows is simulated in.
pub(crate) fn simulated_length(rows: usize) -> usize {
    smooth((rows as f64 * (1.0 + CUT_OFF)) as usize)
}

/// The middle rows of each column from its lines, of which there are `length / 2 + 1`.
pub(crate) fn columns_of(lines: &mut [Vec<Complex<f64>>], length: usize, rows: usize) -> Vec<Vec<f64>> {
    let transform = inverse_transform(length);
    let first = (length - rows) / 2;
    let column = |lines: &mut Vec<Complex<f64>>| {
        let mut samples = vec![0.0; length];
        // Lengths match, and the ends are real: nothing that it refuses.
        let _ = transform.process(lines, &mut samples);
        samples[first..first + rows].to_vec()
    };
    lines.iter_mut().map(column).collect()
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
