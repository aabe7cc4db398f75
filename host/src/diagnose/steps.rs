//! Step by step: adding and dropping effects, refitting all of them together.
//!
//! Measured modes and a structure flow in as a [`Setting`]; after each step the refitted effects and their errors flow out.

use serde::{Deserialize, Serialize};

use super::candidates::Options;
use super::criteria::STANDS_OUT;
use super::discrepancy::{Settled, here};
use super::error::DiagnoseError;
use super::fit::{Estimate, Fit};
use super::found::Found;
use super::goodness::fit_as_given;
use super::held_out::held_out;
use super::joint::Joint;
use super::problem::Problem;
use super::profile::Profile;
use super::search::Searched;
use super::signals::{Signals, shown};
use crate::compare::{ModelView, compare};
use crate::model::Structure;
use crate::model::effect::{Effect, EffectKind, Where};
use crate::modes::MeasuredMode;
use crate::progress::{Tally, UNHEARD};
use crate::study::{Model, Sensor};

/// What all steps of a diagnosis share, whatever effects the model has.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// The structure as first given.
    pub bare: &'a Structure,
    /// How far it is trusted.
    pub model: &'a Model,
    /// The sensors that shapes stand at.
    pub sensors: &'a [Sensor],
    /// What was measured.
    pub measured: &'a [MeasuredMode],
    /// Hears how far fits and searches are.
    pub tally: &'a Tally,
}

/// An effect with its fitted values.
#[derive(Debug, Clone)]
pub struct FittedEffect {
    /// The effect.
    pub effect: Effect,
    /// Its values with their deviations.
    pub parameters: Vec<Estimate>,
}

/// A step of the history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Counts from 0, the model as first seen.
    pub step: usize,
    /// `start`, `add NAME`, `remove NAME` (`drop NAME` in those of earlier versions) or `replace NAME by NAME`.
    pub action: String,
    /// Names of the effects in the model.
    pub effects: Vec<String>,
    /// Squared deviations that model, effects and tolerance leave.
    pub chi_squared: f64,
    /// Numbers compared less values fitted.
    pub degrees_of_freedom: usize,
    /// Probability of as much of a right model.
    pub p_value: f64,
    /// Mean absolute frequency error of the model with its effects, without the fitted scatter.
    pub mean_abs_frequency_error_percent: f64,
    /// Mean MAC of the same.
    pub mean_mac: Option<f64>,
    /// The same with the fitted scatter of the background.
    pub mean_abs_frequency_error_percent_with_background: f64,
    /// Mean MAC with it.
    pub mean_mac_with_background: Option<f64>,
    /// Error at sensors left out in turn.
    pub held_out_error_percent: Option<f64>,
    /// Frequency error of modes left out in turn.
    pub held_out_mode_error_percent: Option<f64>,
    /// Modes compared.
    pub modes: usize,
    /// Natural logarithm of the evidence for the effects that came, or against those that went, over the step before.
    #[serde(default)]
    pub log_bayes_factor: Option<f64>,
    /// The values of the effects with their joint covariance; null where there are none.
    #[serde(default)]
    pub joint: Option<Joint>,
    /// Which measurement and given model the step belongs to: only steps with the same word can be compared.
    #[serde(default)]
    pub data: String,
}

/// A model with its effects fitted, and the step that led to it.
pub struct Step {
    /// What was done.
    pub action: String,
    /// The effects of the model now.
    pub effects: Vec<FittedEffect>,
    /// Its errors.
    pub record: StepRecord,
    /// Whether it explains the measurement as a diagnosis judges, which lets segments scatter further than the study states.
    pub explains: bool,
}

/// What was learned of a model's segments.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Profiles {
    /// The model as first given.
    pub as_given: Profile,
    /// With its effects; null where it has none.
    pub with_effects: Option<Profile>,
}

impl Profiles {
    /// Of the model with all that it has.
    pub fn present(&self) -> &Profile {
        self.with_effects.as_ref().unwrap_or(&self.as_given)
    }
}

