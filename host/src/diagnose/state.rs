//! A model with certain effects and a certain background, held against the measurement: differences, whitened, and how they
//! follow the effects' values and the background.

use std::collections::HashMap;
use std::sync::Mutex;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, RowDVector};

use super::problem::Problem;
use crate::compare::{ModelView, Pair, Residual, pair_above};
use crate::model::effect::{Effect, Prior, Where};
use crate::model::{Assembly, Change, ModeDerivative, Structure};

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
    /// Measured modes that are taken for no modes.
    twins_left: usize,
    /// How many of the paired modes are twins, the last ones.
    twins: usize,
    /// The differences of modes.
    pub(super) residual: Residual,
    /// Cholesky factors of each block's covariance.
    factors: Vec<Cholesky<f64, Dyn>>,
    /// Differences of modes in standard deviations.
    pub(super) modes: DVector<f64>,
    /// Differences of phases in standard deviations.
    pub(super) phases: DVector<f64>,
    /// Differences of damping in standard deviations.
    damping: DVector<f64>,
    /// The model's modes in use, ascending.
    models: Vec<usize>,
    /// Eigenvectors at the sensors, sensors x DOFs.
    sensor_vectors: DMatrix<f64>,
}

/// Likeness below this pairs nothing; every measured mode must find a partner, or values of effects could shake off what
/// they do not explain.
pub(super) const LEAST_LIKENESS: f64 = 1e-6;
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
const SCATTER_OF_VARIANCES: f64 = 11.0 / 9.0;

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
        let factors: Option<Vec<_>> =
            residual.blocks().map(|(_, block)| Cholesky::new(self.covariance(block))).collect();
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

    /// The model with effects as it is given, nothing scattered.
    pub(super) fn state_without_scatter(&self, effects: &[Effect]) -> Result<State, String> {
        self.state(effects.to_vec(), DVector::zeros(self.background.size()), None)
    }

    /// A block's covariance with the mixing of neighbouring modes.
    fn covariance(&self, block: &crate::compare::Block) -> DMatrix<f64> {
        let mut covariance = &block.covariance * SCATTER_OF_VARIANCES;
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

    /// Logarithms of predicted over measured damping ratios. A model says nothing of a structure's own damping, which is taken
    /// to be that of the middle mode; dashpots add theirs.
    fn damping_differences(&self, state: &State) -> DVector<f64> {
        let difference = |mode: usize| {
            let measured = self.damping.get(mode).copied().flatten()?;
            let predicted = self.ordinary_damping + state.view.damping_ratio(state.pairs.get(mode)?.model);
            Some((predicted / measured).ln() / SCATTER_OF_DAMPING)
        };
        DVector::from_fn(self.measured.len(), |mode, _| difference(mode).unwrap_or(0.0))
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

/// A mode whose damping a dashpot raises by this share is one that it moves.
const DAMPED: f64 = 0.3;
/// Damping of a structure's modes scatters by this factor (standard deviation of its logarithm).
const SCATTER_OF_DAMPING: f64 = 0.5;

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

/// Twice the logarithm of how much likelier a measured mode of its frequency, or of its shape, is where the model has such a
/// mode than where identification made it up: one in a hundred is made up, with a frequency anywhere within a third.
const TWIN: f64 = 8.0;

/// The structure as first given, by which effects are weighed.
pub(super) struct Reference {
    state: State,
    /// Typical sizes of parameters so far.
    typical: Mutex<HashMap<String, Option<f64>>>,
}

impl std::fmt::Debug for Reference {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Reference")
    }
}

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
    /// Of a twin, which may also be none.
    is_twin: bool,
}

impl Group {
    /// A mode's damping.
    fn of_damping() -> Self {
        Self { first: 0, count: 1, wrong_by: WRONG_BY[0], is_twin: false }
    }

    /// Twice the negative logarithm of the likelihood of squared differences, zero at zero, and its derivative.
    fn misfit(&self, square: f64) -> (f64, f64) {
        let variance = self.wrong_by * self.wrong_by;
        // Logarithms of the odds of being wrong, at zero and here.
        let odds = (WRONG / (1.0 - WRONG)).ln() - self.count as f64 * self.wrong_by.ln();
        let here = odds + 0.5 * square * (1.0 - 1.0 / variance);
        let softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
        let share = 1.0 / (1.0 + (-here).exp());
        let (misfit, slope) = (square - 2.0 * (softplus(here) - softplus(odds)), 1.0 - share + share / variance);
        if !self.is_twin {
            return (misfit, slope);
        }
        // exp(-misfit/2) + exp(-TWIN/2): far off it is taken for no mode.
        let none = 0.5 * (misfit - TWIN);
        (misfit - 2.0 * (softplus(none) - softplus(-0.5 * TWIN)), slope / (1.0 + none.exp()))
    }
}

