//! Loads: modal forces line by line, with any correlation between modes.

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::structure::Structure;

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

/// Davenport's decay of coherence along the height, and the length of his spectrum in m.
const DECAY: f64 = 10.0;
const LENGTH_M: f64 = 1200.0;

/// A load, ready to be drawn line by line.
pub(super) struct Forces<'a> {
    load: Load,
    structure: &'a Structure,
    /// Lower factor of the modal forces' covariance.
    factor: DMatrix<Complex<f64>>,
}

fn normal(random: &mut impl Rng) -> Complex<f64> {
    let (re, im): (f64, f64) = (StandardNormal.sample(random), StandardNormal.sample(random));
    Complex::new(re, im) * std::f64::consts::FRAC_1_SQRT_2
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
                let x = LENGTH_M * frequency_hz / speed_m_s;
                let density = x * x / frequency_hz / (1.0 + x * x).powf(4.0 / 3.0);
                let mut total = DVector::from_element(modes, Complex::from(0.0));
                let mut gusts = [normal(random), normal(random)];
                let mut below_m: Option<f64> = None;
                for (z_m, shapes) in &self.structure.levels {
                    // exp(-a |dz|) is the correlation of a Markov chain up the height.
                    let kept =
                        below_m.map_or(0.0, |below_m| (-DECAY * frequency_hz * (z_m - below_m) / speed_m_s).exp());
                    below_m = Some(*z_m);
                    for (gust, shape) in gusts.iter_mut().zip(shapes) {
                        *gust = *gust * kept + normal(random) * (1.0 - kept * kept).sqrt();
                        total += shape.map(Complex::from) * *gust;
                    }
                }
                total * Complex::from(density.sqrt())
            }
        }
    }
}
