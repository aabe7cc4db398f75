//! Close modes together: the maximum-likelihood fit of their small cross-spectral matrix.
//!
//! A [`JointFit`] to start from and the matrices that modal filters have [`Seen`] flow in; the fit flows out. The averaged
//! matrix R is complex Wishart about its expectation S, so the least sum over lines of `ln det S + tr S⁻¹ R` is the Whittle
//! estimate (Whittle 1953; for modes Au 2017, "Operational Modal Analysis", chapter 12). The forces' correlations have a mild
//! prior that there are none, and so has what is left beside the modes: that only noise correlates it.

use nalgebra::allocator::Allocator;
use nalgebra::{Cholesky, Const, DVector, DefaultAllocator, Dim, Dyn, OMatrix};
use num_complex::Complex64;

use super::bell::DAMPING_RANGE;
use super::crossing::{At, Row, rows};
use super::information::{Derivatives, Information};
use super::joint::{JointFit, Seen, noise_scale};
use super::resonance::{LineShape, Resonance};
use super::scoring::{Schedule, Slopes, fisher_scoring};

/// Standard deviation of the correlation of two modal forces, beforehand.
const CORRELATION_PRIOR: f64 = 0.3;
/// Standard deviation of the logarithm of the noise's size, beforehand, and the range it keeps to.
const NOISE_PRIOR: f64 = 1.0;
const NOISE_RANGE: [f64; 2] = [0.03, 30.0];
/// Standard deviation of the exponent of the noise's amplitude over frequency, beforehand: 2 are the tails of modes far above,
/// 0 those of modes far below.
const NOISE_COLOUR_PRIOR: f64 = 2.0;
const STEEPEST_NOISE: f64 = 12.0;
/// Standard deviation of what is added to the correlations of the noise, beforehand.
const NOISE_CORRELATION_PRIOR: f64 = 0.3;
/// Steps of Fisher scoring.
const MAX_STEPS: usize = 40;
/// The fit ends where a step gains less than this, a line and average.
const LEAST_GAIN: f64 = 1e-9;
/// The steepest exponent.
const STEEPEST: f64 = 8.0;
/// Correlations of forces, and what is added to those of the floor, keep below this.
const MOST_CORRELATION: f64 = 0.95;
/// The largest step in ln damping, in ln level and noise, in bandwidths, and in mixture and correlation.
const LARGEST_STEP: [f64; 4] = [0.5, 1.5, 1.0, 0.5];

/// Standard deviations of a mode's values by the likelihood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Certainty {
    /// Of the frequency.
    pub(super) frequency_std_hz: f64,
    /// Of the damping ratio.
    pub(super) damping_std: f64,
    /// Of the exponent of the force's density.
    pub(super) slope_std: f64,
}

impl JointFit {
    /// Fits everything; frequencies stay within `limits_hz`. `None` where the start has no likelihood.
    pub(super) fn fit(&self, seen: &Seen, limits_hz: &[[f64; 2]], most_steps: usize) -> Option<Self> {
        let schedule = Schedule {
            damping: 1e-3,
            factors: [0.2, 10.0],
            ridge: 1e-12,
            most_steps: most_steps.min(MAX_STEPS),
            least_gain: LEAST_GAIN * seen.matrices.len() as f64,
        };
        let moved = |fit: &Self, step: &DVector<f64>| fit.moved(step, limits_hz);
        Some(fisher_scoring(self.clone(), &schedule, |fit| fit.slopes(seen), moved)?.0)
    }

    /// How sure the likelihood is of each mode: the inverse of the Fisher information, everything else being fitted as well
    /// (Au 2017, section 9.5). `None` where it has no inverse.
    pub(super) fn certainty(&self, seen: &Seen) -> Option<Vec<Certainty>> {
        let covariance = self.slopes(seen)?.fisher.cholesky()?.inverse() / seen.averages;
        let size = self.resonances.len();
        let std = |place: usize| covariance[(place, place)].max(0.0).sqrt();
        let of_mode = |(mode, resonance): (usize, &Resonance)| Certainty {
            frequency_std_hz: std(mode) * resonance.bandwidth_hz(),
            damping_std: std(size + mode) * resonance.damping_ratio,
            slope_std: std(4 * size + mode),
        };
        Some(self.resonances.iter().enumerate().map(of_mode).collect())
    }

    fn unknowns(&self) -> usize {
        let size = self.resonances.len();
        6 * size + 2 * size * (size - 1) + 2 * size * (size - 1)
    }

