//! From effects and background to a [`State`]: the structure with both is assembled, its modes are paired with the measured ones
//! and the differences are whitened.

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dyn};

use super::discrepancy::Discrepancy;
use super::problem::Problem;
use super::state::{Modelled, Slopes, State};
use crate::compare::{Block, ModelView, Pair, Residual, ShapeBlock, candidates, pair_above};
use crate::model::effect::Effect;
use crate::model::{Assembly, EigenError, ModalBasis, Structure};
use crate::modes::MeasuredMode;

/// Least likeness of a pair. Every measured mode must find a partner, or effects could take values that make the modes that
/// they do not explain disappear.
pub(super) const LEAST_LIKENESS: f64 = 1e-6;
/// Where only the lowest modes are looked for: so many above those that are paired have exact shapes, so that pairs may change, there are so
/// many times as many in all, for the speed with which these are found, and so many more than can be paired.
const MORE_SHARP: usize = 3;
const LEAST_RATIO: usize = 2;
const MORE_MODES: usize = 10;
/// Modes further apart than this (ln f) do not mix.
const FAR: f64 = 0.25;
/// Sections rack by about this share of their rotation in the middle mode, and by the square of the ratio of frequencies more in others, as
/// the inertia does that makes them: tubes of another finite element code by 0.006 to 0.01 in their first mode of torsion and 0.08 to 0.09 in
/// the second, lattices by 0.001 to 0.003 and 0.002 to 0.01. Stiff floors do not; no table says which it is.
const RACKING: f64 = 0.01;
/// A mode whose damping a dashpot raises by this share is one that it moves.
const DAMPED: f64 = 0.3;
/// Damping of a structure's modes scatters by this factor (standard deviation of its logarithm).
pub(super) const SCATTER_OF_DAMPING: f64 = 0.5;

/// What the shape of a block may have wrong.
pub(super) struct ShapeErrors {
    turns: Vec<Turn>,
    /// One standard deviation of what sections that rack add along the block's numbers.
    racked: Option<DVector<f64>>,
    /// Covariance of a smooth error of unit size along the block's directions.
    smooth: DMatrix<f64>,
}

/// How a block changes where its mode turns towards a neighbour.
pub(super) struct Turn {
    /// How far apart the two frequencies are (ln f).
    apart: f64,
    /// The neighbour's shape along the block's numbers.
    along: DVector<f64>,
}

impl Turn {
    /// By a coupling of this size.
    fn by(&self, coupling: f64) -> DVector<f64> {
        &self.along * (0.5 * coupling / self.apart).min(1.0)
    }
}

impl Problem {
    /// The model with effects and background, compared with the measurement; eigenvectors are reused from `previous` where
    /// its matrices are the same.
    pub(super) fn state(
        &self,
        effects: Vec<Effect>,
        numbers: DVector<f64>,
        previous: Option<&State>,
    ) -> Result<State, String> {
        let mut structure = self.bare.clone();
        self.background.apply(&numbers, &mut structure);
        let structure = structure.and(&effects).map_err(|error| error.to_string())?;
        let assembly = structure.assemble();
        let rows = assembly.sensor_rows(&self.sensors).map_err(|error| error.to_string())?;
        let is_same = |previous: &State| {
            let before = &previous.model.assembly;
            before.stiffness == assembly.stiffness && before.mass == assembly.mass
        };
        let basis = match previous {
            Some(previous) if is_same(previous) => Ok(previous.model.view.basis.clone()),
            Some(previous) => self.basis_near(previous, &assembly).map(Arc::new),
            None => assembly.modal_basis().map(Arc::new),
        };
        let basis = basis.map_err(|error| error.to_string())?;
        let delays_s = assembly.sensing.delays_s(&self.sensors);
        let damped = assembly.damped_modes(&basis).map_err(|error| error.to_string())?;
        let view = ModelView::of_basis(basis, damped, rows, delays_s.clone());
        let state = self.compared(Arc::new(Modelled { structure, assembly, view, delays_s }), effects, numbers)?;
        if state.models.last().is_none_or(|highest| *highest < state.model.view.basis.sharp()) {
            return Ok(state);
        }
        // A mode is paired that is higher than those that were looked for closely.
        self.state(state.effects, state.numbers, None)
    }

