//! Through the catalogue: every effect at every place, scored by what it explains, the best refitted.

use nalgebra::DVector;
use rayon::prelude::*;

use super::candidates::Options;
use super::criteria::{FAILS, STANDS_OUT};
use super::discrepancy::{Discrepancy, Settled, here};
use super::error::NoneFound;
use super::fit::Fit;
use super::found::{AtHeight, Found, NEAR};
use super::misfit::Loss;
use super::problem::Problem;
use super::score::{Scored, Sighting};
use super::state::State;
use crate::model::effect::{Effect, EffectKind, Evidence, KINDS, Where};

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

/// How closely a candidate is fitted.
#[derive(Debug, Clone, Copy)]
pub(super) enum Effort {
    /// One start, and no further than what is far off is brought near: for one that others are far above.
    Little,
    /// Several starts, until nothing changes.
    Full,
}

/// Scores of each kind, best first; the kind with the best first.
pub(super) fn by_kind(scored: Vec<Scored>) -> Vec<Vec<Scored>> {
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

/// Whether a present model, beside an effect that gains so much, is good enough for the effect to be held to what it does to errors alone.
pub(super) fn is_good_as_it_is(p_value: f64, gain: f64) -> bool {
    p_value >= EASE || p_value >= FAILS && gain < HARD
}

/// Best first.
pub(super) fn sort(found: &mut [Found]) {
    found.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
}

/// Puts in what is clearly better than what was found of its kind.
fn keep_better(found: &mut Vec<Found>, other: Found, evidence: impl Fn(&Found) -> f64) {
    match found.iter_mut().find(|found| found.kind == other.kind) {
        Some(found) if evidence(found) >= evidence(&other) - SAME => {}
        Some(found) => *found = other,
        None => found.push(other),
    }
}

/// Kinds whose places are settled.
const SETTLED: usize = 2;
/// A far start that gains no more than this has found the same optimum.
const SAME: f64 = 1.0;
/// A discrepancy that raises the evidence by this makes everything be looked at anew: 20 to 1.
const ANEW: f64 = STANDS_OUT;
/// Kinds that are looked at before, and how often everything is looked at.
const LOOKS: usize = 3;
const MOST_SEARCHES: usize = 2;
/// One that passes and gains this more than another makes that one impossible.
pub(super) const CLEAR: f64 = 50.0;
/// Effects that are fitted once more from the start in the end, where they do not pass: what was bent for another effect, or for none, hides
/// one of them now and then, and the right one need not stand before those that help only beside it.
const AFRESH: usize = 6;
/// Effects from whose backgrounds the present model is fitted anew, where they gain more than they can.
const FREED: usize = 2;
/// Fits whose evidence differs by less are as probable: their sizes of a discrepancy are found to a step only.
const AS_PROBABLE: f64 = 2.0;
/// A fit with this probability leaves nothing that calls for a damper; guys along one direction of a round tower split a pair as well, but
/// leave more (0.013 where a damper stands in the pair's middle).
const EASE: f64 = 0.05;
/// An effect that gains so much over a model that does not pass with ease need not make all errors fall clearly: another may hide what it does
/// to shapes. Measured: the weight above, beside a rotary inertia that turns two modes into each other, gains 20.6 over a model that passes
/// with p = 0.017 by twice the stated scatter; it leaves 0.13 of the frequencies' squares and all of the shapes' differences.
const HARD: f64 = 10.0;
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
    /// All of it with the discrepancy that the best leaves, as long as a model of the right kind can miss as much: at first what the kinds
    /// that promise most leave by a first look. In the end the present model and each effect are weighed with what suits each best.
    pub(super) fn search_among(&self, present: &Fit, options: &Options) -> Searched {
        let given = self.without_scatter(present).ok();
        let sightings = self.sightings(present, given.as_ref(), &|fit| self.all_candidates(fit, options));
        let (mut anew, looks) = self.first_look(present, &sightings);
        let mut settled: Settled = None;
        let (mut found, mut rejected) = (Vec::new(), Vec::new());
        for search in 1..=MOST_SEARCHES {
            if let Some(discrepancy) = anew {
                let problem = self.with_discrepancy(discrepancy);
                settled = problem.refitted(present).ok().map(|present| (problem, present)).or(settled);
            }
            let (problem, present) = here(&settled, self, present);
            (found, rejected) = problem.search_all(present, &sightings);
            problem.take_up(present, &looks, &mut found);
            problem.settle_heights(&mut found);
            let best = problem.leading(&found).map_or(present, |best| &best.fit);
            anew = if search < MOST_SEARCHES { problem.to_look_anew(best) } else { None };
            if anew.is_none() {
                break;
            }
        }
        let (problem, present) = here(&settled, self, present);
        // What was found with the discrepancy of another hypothesis may pass with its own.
        if let Some(first) = found.first_mut().filter(|first| !first.fit.passes()) {
            first.own = problem.afresh(&first.fit, problem.settled(&first.fit)).map(|(_, own)| own);
        }
        let is_explained = |found: &[Found]| present.passes() || found.iter().any(|found| found.own().passes());
        let twins = KINDS.iter().copied().filter(|kind| kind.evidence() == Evidence::TwinPeaks);
        let twins = twins.filter(|kind| !options.leaves_out(*kind));
        self.tally.stage("dampers", twins.clone().count());
        // Dampers take long to fit: without twins they are tried where nothing else explains with ease.
        let with_ease = |fit: &Fit| fit.goodness_of_fit().p_value >= EASE;
        let by_twins_only = with_ease(present) || found.iter().any(|found| with_ease(found.own()));
        let damper = |kind| self.tally.piece(|| problem.search_damper(present, kind, None, by_twins_only));
        found.extend(twins.filter_map(damper));
        sort(&mut found);
        if !is_explained(&found) {
            for far in problem.search_far(present, options) {
                keep_better(&mut found, far, |found| found.log_bayes_factor);
            }
            sort(&mut found);
            problem.settle_heights(&mut found);
        }
        let own = problem.weigh_each(present, &mut found);
        let without = problem.state_without_scatter(present.effects()).ok();
        let at_its_own = own.as_ref().map_or(present, |(_, own)| own);
        found.par_iter_mut().for_each(|found| problem.note_left(without.as_ref(), at_its_own, found));
        Searched { settled, own, found, rejected }
    }

    /// Notes what an effect leaves of the differences of the model `without` it and without scatter, and whether that helps; `present`
    /// is the fit of that model as it is.
    pub(super) fn note_left(&self, without: Option<&State>, present: &Fit, found: &mut Found) {
        found.left = without.and_then(|without| self.left_with(without, found));
        // Where the tolerance accounts for all that is left, the evidence is right about what scatter can do.
        let is_accounted_for = !found.own().discrepancy.misses_more();
        let p_value = present.goodness_of_fit().p_value;
        let falls = is_accounted_for
            || found.is_called_for_by(present)
            || found.left.is_none_or(|left| left.is_relief(is_good_as_it_is(p_value, found.log_bayes_factor)));
        let (own, index) = (found.own(), found.index());
        let explains_its_own = !own.passes() || self.explains_its_channels(own, index);
        found.helps = falls && explains_its_own && !own.is_usual(index) && !own.looks_like_the_table(index);
    }

    /// The discrepancy that the best of a few kinds leaves, at the places that promise most, and their fits.
    fn first_look(&self, present: &Fit, sightings: &[Sighting<'_>]) -> (Option<Discrepancy>, Vec<Fit>) {
        let scored = self.scored(sightings).into_iter().filter(|one| one.admissible).collect();
        let kinds = by_kind(scored);
        // Linear steps promise more than they keep; what an effect that is there or not gains is what it gains.
        let (likeliest, rest) = kinds.split_at(kinds.len().min(LOOKS));
        let looked_at = likeliest.iter().chain(rest.iter().filter(|kind| kind[0].knobs.is_empty()));
        let looked_at: Vec<&Vec<Scored>> = looked_at.collect();
        self.tally.stage("a first look at effects", looked_at.len());
        let look = |kind: &&Vec<Scored>| self.tally.piece(|| self.refit_one(present, &kind[0], None, Effort::Full));
        let looks: Vec<Fit> = looked_at.par_iter().filter_map(look).collect();
        let best = looks.iter().max_by(|a, b| a.log_evidence().total_cmp(&b.log_evidence()));
        let best = best.filter(|best| best.log_evidence() - present.log_evidence() > STANDS_OUT);
        (self.to_look_anew(best.unwrap_or(present)), looks)
    }

    /// Takes up fits of another look, with this problem's discrepancy, where they are better than what was `found` of their kind: where an
    /// effect is far from what the present model says, a linear step from there leads now to one of its places and now to another.
    fn take_up(&self, present: &Fit, looks: &[Fit], found: &mut Vec<Found>) {
        self.tally.stage("the first look again", looks.len());
        let again = |look: &Fit| self.tally.piece(|| self.refitted(look).ok());
        let again: Vec<Fit> = looks.par_iter().filter_map(again).collect();
        for fit in again {
            let Some(kind) = fit.effects().last().map(Effect::of_kind) else { continue };
            let gain = fit.log_evidence() - present.log_evidence();
            let look = Found::alone(kind, fit, gain, self.hypotheses(kind, present));
            keep_better(found, look, |found| found.fit.log_evidence());
        }
        sort(found);
    }

    /// The discrepancy that suits a fit, where it makes a difference. What changes the evidence by less changes no order; each effect
    /// gets what suits it in the end.
    fn to_look_anew(&self, fit: &Fit) -> Option<Discrepancy> {
        let (near, gain) = self.best_discrepancy(fit);
        let settled = if gain < ANEW { None } else { self.settled_from(fit, near) };
        settled.map(|(_, fit)| fit.discrepancy).filter(Discrepancy::is_plausible)
    }

    /// Weighs the present model and the best of what was found, each with the discrepancy that suits it best.
    pub(super) fn weigh_each(&self, present: &Fit, found: &mut [Found]) -> Settled {
        // Where an effect leaves the present model that far behind, lesser effects need not be weighed closely.
        let own_gain = |found: &Found| found.own().log_evidence() - found.fit.log_evidence();
        let passing = found.first().filter(|first| first.own().passes());
        let leads_by = passing.map_or(0.0, |first| first.log_bayes_factor + own_gain(first));
        let about = if leads_by > CLEAR { self.best_discrepancy(present).1 } else { f64::INFINITY };
        let is_clear = leads_by - about > CLEAR;
        let settled = if is_clear { None } else { self.settled(present) };
        let own = self.afresh(present, settled);
        let reference = own.as_ref().map_or(present.log_evidence(), |(_, own)| own.log_evidence());
        let raised = reference - present.log_evidence();
        let estimate = |found: &Found| match &found.own {
            Some(own) => (own.discrepancy, own_gain(found)),
            None if found.log_bayes_factor <= if is_clear { leads_by - CLEAR } else { 0.0 } => (self.discrepancy, 0.0),
            None => self.best_discrepancy(&found.fit),
        };
        let estimates: Vec<(Discrepancy, f64)> = found.par_iter().map(estimate).collect();
        let gains = found.iter().zip(&estimates).map(|(found, (_, gain))| found.log_bayes_factor + gain);
        let best = gains.fold(0.0, f64::max);
        self.tally.stage("effects weighed", found.len());
        found.par_iter_mut().zip(estimates).for_each(|(found, (discrepancy, gain))| {
            let estimated = found.log_bayes_factor + gain;
            if found.own.is_none() && gain > 0.0 && estimated > best - NEAR.max(CONTENDS * best) {
                found.own = self.settled_from(&found.fit, discrepancy).map(|(_, own)| own);
                found.log_bayes_factor += own_gain(found);
            } else {
                found.log_bayes_factor = estimated;
            }
            found.log_bayes_factor -= raised;
            self.tally.one();
        });
        sort(found);
        let (own, reference) = self.freed(present, own, reference, found);
        if !is_clear {
            let bent = own.as_ref().map_or(present, |(_, own)| own);
            let straight = self.straight_starts();
            self.tally.stage("the best effects fitted from the start again", found.len());
            found.par_iter_mut().enumerate().for_each(|(rank, found)| {
                // With one number more a model explains no less, so what is less probable by more than chance may have stopped short.
                let stopped_short = found.log_bayes_factor < found.log_share - SAME;
                let is_afresh = rank < AFRESH && !found.own().passes();
                let mut starts = Vec::new();
                if stopped_short || is_afresh {
                    starts.push((bent.discrepancy, bent.state.numbers.clone()));
                }
                if is_afresh {
                    starts.extend_from_slice(&straight);
                }
                let other = self.tally.piece(|| self.best_from(found.own(), None, &starts, &|_| true));
                let Some((_, other)) = other else { return };
                found.log_bayes_factor = other.log_evidence() - reference + found.log_share;
                found.own = Some(other);
            });
            sort(found);
        }
        own
    }

    /// The present model, fitted from where effects have left the background that gain more than their sizes account for, and its evidence:
    /// without one of them it cannot be that much worse, so its own fit has stopped in another optimum. Such an effect gains what is left.
    fn freed(&self, present: &Fit, own: Settled, reference: f64, found: &mut [Found]) -> (Settled, f64) {
        let exceeds = |found: &&Found| {
            let worth = found.own().worth(found.index());
            found.kind.evidence() != Evidence::TwinPeaks
                && worth.is_some_and(|worth| found.log_bayes_factor - found.log_share > worth + ANEW)
        };
        let starts: Vec<(Discrepancy, DVector<f64>)> = found
            .iter()
            .filter(exceeds)
            .take(FREED)
            .map(|found| (found.own().discrepancy, found.own().state.numbers.clone()))
            .collect();
        if starts.is_empty() {
            return (own, reference);
        }
        self.tally.stage("the model as it is, fitted from where effects left it", 1);
        let own = self.tally.piece(|| self.best_from(present, own, &starts, &|_| true));
        let raised = own.as_ref().map_or(reference, |(_, own)| own.log_evidence());
        found.iter_mut().for_each(|found| found.log_bayes_factor -= raised - reference);
        (own, raised)
    }

    /// A straight background without a discrepancy, and with what is usual.
    fn straight_starts(&self) -> Vec<(Discrepancy, DVector<f64>)> {
        let straight = DVector::zeros(self.background.size());
        self.discrepancies_to_start_from().into_iter().map(|discrepancy| (discrepancy, straight.clone())).collect()
    }

    /// A fit with the discrepancy that suits it best, if a model of the right kind can miss as much; what every command states of a model.
    pub(super) fn at_its_best(&self, fit: &Fit) -> Settled {
        let settled = self.settled_plausibly(fit);
        self.afresh_where(fit, settled, &|fit| fit.discrepancy.is_plausible())
    }

    /// A fit that does not pass, from a straight background, where that is more probable.
    fn afresh(&self, fit: &Fit, settled: Settled) -> Settled {
        self.afresh_where(fit, settled, &|_| true)
    }

    fn afresh_where(&self, fit: &Fit, settled: Settled, is_allowed: &(dyn Fn(&Fit) -> bool + Sync)) -> Settled {
        let passes = here(&settled, self, fit).1.passes();
        if passes { settled } else { self.best_from(fit, settled, &self.straight_starts(), is_allowed) }
    }

    /// A fit from other discrepancies and backgrounds, where that is more probable: what was bent to stand in for an
    /// effect may stay bent with it, and the robust loss may let go of modes that a discrepancy accounts for. `settled` is what stands until
    /// now. Of those that are as good as equally probable, the one that fits best stands for all.
    fn best_from(
        &self,
        fit: &Fit,
        settled: Settled,
        starts: &[(Discrepancy, DVector<f64>)],
        is_allowed: &(dyn Fn(&Fit) -> bool + Sync),
    ) -> Settled {
        let (_, stands) = here(&settled, self, fit);
        let is_straight = |numbers: &DVector<f64>| numbers.iter().all(|number| *number == 0.0);
        let straight = starts.iter().any(|(_, numbers)| is_straight(numbers));
        let zeros = || DVector::zeros(self.background.size());
        let straight = straight.then(|| self.state(fit.effects().to_vec(), zeros(), Some(&fit.state)).ok()).flatten();
        let from = |(discrepancy, numbers): &(Discrepancy, DVector<f64>)| {
            let start = self.with_discrepancy(*discrepancy);
            let state = match straight.as_ref().filter(|_| is_straight(numbers)) {
                Some(straight) => start.state_like(straight, numbers.clone()),
                None => start.state(fit.state.effects.clone(), numbers.clone(), Some(&fit.state)),
            };
            let first = start.fit_from(state.ok()?, &fit.knobs).ok()?;
            Some(start.settled(&first).unwrap_or((start, first)))
        };
        // Where nothing but the background is fitted, and the discrepancy is that of the start, the fit came from there.
        let is_new = |(discrepancy, numbers): &&(Discrepancy, DVector<f64>)| {
            !(fit.knobs.is_empty() && *discrepancy == fit.discrepancy && is_straight(numbers))
        };
        let mut found: Vec<(Problem, Fit)> =
            starts.par_iter().filter(is_new).filter_map(from).filter(|(_, fit)| is_allowed(fit)).collect();
        let most = found.iter().map(|(_, fit)| fit.log_evidence()).fold(stands.log_evidence(), f64::max);
        let is_as_probable = |fit: &Fit| fit.log_evidence() > most - AS_PROBABLE;
        found.retain(|(_, fit)| is_as_probable(fit));
        let p_value = |fit: &Fit| fit.goodness_of_fit().p_value;
        let best = found.into_iter().max_by(|a, b| p_value(&a.1).total_cmp(&p_value(&b.1)));
        let best = best.filter(|(_, best)| !is_as_probable(stands) || p_value(best) > p_value(stands)).or(settled);
        let (problem, best_fit) = here(&best, self, fit);
        if best_fit.passes() {
            return best;
        }
        problem.fitting_best(best_fit).filter(|(_, fit)| is_allowed(fit)).or(best)
    }

    /// Every kind near the present model, with this discrepancy.
    fn search_all(&self, present: &Fit, sightings: &[Sighting<'_>]) -> (Vec<Found>, Vec<Scored>) {
        let (scored, rejected): (Vec<Scored>, Vec<Scored>) =
            self.scored(sightings).into_iter().partition(|one| one.admissible);
        let kinds = by_kind(scored);
        let rejected: Vec<Scored> = by_kind(rejected)
            .into_iter()
            .filter_map(|kind| kind.into_iter().next())
            .filter(|one| one.gain > STANDS_OUT)
            .filter(|one| kinds.iter().all(|kind| kind[0].candidate.kind != one.candidate.kind))
            .collect();
        (self.search_near(present, &kinds), rejected)
    }

    /// Kinds refitted from where the linear step leads: a first look at each, at its best place; then all places of those that
    /// can still be the best.
    fn search_near(&self, present: &Fit, kinds: &[Vec<Scored>]) -> Vec<Found> {
        let kinds = &kinds[..kinds.len().min(REFITTED)];
        let gain = |look: &Option<Fit>| {
            look.as_ref().map_or(f64::NEG_INFINITY, |fit| fit.log_evidence() - present.log_evidence())
        };
        // A kind that promises next to nothing compared with the best gets a single start, and one that promises far less than what passes.
        let promised = kinds.first().map_or(0.0, |kind| kind[0].gain);
        self.tally.stage("effects fitted", kinds.len());
        let look = |kind: &Vec<Scored>, reached: f64| {
            let is_hopeless = kind[0].gain < HOPELESS * promised || kind[0].gain < reached - CLEAR;
            let effort = if is_hopeless { Effort::Little } else { Effort::Full };
            self.tally.piece(|| self.refit_one(present, &kind[0], None, effort))
        };
        let (likeliest, rest) = kinds.split_at(kinds.len().min(LOOKS));
        let mut looks: Vec<Option<Fit>> = likeliest.par_iter().map(|kind| look(kind, f64::NEG_INFINITY)).collect();
        let passing = looks.iter().filter(|look| look.as_ref().is_some_and(Fit::passes));
        let reached = passing.map(gain).fold(f64::NEG_INFINITY, f64::max);
        looks.par_extend(rest.par_iter().map(|kind| look(kind, reached)));
        let best = looks.iter().map(gain).fold(0.0, f64::max);
        let fits = looks.iter().flatten().any(Fit::passes);
        // Where something fits already, a kind that reaches far less, or nothing, needs no second look.
        let contends = |kind: &[Scored], look: &Option<Fit>| match fits {
            true => gain(look) > (best - NEAR.max(CONTENDS * best)).max(0.0),
            false => kind[0].gain.max(gain(look)) > HOPELESS * best,
        };
        self.tally.stage("effects fitted at other places", kinds.len());
        let refit = |(kind, look): (&Vec<Scored>, Option<Fit>)| {
            let further = contends(kind, &look);
            let hypotheses = self.hypotheses(kind[0].candidate.kind, present);
            self.tally.piece(|| self.refit(present, kind, look, further, hypotheses))
        };
        kinds.par_iter().zip(looks).filter_map(refit).collect()
    }

    /// Settles where the best of those at a height are, where they gain anything.
    fn settle_heights(&self, found: &mut [Found]) {
        let best = found.first().map_or(0.0, |best| best.log_bayes_factor);
        let least = (best - NEAR.max(CONTENDS * best)).max(0.0);
        let contends = |found: &&mut Found| found.height.is_none() && found.log_bayes_factor > least;
        let contending: Vec<&mut Found> = found.iter_mut().filter(contends).take(SETTLED).collect();
        self.tally.stage("heights of effects", contending.len());
        contending.into_par_iter().for_each(|found| {
            if found.kind.evidence() != Evidence::TwinPeaks {
                self.settle_height(found);
            }
            self.tally.one();
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
            return self.search_damper(present, kind, place, false).ok_or(NoneFound::Unseen);
        }
        let candidates = match place {
            Some(place) => self.candidates_at(kind, vec![Some(place.clone())], present),
            None => self.candidates(kind, present),
        };
        let hypotheses = if place.is_some() { 1 } else { self.hypotheses(kind, present) };
        let given = self.without_scatter(present).ok();
        let scored = self.scored(&self.sightings(present, given.as_ref(), &|_| vec![candidates.clone()]));
        let is_seen = !scored.is_empty();
        let (mut scored, rejected): (Vec<Scored>, Vec<Scored>) = scored.into_iter().partition(|one| one.admissible);
        scored.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        self.tally.stage("the effect fitted at its places", 2);
        let near = scored.first().and_then(|first| {
            let look = self.tally.piece(|| self.refit_one(present, first, None, Effort::Full));
            self.tally.piece(|| self.refit(present, &scored, look, true, hypotheses))
        });
        let is_enough = |found: &Found| found.stands_out() && found.fit.passes();
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
    pub(super) fn refit(
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
            if let Some(fit) = self.refit_one(present, &scored[start], None, Effort::Full) {
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
                if let Some(fit) = self.refit_one(present, &scored[other], from, Effort::Full) {
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
        let hypotheses = hypotheses.max(scored.len());
        let log_share = (sum / hypotheses as f64).ln();
        let log_bayes_factor = best - reference + log_share;
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
        let kind = scored[0].candidate.kind;
        Some(Found {
            kind,
            fit,
            log_bayes_factor,
            hypotheses,
            log_share,
            near,
            height: None,
            known,
            own: None,
            left: None,
            helps: true,
        })
    }

    /// Refits one candidate, from the values of the linear step and from those of a fit near by.
    pub(super) fn refit_one(&self, present: &Fit, scored: &Scored, near: Option<&Fit>, effort: Effort) -> Option<Fit> {
        let (most, losses): (usize, &[Loss]) = match effort {
            Effort::Little => (1, &[Loss::Squares]),
            Effort::Full => (usize::MAX, &[Loss::Squares, Loss::Robust]),
        };
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
        } else {
            // The present background was bent to stand in for the effect. Where the linear step overshoots, start nearer to
            // the present model; an effect that is there or not has no such step.
            starts.push((linear, &straight));
            if !scored.knobs.is_empty() {
                starts.push((scored.candidate.start(&scored.knobs, &scored.values, SHORTER_START), &straight));
            }
        }
        let fit = |(values, numbers): &(Vec<f64>, &DVector<f64>)| {
            let effect = scored.candidate.effect(values)?;
            let mut effects = match near {
                Some(near) => near.state.effects[..index].to_vec(),
                None => present.state.effects.clone(),
            };
            effects.push(effect);
            let state = self.state(effects, (*numbers).clone(), Some(&present.state)).ok()?;
            self.fit_by(losses, state, &knobs).ok()
        };
        let mut best: Option<Fit> = None;
        for start in starts.iter().take(most) {
            if let Some(fit) = fit(start) {
                // The linear step promised as much. Where there is none, a background that was bent to stand in for the effect may hold the
                // fit back, however much it gains.
                let gain = fit.log_evidence() - present.log_evidence();
                let settled = near.is_some() || (!scored.knobs.is_empty() && gain > DISAPPOINTS * scored.gain);
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
