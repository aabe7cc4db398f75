//! A model with certain effects and a certain background, held against the measurement: differences, whitened, and how they
//! follow the effects' values and the background.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, RowDVector};

use super::problem::Problem;
use crate::compare::{ModelView, Pair, Residual, pair_above, recorded};
use crate::model::effect::{Effect, Prior, Where};
use crate::model::{Assembly, Change, ModeDerivative, Structure, derivatives, frequency_derivatives};

/// A model held against the measurement.
pub(super) struct State {
    /// Effects in the model.
    pub(super) effects: Vec<Effect>,
    /// The background's numbers.
    pub(super) numbers: DVector<f64>,
    /// The structure with both.
    pub(super) structure: Structure,
    /// Its matrices.
    pub(super) assembly: Assembly,
    /// Its modes.
    pub(super) view: ModelView,
    /// By how much sensors are late.
    delays_s: Option<RowDVector<f64>>,
    /// Which modes belong together, one pair for each measured mode.
    pub(super) pairs: Vec<Pair>,
    /// The differences of modes.
    pub(super) residual: Residual,
    /// Cholesky factors of each block's covariance.
    factors: Vec<Cholesky<f64, Dyn>>,
    /// Differences of modes in standard deviations.
    pub(super) modes: DVector<f64>,
    /// Differences of phases in standard deviations.
    pub(super) phases: DVector<f64>,
    /// The model's modes in use, ascending.
    models: Vec<usize>,
    /// Eigenvectors at the sensors, sensors x DOFs.
    sensor_vectors: DMatrix<f64>,
}

/// Likeness below this pairs nothing; every measured mode must find a partner, or values of effects could shake off what
/// they do not explain.
const LEAST_LIKENESS: f64 = 1e-6;
/// Shapes of neighbouring modes mix by what neither the model nor the identification controls: directions that the tables
/// give to a degree, supports that are not quite alike. A coupling of this share of the stiffness turns modes that differ by
/// d in ln f by this over 2 d.
const COUPLING: f64 = 2e-3;
/// Modes further apart than this (ln f) do not mix.
const FAR: f64 = 0.25;
/// Whatever makes the peak of a mode lean (neighbours, the colour of the load, damping that is no constant) moves its
/// frequency by a share of its bandwidth, however long the record: of the damping ratio, in ln f.
const BIAS_OF_BANDWIDTH: f64 = 0.03;
/// Deviations from some twelve groups of a jackknife scatter themselves: squares in units of them have the mean
/// 11/9 (Student's t with eleven degrees of freedom).
const SCATTER_OF_DEVIATIONS: f64 = 1.1;

impl Problem {
    /// The model with effects and background, held against the measurement; eigenvectors are taken from `previous` where
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
        let view = ModelView::of_basis(basis, rows, delays_s.clone());
        let pairs = pair_above(&view, &self.measured, LEAST_LIKENESS);
        if pairs.len() < self.measured.len() {
            return Err("a measured mode has no partner".to_owned());
        }
        let partners = |pair: &Pair| {
            let mut models: Vec<usize> =
                self.close[pair.measured].iter().map(|&measured| pairs[measured].model).collect();
            models.sort_unstable();
            models
        };
        let residual = Residual::of(&view, &self.measured, &pairs, &partners);
        let factors: Option<Vec<_>> =
            residual.blocks().map(|(_, block)| Cholesky::new(self.covariance(block))).collect();
        let factors = factors.ok_or("the covariance of a measured mode is not positive definite")?;
        let models = residual.models();
        let sensor_vectors = &view.sensor_rows * &view.basis.vectors;
        let mut state = State {
            modes: DVector::zeros(0),
            phases: DVector::zeros(0),
            effects,
            numbers,
            structure,
            assembly,
            view,
            delays_s,
            pairs,
            residual,
            factors,
            models,
            sensor_vectors,
        };
        state.modes = state.whiten(state.residual.vector());
        state.phases = self.phase_differences(&state, &state.view);
        if state.modes.iter().chain(state.phases.iter()).all(|value| value.is_finite()) {
            Ok(state)
        } else {
            Err("a difference is no finite number".to_owned())
        }
    }

    /// A block's covariance with the mixing of neighbouring modes.
    fn covariance(&self, block: &crate::compare::Block) -> DMatrix<f64> {
        let mut covariance = &block.covariance * SCATTER_OF_DEVIATIONS;
        let mode = &self.measured[block.measured];
        covariance[(0, 0)] += (BIAS_OF_BANDWIDTH * mode.damping_ratio.unwrap_or(0.0)).powi(2);
        let Some(shape) = &block.shape else { return covariance };
        for (index, other) in self.measured.iter().enumerate() {
            let apart = (mode.frequency_hz / other.frequency_hz).ln().abs();
            let Some(other) = &other.shape else { continue };
            if self.close[block.measured].contains(&index) || apart > FAR || other.sensors != shape.sensors {
                continue;
            }
            let angle = (0.5 * COUPLING / apart).min(1.0);
            let along = shape.directions.tr_mul(&other.values.normalize()) * angle;
            let mut part = covariance.view_mut((1, 1), (along.len(), along.len()));
            part += &along * along.transpose();
        }
        covariance
    }

    /// Predicted less measured imaginary parts of shapes, in standard deviations.
    fn phase_differences(&self, state: &State, view: &ModelView) -> DVector<f64> {
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
}

