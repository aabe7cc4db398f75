//! `belfry diagnose`: which physical effect the model lacks.

use std::path::PathBuf;

use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};

use super::Console;
use super::case::{Case, write_json};
use super::identify::align_right;
use super::steps::{append_history, entries, starting_record};
use crate::diagnose::steps::{Step, StepRecord};
use crate::diagnose::{CandidateReport, Diagnosis, Estimate, FAILS, Options, Part, Verdict, diagnose};
use crate::model::effect::{self, Evidence};
use crate::study::edit::set_effects;

const EXAMPLES: &str = "Examples:
  belfry diagnose canton                       after `belfry identify canton`
  belfry diagnose canton --auto                adds and drops effects until nothing is gained
  belfry diagnose canton --without p-delta     as if an effect were not in the catalogue
  belfry diagnose canton --json

Every effect of the catalogue (belfry effects), at every height, channel or node, is scored by how much of the difference
between model and measurement it explains beyond what measurement noise and the model's own tolerance (background_stiffness
and background_mass in [model]) allow. The best are refitted. ln B is the logarithm of the evidence over the present model:
3 is 20 to 1. p is the probability of as much misfit as is left, were the effect all that is missing.
Writes diagnosis.json into `results`. With --auto the best effect is added, those that it makes needless are dropped, and so
on until nothing gains 20 to 1; study.toml and the history change as by `belfry add`, and what is printed is the final state.";

/// Rank the physical effects that the model could lack
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Leave a kind of effect out; repeat for more
    #[arg(long, value_name = "KIND", value_parser = kind)]
    pub without: Vec<String>,
    /// Add and drop effects until nothing is gained
    #[arg(long)]
    pub auto: bool,
}

/// The name of a kind.
fn kind(text: &str) -> Result<String, String> {
    effect::find(text).map(|kind| kind.name().to_owned()).map_err(|error| error.to_string())
}

/// Runs the command.
///
/// # Errors
/// When the study, its model or its modes cannot be read, or do not go together.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let case = Case::load(&arguments.study, console)?;
    let case = if arguments.auto { auto(case, &arguments.without, console)? } else { case };
    let diagnosis = diagnose_case(&case, &arguments.without, arguments.auto, console)?;
    if arguments.auto && diagnosis.verdict != Verdict::Unknown {
        let study = case.study.folder.display();
        console.say(format!("      belfry history {study}     how the error fell, step by step"));
    }
    console.json(&diagnosis)
}

/// Adds and drops effects until nothing is gained; the study as it is then.
pub(super) fn auto(case: Case, without: &[String], console: &Console) -> anyhow::Result<Case> {
    let mut records: Vec<StepRecord> = starting_record(&case)?.into_iter().collect();
    let options = Options { without: without.to_vec() };
    let mut last = None;
    let mut tell = |step: &Step| {
        let record = &step.record;
        console.say(format!(
            "{}: chi-squared {:.0} over {} numbers, frequency error {:.2} %",
            step.action, record.chi_squared, record.degrees_of_freedom, record.mean_abs_frequency_error_percent
        ));
        records.push(record.clone());
        last = Some((entries(&step.effects), record.p_value));
    };
    case.setting()?.auto(&case.model.effects, &case.signals()?, &options, &mut tell)?;
    let Some((entries, p_value)) = last else {
        console.say("No effect gains 20 to 1; the model stays as it is.");
        append_history(&case, &records)?;
        return Ok(case);
    };
    if case.measured.modes.iter().all(|mode| mode.shape.is_none()) {
        console.warn(
            "frequencies alone do not say which mode is which, let alone several effects; nothing was added. `belfry add` puts one in all the same",
        );
        return Ok(case);
    }
    if p_value < FAILS {
        // Effects that together explain too little are made up as likely as not.
        console.warn(format!(
            "these effects do not explain the measurement ({}); nothing was added. `belfry add` puts one in all the same",
            p_is(p_value)
        ));
        return Ok(case);
    }
    set_effects(&case.study.folder, &entries)?;
    append_history(&case, &records)?;
    Case::load(&case.study.folder.clone(), console)
}

/// Diagnoses, tells and stores.
pub(super) fn diagnose_case(
    case: &Case,
    without: &[String],
    auto: bool,
    console: &Console,
) -> anyhow::Result<Diagnosis> {
    let options = Options { without: without.to_vec() };
    let diagnosis = {
        let effects = &case.model.effects;
        diagnose(&case.setting()?.problem(effects)?, effects, &case.signals()?, &options)?
    };
    tell(&diagnosis, auto, case, console);
    for warning in &diagnosis.warnings {
        console.warn(warning);
    }
    write_json(&case.study, "diagnosis.json", &diagnosis)?;
    Ok(diagnosis)
}

/// Candidates in the table, of which the first few are always shown.
const SHOWN: usize = 8;
const ALWAYS: usize = 3;

