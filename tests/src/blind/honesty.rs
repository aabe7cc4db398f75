//! How identified modes stand to the exact ones: found, missed, invented, and whether stated deviations are honest.

use nalgebra::Complex;

use super::answer::IdentifiedMode;
use crate::statistics::{rms, unknown, z};

/// Farther apart in frequency, modes are not the same.
const SAME_FREQUENCY: f64 = 0.02;
const SAME_SHAPE: f64 = 0.8;

/// An exact mode as the sensors record it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ExactMode {
    pub(super) frequency_hz: f64,
    pub(super) shape: Vec<Complex<f64>>,
}

/// Counts and sums; they add up over cases.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Honesty {
    pub(super) found: usize,
    pub(super) missed: usize,
    pub(super) invented: usize,
    pub(super) frequency_z: Vec<f64>,
    pub(super) shape_z: Vec<f64>,
    pub(super) frequency_errors_percent: Vec<f64>,
    pub(super) macs: Vec<f64>,
}

fn mac(a: &[Complex<f64>], b: &[Complex<f64>]) -> f64 {
    let product: Complex<f64> = a.iter().zip(b).map(|(a, b)| a.conj() * b).sum();
    let power = |shape: &[Complex<f64>]| shape.iter().map(Complex::norm_sqr).sum::<f64>();
    product.norm_sqr() / (power(a) * power(b)).max(f64::MIN_POSITIVE)
}

/// Every exact mode of the band takes the identified one near by that resembles it the most. Exact modes beyond the band's
/// edges excuse what is found there, and are not missed.
pub(super) fn honesty(identified: &[IdentifiedMode], exact: &[ExactMode], band_hz: [f64; 2]) -> Honesty {
    let mut sum = Honesty::default();
    let shapes: Vec<Vec<Complex<f64>>> =
        identified.iter().map(|mode| mode.shape.iter().map(|part| Complex::new(part[0], part[1])).collect()).collect();
    let mut used = vec![false; identified.len()];
    for mode in exact {
        let near = |at: &usize| (identified[*at].frequency_hz / mode.frequency_hz - 1.0).abs() < SAME_FREQUENCY;
        let likeness = |at: usize| mac(&shapes[at], &mode.shape);
        let candidates = (0..identified.len()).filter(|at| !used[*at]).filter(near);
        let best = candidates.max_by(|&a, &b| likeness(a).total_cmp(&likeness(b)));
        let Some(at) = best.filter(|&at| likeness(at) > SAME_SHAPE) else {
            sum.missed += usize::from((band_hz[0]..band_hz[1]).contains(&mode.frequency_hz));
            continue;
        };
        used[at] = true;
        sum.found += 1;
        let found = &identified[at];
        sum.macs.push(likeness(at));
        sum.frequency_errors_percent.push(100.0 * (found.frequency_hz / mode.frequency_hz - 1.0));
        sum.frequency_z.push(z(found.frequency_hz - mode.frequency_hz, found.frequency_std_hz));
        let power: f64 = mode.shape.iter().map(Complex::norm_sqr).sum();
        let scale: Complex<f64> =
            mode.shape.iter().zip(&shapes[at]).map(|(t, f)| t.conj() * f).sum::<Complex<f64>>() / power;
        let differences = shapes[at].iter().zip(&mode.shape).map(|(found, truth)| (found - truth * scale).re);
        sum.shape_z.extend(differences.zip(&found.shape).map(|(difference, part)| z(difference, part[2])));
    }
    sum.invented = used.iter().filter(|used| !**used).count();
    sum
}

impl Honesty {
    pub(super) fn absorb(&mut self, other: &Self) {
        self.found += other.found;
        self.missed += other.missed;
        self.invented += other.invented;
        self.frequency_z.extend(&other.frequency_z);
        self.shape_z.extend(&other.shape_z);
        self.frequency_errors_percent.extend(&other.frequency_errors_percent);
        self.macs.extend(&other.macs);
    }

    pub(super) fn line(&self) -> String {
        let worst = self.macs.iter().copied().fold(1.0, f64::min);
        let unknown = match unknown(&self.frequency_z) + unknown(&self.shape_z) {
            0 => String::new(),
            count => format!(" | {count} of unknown deviation"),
        };
        format!(
            "modes found {} missed {} invented {} | z rms f {:.2} shape {:.2} | f error rms {:.4} % | least MAC {worst:.4}{unknown}",
            self.found,
            self.missed,
            self.invented,
            rms(&self.frequency_z),
            rms(&self.shape_z),
            rms(&self.frequency_errors_percent)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_matched_whatever_their_scale_and_deviations_are_counted() {
        let exact = |frequency_hz, parts: [f64; 2]| ExactMode {
            frequency_hz,
            shape: parts.iter().map(|&part| Complex::new(0.0, 3.0 * part)).collect(),
        };
        let identified = |frequency_hz, parts: [f64; 2]| IdentifiedMode {
            frequency_hz,
            frequency_std_hz: 0.001,
            shape: parts.iter().map(|&part| [part, 0.0, 0.01]).collect(),
        };
        let found = [identified(1.002, [0.0, 1.0]), identified(1.0, [1.0, 0.0]), identified(1.5, [1.0, 0.0])];
        let truth = [exact(1.0, [0.0, 1.0]), exact(1.001, [1.0, 0.0]), exact(2.0, [1.0, 1.0]), exact(9.0, [1.0, 1.0])];
        let sum = honesty(&found, &truth, [0.5, 5.0]);
        assert_eq!((sum.found, sum.missed, sum.invented), (2, 1, 1));
        assert!((sum.frequency_z[0] - 2.0).abs() < 1e-9 && (sum.frequency_z[1] + 1.0).abs() < 1e-9);
        assert!(rms(&sum.shape_z) < 1e-9);
    }
}
