//! What neither an effect nor the scatter of a beam's segments can make: how far a sound model of the kind misses modes all the same.
//!
//! A structure is no beam: sections distort, floors are no lumps, properties of bays are smeared. Relative errors of eigenvalues,
//! turning of neighbouring modes' shapes and local errors of shapes are independent Gaussian numbers, as an error of prediction
//! (Kennedy and O'Hagan 2001; Simoen, De Roeck and Lombaert 2015). How large they are is not known before: a [`Fit`] flows in, the
//! sizes with the highest evidence flow out, so that a model pays for each size by the volume of what it could then predict.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use super::criteria::FAILS;
use super::fit::{Fit, weighted};
use super::misfit::Loss;
use super::problem::Problem;
use super::state::State;

/// Standard deviations of what a model misses for reasons that no effect explains.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Discrepancy {
    /// Of a frequency, relative.
    pub frequency: f64,
    /// Of a component of a shape, in shares of its largest.
    pub shape: f64,
    /// Of what couples two modes, in shares of the stiffness: modes whose frequencies differ by d (ln f) turn by this over 2 d.
    pub coupling: f64,
    /// The first two are those of the middle mode; of others they are this power of the ratio of frequencies larger.
    pub growth: f64,
}

/// How large a discrepancy can be.
struct Range {
    /// Sizes up to this are as good as none.
    least: f64,
    /// Up to this every size is as likely as any other; careful models of towers are this good.
    usual: f64,
    /// No structure that is rightly modelled as a beam or by matrices misses more.
    most: f64,
}

/// Engineers' tables of towers miss the frequencies of the structures they are made from by 0.3 to 3 %, most of it through
/// stiffnesses that scatter smoothly, which has its own tolerance.
const FREQUENCY: Range = Range { least: 5e-5, usual: 3e-3, most: 0.1 };
/// Sections distort by about a hundredth.
const SHAPE: Range = Range { least: 5e-4, usual: 5e-3, most: 0.2 };
/// Directions that tables give to a degree, and supports that are not quite alike, always couple modes by the least of these.
const COUPLING: Range = Range { least: 2e-3, usual: 4e-3, most: 0.2 };
/// The shorter the waves, the less a structure is a beam: at most by their square, as those of sections that shear.
const GROWTH: [f64; 2] = [0.0, 2.0];
/// Above what is usual, twice as much is one standard deviation less likely.
const FACTOR: f64 = 2.0;

impl Range {
    /// How far a size is above what is usual, in standard deviations.
    fn above(&self, size: f64) -> f64 {
        ((size / self.usual).ln() / FACTOR.ln()).max(0.0)
    }
}

impl Discrepancy {
    /// Of a model that is as good as its tolerance says.
    pub(super) const NONE: Self = Self { frequency: 0.0, shape: 0.0, coupling: COUPLING.least, growth: 0.0 };

    /// From the logarithms of its sizes, and the growth.
    fn of_numbers(numbers: [f64; 4]) -> Self {
        let size = |at: usize, range: &Range| {
            let size = numbers[at].exp();
            if size <= range.least * 1.001 { 0.0 } else { size }
        };
        Self {
            frequency: size(0, &FREQUENCY),
            shape: size(1, &SHAPE),
            coupling: size(2, &COUPLING).max(COUPLING.least),
            growth: numbers[3],
        }
    }

    fn numbers(&self) -> [f64; 4] {
        let [frequency, shape, coupling] =
            [(self.frequency, FREQUENCY), (self.shape, SHAPE), (self.coupling, COUPLING)]
                .map(|(size, range)| size.clamp(range.least, range.most).ln());
        [frequency, shape, coupling, self.growth]
    }

    /// How much larger the sizes of a mode are than those of the middle one, whose frequency is `middle_hz`.
    pub(super) fn grown(&self, frequency_hz: f64, middle_hz: f64) -> f64 {
        if self.growth == 0.0 { 1.0 } else { (frequency_hz / middle_hz).powf(self.growth) }
    }

    /// How far the sizes are above what is usual, in standard deviations.
    fn above(&self) -> [f64; 3] {
        [FREQUENCY.above(self.frequency), SHAPE.above(self.shape), COUPLING.above(self.coupling)]
    }

    /// Logarithm of the prior density, zero where all is usual.
    pub(super) fn log_prior(&self) -> f64 {
        -0.5 * self.above().iter().map(|above| above * above).sum::<f64>()
    }