/// Candidates that gain, and those that are named.
fn shown(diagnosis: &Diagnosis) -> Vec<&CandidateReport> {
    let is_named = |candidate: &CandidateReport| {
        diagnosis.best.iter().chain(diagnosis.ambiguous.iter().flatten()).any(|name| *name == candidate.name())
    };
    let gains = |candidate: &CandidateReport| candidate.log_bayes_factor.is_some_and(|gain| gain > 0.0);
    let candidates = diagnosis.candidates.iter().filter(|candidate| candidate.admissible).enumerate();
    candidates
        .filter(|(index, candidate)| *index < ALWAYS || is_named(candidate) || (*index < SHOWN && gains(candidate)))
        .map(|(_, candidate)| candidate)
        .collect()
}

/// Whether what an effect leaves is counted in modes.
fn in_modes(candidate: &CandidateReport) -> bool {
    effect::find(&candidate.effect)
        .is_ok_and(|kind| matches!(kind.evidence(), Evidence::Modes | Evidence::Phases | Evidence::TwinPeaks))
}

fn tell(diagnosis: &Diagnosis, auto: bool, case: &Case, console: &Console) {
    let effects = case.effect_names();
    let with = if effects.is_empty() { String::new() } else { format!(", with {}", effects.join(", ")) };
    console.say(format!("\n{}: which effect does the model{with} lack?", case.study.structure.name));
    let test = diagnosis.present;
    console.say(format!(
        "The model as it is: chi-squared {:.0} over {} numbers, {}{}.",
        test.chi_squared,
        test.degrees_of_freedom,
        p_is(test.p_value),
        if test.p_value < FAILS { worst_text(test.worst) } else { "" }
    ));
    if !diagnosis.candidates.is_empty() {
        let mut table = Table::new();
        table.load_style(UTF8_FULL_CONDENSED);
        table.set_header(vec!["effect", "value", "ln B", "chi-squared left", "p"]);
        for candidate in shown(diagnosis) {
            let place_std = candidate.where_std_m.map_or_else(String::new, |std| format!("\n± {} m", short(std)));
            table.add_row(vec![
                candidate.name() + &place_std,
                values_text(&candidate.parameters),
                candidate.log_bayes_factor.map_or_else(|| "-".to_owned(), |gain| format!("{gain:+.1}")),
                if in_modes(candidate) { format!("{:.0}", candidate.chi_squared) } else { "-".to_owned() },
                p_text(candidate.p_value),
            ]);
        }
        align_right(&mut table, 5);
        console.say(table);
        for candidate in diagnosis.candidates.iter().filter(|candidate| !candidate.admissible) {
            console.say(format!(
                "{} would need a value that it cannot have ({}).",
                candidate.name(),
                values_text(&candidate.parameters)
            ));
        }
        let admissible = diagnosis.candidates.iter().filter(|candidate| candidate.admissible).count();
        let others = admissible - shown(diagnosis).len();
        if others > 0 {
            console.say(format!("{others} more gain less, or nothing; --json lists them."));
        }
    }
    tell_verdict(diagnosis, auto, case, console);
}

fn tell_verdict(diagnosis: &Diagnosis, auto: bool, case: &Case, console: &Console) {
    let study = case.study.folder.display();
    let best = diagnosis.best.first().cloned().unwrap_or_default();
    match diagnosis.verdict {
        Verdict::Adequate => {
            console.say("Verdict: adequate. The model explains the measurement within its tolerance, and no effect gains 20 to 1.");
        }
        Verdict::Effect => {
            match &diagnosis.reason {
                Some(reason) => console.say(format!("Verdict: {best}: {reason}.")),
                None => console.say(format!("Verdict: {best}. It explains what the model does not.")),
            }
            tell_near(diagnosis, console);
            tell_explained(diagnosis, console);
        }
        Verdict::Ambiguous => {
            let names = diagnosis.ambiguous.iter().flatten().cloned().collect::<Vec<_>>().join(", ");
            console.say(format!("Verdict: ambiguous. The data cannot tell these apart: {names}."));
            tell_explained(diagnosis, console);
        }
        Verdict::Unknown => {
            console.say(
                "Verdict: unknown. No single effect of the catalogue explains the measurement; what the best of them leaves:",
            );
            tell_unexplained(diagnosis, console);
        }
    }
    if let Some(next) = &diagnosis.next_measurement {
        console.say(format!("To settle it, measure: {next}."));
    }
    match diagnosis.verdict {
        Verdict::Adequate => {
            console.say(format!("Next: belfry covalidate {study}    predicts sensors that it is not shown"));
        }
        Verdict::Effect => {
            console.say(format!("Next: belfry add {study} {best}    puts it into the model and refits"));
        }
        Verdict::Ambiguous => {
            let adds = diagnosis.ambiguous.iter().flatten().map(|name| format!("belfry add {study} {name}"));
            console.say(format!(
                "Next: measure that; or decide by what you know of the structure: {}",
                adds.collect::<Vec<_>>().join(", or ")
            ));
        }
        Verdict::Unknown => {
            if auto {
                console.say(format!("Next: belfry compare {study}    shows where it fails; a hypothesis of your own can be tried as [[model.custom]]"));
            } else {
                console.say(format!(
                    "Next: belfry diagnose {study} --auto    looks for several effects, one after the other"
                ));
            }
        }
    }
}

