//! The verdict on a model.
//!
//! What the search found flows in; a [`Diagnosis`] flows out: the verdict, the effect that it names, and what is still
//! unexplained.

use nalgebra::{DMatrix, DVector};

use super::candidates::Options;
use super::criteria::{FAILS, STANDS_OUT};
use super::discrepancy::here;
use super::error::DiagnoseError;
use super::fit::{Estimate, Fit};
use super::found::{Found, best_of};
use super::problem::Problem;
use super::report::{
    CandidateReport, Diagnosis, Explained, HeightMisfit, ModeMisfit, NearPlace, SensorMisfit, Unexplained, Verdict,
};
use super::score::Scored;
use super::search::Searched;
use super::settle::next_measurement;
use super::signals::{Signal, Signals, all_shown, shown};
use super::state::State;
use crate::compare::{exceeding, levels};
use crate::model::effect::{Effect, Where};
use crate::modes::MeasuredMode;

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
    let present = problem.fit_present(effects)?;
    let Searched { settled, own, found, rejected } = problem.search(&present, options);
    let settled = here(&settled, problem, &present);
    // Where an effect stands out, the present model is shown as that effect has it; else at its own best.
    let alone = own.as_ref().filter(|_| best_of(&found, settled.1).is_none());
    let (problem, present) = alone.map_or(settled, |(problem, fit)| (problem, fit));
    let considered = shown(signals, effects, &options.without);
    let mut diagnosis = weigh(problem, present, &found, &considered);
    diagnosis.candidates.extend(rejected.iter().map(|one| rejected_report(present, one)));
    let all = all_shown(signals, effects);
    let stands_out = |signal: &&Signal| signal.log_bayes_factor > STANDS_OUT;
    if diagnosis.verdict == Verdict::Adequate && all.iter().any(|signal| stands_out(&signal)) {
        // A signal stands out that none of the effects considered explains.
        diagnosis.verdict = Verdict::Unknown;
        let names: Vec<String> = all.iter().filter(stands_out).map(|signal| signal.effect.to_string()).collect();
        diagnosis.warnings.push(format!("{} shows outside the modes, but is not considered here", names.join(", ")));
    }
    Ok(diagnosis)
}

