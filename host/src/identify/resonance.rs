//! A resonance, and the density that a Welch estimate is expected to have of it.
//!
//! Frequency, damping and the quantity that is measured flow in; the expected density with the Hann window's leakage flows out.

use std::f64::consts::TAU;

use num_complex::Complex64;

/// What the spectra are of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Acceleration.
    Acceleration,
    /// Velocity.
    Velocity,
}

impl Quantity {
    /// How many times the angle asin zeta, by which the pole leans, an autocorrelation's phase at lag 0 is: that of the
    /// displacement is -1, and every derivative of both responses adds 2.
    fn turns(self) -> f64 {
        f64::from(2 * self.derivatives() - 1)
    }

    /// How many times the displacement is derived.
    pub(super) fn derivatives(self) -> i32 {
        match self {
            Self::Acceleration => 2,
            Self::Velocity => 1,
        }
    }
}

/// A resonance: where it is and how damped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resonance {
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// What is seen of it.
    pub quantity: Quantity,
}

impl Resonance {
    /// What a Welch estimate with segments of `duration_s` sees of it.
    pub fn line_shape(&self, duration_s: f64) -> LineShape {
        let (zeta, hz) = (self.damping_ratio, self.frequency_hz);
        let damped_hz = hz * (1.0 - zeta * zeta).sqrt();
        let tilt = (self.quantity.turns() * zeta.asin()).tan();
        let decay = TAU * zeta * hz * duration_s;
        LineShape {
            resonance: *self,
            duration_s,
            damped_hz,
            tilt,
            decay,
            falls: Complex64::from_polar((-decay).exp(), TAU * damped_hz * duration_s),
            constant: 4.0 * (tilt * damped_hz / hz - zeta) / (TAU * hz),
        }
    }

    /// [`LineShape::density`] for a segment of `duration_s`.
    pub fn density(&self, frequency_hz: f64, duration_s: f64) -> f64 {
        self.line_shape(duration_s).density(frequency_hz)
    }

    /// [`Resonance::density`] without its smooth part.
    pub(super) fn resonant_density(&self, frequency_hz: f64, duration_s: f64) -> f64 {
        2.0 * self.line_shape(duration_s).pole(frequency_hz, 0.0).re
    }

    /// Density at resonance, unit level.
    pub fn peak_density(&self, duration_s: f64) -> f64 {
        self.density(self.frequency_hz, duration_s)
    }

    /// Half-power bandwidth 2 zeta f in Hz.
    pub fn bandwidth_hz(&self) -> f64 {
        2.0 * self.damping_ratio * self.frequency_hz
    }
}

/// A resonance as a Welch estimate sees it. What is the same at all lines is worked out once: fits ask for hundreds.
#[derive(Debug, Clone, Copy)]
pub struct LineShape {
    resonance: Resonance,
    duration_s: f64,
    damped_hz: f64,
    /// kappa where the force is white.
    tilt: f64,
    /// The pole's decay over a segment.
    decay: f64,
    /// exp(p T), which is all of exp(-q T) at a line of the segment's own.
    falls: Complex64,
    constant: f64,
}

impl LineShape {
    /// The resonance.
    pub fn resonance(&self) -> &Resonance {
        &self.resonance
    }

    /// Expected Welch density at `frequency_hz`, unit level.
    ///
    /// The response of an oscillator to white force has the autocorrelation Re (1 + i kappa) exp(p |t|) with the pole
    /// p = -zeta w + i w sqrt(1 - zeta²); kappa = tan(3 asin zeta) for acceleration, zeta for velocity, comes of p to the fourth
    /// or second power. A Welch estimate sees this times the window's autocorrelation. Of the product's transform the part
    /// that turns with the frequency is closed (the integral of r_hann(t) exp(-q t) over the segment, q = 2 pi i f - p);
    /// the part that turns against it, and what the force adds to an acceleration at once, are smooth in frequency.
    pub fn density(&self, frequency_hz: f64) -> f64 {
        self.density_of(self.symmetric_half(frequency_hz), frequency_hz)
    }

    /// [`LineShape::density`] where [`LineShape::symmetric_half`] is known.
    pub(super) fn density_of(&self, half: Complex64, frequency_hz: f64) -> f64 {
        2.0 * (Complex64::new(1.0, self.tilt) * half).re + self.background(frequency_hz)
    }

    /// What the pole itself contributes to half of [`LineShape::density`] under a force whose density goes as f to the power of
    /// `colour`.
    pub(super) fn pole(&self, frequency_hz: f64, colour: f64) -> Complex64 {
        let tilt = self.tilt + colour * self.resonance.damping_ratio;
        Complex64::new(1.0, tilt) * self.symmetric_half(frequency_hz)
    }

    /// The part of a density that is odd about the resonance, per unit of tilt.
    pub(super) fn skew(&self, frequency_hz: f64) -> f64 {
        -2.0 * self.symmetric_half(frequency_hz).im
    }