/// No record of a dozen modes can separate more effects than this.
const MOST_EFFECTS: usize = 5;
/// Effects of a set that are added without being asked for have at least this probability, each beside the others.
const SURE: f64 = 0.95;

/// A model's effects with those of the best set, where together they explain the measurement and each is sure beside the others.
fn sure_set(
    problem: &Problem,
    present: &Fit,
    settled: &Settled,
    found: &[Found],
    options: &Options,
) -> Option<Vec<Effect>> {
    let (problem, present) = here(settled, problem, present);
    let set = problem.best_set(present, found, options)?;
    let is_sure = set.members.iter().all(|member| member.probability(&set.problem) > SURE);
    let fits = set.fit.passes() && set.fit.effects().len() <= MOST_EFFECTS;
    (is_sure && fits).then(|| set.fit.effects().to_vec())
}

impl Setting<'_> {
    /// The problem of the model with these effects.
    ///
    /// # Errors
    /// As [`Problem::new`].
    pub fn problem(&self, effects: &[Effect]) -> Result<Problem, DiagnoseError> {
        let problem = Problem::new(self.bare.clone(), effects, self.model, self.sensors, self.measured)?;
        Ok(problem.told_to(self.tally))
    }

    /// The same without what the measurement does not see of how segments scatter, which moves no fit.
    ///
    /// # Errors
    /// As [`Problem::new`], and where the model with these effects cannot be solved.
    pub fn problem_as_seen(&self, effects: &[Effect]) -> Result<Problem, DiagnoseError> {
        self.problem(effects)?.as_seen(effects)
    }

    /// The model with effects refitted together.
    ///
    /// # Errors
    /// [`DiagnoseError`] where the data do not determine the effects.
    pub fn refit(&self, action: &str, effects: &[Effect]) -> Result<Step, DiagnoseError> {
        let problem = self.problem_as_seen(effects)?;
        let (problem, fit) = problem.fit_settled(effects)?;
        self.step(action, &problem, &fit)
    }

    /// The same, compared with the model with the effects `before`.
    ///
    /// # Errors
    /// As [`Setting::refit`].
    pub fn refit_beside(&self, action: &str, effects: &[Effect], before: &[Effect]) -> Result<Step, DiagnoseError> {
        let given = self.problem_as_seen(effects)?;
        let (problem, fit) = given.fit_settled(effects)?;
        let mut step = self.step(action, &problem, &fit)?;
        // Both on the modes of one of them: otherwise they explain different numbers.
        let fit_before = given.fit_settled(before);
        step.record.log_bayes_factor = fit_before.ok().map(|(_, before)| fit.log_evidence() - before.log_evidence());
        Ok(step)
    }

    /// Adds an effect at a place (the best one where none is given), refitted together with those in the model.
    ///
    /// # Errors
    /// [`DiagnoseError`] where the effect has no place in the structure, or the data do not determine it.
    pub fn add(
        &self,
        effects: &[Effect],
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
    ) -> Result<Step, DiagnoseError> {
        let problem = self.problem_as_seen(effects)?;
        let present = problem.fit_present(effects)?;
        let (mut found, settled) = problem.find(&present, kind, place)?;
        let with: Vec<Effect> = found.fit.effects().to_vec();
        let action = format!("add {}", found.effect());
        let weigh = || {
            let (problem, present) = here(&settled, &problem, &present);
            // The refit beside it tells how far it is.
            let problem = problem.clone().told_to(&UNHEARD);
            problem.weigh_each(present, std::slice::from_mut(&mut found));
            found.log_bayes_factor
        };
        // With the effect more modes may find a partner.
        let (log_bayes_factor, step) = rayon::join(weigh, || self.refit(&action, &with));
        let mut step = step?;
        step.record.log_bayes_factor = Some(log_bayes_factor);
        Ok(step)
    }

    /// The profile of the model as it is first given, and with effects where there are any, on the same modes; the effects with the values
    /// that they are fitted with.
    ///
    /// # Errors
    /// As [`Setting::refit`].
    pub fn profiles(&self, effects: &[Effect]) -> Result<Profiles, DiagnoseError> {
        let problem = self.problem(effects)?;
        let of = |effects: &[Effect]| {
            let (problem, fit) = problem.fit_settled(effects)?;
            Ok::<_, DiagnoseError>(Profile::of(&problem, &fit))
        };
        let with_effects = if effects.is_empty() { None } else { Some(of(effects)?) };
        Ok(Profiles { as_given: of(&[])?, with_effects })
    }

    /// The model with its effects and its segments or groups as they fit best, within the tolerance.
    ///
    /// # Errors
    /// As [`Setting::refit`].
    pub fn fitted(&self, effects: &[Effect]) -> Result<Structure, DiagnoseError> {
        let (problem, fit) = self.problem_as_seen(effects)?.fit_settled(effects)?;
        let mut fitted = self.bare.clone();
        problem.background.apply(&fit.state.numbers, &mut fitted);
        Ok(fitted.and(fit.effects())?)
    }

    /// Profiles with one effect more, at a place (the best one where none is given).
    ///
    /// # Errors
    /// As [`Setting::add`].
    pub fn profiles_with(
        &self,
        effects: &[Effect],
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
    ) -> Result<Profiles, DiagnoseError> {
        let problem = self.problem(effects)?;
        let present = problem.fit_present(effects)?;
        let (found, _) = problem.find(&present, kind, place)?;
        self.profiles(found.fit.effects())
    }

    /// Adds and drops effects until nothing is gained: the best addition, where one is called for, then drops what has become
    /// needless, then tries to replace each by another. `tell` hears of every step.
    ///
    /// # Errors
    /// As [`Setting::refit`].
    pub fn auto(
        &self,
        effects: &[Effect],
        signals: &Signals,
        options: &Options,
        tell: &mut dyn FnMut(&Step),
    ) -> Result<Vec<Effect>, DiagnoseError> {
        let mut effects = effects.to_vec();
        let mut visited: Vec<Vec<String>> = vec![names(&effects)];
        while effects.len() < MOST_EFFECTS {
            let problem = self.problem_as_seen(&effects)?;
            let present = problem.fit_present(&effects)?;
            let Searched { settled, found, .. } = problem.search(&present, options);
            let best = problem.leading(&found);
            // One after the other need not find effects that hide each other.
            let is_explained = present.passes() || best.is_some_and(|best| best.own().passes());
            let set = if is_explained { None } else { sure_set(&problem, &present, &settled, &found, options) };
            let Some(with) = set.or_else(|| Some(best?.fit.effects().to_vec())) else { break };
            let mut action = format!("add {}", names(&with[effects.len()..]).join(", "));
            let before = effects;
            (effects, action) = self.improved(with, action, options)?;
            let step = self.refit_beside(&action, &effects, &before)?;
            effects = step.effects.iter().map(|fitted| fitted.effect.clone()).collect();
            tell(&step);
            if visited.contains(&names(&effects)) {
                break;
            }
            visited.push(names(&effects));
        }
        for signal in shown(signals, &effects, &options.without) {
            if signal.log_bayes_factor > STANDS_OUT {
                let action = format!("add {}", signal.effect);
                effects.push(signal.effect);
                tell(&self.refit(&action, &effects)?);
            }
        }
        Ok(effects)
    }

    /// Drops what is needless and exchanges what another effect explains better.
    fn improved(
        &self,
        mut effects: Vec<Effect>,
        mut action: String,
        options: &Options,
    ) -> Result<(Vec<Effect>, String), DiagnoseError> {
        if effects.len() < 2 {
            return Ok((effects, action));
        }
        let problem = self.problem_as_seen(&effects)?;
        // The data call for the effect added last; each of those before it must still earn its place beside it.
        for index in (0..effects.len() - 1).rev() {
            let (_, with) = problem.fit_settled(&effects)?;
            let mut fewer = effects.clone();
            let dropped = fewer.remove(index);
            let Ok(present) = problem.fit_present(&fewer) else { continue };
            let settled = problem.settled_plausibly(&present);
            let (_, without) = here(&settled, &problem, &present);
            let gain = with.log_evidence()
                - without.log_evidence()
                - (problem.hypotheses(dropped.of_kind(), without) as f64).ln();
            if gain < STANDS_OUT || !with.is_significant(index) {
                effects = without.effects().to_vec();
                action += &format!(", remove {dropped}");
                continue;
            }
            let searched = problem.search(&present, options);
            let other = problem.leading(&searched.found);
            let Some(other) = other.filter(|found| found.effect().to_string() != dropped.to_string()) else {
                continue;
            };
            if other.log_bayes_factor - gain > STANDS_OUT {
                action += &format!(", replace {dropped} by {}", other.effect());
                effects = other.fit.effects().to_vec();
            }
        }
        Ok((effects, action))
    }

    fn step(&self, action: &str, problem: &Problem, fit: &Fit) -> Result<Step, DiagnoseError> {
        let effects = fit.effects().to_vec();
        let structure = self.bare.clone().and(&effects)?;
        let view = ModelView::of(&structure.assemble(), self.sensors)?;
        let comparison = compare(&view, problem.measured(), self.sensors, None);
        let scattered = compare(&fit.state.model.view, problem.measured(), self.sensors, None);
        // As every other command states it of the model with these effects.
        let stated = self.problem_as_seen(&effects).ok().and_then(|problem| fit_as_given(&problem, &effects));
        let test = stated.map_or_else(|| fit.goodness_as_stated(problem).into(), |(test, _)| test);
        let held_out = held_out(problem, fit);
        let record = StepRecord {
            step: 0,
            action: action.to_owned(),
            effects: names(&effects),
            chi_squared: test.chi_squared,
            degrees_of_freedom: test.degrees_of_freedom,
            p_value: test.p_value,
            mean_abs_frequency_error_percent: comparison.mean_abs_frequency_error_percent.unwrap_or(0.0),
            mean_mac: comparison.mean_mac,
            mean_abs_frequency_error_percent_with_background: scattered.mean_abs_frequency_error_percent.unwrap_or(0.0),
            mean_mac_with_background: scattered.mean_mac,
            held_out_error_percent: held_out.sensor_error_percent,
            held_out_mode_error_percent: held_out.mode_error_percent,
            modes: problem.measured().len(),
            log_bayes_factor: None,
            joint: fit.joint(),
            data: String::new(),
        };
        let fitted = |(index, effect): (usize, &Effect)| FittedEffect {
            effect: effect.clone(),
            parameters: fit.estimates(index),
        };
        let effects = effects.iter().enumerate().map(fitted).collect();
        Ok(Step { action: action.to_owned(), effects, record, explains: fit.passes() })
    }
}

