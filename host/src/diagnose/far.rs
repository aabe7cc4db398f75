//! Effects so large that no derivative at the present model leads to them: a channel in the wrong unit, a mast without its
//! antenna, sensors mounted across.
//!
//! Every kind is tried at values spread over its range, at places spread over the structure; the best of them are fitted.

use rayon::prelude::*;

use super::candidates::{Candidate, Options};
use super::evaluation::LEAST_LIKENESS;
use super::fit::Fit;
use super::found::Found;
use super::misfit::Loss;
use super::problem::Problem;
use super::score::shows_by_derivative;
use super::state::State;
use crate::compare::pair_above;
use crate::model::effect::{EffectKind, Evidence, KINDS, Parameter, PlaceKind, Prior, Where};
use crate::statistics::median;

/// Values whose typical size depends on the structure are tried at these multiples of it.
const MULTIPLES: [f64; 4] = [4.0, 20.0, 200.0, 5000.0];
/// Values with bounds are tried at so many places between them, where those are far apart in units of what is typical.
const BETWEEN_BOUNDS: usize = 12;
const FAR_APART: f64 = 6.0;
/// And those of several parameters at once at these multiples, each with each.
const AROUND: [f64; 7] = [-6.0, -2.0, -0.5, 0.0, 0.5, 2.0, 6.0];
/// Delays are tried at quarters of the shortest period, the phase being the same again after a whole one; so many to each side.
const PERIOD_SHARE: f64 = 0.25;
const DELAYS: i32 = 60;
/// Heights that are tried.
const HEIGHTS: usize = 10;
/// Kinds that are fitted, from the best start of each.
const FITTED: usize = 4;
/// A channel whose factor is within this of 1 (ln) needs no far start.
const NEAR_ONE: f64 = 0.5;
/// A channel says what it is multiplied with in modes in which it moves by this share of the others' mean.
const MOVES: f64 = 0.3;

impl Problem {
    /// Every kind, fitted from values far off those at which it does nothing.
    pub(super) fn search_far(&self, present: &Fit, options: &Options) -> Vec<Found> {
        let kinds = KINDS.iter().copied().filter(|kind| shows_by_derivative(*kind) && !options.leaves_out(*kind));
        let Some(far) = Far::of(self, present) else { return Vec::new() };
        self.tally.stage("effects tried far from none", kinds.clone().count());
        let best_start = |kind| self.tally.piece(|| far.best_start(kind, self.far_candidates(kind, present)));
        let mut starts: Vec<Start> = kinds.filter_map(best_start).collect();
        starts.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
        starts.truncate(FITTED);
        self.tally.stage("effects fitted far from none", starts.len());
        let fit = |start: &Start| self.tally.piece(|| far.fit(start, self.hypotheses(start.kind, present)));
        starts.par_iter().filter_map(fit).collect()
    }

    /// Every pair of channels, as exchanged ones may spoil what says which are likely.
    fn far_candidates(&self, kind: &'static dyn EffectKind, present: &Fit) -> Vec<Candidate> {
        if kind.place() != PlaceKind::TwoChannels {
            return self.candidates(kind, present);
        }
        let name = |index: usize| self.sensors[index].channel.clone();
        let pairs = (0..self.sensors.len()).flat_map(|high| (0..high).map(move |low| (low, high)));
        let places = pairs.map(|(low, high)| Some(Where::Channels(vec![name(low), name(high)])));
        self.candidates_at(kind, places.collect(), present)
    }

    /// One kind, as one of `candidates`.
    pub(super) fn far_of_kind(
        &self,
        present: &Fit,
        kind: &'static dyn EffectKind,
        candidates: Vec<Candidate>,
    ) -> Option<Found> {
        let (far, hypotheses) = (Far::of(self, present)?, candidates.len());
        far.fit(&far.best_start(kind, candidates)?, hypotheses)
    }
}

/// What far starts are made from.
struct Far<'a> {
    problem: &'a Problem,
    present: &'a Fit,
    /// The present model without scatter.
    given: State,
    /// What each channel seems to be multiplied with.
    factors: Vec<Option<f64>>,
}

/// A model with an effect of some size, not fitted yet.
struct Start {
    kind: &'static dyn EffectKind,
    misfit: f64,
    state: State,
}

impl<'a> Far<'a> {
    fn of(problem: &'a Problem, present: &'a Fit) -> Option<Self> {
        let given = problem.state_without_scatter(&present.state.effects).ok()?;
        let factors = problem.factors(&given);
        Some(Self { problem, present, given, factors })
    }

    fn best_start(&self, kind: &'static dyn EffectKind, candidates: Vec<Candidate>) -> Option<Start> {
        let starts = self.problem.far_starts(kind, candidates, &self.factors);
        let states = starts.par_iter().filter_map(|(candidate, values)| {
            let mut effects = self.present.state.effects.clone();
            effects.push(candidate.effect(values)?);
            let state = self.problem.state(effects, self.given.numbers.clone(), Some(&self.given)).ok()?;
            Some(Start { kind, misfit: state.misfit(Loss::Robust), state })
        });
        states.min_by(|a, b| a.misfit.total_cmp(&b.misfit))
    }

    fn fit(&self, start: &Start, hypotheses: usize) -> Option<Found> {
        let fit = self.problem.fit_with_one_more(self.present, &start.state, &|_| {})?;
        let gain = fit.log_evidence() - self.present.log_evidence();
        Some(Found::alone(start.kind, fit, gain, hypotheses.max(1)))
    }
}

