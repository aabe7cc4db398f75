//! What every candidate would explain, by one linear step from the present model.
//!
//! Candidates and a fit flow in; the gain in evidence of each, and the values it would have, flow out.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::candidates::{Candidate, Options};
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
        let neutral = candidate.neutral();
        let effect = candidate.effect(&neutral)?;
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
        let columns = marginal.weigh(&DMatrix::from_columns(&columns?));
        let projected = marginal.project(&columns);
        let information = columns.tr_mul(&projected);
        // The background, or effects in the model, explain the same: the data cannot see this candidate.
        if (0..knobs.len()).any(|at| information[(at, at)] < SEPARATE * columns.column(at).norm_squared()) {
            return None;
        }
        let gradient = columns.tr_mul(differences);
        let admissible = |units: &DVector<f64>| {
            knobs.iter().zip(units.iter()).all(|(knob, units)| {
                let value = knob.neutral + units * knob.scale;
                value >= knob.bounds[0]
            })
        };
        let units = Cholesky::new(information.clone())?.solve(&-&gradient);
        if !units.iter().all(|units| units.is_finite()) {
            return None;
        }
        let admissible = admissible(&units);
        let with_prior = &information + DMatrix::identity(knobs.len(), knobs.len());
        let log_determinant: f64 =
            Cholesky::new(with_prior)?.l_dirty().diagonal().iter().map(|value| 2.0 * value.ln()).sum();
        let prior: f64 = units.iter().map(|&units| prior_misfit(units)).sum();
        let gain = 0.5 * (-gradient.dot(&units) - log_determinant - prior);
        let values = knobs
            .iter()
            .zip(units.iter())
            .map(|(knob, units)| (knob.neutral + units * knob.scale, knob.bounds))
            .map(|(value, bounds)| if admissible { value.clamp(bounds[0], bounds[1]) } else { value });
        let mut all = neutral;
        for (knob, value) in knobs.iter().zip(values) {
            all[knob.parameter] = value;
        }
        Some(Scored { candidate, gain, knobs, values: all, admissible })
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
