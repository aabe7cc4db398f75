//! The most probable values of effects and background, how sure they are, and the evidence for the effects.

use std::f64::consts::PI;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::{Deserialize, Serialize};

use super::discrepancy::{Discrepancy, log_determinant};
use super::knob::{Knob, with_values};
use super::misfit::Loss;
use super::near::squares;
use super::problem::Problem;
use super::state::State;
use crate::compare::exceeding;
use crate::model::effect::{Effect, EffectKind, Evidence, Parameter, PlaceKind, Prior, TYPICAL_SHIFT, Where};

/// A model fitted to the measurement: effects and background at their most probable values.
pub struct Fit {
    pub(super) state: State,
    pub(super) knobs: Vec<Knob>,
    /// Derivatives of the differences by the knobs (in units of their scale) and the background's numbers.
    pub(super) slopes: DMatrix<f64>,
    /// The same by weight.
    pub(super) jacobian: DMatrix<f64>,
    /// Covariance of knobs (in units of their scale) and background, by which it is judged whether an effect is there.
    pub(super) covariance: DMatrix<f64>,
    /// What each knob's variance has besides in what is stated of its value; see [`LOOKS_LIKE_IT`].
    besides: Vec<f64>,
    /// See [`Problem::allowed`], block by block.
    pub(super) allowed: Vec<f64>,
    log_evidence: f64,
    /// What the model was taken to miss besides.
    pub(super) discrepancy: Discrepancy,
}

/// An effect's value with its standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The parameter.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard deviation; null for a parameter that is given, not fitted.
    pub std: Option<f64>,
    /// The unit of both; `-` for a pure number.
    pub unit: String,
    /// How far it is from no effect, in units of what is typical; null where nothing is.
    #[serde(default)]
    pub typical_sizes: Option<f64>,
}

impl Estimate {
    /// Whether an engineer would ask whether it can be true.
    pub fn is_unusual(&self) -> bool {
        self.typical_sizes.is_some_and(|sizes| sizes > UNUSUAL)
    }
}

/// Cauchy's prior, whose unit is what is typical, has 6 % of its probability beyond so many.
const UNUSUAL: f64 = 10.0;

/// What stands for an effect in a model is not all that it is: a spring for a foundation, a point for a tank, a share of a segment for a cut
/// brace. Values have this share of themselves as a standard deviation besides. In 17 values of effects in tubes and frames of another
/// finite element code, which fits had said to be sure to 1.3 to 7 %, errors were 4.7 % (rms), and 6 were outside of two deviations; so none
/// is. Lattice towers need more: errors of 26 %.
const IDEALISED: f64 = 0.05;
/// What a table has wrong looks like an effect in part, and no data tell that part from the effect: a foot that is stiffer than the table's
/// is missing in the flexibility of the ground. Values have a standard deviation besides, which moves frequencies by this share of what a
/// segment's stiffness is uncertain by (it would be half were all segments wrong alike). What an effect at one height does is less like a
/// table's errors than what one does that is everywhere or at the foot.
///
/// In 52 values of effects in lattice towers, frames and tubes of another finite element code, with segments known to 3 %, errors were 0.09 of
/// what is typical (rms, without the largest) at a height and 0.12 elsewhere, hardly less in small effects than in large ones; these shares
/// are 0.10 and 0.15 of it. With them 50 of the values are within two deviations, without them 41.
const LOOKS_LIKE_IT: f64 = 0.25;
const LOOKS_LIKE_IT_AT_A_HEIGHT: f64 = 1.0 / 6.0;
/// What a segment's stiffness is uncertain by where a study does not say.
pub(super) const USUAL_TOLERANCE: f64 = 0.03;
const MOST_ITERATIONS: usize = 25;
/// A value that chance makes as large with a higher probability than this is not significant.
const INSIGNIFICANT: f64 = 0.05;
/// What the table's own errors look like with a higher probability than this is no finding. Of 69 effects in lattice towers, frames and
/// tubes of another finite element code the least sure that was rightly named has 0.12, and it has three values; what was named of sound
/// structures has 0.2 to 0.8.
const LIKE_THE_TABLE: f64 = 0.15;
/// A step that lowers the cost by less than this, or by less than this share of it, is the last; a cost of 1 is one standard
/// deviation.
const SETTLED: f64 = 0.02;
const SETTLED_SHARE: f64 = 1e-4;
/// The same of squares, from where the robust loss takes over.
const NEAR_SHARE: f64 = 0.05;
/// A step that promises less than this share of that is not taken.
const WORTH: f64 = 0.25;
const LEAST_DAMPING: f64 = 1e-3;
const MOST_DAMPING: f64 = 1e8;
/// Derivatives are carried over a step that gains this share of what they promise.
const KEPT: f64 = 0.5;