/// One fitted number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Knob {
    /// Index of its effect.
    pub(super) effect: usize,
    /// Index of the parameter.
    pub(super) parameter: usize,
    /// The value at which the effect is not there.
    pub(super) neutral: f64,
    /// Its prior scale: the unit of the fit.
    pub(super) scale: f64,
    /// The step of derivatives, in the parameter's unit.
    pub(super) step: f64,
    /// Bounds, in the parameter's unit.
    pub(super) bounds: [f64; 2],
}

/// A step moves frequencies by about this.
const SHIFT_OF_STEP: f64 = 1e-4;
const LEAST_SHIFT: f64 = 1e-6;
const GREATEST_SHIFT: f64 = 1e-3;
/// Where a tenth of a step moves more than this share of what the step moves, the step is too long.
const SATURATED: f64 = 0.11;
/// Steps of parameters of a known size, in shares of it.
const SHARE_OF_STEP: f64 = 1e-3;

/// Share of modes whose deviations are wrong, and by what factor: those of a frequency, those of a shape.
const WRONG: f64 = 0.1;
const WRONG_BY: [f64; 2] = [5.0, 3.0];

/// How differences count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Loss {
    /// By their squares: far from the best values it leads there.
    Squares,
    /// As [`State::misfit`] says: near them it says what they are.
    Robust,
}

/// Numbers of one mode whose deviations may be wrong together.
struct Group {
    first: usize,
    count: usize,
    /// By what factor their deviations are wrong, where they are.
    wrong_by: f64,
}

impl Group {
    /// Twice the negative logarithm of the likelihood of squared differences, zero at zero, and its derivative.
    fn misfit(&self, square: f64) -> (f64, f64) {
        let variance = self.wrong_by * self.wrong_by;
        // Logarithms of the odds of being wrong, at zero and here.
        let odds = (WRONG / (1.0 - WRONG)).ln() - self.count as f64 * self.wrong_by.ln();
        let here = odds + 0.5 * square * (1.0 - 1.0 / variance);
        let softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
        let share = 1.0 / (1.0 + (-here).exp());
        (square - 2.0 * (softplus(here) - softplus(odds)), 1.0 - share + share / variance)
    }
}

impl State {
    /// Frequencies and shapes, mode by mode, and the phases of each mode.
    fn groups(&self) -> Vec<Group> {
        let mut groups = Vec::new();
        for (first, block) in self.residual.blocks() {
            groups.push(Group { first, count: 1, wrong_by: WRONG_BY[0] });
            if block.size() > 1 {
                groups.push(Group { first: first + 1, count: block.size() - 1, wrong_by: WRONG_BY[1] });
            }
        }
        groups
    }

    /// Twice the negative logarithm of the likelihood, up to a constant. A few modes may have deviations that are wrong by a
    /// factor: squared differences q of n numbers count as `-2 ln((1 - e) exp(-q/2) + e k^-n exp(-q/2k²))` (Tukey's
    /// contaminated normal distribution, 1960). One mode that identification got wrong then weighs less, and one that the
    /// model has wrong still weighs.
    pub(super) fn misfit(&self, loss: Loss) -> f64 {
        let of = |group: Group| {
            let square = self.modes.rows(group.first, group.count).norm_squared();
            match loss {
                Loss::Squares => square,
                Loss::Robust => group.misfit(square).0,
            }
        };
        self.groups().into_iter().map(of).sum::<f64>() + self.phases.norm_squared()
    }

    /// Square roots of the weights with which differences count at this state, so that weighted squares have the gradient
    /// of [`State::misfit`].
    pub(super) fn weights(&self, loss: Loss) -> DVector<f64> {
        let mut weights = DVector::from_element(self.modes.len() + self.phases.len(), 1.0);
        if loss == Loss::Squares {
            return weights;
        }
        for group in self.groups() {
            let square = self.modes.rows(group.first, group.count).norm_squared();
            weights.rows_mut(group.first, group.count).fill(group.misfit(square).1.sqrt());
        }
        weights
    }