/// What a probability is of, where it is not of all numbers.
fn worst_text(worst: Part) -> &'static str {
    match worst {
        Part::All => "",
        Part::Frequencies => " by its frequencies alone",
        Part::Scatter => " by how far its segments had to be bent",
        Part::Phases => " by the phases of its shapes alone",
    }
}

/// Where else the best effect could be.
fn tell_near(diagnosis: &Diagnosis, console: &Console) {
    if let Some(best) = diagnosis.candidates.first().filter(|best| !best.near.is_empty()) {
        let places: Vec<&str> = best.near.iter().map(|near| near.r#where.as_str()).collect();
        console.say(format!("  Other places do nearly as well: {}.", places.join(", ")));
    }
}

/// Modes that are named as those that gain most.
const NAMED_MODES: usize = 4;

fn tell_explained(diagnosis: &Diagnosis, console: &Console) {
    let mut modes: Vec<_> = diagnosis.explained.iter().collect();
    let gain = |mode: &crate::diagnose::Explained| mode.chi_squared_before - mode.chi_squared_after;
    modes.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    for (index, mode) in modes.iter().take(NAMED_MODES).filter(|mode| gain(mode) > 1.0).enumerate() {
        let [before, after] = [mode.before_percent, mode.after_percent].map(percent_text);
        let frequency = if before == after { String::new() } else { format!("frequency {before} -> {after}, ") };
        let at = mode.channel.as_ref().map_or_else(String::new, |channel| format!(", shape most at channel {channel}"));
        console.say(format!(
            "  {} mode {} at {:.4} Hz: {frequency}chi-squared {:.0} -> {:.0}{at}",
            if index == 0 { "Why:" } else { "    " },
            mode.measured,
            mode.measured_hz,
            mode.chi_squared_before,
            mode.chi_squared_after
        ));
    }
}

/// An error, where the model has such a mode.
fn percent_text(error_percent: Option<f64>) -> String {
    error_percent.map_or_else(|| "no such mode".to_owned(), |error| format!("{error:+.2} %"))
}

fn tell_unexplained(diagnosis: &Diagnosis, console: &Console) {
    let left = &diagnosis.unexplained;
    let mut modes: Vec<_> = left.by_mode.iter().collect();
    modes.sort_by(|a, b| b.mean_square.total_cmp(&a.mean_square));
    for mode in modes.iter().take(NAMED_MODES) {
        console.say(format!(
            "  mode {} at {:.4} Hz: {:.1} times what is allowed (frequency {:+.2} %)",
            mode.measured, mode.measured_hz, mode.mean_square, mode.frequency_error_percent
        ));
    }
    let mut sensors: Vec<_> = left.by_sensor.iter().collect();
    sensors.sort_by(|a, b| b.mean_square.total_cmp(&a.mean_square));
    for sensor in sensors.iter().take(NAMED_MODES) {
        console.say(format!("  channel {}: {:.1} times what is allowed", sensor.channel, sensor.mean_square));
    }
}

/// Values with their deviations.
pub(super) fn values_text(parameters: &[Estimate]) -> String {
    let several = parameters.iter().filter(|parameter| parameter.std.is_some()).count() > 1;
    let words: Vec<String> = parameters
        .iter()
        .map(|parameter| {
            let name = if several { format!("{} ", parameter.name) } else { String::new() };
            let unit = if parameter.unit == "-" { String::new() } else { format!(" {}", parameter.unit) };
            match parameter.std {
                Some(std) => format!("{name}{} ± {}{unit}", short(parameter.value), short(std)),
                None => format!("{} {}{unit}", parameter.name, short(parameter.value)),
            }
        })
        .collect();
    words.join("\n")
}

/// Three digits, with an exponent where the number is far from 1.
pub(super) fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let exponent = value.abs().log10().floor();
    if (-3.0..5.0).contains(&exponent) {
        format!("{value:.*}", (2.0 - exponent).max(0.0) as usize)
    } else {
        format!("{value:.2e}")
    }
}

/// A probability in a sentence.
pub(super) fn p_is(p_value: f64) -> String {
    if p_value < 1e-4 { format!("p {}", p_text(p_value)) } else { format!("p = {}", p_text(p_value)) }
}

/// A probability in a table.
pub(super) fn p_text(p_value: f64) -> String {
    if p_value < 1e-4 { "< 0.0001".to_owned() } else { format!("{p_value:.4}") }
}
