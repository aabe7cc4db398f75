//! The differences near a fit, as another discrepancy weighs them.
//!
//! A [`Fit`] flows in; its differences and how they follow what is fitted, before they are weighed, are kept, as they hang on no
//! discrepancy. With one, the evidence near the fit (Laplace's approximation) or a [`Marginal`] flows out, without another fit.

use std::sync::{Arc, OnceLock};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::discrepancy::{Discrepancy, SCATTER, log_determinant};
use super::error::DiagnoseError;
use super::evaluation::ShapeErrors;
use super::fit::{Fit, Marginal, weigh, weighted};
use super::misfit::Loss;
use super::problem::Problem;
use crate::model::effect::Effect;

/// A fit's differences, and how they follow what is fitted, before they are weighed.
pub(super) struct Near<'a> {
    pub(super) fit: &'a Fit,
    residual: DVector<f64>,
    slopes: DMatrix<f64>,
    /// The background's numbers, of which the first so many scatter segments.
    numbers: DVector<f64>,
    scatter: usize,
    /// Knobs at a bound, which stay there.
    frozen: Vec<bool>,
    /// What shapes may have wrong, made when first asked for.
    errors: OnceLock<Vec<ShapeErrors>>,
}

/// The same in standard deviations of measurement and discrepancy.
struct Weighed {
    factors: Vec<Cholesky<f64, Dyn>>,
    differences: DVector<f64>,
    slopes: DMatrix<f64>,
    /// The background's numbers, in units of how far segments scatter.
    numbers: DVector<f64>,
    /// Square roots of the weights of differences.
    weights: DVector<f64>,
}

/// Directions of the scatter that move what is measured by less than this many of its standard deviations are not seen.
const UNSEEN: f64 = 0.05;

/// Directions at right angles, numbers x directions, along which numbers that scatter segments this many times as far as a study states
/// move what is measured, whose weighted derivatives these are.
fn seen(by_scatter: &DMatrix<f64>, scatter: f64) -> DMatrix<f64> {
    let eigen = squares(by_scatter).symmetric_eigen();
    let least = (UNSEEN * scatter / SCATTER[1]).powi(2);
    let seen: Vec<usize> = (0..by_scatter.ncols()).filter(|&at| eigen.eigenvalues[at] > least).collect();
    eigen.eigenvectors.select_columns(&seen)
}

impl Problem {
    /// The same without directions of the segments' scatter that the measurement does not see, at the model with these effects. They tell
    /// nothing of effects and cost as much as the others: each segment of a tower of 38 has a number for its stiffness and one for its mass,
    /// and a dozen modes see a third of them.
    ///
    /// # Errors
    /// Where the model with these effects cannot be solved.
    pub(super) fn as_seen(&self, effects: &[Effect]) -> Result<Self, DiagnoseError> {
        let of_segments = self.background.first_of_groups();
        if of_segments == 0 {
            return Ok(self.clone());
        }
        let state =
            self.state_without_scatter(effects).map_err(|reason| DiagnoseError::no_structure(effects, reason))?;
        let by_background = state.by_background(self);
        let directions = seen(&by_background.columns(0, of_segments).into_owned(), self.background.times());
        let mut other = self.clone();
        other.background = self.background.along(&directions);
        other.reference = Arc::default();
        Ok(other)
    }
}

impl<'a> Near<'a> {
    pub(super) fn of(problem: &Problem, fit: &'a Fit) -> Self {
        let state = &fit.state;
        let mut slopes = fit.slopes.clone();
        state.unwhiten(&mut slopes);
        let mut residual = state.differences();
        residual.rows_mut(0, state.modes.len()).copy_from(&state.residual.vector());
        let frozen = fit
            .knobs
            .iter()
            .map(|knob| knob.bounds.iter().any(|&bound| knob.is_at(state.value(knob), bound)))
            .collect();
        let (numbers, scatter) = (state.numbers.clone(), problem.background.scatter());
        Self { fit, residual, slopes, numbers, scatter, frozen, errors: OnceLock::new() }
    }

