//! What has changed in a structure since an earlier measurement.
//!
//! A model, the modes before and the modes now flow in; which effect has come, or gone, flows out. First the model is fitted to the
//! measurement before, with its effects and within its tolerance. That model then meets modes that have moved from its own as the
//! measured ones have, with the deviations of both measurements. So what the model has wrong is wrong before and now, and cancels to first
//! order.
//!
//! Between two states of one structure segments do not scatter anew: it was built once. So they have no tolerance here, and
//! nothing but an effect explains a change. A wrong model predicts a change wrongly by a share. What it misses of a change is a
//! [`Discrepancy`] whose size the evidence settles, for each effect and for a change that no effect makes; only a structure that has not
//! changed has none.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::candidates::Options;
use super::criteria::{FAILS, STANDS_OUT};
use super::discrepancy::{Discrepancy, here};
use super::error::DiagnoseError;
use super::fit::Fit;
use super::posterior::Hypothesis;
use super::problem::Problem;
use super::report::{CandidateReport, Diagnosis, GoodnessOfFit, Verdict};
use super::search::Searched;
use super::steps::Setting;
use super::verdict::{Weighed, rejected_report};
use crate::change::{Difference, differences};
use crate::model::effect::{Effect, Evidence, KINDS};
use crate::modes::{MeasuredMode, StatedMode};
use crate::study::Model;

/// What has happened to the structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChangeVerdict {
    /// Most probably nothing.
    Unchanged,
    /// One effect is the most probable.
    Effect,
    /// Several effects explain the change alike.
    Ambiguous,
    /// Something has changed that is no single effect of the catalogue.
    Unknown,
}

/// Whether an effect is there now and was not before, or the other way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// It has come.
    Come,
    /// It was there before and is gone.
    Gone,
}

/// What is no candidate; with the candidates' probabilities they sum to one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChangeProbabilities {
    /// That nothing has changed.
    pub unchanged: f64,
    /// That what has changed is no single effect of the catalogue.
    pub something_else: f64,
}

/// What the named effect makes of a mode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Predicted {
    /// Number of the mode now.
    pub now: usize,
    /// The measured change of its frequency.
    pub change_percent: f64,
    /// What the effect makes of it; null where no effect is named.
    pub predicted_percent: Option<f64>,
}

/// What has changed, by a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChangeDiagnosis {
    /// What is most probable.
    pub verdict: ChangeVerdict,
    /// Whether the effects have come or gone.
    pub direction: Direction,
    /// The name of the effect that explains the change best; empty where none does.
    pub best: Vec<String>,
    /// Sets of names that the data cannot tell apart.
    pub ambiguous: Vec<Vec<String>>,
    /// That nothing has changed, or something that is no candidate.
    pub probabilities: ChangeProbabilities,
    /// Kinds that explain something of the change, each at its best place, best first.
    pub candidates: Vec<CandidateReport>,
    /// What the model missed before the change, its effects and segments fitted.
    pub model_before: GoodnessOfFit,
    /// With the named effect, or without one.
    pub goodness_of_fit: GoodnessOfFit,
    /// What the model misses of the change, as standard deviations.
    pub discrepancy: Discrepancy,
    /// The change of each frequency beside that of the named effect.
    pub predicted: Vec<Predicted>,
    /// The measurement that would settle what is open.
    pub next_measurement: Option<String>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// What a table of a tower may lack from the start, and no structure gets in service: its weight and its sections stay what they were, and so
/// do the axes of the drawing.
const NEVER_COMES: [&str; 4] = ["p-delta", "rotary-inertia", "axis-rotation", "foundation-mass"];
/// Odds of a change that is no effect of the catalogue, which the model misses as a discrepancy: as likely as most effects.
const OTHERWISE: f64 = 1.0;

