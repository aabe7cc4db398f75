//! A model with certain effects and a certain background, compared with the measurement.
//!
//! `evaluation` makes a state from effects and background; whitened differences, their weights and what they cost together
//! flow out, to `derivatives` and `fit`.

use std::sync::{Arc, OnceLock};

use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dim, Dyn, Matrix, RowDVector, StorageMut};

use super::derivatives::BySegments;
use super::knob::Knob;
use super::misfit::{Group, Loss, TWIN};
use crate::compare::{Block, Following, ModelView, Pair, Residual};
use crate::model::effect::Effect;
use crate::model::{Assembly, Responses, Structure};
use crate::modes::WRONG_BY;

/// A model compared with the measurement.
pub(super) struct State {
    /// Effects in the model.
    pub(super) effects: Vec<Effect>,
    /// The background's numbers.
    pub(super) numbers: DVector<f64>,
    /// The structure with both, and its modes; states that differ by how they are weighed share it.
    pub(super) model: Arc<Modelled>,
    /// Which modes belong together, one pair for each measured mode.
    pub(super) pairs: Vec<Pair>,
    /// Measured modes that are taken for noise.
    pub(super) twins_left: usize,
    /// How many of the paired modes are twins, the last ones.
    pub(super) twins: usize,
    /// The differences of modes.
    pub(super) residual: Residual,
    /// Cholesky factors of each block's covariance.
    pub(super) factors: Vec<Cholesky<f64, Dyn>>,
    /// Differences of modes in standard deviations.
    pub(super) modes: DVector<f64>,
    /// Differences of phases in standard deviations.
    pub(super) phases: DVector<f64>,
    /// Differences of damping in standard deviations.
    pub(super) damping: DVector<f64>,
    /// The model's modes in use, ascending.
    pub(super) models: Vec<usize>,
    /// How these, and the differences, follow a change of the structure, made when first asked for.
    pub(super) slopes: Arc<Slopes>,
}

/// A structure with its modes, as the sensors see them.
pub(super) struct Modelled {
    /// The structure.
    pub(super) structure: Structure,
    /// Its matrices.
    pub(super) assembly: Assembly,
    /// Its modes.
    pub(super) view: ModelView,
    /// By how much each sensor is late.
    pub(super) delays_s: Option<RowDVector<f64>>,
}

/// How a state's modes and differences, before they are weighed, follow a change of its structure.
#[derive(Default)]
pub(super) struct Slopes {
    /// The modes, by forces at the DOFs.
    pub(super) responses: OnceLock<Responses>,
    /// The differences; `None` where dashpots move a mode.
    pub(super) following: OnceLock<Option<Following>>,
    /// The differences, by what is not trusted of segments, masses and sections; `None` where that is nothing.
    pub(super) by_segments: OnceLock<Option<BySegments>>,
}

impl State {
    /// Frequencies and shapes, mode by mode, where these are the factors of the blocks' covariances: identification may have deviations
    /// wrong, but not what the model misses.
    fn groups(&self, factors: &[Cholesky<f64, Dyn>]) -> Vec<Group> {
        let mut groups = Vec::new();
        let paired = self.pairs.len() - self.twins;
        for ((first, block), factor) in self.residual.blocks().zip(factors) {
            let is_twin = block.measured >= paired;
            // The part of a number's variance that the measurement makes.
            let measured = |row: usize| {
                let all = factor.l_dirty().row(row).columns(0, row + 1).norm_squared();
                (block.covariance[(row, row)] / all).min(1.0)
            };
            let wrong_by = |by: f64, measured: f64| (by.mul_add(by, -1.0)).mul_add(measured, 1.0).sqrt();
            groups.push(Group { first, count: 1, wrong_by: wrong_by(WRONG_BY[0], measured(0)), is_twin });
            let count = block.size() - 1;
            if count > 0 {
                let mean = (1..=count).map(measured).sum::<f64>() / count as f64;
                groups.push(Group { first: first + 1, count, wrong_by: wrong_by(WRONG_BY[1], mean), is_twin });
            }
        }
        groups
    }