/// Where a step of a fit leads.
enum Step {
    /// To a cost that is lower by `gain`, by `promised` where differences were linear; a step that gains less than `settled` is the last.
    Moved { state: Box<State>, gain: f64, promised: f64, settled: f64 },
    /// Nowhere that is better by what is worth it.
    Settled,
}

impl Problem {
    /// Fits effects, from the values they have, and the background from `numbers`; `knobs` say what is free.
    ///
    /// Levenberg-Marquardt within bounds (Nocedal and Wright 2006, section 10.3) on the misfit, its squares weighted anew in
    /// every step, and `|b|²`; a knob at a bound stays there while the cost falls outwards.
    pub(super) fn fit(
        &self,
        effects: Vec<Effect>,
        knobs: &[Knob],
        numbers: &DVector<f64>,
        previous: Option<&State>,
    ) -> Result<Fit, String> {
        self.fit_from(self.state(effects, numbers.clone(), previous)?, knobs)
    }

    /// The same of a state.
    pub(super) fn fit_from(&self, state: State, knobs: &[Knob]) -> Result<Fit, String> {
        // The robust loss lets go of what is far off, wherever it starts; squares bring it near first.
        self.fit_by(&[Loss::Squares, Loss::Robust], state, knobs)
    }

    /// The same of a state by one loss after the other.
    ///
    /// Derivatives are carried from step to step by Broyden's update (Madsen, Nielsen and Tingleff 2004, "Methods for Non-Linear Least
    /// Squares Problems", section 3.5), and made anew where a step gains less than they promise: they take as long as a state.
    pub(super) fn fit_by(&self, losses: &[Loss], mut state: State, knobs: &[Knob]) -> Result<Fit, String> {
        let (mut jacobian, mut is_exact) = (self.jacobian(&state, knobs)?, true);
        for &loss in losses {
            let mut damping = LEAST_DAMPING;
            for _ in 0..MOST_ITERATIONS {
                let (is_last, carried) = match self.step(&state, knobs, &jacobian, loss, &mut damping) {
                    Step::Moved { state: moved, gain, promised, settled } => {
                        let is_close = gain > KEPT * promised && gain > settled;
                        let carried = if is_close { moved.carry(&state, knobs, &jacobian) } else { None };
                        let is_last = gain < settled && is_exact;
                        state = *moved;
                        (is_last, carried)
                    }
                    Step::Settled if is_exact => break,
                    Step::Settled => (false, None),
                };
                is_exact = carried.is_none();
                jacobian = match carried {
                    Some(carried) => carried,
                    None => self.jacobian(&state, knobs)?,
                };
                if is_last {
                    break;
                }
            }
        }
        if !is_exact {
            jacobian = self.jacobian(&state, knobs)?;
        }
        self.finish(state, knobs.to_vec(), jacobian)
    }

    /// The present model's best values, from those of the effects in it.
    pub(super) fn present(&self, effects: &[Effect]) -> Result<Fit, String> {
        let state = self.state_without_scatter(effects)?;
        let knobs = self.all_knobs(&state);
        self.fit_from(state, &knobs)
    }

