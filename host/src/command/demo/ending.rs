//! The demo's last words: what was hidden, what the diagnosis said of it, and whether that was right.
//!
//! The truth, a diagnosis and the change that was made flow in; sentences flow out that are true whatever the outcome.

use serde::Serialize;

use crate::command::text::{p_is, short, unit_text, values_text};
use crate::diagnose::{CandidateReport, Diagnosis, FAILS, Verdict};
use crate::model::BeamTable;
use crate::model::effect::{Effect, Evidence, Where, find, named};
use crate::story::ChangeReport;

/// What was hidden, and the beam that it was hidden in.
pub(super) struct Hidden<'a> {
    pub(super) effect: &'a Effect,
    pub(super) beam: &'a BeamTable,
}

/// How the place that a diagnosis names lies to the true one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "place")]
pub(super) enum Likeness {
    /// The same place, or none is needed.
    Same,
    /// Another height of the same segment of the beam.
    SameSegment { bottom_m: f64, top_m: f64 },
    /// Nearly the same height.
    Near { off_m: f64 },
}

/// The demo's last words, and what they rest on.
#[derive(Debug, Serialize)]
pub(super) struct Ending {
    /// What the diagnosis named: the verdict's best effect.
    named: Option<String>,
    /// Whether that is what was hidden.
    right: bool,
    /// The place of what was hidden in the ranking, from 1; null where it is not in it.
    rank_of_hidden: Option<usize>,
    /// How the place that is ranked lies to the true one.
    #[serde(skip_serializing_if = "Option::is_none")]
    likeness: Option<Likeness>,
    /// What the demo added to the model.
    added: Option<String>,
    /// What it says.
    pub(super) sentences: Vec<String>,
}

/// A height is right when it is off by no more than this share of the tower's.
const NEAR_HEIGHT: f64 = 0.05;
/// A frequency is right when it is off by no more than this share.
const NEAR_FREQUENCY: f64 = 0.01;

impl Hidden<'_> {
    /// Whether a name is that of what was hidden: of its kind, at its channels or node, about its height or frequency.
    fn likeness(&self, name: &str) -> Option<Likeness> {
        let (kind, place) = named(name).ok()?;
        if kind != self.effect.of_kind() {
            return None;
        }
        match (self.effect.place(), &place) {
            (Some(Where::Height(hidden_m)), Some(Where::Height(found_m))) => {
                self.likeness_of_heights(*hidden_m, *found_m)
            }
            (Some(Where::Frequency(hidden_hz)), Some(Where::Frequency(found_hz))) => {
                ((found_hz / hidden_hz - 1.0).abs() <= NEAR_FREQUENCY).then_some(Likeness::Same)
            }
            (Some(Where::Channels(hidden)), Some(Where::Channels(found))) => {
                let sorted = |channels: &[String]| {
                    let mut channels = channels.to_vec();
                    channels.sort();
                    channels
                };
                (sorted(hidden) == sorted(found)).then_some(Likeness::Same)
            }
            (hidden, found) => (hidden == found.as_ref()).then_some(Likeness::Same),
        }
    }

    fn likeness_of_heights(&self, hidden_m: f64, found_m: f64) -> Option<Likeness> {
        if hidden_m == found_m {
            return Some(Likeness::Same);
        }
        let segments = self.beam.segments();
        let within = |z_m: f64, bottom_m: f64, top_m: f64| (bottom_m..=top_m).contains(&z_m);
        let same = segments.iter().find(|segment| {
            within(hidden_m, segment.z_bottom_m, segment.z_top_m)
                && within(found_m, segment.z_bottom_m, segment.z_top_m)
        });
        if let Some(segment) = same {
            return Some(Likeness::SameSegment { bottom_m: segment.z_bottom_m, top_m: segment.z_top_m });
        }
        let bottom_m = segments.first().map_or(0.0, |segment| segment.z_bottom_m);
        let top_m = segments.last().map_or(0.0, |segment| segment.z_top_m);
        let off_m = (hidden_m - found_m).abs();
        (off_m <= NEAR_HEIGHT * (top_m - bottom_m)).then_some(Likeness::Near { off_m })
    }
}

/// The effect that the demo adds: the one that is named; where none is, the one that explains most and gains 20 to 1.
pub(super) fn to_add(diagnosis: &Diagnosis) -> Option<String> {
    let named = diagnosis.best.first().cloned();
    named.or_else(|| ranked(diagnosis).next().map(CandidateReport::name))
}

