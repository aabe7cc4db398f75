//! Whether what a fit leaves unexplained is within measurement and tolerance.
//!
//! A [`Fit`] flows in; chi-squared tests of all differences and of parts of them flow out.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::criteria::FAILS;
use super::discrepancy::Discrepancy;
use super::fit::Fit;
use super::problem::Problem;
use super::report::GoodnessOfFit;
use crate::compare::{Block, ChiSquared, exceeding};
use crate::model::effect::Effect;
use crate::modes::WRONGLY_IDENTIFIED;
use crate::statistics::at_least;

/// What a test looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// All differences and the background's scatter.
    All,
    /// Frequencies, by measurement and tolerance together.
    Frequencies,
    /// How far the background had to be bent.
    Scatter,
    /// Imaginary parts of shapes.
    Phases,
    /// How much the model would have to miss for reasons that no effect explains.
    Discrepancy,
}

/// Tests of a fit.
///
/// Hundreds of components of shapes would hide what a dozen frequencies or a scatter of five deviations say; those, and phases, are
/// therefore also tested by themselves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tests {
    /// Squared differences of modes and the background's scatter against what is expected of a right model: the numbers compared
    /// less the values fitted and what is allowed but not expected.
    pub all: ChiSquared,
    /// The part with the least probability.
    pub worst: Part,
    /// Its probability, corrected for how many parts were tested (Sidak 1967, J. Am. Stat. Assoc. 62, 626).
    pub p_value: f64,
}

/// The test of the model with its effects as they are written, as comparison, history and diagnosis state it, and what it had to allow for;
/// `None` where nothing can be compared. Their values count as fitted to these data, which `belfry add` has done.
pub fn fit_as_given(problem: &Problem, effects: &[Effect]) -> Option<(GoodnessOfFit, Discrepancy)> {
    let numbers = DVector::zeros(problem.background.size());
    let fit = problem.fit(effects.to_vec(), &[], &numbers, None).ok()?;
    let (problem, fit) = problem.at_its_best(&fit).unwrap_or_else(|| (problem.clone(), fit));
    let discrepancy = fit.discrepancy;
    let test = problem.as_if_fitted(fit).ok()?.goodness_as_stated(&problem);
    Some((test.into(), discrepancy))
}

impl Fit {
    /// The tests of this fit.
    pub fn goodness_of_fit(&self) -> Tests {
        self.tests_but_for_wrong().0
    }

    /// The same, and whether segments scatter no further than the study states: a diagnosis asks what is most probable and lets them, a
    /// reader asks whether the model is as good as it claims to be.
    pub(super) fn goodness_as_stated(&self, problem: &Problem) -> Tests {
        let tests = self.goodness_of_fit();
        let beyond = self.scatter_beyond(problem.background.scatter());
        match beyond.map(|p_value| sidak(p_value, PARTS)) {
            Some(p_value) if p_value < tests.p_value => Tests { worst: Part::Scatter, p_value, ..tests },
            _ => tests,
        }
    }

    /// Modes (indices into the measured ones) that identification may have got wrong: without them the fit passes, and so many happen; or
    /// their frequencies are outliers among those of the others, which one mode far off makes look missed.
    pub(super) fn wrong_modes(&self) -> Vec<usize> {
        let (tests, mut wrong) = self.tests_but_for_wrong();
        if tests.p_value < FAILS {
            return Vec::new();
        }
        wrong.extend(self.outlier().filter(|mode| !wrong.contains(mode)));
        wrong.sort_unstable();
        wrong
    }

    /// The mode whose frequency is an outlier: a t-test of the largest of n differences against the others, at 1 % for all of them (Grubbs
    /// 1969, Technometrics 11, 1).
    fn outlier(&self) -> Option<usize> {
        let squares: Vec<(usize, f64)> = self
            .state
            .residual
            .blocks()
            .map(|(first, block)| (block.measured, self.state.modes[first].powi(2)))
            .collect();
        let others = squares.len().checked_sub(1).filter(|_| squares.len() >= LEAST_MODES)? as f64;
        let (mode, largest) = squares.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let mean = (squares.iter().map(|(_, square)| square).sum::<f64>() - largest) / others;
        if mean <= 0.0 {
            return None;
        }
        let student = StudentsT::new(0.0, 1.0, others).ok()?;
        let chance = 2.0 * student.sf((largest / mean).sqrt());
        (chance * (others + 1.0) < FAILS).then_some(mode)
    }