    /// The knobs of all effects of a state.
    pub(super) fn all_knobs(&self, state: &State) -> Vec<Knob> {
        // A value that moves nothing measured stays as it is; the others are fitted.
        let of = |effect: usize| state.knobs_seen(self, &state.effects, effect, &[]).into_iter().flatten();
        (0..state.effects.len())
            .filter(|&effect| shows_in_modes(state.effects[effect].of_kind()))
            .flat_map(of)
            .collect()
    }

    /// Fits a state with one effect more than `present`, from the values and the scatter that it has; `narrow` may narrow the
    /// bounds of the effect's values.
    pub(super) fn fit_with_one_more(&self, present: &Fit, state: &State, narrow: &dyn Fn(&mut Knob)) -> Option<Fit> {
        let mut own = state.knobs(self, &state.effects, state.effects.len() - 1, &[])?;
        own.iter_mut().for_each(narrow);
        let knobs = [present.knobs.clone(), own].concat();
        self.fit_from(self.state_like(state, state.numbers.clone()).ok()?, &knobs).ok()
    }

    /// The model of a fit without its scatter, from where the effects of a search are linearised a second time.
    pub(super) fn without_scatter(&self, fit: &Fit) -> Result<Fit, String> {
        let state = self.state_without_scatter(&fit.state.effects)?;
        let jacobian = self.jacobian(&state, &fit.knobs)?;
        self.finish(state, fit.knobs.clone(), jacobian)
    }

    /// The same state, its effects' values counted as fitted.
    pub(super) fn as_if_fitted(&self, fit: Fit) -> Result<Fit, String> {
        let knobs = self.all_knobs(&fit.state);
        let jacobian = self.jacobian(&fit.state, &knobs)?;
        self.finish(fit.state, knobs, jacobian)
    }

    /// The model with effects as they are given, without scatter and without a fit.
    pub(super) fn as_given(&self, effects: &[Effect]) -> Result<Fit, String> {
        let state = self.state_without_scatter(effects)?;
        let knobs = self.all_knobs(&state);
        let jacobian = self.jacobian(&state, &knobs)?;
        self.finish(state, knobs, jacobian)
    }

    /// One step that lowers the cost, unless the best promises too little to be worth it.
    fn step(&self, state: &State, knobs: &[Knob], jacobian: &DMatrix<f64>, loss: Loss, damping: &mut f64) -> Step {
        let (count, size) = (knobs.len(), jacobian.ncols());
        let before = cost(state, loss);
        let settled = match loss {
            Loss::Squares => NEAR_SHARE * before,
            Loss::Robust => SETTLED.max(SETTLED_SHARE * before),
        };
        let weights = state.weights(loss);
        let weighted = weighted(jacobian, &weights);
        let mut gradient = weighted.tr_mul(&state.differences().component_mul(&weights));
        let mut curvature = squares(&weighted);
        for index in count..size {
            gradient[index] += state.numbers[index - count];
            curvature[(index, index)] += 1.0;
        }
        let frozen = |index: usize| {
            let knob = knobs.get(index)?;
            let outwards = |bound: f64, sign: f64| knob.is_at(state.value(knob), bound) && gradient[index] * sign < 0.0;
            (outwards(knob.bounds[0], -1.0) || outwards(knob.bounds[1], 1.0)).then_some(())
        };
        let free: Vec<usize> = (0..size).filter(|&index| frozen(index).is_none()).collect();
        let (curvature, downhill) = (curvature.select_rows(&free).select_columns(&free), -gradient.select_rows(&free));
        while *damping < MOST_DAMPING {
            let mut system = curvature.clone();
            for index in 0..free.len() {
                let diagonal = system[(index, index)];
                system[(index, index)] += *damping * diagonal.max(1e-9);
            }
            let step = Cholesky::new(system).map(|factor| factor.solve(&downhill));
            let promised = step.as_ref().map_or(0.0, |step| 2.0 * downhill.dot(step) - (&curvature * step).dot(step));
            if *damping <= LEAST_DAMPING && promised < WORTH * settled {
                return Step::Settled;
            }
            let moved = step.and_then(|step| {
                let mut all = DVector::zeros(size);
                for (&index, value) in free.iter().zip(step.iter()) {
                    all[index] = *value;
                }
                let values: Vec<f64> =
                    knobs.iter().enumerate().map(|(index, knob)| state.value(knob) + all[index] * knob.scale).collect();
                let numbers = &state.numbers + all.rows(count, size - count);
                self.state(with_values(&state.effects, knobs, &values), numbers, Some(state)).ok()
            });
            if let Some(moved) = moved {
                let gain = before - cost(&moved, loss);
                if gain > 0.0 {
                    *damping = (*damping * 0.1).max(1e-9);
                    return Step::Moved { state: Box::new(moved), gain, promised, settled };
                }
            }
            *damping *= 10.0;
        }
        Step::Settled
    }