    /// All differences in standard deviations: of modes, then of phases.
    pub(super) fn differences(&self) -> DVector<f64> {
        let mut all = self.modes.clone().resize_vertically(self.modes.len() + self.phases.len(), 0.0);
        all.rows_mut(self.modes.len(), self.phases.len()).copy_from(&self.phases);
        all
    }

    /// Frequencies of the paired model modes.
    pub(super) fn frequency_of(&self, measured: usize) -> f64 {
        self.view.modes.frequency_hz[self.pairs[measured].model]
    }

    fn whiten(&self, mut vector: DVector<f64>) -> DVector<f64> {
        for ((first, block), factor) in self.residual.blocks().zip(&self.factors) {
            let mut part = vector.rows(first, block.size()).into_owned();
            if factor.l_dirty().solve_lower_triangular_mut(&mut part) {
                vector.rows_mut(first, block.size()).copy_from(&part);
            }
        }
        vector
    }

    /// Derivatives of [`State::differences`] by the background's numbers.
    pub(super) fn by_background(&self, problem: &Problem) -> DMatrix<f64> {
        let rows = self.modes.len();
        let changes = if problem.background.size() == 0 { Vec::new() } else { self.structure.segment_changes() };
        let column = |change: &Change| {
            let derivatives = derivatives(&self.view.basis, &self.sensor_vectors, &self.models, change);
            self.residual.slope(&self.models, &recorded(&self.view, &self.models, derivatives))
        };
        let matrix = |columns: Vec<DVector<f64>>| {
            if columns.is_empty() { DMatrix::zeros(rows, 0) } else { DMatrix::from_columns(&columns) }
        };
        if changes.is_empty() {
            return DMatrix::zeros(rows + self.phases.len(), problem.background.size());
        }
        let by_stiffness = matrix(changes.iter().map(|change| column(&change.stiffness)).collect());
        let by_mass = matrix(changes.iter().map(|change| column(&change.mass)).collect());
        let by_spread = column(&self.structure.spread_change());
        let mut by_numbers = problem.background.chain(&by_stiffness, &by_mass, &by_spread, &self.numbers);
        for mut column in by_numbers.column_iter_mut() {
            let whitened = self.whiten(column.clone_owned());
            column.copy_from(&whitened);
        }
        by_numbers.resize_vertically(rows + self.phases.len(), 0.0)
    }

    /// The derivative of [`State::differences`] by what takes the structure to `structure` in a step of the size `step`.
    pub(super) fn towards(&self, problem: &Problem, structure: &Structure, step: f64) -> Option<DVector<f64>> {
        let there = structure.assemble();
        if there.dofs() != self.assembly.dofs() {
            return None;
        }
        let (rows, delays_s) = (there.sensor_rows(&problem.sensors).ok()?, there.sensing.delays_s(&problem.sensors));
        let change = self.change(&there, step);
        let mut slopes = match &change {
            Some(change) => recorded(
                &self.view,
                &self.models,
                derivatives(&self.view.basis, &self.sensor_vectors, &self.models, change),
            ),
            None => {
                let still = DVector::zeros(self.view.at_sensors.nrows());
                vec![ModeDerivative { ln_frequency: 0.0, shape: still }; self.models.len()]
            }
        };
        let mut phases = DVector::zeros(self.phases.len());
        if rows != self.view.sensor_rows || delays_s != self.delays_s {
            let view = ModelView::of_basis(self.view.basis.clone(), rows, delays_s);
            for (slope, &model) in slopes.iter_mut().zip(&self.models) {
                slope.shape += (view.at_sensors.column(model) - self.view.at_sensors.column(model)) / step;
            }
            phases = (problem.phase_differences(self, &view) - &self.phases) / step;
        }
        let modes = self.whiten(self.residual.slope(&self.models, &slopes));
        let mut all = modes.resize_vertically(self.modes.len() + phases.len(), 0.0);
        all.rows_mut(self.modes.len(), phases.len()).copy_from(&phases);
        all.iter().all(|value| value.is_finite()).then_some(all)
    }

    /// The change of K and M for one unit of the step; `None` where they stay.
    fn change(&self, there: &Assembly, step: f64) -> Option<Change> {
        let here = &self.assembly;
        if there.stiffness == here.stiffness && there.mass == here.mass {
            return None;
        }
        Some(Change::of(&((&there.stiffness - &here.stiffness) / step), &((&there.mass - &here.mass) / step)))
    }

