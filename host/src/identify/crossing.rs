//! The cross density of two modes whose forces are correlated.
//!
//! Two resonances as a Welch estimate sees them flow in; the expected cross density at a frequency flows out. Under white forces of cross
//! density G it is `G H_i(s) H_j(-s)` at s = 2 pi i f. Its partial fractions are the two poles that turn with the frequency, which the
//! window smears, and the rest, which is smooth: the residue at a mode's pole is r_i H_j(-p_i), so that it depends on where the other
//! mode is. Only for modes that are close beside their distance from frequency 0 is it the same for both.

use std::f64::consts::TAU;

use num_complex::Complex64;

use super::resonance::{LineShape, Resonance};

/// A mode's transfer function s^n / ((s - p)(s - p*)): n is 2 where force makes acceleration, 1 where it makes velocity.
#[derive(Debug, Clone, Copy)]
struct Transfer {
    pole: Complex64,
    zeros: i32,
}

impl Transfer {
    fn of(shape: &LineShape) -> Self {
        let resonance = shape.resonance();
        let zeta = resonance.damping_ratio;
        let pole = Complex64::new(-zeta, (1.0 - zeta * zeta).sqrt()) * (TAU * resonance.frequency_hz);
        Self { pole, zeros: resonance.quantity.derivatives() }
    }

    fn at(self, s: Complex64) -> Complex64 {
        s.powi(self.zeros) / ((s - self.pole) * (s - self.pole.conj()))
    }

    fn residue(self) -> Complex64 {
        self.pole.powi(self.zeros) / (self.pole - self.pole.conj())
    }

    /// The residue of the mode's own density: that of unit level is 1.
    fn own(self) -> f64 {
        (self.residue() * self.at(-self.pole)).re
    }
}

/// Two modes: what their cross density has of either pole.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    residues: [Complex64; 2],
    scale: f64,
}

impl Crossing {
    /// The density of `first` times that of `second`, conjugate.
    fn new(first: Transfer, second: Transfer) -> Self {
        let scale = 1.0 / (first.own() * second.own()).sqrt();
        let residues = [first.residue() * second.at(-first.pole), second.residue() * first.at(-second.pole)];
        Self { residues, scale }
    }

    /// The expected cross density of modes of unit level under white forces of coherence 1 and phase 0.
    fn density(&self, first: At, second: At) -> Complex64 {
        let [of_first, of_second] = self.residues;
        let smeared = of_first * first.smeared + (of_second * second.smeared).conj();
        self.scale * (first.transfer * second.transfer.conj() + smeared)
    }
}

/// What one mode of a group has with itself and with each of the others.
#[derive(Debug, Clone)]
pub(super) struct Row {
    shape: LineShape,
    transfer: Transfer,
    crossings: Vec<Crossing>,
}

impl Row {
    pub(super) fn new(shape: LineShape, all: &[LineShape]) -> Self {
        let transfer = Transfer::of(&shape);
        let crossings = all.iter().map(|other| Crossing::new(transfer, Transfer::of(other))).collect();
        Self { shape, transfer, crossings }
    }

    /// The entry with mode `other` of unit level, the row being mode `mode`; `own` and `others` are the modes at the same line.
    pub(super) fn entry(&self, [mode, other]: [usize; 2], own: At, others: &[At]) -> Complex64 {
        if mode == other {
            return Complex64::from(own.density * own.colour * own.colour);
        }
        let there = others[other];
        self.crossings[other].density(own, there) * (own.colour * there.colour)
    }

    /// The mode at a line, under a force whose density goes as f to the power of `slope`.
    ///
    /// The colour multiplies the whole density, not the pole's phase alone: far from a resonance that is damped a lot its tilt would make
    /// the density negative.
    pub(super) fn at(&self, frequency_hz: f64, slope: f64) -> At {
        let half = self.shape.symmetric_half(frequency_hz);
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let ratio = frequency_hz / self.shape.resonance().frequency_hz;
        At {
            transfer: self.transfer.at(s),
            smeared: half - 1.0 / (s - self.transfer.pole),
            // Rounding must not make a density negative where next to nothing is left of it.
            density: self.shape.density_of(half, frequency_hz).max(0.0),
            colour: ratio.powf(0.5 * slope),
        }
    }
}