    /// Eigenvectors of a structure near that of another state: as many as measured modes may be paired with.
    fn basis_near(&self, other: &State, assembly: &Assembly) -> Result<ModalBasis, EigenError> {
        let Modelled { view, .. } = other.model.as_ref();
        let sharp = other.models.last().map_or(0, |highest| highest + 1 + MORE_SHARP);
        let needed = candidates(view, &self.measured).max(LEAST_RATIO * sharp);
        let there = view.basis.vectors.ncols();
        // As many as before, where these are enough: with softer segments a mode more comes within reach.
        let is_enough = (needed + MORE_MODES / 2..=needed + MORE_MODES).contains(&there);
        let count = if is_enough { there } else { needed + MORE_MODES };
        assembly.modal_basis_near(&view.basis, sharp, count)
    }

    /// The same with the structure and the effects of `other`, whose background has the same segments with its own numbers and its own
    /// size of scatter.
    pub(super) fn state_like(&self, other: &State, numbers: DVector<f64>) -> Result<State, String> {
        let mut state = self.compared(other.model.clone(), other.effects.clone(), numbers)?;
        if state.is_compared_like(other) {
            state.slopes = other.slopes.clone();
        }
        Ok(state)
    }

    /// A structure with its effects and background, compared with the measurement.
    fn compared(&self, model: Arc<Modelled>, effects: Vec<Effect>, numbers: DVector<f64>) -> Result<State, String> {
        let Modelled { structure, assembly, view, .. } = model.as_ref();
        let measured = self.seen_by(structure);
        let pairs = pair_above(view, measured, LEAST_LIKENESS);
        if pairs.len() < measured.len() {
            return Err("a measured mode has no partner".to_owned());
        }
        let partners = |pair: &Pair| {
            let mut models: Vec<usize> =
                self.close[pair.measured].iter().filter_map(|&close| Some(pairs.get(close)?.model)).collect();
            // Modes that dashpots damp overlap each other, and are seen together: half-power bands meet.
            if let Some(ratio) = self.damping[pair.measured].filter(|_| structure.dampers() > 0) {
                let hz = &view.modes.frequency_hz;
                let is_damped = |model: usize| view.damping_ratio(model) > DAMPED * self.ordinary_damping;
                let overlaps = |&model: &usize| {
                    let other = self.ordinary_damping + view.damping_ratio(model);
                    (hz[model] / hz[pair.model]).ln().abs() < ratio + other && is_damped(pair.model) && is_damped(model)
                };
                models.extend((0..hz.len()).filter(overlaps));
            }
            models.sort_unstable();
            models.dedup();
            models
        };
        let mut residual = Residual::of(view, measured, &pairs, &partners);
        if self.discrepancy.family > 0.0 {
            residual.shift_frequencies(&(self.by_families(&residual, &self.discrepancy) * self.of_families(&numbers)));
        }
        // As the model given first has it, so that what is weighed by it does not move with what is fitted.
        let mut racking = self.racking.as_ref().clone();
        assembly.sensing.record(&mut racking, &self.sensors);
        residual.note_racking(&racking);
        let twins_left = self.measured.len() - measured.len();
        let factors = self.covariance_factors(&residual, &self.discrepancy);
        let factors = factors.ok_or("the covariance of a measured mode is not positive definite")?;
        let models = residual.models();
        let mut state = State {
            modes: DVector::zeros(0),
            phases: DVector::zeros(0),
            damping: DVector::zeros(0),
            effects,
            numbers,
            twins_left,
            twins: measured.len() - self.paired,
            pairs,
            residual,
            factors,
            models,
            slopes: Arc::new(Slopes::default()),
            model,
        };
        state.modes = state.whiten(state.residual.vector());
        state.phases = self.phase_differences(&state, &state.model.view);
        state.damping = self.damping_differences(&state);
        if state.differences().iter().all(|value| value.is_finite()) {
            Ok(state)
        } else {
            Err("a difference is no finite number".to_owned())
        }
    }

    /// The model with effects as it is given, without scatter.
    pub(super) fn state_without_scatter(&self, effects: &[Effect]) -> Result<State, String> {
        self.state(effects.to_vec(), DVector::zeros(self.background.size()), None)
    }