/// What has changed from the modes of `setting` to those of `now`, where `p_value` is the probability of as much difference by the errors of
/// both measurements alone. The model has `effects`; kinds in `options` are left out.
///
/// What has gone comes from now to before, so it is looked for that way round. Both ways round the evidence is that over the same differences
/// without a cause.
///
/// # Errors
/// [`DiagnoseError`] where the model cannot be fitted to one of the measurements, or they have no mode in common.
pub fn diagnose_change(
    setting: &Setting<'_>,
    effects: &[Effect],
    now: &[MeasuredMode],
    p_value: f64,
    options: &Options,
) -> Result<ChangeDiagnosis, DiagnoseError> {
    let mut options = options.clone();
    let never = |name: &str, evidence: Evidence| {
        NEVER_COMES.contains(&name) || !matches!(evidence, Evidence::Modes | Evidence::Phases)
    };
    let kinds = KINDS.iter().filter(|kind| never(kind.name(), kind.evidence()));
    options.without.extend(kinds.map(|kind| kind.name().to_owned()));
    let mut come = one_way(setting, effects, now, p_value, &options)?;
    if come.verdict == ChangeVerdict::Unchanged && p_value >= FAILS {
        return Ok(come);
    }
    let back = Setting { measured: now, ..*setting };
    let Ok(gone) = one_way(&back, effects, setting.measured, p_value, &options) else { return Ok(come) };
    let mut gone = gone.turned();
    let ahead = gone.log_odds() - come.log_odds();
    let alike = |one: &ChangeDiagnosis, other: &ChangeDiagnosis| {
        let kind = |diagnosis: &ChangeDiagnosis| diagnosis.candidates.first().map(|candidate| candidate.effect.clone());
        let name = other.best.first().filter(|_| kind(one) != kind(other) && ahead.abs() < STANDS_OUT)?;
        let how = if other.direction == Direction::Come { "had it come" } else { "had it been there before and gone" };
        Some(format!("{name} would explain the change as well, {how}"))
    };
    // What can be more or less, such as a mass as a whole, explains the same both ways round: it has come.
    if !gone.best.is_empty() && ahead > BOTH_WAYS {
        gone.warnings.extend(alike(&gone, &come));
        return Ok(gone);
    }
    come.warnings.extend(alike(&come, &gone));
    Ok(come)
}

/// Evidence (ln) by which what has gone must be ahead of what has come.
const BOTH_WAYS: f64 = 1.0;

impl ChangeDiagnosis {
    /// Logarithm of the odds of the best candidate over those that nothing has changed.
    fn log_odds(&self) -> f64 {
        let of = |candidate: &CandidateReport| {
            let odds = candidate.prior_odds.filter(|_| candidate.probability > Some(0.0))?;
            Some(odds.ln() + candidate.log_bayes_factor?)
        };
        self.candidates.iter().filter_map(of).fold(f64::NEG_INFINITY, f64::max)
    }

    /// What has come from now to before has gone from before to now.
    fn turned(mut self) -> Self {
        let back = |percent: f64| 100.0 * ((1.0 + percent / 100.0).recip() - 1.0);
        for mode in &mut self.predicted {
            mode.change_percent = back(mode.change_percent);
            mode.predicted_percent = mode.predicted_percent.map(back);
        }
        self.direction = match self.direction {
            Direction::Come => Direction::Gone,
            Direction::Gone => Direction::Come,
        };
        self
    }
}

/// What has come from the modes of `setting` to those of `now`.
fn one_way(
    setting: &Setting<'_>,
    effects: &[Effect],
    now: &[MeasuredMode],
    p_value: f64,
    options: &Options,
) -> Result<ChangeDiagnosis, DiagnoseError> {
    let (before, fitted) = setting.problem(effects)?.fit_settled(effects)?;
    let problem = changed(setting, &before, &fitted, now)?;
    let present = problem.fit_present(&[])?;
    let Searched { settled, own, found, rejected } = problem.search(&present, options);
    let (searched, searched_present) = here(&settled, &problem, &present);
    let otherwise = own.as_ref().map_or(searched_present, |(_, fit)| fit);
    let unchanged = Hypothesis {
        prior_odds: problem.prior_odds.adequate(),
        log_bayes_factor: present.log_evidence() - otherwise.log_evidence(),
        p_value,
    };
    let otherwise =
        Hypothesis { prior_odds: OTHERWISE, log_bayes_factor: 0.0, p_value: otherwise.goodness_of_fit().p_value };
    // Where the test of all differences sees no change, nothing but an effect, which gathers what is spread over hundreds of numbers, can show
    // one.
    let is_seen = p_value < FAILS;
    let without = if is_seen { &[unchanged, otherwise][..] } else { &[unchanged] };
    let weighed = Weighed::of(searched, searched_present, without, &found, &[]);
    let mut diagnosis = weighed.told(searched, searched_present);
    diagnosis.candidates.extend(rejected.iter().map(|one| rejected_report(searched_present, one)));
    // The evidence is stated over that of no change.
    for evidence in diagnosis.candidates.iter_mut().filter_map(|candidate| candidate.log_bayes_factor.as_mut()) {
        *evidence -= unchanged.log_bayes_factor;
    }
    Ok(of_change(diagnosis, fitted.goodness_of_fit().into()))
}

