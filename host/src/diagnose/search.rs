//! Through the catalogue: every effect at every place, scored by what it explains, the best refitted.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::candidates::Candidate;
use super::fit::{Fit, Marginal};
use super::problem::Problem;
use super::state::{Knob, Loss, State};
use super::verdict::FAILS;
use crate::model::effect::{Effect, EffectKind, Evidence, KINDS, Parameter, Where};

/// What a search leaves out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Kinds that are not considered.
    pub without: Vec<String>,
}

/// A candidate and what it would explain, by one linear step from the present model.
struct Scored {
    candidate: Candidate,
    /// Gain in the logarithm of the evidence.
    gain: f64,
    knobs: Vec<Knob>,
    /// The values that the linear step gives.
    values: Vec<f64>,
}

/// A kind's best place, refitted.
pub(super) struct Found {
    /// The effect's kind.
    pub(super) kind: &'static dyn EffectKind,
    /// The fit with it; it is the last effect there.
    pub(super) fit: Fit,
    /// The logarithm of the evidence over that of the present model, averaged over the places of the kind.
    pub(super) log_bayes_factor: f64,
    /// Other places that explain nearly as much: the logarithm of their evidence below that of the best.
    pub(super) near: Vec<(Where, f64)>,
}

impl Found {
    /// The effect found.
    pub(super) fn effect(&self) -> &Effect {
        &self.fit.state.effects[self.index()]
    }

    /// Its index among the effects of the fit.
    pub(super) fn index(&self) -> usize {
        self.fit.state.effects.len() - 1
    }
}

/// Kinds that are refitted.
const REFITTED: usize = 10;
/// Places of a kind that are refitted.
const PLACES: usize = 2;
/// Moves from place to neighbouring place.
const MOST_MOVES: usize = 6;
/// Where something fits: a promise below the best's gain by more than this share of it is none.
const CONTENDS: f64 = 0.3;
/// Where nothing fits yet: a promise below this share of the best's gain is none.
const HOPELESS: f64 = 0.1;
/// Places that are named beside the best.
const NEAR: f64 = 3.0;

impl Problem {
    /// The present model's best values, from those of the effects in it.
    pub(super) fn present(&self, effects: &[Effect]) -> Result<Fit, String> {
        let numbers = DVector::zeros(self.background.size());
        let state = self.state(effects.to_vec(), numbers.clone(), None)?;
        let knobs = self.all_knobs(&state);
        self.fit(effects.to_vec(), &knobs, &numbers, Some(&state))
    }

    /// The knobs of all effects of a state.
    pub(super) fn all_knobs(&self, state: &State) -> Vec<Knob> {
        let of = |effect: usize| state.knobs(self, &state.effects, effect, &[]).unwrap_or_default();
        (0..state.effects.len())
            .filter(|&effect| shows_in_modes(state.effects[effect].of_kind()))
            .flat_map(of)
            .collect()
    }

    /// Every kind that explains anything, refitted at its best place; best first.
    pub(super) fn search(&self, present: &Fit, options: &Options) -> Vec<Found> {
        let scored = self.scored_twice(present, |from| self.score(from, options));
        let mut kinds: Vec<Vec<Scored>> = Vec::new();
        for one in scored {
            match kinds.iter_mut().find(|kind| kind[0].candidate.kind == one.candidate.kind) {
                Some(kind) => kind.push(one),
                None => kinds.push(vec![one]),
            }
        }
        for kind in &mut kinds {
            kind.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        }
        kinds.sort_by(|a, b| b[0].gain.total_cmp(&a[0].gain));
        kinds.truncate(REFITTED);
        // A first look at each, at its best place; then all places of those that can still be the best.
        let looks: Vec<Option<Fit>> = kinds.par_iter().map(|kind| self.refit_one(present, &kind[0], None)).collect();
        let gain = |look: &Option<Fit>| {
            look.as_ref().map_or(f64::NEG_INFINITY, |fit| fit.log_evidence() - present.log_evidence())
        };
        let best = looks.iter().map(gain).fold(0.0, f64::max);
        let fits = looks.iter().flatten().any(|fit| fit.goodness_of_fit().p_value >= FAILS);
        // Where something fits already, what promises far less than that explains need not be looked at twice.
        let contends = |kind: &[Scored], look: &Option<Fit>| {
            let promised = kind[0].gain.max(gain(look));
            if fits { promised > best - NEAR.max(CONTENDS * best) } else { promised > HOPELESS * best }
        };
        let mut found: Vec<Found> = kinds
            .par_iter()
            .zip(looks)
            .filter_map(|(kind, look)| {
                let further = contends(kind, &look);
                self.refit(present, kind, look, further)
            })
            .collect();
        found.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
        found
    }

