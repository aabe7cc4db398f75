//! What every candidate would explain, by one linear step from the present model.
//!
//! Candidates and a fit flow in; the gain in evidence of each, and the values it would have, flow out.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::candidates::{Candidate, Options};
use super::discrepancy::log_determinant;
use super::fit::{Fit, Marginal, prior_misfit};
use super::knob::{Knob, with_values};
use super::misfit::Loss;
use super::problem::Problem;
use crate::model::effect::{EffectKind, Evidence, KINDS, Parameter};

/// A candidate and what it would explain, by one linear step from the present model.
pub(super) struct Scored {
    pub(super) candidate: Candidate,
    /// Gain in the logarithm of the evidence.
    pub(super) gain: f64,
    pub(super) knobs: Vec<Knob>,
    /// The values that the linear step gives.
    pub(super) values: Vec<f64>,
    /// Whether the linear step stays inside the bounds.
    pub(super) admissible: bool,
}

impl Problem {
    /// Scores from the fit, and from the model as given: where the background was bent far to make up for an effect, the
    /// effect may seem to have the wrong sign. The better of the two counts.
    pub(super) fn scored_twice(&self, present: &Fit, score: impl Fn(&Fit) -> Vec<Scored>) -> Vec<Scored> {
        let mut scored = score(present);
        if let Ok(given) = self.without_scatter(present) {
            merge(&mut scored, score(&given));
        }
        scored
    }

    /// Scores every candidate by one linear step: `T = gᵀ P r` over `gᵀ P g` in several dimensions.
    pub(super) fn score(&self, present: &Fit, options: &Options) -> Vec<Scored> {
        let marginal = present.marginal();
        let kinds: Vec<&'static dyn EffectKind> =
            KINDS.iter().copied().filter(|kind| shows_by_derivative(*kind) && !options.leaves_out(*kind)).collect();
        let of_kind = |kind: &&'static dyn EffectKind| -> Vec<Scored> {
            self.score_all(present, &marginal, self.candidates(*kind, present))
        };
        kinds.par_iter().flat_map(of_kind).collect()
    }

    /// Scores candidates of one kind, neighbours after each other.
    pub(super) fn score_all(&self, present: &Fit, marginal: &Marginal, candidates: Vec<Candidate>) -> Vec<Scored> {
        let differences = marginal.left(&present.state);
        let mut guesses: Vec<f64> = Vec::new();
        let score = |candidate: Candidate| match candidate.parameters.iter().any(Parameter::is_fitted) {
            true => self.score_one(present, marginal, &differences, candidate, &mut guesses),
            false => self.score_discrete(present, candidate),
        };
        candidates.into_iter().filter_map(score).collect()
    }

    fn score_one(
        &self,
        present: &Fit,
        marginal: &Marginal,
        differences: &DVector<f64>,
        candidate: Candidate,
        guesses: &mut Vec<f64>,
    ) -> Option<Scored> {
        let (knobs, columns) = self.columns_of(present, &candidate, guesses)?;
        let columns = marginal.weigh(&columns);
        let projected = marginal.project(&columns);
        let information = columns.tr_mul(&projected);
        if !is_seen(&information, &columns) {
            return None;
        }
        let gradient = columns.tr_mul(differences);
        let (linear, gain) = LinearStep::of(information.clone())?.against(&gradient);
        let (units, steeper) = enlarged(&candidate, &knobs, &linear, information);
        if !units.iter().all(|units| units.is_finite()) {
            return None;
        }
        let gain = match steeper {
            Some(steeper) => {
                let with_prior = Cholesky::new(&steeper + DMatrix::identity(knobs.len(), knobs.len()))?;
                let prior: f64 = units.iter().map(|&units| prior_misfit(units)).sum();
                0.5 * (-gradient.dot(&linear) - log_determinant(&with_prior) - prior)
            }
            None => gain,
        };
        let admissible = is_admissible(&knobs, &units);
        let values = knobs
            .iter()
            .zip(units.iter())
            .map(|(knob, units)| (knob.neutral + units * knob.scale, knob.bounds))
            .map(|(value, bounds)| if admissible { value.clamp(bounds[0], bounds[1]) } else { value });
        let mut all = candidate.neutral();
        for (knob, value) in knobs.iter().zip(values) {
            all[knob.parameter] = value;
        }
        Some(Scored { candidate, gain, knobs, values: all, admissible })
    }

    /// The numbers of a candidate that are fitted, and how the differences follow them at the present state (in units of their
    /// scale). `guesses` are steps that served a neighbour; those that serve this candidate take their place.
    pub(super) fn columns_of(
        &self,
        present: &Fit,
        candidate: &Candidate,
        guesses: &mut Vec<f64>,
    ) -> Option<(Vec<Knob>, DMatrix<f64>)> {
        let effect = candidate.effect(&candidate.neutral())?;
        let mut effects = present.state.effects.clone();
        effects.push(effect);
        let index = effects.len() - 1;
        // At its neutral values the effect changes nothing, so the present state serves.
        let knobs = present.state.knobs(self, &effects, index, guesses)?;
        let structure_at = |knob: &Knob, value: f64| {
            let effects = with_values(&effects, std::slice::from_ref(knob), &[value]);
            self.structure_with(&effects, &present.state.numbers)
        };
        let columns: Option<Vec<DVector<f64>>> = knobs
            .iter()
            .map(|knob| {
                let structure = structure_at(knob, knob.neutral + knob.step)?;
                Some(present.state.towards(self, &structure, knob.step)? * knob.scale)
            })
            .collect();
        *guesses = knobs.iter().map(|knob| knob.step).collect();
        Some((knobs, DMatrix::from_columns(&columns?)))
    }

    /// An effect that is there or not.
    fn score_discrete(&self, present: &Fit, candidate: Candidate) -> Option<Scored> {
        let mut effects = present.state.effects.clone();
        effects.push(candidate.effect(&[])?);
        let before = present.state.misfit(Loss::Robust);
        let state = self.state(effects, present.state.numbers.clone(), Some(&present.state)).ok()?;
        let gain = 0.5 * (before - state.misfit(Loss::Robust));
        Some(Scored { candidate, gain, knobs: Vec::new(), values: Vec::new(), admissible: true })
    }
}

