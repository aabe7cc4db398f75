//! The small set of effects that explains most, where no single one explains the measurement.
//!
//! What a search found flows in; effects flow out that are added one after the other while the evidence calls for one more, and
//! fitted together. Then each must be worth its place beside the others: the set is fitted without it, and other kinds are tried
//! there. A set is a lead and no verdict: a search that takes what explains most first need not find the best set (Miller 2002, "Subset
//! Selection in Regression").

use rayon::prelude::*;

use super::candidates::{Candidate, Options};
use super::fit::Fit;
use super::found::Found;
use super::problem::Problem;
use super::score::{CandidatesOf, Scored};
use super::search::{CLEAR, Effort, by_kind};
use crate::model::effect::{Effect, Evidence};
use crate::progress::{Tally, UNHEARD};

/// No more effects than this: each costs values, and a dozen modes have few to spare.
const MOST_EFFECTS: usize = 4;
/// Kinds that are fitted roughly as the next effect, and as one in the place of another; and those that are fitted closely then.
const LOOKED_AT: usize = 4;
const INSTEAD: usize = 2;
const SETTLED: usize = 2;
/// Of the places along the height every one of so many is tried, for the next effect and for one in the place of another: the best is
/// moved from there.
const NEXT_AT: usize = 2;
const INSTEAD_AT: usize = 4;
/// A set is exchanged and thinned out so often at most.
const MOST_ROUNDS: usize = MOST_EFFECTS;

/// Effects that together explain most.
pub(super) struct Set {
    /// The problem with the discrepancy that suits them, if a model of the right kind can miss as much.
    pub(super) problem: Problem,
    /// The present model there.
    pub(super) present: Fit,
    /// The model with all of them.
    pub(super) fit: Fit,
    /// Each of them, what explains most first.
    pub(super) members: Vec<Member>,
}

/// An effect of a set.
pub(super) struct Member {
    /// The whole set with this effect as the last one; its evidence is that over the set without it.
    pub(super) found: Found,
    /// Squared deviations that the set leaves without it.
    pub(super) without_chi_squared: f64,
    /// The other kind that does best in its place, also over the set without it.
    pub(super) instead: Option<Found>,
}

impl Member {
    /// Probability that the effect is there, were the other effects, and nothing that the catalogue does not have: against none and
    /// against the other kind that does best in its place.
    pub(super) fn probability(&self, problem: &Problem) -> f64 {
        let odds = &problem.prior_odds;
        let own = odds.log_odds_of(&self.found);
        let others = self.instead.iter().map(|other| odds.log_odds_of(other)).chain([odds.adequate().ln()]);
        1.0 / (1.0 + others.map(|other| (other - own).exp()).sum::<f64>())
    }

    /// The kind that does best in its place, and by how much less probable it is, as a logarithm.
    pub(super) fn rival(&self, problem: &Problem) -> Option<(&Found, f64)> {
        let odds = &problem.prior_odds;
        self.instead.as_ref().map(|rival| (rival, odds.log_odds_of(&self.found) - odds.log_odds_of(rival)))
    }
}

impl Problem {
    /// The set that begins with the best of what was `found` beside `present`; `None` where not even one effect is called for.
    pub(super) fn best_set(&self, present: &Fit, found: &[Found], options: &Options) -> Option<Set> {
        // As if the model were as good as its tolerance says: what a discrepancy would take may be another effect. Where a model is so far
        // off that its modes pass for wrong ones, with the discrepancy of the best single effect.
        let stated = || self.stated(self.discrepancy.expected_scatter);
        let first = |given: Self| Some((given.first_of_set(present, found)?, given));
        let (mut set, given) =
            first(stated()).or_else(|| first(self.with_discrepancy(found.first()?.own().discrepancy)))?;
        // Searches of one effect are pieces of what is counted here.
        let given = given.told_to(&UNHEARD);
        let base = present.state.effects.len();
        self.tally.stage("a set of effects, one by one", MOST_EFFECTS);
        self.tally.one();
        // What passes calls for no other effect.
        while set.state.effects.len() < base + MOST_EFFECTS && !set.passes() {
            let Some(next) = given.next_effect(&set, options) else { break };
            set = next.fit;
            self.tally.one();
        }
        let settled = given.settled_plausibly(&set);
        let (problem, fit) = settled.unwrap_or((given, set));
        problem.weighed_set(present, fit, options, &self.tally)
    }