    /// Scores from the fit, and from the model as given: where the background was bent far to make up for an effect, the
    /// effect may seem to have the wrong sign. The better of the two counts.
    fn scored_twice(&self, present: &Fit, score: impl Fn(&Fit) -> Vec<Scored>) -> Vec<Scored> {
        let mut scored = score(present);
        if let Ok(given) = self.without_scatter(present) {
            merge(&mut scored, score(&given));
        }
        scored
    }

    /// One kind, at its best place or at the one that is given.
    pub(super) fn search_kind(
        &self,
        present: &Fit,
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
    ) -> Option<Found> {
        let candidates = match place {
            Some(place) => self.candidates_at(kind, vec![Some(place.clone())], present),
            None => self.candidates(kind, present),
        };
        let score = |from: &Fit| self.score_all(from, &from.marginal(), candidates.clone());
        let mut scored = self.scored_twice(present, score);
        scored.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let look = self.refit_one(present, scored.first()?, None);
        self.refit(present, &scored, look, true)
    }

    /// Refits a kind at its best places, of which `look` is the first, and (with `further`) from there at their neighbours
    /// while that gains.
    fn refit(&self, present: &Fit, scored: &[Scored], look: Option<Fit>, further: bool) -> Option<Found> {
        let mut fits: Vec<(usize, Fit)> = Vec::new();
        let mut tried = vec![false; scored.len()];
        let mut starts = Vec::new();
        for (index, one) in scored.iter().enumerate() {
            let apart = |&start: &usize| !one.candidate.is_near(&scored[start].candidate, self);
            if starts.len() < PLACES && starts.iter().all(apart) {
                starts.push(index);
            }
        }
        if let Some(first) = tried.first_mut() {
            *first = true;
            fits.extend(look.map(|fit| (0, fit)));
        }
        for start in starts.into_iter().filter(|start| *start > 0 && further) {
            tried[start] = true;
            if let Some(fit) = self.refit_one(present, &scored[start], None) {
                fits.push((start, fit));
            }
        }
        for _ in 0..if further { MOST_MOVES } else { 0 } {
            let best = fits.iter().max_by(|a, b| a.1.log_evidence().total_cmp(&b.1.log_evidence()))?.0;
            let neighbours: Vec<usize> = (0..scored.len())
                .filter(|&other| !tried[other] && scored[other].candidate.is_beside(&scored[best].candidate, self))
                .collect();
            if neighbours.is_empty() {
                break;
            }
            for other in neighbours {
                tried[other] = true;
                let from = fits.iter().find(|(index, _)| *index == best).map(|(_, fit)| fit);
                if let Some(fit) = self.refit_one(present, &scored[other], from) {
                    fits.push((other, fit));
                }
            }
        }
        fits.sort_by(|a, b| b.1.log_evidence().total_cmp(&a.1.log_evidence()));
        let best = fits.first()?.1.log_evidence();
        // Places that were not refitted count by their linear gain, never above the best.
        let reference = present.log_evidence();
        let gains: Vec<f64> = (0..scored.len())
            .map(|index| {
                let refitted = fits.iter().find(|(other, _)| *other == index).map(|(_, fit)| fit.log_evidence());
                refitted.unwrap_or((scored[index].gain + reference).min(best - 1.0)) - reference
            })
            .collect();
        let sum: f64 = gains.iter().map(|gain| (gain - (best - reference)).exp()).sum();
        let log_bayes_factor = best - reference + (sum / scored.len() as f64).ln();
        let near = fits[1..]
            .iter()
            .filter(|(_, fit)| best - fit.log_evidence() < NEAR)
            .filter_map(|(index, fit)| Some((scored[*index].candidate.place.clone()?, best - fit.log_evidence())))
            .collect();
        let fit = fits.swap_remove(0).1;
        Some(Found { kind: scored[0].candidate.kind, fit, log_bayes_factor, near })
    }

    /// Refits one candidate, from the values of the linear step and from those of a fit near by.
    fn refit_one(&self, present: &Fit, scored: &Scored, near: Option<&Fit>) -> Option<Fit> {
        let index = present.state.effects.len();
        let mut knobs = present.knobs.clone();
        knobs.extend(scored.knobs.iter().copied());
        let bent = near.map_or(&present.state.numbers, |fit| &fit.state.numbers);
        let straight = bent.map(|_| 0.0);
        let linear = scored.candidate.start(&scored.knobs, &scored.values, LONGEST_START);
        let mut starts = vec![(linear.clone(), bent)];
        if let Some(near) = near {
            let values: Vec<f64> = near.state.effects[index].parameters().map(|(_, value)| value).collect();
            if values.len() == linear.len() {
                starts.insert(0, (scored.candidate.like(&values), bent));
            }
        } else if !scored.knobs.is_empty() {
            // The present background was bent to make up for what the effect does; and beyond the linear, nearer to where the
            // present model is.
            starts.push((linear, &straight));
            starts.push((scored.candidate.start(&scored.knobs, &scored.values, SHORTER_START), &straight));
        }
        let fit = |(values, numbers): &(Vec<f64>, &DVector<f64>)| {
            let effect = scored.candidate.effect(values)?;
            let mut effects = match near {
                Some(near) => near.state.effects[..index].to_vec(),
                None => present.state.effects.clone(),
            };
            effects.push(effect);
            self.fit(effects, &knobs, numbers, None).ok()
        };
        let mut best: Option<Fit> = None;
        for start in &starts {
            if let Some(fit) = fit(start) {
                // The linear step promised as much.
                let gain = fit.log_evidence() - present.log_evidence();
                let settled = near.is_some() || gain > DISAPPOINTS * scored.gain;
                if best.as_ref().is_none_or(|best| fit.log_evidence() > best.log_evidence()) {
                    best = Some(fit);
                }
                if settled {
                    break;
                }
            }
        }
        best
    }