    /// Twice the negative logarithm of the likelihood, up to a constant. A few modes may have deviations that are wrong by a
    /// factor: squared differences q of n numbers count as `-2 ln((1 - e) exp(-q/2) + e k^-n exp(-q/2k²))` (Tukey's
    /// contaminated normal distribution, 1960). One mode that identification got wrong then weighs less, and one that the
    /// model has wrong still weighs.
    pub(super) fn misfit(&self, loss: Loss) -> f64 {
        self.misfit_of(&self.differences(), &self.factors, loss)
    }

    /// The same of other differences, with other covariances.
    pub(super) fn misfit_of(&self, differences: &DVector<f64>, factors: &[Cholesky<f64, Dyn>], loss: Loss) -> f64 {
        let of = |group: Group| {
            let square = differences.rows(group.first, group.count).norm_squared();
            match loss {
                Loss::Squares => square,
                Loss::Robust => group.misfit(square).0 + group.offset(),
            }
        };
        // A false mode has its price too.
        let left = 2.0 * TWIN * self.twins_left as f64;
        let phases = differences.rows(self.modes.len(), self.phases.len()).norm_squared();
        let damping = differences.rows(self.modes.len() + self.phases.len(), self.damping.len());
        let damping: f64 = damping.iter().map(|difference| Group::of_damping().misfit(difference * difference).0).sum();
        self.groups(factors).into_iter().map(of).sum::<f64>() + phases + damping + left
    }

    /// Square roots of the weights with which differences count at this state, so that weighted squares have the gradient
    /// of [`State::misfit`].
    pub(super) fn weights(&self, loss: Loss) -> DVector<f64> {
        self.weights_of(&self.differences(), &self.factors, loss)
    }

    /// The same of other differences, with other covariances.
    pub(super) fn weights_of(
        &self,
        differences: &DVector<f64>,
        factors: &[Cholesky<f64, Dyn>],
        loss: Loss,
    ) -> DVector<f64> {
        let mut weights = DVector::from_element(self.size(), 1.0);
        for index in self.modes.len() + self.phases.len()..self.size() {
            weights[index] = Group::of_damping().misfit(differences[index] * differences[index]).1.sqrt();
        }
        if loss == Loss::Squares {
            return weights;
        }
        for group in self.groups(factors) {
            let square = differences.rows(group.first, group.count).norm_squared();
            weights.rows_mut(group.first, group.count).fill(group.misfit(square).1.sqrt());
        }
        weights
    }

    /// All differences in standard deviations: of modes, then of phases, then of damping.
    pub(super) fn differences(&self) -> DVector<f64> {
        self.joined(self.modes.clone(), &self.phases, &self.damping)
    }

    pub(super) fn joined(&self, modes: DVector<f64>, phases: &DVector<f64>, damping: &DVector<f64>) -> DVector<f64> {
        let (first, second) = (modes.len(), phases.len());
        let mut all = modes.resize_vertically(self.size(), 0.0);
        all.rows_mut(first, second).copy_from(phases);
        all.rows_mut(first + second, damping.len()).copy_from(damping);
        all
    }

    /// How many differences there are.
    pub(super) fn size(&self) -> usize {
        self.modes.len() + self.phases.len() + self.damping.len()
    }

    /// Whether another state of the same model has differences of the same modes at the same sensors, which follow the model alike.
    pub(super) fn is_compared_like(&self, other: &State) -> bool {
        let are_alike = |((_, own), (_, other)): ((usize, &Block), (usize, &Block))| {
            own.measured == other.measured && own.models() == other.models() && own.sensors() == other.sensors()
        };
        self.pairs == other.pairs
            && self.size() == other.size()
            && self.residual.blocks().zip(other.residual.blocks()).all(are_alike)
    }

    /// By how much the differences of modes that have a partner in both, and of phases, are others than those of `other`;
    /// `None` where those are not the same numbers.
    pub(super) fn moved_from(&self, other: &State) -> Option<DVector<f64>> {
        let twins: usize = self
            .residual
            .blocks()
            .filter(|(_, block)| block.measured >= self.pairs.len() - self.twins)
            .map(|(_, block)| block.size())
            .sum();
        let paired = self.modes.len() - twins;
        let same = self.differences().remove_rows(paired, twins);
        (same.len() == other.size()).then(|| same - other.differences())
    }