    /// Probability of a size as far above what is usual, or further, of a model of the right kind; `None` where none is above.
    pub(super) fn p_value(&self) -> Option<f64> {
        let above = self.above().into_iter().fold(0.0, f64::max);
        let normal = Normal::standard();
        (above > 0.0).then(|| 1.0 - normal.cdf(above).powi(3))
    }

    /// Whether a model of the right kind can miss as much.
    pub(super) fn is_plausible(&self) -> bool {
        self.p_value().is_none_or(|p_value| p_value >= FAILS)
    }

    /// With a share of its sizes.
    pub(crate) fn times(&self, share: f64) -> Self {
        Self {
            frequency: share * self.frequency,
            shape: share * self.shape,
            coupling: (share * self.coupling).max(COUPLING.least),
            ..*self
        }
    }

    /// Whether another is the same for all that follows from it.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        let (one, other) = (self.numbers(), other.numbers());
        one.iter().zip(other).all(|(one, other)| (one - other).abs() < ALIKE)
    }
}

/// Sizes that differ by less than this (ln) are alike.
const ALIKE: f64 = 0.3;
/// A discrepancy that raises the logarithm of the evidence by less is left out.
pub(super) const WORTH: f64 = 1.0;
/// Steps of the search for the best sizes (ln) and growth.
const STEPS: [f64; 4] = [1.6, 0.8, 0.4, 0.2];
/// Fits and sizes are settled in turn, so often at most.
const MOST_ROUNDS: usize = 3;

impl Problem {
    /// The same with another discrepancy.
    pub(super) fn with_discrepancy(&self, discrepancy: Discrepancy) -> Self {
        let mut other = self.clone();
        other.discrepancy = discrepancy;
        other
    }

    /// The sizes of the discrepancy with the highest evidence, near a fit, and by how much they raise its logarithm: the differences
    /// follow effects and background as they do there (Laplace's approximation).
    pub(super) fn best_discrepancy(&self, fit: &Fit) -> (Discrepancy, f64) {
        // A dozen frequencies alone do not tell what a model misses from what it lacks.
        if self.measured.iter().all(|mode| mode.shape.is_none()) {
            return (fit.discrepancy, 0.0);
        }
        let near = Near::of(fit);
        let mut best = fit.discrepancy.numbers();
        let Some(mut evidence) = near.log_evidence(self, &Discrepancy::of_numbers(best)) else {
            return (fit.discrepancy, 0.0);
        };
        let before = evidence;
        let [frequency, shape, coupling] =
            [FREQUENCY, SHAPE, COUPLING].map(|range| [range.least.ln(), range.most.ln()]);
        let ranges = [frequency, shape, coupling, GROWTH];
        for step in STEPS {
            let mut has_moved = true;
            while has_moved {
                has_moved = false;
                for at in 0..best.len() {
                    for change in [step, -step] {
                        let mut there = best;
                        there[at] = (there[at] + change).clamp(ranges[at][0], ranges[at][1]);
                        let found = near.log_evidence(self, &Discrepancy::of_numbers(there));
                        if let Some(found) = found.filter(|found| *found > evidence + 1e-3) {
                            (best, evidence, has_moved) = (there, found, true);
                            break;
                        }
                    }
                }
            }
        }
        let best = Discrepancy::of_numbers(best);
        // What hardly adds to the evidence is none.
        match near.log_evidence(self, &Discrepancy::NONE) {
            Some(none) if evidence < none + WORTH => (Discrepancy::NONE, none - before),
            _ => (best, evidence - before),
        }
    }

    /// A fit again with the discrepancy that suits it best, and the problem with that; `None` where it has that already.
    pub(super) fn settled(&self, fit: &Fit) -> Settled {
        self.settled_from(fit, self.best_discrepancy(fit).0)
    }

    /// The same where the best discrepancy near the fit is known.
    pub(super) fn settled_from(&self, fit: &Fit, mut discrepancy: Discrepancy) -> Settled {
        let mut settled: Settled = None;
        for round in 1..=MOST_ROUNDS {
            let (problem, fit) = here(&settled, self, fit);
            if discrepancy.is_like(&fit.discrepancy) {
                break;
            }
            let next = problem.with_discrepancy(discrepancy);
            let Ok(refitted) = next.refitted(fit) else { break };
            if round < MOST_ROUNDS {
                discrepancy = next.best_discrepancy(&refitted).0;
            }
            settled = Some((next, refitted));
        }
        settled
    }