impl Problem {
    /// The model with its effects at their most probable values and the discrepancy that suits it best, if a model of the right kind
    /// can miss as much.
    pub(super) fn fit_settled(&self, effects: &[Effect]) -> Result<(Self, Fit), DiagnoseError> {
        self.tally.stage("effects in the model refitted", 2);
        let fit = self.tally.piece(|| self.fit_present(effects))?;
        Ok(self.tally.piece(|| self.at_its_best(&fit)).unwrap_or_else(|| (self.clone(), fit)))
    }

    /// An effect fitted at its best place, or at the one that is given, with the discrepancy that it leaves: that problem, and the
    /// present model in it.
    fn find(
        &self,
        present: &Fit,
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
    ) -> Result<(Found, Settled), DiagnoseError> {
        let mut found = self.search_kind(present, kind, place).map_err(|reason| DiagnoseError::NothingGained {
            effect: place.map_or_else(|| kind.name().to_owned(), |place| format!("{}@{place}", kind.name())),
            reason,
        })?;
        let settled = self.settled_plausibly(&found.fit).and_then(|(problem, _)| {
            let present = problem.refitted(present).ok()?;
            found = problem.search_kind(&present, kind, place).ok()?;
            Some((problem, present))
        });
        Ok((found, settled))
    }
}

fn names(effects: &[Effect]) -> Vec<String> {
    effects.iter().map(Effect::to_string).collect()
}