/// The problem of the change: the model as it was fitted to the measurement before, and the modes that it would have, had they moved as the
/// measured ones have.
fn changed(
    setting: &Setting<'_>,
    before: &Problem,
    fitted: &Fit,
    now: &[MeasuredMode],
) -> Result<Problem, DiagnoseError> {
    let differences = differences(setting.measured, now);
    let mass = &fitted.state.model.assembly.mass;
    let moved = differences.iter().filter_map(|one| {
        let mode = moved_with(setting.measured, before, fitted, one, now)?;
        let is_known = mode.shape.is_some() || mode.stated.is_some();
        // Where no shape says which mode of the model it is, the mode before does.
        let stated = || {
            let (_, block) = fitted.state.residual.block_of(place(setting.measured, before, one.before)?)?;
            StatedMode::in_model(block.model, mass, &fitted.state.model.view.modes)
        };
        Some(if is_known { mode } else { MeasuredMode { stated: stated(), ..mode } })
    });
    let moved: Vec<MeasuredMode> = moved.collect();
    let model =
        Model { background_stiffness: None, background_mass: None, effects: Vec::new(), ..setting.model.clone() };
    let structure = fitted.state.model.structure.clone().with_trusted_groups();
    let mut problem = Problem::new(structure, &[], &model, setting.sensors, &moved)?;
    problem.lacks_tolerance = false;
    // What a table has wrong it had wrong before.
    problem.stiffness_known_to = 0.0;
    Ok(problem)
}

/// Where a measured mode stands in the problem before.
fn place(measured: &[MeasuredMode], before: &Problem, index: usize) -> Option<usize> {
    before.measured().iter().position(|mode| mode.number == measured[index].number)
}

/// A mode as the fitted model would show it now; `None` where the mode before has no partner in the model.
fn moved_with(
    measured: &[MeasuredMode],
    before: &Problem,
    fitted: &Fit,
    difference: &Difference,
    now: &[MeasuredMode],
) -> Option<MeasuredMode> {
    let place = |index: usize| place(measured, before, index);
    let frequency_hz = fitted.state.frequency_of(place(difference.before)?)?;
    let spanned_by = difference.shape.iter().flat_map(|shape| &shape.spanned_by);
    let image = |(index, mode): &(usize, MeasuredMode)| {
        let shape = mode.shape.as_ref()?;
        let partner = place(*index).and_then(|place| fitted.state.residual.block_of(place));
        // A close mode without a partner in the model stays as it was measured.
        let Some((_, block)) = partner else { return Some(shape.values.clone()) };
        let models = block.shape.as_ref().map_or(vec![block.model], |shape| shape.models.clone());
        nearest(&fitted.state.model.view.at_sensors.select_rows(&shape.sensors).select_columns(&models), &shape.values)
    };
    let images: Vec<DVector<f64>> = spanned_by.filter_map(image).collect();
    Some(difference.moved_from(&now[difference.now], frequency_hz, &images))
}

/// The combination of columns that is nearest to a vector.
fn nearest(columns: &DMatrix<f64>, vector: &DVector<f64>) -> Option<DVector<f64>> {
    let combination = columns.clone().svd(true, true).solve(vector, SINGULAR).ok()?;
    Some(columns * combination)
}

/// Combinations of the model's shapes that move sensors by less are not used.
const SINGULAR: f64 = 1e-9;

/// A diagnosis of the problem of a change, in the words of a change.
fn of_change(diagnosis: Diagnosis, model_before: GoodnessOfFit) -> ChangeDiagnosis {
    let verdict = match diagnosis.verdict {
        Verdict::Adequate => ChangeVerdict::Unchanged,
        Verdict::Effect => ChangeVerdict::Effect,
        Verdict::Ambiguous => ChangeVerdict::Ambiguous,
        Verdict::Unknown => ChangeVerdict::Unknown,
    };
    let is_named = !diagnosis.best.is_empty();
    let predicted = diagnosis.explained.iter().filter_map(|mode| {
        // The model before, and with the effect, against the mode now.
        let share = |percent: f64| 1.0 + percent / 100.0;
        let before = share(mode.before_percent?);
        Some(Predicted {
            now: mode.measured,
            change_percent: 100.0 * (before.recip() - 1.0),
            predicted_percent: mode
                .after_percent
                .filter(|_| is_named)
                .map(|after| 100.0 * (share(after) / before - 1.0)),
        })
    });
    ChangeDiagnosis {
        verdict,
        direction: Direction::Come,
        predicted: predicted.collect(),
        best: diagnosis.best,
        ambiguous: diagnosis.ambiguous,
        probabilities: ChangeProbabilities {
            unchanged: diagnosis.probabilities.adequate,
            something_else: diagnosis.probabilities.something_else,
        },
        candidates: diagnosis.candidates,
        model_before,
        goodness_of_fit: diagnosis.goodness_of_fit,
        discrepancy: diagnosis.discrepancy,
        next_measurement: diagnosis.next_measurement,
        warnings: diagnosis.warnings,
    }
}