    /// The same without directions of the scatter that the measurement does not see, with whatever discrepancy: where evidence is asked
    /// for often.
    pub(super) fn of_seen(problem: &Problem, fit: &'a Fit) -> Self {
        let mut near = Self::of(problem, fit);
        if let Some(directions) = near.seen(problem) {
            let (first, scatter, seen) = (fit.knobs.len(), near.scatter, directions.ncols());
            let slopes = near.slopes.columns(first, scatter) * &directions;
            let numbers = directions.tr_mul(&near.numbers.rows(0, scatter));
            // Directions are no more than there are numbers.
            near.slopes = near.slopes.remove_columns(first + seen, scatter - seen);
            near.slopes.columns_mut(first, seen).copy_from(&slopes);
            near.numbers = near.numbers.remove_rows(seen, scatter - seen);
            near.numbers.rows_mut(0, seen).copy_from(&numbers);
            near.scatter = seen;
        }
        near
    }

    /// Directions of the scatter's numbers that the measurement sees: numbers x directions, at right angles.
    fn seen(&self, problem: &Problem) -> Option<DMatrix<f64>> {
        if self.scatter == 0 {
            return None;
        }
        let state = &self.fit.state;
        let errors = self.errors.get_or_init(|| problem.errors(&state.residual));
        let factors = problem.factors_of(&state.residual, errors, &Discrepancy::NONE)?;
        let mut by_scatter = self.slopes.columns(self.fit.knobs.len(), self.scatter).into_owned();
        state.whiten_by(&factors, &mut by_scatter);
        Some(seen(&by_scatter, self.fit.discrepancy.scatter))
    }

    fn weighed(&self, problem: &Problem, sizes: &Discrepancy) -> Option<Weighed> {
        let (state, scatter) = (&self.fit.state, self.scatter);
        let errors = self.errors.get_or_init(|| problem.errors(&state.residual));
        let factors = problem.factors_of(&state.residual, errors, sizes)?;
        let (mut differences, mut slopes) = (self.residual.clone(), self.slopes.clone());
        let (mut numbers, times) = (self.numbers.clone(), sizes.scatter / self.fit.discrepancy.scatter);
        let mut of_scatter = numbers.rows_mut(0, scatter);
        of_scatter /= times;
        let mut by_scatter = slopes.columns_mut(self.fit.knobs.len(), scatter);
        by_scatter *= times;
        self.change_family(problem, sizes, &mut differences, &mut numbers, &mut slopes);
        state.whiten_by(&factors, &mut differences);
        state.whiten_by(&factors, &mut slopes);
        let weights = state.weights_of(&differences, &factors, Loss::Robust);
        Some(Weighed { factors, differences, slopes, numbers, weights })
    }

    /// What families of modes have in common, with another size: in units of it.
    fn change_family(
        &self,
        problem: &Problem,
        sizes: &Discrepancy,
        differences: &mut DVector<f64>,
        numbers: &mut DVector<f64>,
        slopes: &mut DMatrix<f64>,
    ) {
        let (state, families) = (&self.fit.state, problem.families.ncols());
        let first = numbers.len() - families;
        let mut of_families = numbers.rows_mut(first, families);
        let shift = problem.by_families(&state.residual, &self.fit.discrepancy) * &of_families;
        of_families *= self.fit.discrepancy.family_in_units_of(sizes);
        let shift = problem.by_families(&state.residual, sizes) * of_families - shift;
        for ((row, _), by) in state.residual.blocks().zip(shift.iter()) {
            differences[row] += by;
        }
        problem.set_families(&state.residual, sizes, self.fit.knobs.len() + first, slopes);
    }

    /// Logarithm of the evidence, up to what all discrepancies have in common: effects and background at their best, one step away.
    pub(super) fn log_evidence(&self, problem: &Problem, sizes: &Discrepancy) -> Option<f64> {
        let (state, count) = (&self.fit.state, self.fit.knobs.len());
        let Weighed { factors, mut differences, slopes: mut jacobian, numbers, weights } =
            self.weighed(problem, sizes)?;
        weigh(&mut jacobian, &weights);
        let information = squares(&jacobian);
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
        let mut by_numbers = gradient.rows_mut(count, numbers.len());
        by_numbers += &numbers;
        let step = -Cholesky::new(curvature)?.solve(&gradient);
        // A twin without weight is so far off that no step brings it near.
        let moved = jacobian * &step;
        let unweighted = moved.zip_map(&weights, |moved, weight| if weight > 0.0 { moved / weight } else { 0.0 });
        differences += unweighted;
        let scatter = (&numbers + step.rows(count, numbers.len())).norm_squared();
        let size = information.nrows();
        let posterior = log_determinant(&Cholesky::new(information + DMatrix::identity(size, size))?);
        let volume: f64 = factors.iter().map(log_determinant).sum();
        let misfit = state.misfit_of(&differences, &factors, Loss::Robust);
        Some(-0.5 * (misfit + scatter + posterior + volume) + sizes.log_prior())
    }