    pub(super) fn jacobian(&self, state: &State, knobs: &[Knob]) -> Result<DMatrix<f64>, String> {
        let background = state.by_background(self);
        let mut jacobian = background.insert_columns(0, knobs.len(), 0.0);
        for (index, knob) in knobs.iter().enumerate() {
            let column = state.by_knob(self, knob).ok_or("the model cannot follow an effect's value")?;
            jacobian.set_column(index, &column);
        }
        Ok(jacobian)
    }

    fn finish(&self, state: State, knobs: Vec<Knob>, slopes: DMatrix<f64>) -> Result<Fit, String> {
        let (count, size) = (knobs.len(), slopes.ncols());
        let jacobian = weighted(&slopes, &state.weights(Loss::Robust));
        let information = squares(&jacobian);
        let with_prior = &information + DMatrix::identity(size, size);
        let factor = Cholesky::new(with_prior).ok_or("the fit is not determined")?;
        let more_room = self.log_volume(&state).ok_or("the covariance of a measured mode is not positive definite")?;
        let volume = log_determinant(&factor) + more_room;
        let mut posterior = information;
        for index in 0..size {
            // Effects are estimated without their prior; a trace of it keeps the matrix invertible where the data do not see a
            // value, or cannot separate two.
            posterior[(index, index)] += if index < count { 1e-12 + 1e-9 * posterior[(index, index)] } else { 1.0 };
        }
        let mut covariance = Cholesky::new(posterior).ok_or("the fit is not determined")?.inverse();
        let units = knobs.iter().map(|knob| (state.value(knob) - knob.neutral) / knob.scale);
        let prior: f64 = units.map(prior_misfit).sum();
        let log_evidence = -0.5 * (cost(&state, Loss::Robust) + prior + volume) + log_one_sided(&knobs);
        let discrepancy = self.discrepancy;
        let log_evidence = log_evidence + discrepancy.log_prior();
        let allowed = self.allowed(&state, &slopes, &covariance);
        for (index, knob) in knobs.iter().enumerate() {
            // What the user has given is all that it is.
            let kind = state.effects[knob.effect].of_kind();
            if kind.is_of_structure() && !kind.is_of_the_study() {
                let units = (state.value(knob) - knob.neutral) / knob.scale;
                covariance[(index, index)] += (IDEALISED * units).powi(2);
            }
        }
        let besides = |(at, knob): (usize, &Knob)| {
            let shift = state.largest_shift(slopes.column(at));
            self.looks_like(&state.effects[knob.effect], knob, shift).powi(2)
        };
        let besides = knobs.iter().enumerate().map(besides).collect();
        Ok(Fit { state, knobs, slopes, jacobian, covariance, besides, allowed, log_evidence, discrepancy })
    }

