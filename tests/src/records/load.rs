//! Loads: modal forces line by line, with any correlation between modes.

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};
use rand::{Rng, RngExt};

use super::structure::Structure;
use crate::spectral::{gust_above, gust_coherence, gust_density, normal};

/// What shakes a structure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Load {
    /// A force on each mode; two of them have a coherence of this size and any phase. Its density goes as f to the power of
    /// `colour`.
    Modal {
        /// Magnitude of the correlation of two modal forces.
        correlation: f64,
        /// Exponent of the density.
        colour: f64,
    },
    /// Independent white forces on all modes, small but for bursts that they have in common, as where vehicles pass.
    Bursts,
    /// Wind on all levels: the density of Davenport (1961), and the coherence exp(-C f dz / U) between two levels.
    Wind {
        /// Mean speed in m/s.
        speed_m_s: f64,
    },
}

impl Load {
    pub(super) fn comes_in_bursts(self) -> bool {
        self == Self::Bursts
    }
}

/// A load, ready to be drawn line by line.
pub(super) struct Forces<'a> {
    load: Load,
    structure: &'a Structure,
    /// Lower factor of the modal forces' covariance.
    factor: DMatrix<Complex<f64>>,
}

impl<'a> Forces<'a> {
    pub(super) fn new(load: Load, structure: &'a Structure, random: &mut impl Rng) -> Self {
        let modes = structure.frequencies_hz.len();
        let correlation = if let Load::Modal { correlation, .. } = load { correlation } else { 0.0 };
        let phases: Vec<f64> = (0..modes).map(|_| random.random_range(0.0..TAU)).collect();
        // Constant coherence with phases of a common cause: positive definite for any correlation below 1.
        let covariance = DMatrix::from_fn(modes, modes, |i, j| {
            if i == j { Complex::from(1.0) } else { Complex::from_polar(correlation, phases[i] - phases[j]) }
        });
        let factor = covariance.cholesky().map_or_else(|| DMatrix::identity(modes, modes), |factor| factor.l());
        Self { load, structure, factor }
    }

    /// Modal forces of a line of unit bandwidth.
    pub(super) fn draw(&self, frequency_hz: f64, random: &mut impl Rng) -> DVector<Complex<f64>> {
        let modes = self.structure.frequencies_hz.len();
        match self.load {
            Load::Bursts => DVector::from_fn(modes, |_, _| normal(random)),
            Load::Modal { colour, .. } => {
                let amplitude = (frequency_hz / self.structure.frequencies_hz[0]).powf(0.5 * colour);
                let white = DVector::from_fn(modes, |_, _| normal(random));
                &self.factor * white * Complex::from(amplitude)
            }
            Load::Wind { speed_m_s } => {
                let mut total = DVector::from_element(modes, Complex::from(0.0));
                let mut gusts = [normal(random), normal(random)];
                let mut below_m: Option<f64> = None;
                for (z_m, shapes) in &self.structure.levels {
                    let kept = below_m.map_or(0.0, |below_m| gust_coherence(frequency_hz, z_m - below_m, speed_m_s));
                    below_m = Some(*z_m);
                    for (gust, shape) in gusts.iter_mut().zip(shapes) {
                        *gust = gust_above(*gust, kept, random);
                        total += shape.map(Complex::from) * *gust;
                    }
                }
                total * Complex::from(gust_density(frequency_hz, speed_m_s).sqrt())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Products of two modes' forces, averaged over so many draws that they scatter by a hundredth.
    const DRAWS: usize = 10_000;
    const SCATTER: f64 = 0.01;

    /// Modes at 0.5 and 1 Hz; wind moves the first at the ground alone and the second at `z_m` alone.
    fn structure(z_m: f64) -> Structure {
        let [first, second, none] =
            [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]].map(|along| DVector::from_column_slice(&along));
        Structure {
            frequencies_hz: vec![0.5, 1.0],
            damping: vec![0.01, 0.01],
            shapes: DMatrix::identity(2, 2),
            places: vec![(10.0, 0.0), (20.0, 0.0)],
            levels: vec![(0.0, [first, none.clone()]), (z_m, [second, none])],
        }
    }

    /// The modal forces' powers and the magnitude of their correlation.
    fn drawn(load: Load, structure: &Structure, frequency_hz: f64) -> ([f64; 2], f64) {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let forces = Forces::new(load, structure, &mut random);
        let mut sum = Matrix2::from_element(Complex::from(0.0));
        for _ in 0..DRAWS {
            let force = forces.draw(frequency_hz, &mut random);
            sum += &force * force.adjoint() / Complex::from(DRAWS as f64);
        }
        let powers = [sum[(0, 0)].re, sum[(1, 1)].re];
        (powers, sum[(0, 1)].norm() / (powers[0] * powers[1]).sqrt())
    }

    fn is_near(value: f64, wanted: f64) -> bool {
        (value - wanted).abs() < 5.0 * SCATTER * wanted.max(1.0)
    }

    #[test]
    fn modal_forces_have_the_density_and_the_correlation_of_their_case() {
        for correlation in [0.0, 0.3] {
            let load = Load::Modal { correlation, colour: -5.0 / 3.0 };
            let (powers, found) = drawn(load, &structure(1.0), 0.5);
            assert!(powers.iter().all(|power| is_near(*power, 1.0)), "{powers:?}");
            assert!(is_near(found, correlation), "{found}");
            // 8^(-5/3) = 1/32 at eight times the first frequency.
            let (powers, _) = drawn(load, &structure(1.0), 4.0);
            assert!(powers.iter().all(|power| is_near(32.0 * power, 1.0)), "{powers:?}");
        }
    }

    #[test]
    fn wind_has_davenports_density_and_loses_its_correlation_with_height() {
        // At 0.01 Hz and 12 m/s 1200 f / U is 1, and 10 f / U is 1/120 for each metre.
        let wind = Load::Wind { speed_m_s: 12.0 };
        let density = 100.0 / 2.0_f64.powf(4.0 / 3.0);
        for (z_m, correlation) in [(120.0 * 2.0_f64.ln(), 0.5), (120.0 * 4.0_f64.ln(), 0.25)] {
            let (powers, found) = drawn(wind, &structure(z_m), 0.01);
            assert!(powers.iter().all(|power| is_near(power / density, 1.0)), "{powers:?}");
            assert!(is_near(found, correlation), "{found}");
        }
    }
}