    /// Frequency of the model mode that belongs to a measured one; `None` for a twin without a partner.
    pub(super) fn frequency_of(&self, measured: usize) -> Option<f64> {
        Some(self.model.view.modes.frequency_hz[self.pairs.get(measured)?.model])
    }

    /// Differences of modes in standard deviations.
    pub(super) fn whiten(&self, mut vector: DVector<f64>) -> DVector<f64> {
        self.whiten_by(&self.factors, &mut vector);
        vector
    }

    /// Brings differences of modes (rows) into the standard deviations of covariances with these Cholesky factors, block by block.
    pub(super) fn whiten_by<C: Dim, S: StorageMut<f64, Dyn, C>>(
        &self,
        factors: &[Cholesky<f64, Dyn>],
        differences: &mut Matrix<f64, Dyn, C, S>,
    ) {
        for ((first, block), factor) in self.residual.blocks().zip(factors) {
            let mut part = differences.rows_mut(first, block.size());
            // Columns are solved for one after the other; where there are many, an inverse and a fast product are less.
            if part.ncols() > block.size() {
                let whitened = inverse_of_lower(factor.l_dirty()) * &part;
                part.copy_from(&whitened);
            } else {
                factor.l_dirty().solve_lower_triangular_mut(&mut part);
            }
        }
    }

    /// Brings differences of modes (rows) out of the standard deviations of this state's covariances.
    pub(super) fn unwhiten(&self, differences: &mut DMatrix<f64>) {
        for (first, block, factor) in self.blocks() {
            let part = factor.l() * differences.rows(first, block.size());
            differences.rows_mut(first, block.size()).copy_from(&part);
        }
    }

    /// Blocks of numbers that are compared, each with the place of its first number and the Cholesky factor of its covariance.
    pub(super) fn blocks(&self) -> impl Iterator<Item = (usize, &Block, &Cholesky<f64, Dyn>)> {
        self.residual.blocks().zip(&self.factors).map(|((first, block), factor)| (first, block, factor))
    }

    /// What whitened differences cost by the robust loss, and the squares of frequencies among them.
    pub(super) fn misfit_and_frequencies(
        &self,
        differences: &DVector<f64>,
        factors: &[Cholesky<f64, Dyn>],
    ) -> [f64; 2] {
        let of_frequencies = self.residual.blocks().map(|(first, _)| differences[first].powi(2)).sum();
        [self.misfit_of(differences, factors, Loss::Robust), of_frequencies]
    }

    /// By how much (ln f) the frequency moves that moves most, of whitened derivatives of the differences.
    pub(super) fn largest_shift(&self, slopes: DVectorView<'_, f64>) -> f64 {
        // A block's first number is its frequency's, which Cholesky's factor leaves to itself.
        let shift = |(first, _, factor): (usize, &Block, &Cholesky<f64, Dyn>)| factor.l_dirty()[(0, 0)] * slopes[first];
        self.blocks().map(shift).fold(0.0, |most, shift| most.max(shift.abs()))
    }

    /// The value of a knob.
    pub(super) fn value(&self, knob: &Knob) -> f64 {
        self.effects[knob.effect].parameters().nth(knob.parameter).map_or(knob.neutral, |(_, value)| value)
    }
}

/// The inverse of the lower triangle of a matrix, which has no zero on its diagonal; what is above the triangle does not count.
fn inverse_of_lower(lower: &DMatrix<f64>) -> DMatrix<f64> {
    let size = lower.nrows();
    let mut inverse = DMatrix::identity(size, size);
    for (first, column) in inverse.as_mut_slice().chunks_exact_mut(size.max(1)).enumerate() {
        for at in first..size {
            let below = &lower.as_slice()[at * size..(at + 1) * size];
            let value = column[at] / below[at];
            column[at] = value;
            for (number, factor) in column[at + 1..].iter_mut().zip(&below[at + 1..]) {
                *number -= value * factor;
            }
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_of_a_triangle_undoes_it() {
        // Above the triangle stands what a factor leaves there.
        let lower = DMatrix::from_row_slice(3, 3, &[2.0, 7.0, 9.0, -1.0, 0.5, 8.0, 3.0, 4.0, -5.0]);
        let product = inverse_of_lower(&lower) * lower.lower_triangle();
        assert!((product - DMatrix::identity(3, 3)).amax() < 1e-15);
    }
}
