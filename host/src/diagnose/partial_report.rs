//! A partial answer as it is printed and stored: the set of effects that explains most, how sure each is, and what would decide.

use serde::Serialize;

use super::fit::{Estimate, Fit};
use super::partial::{Member, Set};
use super::problem::Problem;
use super::report::{GoodnessOfFit, NearPlace, Unexplained, name};
use super::settle::next_measurement;
use super::verdict::{error_percent, height_report, unexplained};

/// The small set of effects that explains most of what no single one explains: a lead, no finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartialAnswer {
    /// The effects, the one whose absence costs most first; fitted together.
    pub effects: Vec<PartialEffect>,
    /// The model as it is, with what is then taken to be missed besides.
    pub before: GoodnessOfFit,
    /// The model with all of them.
    pub after: GoodnessOfFit,
    /// Mean absolute frequency error of the model as it is, no segment adjusted.
    pub mean_abs_frequency_error_percent_before: f64,
    /// The same with the effects.
    pub mean_abs_frequency_error_percent_after: f64,
    /// What they leave.
    pub unexplained: Unexplained,
    /// What would tell the least sure of them from what does best in its place.
    pub next_measurement: Option<String>,
}

/// An effect of the set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartialEffect {
    /// The kind.
    pub effect: String,
    /// The part after the @.
    pub r#where: Option<String>,
    /// Its values.
    pub parameters: Vec<Estimate>,
    /// Standard deviation of its height in m, where that was fitted.
    pub where_std_m: Option<f64>,
    /// Other places that do nearly as well.
    pub near: Vec<NearPlace>,
    /// Natural logarithm of the evidence for it over that of the set without it.
    pub log_bayes_factor: f64,
    /// Probability that it is there, were the others there and nothing that is no kind of the catalogue: against none and other kinds.
    pub probability: f64,
    /// Chi-squared of the set without it.
    pub chi_squared_without: f64,
    /// What does best in its place; null where nothing comes near it.
    pub instead: Option<Instead>,
}

/// An effect in the place of another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Instead {
    /// `kind` or `kind@where`.
    pub effect: String,
    /// By how much its evidence is less than that of the one that it replaces, as a natural logarithm.
    pub log_evidence_below: f64,
}

/// Errors that differ by less than this share are the same, to rounding.
const SAME: f64 = 1e-9;

impl PartialEffect {
    /// `kind` or `kind@where`.
    pub fn name(&self) -> String {
        name(&self.effect, self.r#where.as_deref())
    }
}

impl PartialAnswer {
    /// The effect that another in its place is nearest to, and that other.
    pub fn least_sure(&self) -> Option<(&PartialEffect, &Instead)> {
        let with_rival = self.effects.iter().filter_map(|effect| Some((effect, effect.instead.as_ref()?)));
        with_rival.min_by(|a, b| a.1.log_evidence_below.total_cmp(&b.1.log_evidence_below))
    }

    /// Whether frequencies are no further off with the set; faults of sensors leave them where they are.
    pub(super) fn brings_nearer(&self) -> bool {
        let (before, after) =
            (self.mean_abs_frequency_error_percent_before, self.mean_abs_frequency_error_percent_after);
        after <= before * (1.0 + SAME)
    }

    pub(super) fn of(set: &Set) -> Self {
        let Set { problem, present, fit, members } = set;
        let mut answer = Self {
            effects: members.iter().map(|member| effect(problem, member)).collect(),
            before: present.goodness_of_fit().into(),
            after: fit.goodness_of_fit().into(),
            mean_abs_frequency_error_percent_before: frequency_error_percent(problem, present),
            mean_abs_frequency_error_percent_after: frequency_error_percent(problem, fit),
            unexplained: unexplained(problem, fit),
            next_measurement: None,
        };
        let least_sure = answer.least_sure().map(|(least_sure, _)| least_sure.name());
        let member = members.iter().find(|member| Some(member.found.effect().to_string()) == least_sure);
        answer.next_measurement = member.and_then(|Member { found, instead, .. }| {
            let rival = instead.as_ref()?;
            Some(next_measurement(problem, (found.kind, &found.fit), (rival.kind, &rival.fit)))
        });
        answer
    }
}

fn effect(problem: &Problem, member: &Member) -> PartialEffect {
    let Member { found, without_chi_squared, instead, .. } = member;
    let report = height_report(found, &found.fit);
    PartialEffect {
        effect: report.effect,
        r#where: report.r#where,
        parameters: report.parameters,
        where_std_m: report.where_std_m,
        near: report.near,
        log_bayes_factor: found.log_bayes_factor,
        probability: member.probability(problem),
        chi_squared_without: *without_chi_squared,
        instead: instead.as_ref().map(|other| Instead {
            effect: other.effect().to_string(),
            log_evidence_below: found.log_bayes_factor - other.log_bayes_factor,
        }),
    }
}

/// Of a fit's effects, no segment adjusted.
fn frequency_error_percent(problem: &Problem, fit: &Fit) -> f64 {
    let Ok(state) = problem.state_without_scatter(fit.effects()) else { return f64::NAN };
    let error = |(index, mode): (usize, &crate::modes::MeasuredMode)| {
        Some(error_percent(state.frequency_of(index)?, mode).abs())
    };
    let errors: Vec<f64> = problem.measured().iter().enumerate().filter_map(error).collect();
    errors.iter().sum::<f64>() / errors.len().max(1) as f64
}