    /// The numbers of families of modes.
    pub(super) fn of_families<'a>(&self, numbers: &'a DVector<f64>) -> DVectorView<'a, f64> {
        numbers.rows(self.background.first_of_families(), self.families.ncols())
    }

    /// How the difference of ln f of each block follows these numbers, with a discrepancy.
    pub(super) fn by_families(&self, residual: &Residual, discrepancy: &Discrepancy) -> DMatrix<f64> {
        let modes: Vec<usize> = residual.blocks().map(|(_, block)| block.measured).collect();
        let mut shares = self.families.select_rows(&modes);
        for (mut row, &mode) in shares.row_iter_mut().zip(&modes) {
            row *= discrepancy.family * discrepancy.grown(self.measured[mode].frequency_hz, self.middle_hz);
        }
        shares
    }

    /// Writes that into columns of derivatives, before they are weighed.
    pub(super) fn set_families(
        &self,
        residual: &Residual,
        discrepancy: &Discrepancy,
        first_column: usize,
        slopes: &mut DMatrix<f64>,
    ) {
        let by_families = self.by_families(residual, discrepancy);
        for ((first, _), row) in residual.blocks().zip(by_families.row_iter()) {
            slopes.view_mut((first, first_column), (1, row.len())).copy_from(&row);
        }
    }

    /// Cholesky factors of the blocks' covariances; `None` where one is not positive definite.
    pub(super) fn covariance_factors(
        &self,
        residual: &Residual,
        discrepancy: &Discrepancy,
    ) -> Option<Vec<Cholesky<f64, Dyn>>> {
        self.factors_of(residual, &self.errors(residual), discrepancy)
    }

    /// The same where the errors that blocks may have are known.
    pub(super) fn factors_of(
        &self,
        residual: &Residual,
        errors: &[ShapeErrors],
        discrepancy: &Discrepancy,
    ) -> Option<Vec<Cholesky<f64, Dyn>>> {
        let factor = |((_, block), errors): ((usize, &Block), &ShapeErrors)| {
            Cholesky::new(self.covariance(block, errors, discrepancy))
        };
        residual.blocks().zip(errors).map(factor).collect()
    }

    /// A block's covariance by the measurement and by a discrepancy of the model: of the frequency, of the shape at each sensor and
    /// smoothly over the height, and by how far neighbouring modes turn.
    fn covariance(&self, block: &Block, errors: &ShapeErrors, discrepancy: &Discrepancy) -> DMatrix<f64> {
        let mut covariance = block.covariance.clone();
        let mode = &self.measured[block.measured];
        let grown = discrepancy.grown(mode.frequency_hz, self.middle_hz);
        covariance[(0, 0)] += (grown * discrepancy.frequency).powi(2);
        let Some(shape) = &block.shape else { return covariance };
        // Directions are of unit length and at right angles, so what is independent at sensors is independent along them.
        let local = (grown * discrepancy.shape * shape.largest()).powi(2);
        for index in 1..block.size() {
            covariance[(index, index)] += local;
        }
        if discrepancy.smooth > 0.0 {
            let size = (grown * discrepancy.smooth * shape.largest()).powi(2);
            let mut of_shape = covariance.view_mut((1, 1), (block.size() - 1, block.size() - 1));
            of_shape += &errors.smooth * size;
        }
        let turns = &errors.turns;
        if !turns.is_empty() {
            let turned: Vec<DVector<f64>> = turns.iter().map(|turn| turn.by(discrepancy.coupling)).collect();
            let turned = DMatrix::from_columns(&turned);
            covariance += &turned * turned.transpose();
        }
        if let Some(racked) = &errors.racked {
            covariance += racked * racked.transpose();
        }
        covariance
    }

    /// How each block's mode turns towards its neighbours, and how its shape may err smoothly.
    pub(super) fn errors(&self, residual: &Residual) -> Vec<ShapeErrors> {
        let of_block = |(_, block): (usize, &Block)| match &block.shape {
            Some(shape) => ShapeErrors {
                turns: self.turns_of(block, shape),
                racked: self.racked(block),
                smooth: self.smooth_of(shape),
            },
            None => ShapeErrors { turns: Vec::new(), racked: None, smooth: DMatrix::zeros(0, 0) },
        };
        residual.blocks().map(of_block).collect()
    }

    /// Covariance of a smooth error of unit size along a block's directions.
    fn smooth_of(&self, shape: &ShapeBlock) -> DMatrix<f64> {
        let at_sensors = self.smooth.select_rows(&shape.sensors).select_columns(&shape.sensors);
        shape.directions.transpose() * at_sensors * &shape.directions
    }

    /// One standard deviation of what sections that rack add to a block's numbers; `None` where it is nothing.
    fn racked(&self, block: &Block) -> Option<DVector<f64>> {
        let size = RACKING * (self.measured[block.measured].frequency_hz / self.middle_hz).powi(2);
        Some(block.racked.as_ref()? * size)
    }

    fn turns_of(&self, block: &Block, shape: &ShapeBlock) -> Vec<Turn> {
        let mode = &self.measured[block.measured];
        let towards = |(index, other): (usize, &MeasuredMode)| {
            let apart = (mode.frequency_hz / other.frequency_hz).ln().abs();
            let other = other.shape.as_ref().filter(|other| other.sensors == shape.sensors)?;
            if self.close[block.measured].contains(&index) || apart > FAR {
                return None;
            }
            let along = shape.directions.tr_mul(&other.values.normalize()).insert_row(0, 0.0);
            Some(Turn { apart, along })
        };
        self.measured.iter().enumerate().filter_map(towards).collect()
    }

    /// How much smaller the squared differences of each block of a fit are to be expected than the numbers compared: the coupling and the
    /// racking that are always allowed are bounds for what directions, supports and sections do, not what they do. Of `E q = tr(P S)`, P
    /// what a fit leaves (`slopes` with the `covariance` of what is fitted), S without these.
    pub(super) fn allowed(&self, state: &State, slopes: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Vec<f64> {
        let of_block = |(first, block, factor): (usize, &Block, &Cholesky<f64, Dyn>)| {
            let Some(shape) = &block.shape else { return 0.0 };
            let slopes = slopes.rows(first, block.size());
            let left = |turned: DVector<f64>| {
                let turned = factor.l_dirty().solve_lower_triangular(&turned).unwrap_or(turned);
                let followed = slopes.tr_mul(&turned);
                (turned.norm_squared() - followed.dot(&(covariance * &followed))).max(0.0)
            };
            let turns = self.turns_of(block, shape);
            let turned: f64 = turns.iter().map(|turn| left(turn.by(Discrepancy::NONE.coupling))).sum();
            turned + self.racked(block).map_or(0.0, left)
        };
        state.blocks().map(of_block).collect()
    }

    /// Logarithms of predicted over measured damping ratios. The model does not know a structure's own damping: that of the
    /// median mode stands for it, and dashpots add theirs.
    fn damping_differences(&self, state: &State) -> DVector<f64> {
        let difference = |mode: usize| {
            let measured = self.damping.get(mode).copied().flatten()?;
            let predicted = self.ordinary_damping + state.model.view.damping_ratio(state.pairs.get(mode)?.model);
            Some((predicted / measured).ln() / SCATTER_OF_DAMPING)
        };
        DVector::from_fn(self.measured.len(), |mode, _| difference(mode).unwrap_or(0.0))
    }

    /// Predicted less measured imaginary parts of shapes, in standard deviations.
    pub(super) fn phase_differences(&self, state: &State, view: &ModelView) -> DVector<f64> {
        let mut differences = Vec::new();
        for phases in &self.phases {
            let predicted = state.residual.block_of(phases.mode).and_then(|(_, block)| {
                let shape = block.shape.as_ref()?;
                let imaginary = view.imaginary(block.model)? * shape.combination[0];
                Some(imaginary.select_rows(&shape.sensors))
            });
            for (row, (measured, std)) in phases.imaginary.iter().zip(phases.deviations.iter()).enumerate() {
                let predicted = predicted.as_ref().map_or(0.0, |predicted| predicted[row]);
                differences.push((predicted - measured) / std);
            }
        }
        DVector::from_vec(differences)
    }

    /// The structure with effects and background; `None` where an effect does not fit it.
    pub(super) fn structure_with(&self, effects: &[Effect], numbers: &DVector<f64>) -> Option<Structure> {
        let mut structure = self.bare.clone();
        self.background.apply(numbers, &mut structure);
        structure.and(effects).ok()
    }
}