    /// The tests with the highest probability over how many modes are wrong, and which: that so many are, times that of what the others
    /// leave.
    fn tests_but_for_wrong(&self) -> (Tests, Vec<usize>) {
        let strangers = self.strangers();
        let mut best = (self.tests(&strangers), Vec::new());
        let modes = self.state.pairs.len();
        if modes < LEAST_MODES {
            return best;
        }
        let beyond = |(first, block): (usize, &Block)| {
            let square = self.state.modes.rows(first, block.size()).norm_squared();
            (block.measured, square - block.size() as f64)
        };
        let mut worst: Vec<(usize, f64)> = self.state.residual.blocks().map(beyond).collect();
        worst.retain(|(mode, _)| !strangers.contains(mode));
        worst.sort_by(|a, b| b.1.total_cmp(&a.1));
        for count in 1..=worst.len() {
            let chance = at_least(count, modes, WRONGLY_IDENTIFIED);
            if chance < FAILS.max(best.0.p_value) {
                break;
            }
            let wrong: Vec<usize> = worst[..count].iter().map(|(mode, _)| *mode).collect();
            let tests = self.tests(&[&strangers[..], &wrong].concat());
            let p_value = chance * tests.p_value;
            if p_value > best.0.p_value {
                best = (Tests { p_value, ..tests }, wrong);
            }
        }
        best
    }

    /// Modes (indices into the measured ones) that are like none of the model's: of a floor, a wall or a section that a beam does not
    /// have. They say nothing about it, where they are few.
    pub(super) fn strangers(&self) -> Vec<usize> {
        let is_strange = |block: &&Block| block.shape.as_ref().is_some_and(|shape| shape.likeness() < ALIKE);
        let blocks = self.state.residual.blocks().map(|(_, block)| block);
        let strangers: Vec<usize> = blocks.filter(is_strange).map(|block| block.measured).collect();
        let modes = self.state.pairs.len();
        let are_few = modes >= LEAST_MODES && strangers.len() * MOST_STRANGERS <= modes;
        if are_few { strangers } else { Vec::new() }
    }

    /// Whether what it leaves is within measurement and tolerance.
    pub(super) fn passes(&self) -> bool {
        self.goodness_of_fit().p_value >= FAILS
    }

    /// The same, where identification has got no mode wrong.
    pub(super) fn passes_with_every_mode(&self) -> bool {
        self.tests(&self.strangers()).p_value >= FAILS
    }

    /// The tests without some modes.
    fn tests(&self, without: &[usize]) -> Tests {
        let state = &self.state;
        let blocks = state.residual.blocks().zip(&self.allowed);
        let kept: Vec<_> = blocks.filter(|((_, block), _)| !without.contains(&block.measured)).collect();
        let (square, expected) = kept.iter().fold((0.0, 0.0), |(square, expected), ((first, block), allowed)| {
            let rows = state.modes.rows(*first, block.size());
            (square + rows.norm_squared(), expected + block.size() as f64 - **allowed)
        });
        let freedom = (expected - self.knobs.len() as f64).round().max(1.0);
        let all = ChiSquared::of(square + state.numbers.norm_squared(), freedom as usize);
        let has_phases = !state.phases.is_empty();
        let phases = has_phases.then(|| ChiSquared::of(state.phases.norm_squared(), state.phases.len()));
        let rows: Vec<usize> = kept.iter().map(|((first, _), _)| *first).collect();
        let parts = [
            (Part::All, Some(all.p_value)),
            (Part::Frequencies, self.frequencies(&rows).map(|test| test.p_value)),
            (Part::Scatter, self.scatter()),
            (Part::Phases, phases.map(|test| test.p_value)),
            (Part::Discrepancy, self.discrepancy.p_value()),
        ];
        let tested = parts.iter().filter(|part| part.1.is_some()).count();
        let worst = parts.into_iter().filter_map(|(part, p_value)| Some((part, p_value?)));
        let (worst, p_value) = worst.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((Part::All, all.p_value));
        Tests { all, worst, p_value: sidak(p_value, tested) }
    }

    /// Derivatives without the weights of the robust loss, by knobs and by the background.
    fn derivatives(&self) -> (DMatrix<f64>, DMatrix<f64>) {
        let count = self.knobs.len();
        (
            self.slopes.columns(0, count).into_owned(),
            self.slopes.columns(count, self.slopes.ncols() - count).into_owned(),
        )
    }

