//! The verdict on a model.
//!
//! What the search found flows in; a [`Diagnosis`] flows out: the verdict, the effect that it names, and what is still
//! unexplained.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::candidates::Options;
use super::criteria::{FAILS, STANDS_OUT};
use super::discrepancy::here;
use super::elsewise::Elsewise;
use super::error::{DiagnoseError, in_words};
use super::fit::{Estimate, Fit};
use super::found::Found;
use super::goodness::fit_as_given;
use super::near::Near;
use super::partial_report::PartialAnswer;
use super::posterior::{Hypothesis, Probabilities, posterior};
use super::problem::Problem;
use super::report::{
    CandidateReport, Diagnosis, Explained, HeightMisfit, ModeMisfit, NearPlace, SensorMisfit, Unexplained, Verdict,
};
use super::score::Scored;
use super::search::Searched;
use super::settle::next_measurement;
use super::signals::{Signal, Signals, all_shown, shown};
use super::state::State;
use crate::compare::{Block, exceeding, levels};
use crate::model::Body;
use crate::model::effect::{Effect, Where};
use crate::modes::{MeasuredMode, are_known};

/// Effects whose predictions have this squared cosine are twins.
pub(super) const TWINS: f64 = 0.99;

/// Diagnoses the model with the effects that it has.
///
/// # Errors
/// [`DiagnoseError`] where effects cannot be fitted to these data.
pub fn diagnose(
    problem: &Problem,
    effects: &[Effect],
    signals: &Signals,
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    let problem = &problem.as_seen(effects)?;
    let present = problem.fit_present(effects)?;
    let (as_given, Searched { settled, own, found, rejected }) =
        rayon::join(|| fit_as_given(problem, effects), || problem.search(&present, options));
    let (searched, settled) = here(&settled, problem, &present);
    let at_its_own = own.as_ref().map_or(settled, |(_, fit)| fit);
    let considered = shown(signals, effects, &options.without);
    let none = problem.prior_odds.of_adequate(at_its_own.goodness_of_fit().p_value);
    let weighed = Weighed::of(searched, settled, &[none], &found, &considered);
    // Where an effect leads, the present model is shown as that effect has it; else at its own best.
    let is_led = matches!(weighed.leads, Leads::Effect(_) | Leads::Twins(..));
    let alone = own.as_ref().filter(|_| !is_led);
    let (problem, present) = alone.map_or((searched, settled), |(problem, fit)| (problem, fit));
    let mut diagnosis = weighed.told(problem, present);
    diagnosis.present_beside_best = is_led.then_some(diagnosis.present);
    if let Some((test, _)) = as_given {
        diagnosis.present = test;
    }
    diagnosis.warnings.extend(weighed.no_help(problem));
    diagnosis.fingerprints = searched.fingerprints(settled, &weighed.first_found());
    if matches!(weighed.leads, Leads::SomethingElse) {
        let answer = searched.best_set(settled, &found, options).map(|set| PartialAnswer::of(&set));
        diagnosis.partial = answer.filter(PartialAnswer::brings_nearer);
    }
    if !matches!(weighed.leads, Leads::Signal(_)) {
        let best = diagnosis.best.first().map(String::as_str);
        diagnosis.elsewise = problem.elsewise(at_its_own, &found, diagnosis.verdict, best);
        diagnosis.warnings.extend(diagnosis.elsewise.iter().map(Elsewise::told));
    }
    diagnosis.candidates.extend(rejected.iter().map(|one| rejected_report(present, one)));
    let is_left_out = |signal: &Signal| options.without.iter().any(|kind| kind == signal.effect.kind());
    let left_out = all_shown(signals, effects).into_iter().filter(is_left_out);
    let names: Vec<String> = left_out
        .filter(|signal| signal.log_bayes_factor > STANDS_OUT)
        .map(|signal| signal.effect.to_string())
        .collect();
    if diagnosis.verdict == Verdict::Adequate && !names.is_empty() {
        // A signal stands out that none of the effects considered explains.
        diagnosis.verdict = Verdict::Unknown;
        diagnosis.warnings.push(format!("{} shows outside the modes, but is not considered here", names.join(", ")));
    }
    Ok(diagnosis)
}