    /// The differences seen through what else is uncertain, and what is left of them, by weight, where the background does what it can;
    /// with a problem's discrepancy.
    pub(super) fn marginal(&self, problem: &Problem) -> Option<Marginal> {
        let Weighed { factors, differences, slopes, numbers, weights } = self.weighed(problem, &problem.discrepancy)?;
        let count = self.fit.knobs.len();
        // Without the scatter, which the projection finds again.
        let straight = differences - slopes.columns(count, numbers.len()) * &numbers;
        Marginal::of(weighted(&slopes, &weights), count, weights, factors, &straight)
    }
}

/// `AᵀA`: nalgebra's `tr_mul` does not go through the fast product.
pub(super) fn squares(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    matrix.transpose() * matrix
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::testing::{measured, scattered, study};
    use super::*;

    /// What the measurement does not see moves neither values nor evidence, whatever is in the model.
    #[test]
    fn a_fit_is_the_same_without_what_is_not_seen() {
        let (structure, model, sensors) = study();
        let effects: Vec<Effect> = vec!["added-mass@443.6m=2e6".parse().unwrap()];
        let truth = scattered(&structure, &model, 1.0, 3).and(&effects).unwrap();
        let modes = measured(&truth, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(3));
        let whole = Problem::new(structure, &effects, &model, &sensors, &modes).unwrap();
        let seen = whole.as_seen(&effects).unwrap();
        let numbers = |problem: &Problem| problem.background.scatter();
        assert!(2 * numbers(&seen) < numbers(&whole), "{} of {}", numbers(&seen), numbers(&whole));
        let [by_whole, by_seen] = [&whole, &seen].map(|problem| problem.present(&effects).unwrap());
        let [one, other] = [&by_whole, &by_seen].map(|fit| fit.estimates(0)[0].clone());
        let std = one.std.unwrap();
        assert!((one.value - other.value).abs() < 0.02 * std, "{one:?} {other:?}");
        assert!((other.std.unwrap() / std - 1.0).abs() < 0.02, "{one:?} {other:?}");
        let gain = |problem: &Problem, fit: &Fit| fit.log_evidence() - problem.present(&[]).unwrap().log_evidence();
        let (one, other) = (gain(&whole, &by_whole), gain(&seen, &by_seen));
        assert!((one - other).abs() < 0.3 + 0.01 * one.abs(), "{one} {other}");
    }

    /// The evidence of another discrepancy near a fit is that of a fit with it, but for what another step moves.
    #[test]
    fn evidence_near_a_fit_is_that_of_another_fit() {
        let (structure, model, sensors) = study();
        let truth = scattered(&structure, &model, 1.0, 3);
        let modes = measured(&truth, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(3));
        let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
        let fit = problem.present(&[]).unwrap();
        let near = Near::of_seen(&problem, &fit);
        let here = near.log_evidence(&problem, &fit.discrepancy).unwrap();
        let others = [
            Discrepancy { frequency: 0.003, shape: 0.005, ..fit.discrepancy },
            Discrepancy { family: 0.01, smooth: 0.004, growth: 1.0, ..fit.discrepancy },
            Discrepancy { scatter: 1.5, coupling: 0.006, ..fit.discrepancy },
        ];
        for sizes in others {
            let refitted = problem.with_discrepancy(sizes).refitted(&fit).unwrap();
            let exact = refitted.log_evidence() - fit.log_evidence();
            let close = near.log_evidence(&problem, &sizes).unwrap() - here;
            assert!((close - exact).abs() < 0.3 + 0.02 * exact.abs(), "{sizes:?}: {close} near, {exact} by a fit");
        }
    }
}