/// Candidates that gain 20 to 1 with values that they can have, best first.
fn ranked(diagnosis: &Diagnosis) -> impl Iterator<Item = &CandidateReport> {
    diagnosis.candidates.iter().filter(|candidate| candidate.stands_out())
}

impl Ending {
    pub(super) fn of(hidden: &Hidden<'_>, diagnosis: &Diagnosis, added: Option<&ChangeReport>) -> Self {
        let named = diagnosis.best.first().cloned();
        let candidates: Vec<&CandidateReport> = ranked(diagnosis).collect();
        let found = candidates
            .iter()
            .enumerate()
            .find_map(|(index, candidate)| Some((index + 1, hidden.likeness(&candidate.name())?, *candidate)));
        let likeness_of_named = named.as_ref().and_then(|name| hidden.likeness(name));
        let mut sentences = vec![truth(hidden.effect)];
        sentences.push(match (diagnosis.verdict, &named) {
            (Verdict::Effect, Some(name)) => match likeness_of_named {
                Some(likeness) => format!("The diagnosis named {name}: right{}.", place_text(likeness)),
                None => format!("The diagnosis named {name}: wrong. {}", rank_text(found.as_ref())),
            },
            (Verdict::Ambiguous, Some(first)) => ambiguous(hidden, diagnosis, first, found.as_ref()),
            (Verdict::Adequate, _) => format!(
                "The diagnosis named no effect: the model explains this record without one ({}), so what was hidden lies within what measurement and model leave uncertain.",
                p_is(diagnosis.goodness_of_fit.p_value)
            ),
            _ => unknown(diagnosis, &candidates, found.as_ref()),
        });
        let added_name = added.map(|report| report.action.trim_start_matches("add ").to_owned());
        if let Some((_, _, candidate)) = &found {
            sentences.push(values(hidden.effect, candidate, added));
        }
        if let Some(report) = added {
            sentences.push(gain(report));
        }
        Self {
            right: likeness_of_named.is_some(),
            named,
            rank_of_hidden: found.as_ref().map(|(rank, ..)| *rank),
            likeness: likeness_of_named.or(found.map(|(_, likeness, _)| likeness)),
            added: added_name,
            sentences,
        }
    }
}

/// What the tower had.
fn truth(effect: &Effect) -> String {
    let values: Vec<String> = effect
        .parameters()
        .map(|(parameter, value)| format!("{} = {}{}", parameter.name, short(value), unit_text(parameter.unit)))
        .collect();
    let values = if values.is_empty() { String::new() } else { format!(", {}", values.join(", ")) };
    format!("The tower had {effect}{values}.")
}

/// How the place lies to the true one; nothing where it is the same.
fn place_text(likeness: Likeness) -> String {
    match likeness {
        Likeness::Same => String::new(),
        Likeness::SameSegment { bottom_m, top_m } => {
            format!(", in the same segment of the beam ({bottom_m} to {top_m} m)")
        }
        Likeness::Near { off_m } => format!(", {off_m:.0} m from the true height"),
    }
}

/// What was hidden, as the ranking has it.
type Found<'a> = (usize, Likeness, &'a CandidateReport);

/// Where what was hidden stands in the ranking.
fn rank_text(found: Option<&Found<'_>>) -> String {
    match found {
        Some((rank, likeness, candidate)) => format!(
            "What was hidden is number {rank} in its ranking, as {}{} (ln B = {:+.1}).",
            candidate.name(),
            place_text(*likeness),
            candidate.log_bayes_factor.unwrap_or(0.0)
        ),
        None => "What was hidden is not among the effects that it says gain 20 to 1.".to_owned(),
    }
}

/// A verdict that names several.
fn ambiguous(hidden: &Hidden<'_>, diagnosis: &Diagnosis, first: &str, found: Option<&Found<'_>>) -> String {
    let names: Vec<&str> = diagnosis.ambiguous.iter().flatten().map(String::as_str).collect();
    let others: Vec<&str> = names.iter().copied().filter(|name| *name != first).collect();
    let opening =
        format!("The diagnosis put {first} first and said that the data cannot tell it from {}", others.join(", "));
    match (hidden.likeness(first), others.iter().find_map(|name| Some((name, hidden.likeness(name)?)))) {
        (Some(likeness), _) => format!("{opening}: {first} is right{}.", place_text(likeness)),
        (None, Some((name, likeness))) => format!("{opening}: {name} is right{}.", place_text(likeness)),
        (None, None) => format!("{opening}: none of them is what was hidden. {}", rank_text(found)),
    }
}

