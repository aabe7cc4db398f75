//! What `add`, `remove` and the demo tell of a change: the effects now, and the model before and after.

use super::Console;
use super::text::{Columns, in_shell, mac_text, next_lines, or_dash, p_is, values_text};
use crate::compare::Comparison;
use crate::diagnose::STANDS_OUT;
use crate::diagnose::steps::StepRecord;
use crate::numbers::signed;
use crate::story::ChangeReport;
use crate::study::{STUDY_FILE, Study};

/// Tells of a change, and what comes next.
pub(super) fn tell(report: &ChangeReport, study: &Study, console: &Console) {
    tell_change(report, study, console);
    let folder = in_shell(&study.folder);
    console.say(next_lines(&[
        (format!("diagnose {folder}"), "is anything else missing?"),
        (format!("history {folder}"), "how the error fell, step by step"),
    ]));
}

/// Tells of a change.
pub(super) fn tell_change(report: &ChangeReport, study: &Study, console: &Console) {
    console.say(format!("\n{}: {}", study.structure.name, report.action));
    if report.effects.is_empty() {
        console.say("The model has no effects now; it is the model as first given.");
    }
    for effect in &report.effects {
        let place = effect.r#where.as_ref().map_or_else(String::new, |place| format!("@{place}"));
        let values = values_text(&effect.parameters).replace('\n', ", ");
        console.say(format!("  {}{place}   {values}", effect.effect));
    }
    console.detail(before_and_after(&report.before, &report.after));
    let change = |before: Option<f64>, after: Option<f64>, unit: &str| {
        format!("{}{unit} -> {}{unit}", or_dash(before, 2), or_dash(after, 2))
    };
    let (now, before) = (&report.step, report.previous.as_ref());
    console.say(format!(
        "Mean frequency error {}, chi-squared {} over {} numbers ({}).",
        change(report.before.mean_abs_frequency_error_percent, report.after.mean_abs_frequency_error_percent, " %"),
        change(before.map(|step| step.chi_squared), Some(now.chi_squared), ""),
        now.degrees_of_freedom,
        p_is(now.p_value)
    ));
    if now.held_out_error_percent.is_some() || now.held_out_mode_error_percent.is_some() {
        console.say(format!(
            "Predicted while left out: sensors {}, frequencies {}.",
            change(before.and_then(|step| step.held_out_error_percent), now.held_out_error_percent, " %"),
            change(before.and_then(|step| step.held_out_mode_error_percent), now.held_out_mode_error_percent, " %")
        ));
    }
    now.joint.iter().flat_map(|joint| joint.in_words()).for_each(|sentence| console.say(sentence + "."));
    if let Some(gain) = now.log_bayes_factor {
        console.say(gain_text(gain, now, study));
    }
    console.say(format!("Written into {}.", study.folder.join(STUDY_FILE).display()));
}

/// How a step that took an effect out begins.
const REMOVED: &str = "remove ";

/// Whether a step was worth it.
fn gain_text(gain: f64, step: &StepRecord, study: &Study) -> String {
    let study = in_shell(&study.folder);
    let last = step.effects.last().cloned().unwrap_or_default();
    if step.action.starts_with(REMOVED) {
        return match gain > -STANDS_OUT {
            true => format!("The data do not support it (ln B = {gain:+.1} without it)."),
            false => format!("The data support it: without it, ln B = {gain:+.1}."),
        };
    }
    if gain > STANDS_OUT {
        format!("It helps: the evidence rises by ln B = {gain:+.1}.")
    } else if gain > 0.0 {
        format!("It gains less than 20 to 1 (ln B = {gain:+.1}): the data do not support it.")
    } else {
        format!("It gains nothing (ln B = {gain:+.1}); `belfry remove {study} {last}` takes it out again.")
    }
}

fn before_and_after(before: &Comparison, after: &Comparison) -> Columns {
    let mut table = Columns::new(["mode", "measured Hz", "error % before", "after", "MAC before", "after"]);
    for pair in &after.pairs {
        let old = before.pairs.iter().find(|old| old.measured == pair.measured);
        table.row([
            pair.measured.to_string(),
            format!("{:.4}", pair.measured_hz),
            old.map_or_else(|| "-".to_owned(), |old| signed(old.frequency_error_percent, 2)),
            signed(pair.frequency_error_percent, 2),
            mac_text(old.and_then(|old| old.mac), 4),
            mac_text(pair.mac, 4),
        ]);
    }
    table
}