    /// Frequencies against measurement and tolerance together: `yᵀ (I + G Gᵀ)⁻¹ y` with y the differences without the scatter
    /// and G their derivatives by it, after the effects' values have done for frequencies what they can.
    fn frequencies(&self, rows: &[usize]) -> Option<ChiSquared> {
        let state = &self.state;
        let (by_knobs, by_background) = self.derivatives();
        let by_background = by_background.select_rows(rows);
        let differences = state.modes.select_rows(rows) - &by_background * &state.numbers;
        let covariance = DMatrix::identity(rows.len(), rows.len()) + &by_background * by_background.transpose();
        let factor = Cholesky::new(covariance)?;
        let whiten = |columns: &DMatrix<f64>| factor.l_dirty().solve_lower_triangular(columns);
        let differences = whiten(&DMatrix::from_columns(&[differences]))?;
        // Knobs that frequencies do not see take no freedom.
        let (left, seen) = without_span(&differences, &whiten(&by_knobs.select_rows(rows))?);
        let freedom = rows.len().checked_sub(seen).filter(|freedom| *freedom > 0)?;
        Some(ChiSquared::of(left.norm_squared(), freedom))
    }

    /// Probability of so large a scatter. Estimated numbers scatter less than the true ones, by what the data cannot see of
    /// them: with the covariance A, `|b|²` has the mean tr A and the variance 2 tr A², and is taken for a multiple of a
    /// chi-squared number with these (Satterthwaite 1946).
    fn scatter(&self) -> Option<f64> {
        let numbers = &self.state.numbers;
        if numbers.is_empty() {
            return None;
        }
        let (by_knobs, by_background) = self.derivatives();
        let (seen, _) = without_span(&by_background, &by_knobs);
        let eigenvalues =
            seen.tr_mul(&seen).symmetric_eigenvalues().map(|value| value.max(0.0) / (1.0 + value.max(0.0)));
        let (mean, square) = (eigenvalues.sum(), eigenvalues.norm_squared());
        if mean < LEAST_SCATTER {
            return None;
        }
        let scale = square / mean;
        Some(exceeding(numbers.norm_squared() / scale, mean / scale))
    }

    /// Probability that segments which scatter as far as the study states are fitted with as large a scatter, by the first `count` numbers;
    /// `None` where they are fitted with no more than it states. With s the fitted size, numbers have the prior variance s², so what data of
    /// the information v say of a number of variance 1 has the variance `v (1 + v) / (v + 1/s²)²`.
    fn scatter_beyond(&self, count: usize) -> Option<f64> {
        let times = self.discrepancy.scatter;
        if times <= self.discrepancy.expected_scatter || count == 0 {
            return None;
        }
        let (by_knobs, by_background) = self.derivatives();
        let (seen, _) = without_span(&by_background.columns(0, count).into_owned(), &by_knobs);
        let variance = |squared: f64| {
            let information = squared.max(0.0) / (times * times);
            information * (1.0 + information) / (information + times.powi(-2)).powi(2)
        };
        let variances = seen.tr_mul(&seen).symmetric_eigenvalues().map(variance);
        let (mean, square) = (variances.sum(), variances.norm_squared());
        let scale = square / mean;
        let numbers = self.state.numbers.rows(0, count).norm_squared() * times * times;
        (mean >= LEAST_SCATTER).then(|| exceeding(numbers / scale, mean / scale))
    }
}

/// How many parts a fit is tested by.
const PARTS: usize = 5;

/// Probability that the least of so many p-values is as small: `1 - (1 - p)^n`, also where p is tiny.
fn sidak(p_value: f64, tested: usize) -> f64 {
    -f64::exp_m1(tested as f64 * f64::ln_1p(-p_value.min(1.0)))
}

/// A mode that has less of its shape in common with the model's is like none of them (a MAC).
const ALIKE: f64 = 0.8;
/// At most one of so many modes may be a stranger.
const MOST_STRANGERS: usize = 5;
/// With fewer modes than this none may stay unexplained.
const LEAST_MODES: usize = 8;

/// Where the data determine less than this of the scatter's variance there is nothing to test.
const LEAST_SCATTER: f64 = 0.5;
/// Directions shorter than this share of the longest are taken as zero.
const NEGLIGIBLE: f64 = 1e-6;

/// Columns less what lies in the span of others, and the rank of those.
fn without_span(columns: &DMatrix<f64>, others: &DMatrix<f64>) -> (DMatrix<f64>, usize) {
    let others: Vec<DVector<f64>> =
        others.column_iter().filter(|column| column.norm() > 0.0).map(|column| column.normalize()).collect();
    if others.is_empty() {
        return (columns.clone(), 0);
    }
    let decomposition = DMatrix::from_columns(&others).svd(true, false);
    let Some(directions) = decomposition.u else { return (columns.clone(), 0) };
    let is_kept = |at: &usize| decomposition.singular_values[*at] > NEGLIGIBLE;
    let kept: Vec<usize> = (0..decomposition.singular_values.len()).filter(is_kept).collect();
    let directions = directions.select_columns(&kept);
    (columns - &directions * directions.tr_mul(columns), kept.len())
}