impl State {
    /// Frequencies and shapes, mode by mode, and the phases of each mode.
    fn groups(&self) -> Vec<Group> {
        let mut groups = Vec::new();
        let paired = self.pairs.len() - self.twins;
        for (first, block) in self.residual.blocks() {
            let is_twin = block.measured >= paired;
            groups.push(Group { first, count: 1, wrong_by: WRONG_BY[0], is_twin });
            if block.size() > 1 {
                groups.push(Group { first: first + 1, count: block.size() - 1, wrong_by: WRONG_BY[1], is_twin });
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
        // A mode that is no mode had to come from somewhere.
        let left = 2.0 * TWIN * self.twins_left as f64;
        let damping: f64 =
            self.damping.iter().map(|difference| Group::of_damping().misfit(difference * difference).0).sum();
        self.groups().into_iter().map(of).sum::<f64>() + self.phases.norm_squared() + damping + left
    }

    /// Square roots of the weights with which differences count at this state, so that weighted squares have the gradient
    /// of [`State::misfit`].
    pub(super) fn weights(&self, loss: Loss) -> DVector<f64> {
        let mut weights = DVector::from_element(self.size(), 1.0);
        let damping = self.modes.len() + self.phases.len();
        for (index, difference) in self.damping.iter().enumerate() {
            weights[damping + index] = Group::of_damping().misfit(difference * difference).1.sqrt();
        }
        if loss == Loss::Squares {
            return weights;
        }
        for group in self.groups() {
            let square = self.modes.rows(group.first, group.count).norm_squared();
            weights.rows_mut(group.first, group.count).fill(group.misfit(square).1.sqrt());
        }
        weights
    }

    /// All differences in standard deviations: of modes, then of phases, then of damping.
    pub(super) fn differences(&self) -> DVector<f64> {
        self.joined(self.modes.clone(), &self.phases, &self.damping)
    }

    fn joined(&self, modes: DVector<f64>, phases: &DVector<f64>, damping: &DVector<f64>) -> DVector<f64> {
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
        Some(self.view.modes.frequency_hz[self.pairs.get(measured)?.model])
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
            let derivatives = self.view.derivatives(&self.sensor_vectors, &self.models, change);
            self.residual.slope(&self.models, &derivatives)
        };
        let matrix = |columns: Vec<DVector<f64>>| {
            if columns.is_empty() { DMatrix::zeros(rows, 0) } else { DMatrix::from_columns(&columns) }
        };
        if changes.is_empty() {
            return DMatrix::zeros(self.size(), problem.background.size());
        }
        let by_stiffness = matrix(changes.iter().map(|change| column(&change.stiffness)).collect());
        let by_mass = matrix(changes.iter().map(|change| column(&change.mass)).collect());
        let by_spread = column(&self.structure.spread_change());
        let mut by_numbers = problem.background.chain(&by_stiffness, &by_mass, &by_spread, &self.numbers);
        for mut column in by_numbers.column_iter_mut() {
            let whitened = self.whiten(column.clone_owned());
            column.copy_from(&whitened);
        }
        // Scatter moves damping by next to nothing.
        by_numbers.resize_vertically(self.size(), 0.0)
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
            Some(change) => self.view.derivatives(&self.sensor_vectors, &self.models, change),
            None => {
                let still = DVector::zeros(self.view.at_sensors.nrows());
                vec![ModeDerivative { ln_frequency: 0.0, shape: still, damping_ratio: 0.0 }; self.models.len()]
            }
        };
        let mut phases = DVector::zeros(self.phases.len());
        if rows != self.view.sensor_rows || delays_s != self.delays_s {
            let view = ModelView::of_basis(self.view.basis.clone(), self.view.damped.clone(), rows, delays_s);
            for (slope, &model) in slopes.iter_mut().zip(&self.models) {
                slope.shape += (view.at_sensors.column(model) - self.view.at_sensors.column(model)) / step;
            }
            phases = (problem.phase_differences(self, &view) - &self.phases) / step;
        }
        let modes = self.whiten(self.residual.slope(&self.models, &slopes));
        let damping = DVector::from_fn(self.damping.len(), |mode, _| {
            let pair = self.pairs.get(mode);
            let at = pair.and_then(|pair| Some((pair.model, self.models.binary_search(&pair.model).ok()?)));
            let known = problem.damping.get(mode).copied().flatten();
            at.filter(|_| known.is_some()).map_or(0.0, |(model, at)| {
                let predicted = problem.ordinary_damping + self.view.damping_ratio(model);
                slopes[at].damping_ratio / predicted / SCATTER_OF_DAMPING
            })
        });
        let all = self.joined(modes, &phases, &damping);
        all.iter().all(|value| value.is_finite()).then_some(all)
    }