    /// The model with the effect that explains most, which must be called for.
    fn first_of_set(&self, present: &Fit, found: &[Found]) -> Option<Fit> {
        let present = self.refitted(present).ok()?;
        // Dampers are judged by twin peaks, which effects in series are not.
        let is_asked = |found: &&Found| brings_nearer(found) && found.kind.evidence() != Evidence::TwinPeaks;
        let mut found: Vec<&Found> = found.iter().filter(is_asked).collect();
        let log_share = |found: &Found| found.log_share + self.prior_odds.kind(found.kind).ln();
        let evidence = |found: &Found| found.fit.log_evidence() + log_share(found);
        found.sort_by(|a, b| evidence(b).total_cmp(&evidence(a)));
        let refit = |found: &&Found| {
            let fit = self.refitted(&found.fit).ok()?;
            Some((fit.log_evidence() - present.log_evidence() + log_share(found), fit))
        };
        let refitted: Vec<(f64, Fit)> = found.par_iter().take(SETTLED).filter_map(refit).collect();
        let best = refitted.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > self.prior_odds.adequate().ln()).then_some(best.1)
    }

    /// The effect to be added to a set, if one is called for: more probable than none, and the model's errors fall with it.
    fn next_effect(&self, set: &Fit, options: &Options) -> Option<Found> {
        let given = self.without_scatter(set).ok();
        let mut found = self.best_beside(set, given.as_ref(), LOOKED_AT, f64::NEG_INFINITY, &|fit| {
            self.all_candidates(fit, options).into_iter().map(|kind| thinned(kind, NEXT_AT)).collect()
        });
        let without = self.state_without_scatter(set.effects()).ok();
        found.iter_mut().for_each(|found| self.note_left(without.as_ref(), set, found));
        found.retain(brings_nearer);
        let position = self.leading_position(&found)?;
        let mut next = found.swap_remove(position);
        self.settle_height(&mut next);
        Some(next)
    }

    /// The best of `candidates` that explain anything beside a fit, one of a kind: the `looked_at` likeliest kinds by a linear step (also from the
    /// model as it is `given`) are fitted roughly, the best of those closely where their evidence is not below `least`. The most probable
    /// first.
    fn best_beside(
        &self,
        fit: &Fit,
        given: Option<&Fit>,
        looked_at: usize,
        least: f64,
        candidates: &CandidatesOf<'_>,
    ) -> Vec<Found> {
        let scored = self.scored(&self.sightings(fit, given, candidates));
        let mut kinds = by_kind(scored.into_iter().filter(|one| one.admissible).collect());
        kinds.truncate(looked_at);
        let evidence = |look: &Option<Fit>| look.as_ref().map_or(f64::NEG_INFINITY, Fit::log_evidence);
        let rough = |kind: Vec<Scored>| {
            let look = self.refit_one(fit, &kind[0], None, Effort::Little);
            (kind, look)
        };
        let mut looks: Vec<(Vec<Scored>, Option<Fit>)> = kinds.into_par_iter().map(rough).collect();
        looks.sort_by(|a, b| evidence(&b.1).total_cmp(&evidence(&a.1)));
        let best = looks.first().map_or(f64::NEG_INFINITY, |(_, look)| evidence(look));
        looks.retain(|(_, look)| evidence(look) > least.max(best - CLEAR));
        looks.truncate(SETTLED);
        let close = |(kind, look): &(Vec<Scored>, Option<Fit>)| {
            let refitted = self.refit_one(fit, &kind[0], look.as_ref(), Effort::Full);
            self.refit(fit, kind, refitted, false, self.hypotheses(kind[0].candidate.kind, fit))
        };
        let mut found: Vec<Found> = looks.par_iter().filter_map(close).collect();
        found.sort_by(|a, b| self.prior_odds.log_odds_of(b).total_cmp(&self.prior_odds.log_odds_of(a)));
        found
    }

    /// The set after its members were weighed against each other: what is needless is dropped, and what another kind explains better is
    /// exchanged.
    fn weighed_set(self, present: &Fit, mut fit: Fit, options: &Options, tally: &Tally) -> Option<Set> {
        let base = present.state.effects.len();
        let present = self.refitted(present).ok()?;
        let mut members = self.members(base, &mut fit, options, tally);
        for _ in 0..MOST_ROUNDS {
            let log_odds = |found: &Found| self.prior_odds.log_odds_of(found);
            let least = self.prior_odds.adequate().ln();
            let needless = |member: &&Member| {
                log_odds(&member.found) < least || !member.found.fit.is_significant(member.found.index())
            };
            let worst =
                members.iter().filter(needless).min_by(|a, b| log_odds(&a.found).total_cmp(&log_odds(&b.found)));
            let better = |member: &&Member| member.rival(&self).is_some_and(|(_, behind)| behind < 0.0);
            if let Some(worst) = worst {
                let mut effects = worst.found.fit.effects().to_vec();
                effects.pop();
                if effects.len() == base {
                    return None;
                }
                fit = self.fitted_from(&worst.found.fit, effects)?;
            } else if let Some(member) = members.iter().find(better) {
                let (rival, _) = member.rival(&self)?;
                fit = self.fitted_from(&rival.fit, rival.fit.effects().to_vec())?;
            } else {
                break;
            }
            members = self.members(base, &mut fit, options, tally);
        }
        members.sort_by(|a, b| b.found.log_bayes_factor.total_cmp(&a.found.log_bayes_factor));
        // Without members, effects could not be fitted without each other.
        (!members.is_empty()).then_some(Set { problem: self, present, fit, members })
    }

    /// The effects of a fit from the `base`-th on, each weighed beside the others and moved to its best height there; the fit follows.
    fn members(&self, base: usize, fit: &mut Fit, options: &Options, tally: &Tally) -> Vec<Member> {
        tally.stage("effects of the set, each beside the others", fit.state.effects.len() - base);
        let mut members: Vec<Member> = Vec::new();
        for _ in base..fit.state.effects.len() {
            let now = members.last().map_or(&*fit, |member| &member.found.fit);
            // The first becomes the last, so that after a round all are where they were.
            let mut effects = now.state.effects.clone();
            let member = effects.remove(base);
            let without = self.fitted_from(now, effects.clone());
            effects.push(member);
            let with = self.fitted_from(now, effects);
            let member = without.zip(with).and_then(|(without, with)| self.member(&without, with, options));
            let Some(member) = member else { return Vec::new() };
            members.push(member);
            tally.one();
        }
        let settled = members.last().map(|member| &member.found.fit);
        if let Some(settled) = settled.and_then(|settled| self.fitted_from(settled, settled.effects().to_vec())) {
            *fit = settled;
        }
        members
    }

    /// The last effect of a fit beside the others.
    fn member(&self, without: &Fit, with: Fit, options: &Options) -> Option<Member> {
        let kind = with.state.effects.last()?.of_kind();
        let hypotheses = self.hypotheses(kind, without);
        let gain = with.log_evidence() - without.log_evidence();
        let mut found = Found::alone(kind, with, gain, hypotheses);
        self.settle_height(&mut found);
        // What is far less probable, as far as a rough fit says, need not be fitted closely.
        let within = found.fit.log_evidence() - 2.0 * CLEAR;
        let mut instead = self.best_beside(without, None, INSTEAD, within, &|fit| {
            let others = self.all_candidates(fit, options).into_iter();
            let is_other = |candidates: &Vec<Candidate>| candidates.first().is_some_and(|one| one.kind != kind);
            others.filter(is_other).map(|kind| thinned(kind, INSTEAD_AT)).collect()
        });
        instead.retain(|other| other.fit.is_significant(other.index()));
        instead.truncate(1);
        // Each with the discrepancy that suits it best.
        let raised = |fit: &Fit| self.best_discrepancy(fit).1.max(0.0);
        let before = raised(without);
        found.log_bayes_factor += raised(&found.fit) - before;
        for rival in &mut instead {
            self.settle_height(rival);
            rival.log_bayes_factor += raised(&rival.fit) - before;
        }
        Some(Member { found, without_chi_squared: without.goodness_of_fit().all.chi_squared, instead: instead.pop() })
    }

    /// Effects fitted from the values that they have, beside the scatter of another fit.
    fn fitted_from(&self, fit: &Fit, effects: Vec<Effect>) -> Option<Fit> {
        let state = self.state(effects, self.carried(fit), Some(&fit.state)).ok()?;
        let knobs = self.all_knobs(&state);
        self.fit_from(state, &knobs).ok()
    }
}

/// Whether the model's errors fall with an effect, and frequencies are no further off: an effect that is shown as a part of what is missing
/// must not need segments that are off the other way.
fn brings_nearer(found: &Found) -> bool {
    found.helps && found.left.is_none_or(|left| !left.moves || left.frequency < 1.0)
}

/// A kind's candidates at every one of so many heights; those elsewhere stay as they are.
fn thinned(mut candidates: Vec<Candidate>, one_of: usize) -> Vec<Candidate> {
    let mut heights_m: Vec<f64> = candidates.iter().filter_map(Candidate::z_m).collect();
    heights_m.sort_by(f64::total_cmp);
    heights_m.dedup();
    let place = |z_m: f64| heights_m.partition_point(|&other| other < z_m);
    candidates.retain(|candidate| candidate.z_m().is_none_or(|z_m| place(z_m).is_multiple_of(one_of)));
    candidates
}