/// A verdict that names none.
fn unknown(diagnosis: &Diagnosis, candidates: &[&CandidateReport], found: Option<&Found<'_>>) -> String {
    let Some(first) = candidates.first() else {
        return format!(
            "The diagnosis named no effect (verdict unknown): the model does not explain this record ({}), and no single effect gains 20 to 1.",
            p_is(diagnosis.present.p_value)
        );
    };
    let why = unknown_because(diagnosis, first);
    match found {
        Some((1, likeness, _)) => format!(
            "The diagnosis ranked {} first (ln B = {:+.1}), which is right{}. It still did not name it (verdict unknown): {why}.",
            first.name(),
            first.log_bayes_factor.unwrap_or(0.0),
            place_text(*likeness)
        ),
        _ => format!(
            "The diagnosis ranked {} first, which is wrong, but did not name it (verdict unknown): {why}. {}",
            first.name(),
            rank_text(found)
        ),
    }
}

/// Why the effect that explains most is not named.
fn unknown_because(diagnosis: &Diagnosis, first: &CandidateReport) -> String {
    let in_modes = find(&first.effect)
        .is_ok_and(|kind| matches!(kind.evidence(), Evidence::Modes | Evidence::Phases | Evidence::TwinPeaks));
    if !in_modes {
        return format!(
            "it shows outside the modes, and no effect explains what is wrong in them ({})",
            p_is(diagnosis.goodness_of_fit.p_value)
        );
    }
    if first.p_value >= FAILS {
        return format!("something else is more probable ({} with it)", p_is(first.p_value));
    }
    // What is left is that of the fit which was judged.
    let is_judged = diagnosis.goodness_of_fit.p_value == first.p_value;
    let worst = diagnosis.unexplained.by_mode.iter().max_by(|a, b| a.mean_square.total_cmp(&b.mean_square));
    let worst = worst.filter(|worst| is_judged && worst.mean_square > 1.0).map_or_else(String::new, |worst| {
        format!(
            "; mode {} at {:.4} Hz is off most, by {:.1} times the squared deviation that is allowed",
            worst.measured, worst.measured_hz, worst.mean_square
        )
    });
    format!("the record is not explained with it either ({}{worst})", p_is(first.p_value))
}

/// Fitted values beside the true ones: those of the model where the effect was added, else those of the diagnosis.
fn values(effect: &Effect, candidate: &CandidateReport, added: Option<&ChangeReport>) -> String {
    let in_model = added.and_then(|report| {
        report.effects.iter().find(|now| now.effect == candidate.effect && now.r#where == candidate.r#where)
    });
    let (whose, fitted) = match in_model {
        Some(now) => ("in the model", &now.parameters),
        None => ("by the diagnosis", &candidate.parameters),
    };
    if fitted.is_empty() {
        return "It has no value to be fitted: it is there or not.".to_owned();
    }
    let pair = |estimate: &crate::diagnose::Estimate| {
        let (_, true_value) = effect.parameters().find(|(parameter, _)| parameter.name == estimate.name)?;
        let off = estimate.std.filter(|std| *std > 0.0).map_or_else(String::new, |std| {
            format!(" ({:.1} standard deviations off)", (estimate.value - true_value).abs() / std)
        });
        let std = estimate.std.map_or_else(String::new, |std| format!(" ± {}", short(std)));
        let unit = unit_text(&estimate.unit);
        Some(format!(
            "{} fitted {}{std}{unit}, true {}{unit}{off}",
            estimate.name,
            short(estimate.value),
            short(true_value)
        ))
    };
    let pairs: Option<Vec<String>> = fitted.iter().map(pair).collect();
    match pairs {
        Some(pairs) => format!("Its value {whose}: {}.", pairs.join("; ")),
        None => format!("Its value {whose}: {}.", values_text(fitted).replace('\n', ", ")),
    }
}

/// What adding it did to the error.
fn gain(report: &ChangeReport) -> String {
    let mean = |comparison: &crate::compare::Comparison| comparison.mean_abs_frequency_error_percent;
    match (mean(&report.before), mean(&report.after)) {
        (Some(before), Some(after)) if after < before => {
            format!("With what was added, the mean frequency error of the model fell from {before:.2} to {after:.2} %.")
        }
        (Some(before), Some(after)) => format!(
            "With what was added, the mean frequency error of the model did not fall ({before:.2} % before, {after:.2} % after): what it explains is in the shapes, or outside the modes."
        ),
        _ => "With what was added, no frequency can be compared before and after.".to_owned(),
    }
}

#[cfg(test)]
#[path = "ending_tests.rs"]
mod tests;