    /// The derivative by a knob.
    pub(super) fn by_knob(&self, problem: &Problem, knob: &Knob) -> Option<DVector<f64>> {
        let value = self.value(knob);
        // Inwards where the bound is near.
        let step = if value + knob.step <= knob.bounds[1] { knob.step } else { -knob.step };
        let effects = with_values(&self.effects, std::slice::from_ref(knob), &[value + step]);
        Some(self.towards(problem, &problem.structure_with(&effects, &self.numbers)?, step)? * knob.scale)
    }

    /// The value of a knob.
    pub(super) fn value(&self, knob: &Knob) -> f64 {
        self.effects[knob.effect].parameters().nth(knob.parameter).map_or(knob.neutral, |(_, value)| value)
    }

    /// The knobs of one of `effects`, with which the matrices must be those of this state: steps and scales, from `guesses`
    /// (one for each knob, for instance the steps that served a neighbour). `None` where it does nothing.
    pub(super) fn knobs(
        &self,
        problem: &Problem,
        effects: &[Effect],
        effect: usize,
        guesses: &[f64],
    ) -> Option<Vec<Knob>> {
        let custom = match effects[effect].place() {
            Some(Where::Name(name)) => problem.bare.customs.iter().find(|custom| custom.name == *name),
            _ => None,
        };
        let mut knobs: Vec<Knob> = Vec::new();
        for (index, (parameter, value)) in effects[effect].parameters().enumerate() {
            let guess = guesses.get(knobs.len()).copied().unwrap_or(1.0);
            let mut knob = Knob {
                effect,
                parameter: index,
                neutral: parameter.neutral,
                scale: 1.0,
                step: guess,
                bounds: custom.map_or([parameter.least, parameter.greatest], |custom| custom.range),
            };
            match custom.map_or(parameter.prior, |custom| Prior::Value(custom.typical)) {
                Prior::Given => continue,
                Prior::Value(typical) => (knob.scale, knob.step) = (typical, SHARE_OF_STEP * typical),
                Prior::FrequencyShift(share) => {
                    let (step, shift) = self.step_that_shifts(problem, effects, &knob, value)?;
                    (knob.scale, knob.step) = (share * step / shift, step);
                }
            }
            knobs.push(knob);
        }
        Some(knobs)
    }

    /// A step of a knob that moves some frequency by about [`SHIFT_OF_STEP`], and by how much it does.
    fn step_that_shifts(&self, problem: &Problem, effects: &[Effect], knob: &Knob, value: f64) -> Option<(f64, f64)> {
        let mut step = knob.step;
        let shift_at = |step: f64| {
            let effects = with_values(effects, std::slice::from_ref(knob), &[value + step]);
            problem.structure_with(&effects, &self.numbers).map_or(f64::INFINITY, |structure| {
                let shifts = self
                    .change(&structure.assemble(), 1.0)
                    .map_or_else(Vec::new, |change| frequency_derivatives(&self.view.basis, &self.models, &change));
                shifts.iter().fold(0.0, |most: f64, shift| most.max(shift.abs()))
            })
        };
        for _ in 0..60 {
            let shift = shift_at(step);
            if (LEAST_SHIFT..=GREATEST_SHIFT).contains(&shift) {
                // A spring that is as good as a hinge already moves nothing by another step either.
                if shift_at(0.1 * step) < SATURATED * shift {
                    return Some((step, shift));
                }
                step *= 1e-3;
                continue;
            }
            let factor = SHIFT_OF_STEP / shift;
            step *= if factor.is_finite() { factor.clamp(1e-6, 1e4) } else { 1e4 };
            if !(1e-60..1e60).contains(&step) {
                return None;
            }
        }
        None
    }
}

impl Problem {
    /// The structure with effects and background; `None` where an effect does not fit it.
    pub(super) fn structure_with(&self, effects: &[Effect], numbers: &DVector<f64>) -> Option<Structure> {
        let mut structure = self.bare.clone();
        self.background.apply(numbers, &mut structure);
        structure.and(effects).ok()
    }
}

/// Effects with some of their values changed.
pub(super) fn with_values(effects: &[Effect], knobs: &[Knob], values: &[f64]) -> Vec<Effect> {
    let mut effects = effects.to_vec();
    for (knob, value) in knobs.iter().zip(values) {
        if let Some(effect) = effects.get_mut(knob.effect) {
            let mut all: Vec<f64> = effect.parameters().map(|(_, value)| value).collect();
            if let Some(slot) = all.get_mut(knob.parameter) {
                *slot = *value;
            }
            *effect = effect.with_values(&all);
        }
    }
    effects
}