/// What is most probable.
pub(super) enum Leads<'a> {
    /// The model lacks nothing.
    Nothing,
    /// An effect.
    Effect(&'a Found),
    /// An effect, and others that the data cannot tell from it.
    Twins(&'a Found, Vec<&'a Found>),
    /// An effect that shows outside the modes.
    Signal(&'a Signal),
    /// Something else.
    SomethingElse,
}

/// All hypotheses with their probabilities, and which is the most probable.
pub(super) struct Weighed<'a> {
    probabilities: Probabilities,
    /// Effects, with odds before and probability.
    found: Vec<(&'a Found, f64, f64)>,
    signals: Vec<(&'a Signal, f64, f64)>,
    pub(super) leads: Leads<'a>,
}

impl<'a> Weighed<'a> {
    /// `without` are hypotheses without an effect: first that the model lacks nothing, then what counts as something else. `problem` and
    /// `present` are those of the search.
    pub(super) fn of(
        problem: &Problem,
        present: &Fit,
        without: &[Hypothesis],
        found: &'a [Found],
        signals: &'a [Signal],
    ) -> Self {
        let odds = &problem.prior_odds;
        let p_value = without.first().map_or(0.0, |none| none.p_value);
        let mut hypotheses = without.to_vec();
        hypotheses.extend(found.iter().map(|one| odds.of_found(one, one.own().goodness_of_fit().p_value)));
        hypotheses.extend(signals.iter().map(|signal| Hypothesis {
            prior_odds: odds.kind(signal.effect.of_kind()),
            log_bayes_factor: signal.log_bayes_factor,
            // Beside a signal the modes are as the present model has them, but for those that a forced line is in.
            p_value: if p_value < FAILS {
                without_spoilt(problem, present, signal).unwrap_or(p_value)
            } else {
                p_value
            },
        }));
        let (each, something_else) = posterior(&hypotheses, odds.something_else());
        let (alone, each_effect) = each.split_at(without.len());
        let something_else = something_else + alone.iter().skip(1).sum::<f64>();
        let probabilities = Probabilities { adequate: alone.first().copied().unwrap_or(0.0), something_else };
        let hypotheses = &hypotheses[without.len()..];
        let of = |at: usize| (hypotheses[at].prior_odds, each_effect[at]);
        let mut weighed_found: Vec<(&Found, f64, f64)> =
            found.iter().enumerate().map(|(at, one)| (one, of(at).0, of(at).1)).collect();
        let first_signal = found.len();
        let mut weighed_signals: Vec<(&Signal, f64, f64)> = signals
            .iter()
            .enumerate()
            .map(|(at, one)| (one, of(first_signal + at).0, of(first_signal + at).1))
            .collect();
        weighed_found.sort_by(|a, b| b.2.total_cmp(&a.2));
        weighed_signals.sort_by(|a, b| b.2.total_cmp(&a.2));
        let mut leads = vec![(Leads::Nothing, probabilities.adequate), (Leads::SomethingElse, something_else)];
        if let Some(&(signal, _, probability)) = weighed_signals.first() {
            leads.push((Leads::Signal(signal), probability));
        }
        // What the data cannot tell apart counts as one.
        if let Some(&(best, _, probability)) = weighed_found.first() {
            let twins = twins(problem, present, best, &weighed_found);
            let together = probability + twins.iter().map(|(_, probability)| probability).sum::<f64>();
            let twins: Vec<&Found> = twins.into_iter().map(|(twin, _)| twin).collect();
            let leading = if twins.is_empty() { Leads::Effect(best) } else { Leads::Twins(best, twins) };
            leads.push((leading, together));
        }
        let leads =
            leads.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(Leads::SomethingElse, |(leads, _)| leads);
        Self { probabilities, found: weighed_found, signals: weighed_signals, leads }
    }

    /// As a diagnosis, beside this present model.
    pub(super) fn told(&self, problem: &Problem, present: &Fit) -> Diagnosis {
        let mut warnings = unused_modes(problem);
        let first = self.found.first().map(|(best, ..)| *best);
        let name = |found: &Found| found.effect().to_string();
        let (verdict, best, ambiguous, next) = match &self.leads {
            Leads::Nothing => (Verdict::Adequate, Vec::new(), Vec::new(), None),
            Leads::SomethingElse => (Verdict::Unknown, Vec::new(), Vec::new(), None),
            Leads::Effect(best) => (Verdict::Effect, vec![name(best)], Vec::new(), None),
            Leads::Signal(signal) => (Verdict::Effect, vec![signal.effect.to_string()], Vec::new(), None),
            Leads::Twins(best, twins) => {
                let names = std::iter::once(best).chain(twins).map(|found| name(found)).collect();
                let next =
                    twins.first().map(|twin| next_measurement(problem, (best.kind, &best.fit), (twin.kind, &twin.fit)));
                (Verdict::Ambiguous, vec![name(best)], vec![names], next)
            }
        };
        let strong = self.signals.iter().any(|(signal, ..)| signal.log_bayes_factor > STANDS_OUT);
        if verdict == Verdict::Unknown && strong {
            warnings.push("forced lines or trends point to an effect as well; see the candidates".to_owned());
        }
        // The unexplained part is that of the best fit, even where that fails.
        let shown_fit = match (&self.leads, first) {
            (Leads::Effect(best) | Leads::Twins(best, _), _) => best.own(),
            (Leads::SomethingElse, Some(best)) if best.log_bayes_factor > STANDS_OUT => best.own(),
            _ => present,
        };
        if verdict != Verdict::Unknown {
            warnings.extend(wrong_modes(problem, shown_fit));
        }
        warnings.extend(shown_fit.effects().iter().filter_map(|effect| effect.caution(&problem.bare)));
        let strangers: Vec<usize> =
            shown_fit.strangers().into_iter().map(|mode| problem.measured[mode].number).collect();
        if !strangers.is_empty() {
            warnings.push(told(
                &strangers,
                "measured mode {} is like no mode of the model (MAC below 0.8), as of a floor or a wall; it does not count in the test of fit",
                "measured modes {} are like no mode of the model (MAC below 0.8), as of floors or walls; they do not count in the test of fit",
            ));
        }
        if let (Leads::Signal(signal), Some(other)) = (&self.leads, first.filter(|found| found.stands_out())) {
            warnings.push(format!(
                "{} stands out as well, in the modes; add {} and diagnose again",
                other.effect(),
                signal.effect
            ));
        }
        let reason = match &self.leads {
            Leads::Signal(signal) => Some(signal.reason.clone()),
            _ => None,
        };
        Diagnosis {
            verdict,
            candidates: self.candidate_reports(best.first()),
            best,
            ambiguous,
            next_measurement: next,
            goodness_of_fit: shown_fit.goodness_of_fit().into(),
            discrepancy: shown_fit.discrepancy,
            probabilities: self.probabilities,
            elsewise: Vec::new(),
            partial: None,
            present: present.goodness_of_fit().into(),
            present_beside_best: None,
            unexplained: unexplained(problem, shown_fit),
            explained: explained(problem, present, shown_fit),
            effects: (0..present.state.effects.len()).map(|effect| report(present, effect, None)).collect(),
            joint: shown_fit.joint(),
            fingerprints: None,
            reason,
            warnings,
        }
    }

    /// The effects that explain most, the most probable first.
    fn first_found(&self) -> Vec<(&'a Found, f64)> {
        let mut found: Vec<(&Found, f64)> =
            self.found.iter().map(|(found, _, probability)| (*found, *probability)).collect();
        found.sort_by(|a, b| b.1.total_cmp(&a.1).then(b.0.log_bayes_factor.total_cmp(&a.0.log_bayes_factor)));
        found
    }

    /// A warning about the effect that would be the most probable, had it made the model better.
    fn no_help(&self, problem: &Problem) -> Option<String> {
        let log_odds = |found: &Found| problem.prior_odds.log_odds_of(found);
        let helps = self.found.iter().filter(|(found, ..)| found.helps).map(|(found, ..)| log_odds(found));
        let most = helps.fold(problem.prior_odds.adequate().ln(), f64::max);
        let useless = self.found.iter().filter(|(found, ..)| !found.helps && log_odds(found) > most);
        let (found, ..) = useless.max_by(|a, b| log_odds(a.0).total_cmp(&log_odds(b.0)))?;
        if found.own().is_usual(found.index()) {
            return Some(format!(
                "{} stands out, but is not counted: calibration and mounting of good sensors leave as much",
                found.effect()
            ));
        }
        if found.own().looks_like_the_table(found.index()) {
            return Some(format!(
                "{} stands out, but is not counted: it is no larger than what the model's own tolerance looks like",
                found.effect()
            ));
        }
        if !problem.explains_its_channels(found.own(), found.index()) {
            return Some(format!(
                "{} stands out, but is not counted: what it leaves at its own channels is more than at all others",
                found.effect()
            ));
        }
        let left = found.left?;
        let how = match (left.misfit < 1.0, left.frequency < 1.0) {
            (false, _) => "the model's errors rise with it",
            (_, false) => "frequencies are further off with it",
            _ => "the model's errors hardly fall with it",
        };
        Some(format!(
            "{} is not counted: {how}. It fits only beside segments that are off the other way",
            found.effect()
        ))
    }

    /// Candidates by their probability, the one that is named first before all others.
    fn candidate_reports(&self, first: Option<&String>) -> Vec<CandidateReport> {
        let of_found = |(found, prior_odds, probability): &(&Found, f64, f64)| CandidateReport {
            prior_odds: Some(*prior_odds),
            probability: Some(*probability),
            errors_left: found.left,
            ..height_report(found, found.own())
        };
        let of_signal = |(signal, prior_odds, probability): &(&Signal, f64, f64)| CandidateReport {
            prior_odds: Some(*prior_odds),
            probability: Some(*probability),
            ..signal_report(signal)
        };
        let mut candidates: Vec<CandidateReport> =
            self.found.iter().map(of_found).chain(self.signals.iter().map(of_signal)).collect();
        let by = |candidate: &CandidateReport| {
            (candidate.probability.unwrap_or(0.0), candidate.log_bayes_factor.unwrap_or(f64::NEG_INFINITY))
        };
        candidates.sort_by(|a, b| by(b).0.total_cmp(&by(a).0).then(by(b).1.total_cmp(&by(a).1)));
        candidates.sort_by_key(|candidate| first.is_some_and(|first| candidate.name() != *first));
        candidates
    }
}

impl Problem {
    /// The model with its effects at their most probable values.
    ///
    /// # Errors
    /// [`DiagnoseError`] where the data do not determine them.
    pub(super) fn fit_present(&self, effects: &[Effect]) -> Result<Fit, DiagnoseError> {
        let present = self.present(effects).map_err(|reason| DiagnoseError::no_structure(effects, reason))?;
        let (numbers, parameters) = (present.state.modes.len(), present.knobs.len());
        if parameters >= numbers {
            return Err(DiagnoseError::TooFewModes { numbers, parameters, effects: in_words(effects) });
        }
        self.check_apart(&present)?;
        Ok(present)
    }

    /// Checks that no two effects explain the same: they cannot be fitted together.
    fn check_apart(&self, present: &Fit) -> Result<(), DiagnoseError> {
        let columns = present.jacobian.columns(0, present.knobs.len());
        for one in 0..present.knobs.len() {
            for other in 0..one {
                let (a, b) = (columns.column(one), columns.column(other));
                let cosine_squared = a.dot(&b).powi(2) / (a.norm_squared() * b.norm_squared());
                if cosine_squared > 1.0 - IDENTICAL {
                    let effect = |knob: usize| &present.state.effects[present.knobs[knob].effect];
                    let (first, second) = (effect(other), effect(one));
                    let (name, kind) = (first.to_string(), first.kind());
                    return Err(match present.knobs[one].effect == present.knobs[other].effect {
                        true => DiagnoseError::SameValues { effect: name, kind },
                        false if second.to_string() == name => DiagnoseError::Twice { effect: name },
                        false => DiagnoseError::SameEffect { one: name, other: second.to_string() },
                    });
                }
            }
        }
        Ok(())
    }
}

/// Directions that differ by less than this squared sine are one.
const IDENTICAL: f64 = 1e-6;

/// Probability of the misfit that is left without the modes in whose peaks a forced line is; `None` where it is in none.
pub(super) fn without_spoilt(problem: &Problem, present: &Fit, signal: &Signal) -> Option<f64> {
    let Some(Where::Frequency(forced_hz)) = signal.effect.place() else { return None };
    let fit = problem.without_forced(*forced_hz)?.present(present.effects()).ok()?;
    Some(fit.goodness_of_fit().p_value)
}

/// A warning about modes that stay far off, where the others fit.
fn wrong_modes(problem: &Problem, fit: &Fit) -> Option<String> {
    let wrong = fit.wrong_modes();
    let of = |&mode: &usize| {
        let mode: &MeasuredMode = &problem.measured[mode];
        format!("{} at {:.4} Hz", mode.number, mode.frequency_hz)
    };
    let names = wrong.iter().map(of).collect::<Vec<_>>().join(" and ");
    match wrong.len() {
        0 => None,
        1 => Some(format!(
            "measured mode {names} is the only one that stays far off; is it a single mode, and well identified?"
        )),
        _ => Some(format!(
            "measured modes {names} are the only ones that stay far off; are they single modes, and well identified?"
        )),
    }
}

/// Warnings about measured modes, or parts of them, that the verdict does not rest on.
fn unused_modes(problem: &Problem) -> Vec<String> {
    let mut warnings = Vec::new();
    if !problem.unpaired.is_empty() {
        warnings.push(told(
            &problem.unpaired,
            "measured mode {} has no partner in the model and does not count in the verdict",
            "measured modes {} have no partner in the model and do not count in the verdict",
        ));
    }
    if problem.measured().iter().all(|mode| mode.shape.is_none()) {
        let guess = if are_known(problem.measured()) { "" } else { "which mode is which is a guess, and " };
        warnings.push(format!(
            "no shapes were measured: {guess}effects that move the same frequencies cannot be told apart; shapes at a few heights would decide more than any better frequency"
        ));
    }
    if !problem.complex.is_empty() {
        warnings.push(told(
            &problem.complex,
            "the shape of measured mode {} is complex, as if two modes were taken for one; it does not count in the verdict",
            "the shapes of measured modes {} are complex, each as if two modes were taken for one; they do not count in the verdict",
        ));
    }
    if problem.lacks_tolerance {
        let warning = match problem.bare.body {
            Body::Beam(_) => {
                "study.toml states no background_stiffness and background_mass, so the table is taken to be exact and its errors may pass for effects; 0.03 and 0.01 are usual"
            }
            Body::Matrices(_) => {
                "the model is given as matrices without a [[model.group]], so all of it is taken to be exact and its errors may pass for effects; name its parts and how far each is trusted"
            }
        };
        warnings.push(warning.to_owned());
    }
    let assumed = |mode: &&MeasuredMode| {
        mode.frequency_std_hz.is_none() || mode.shape.as_ref().is_some_and(|shape| shape.stds.is_none())
    };
    let assumed: Vec<usize> = problem.measured().iter().filter(assumed).map(|mode| mode.number).collect();
    if !assumed.is_empty() {
        warnings.push(told(
            &assumed,
            "the file of modes states no deviations for measured mode {}; 0.5 % of the frequency and 2 % of the shape are assumed, and the verdict rests on that",
            "the file of modes states no deviations for measured modes {}; 0.5 % of frequencies and 2 % of shapes are assumed, and the verdict rests on that",
        ));
    }
    warnings
}

/// What is said of one mode, or of several, with their numbers in the place of `{}`.
fn told(numbers: &[usize], of_one: &str, of_several: &str) -> String {
    let words = if numbers.len() == 1 { of_one } else { of_several };
    words.replace("{}", &numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(", "))
}

/// What was found, as a fit has it, with what is known of its height.
pub(super) fn height_report(found: &Found, fit: &Fit) -> CandidateReport {
    let near =
        |(place, below): &(Where, f64)| NearPlace { r#where: place.to_string(), log_evidence_below_best: *below };
    let mut candidate = CandidateReport {
        near: found.near.iter().map(near).collect(),
        where_std_m: found.height.as_ref().map(|height| height.std_m),
        ..report(fit, found.index(), Some(found.log_bayes_factor))
    };
    // Elsewhere it would have other values.
    let spread = found.height.as_ref().map_or(&[][..], |height| &height.values);
    for (parameter, spread) in candidate.parameters.iter_mut().zip(spread) {
        parameter.std = parameter.std.map(|std| std.hypot(*spread));
    }
    candidate
}

fn report(fit: &Fit, effect: usize, log_bayes_factor: Option<f64>) -> CandidateReport {
    let test = fit.goodness_of_fit();
    CandidateReport {
        effect: fit.state.effects[effect].kind().to_owned(),
        r#where: fit.place(effect).map(ToString::to_string),
        parameters: fit.estimates(effect),
        log_bayes_factor,
        prior_odds: None,
        probability: None,
        chi_squared: test.all.chi_squared,
        p_value: test.p_value,
        errors_left: None,
        admissible: true,
        where_std_m: None,
        near: Vec::new(),
    }
}

/// A kind that would explain something with a value that it cannot have; the value is that of one linear step.
pub(super) fn rejected_report(present: &Fit, scored: &Scored) -> CandidateReport {
    let test = present.goodness_of_fit();
    let values = scored.candidate.parameters.iter().zip(&scored.values);
    CandidateReport {
        effect: scored.candidate.kind.name().to_owned(),
        r#where: scored.candidate.place.as_ref().map(ToString::to_string),
        parameters: values
            .map(|(parameter, value)| Estimate {
                name: parameter.name.to_owned(),
                value: *value,
                std: None,
                unit: parameter.unit.to_owned(),
                typical_sizes: None,
            })
            .collect(),
        log_bayes_factor: None,
        prior_odds: None,
        probability: None,
        chi_squared: test.all.chi_squared,
        p_value: test.p_value,
        errors_left: None,
        admissible: false,
        where_std_m: None,
        near: Vec::new(),
    }
}

fn signal_report(signal: &Signal) -> CandidateReport {
    let estimate = |(parameter, value): (&'static crate::model::effect::Parameter, f64)| Estimate {
        name: parameter.name.to_owned(),
        value,
        std: signal.std,
        unit: parameter.unit.to_owned(),
        typical_sizes: None,
    };
    CandidateReport {
        effect: signal.effect.kind().to_owned(),
        r#where: signal.effect.place().map(ToString::to_string),
        parameters: signal.effect.parameters().map(estimate).collect(),
        log_bayes_factor: Some(signal.log_bayes_factor),
        prior_odds: None,
        probability: None,
        chi_squared: signal.chi_squared,
        p_value: exceeding(signal.chi_squared, signal.degrees_of_freedom as f64),
        errors_left: None,
        admissible: true,
        where_std_m: None,
        near: Vec::new(),
    }
}

/// Effects that the data cannot tell from the best, with their probabilities: within 20 to 1 of its own, or predicting the same, and not
/// refuted by the test of fit where the best is not.
fn twins<'a>(
    problem: &Problem,
    present: &Fit,
    best: &Found,
    others: &[(&'a Found, f64, f64)],
) -> Vec<(&'a Found, f64)> {
    let Some(marginal) = Near::of(problem, present).marginal(problem) else { return Vec::new() };
    let single: Vec<bool> = rows_of_single_modes(present);
    let direction = |fit: &Fit| {
        // Twins stand beside no mode of the present model.
        let Some(mut moved) = fit.state.moved_from(&present.state) else {
            return DVector::zeros(present.state.size());
        };
        for (value, single) in moved.iter_mut().zip(&single) {
            if !single {
                *value = 0.0;
            }
        }
        let columns = marginal.weigh(&DMatrix::from_columns(&[moved]));
        marginal.project(&columns).column(0).into_owned()
    };
    let along = direction(&best.fit);
    let log_odds = |found: &Found| problem.prior_odds.log_odds_of(found);
    let p_value = |found: &Found| found.own().goodness_of_fit().p_value;
    let least = FAILS.min(p_value(best));
    let is_twin = |other: &Found| {
        let within = log_odds(best) - log_odds(other) < STANDS_OUT;
        let there = direction(&other.fit);
        let cosine_squared = along.dot(&there).powi(2) / (along.norm_squared() * there.norm_squared());
        other.helps && (within || cosine_squared > TWINS) && p_value(other) >= least
    };
    let others = others.iter().filter(|(other, ..)| other.kind != best.kind && other.fit.is_significant(other.index()));
    others.filter(|(other, ..)| is_twin(other)).map(|(other, _, probability)| (*other, *probability)).collect()
}

/// Differences of shapes in a span of close modes stand along directions of their own in every state.
fn rows_of_single_modes(fit: &Fit) -> Vec<bool> {
    let mut rows = vec![true; fit.state.size()];
    for (first, block) in fit.state.residual.blocks() {
        if block.shape.as_ref().is_some_and(|shape| shape.models.len() > 1) {
            rows[first + 1..first + block.size()].fill(false);
        }
    }
    rows
}

/// Squared differences of shapes in a fit at every sensor of these, in standard deviations: their sum, and how many there are.
pub(super) fn squares_by_sensor(sensors: usize, fit: &Fit) -> Vec<(f64, usize)> {
    let mut squares = vec![(0.0, 0usize); sensors];
    for (_, block, factor) in fit.state.blocks() {
        for (sensor, square) in sensor_squares(block, factor) {
            squares[sensor].0 += square;
            squares[sensor].1 += 1;
        }
    }
    squares
}

pub(super) fn unexplained(problem: &Problem, fit: &Fit) -> Unexplained {
    let state = &fit.state;
    let of_mode = |(first, block, _): (usize, &Block, &Cholesky<f64, Dyn>)| {
        let mode = &problem.measured[block.measured];
        ModeMisfit {
            measured: mode.number,
            measured_hz: mode.frequency_hz,
            frequency_error_percent: error_percent(state.model.view.modes.frequency_hz[block.model], mode),
            mean_square: state.modes.rows(first, block.size()).norm_squared() / block.size() as f64,
        }
    };
    let by_mode = state.blocks().map(of_mode).collect();
    let by_sensor: Vec<(usize, f64)> = squares_by_sensor(problem.sensors.len(), fit)
        .iter()
        .enumerate()
        .filter(|(_, (_, count))| *count > 0)
        .map(|(sensor, (sum, count))| (sensor, sum / *count as f64))
        .collect();
    let at_height = |&(sensor, mean_square): &(usize, f64)| Some((problem.sensors[sensor].elevation_m?, mean_square));
    let levels = levels(by_sensor.iter().filter_map(at_height).collect());
    Unexplained {
        by_mode,
        by_sensor: by_sensor
            .iter()
            .map(|&(sensor, mean_square)| SensorMisfit {
                channel: problem.sensors[sensor].channel.clone(),
                mean_square,
            })
            .collect(),
        by_group: Vec::new(),
        by_height: levels
            .iter()
            .map(|(elevation_m, squares)| HeightMisfit {
                elevation_m: *elevation_m,
                mean_square: squares.iter().sum::<f64>() / squares.len() as f64,
            })
            .collect(),
    }
}

/// A model's frequency against that of a measured mode.
pub(super) fn error_percent(frequency_hz: f64, mode: &MeasuredMode) -> f64 {
    100.0 * (frequency_hz / mode.frequency_hz - 1.0)
}

/// Squared differences of a shape sensor by sensor, in standard deviations of measurement and discrepancy. `factor` is the Cholesky
/// factor of the block's covariance.
fn sensor_squares(block: &Block, factor: &Cholesky<f64, Dyn>) -> Vec<(usize, f64)> {
    let Some(shape) = &block.shape else { return Vec::new() };
    let rows = block.size() - 1;
    let left = &shape.directions * block.residual.rows(1, rows);
    let scatter = &shape.directions * factor.l().rows(1, rows);
    let squares = left.iter().zip(scatter.row_iter()).map(|(left, scatter)| left * left / scatter.norm_squared());
    shape.sensors.iter().copied().zip(squares).collect()
}

fn explained(problem: &Problem, present: &Fit, best: &Fit) -> Vec<Explained> {
    // Errors without the scatter that a fit allows itself, as `belfry compare` shows them.
    let plain = |fit: &Fit| problem.state_without_scatter(&fit.state.effects).ok();
    let (plain_present, plain_best) = (plain(present), plain(best));
    let block_of = |fit: &Fit, measured: usize| -> (f64, Vec<(usize, f64)>) {
        let block = fit.state.blocks().find(|(_, block, _)| block.measured == measured);
        block.map_or((0.0, Vec::new()), |(first, block, factor)| {
            (fit.state.modes.rows(first, block.size()).norm_squared(), sensor_squares(block, factor))
        })
    };
    problem
        .measured
        .iter()
        .enumerate()
        .map(|(index, mode)| {
            let error = |plain: &Option<State>| Some(error_percent(plain.as_ref()?.frequency_of(index)?, mode));
            let ((chi_squared_before, before), (chi_squared_after, after)) =
                (block_of(present, index), block_of(best, index));
            let gains = before.iter().filter_map(|(sensor, square)| {
                let left = after.iter().find(|(other, _)| other == sensor).map(|(_, left)| left)?;
                Some((*sensor, square - left))
            });
            let channel = gains
                .filter(|(_, gain)| *gain > 1.0)
                .max_by(|a, b| a.1.total_cmp(&b.1))
                .map(|(sensor, _)| problem.sensors[sensor].channel.clone());
            Explained {
                measured: mode.number,
                measured_hz: mode.frequency_hz,
                before_percent: error(&plain_present),
                after_percent: error(&plain_best),
                chi_squared_before,
                chi_squared_after,
                channel,
            }
        })
        .collect()
}