    fn moved(&self, step: &DVector<f64>, limits_hz: &[[f64; 2]]) -> Self {
        let mut moved = self.clone();
        let size = self.resonances.len();
        let [most_damping, most_level, most_bandwidths, most_mixture] = LARGEST_STEP;
        for (mode, resonance) in moved.resonances.iter_mut().enumerate() {
            let [lowest, highest] = limits_hz[mode];
            let shift = step[mode].clamp(-most_bandwidths, most_bandwidths) * resonance.bandwidth_hz();
            resonance.frequency_hz = (resonance.frequency_hz + shift).clamp(lowest, highest);
            let factor = step[size + mode].clamp(-most_damping, most_damping).exp();
            resonance.damping_ratio = (resonance.damping_ratio * factor).clamp(DAMPING_RANGE[0], DAMPING_RANGE[1]);
            moved.levels[mode] *= step[2 * size + mode].clamp(-most_level, most_level).exp();
            moved.noise[mode] *= step[3 * size + mode].clamp(-most_level, most_level).exp();
            moved.noise[mode] = moved.noise[mode].clamp(NOISE_RANGE[0], NOISE_RANGE[1]);
        }
        for (mode, slope) in moved.slopes.iter_mut().enumerate() {
            *slope = (*slope + step[4 * size + mode].clamp(-most_level, most_level)).clamp(-STEEPEST, STEEPEST);
        }
        for (mode, colour) in moved.noise_colours.iter_mut().enumerate() {
            let step = step[5 * size + mode].clamp(-most_level, most_level);
            *colour = (*colour + step).clamp(-STEEPEST_NOISE, STEEPEST_NOISE);
        }
        let mut next = 6 * size;
        let mut complex = || {
            let value = Complex64::new(step[next], step[next + 1]);
            next += 2;
            let length = value.norm();
            if length > most_mixture { value * (most_mixture / length) } else { value }
        };
        for i in 0..size {
            for j in (0..size).filter(|&j| j != i) {
                moved.mixture[(i, j)] += complex();
            }
        }
        for correlation in [&mut moved.correlation, &mut moved.noise_correlation] {
            for i in 0..size {
                for j in i + 1..size {
                    let mut value = correlation[(i, j)] + complex();
                    let length = value.norm();
                    if length > MOST_CORRELATION {
                        value *= MOST_CORRELATION / length;
                    }
                    correlation[(i, j)] = value;
                    correlation[(j, i)] = value.conj();
                }
            }
        }
        moved
    }

    /// The objective, its negative gradient and the Fisher information, an average; `None` where S is not positive
    /// definite at some line.
    fn slopes(&self, seen: &Seen) -> Option<Slopes> {
        // Matrices of a size that is known when this is compiled need not be allocated, which is most of the work.
        match self.resonances.len() {
            1 => self.slopes_of_size(seen, Const::<1>),
            2 => self.slopes_of_size(seen, Const::<2>),
            3 => self.slopes_of_size(seen, Const::<3>),
            4 => self.slopes_of_size(seen, Const::<4>),
            size => self.slopes_of_size(seen, Dyn(size)),
        }
    }

