//! Whether what a fit leaves unexplained is within measurement and tolerance.
//!
//! A [`Fit`] flows in; chi-squared tests of all differences and of parts of them flow out.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::criteria::FAILS;
use super::fit::Fit;
use crate::compare::{Block, ChiSquared, exceeding};

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
/// Deviations of shapes have floors, so that hundreds of components would hide what a dozen frequencies or a scatter of five
/// deviations say; those, and phases, are therefore also tested by themselves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tests {
    /// Squared differences of modes and the background's scatter against the numbers compared less the values fitted.
    pub all: ChiSquared,
    /// The part with the least probability.
    pub worst: Part,
    /// Its probability, times how many parts were tested (Bonferroni).
    pub p_value: f64,
}

impl Fit {
    /// The tests of this fit.
    pub fn goodness_of_fit(&self) -> Tests {
        self.tests(&self.strangers())
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

    /// Whether it fits where `present` does not: all modes, or all but one that stays far off, as identification may get one
    /// wrong, where nine tenths of what the others left beyond scatter are gone.
    pub(super) fn explains(&self, present: &Fit) -> bool {
        self.goodness_of_fit().p_value >= FAILS || self.odd_one(present).is_some()
    }

    /// The one mode (index into the measured ones) but for which it fits.
    pub(super) fn odd_one(&self, present: &Fit) -> Option<usize> {
        // Of the other modes: squared differences, and how many there are.
        let others = |fit: &Fit, mode: usize| {
            let blocks = fit.state.residual.blocks().filter(|(_, block)| block.measured != mode);
            blocks.fold((0.0, 0), |(square, count), (first, block)| {
                (square + fit.state.modes.rows(first, block.size()).norm_squared(), count + block.size())
            })
        };
        let left = |fit: &Fit, mode: usize| others(fit, mode).0;
        let beyond = |fit: &Fit, mode: usize| {
            let (square, count) = others(fit, mode);
            (square - count as f64).max(0.0)
        };
        let modes = self.state.pairs.len();
        let worst = (0..modes).min_by(|&a, &b| left(self, a).total_cmp(&left(self, b)))?;
        let is_enough = modes >= LEAST_MODES && beyond(self, worst) < LEFT * beyond(present, worst);
        let others = || [self.strangers(), vec![worst]].concat();
        let fits_but_for_it = || self.goodness_of_fit().p_value < FAILS && self.tests(&others()).p_value >= FAILS;
        (is_enough && fits_but_for_it()).then_some(worst)
    }

    /// The tests without some modes.
    fn tests(&self, without: &[usize]) -> Tests {
        let state = &self.state;
        let kept = || state.residual.blocks().filter(|(_, block)| !without.contains(&block.measured));
        let (square, count) = kept().fold((0.0, 0), |(square, count), (first, block)| {
            (square + state.modes.rows(first, block.size()).norm_squared(), count + block.size())
        });
        let freedom = count.saturating_sub(self.knobs.len()).max(1);
        let all = ChiSquared::of(square + state.numbers.norm_squared(), freedom);
        let has_phases = !state.phases.is_empty();
        let phases = has_phases.then(|| ChiSquared::of(state.phases.norm_squared(), state.phases.len()));
        let rows: Vec<usize> = kept().map(|(first, _)| first).collect();
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
        Tests { all, worst, p_value: (p_value * tested as f64).min(1.0) }
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
}

/// A mode that has less of its shape in common with the model's is like none of them (a MAC).
const ALIKE: f64 = 0.8;
/// At most one of so many modes may be a stranger.
const MOST_STRANGERS: usize = 5;
/// With fewer modes than this none may stay unexplained.
const LEAST_MODES: usize = 8;
/// Share of the other modes' squared differences beyond scatter that may be left then.
const LEFT: f64 = 0.1;
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