/// Values all around those at which an effect of several parameters does nothing: every combination of [`AROUND`] times what is typical.
fn around(candidate: &Candidate) -> Vec<Vec<f64>> {
    let mut all = vec![candidate.neutral()];
    for (at, parameter) in candidate.parameters.iter().enumerate() {
        let Prior::Value(typical) = parameter.prior else { continue };
        let values = AROUND.map(|multiple| parameter.neutral + multiple * typical);
        let admissible = values.into_iter().filter(|value| (parameter.least..=parameter.greatest).contains(value));
        let with = |value: f64| {
            all.iter().map(move |values| {
                let mut values = values.clone();
                values[at] = value;
                values
            })
        };
        all = admissible.flat_map(with).collect();
    }
    all
}

impl Problem {
    /// Places and values to start from.
    fn far_starts(
        &self,
        kind: &'static dyn EffectKind,
        mut candidates: Vec<Candidate>,
        factors: &[Option<f64>],
    ) -> Vec<(Candidate, Vec<f64>)> {
        if kind.place() == PlaceKind::TwoChannels {
            return candidates.into_iter().map(|candidate| (candidate, Vec::new())).collect();
        }
        // Values of several parameters are found from those of one for all, where a kind has such a set.
        let fitted = |candidate: &Candidate| candidate.parameters.iter().filter(|p| p.is_fitted()).count();
        let fewest = candidates.iter().map(&fitted).filter(|count| *count > 0).min();
        candidates.retain(|candidate| Some(fitted(candidate)) == fewest);
        if kind.place() == PlaceKind::Height {
            let step = candidates.len().div_ceil(HEIGHTS).max(1);
            candidates = candidates.into_iter().rev().step_by(step).collect();
        }
        let of_candidate = |candidate: Candidate| {
            let neutral = candidate.neutral();
            if fewest > Some(1) {
                return Some(around(&candidate).into_iter().map(|values| (candidate.clone(), values)).collect());
            }
            let at = candidate.parameters.iter().position(Parameter::is_fitted)?;
            let with = |value: f64| {
                let mut values = neutral.clone();
                values[at] = value;
                (candidate.clone(), values)
            };
            Some(self.far_values(&candidate, at, factors).into_iter().map(with).collect::<Vec<_>>())
        };
        candidates.into_iter().filter_map(of_candidate).flatten().collect()
    }

    /// Values of a candidate's one parameter that is fitted, its index `at`, far from where it does nothing.
    fn far_values(&self, candidate: &Candidate, at: usize, factors: &[Option<f64>]) -> Vec<f64> {
        if let (PlaceKind::Channel, Some(Where::Channels(channels))) = (candidate.kind.place(), &candidate.place) {
            let sensor = self.sensors.iter().position(|sensor| channels.first() == Some(&sensor.channel));
            let factor = sensor.and_then(|sensor| factors.get(sensor).copied().flatten());
            return factor.filter(|factor| factor.ln().abs() > NEAR_ONE).into_iter().collect();
        }
        let parameter = &candidate.parameters[at];
        if candidate.kind.evidence() == Evidence::Phases {
            let highest_hz = self.measured().iter().map(|mode| mode.frequency_hz).fold(0.0, f64::max);
            let step = PERIOD_SHARE / highest_hz;
            let values = (-DELAYS..=DELAYS).filter(|turns| *turns != 0).map(|turns| f64::from(turns) * step);
            return values.filter(|value| (parameter.least..=parameter.greatest).contains(value)).collect();
        }
        match parameter.prior {
            Prior::FrequencyShift(_) => {
                let nothing = candidate.effect(&candidate.neutral());
                let unit = nothing.and_then(|effect| Some(self.typical(&effect, at, 1.0)?.size));
                let multiples = |unit: f64| MULTIPLES.map(|multiple| parameter.neutral + multiple * unit).to_vec();
                unit.map_or_else(Vec::new, multiples)
            }
            Prior::Value(typical) => {
                let width = parameter.greatest - parameter.least;
                let between = |index: usize| parameter.least + width * (index as f64 + 0.5) / BETWEEN_BOUNDS as f64;
                let is_wide = width.is_finite() && width > FAR_APART * typical;
                if is_wide { (0..BETWEEN_BOUNDS).map(between).collect() } else { Vec::new() }
            }
            Prior::Share(_) | Prior::Given => Vec::new(),
        }
    }

    /// Recorded over modelled motion of each channel: the median over the modes that the other channels find, in each of
    /// which the others say how large it is.
    fn factors(&self, given: &State) -> Vec<Option<f64>> {
        let of = |sensor: usize| {
            let measured = self.without_sensors(&[sensor]);
            let pairs = pair_above(&given.model.view, measured.measured(), LEAST_LIKENESS);
            let mut ratios: Vec<f64> = pairs
                .iter()
                .filter_map(|pair| {
                    let others = measured.measured()[pair.measured].shape.as_ref()?;
                    let shape = self.measured[pair.measured].shape.as_ref()?;
                    let at = shape.sensors.iter().position(|other| *other == sensor)?;
                    let model = given.model.view.at_sensors.column(pair.model);
                    let there = model.select_rows(&others.sensors);
                    let scale = there.dot(&others.values) / there.norm_squared();
                    let predicted = scale * model[sensor];
                    let typical = (others.values.norm_squared() / others.values.len() as f64).sqrt();
                    (predicted.abs() > MOVES * typical).then(|| shape.values[at] / predicted)
                })
                .collect();
            median(&mut ratios).filter(|ratio| *ratio > 0.0)
        };
        (0..self.sensors.len()).into_par_iter().map(of).collect()
    }
}