/// A mode at a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct At {
    transfer: Complex64,
    /// What the window adds to 1 / (s - p).
    smeared: Complex64,
    /// The mode's own density under a white force.
    density: f64,
    /// The root of the force's colour, 1 at the mode's own frequency.
    colour: f64,
}

/// The rows of all modes.
pub(super) fn rows(resonances: &[Resonance], duration_s: f64) -> Vec<Row> {
    let shapes: Vec<LineShape> = resonances.iter().map(|resonance| resonance.line_shape(duration_s)).collect();
    shapes.iter().map(|&shape| Row::new(shape, &shapes)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::resonance::Quantity;

    fn shape(frequency_hz: f64, damping_ratio: f64, quantity: Quantity, duration_s: f64) -> LineShape {
        Resonance { frequency_hz, damping_ratio, quantity }.line_shape(duration_s)
    }

    fn density(first: &LineShape, second: &LineShape, frequency_hz: f64) -> Complex64 {
        let all = [*first, *second];
        let [a, b] = all.map(|shape| Row::new(shape, &all));
        a.crossings[1].density(a.at(frequency_hz, 0.0), b.at(frequency_hz, 0.0))
    }

    #[test]
    fn a_mode_crossed_with_itself_has_its_own_density() {
        for quantity in [Quantity::Acceleration, Quantity::Velocity] {
            for damping in [0.001, 0.02, 0.2] {
                let mode = shape(1.3, damping, quantity, 80.0);
                for frequency_hz in [0.2, 1.0, 1.29, 1.3, 1.5, 4.0] {
                    let found = density(&mode, &mode, frequency_hz);
                    let own = mode.density(frequency_hz);
                    assert!(
                        (found - own).norm() < 1e-9 * own.abs(),
                        "{quantity:?} {damping} {frequency_hz}: {found} {own}"
                    );
                }
            }
        }
    }

    #[test]
    fn segments_without_end_show_the_product_of_both_transfer_functions() {
        let (low, high) =
            (shape(2.1, 0.03, Quantity::Acceleration, 1e5), shape(3.0, 0.08, Quantity::Acceleration, 1e5));
        let transfer = |f: f64, own: f64, damping: f64| {
            let (f, own) = (Complex64::from(f), Complex64::from(own));
            -f * f / (own * own - f * f + Complex64::new(0.0, 2.0 * damping) * own * f)
        };
        let product = |f: f64| transfer(f, 2.1, 0.03) * transfer(f, 3.0, 0.08).conj();
        let unit = density(&low, &high, 2.5) / product(2.5);
        assert!(unit.im.abs() < 1e-6 * unit.re && unit.re > 0.0, "{unit}");
        for f in [0.5, 1.9, 2.1, 2.3, 2.9, 3.0, 3.6] {
            let ratio = density(&low, &high, f) / product(f) / unit;
            assert!((ratio - 1.0).norm() < 1e-4, "{f}: {ratio}");
        }
    }

    #[test]
    fn a_segment_smears_it_as_the_windows_kernel_does() {
        // The mean of the exact density about a line, weighted by the Hann window's spectral window.
        let duration_s = 60.0;
        let pair = |duration_s| {
            [
                shape(1.0, 0.01, Quantity::Acceleration, duration_s),
                shape(1.04, 0.006, Quantity::Acceleration, duration_s),
            ]
        };
        let [first, second] = pair(duration_s);
        let [long_first, long_second] = pair(1e6);
        // |W|² of Hann's window at x lines off.
        let kernel = |x: f64| {
            let sinc = |x: f64| {
                if x.abs() < 1e-9 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) }
            };
            (sinc(x) + 0.5 * sinc(x - 1.0) + 0.5 * sinc(x + 1.0)).powi(2)
        };
        for frequency_hz in [0.97, 1.0, 1.02, 1.04, 1.08] {
            let (mut sum, mut weights) = (Complex64::ZERO, 0.0);
            for step in -24_000..=24_000 {
                let x = (f64::from(step) + 0.37) / 2000.0;
                sum += density(&long_first, &long_second, frequency_hz + x / duration_s) * kernel(x);
                weights += kernel(x);
            }
            let (expected, found) = (sum / weights, density(&first, &second, frequency_hz));
            assert!((found - expected).norm() < 1e-3 * expected.norm(), "{frequency_hz}: {found} {expected}");
        }
    }
}