    /// How much of an effect's knob, in units of its scale of which one moves the frequency that it moves most by `shift`, what the table has wrong
    /// may look like. Nothing where values are of sensors, or the user has given what they are of.
    pub(super) fn looks_like(&self, effect: &Effect, knob: &Knob, shift: f64) -> f64 {
        let prior = effect.parameters().nth(knob.parameter).map(|(parameter, _)| parameter.prior);
        let has_scale = matches!(prior, Some(Prior::FrequencyShift(_) | Prior::Value(_)));
        // Of a damper's damping and of axes no table says anything.
        if !has_scale || effect.of_kind().evidence() == Evidence::TwinPeaks || effect.kind() == "axis-rotation" {
            return 0.0;
        }
        let share = match effect.of_kind().place() {
            PlaceKind::Nowhere => LOOKS_LIKE_IT,
            PlaceKind::Height => LOOKS_LIKE_IT_AT_A_HEIGHT,
            _ => 0.0,
        };
        // What is typical of some kinds moves a structure that is made for it by far more: half as much again of a frame's shear flexibility moves its
        // storeys by a sixth. Taken for a twentieth, 29 % of flexibility with frequencies off by a tenth was no finding.
        share * self.stiffness_known_to / shift.max(TYPICAL_SHIFT)
    }
}

/// Whether an effect's values are fitted to modes (and phases).
pub(super) fn shows_in_modes(kind: &dyn EffectKind) -> bool {
    matches!(kind.evidence(), Evidence::Modes | Evidence::Phases | Evidence::TwinPeaks)
}

/// Twice the negative logarithm of the prior of a value, in units of its scale, over that of a Gaussian at zero: Cauchy's, of
/// which large effects are not ruled out (Jeffreys 1961, "Theory of Probability", section 5.2).
pub(super) fn prior_misfit(units: f64) -> f64 {
    2.0 * units.mul_add(units, 1.0).ln() + (0.5 * PI).ln()
}

/// By how much priors on one side only are higher there: twice each; the logarithm.
pub(super) fn log_one_sided(knobs: &[Knob]) -> f64 {
    let one_sided = knobs.iter().filter(|knob| knob.bounds.contains(&knob.neutral)).count();
    one_sided as f64 * std::f64::consts::LN_2
}

/// Squared distance from zero of values with this covariance, in standard deviations.
fn distance(values: &DVector<f64>, covariance: DMatrix<f64>) -> f64 {
    Cholesky::new(covariance).map_or(0.0, |factor| values.dot(&factor.solve(values)))
}

/// Probability that values with this covariance are as far from zero by chance (Wald's test).
fn chance_of_none(values: &DVector<f64>, covariance: DMatrix<f64>) -> f64 {
    exceeding(distance(values, covariance), values.len() as f64)
}

/// Whether values with this covariance, in units of their scales, are no further from nothing than what the table's own errors look like.
pub(super) fn are_like_the_table(values: &DVector<f64>, covariance: DMatrix<f64>) -> bool {
    chance_of_none(values, covariance) > LIKE_THE_TABLE
}

/// What differences cost, and what the background's scatter does.
fn cost(state: &State, loss: Loss) -> f64 {
    state.misfit(loss) + state.numbers.norm_squared()
}

/// Rows times weights.
pub(super) fn weighted(matrix: &DMatrix<f64>, weights: &DVector<f64>) -> DMatrix<f64> {
    let mut matrix = matrix.clone();
    weigh(&mut matrix, weights);
    matrix
}

/// The same in place.
pub(super) fn weigh(matrix: &mut DMatrix<f64>, weights: &DVector<f64>) {
    for mut column in matrix.column_iter_mut() {
        column.component_mul_assign(weights);
    }
}

impl Fit {
    /// Effects at their most probable values.
    pub fn effects(&self) -> &[Effect] {
        &self.state.effects
    }

    /// Natural logarithm of the evidence, up to what all fits of a problem have in common.
    pub fn log_evidence(&self) -> f64 {
        self.log_evidence
    }