    /// The change of K, M and C for one unit of the step; `None` where they stay.
    fn change(&self, there: &Assembly, step: f64) -> Option<Change> {
        let here = &self.assembly;
        if there.stiffness == here.stiffness && there.mass == here.mass && there.damping == here.damping {
            return None;
        }
        let none = || DMatrix::zeros(here.dofs(), here.dofs());
        let damping = (there.damping.is_some() || here.damping.is_some()).then(|| {
            let [there, here] = [there, here].map(|assembly| assembly.damping.clone().unwrap_or_else(none));
            (there - here) / step
        });
        let (stiffness, mass) = ((&there.stiffness - &here.stiffness) / step, (&there.mass - &here.mass) / step);
        Some(Change::of(&stiffness, &mass, damping.as_ref()))
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
    /// (one for each knob, for instance the steps that served a neighbour). `None` where one of them does nothing.
    pub(super) fn knobs(
        &self,
        problem: &Problem,
        effects: &[Effect],
        effect: usize,
        guesses: &[f64],
    ) -> Option<Vec<Knob>> {
        self.knobs_seen(problem, effects, effect, guesses).into_iter().collect()
    }

    /// The same, one for each parameter that is fitted; `None` for one that does nothing.
    pub(super) fn knobs_seen(
        &self,
        problem: &Problem,
        effects: &[Effect],
        effect: usize,
        guesses: &[f64],
    ) -> Vec<Option<Knob>> {
        let custom = match effects[effect].place() {
            Some(Where::Name(name)) => problem.bare.customs.iter().find(|custom| custom.name == *name),
            _ => None,
        };
        let mut knobs: Vec<Option<Knob>> = Vec::new();
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
                Prior::Share(share) => {
                    (knob.neutral, knob.scale, knob.step) = (value, share * value, SHARE_OF_STEP * value);
                }
                Prior::Value(typical) => (knob.scale, knob.step) = (typical, SHARE_OF_STEP * typical),
                Prior::FrequencyShift(share) => match self.step_that_shifts(problem, effects, &knob, value) {
                    Some((step, shift)) => {
                        let typical = problem.typical(&effects[effect], index);
                        (knob.scale, knob.step) = (typical.unwrap_or(share * step / shift), step);
                    }
                    None => {
                        knobs.push(None);
                        continue;
                    }
                },
            }
            knobs.push(Some(knob));
        }
        knobs
    }

    /// A step of a knob that moves some frequency by about [`SHIFT_OF_STEP`], and by how much it does.
    fn step_that_shifts(&self, problem: &Problem, effects: &[Effect], knob: &Knob, value: f64) -> Option<(f64, f64)> {
        let mut step = knob.step;
        let shift_at = |step: f64| {
            let effects = with_values(effects, std::slice::from_ref(knob), &[value + step]);
            problem.structure_with(&effects, &self.numbers).map_or(f64::INFINITY, |structure| {
                let shifts = self
                    .change(&structure.assemble(), 1.0)
                    .map_or_else(Vec::new, |change| self.view.frequency_derivatives(&self.models, &change));
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
    /// The typical size of a parameter that depends on the structure: of the structure as first given, so that an effect weighs
    /// the same wherever a fit starts. `None` where it does nothing there.
    pub(super) fn typical(&self, effect: &Effect, parameter: usize) -> Option<f64> {
        let Prior::FrequencyShift(share) = effect.parameters().nth(parameter)?.0.prior else { return None };
        let reference = self.reference()?;
        let name = format!("{effect} {parameter} {}", effect.parameters().len());
        if let Some(known) = reference.typical.lock().ok()?.get(&name) {
            return *known;
        }
        let neutral: Vec<f64> = effect.parameters().map(|(parameter, _)| parameter.neutral).collect();
        let alone = [effect.with_values(&neutral)];
        let value = neutral[parameter];
        let bounds = [f64::NEG_INFINITY, f64::INFINITY];
        let knob = Knob { effect: 0, parameter, neutral: value, scale: 1.0, step: 1.0, bounds };
        let found =
            reference.state.step_that_shifts(self, &alone, &knob, value).map(|(step, shift)| share * step / shift);
        reference.typical.lock().ok()?.insert(name, found);
        found
    }

    fn reference(&self) -> Option<&Reference> {
        let make = || {
            let state = self.state_without_scatter(&[]).ok()?;
            Some(Reference { state, typical: Mutex::default() })
        };
        self.reference.get_or_init(make).as_ref()
    }

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