    /// Scores every candidate by one linear step: `T = gᵀ P r` over `gᵀ P g` in several dimensions.
    fn score(&self, present: &Fit, options: &Options) -> Vec<Scored> {
        let marginal = present.marginal();
        let kinds: Vec<&'static dyn EffectKind> = KINDS
            .iter()
            .copied()
            .filter(|kind| shows_in_modes(*kind) && !options.without.iter().any(|name| name == kind.name()))
            .collect();
        let of_kind = |kind: &&'static dyn EffectKind| -> Vec<Scored> {
            self.score_all(present, &marginal, self.candidates(*kind, present))
        };
        kinds.par_iter().flat_map(of_kind).collect()
    }

    /// Scores candidates of one kind, neighbours after each other.
    fn score_all(&self, present: &Fit, marginal: &Marginal, candidates: Vec<Candidate>) -> Vec<Scored> {
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
            let effects = super::state::with_values(&effects, std::slice::from_ref(knob), &[value]);
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
        // What the background or effects in the model explain as well is no effect of its own.
        if (0..knobs.len()).any(|at| information[(at, at)] < SEPARATE * columns.column(at).norm_squared()) {
            return None;
        }
        let gradient = columns.tr_mul(differences);
        let admissible = |units: &DVector<f64>| {
            knobs.iter().zip(units.iter()).all(|(knob, units)| {
                let value = knob.neutral + units * knob.scale;
                value >= knob.bounds[0] && units.is_finite()
            })
        };
        let units = Cholesky::new(information.clone())?.solve(&-&gradient);
        if !admissible(&units) {
            return None;
        }
        let with_prior = &information + DMatrix::identity(knobs.len(), knobs.len());
        let log_determinant: f64 =
            Cholesky::new(with_prior)?.l_dirty().diagonal().iter().map(|value| 2.0 * value.ln()).sum();
        let gain = 0.5 * (-gradient.dot(&units) - log_determinant - units.norm_squared());
        let values = knobs
            .iter()
            .zip(units.iter())
            .map(|(knob, units)| (knob.neutral + units * knob.scale).clamp(knob.bounds[0], knob.bounds[1]));
        let mut all = neutral;
        for (knob, value) in knobs.iter().zip(values) {
            all[knob.parameter] = value;
        }
        Some(Scored { candidate, gain, knobs, values: all })
    }

    /// An effect that is there or not.
    fn score_discrete(&self, present: &Fit, candidate: Candidate) -> Option<Scored> {
        let mut effects = present.state.effects.clone();
        effects.push(candidate.effect(&[])?);
        let before = present.state.misfit(Loss::Robust);
        let state = self.state(effects, present.state.numbers.clone(), Some(&present.state)).ok()?;
        let gain = 0.5 * (before - state.misfit(Loss::Robust));
        Some(Scored { candidate, gain, knobs: Vec::new(), values: Vec::new() })
    }
}

/// Starts go no further than this many prior scales.
const LONGEST_START: f64 = 2.0;
const SHORTER_START: f64 = 0.3;
/// A fit that reaches less than this share of what the linear step promised is tried from another start.
const DISAPPOINTS: f64 = 0.5;
/// Keeps the better score of each candidate.
fn merge(scored: &mut Vec<Scored>, others: Vec<Scored>) {
    for other in others {
        match scored.iter_mut().find(|one| one.candidate.is_same(&other.candidate)) {
            Some(one) if one.gain >= other.gain => {}
            Some(one) => *one = other,
            None => scored.push(other),
        }
    }
}

/// An effect that keeps less than this share of itself beside the background and other effects is none of its own.
const SEPARATE: f64 = 1e-6;

/// Whether an effect is looked for in modes (and phases).
pub(super) fn shows_in_modes(kind: &dyn EffectKind) -> bool {
    matches!(kind.evidence(), Evidence::Modes | Evidence::Phases)
}
