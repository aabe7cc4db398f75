//! Through the catalogue: every effect at every place, scored by what it explains, the best refitted.

use nalgebra::DVector;
use rayon::prelude::*;

use super::candidates::Options;
use super::criteria::{FAILS, STANDS_OUT};
use super::discrepancy::{Discrepancy, Settled, here};
use super::error::NoneFound;
use super::fit::Fit;
use super::found::{AtHeight, Found, NEAR, best_of};
use super::problem::Problem;
use super::score::Scored;
use crate::model::effect::{EffectKind, Evidence, KINDS, Where};

/// What a search has found.
pub(super) struct Searched {
    /// The problem with the discrepancy that all of it was found with, and the present model there; `None` where it is that of the
    /// problem that was searched.
    pub(super) settled: Settled,
    /// The present model with the discrepancy that suits it best, where that is another.
    pub(super) own: Settled,
    /// Kinds that explain anything, best first.
    pub(super) found: Vec<Found>,
    /// Kinds that would explain something with a value that is out of bounds: the best of each.
    pub(super) rejected: Vec<Scored>,
}

/// Scores of each kind, best first; the kind with the best first.
fn by_kind(scored: Vec<Scored>) -> Vec<Vec<Scored>> {
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
    kinds
}

/// Best first.
fn sort(found: &mut [Found]) {
    found.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
}

/// Kinds whose places are settled.
const SETTLED: usize = 2;
/// A far start that gains no more than this has found the same optimum.
const SAME: f64 = 1.0;
/// Kinds that are refitted.
const REFITTED: usize = 10;
/// Places of a kind that are refitted.
const PLACES: usize = 2;
/// Moves from place to neighbouring place.
const MOST_MOVES: usize = 6;
/// Where something fits already: a candidate whose promised gain is below the best's by more than this share of it is dropped.
const CONTENDS: f64 = 0.3;
/// Where nothing fits yet: a candidate that promises less than this share of the best's gain is dropped.
const HOPELESS: f64 = 0.1;

impl Problem {
    /// Every kind that explains anything, refitted at its best place; best first.
    ///
    /// At first as if the model missed nothing else, then with the discrepancy that the best of them leaves, as long as a model of the
    /// right kind can miss as much. In the end the present model and each effect are weighed with what suits each best.
    pub(super) fn search(&self, present: &Fit, options: &Options) -> Searched {
        let (mut found, mut rejected) = self.search_all(present, options);
        let best = best_of(&found, present).map_or(present, |best| &best.fit);
        let discrepancy = self.settled(best).map(|(_, best)| best.discrepancy);
        let settled = discrepancy.filter(Discrepancy::is_plausible).and_then(|discrepancy| {
            let problem = self.with_discrepancy(discrepancy);
            let present = problem.refitted(present).ok()?;
            (found, rejected) = problem.search_all(&present, options);
            Some((problem, present))
        });
        let (problem, present) = here(&settled, self, present);
        let fits = found.iter().any(|found| found.fit.explains(present));
        if !fits && present.goodness_of_fit().p_value < FAILS {
            for far in problem.search_far(present, options) {
                match found.iter_mut().find(|near| near.kind == far.kind) {
                    Some(near) if near.log_bayes_factor >= far.log_bayes_factor - SAME => {}
                    Some(near) => *near = far,
                    None => found.push(far),
                }
            }
            sort(&mut found);
            problem.settle_heights(&mut found);
        }
        let own = problem.weigh_each(present, &mut found);
        Searched { settled, own, found, rejected }
    }

