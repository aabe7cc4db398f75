//! The set of effects that explains most where no single one does, in words.

use super::Console;
use super::diagnose::{cells, tell_unexplained};
use super::text::{Columns, p_is};
use crate::diagnose::{FAILS, PartialAnswer, PartialEffect};

/// Tells of a partial answer, and of what it leaves.
pub(super) fn tell(partial: &PartialAnswer, console: &Console) {
    let (before, after) = (partial.before, partial.after);
    let which = match partial.effects.len() {
        1 => "this effect explains most, and no other is called for beside it".to_owned(),
        count => format!("these {count} effects together explain most"),
    };
    console.say(format!(
        "A lead, not a finding: {which}. Chi-squared {:.0} -> {:.0} over {} numbers ({}), frequency error {:.2} % -> {:.2} %.",
        before.chi_squared,
        after.chi_squared,
        after.degrees_of_freedom,
        p_is(after.p_value),
        partial.mean_abs_frequency_error_percent_before,
        partial.mean_abs_frequency_error_percent_after
    ));
    let mut table = Columns::new(["effect", "value", "probability", "chi-squared without", "next best in its place"]);
    for effect in &partial.effects {
        let [name, values, probable] = cells(effect.name(), effect.where_std_m, &effect.parameters, effect.probability);
        table.row([name, values, probable, format!("{:.0}", effect.chi_squared_without), instead_text(effect)]);
    }
    console.say(table);
    let beside = if partial.effects.len() > 1 { " the others are right and" } else { "" };
    console.say(format!(
        "Each probability holds if{beside} nothing outside the catalogue is missing. ln B is the evidence of what is next best over that of the effect."
    ));
    if after.p_value < FAILS {
        console.say("What is left:");
        tell_unexplained(&partial.unexplained, console);
    }
    if let Some(next) = &partial.next_measurement {
        console.say(format!("To settle the least sure of them, measure: {next}."));
    }
}

/// The other kind that does best in the place of an effect, and how much less it explains.
fn instead_text(effect: &PartialEffect) -> String {
    effect
        .instead
        .as_ref()
        .map_or_else(|| "-".to_owned(), |other| format!("{}\nln B {:+.1}", other.effect, -other.log_evidence_below))
}