impl Problem {
    /// The model with its effects at their most probable values.
    ///
    /// # Errors
    /// [`DiagnoseError`] where the data do not determine them.
    pub(super) fn fit_present(&self, effects: &[Effect]) -> Result<Fit, DiagnoseError> {
        let names = || effects.iter().map(Effect::to_string).collect::<Vec<_>>().join(" and ");
        let present =
            self.present(effects).map_err(|reason| DiagnoseError::NoStructure { effects: names(), reason })?;
        let (numbers, parameters) = (present.state.modes.len(), present.knobs.len());
        if parameters >= numbers {
            return Err(DiagnoseError::TooFewModes { numbers, parameters, effects: names() });
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

fn weigh(problem: &Problem, present: &Fit, found: &[Found], signals: &[Signal]) -> Diagnosis {
    let test = present.goodness_of_fit();
    let best = best_of(found, present);
    let fails = test.p_value < FAILS;
    let modal = match best {
        None if fails => Verdict::Unknown,
        None => Verdict::Adequate,
        Some(best) if !best.fit.explains(present) => Verdict::Unknown,
        Some(_) => Verdict::Effect,
    };
    let named = best.filter(|_| modal == Verdict::Effect);
    let twins = named.map_or_else(Vec::new, |best| twins(present, best, found));
    let strongest = signals.iter().max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor));
    let strongest = strongest.filter(|signal| signal.log_bayes_factor > STANDS_OUT);
    let above_modes = |signal: &&Signal| match modal {
        Verdict::Adequate => true,
        Verdict::Unknown => spoils_all(problem, present, signal),
        Verdict::Effect | Verdict::Ambiguous => {
            named.is_none_or(|named| signal.log_bayes_factor > named.log_bayes_factor)
        }
    };
    let signal = strongest.filter(above_modes);
    let mut warnings = unused_modes(problem);
    let (verdict, best_names, ambiguous, next) = match (signal, named) {
        (Some(signal), _) => (Verdict::Effect, vec![signal.effect.to_string()], Vec::new(), None),
        (None, Some(best)) if twins.is_empty() => (modal, vec![best.effect().to_string()], Vec::new(), None),
        (None, Some(best)) => {
            let names = std::iter::once(best).chain(twins.iter().copied()).map(|found| found.effect().to_string());
            let next =
                twins.first().map(|twin| next_measurement(problem, (best.kind, &best.fit), (twin.kind, &twin.fit)));
            (Verdict::Ambiguous, vec![best.effect().to_string()], vec![names.collect()], next)
        }
        (None, None) => (modal, Vec::new(), Vec::new(), None),
    };
    if verdict == Verdict::Unknown && strongest.is_some() {
        warnings.push("forced lines or trends point to an effect as well; see the candidates".to_owned());
    }
    // The unexplained part is that of the best fit, even where that fails.
    let shown_fit = match (modal, best) {
        // A signal shows outside the modes.
        _ if signal.is_some() => present,
        (Verdict::Effect | Verdict::Unknown, Some(best)) => &best.fit,
        _ => present,
    };
    if let Some(odd) = named.and_then(|named| named.fit.odd_one(present)) {
        let mode = &problem.measured[odd];
        warnings.push(format!(
            "measured mode {} at {:.4} Hz is the only one that stays far off; is it a single mode, and well identified?",
            mode.number, mode.frequency_hz
        ));
    }
    let strangers: Vec<usize> = shown_fit.strangers().into_iter().map(|mode| problem.measured[mode].number).collect();
    if !strangers.is_empty() {
        warnings.push(told(
            &strangers,
            "measured mode {} is like no mode of the model (MAC below 0.8), as of a floor or a wall; it does not count in the test of fit",
            "measured modes {} are like no mode of the model (MAC below 0.8), as of floors or walls; they do not count in the test of fit",
        ));
    }
    if let (Some(signal), Some(named)) = (signal, named) {
        warnings.push(format!(
            "{} stands out as well, in the modes; add {} and diagnose again",
            named.effect(),
            signal.effect
        ));
    }
    Diagnosis {
        verdict,
        candidates: candidate_reports(found, signals, best_names.first()),
        best: best_names,
        ambiguous,
        next_measurement: next,
        goodness_of_fit: shown_fit.goodness_of_fit().into(),
        discrepancy: shown_fit.discrepancy,
        present: test.into(),
        unexplained: unexplained(problem, shown_fit),
        explained: explained(problem, present, shown_fit),
        effects: (0..present.state.effects.len()).map(|effect| report(present, effect, None)).collect(),
        reason: signal.map(|signal| signal.reason.clone()),
        warnings,
    }
}

/// Whether a forced line is what is wrong: without the modes whose peaks it is in, the model fits.
pub(super) fn spoils_all(problem: &Problem, present: &Fit, signal: &Signal) -> bool {
    let Some(Where::Frequency(forced_hz)) = signal.effect.place() else { return false };
    let rest = problem.without_forced(*forced_hz);
    let fit = rest.and_then(|rest| rest.present(present.effects()).ok());
    fit.is_some_and(|fit| fit.goodness_of_fit().p_value >= FAILS)
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
        warnings.push(
            "no shapes were measured: which mode is which is a guess, and effects that lower the same frequencies cannot be told apart; shapes at a few heights would decide more than any better frequency"
                .to_owned(),
        );
    }
    if !problem.complex.is_empty() {
        warnings.push(told(
            &problem.complex,
            "the shape of measured mode {} is complex, as if two modes were taken for one; it does not count in the verdict",
            "the shapes of measured modes {} are complex, each as if two modes were taken for one; they do not count in the verdict",
        ));
    }
    warnings
}

/// What is said of one mode, or of several, with their numbers in the place of `{}`.
fn told(numbers: &[usize], of_one: &str, of_several: &str) -> String {
    let words = if numbers.len() == 1 { of_one } else { of_several };
    words.replace("{}", &numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(", "))
}