    /// Weighs the present model and the best of what was found, each with the discrepancy that suits it best.
    pub(super) fn weigh_each(&self, present: &Fit, found: &mut [Found]) -> Settled {
        let own = self.settled(present);
        let raised = own.as_ref().map_or(0.0, |(_, own)| own.log_evidence() - present.log_evidence());
        let estimate = |found: &Found| match found.log_bayes_factor > 0.0 {
            true => self.best_discrepancy(&found.fit),
            false => (self.discrepancy, 0.0),
        };
        let estimates: Vec<(Discrepancy, f64)> = found.par_iter().map(estimate).collect();
        let gains = found.iter().zip(&estimates).map(|(found, (_, gain))| found.log_bayes_factor + gain);
        let best = gains.fold(0.0, f64::max);
        found.par_iter_mut().zip(estimates).for_each(|(found, (discrepancy, gain))| {
            let estimated = found.log_bayes_factor + gain;
            if gain > 0.0 && estimated > best - NEAR.max(CONTENDS * best) {
                found.own = self.settled_from(&found.fit, discrepancy).map(|(_, own)| own);
                found.log_bayes_factor += found.own().log_evidence() - found.fit.log_evidence();
            } else {
                found.log_bayes_factor = estimated;
            }
            found.log_bayes_factor -= raised;
        });
        sort(found);
        own
    }

    /// Every kind near the present model, with this discrepancy.
    fn search_all(&self, present: &Fit, options: &Options) -> (Vec<Found>, Vec<Scored>) {
        let scored = self.scored_twice(present, |from| self.score(from, options));
        let (scored, rejected): (Vec<Scored>, Vec<Scored>) = scored.into_iter().partition(|one| one.admissible);
        let kinds = by_kind(scored);
        let rejected: Vec<Scored> = by_kind(rejected)
            .into_iter()
            .filter_map(|kind| kind.into_iter().next())
            .filter(|one| one.gain > STANDS_OUT)
            .filter(|one| kinds.iter().all(|kind| kind[0].candidate.kind != one.candidate.kind))
            .collect();
        let mut found = self.search_near(present, &kinds);
        let twins = KINDS.iter().copied().filter(|kind| kind.evidence() == Evidence::TwinPeaks);
        let twins = twins.filter(|kind| !options.leaves_out(*kind));
        found.extend(twins.filter_map(|kind| self.search_damper(present, kind, None)));
        sort(&mut found);
        self.settle_heights(&mut found);
        (found, rejected)
    }

    /// Kinds refitted from where the linear step leads: a first look at each, at its best place; then all places of those that
    /// can still be the best.
    fn search_near(&self, present: &Fit, kinds: &[Vec<Scored>]) -> Vec<Found> {
        let kinds = &kinds[..kinds.len().min(REFITTED)];
        // A kind that promises next to nothing compared with the best gets a single start.
        let promised = kinds.first().map_or(0.0, |kind| kind[0].gain);
        let look = |kind: &Vec<Scored>| {
            let most = if kind[0].gain > HOPELESS * promised { usize::MAX } else { 1 };
            self.refit_one(present, &kind[0], None, most)
        };
        let looks: Vec<Option<Fit>> = kinds.par_iter().map(look).collect();
        let gain = |look: &Option<Fit>| {
            look.as_ref().map_or(f64::NEG_INFINITY, |fit| fit.log_evidence() - present.log_evidence())
        };
        let best = looks.iter().map(gain).fold(0.0, f64::max);
        let fits = looks.iter().flatten().any(|fit| fit.goodness_of_fit().p_value >= FAILS);
        // Where something fits already, a kind that promises far less needs no second look.
        let contends = |kind: &[Scored], look: &Option<Fit>| {
            let promised = kind[0].gain.max(gain(look));
            if fits { promised > best - NEAR.max(CONTENDS * best) } else { promised > HOPELESS * best }
        };
        let refit = |(kind, look): (&Vec<Scored>, Option<Fit>)| {
            let further = contends(kind, &look);
            self.refit(present, kind, look, further, self.hypotheses(kind[0].candidate.kind, present))
        };
        kinds.par_iter().zip(looks).filter_map(refit).collect()
    }

    /// Settles where the best of those at a height are.
    fn settle_heights(&self, found: &mut [Found]) {
        let best = found.first().map_or(0.0, |best| best.log_bayes_factor);
        let contends =
            |found: &&mut Found| found.height.is_none() && found.log_bayes_factor > best - NEAR.max(CONTENDS * best);
        found.iter_mut().filter(contends).take(SETTLED).collect::<Vec<_>>().into_par_iter().for_each(|found| {
            if found.kind.evidence() != Evidence::TwinPeaks {
                self.settle_height(found);
            }
        });
        sort(found);
    }