    /// Half density without its tilt and the smooth part: what the window makes of 1 / (s - p).
    pub(super) fn symmetric_half(&self, frequency_hz: f64) -> Complex64 {
        let turns = frequency_hz * self.duration_s;
        let is_line = (turns - turns.round()).abs() < WHOLE;
        let falls = if is_line { self.falls } else { self.falls * Complex64::cis(-TAU * turns) };
        let x = Complex64::new(self.decay, TAU * (turns - self.damped_hz * self.duration_s));
        hann_transform(x, falls) * self.duration_s
    }

    /// The smooth part of the density: the pole of negative frequency, and a constant by which the whole vanishes at
    /// frequency 0. The window, which is long beside a period, does nothing to it.
    fn background(&self, frequency_hz: f64) -> f64 {
        let Resonance { frequency_hz: hz, damping_ratio: zeta, .. } = self.resonance;
        let against = Complex64::new(zeta * hz, frequency_hz + self.damped_hz) * TAU;
        self.constant + 2.0 * (Complex64::new(1.0, -self.tilt) / against).re
    }
}

/// A frequency this near to a line, in lines, is at the line.
const WHOLE: f64 = 1e-9;

/// Autocorrelation of the Hann window of unit length at lag `u` (0 to 1), 1 at lag 0:
/// (1 - u)(2/3 + cos(2 pi u)/3) + sin(2 pi u)/(2 pi).
pub fn hann_autocorrelation(u: f64) -> f64 {
    if u >= 1.0 { 0.0 } else { (1.0 - u) * (2.0 + (TAU * u).cos()) / 3.0 + (TAU * u).sin() / TAU }
}

/// Integral of hann_autocorrelation(u) exp(-x u) over u = 0..1; `falls` is exp(-x).
fn hann_transform(x: Complex64, falls: Complex64) -> Complex64 {
    // The window's cosine shifts x by a whole turn, which leaves its exponential as it is.
    let turn = Complex64::new(0.0, TAU);
    let is_small = |x: Complex64| x.norm_sqr() < 1e-6;
    // (x - 1 + exp(-x)) / x² loses its digits for small x; its series is 1/2 - x/6 + x²/24.
    let triangle = |x: Complex64| if is_small(x) { 0.5 - x / 6.0 + x * x / 24.0 } else { (x - 1.0 + falls) / (x * x) };
    let decay = |x: Complex64| if is_small(x) { 1.0 - x / 2.0 + x * x / 6.0 } else { (1.0 - falls) / x };
    let (below, above) = (x - turn, x + turn);
    let sine = (decay(below) - decay(above)) * Complex64::new(0.0, -0.5);
    triangle(x) * (2.0 / 3.0) + (triangle(below) + triangle(above)) / 6.0 + sine / TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    fn acceleration(frequency_hz: f64, damping_ratio: f64) -> Resonance {
        Resonance { frequency_hz, damping_ratio, quantity: Quantity::Acceleration }
    }

    #[test]
    fn the_expected_density_is_the_resonance_convolved_with_the_windows_kernel() {
        // Numerically: the autocorrelation's exact form times the window's, and the force's own constant.
        let resonance = acceleration(1.0, 0.01);
        let duration = 60.0;
        for f in [0.9, 0.98, 1.0, 1.01, 1.1] {
            let steps = 200_000;
            let dt = duration / f64::from(steps);
            let (zeta, w) = (0.01_f64, TAU);
            let damped = w * (1.0 - zeta * zeta).sqrt();
            let kappa = (3.0 * zeta.asin()).tan();
            let numeric: f64 = (0..steps)
                .map(|n| {
                    let t = (f64::from(n) + 0.5) * dt;
                    let turn = damped * t;
                    let correlation = (-zeta * w * t).exp() * (turn.cos() - kappa * turn.sin());
                    4.0 * dt * correlation * hann_autocorrelation(t / duration) * (TAU * f * t).cos()
                })
                .sum();
            let numeric = numeric + 8.0 * zeta / w;
            let closed = resonance.density(f, duration);
            // The window does next to nothing to the smooth part.
            assert!((closed / numeric - 1.0).abs() < 5e-5, "{f}: {closed}, {numeric}");
        }
    }

    #[test]
    fn the_hann_autocorrelation_is_that_of_the_window() {
        let count = 20_000;
        let hann = |n: usize| 0.5 - 0.5 * (TAU * n as f64 / count as f64).cos();
        let at = |lag: usize| (0..count - lag).map(|n| hann(n) * hann(n + lag)).sum::<f64>();
        for lag in [0, 1000, 5000, 10_000, 15_000] {
            let expected = at(lag) / at(0);
            assert!((hann_autocorrelation(lag as f64 / count as f64) - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn a_fine_line_spacing_shows_the_accelerations_own_density() {
        let resonance = acceleration(1.0, 0.01);
        let exact = |f: f64| f.powi(4) / ((1.0 - f * f).powi(2) + (0.02 * f).powi(2));
        for f in [0.9, 0.97, 0.99, 1.0, 1.01, 1.03, 1.1] {
            let ratio = resonance.density(f, 1e5) / resonance.density(1.0, 1e5) / (exact(f) / exact(1.0));
            assert!((ratio - 1.0).abs() < 1e-4, "{f}: {ratio}");
        }
    }
}