/// Candidates by their evidence, the one that is named first before all others.
fn candidate_reports(found: &[Found], signals: &[Signal], first: Option<&String>) -> Vec<CandidateReport> {
    let near =
        |(place, below): &(Where, f64)| NearPlace { r#where: place.to_string(), log_evidence_below_best: *below };
    let of_found = |found: &Found| {
        let mut candidate = CandidateReport {
            near: found.near.iter().map(near).collect(),
            where_std_m: found.height.as_ref().map(|height| height.std_m),
            ..report(found.own(), found.index(), Some(found.log_bayes_factor))
        };
        // Elsewhere it would have other values.
        let spread = found.height.as_ref().map_or(&[][..], |height| &height.values);
        for (parameter, spread) in candidate.parameters.iter_mut().zip(spread) {
            parameter.std = parameter.std.map(|std| std.hypot(*spread));
        }
        candidate
    };
    let mut candidates: Vec<CandidateReport> =
        found.iter().map(of_found).chain(signals.iter().map(signal_report)).collect();
    candidates.sort_by(|a, b| b.log_bayes_factor.unwrap_or(0.0).total_cmp(&a.log_bayes_factor.unwrap_or(0.0)));
    candidates.sort_by_key(|candidate| first.is_some_and(|first| candidate.name() != *first));
    candidates
}

fn report(fit: &Fit, effect: usize, log_bayes_factor: Option<f64>) -> CandidateReport {
    let test = fit.goodness_of_fit();
    CandidateReport {
        effect: fit.state.effects[effect].kind().to_owned(),
        r#where: fit.place(effect).map(ToString::to_string),
        parameters: fit.estimates(effect),
        log_bayes_factor,
        chi_squared: test.all.chi_squared,
        p_value: test.p_value,
        admissible: true,
        where_std_m: None,
        near: Vec::new(),
    }
}

/// A kind that would explain something with a value that it cannot have; the value is that of one linear step.
fn rejected_report(present: &Fit, scored: &Scored) -> CandidateReport {
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
        chi_squared: test.all.chi_squared,
        p_value: test.p_value,
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
        chi_squared: signal.chi_squared,
        p_value: exceeding(signal.chi_squared, signal.degrees_of_freedom as f64),
        admissible: true,
        where_std_m: None,
        near: Vec::new(),
    }
}

/// Effects that the data cannot tell from the best: within 20 to 1 of its evidence, or predicting the same and not
/// refuted by the test of fit.
fn twins<'a>(present: &Fit, best: &Found, others: &'a [Found]) -> Vec<&'a Found> {
    let marginal = present.marginal();
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
    others
        .iter()
        .filter(|other| other.kind != best.kind && other.fit.is_significant(other.index()))
        .filter(|other| {
            let within = best.log_bayes_factor - other.log_bayes_factor < STANDS_OUT;
            let there = direction(&other.fit);
            let cosine_squared = along.dot(&there).powi(2) / (along.norm_squared() * there.norm_squared());
            (within || cosine_squared > TWINS) && other.fit.explains(present)
        })
        .collect()
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

fn unexplained(problem: &Problem, fit: &Fit) -> Unexplained {
    let state = &fit.state;
    let mut sensors = vec![(0.0, 0usize); problem.sensors.len()];
    let mut by_mode = Vec::new();
    for (first, block) in state.residual.blocks() {
        let mode = &problem.measured[block.measured];
        let part = state.modes.rows(first, block.size());
        by_mode.push(ModeMisfit {
            measured: mode.number,
            measured_hz: mode.frequency_hz,
            frequency_error_percent: error_percent(state.view.modes.frequency_hz[block.model], mode),
            mean_square: part.norm_squared() / block.size() as f64,
        });
        for (sensor, square) in sensor_squares(problem, block) {
            sensors[sensor].0 += square;
            sensors[sensor].1 += 1;
        }
    }
    let by_sensor: Vec<(usize, f64)> = sensors
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
fn error_percent(frequency_hz: f64, mode: &MeasuredMode) -> f64 {
    100.0 * (frequency_hz / mode.frequency_hz - 1.0)
}

/// Squared deviations of a shape sensor by sensor.
fn sensor_squares(problem: &Problem, block: &crate::compare::Block) -> Vec<(usize, f64)> {
    let (Some(shape), Some(measured)) = (&block.shape, &problem.measured[block.measured].shape) else {
        return Vec::new();
    };
    let left = &shape.directions * block.residual.rows(1, block.size() - 1);
    let deviations = crate::compare::shape_deviations(measured);
    shape
        .sensors
        .iter()
        .zip(left.iter().zip(deviations))
        .map(|(&sensor, (left, std))| (sensor, (left / std).powi(2)))
        .collect()
}

fn explained(problem: &Problem, present: &Fit, best: &Fit) -> Vec<Explained> {
    // Errors without the scatter that a fit allows itself, as `belfry compare` shows them.
    let plain = |fit: &Fit| problem.state_without_scatter(&fit.state.effects).ok();
    let (plain_present, plain_best) = (plain(present), plain(best));
    let block_of = |fit: &Fit, measured: usize| -> (f64, Vec<(usize, f64)>) {
        fit.state.residual.block_of(measured).map_or((0.0, Vec::new()), |(first, block)| {
            (fit.state.modes.rows(first, block.size()).norm_squared(), sensor_squares(problem, block))
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