    /// [`JointFit::slopes`] of `modes` modes.
    ///
    /// Every derivative of S is `u q + (u q)ᴴ`, u a column and q a row; with S = L Lᴴ, u and q come divided by L.
    fn slopes_of_size<D: Dim>(&self, seen: &Seen, modes: D) -> Option<Slopes>
    where
        DefaultAllocator: Allocator<D, D>,
    {
        let size = modes.value();
        let unknowns = self.unknowns();
        let mut objective = 0.0;
        let mut information = Information::zero(unknowns);
        let step = 1e-4;
        let own = rows(&self.resonances, seen.duration_s);
        let shapes: Vec<LineShape> =
            self.resonances.iter().map(|resonance| resonance.line_shape(seen.duration_s)).collect();
        // Each mode with its frequency and its damping a little more and less.
        let moved: Vec<[[Row; 2]; 2]> = self
            .resonances
            .iter()
            .map(|here| {
                let at = |bandwidths: f64, log: f64| {
                    let resonance = Resonance {
                        frequency_hz: here.frequency_hz + bandwidths * here.bandwidth_hz(),
                        damping_ratio: here.damping_ratio * log.exp(),
                        ..*here
                    };
                    Row::new(resonance.line_shape(seen.duration_s), &shapes)
                };
                [[at(step, 0.0), at(-step, 0.0)], [at(0.0, step), at(0.0, -step)]]
            })
            .collect();
        let mut change = vec![Complex64::ZERO; size];
        let mut derivatives = Derivatives::new(size, unknowns);
        let mut excess = vec![0.0; size * size];
        let identity = OMatrix::<Complex64, D, D>::identity_generic(modes, modes);
        let mixture = square(modes, |i, j| self.mixture[(i, j)]);
        let amplitude = square(modes, |i, j| self.amplitude(i, j));
        let floor = self.floor(seen);
        for (&frequency_hz, matrix) in seen.frequency_hz.iter().zip(&seen.matrices) {
            let at: Vec<At> = own.iter().zip(&self.slopes).map(|(row, &slope)| row.at(frequency_hz, slope)).collect();
            let mut unit = square(modes, |_, _| Complex64::ZERO);
            for i in 0..size {
                for j in i..size {
                    unit[(i, j)] = own[i].entry([i, j], at[i], &at);
                    unit[(j, i)] = unit[(i, j)].conj();
                }
            }
            let spectra = amplitude.component_mul(&unit);
            let through = &mixture * &spectra;
            let noise_sizes = self.noise_sizes(frequency_hz);
            let noise = square(modes, |i, j| floor[(i, j)] * (noise_sizes[i] * noise_sizes[j]));
            let expected = &through * mixture.adjoint() + &noise;
            let lower = lower_factor(&expected)?;
            let inverse = lower.solve_lower_triangular(&identity)?;
            objective += 2.0 * (0..size).map(|i| lower[(i, i)].re.ln()).sum::<f64>();
            // (R/S) and what every derivative is made of.
            let ratio = &inverse * square(modes, |i, j| matrix[(i, j)]) * inverse.adjoint();
            objective += ratio.trace().re;
            let mixed = &inverse * &mixture;
            let spectra_mixed = &spectra * mixed.adjoint();
            let noise_mixed = &noise * inverse.adjoint();
            derivatives.start();
            // First all frequencies, then all dampings.
            for unknown in 0..2 {
                for (mode, moved) in moved.iter().enumerate() {
                    // What the mode's row of P changes by; half of it on the diagonal, which its column has as well.
                    let [more, less] = &moved[unknown];
                    let [at_more, at_less] = [more, less].map(|row| row.at(frequency_hz, self.slopes[mode]));
                    for (other, change) in change.iter_mut().enumerate() {
                        let place = [mode, other];
                        let difference = more.entry(place, at_more, &at) - less.entry(place, at_less, &at);
                        let share = if other == mode { 0.25 } else { 0.5 };
                        *change = amplitude[(mode, other)] * difference * (share / step);
                    }
                    let row = |l: usize| (0..size).map(|other| change[other] * mixed[(l, other)].conj()).sum();
                    derivatives.put(|k| mixed[(k, mode)], row);
                }
            }
            for mode in 0..size {
                derivatives.put(|k| mixed[(k, mode)], |l| spectra_mixed[(mode, l)] * 0.5);
            }
            for mode in 0..size {
                derivatives.put(|k| inverse[(k, mode)], |l| noise_mixed[(mode, l)]);
            }
            for mode in 0..size {
                let change = 0.5 * (frequency_hz / self.resonances[mode].frequency_hz).ln();
                derivatives.put(|k| mixed[(k, mode)], |l| spectra_mixed[(mode, l)] * change);
            }
            for mode in 0..size {
                let change = (frequency_hz / self.centres_hz[mode]).ln();
                derivatives.put(|k| inverse[(k, mode)], |l| change * noise_mixed[(mode, l)]);
            }
            for i in 0..size {
                for j in (0..size).filter(|&j| j != i) {
                    for unit in [Complex64::ONE, Complex64::I] {
                        derivatives.put(|k| inverse[(k, i)] * unit, |l| spectra_mixed[(j, l)]);
                    }
                }
            }
            for i in 0..size {
                for j in i + 1..size {
                    let change = unit[(i, j)] * (self.levels[i] * self.levels[j]).sqrt();
                    for unit in [Complex64::ONE, Complex64::I] {
                        derivatives.put(|k| mixed[(k, i)], |l| unit * change * mixed[(l, j)].conj());
                    }
                }
            }
            for i in 0..size {
                for j in i + 1..size {
                    let change = noise_sizes[i] * noise_sizes[j] * noise_scale(seen, i, j);
                    for unit in [Complex64::ONE, Complex64::I] {
                        derivatives.put(|k| inverse[(k, i)] * unit, |l| inverse[(l, j)].conj() * change);
                    }
                }
            }
            let mut place = 0;
            for k in 0..size {
                excess[place] = ratio[(k, k)].re - 1.0;
                place += 1;
                for l in k + 1..size {
                    excess[place] = std::f64::consts::SQRT_2 * ratio[(k, l)].re;
                    excess[place + 1] = std::f64::consts::SQRT_2 * ratio[(k, l)].im;
                    place += 2;
                }
            }
            information.add(&derivatives, &excess);
        }
        let (mut gradient, mut fisher) = information.sums();
        let prior = 1.0 / (NOISE_PRIOR * NOISE_PRIOR * seen.averages.max(1.0));
        for (mode, noise) in self.noise.iter().enumerate() {
            let place = 3 * size + mode;
            objective += 0.5 * prior * noise.ln().powi(2);
            gradient[place] -= prior * noise.ln();
            fisher[(place, place)] += prior;
        }
        let prior = 1.0 / (seen.slope.std * seen.slope.std * seen.averages.max(1.0));
        for (mode, slope) in self.slopes.iter().enumerate() {
            let (place, away) = (4 * size + mode, slope - seen.slope.mean);
            objective += 0.5 * prior * away * away;
            gradient[place] -= prior * away;
            fisher[(place, place)] += prior;
        }
        let prior = 1.0 / (NOISE_COLOUR_PRIOR * NOISE_COLOUR_PRIOR * seen.averages.max(1.0));
        for (mode, colour) in self.noise_colours.iter().enumerate() {
            let place = 5 * size + mode;
            objective += 0.5 * prior * colour * colour;
            gradient[place] -= prior * colour;
            fisher[(place, place)] += prior;
        }
        let mut place = 6 * size + 2 * size * (size - 1);
        let correlations = [(&self.correlation, CORRELATION_PRIOR), (&self.noise_correlation, NOISE_CORRELATION_PRIOR)];
        for (correlation, std) in correlations {
            let prior = 1.0 / (std * std * seen.averages.max(1.0));
            for i in 0..size {
                for j in i + 1..size {
                    let value = correlation[(i, j)];
                    objective += 0.5 * prior * value.norm_sqr();
                    for part in [value.re, value.im] {
                        gradient[place] -= prior * part;
                        fisher[(place, place)] += prior;
                        place += 1;
                    }
                }
            }
        }
        objective.is_finite().then_some(Slopes { objective, gradient, fisher })
    }
}