    /// Whether all values of an effect that are fitted may be such as every good installation has.
    pub(super) fn is_usual(&self, effect: usize) -> bool {
        let parameters: Vec<&Parameter> =
            self.state.effects[effect].parameters().map(|(parameter, _)| parameter).collect();
        let estimates = self.estimates_by(effect, |at| self.covariance[(at, at)]);
        let mut fitted = parameters
            .iter()
            .zip(&estimates)
            .filter_map(|(parameter, estimate)| Some(parameter.is_usual(estimate.value, estimate.std?)));
        fitted.next().is_some_and(|first| first && fitted.all(|usual| usual))
    }

    /// Whether the values of an effect, together, differ from those at which it is not there by more than their deviations:
    /// Wald's test at 5 %. True of effects that have no value to test.
    pub(super) fn is_significant(&self, effect: usize) -> bool {
        self.away_from_none(effect, |_| 0.0)
            .is_none_or(|(values, covariance)| chance_of_none(&values, covariance) < INSIGNIFICANT)
    }

    /// Whether an effect is no larger than what the table's own errors may look like, as far as its parts scatter.
    pub(super) fn looks_like_the_table(&self, effect: usize) -> bool {
        let times = self.discrepancy.scatter.max(1.0).powi(2);
        let away = self.away_from_none(effect, |at| times * self.besides[at]);
        away.is_some_and(|(values, covariance)| are_like_the_table(&values, covariance))
    }

    /// By how much the logarithm of the evidence can fall where an effect is left out and all else is fitted anew, were differences linear;
    /// `None` of effects that have no value to leave out.
    pub(super) fn worth(&self, effect: usize) -> Option<f64> {
        let idealised = |at: usize| {
            -(IDEALISED * (self.state.value(&self.knobs[at]) - self.knobs[at].neutral) / self.knobs[at].scale).powi(2)
        };
        self.away_from_none(effect, idealised).map(|(values, covariance)| 0.5 * distance(&values, covariance))
    }

    /// How far values of an effect are from those at which it is not there, in units of their scales, with their covariance and this much variance
    /// of each besides; `None` of effects that have no value to test.
    fn away_from_none(&self, effect: usize, besides: impl Fn(usize) -> f64) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let parameter = |index: usize| {
            let knob = self.knobs.get(index).filter(|knob| knob.effect == effect)?;
            self.state.effects[effect].parameters().nth(knob.parameter).map(|(parameter, _)| parameter)
        };
        let own: Vec<usize> = (0..self.knobs.len()).filter(|&index| parameter(index).is_some()).collect();
        let is_share = |&index: &usize| parameter(index).is_some_and(|p| matches!(p.prior, Prior::Share(_)));
        // Without its mass a damper does nothing, whatever its damping.
        let has_share = own.iter().any(is_share);
        let vanishes = |index: &usize| parameter(*index).is_some_and(|p| p.neutral >= p.least);
        let knobs: Vec<usize> =
            own.into_iter().filter(vanishes).filter(|index| !has_share || is_share(index)).collect();
        if knobs.is_empty() {
            return None;
        }
        let units = |&index: &usize| {
            let knob = &self.knobs[index];
            let nothing = parameter(index).map_or(knob.neutral, |parameter| parameter.neutral);
            (self.state.value(knob) - nothing) / knob.scale
        };
        let units = DVector::from_iterator(knobs.len(), knobs.iter().map(units));
        let mut covariance = self.covariance.select_rows(&knobs).select_columns(&knobs);
        for (at, &knob) in knobs.iter().enumerate() {
            covariance[(at, at)] += besides(knob);
        }
        Some((units, covariance))
    }

    /// The values of an effect, with their standard deviations.
    pub fn estimates(&self, effect: usize) -> Vec<Estimate> {
        self.estimates_by(effect, |at| self.stated_variance(at))
    }

    /// What is stated of a knob's variance, in units of its scale.
    pub(super) fn stated_variance(&self, at: usize) -> f64 {
        self.covariance[(at, at)].max(0.0) + self.besides[at]
    }

    /// The same by the variances of knobs, in units of their scales.
    fn estimates_by(&self, effect: usize, variance: impl Fn(usize) -> f64) -> Vec<Estimate> {
        let Some(fitted) = self.state.effects.get(effect) else { return Vec::new() };
        let knob =
            |parameter: usize| self.knobs.iter().position(|knob| (knob.effect, knob.parameter) == (effect, parameter));
        let std = |at: usize| variance(at).max(0.0).sqrt() * self.knobs[at].scale;
        let sizes = |at: usize| {
            let knob = &self.knobs[at];
            ((self.state.value(knob) - knob.neutral) / knob.scale).abs()
        };
        fitted
            .parameters()
            .enumerate()
            .map(|(index, (parameter, value))| Estimate {
                name: parameter.name.to_owned(),
                value,
                std: knob(index).map(std),
                unit: parameter.unit.to_owned(),
                typical_sizes: knob(index).map(sizes),
            })
            .collect()
    }

    /// Where an effect is.
    pub fn place(&self, effect: usize) -> Option<&Where> {
        self.state.effects.get(effect).and_then(Effect::place)
    }
}