    /// The same, where a model of the right kind can miss as much.
    pub(super) fn settled_plausibly(&self, fit: &Fit) -> Settled {
        self.settled(fit).filter(|(_, fit)| fit.discrepancy.is_plausible())
    }

    /// Logarithm of how much larger the determinants of a state's covariances are than without a discrepancy; `None` where one is not
    /// positive definite.
    pub(super) fn log_volume(&self, state: &State) -> Option<f64> {
        if self.discrepancy == Discrepancy::NONE {
            return Some(0.0);
        }
        let without = self.covariance_factors(&state.residual, &Discrepancy::NONE)?;
        let volume = |factors: &[Cholesky<f64, Dyn>]| factors.iter().map(log_determinant).sum::<f64>();
        Some(volume(&state.factors) - volume(&without))
    }

    /// A fit of the same problem with another discrepancy, again with that of this one.
    pub(super) fn refitted(&self, fit: &Fit) -> Result<Fit, String> {
        self.fit(fit.state.effects.clone(), &fit.knobs, &fit.state.numbers, Some(&fit.state))
    }
}

/// A problem with another discrepancy, and a fit of it; `None` where that of the given problem stands.
pub(super) type Settled = Option<(Problem, Fit)>;

/// What stands: problem and fit with another discrepancy, or else the given ones.
pub(super) fn here<'a>(settled: &'a Settled, problem: &'a Problem, fit: &'a Fit) -> (&'a Problem, &'a Fit) {
    settled.as_ref().map_or((problem, fit), |(problem, fit)| (problem, fit))
}

/// A fit's differences, and how they follow what is fitted, before they are weighed.
struct Near<'a> {
    fit: &'a Fit,
    residual: DVector<f64>,
    slopes: DMatrix<f64>,
    /// Knobs at a bound, which stay there.
    frozen: Vec<bool>,
}

impl<'a> Near<'a> {
    fn of(fit: &'a Fit) -> Self {
        let state = &fit.state;
        let mut slopes = fit.slopes.clone();
        for ((first, block), factor) in state.residual.blocks().zip(&state.factors) {
            let part = factor.l() * slopes.rows(first, block.size());
            slopes.rows_mut(first, block.size()).copy_from(&part);
        }
        let mut residual = state.differences();
        residual.rows_mut(0, state.modes.len()).copy_from(&state.residual.vector());
        let frozen = fit
            .knobs
            .iter()
            .map(|knob| knob.bounds.iter().any(|&bound| knob.is_at(state.value(knob), bound)))
            .collect();
        Self { fit, residual, slopes, frozen }
    }

    fn log_evidence(&self, problem: &Problem, sizes: &Discrepancy) -> Option<f64> {
        let (state, count) = (&self.fit.state, self.fit.knobs.len());
        let factors = problem.covariance_factors(&state.residual, sizes)?;
        let (mut differences, mut slopes) = (self.residual.clone(), self.slopes.clone());
        state.whiten_by(&factors, &mut differences);
        state.whiten_by(&factors, &mut slopes);
        let weights = state.weights_of(&differences, Loss::Robust);
        let jacobian = weighted(&slopes, &weights);
        let information = jacobian.tr_mul(&jacobian);
        let mut curvature = information.clone();
        for index in 0..curvature.nrows() {
            let is_frozen = self.frozen.get(index) == Some(&true);
            curvature[(index, index)] += match index < count {
                true if is_frozen => 1e12 * (1.0 + information[(index, index)]),
                true => 1e-12 + 1e-9 * information[(index, index)],
                false => 1.0,
            };
        }
        let mut gradient = jacobian.tr_mul(&differences.component_mul(&weights));
        let mut numbers = gradient.rows_mut(count, state.numbers.len());
        numbers += &state.numbers;
        let step = -Cholesky::new(curvature)?.solve(&gradient);
        differences += slopes * &step;
        let scatter = (&state.numbers + step.rows(count, state.numbers.len())).norm_squared();
        let size = information.nrows();
        let posterior = log_determinant(&Cholesky::new(information + DMatrix::identity(size, size))?);
        let volume: f64 = factors.iter().map(log_determinant).sum();
        let misfit = state.misfit_of(&differences, Loss::Robust);
        Some(-0.5 * (misfit + scatter + posterior + volume) + sizes.log_prior())
    }
}

/// Of a matrix, from its Cholesky factor.
pub(super) fn log_determinant(factor: &Cholesky<f64, Dyn>) -> f64 {
    factor.l_dirty().diagonal().iter().map(|value| 2.0 * value.ln()).sum()
}