/// A pivot below this share of its diagonal entry is zero up to rounding.
const LEAST_PIVOT: f64 = 1e-14;

/// A matrix, modes x modes.
fn square<D: Dim>(modes: D, entry: impl FnMut(usize, usize) -> Complex64) -> OMatrix<Complex64, D, D>
where
    DefaultAllocator: Allocator<D, D>,
{
    OMatrix::from_fn_generic(modes, modes, entry)
}

/// Lower Cholesky factor of a Hermitian matrix; `None` where it is not positive definite.
///
/// The library takes the root of a negative pivot too, which is a complex number like any other, so pivots are checked here.
fn lower_factor<D: Dim>(matrix: &OMatrix<Complex64, D, D>) -> Option<OMatrix<Complex64, D, D>>
where
    DefaultAllocator: Allocator<D, D>,
{
    let lower = Cholesky::new(matrix.clone())?.unpack();
    let is_positive = |i: usize| lower[(i, i)].re.powi(2) > LEAST_PIVOT * matrix[(i, i)].re;
    (0..matrix.nrows()).all(is_positive).then_some(lower)
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;
    use crate::identify::joint::SlopePrior;
    use crate::identify::resonance::Quantity;

    fn resonance(frequency_hz: f64, damping_ratio: f64) -> Resonance {
        Resonance { frequency_hz, damping_ratio, quantity: Quantity::Acceleration }
    }

    /// Two modes half a bandwidth and a half apart, that mix and whose forces are correlated, and what is expected of them.
    fn pair() -> (JointFit, Seen) {
        let mut truth = JointFit::start(vec![resonance(1.0, 0.01), resonance(1.015, 0.008)], vec![2.0, 0.5]);
        truth.mixture[(0, 1)] = Complex64::new(0.2, -0.05);
        truth.mixture[(1, 0)] = Complex64::new(-0.1, 0.02);
        truth.correlation[(0, 1)] = Complex64::new(0.1, 0.0);
        truth.correlation[(1, 0)] = Complex64::new(0.1, 0.0);
        let duration_s = 200.0;
        let frequency_hz: Vec<f64> = (0..40).map(|line| 0.9 + f64::from(line) / duration_s).collect();
        let noise = DMatrix::from_row_slice(2, 2, &[1e-3, 2e-4, 2e-4, 2e-3]).map(Complex64::from);
        let expected = |spectra| &truth.mixture * spectra * truth.mixture.adjoint() + &noise;
        let matrices = truth.modal_spectra(&frequency_hz, duration_s).into_iter().map(expected).collect();
        (
            truth.clone(),
            Seen {
                frequency_hz,
                matrices,
                noise,
                duration_s,
                averages: 1e9,
                slope: SlopePrior { mean: 0.0, std: 2.0 },
            },
        )
    }

    #[test]
    fn an_exact_spectrum_of_two_close_modes_gives_them_back() {
        let (truth, seen) = pair();
        let start = JointFit::start(vec![resonance(0.998, 0.015), resonance(1.018, 0.005)], vec![1.0, 1.0]);
        let mut fit = start;
        for _ in 0..3 {
            fit = fit.fit(&seen, &[[0.98, 1.02]; 2], MAX_STEPS).unwrap();
        }
        for (found, made) in fit.resonances.iter().zip(&truth.resonances) {
            assert!((found.frequency_hz / made.frequency_hz - 1.0).abs() < 1e-6, "{found:?} {made:?}");
            assert!((found.damping_ratio / made.damping_ratio - 1.0).abs() < 2e-3, "{found:?} {made:?}");
        }
        assert!((fit.mixture - &truth.mixture).norm() < 2e-3);
        assert!((fit.correlation[(0, 1)] - truth.correlation[(0, 1)]).norm() < 2e-3);
    }

    #[test]
    fn what_filters_see_together_of_other_modes_bends_no_mode() {
        // Two filters see the floor a quarter of a turn apart.
        let (mut truth, mut seen) = pair();
        truth.resonances[1].frequency_hz = 1.05;
        truth.noise = vec![4.0, 4.0];
        truth.noise_correlation[(0, 1)] = Complex64::new(0.0, -0.5);
        truth.noise_correlation[(1, 0)] = Complex64::new(0.0, 0.5);
        seen.matrices = truth.expected(&truth.modal_spectra(&seen.frequency_hz, seen.duration_s), &seen);
        let mut fit = JointFit::start(vec![resonance(0.998, 0.015), resonance(1.048, 0.01)], vec![1.0, 1.0]);
        for _ in 0..3 {
            fit = fit.fit(&seen, &[[0.98, 1.07]; 2], MAX_STEPS).unwrap();
        }
        for (found, made) in fit.resonances.iter().zip(&truth.resonances) {
            assert!((found.damping_ratio / made.damping_ratio - 1.0).abs() < 5e-3, "{found:?} {made:?}");
        }
        let [found, made] = [&fit, &truth].map(|fit| fit.noise_correlation[(0, 1)]);
        assert!((found - made).norm() < 0.02, "{found} {made}");
    }

    #[test]
    fn the_gradient_is_that_of_the_objective() {
        let (truth, mut seen) = pair();
        // Away from the optimum, with averages that make the priors count.
        seen.averages = 20.0;
        for (index, matrix) in seen.matrices.iter_mut().enumerate() {
            *matrix *= Complex64::from(1.0 + 0.3 * (index as f64).sin());
        }
        let mut here = truth;
        here.noise = vec![1.5, 0.7];
        here.slopes = vec![-1.0, 0.5];
        here.noise_colours = vec![3.0, -0.5];
        here.noise_correlation[(0, 1)] = Complex64::new(0.1, -0.3);
        here.noise_correlation[(1, 0)] = Complex64::new(0.1, 0.3);
        let free = [[0.0, 10.0]; 2];
        let slopes = here.slopes(&seen).unwrap();
        for unknown in 0..here.unknowns() {
            let at = |size: f64| {
                let mut step = DVector::zeros(here.unknowns());
                step[unknown] = size;
                here.moved(&step, &free).slopes(&seen).unwrap().objective
            };
            let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
            let found = -slopes.gradient[unknown];
            assert!((found - numeric).abs() < 1e-4 * (1.0 + numeric.abs()), "{unknown}: {found} {numeric}");
        }
        assert!(slopes.fisher.clone().cholesky().is_some());
    }

    #[test]
    fn matrices_that_are_not_positive_definite_have_no_factor() {
        let matrix = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]).map(Complex64::from);
        assert!(lower_factor(&matrix).is_none());
        assert!(lower_factor(&DMatrix::from_element(1, 1, Complex64::from(f64::NAN))).is_none());
        let (_, seen) = pair();
        let lower = lower_factor(&seen.matrices[7]).unwrap();
        assert!((&lower * lower.adjoint() - &seen.matrices[7]).norm() < 1e-12 * seen.matrices[7].norm());
    }
}
