//! From effects and background to a [`State`]: the structure with both is assembled, its modes are paired with the measured ones
//! and the differences are whitened.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::discrepancy::Discrepancy;
use super::problem::Problem;
use super::state::State;
use crate::compare::{Block, ModelView, Pair, Residual, pair_above};
use crate::model::Structure;
use crate::model::effect::Effect;

/// Least likeness of a pair. Every measured mode must find a partner, or effects could take values that make the modes that
/// they do not explain disappear.
pub(super) const LEAST_LIKENESS: f64 = 1e-6;
/// Modes further apart than this (ln f) do not mix.
const FAR: f64 = 0.25;
/// Whatever makes the peak of a mode lean (neighbours, the colour of the load, damping that is no constant) moves its
/// frequency by a share of its bandwidth, however long the record: of the damping ratio, in ln f.
const BIAS_OF_BANDWIDTH: f64 = 0.03;
/// Deviations from some twelve groups of a jackknife scatter themselves: squares in units of them have the mean
/// 11/9 (Student's t with eleven degrees of freedom).
const SCATTER_OF_VARIANCES: f64 = 11.0 / 9.0;
/// A mode whose damping a dashpot raises by this share is one that it moves.
const DAMPED: f64 = 0.3;
/// Damping of a structure's modes scatters by this factor (standard deviation of its logarithm).
pub(super) const SCATTER_OF_DAMPING: f64 = 0.5;

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
        let same = previous.filter(|previous| {
            previous.assembly.stiffness == assembly.stiffness && previous.assembly.mass == assembly.mass
        });
        let basis = match same {
            Some(previous) => previous.view.basis.clone(),
            None => assembly.modal_basis().map_err(|error| error.to_string())?,
        };
        let delays_s = assembly.sensing.delays_s(&self.sensors);
        let damped = assembly.damped_modes(&basis).map_err(|error| error.to_string())?;
        let view = ModelView::of_basis(basis, damped, rows, delays_s.clone());
        let measured = self.seen_by(&structure);
        let pairs = pair_above(&view, measured, LEAST_LIKENESS);
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
        let residual = Residual::of(&view, measured, &pairs, &partners);
        let twins_left = self.measured.len() - measured.len();
        let factors = self.covariance_factors(&residual, &self.discrepancy);
        let factors = factors.ok_or("the covariance of a measured mode is not positive definite")?;
        let models = residual.models();
        let sensor_vectors = view.sensor_vectors();
        let mut state = State {
            modes: DVector::zeros(0),
            phases: DVector::zeros(0),
            damping: DVector::zeros(0),
            effects,
            numbers,
            structure,
            assembly,
            view,
            delays_s,
            twins_left,
            twins: measured.len() - self.paired,
            pairs,
            residual,
            factors,
            models,
            sensor_vectors,
        };
        state.modes = state.whiten(state.residual.vector());
        state.phases = self.phase_differences(&state, &state.view);
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

    /// Cholesky factors of the blocks' covariances; `None` where one is not positive definite.
    pub(super) fn covariance_factors(
        &self,
        residual: &Residual,
        discrepancy: &Discrepancy,
    ) -> Option<Vec<Cholesky<f64, Dyn>>> {
        residual.blocks().map(|(_, block)| Cholesky::new(self.covariance(block, discrepancy))).collect()
    }

    /// A block's covariance by the measurement and by a discrepancy of the model: of the frequency, of the shape at each sensor, and
    /// by how far neighbouring modes turn.
    fn covariance(&self, block: &Block, discrepancy: &Discrepancy) -> DMatrix<f64> {
        let mut covariance = &block.covariance * SCATTER_OF_VARIANCES;
        let mode = &self.measured[block.measured];
        let grown = discrepancy.grown(mode.frequency_hz, self.middle_hz);
        covariance[(0, 0)] +=
            (BIAS_OF_BANDWIDTH * mode.damping_ratio.unwrap_or(0.0)).powi(2) + (grown * discrepancy.frequency).powi(2);
        let Some(shape) = &block.shape else { return covariance };
        // Directions are of unit length and at right angles, so what is independent at sensors is independent along them.
        let local = (grown * discrepancy.shape * shape.largest()).powi(2);
        for index in 1..block.size() {
            covariance[(index, index)] += local;
        }
        for (index, other) in self.measured.iter().enumerate() {
            let apart = (mode.frequency_hz / other.frequency_hz).ln().abs();
            let Some(other) = &other.shape else { continue };
            if self.close[block.measured].contains(&index) || apart > FAR || other.sensors != shape.sensors {
                continue;
            }
            let angle = (0.5 * discrepancy.coupling / apart).min(1.0);
            let along = shape.directions.tr_mul(&other.values.normalize()) * angle;
            let mut part = covariance.view_mut((1, 1), (along.len(), along.len()));
            part += &along * along.transpose();
        }
        covariance
    }

    /// Logarithms of predicted over measured damping ratios. The model does not know a structure's own damping: that of the
    /// median mode stands for it, and dashpots add theirs.
    fn damping_differences(&self, state: &State) -> DVector<f64> {
        let difference = |mode: usize| {
            let measured = self.damping.get(mode).copied().flatten()?;
            let predicted = self.ordinary_damping + state.view.damping_ratio(state.pairs.get(mode)?.model);
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