/// Differences seen through what else is uncertain: background and effects in the model.
pub(super) struct Marginal {
    /// Of what is uncertain, by weight.
    jacobian: DMatrix<f64>,
    curvature: Cholesky<f64, Dyn>,
    /// Square roots of the weights of differences.
    pub(super) weights: DVector<f64>,
    /// Cholesky factors of the modes' covariances.
    pub(super) factors: Vec<Cholesky<f64, Dyn>>,
    /// What is left of the differences, by weight, where all that is uncertain does what it can.
    pub(super) left: DVector<f64>,
}

impl Marginal {
    /// From derivatives by weight, of which the first `count` are by knobs, and differences without scatter.
    pub(super) fn of(
        jacobian: DMatrix<f64>,
        count: usize,
        weights: DVector<f64>,
        factors: Vec<Cholesky<f64, Dyn>>,
        straight: &DVector<f64>,
    ) -> Option<Self> {
        let mut curvature = squares(&jacobian);
        for index in 0..curvature.nrows() {
            curvature[(index, index)] += if index < count { 1e-12 } else { 1.0 };
        }
        let left = straight.component_mul(&weights);
        let mut marginal = Self { jacobian, curvature: Cholesky::new(curvature)?, weights, factors, left };
        marginal.left = marginal.project(&DMatrix::from_columns(&[marginal.left.clone()])).column(0).into_owned();
        Some(marginal)
    }

    /// Columns by weight.
    pub(super) fn weigh(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        weighted(columns, &self.weights)
    }

    /// `P g`, P = I - J (JᵀJ + D)⁻¹ Jᵀ with D the prior's precision, of columns by weight: whitened by measurement,
    /// background and other effects.
    pub(super) fn project(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        columns - &self.jacobian * self.curvature.solve(&self.jacobian.tr_mul(columns))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::testing::{measured, study};
    use super::*;

    /// An effect that moves frequencies by little: leaving it out costs what its value and deviation say.
    #[test]
    fn an_effect_is_worth_what_leaving_it_out_costs() {
        let (structure, model, sensors) = study();
        let effect: Effect = "base-rotation=2e-15".parse().unwrap();
        let truth = structure.clone().and(std::slice::from_ref(&effect)).unwrap();
        let modes = measured(&truth, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(3));
        let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
        let present = problem.present(&[]).unwrap();
        let found = problem.search_kind(&present, effect.of_kind(), None).unwrap();
        let worth = found.fit.worth(0).unwrap();
        let costs = 0.5 * (cost(&present.state, Loss::Robust) - cost(&found.fit.state, Loss::Robust));
        assert!(costs > 2.0 && (worth / costs - 1.0).abs() < 0.2, "{worth} and {costs}");
    }
}