    /// One kind, at its best place or at the one that is given.
    ///
    /// # Errors
    /// Why the kind is not found.
    pub(super) fn search_kind(
        &self,
        present: &Fit,
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
    ) -> Result<Found, NoneFound> {
        if kind.evidence() == Evidence::TwinPeaks {
            return self.search_damper(present, kind, place).ok_or(NoneFound::Unseen);
        }
        let candidates = match place {
            Some(place) => self.candidates_at(kind, vec![Some(place.clone())], present),
            None => self.candidates(kind, present),
        };
        let hypotheses = if place.is_some() { 1 } else { self.hypotheses(kind, present) };
        let score = |from: &Fit| self.score_all(from, &from.marginal(), candidates.clone());
        let scored = self.scored_twice(present, score);
        let is_seen = !scored.is_empty();
        let (mut scored, rejected): (Vec<Scored>, Vec<Scored>) = scored.into_iter().partition(|one| one.admissible);
        scored.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let near = scored.first().and_then(|first| {
            let look = self.refit_one(present, first, None, usize::MAX);
            self.refit(present, &scored, look, true, hypotheses)
        });
        let is_enough = |found: &Found| found.stands_out() && found.fit.goodness_of_fit().p_value >= FAILS;
        let far = match &near {
            Some(near) if is_enough(near) => None,
            _ => self.far_of_kind(present, kind, candidates.clone()),
        };
        let best = [near, far].into_iter().flatten().max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor));
        let Some(mut found) = best else {
            let wanted = rejected.iter().max_by(|a, b| a.gain.total_cmp(&b.gain)).filter(|one| one.gain > 0.0);
            return Err(match wanted.and_then(|one| Some((one, one.knobs.first()?))) {
                Some((one, knob)) => NoneFound::OutOfBounds { value: one.values[knob.parameter] },
                None if candidates.is_empty() => NoneFound::NoPlace,
                None if !is_seen && !present.state.effects.is_empty() => NoneFound::LikeOthers,
                None => NoneFound::Unseen,
            });
        };
        if place.is_none() {
            self.settle_height(&mut found);
        }
        Ok(found)
    }

    /// Refits a kind at its best places, of which `look` is the first, and (with `further`) from there at their neighbours
    /// while that gains; the evidence is averaged over all `hypotheses`, of which those that were not scored explain nothing.
    fn refit(
        &self,
        present: &Fit,
        scored: &[Scored],
        look: Option<Fit>,
        further: bool,
        hypotheses: usize,
    ) -> Option<Found> {
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
            if let Some(fit) = self.refit_one(present, &scored[start], None, usize::MAX) {
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
                if let Some(fit) = self.refit_one(present, &scored[other], from, usize::MAX) {
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
        let log_bayes_factor = best - reference + (sum / hypotheses.max(scored.len()) as f64).ln();
        let near = fits[1..]
            .iter()
            .filter(|(_, fit)| best - fit.log_evidence() < NEAR)
            .filter_map(|(index, fit)| Some((scored[*index].candidate.place.clone()?, best - fit.log_evidence())))
            .collect();
        let known = fits
            .iter()
            .filter(|(index, _)| scored[*index].candidate.parameters == scored[fits[0].0].candidate.parameters)
            .filter_map(|(_, fit)| AtHeight::of(fit))
            .collect();
        let fit = fits.swap_remove(0).1;
        Some(Found { kind: scored[0].candidate.kind, fit, log_bayes_factor, near, height: None, known, own: None })
    }

    /// Refits one candidate, from the values of the linear step and from those of a fit near by, from `most` starts.
    fn refit_one(&self, present: &Fit, scored: &Scored, near: Option<&Fit>, most: usize) -> Option<Fit> {
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
            // The present background was bent to stand in for the effect. Where the linear step overshoots, start nearer to
            // the present model.
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
        for start in starts.iter().take(most) {
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
}

/// Starts go no further than this many prior scales.
const LONGEST_START: f64 = 2.0;
const SHORTER_START: f64 = 0.3;
/// A fit that reaches less than this share of what the linear step promised is tried from another start.
const DISAPPOINTS: f64 = 0.5;