/// Where parameters act by a power of themselves: the values that a linear step stands for, and the information there. The step stands for
/// a slope that is zero where the effect is not there: so far does the same change take the value, and there the slope is as much steeper.
fn enlarged(
    candidate: &Candidate,
    knobs: &[Knob],
    linear: &DVector<f64>,
    mut information: DMatrix<f64>,
) -> (DVector<f64>, Option<DMatrix<f64>>) {
    let mut units = linear.clone();
    let mut is_enlarged = false;
    for (at, knob) in knobs.iter().enumerate().filter(|(_, knob)| candidate.parameters[knob.parameter].power > 1) {
        is_enlarged = true;
        let step = knob.step / knob.scale;
        let parameter = &candidate.parameters[knob.parameter];
        units[at] = units[at].signum() * parameter.enlarged(step, units[at] / step);
        let steeper = f64::from(parameter.power) * (units[at] / step).abs().powi(i32::from(parameter.power) - 1);
        information.row_mut(at).scale_mut(steeper);
        information.column_mut(at).scale_mut(steeper);
    }
    (units, is_enlarged.then_some(information))
}

/// What one linear step along some directions gains.
pub(super) struct LinearStep {
    information: Cholesky<f64, Dyn>,
    /// Of the information with that of the prior.
    log_determinant: f64,
}

impl LinearStep {
    /// Along directions with this information, in units of their scales; `None` where they are not independent.
    pub(super) fn of(information: DMatrix<f64>) -> Option<Self> {
        let size = information.nrows();
        let with_prior = Cholesky::new(&information + DMatrix::identity(size, size))?;
        Some(Self { log_determinant: log_determinant(&with_prior), information: Cholesky::new(information)? })
    }

    /// The values that the step leads to, and the gain in the logarithm of the evidence, where the misfit has this gradient.
    pub(super) fn against(&self, gradient: &DVector<f64>) -> (DVector<f64>, f64) {
        let units = self.information.solve(&-gradient);
        let prior: f64 = units.iter().map(|&units| prior_misfit(units)).sum();
        let gain = 0.5 * (-gradient.dot(&units) - self.log_determinant - prior);
        (units, gain)
    }
}

/// Whether the data see a candidate of this information behind background and other effects; `columns` by weight are what it does.
pub(super) fn is_seen(information: &DMatrix<f64>, columns: &DMatrix<f64>) -> bool {
    (0..columns.ncols()).all(|at| information[(at, at)] >= SEPARATE * columns.column(at).norm_squared())
}

/// Whether values (in units of their scales) are not below their bounds.
pub(super) fn is_admissible(knobs: &[Knob], units: &DVector<f64>) -> bool {
    knobs.iter().zip(units.iter()).all(|(knob, units)| knob.neutral + units * knob.scale >= knob.bounds[0])
}

/// Keeps the better score of each candidate.
fn merge(scored: &mut Vec<Scored>, others: Vec<Scored>) {
    for other in others {
        match scored.iter_mut().find(|one| one.candidate.is_same(&other.candidate)) {
            Some(one) if (one.admissible, one.gain) >= (other.admissible, other.gain) => {}
            Some(one) => *one = other,
            None => scored.push(other),
        }
    }
}

/// Where background and other effects explain all but this share of what a candidate does, the data cannot see it.
const SEPARATE: f64 = 1e-6;

/// Whether the derivative at the model without it leads to an effect.
pub(super) fn shows_by_derivative(kind: &dyn EffectKind) -> bool {
    matches!(kind.evidence(), Evidence::Modes | Evidence::Phases)
}
