//! `belfry change`: what has changed between two measurements of one structure.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::diagnose::{cells, kind, tell_near};
use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, mac_text, or_dash, p_is, p_text, short};
use crate::change::{Changes, LonelyMode, ModeChange};
use crate::diagnose::{CandidateReport, ChangeDiagnosis, ChangeVerdict, Direction};
use crate::numbers::{probability_text, signed};
use crate::story::{Project, SinceReport, SinceRequest};

const EXAMPLES: &str = "Examples:
  belfry change tower --before tower-2024              the modes of another study
  belfry change tower --before before.csv              a file of modes
  belfry change tower --before may.json --now june.json
  belfry change tower --before before.csv --without added-mass --json

STUDY has the sensors and, where there is one, the model; its own modes are those of now. Modes are CSV, UFF 55 or JSON, or another study's. The same channels must stand at the same places in both measurements.

Modes are paired by shape and frequency. Close modes turn within their span at the slightest change, so their shapes are compared with that span. p is the probability of as much difference by the errors of both measurements alone.

With a model, it is first fitted to the measurement before. Then it says what has changed, and where: the model's own errors are the same in both measurements and cancel. Temperature and the level of vibration change frequencies too, most often all alike.

Writes change.json and change.svg into `results`.";

/// Compare two measurements of one structure: what has changed, and where
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// The measurement before: a file of modes, or the folder of a study
    #[arg(long, value_name = "MODES")]
    before: PathBuf,
    /// The measurement now [default: the study's own modes]
    #[arg(long, value_name = "MODES")]
    now: Option<PathBuf>,
    /// Leave a kind of effect out; repeat for more
    #[arg(long, value_name = "KIND", value_parser = kind)]
    without: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// When modes or the model cannot be read, sensors of the two differ, or they have no mode in common.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let project = Project::open(&arguments.study)?;
    let request = SinceRequest {
        before: arguments.before.clone(),
        now: arguments.now.clone(),
        without: arguments.without.clone(),
    };
    let (report, picture) = project.since(&request)?;
    console.say(format!(
        "\n{}: {} since {}",
        project.study().structure.name,
        report.now.display(),
        report.before.display()
    ));
    tell_modes(&report.changes, console);
    tell_test(&report, console);
    if let Some(diagnosis) = &report.diagnosis {
        tell_diagnosis(diagnosis, report.changes.has_changed() == Some(true), console);
    }
    console.warn_all(&report.warnings);
    console.say(format!("Picture: {}", picture.display()));
    if project.study().model.is_none() {
        console.say("With a [model] in study.toml Belfry also says what has changed, and where.");
    }
    console.json("change-1", &report)
}

fn tell_modes(changes: &Changes, console: &Console) {
    let mut table = Columns::new(["mode", "before Hz", "now Hz", "change %", "±", "damping %", "now", "MAC", "p"])
        .expendable(&[6, 5, 1]);
    let percent = |ratio: Option<f64>| or_dash(ratio.map(|ratio| 100.0 * ratio), 2);
    for mode in &changes.modes {
        table.row([
            name(mode),
            format!("{:.4}", mode.before_hz),
            format!("{:.4}", mode.now_hz),
            signed(mode.change_percent, 2),
            short(mode.change_percent_std),
            percent(mode.damping_before),
            percent(mode.damping_now),
            mac_text(mode.mac, 4),
            p_text(mode.p_value),
        ]);
    }
    console.say(table);
    for mode in changes.modes.iter().filter(|mode| !mode.close_to.is_empty()) {
        let span: Vec<String> = mode.close_to.iter().map(usize::to_string).collect();
        console.say(format!(
            "Mode {} is one of close ones; its p compares it with modes {} before together.",
            mode.now,
            span.join(", ")
        ));
    }
    let damped = |mode: &&ModeChange| mode.damping_z.is_some_and(|z| z.abs() > DAMPING_STANDS_OUT);
    for mode in changes.modes.iter().filter(damped) {
        console.say(format!(
            "The damping of mode {} has changed: {} % -> {} % ({} deviations).",
            mode.now,
            percent(mode.damping_before),
            percent(mode.damping_now),
            signed(mode.damping_z.unwrap_or_default(), 1)
        ));
    }
    tell_lonely(&changes.only_before, "before", console);
    tell_lonely(&changes.only_now, "now", console);
}

/// A dozen dampings differ by less than so many deviations by chance (with 99 %, Bonferroni).
const DAMPING_STANDS_OUT: f64 = 3.4;

/// A mode by its number now, and the one before where that is another.
fn name(mode: &ModeChange) -> String {
    if mode.before == mode.now { mode.now.to_string() } else { format!("{} ({})", mode.now, mode.before) }
}

fn tell_lonely(modes: &[LonelyMode], when: &str, console: &Console) {
    for mode in modes {
        console.say(format!("Mode {} at {:.4} Hz was found only {when}.", mode.number, mode.frequency_hz));
    }
}

fn tell_test(report: &SinceReport, console: &Console) {
    let changes = &report.changes;
    let Some(test) = &changes.test else { return };
    let verdict = if test.has_changed() {
        "The structure, or its measurement, has changed"
    } else {
        "All numbers together differ by no more than the errors of both measurements make"
    };
    console.say(format!(
        "{verdict}: chi-squared {:.0} over {} numbers, {}.",
        test.chi_squared,
        test.degrees_of_freedom,
        p_is(test.p_value)
    ));
    if let (true, Some(percent), Some(std)) = (changes.is_common(), changes.common_percent, changes.common_percent_std)
    {
        console.say(format!(
            "All frequencies have changed alike, by {percent:+.2} ± {std:.2} %: that is what temperature does, or stiffness or mass as a whole."
        ));
    }
    match &report.climate {
        Some(climate) => {
            let corrected = climate.corrected_before.len().max(climate.corrected_now.len());
            console.say(format!(
                "Temperature {:.1} °C before, {:.1} °C now; {corrected} of {} modes are compared at one temperature.",
                climate.before_degc,
                climate.now_degc,
                changes.modes.len()
            ));
        }
        None if test.has_changed() => console.say(
            "Temperature is not known: a structure that is 10 K warmer may have frequencies lower by 0.1 to 1 %, without damage.",
        ),
        None => {}
    }
}

/// Candidates in the table.
const SHOWN: usize = 5;

fn tell_diagnosis(diagnosis: &ChangeDiagnosis, has_changed: bool, console: &Console) {
    let mut rows: Vec<(f64, [String; 3])> = diagnosis
        .candidates
        .iter()
        .filter(|candidate| candidate.admissible && candidate.probability.is_some())
        .take(SHOWN)
        .map(row)
        .collect();
    let dash = || "-".to_owned();
    let probabilities = diagnosis.probabilities;
    for (what, probability) in [("nothing", probabilities.unchanged), ("something else", probabilities.something_else)]
    {
        rows.push((probability, [what.to_owned(), dash(), probability_text(probability)]));
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    let what = if diagnosis.direction == Direction::Come { "what has come" } else { "what has gone" };
    let mut table = Columns::new([what, "value", "probability"]);
    for (_, row) in rows {
        table.row(row);
    }
    console.say(table);
    tell_verdict(diagnosis, has_changed, console);
    if let Some(next) = &diagnosis.next_measurement {
        console.say(format!("To settle it, measure: {next}."));
    }
}

fn row(candidate: &CandidateReport) -> (f64, [String; 3]) {
    let probability = candidate.probability.unwrap_or(0.0);
    (probability, cells(candidate.name(), candidate.where_std_m, &candidate.parameters, probability))
}

fn tell_verdict(diagnosis: &ChangeDiagnosis, has_changed: bool, console: &Console) {
    let best = diagnosis.best.first().cloned().unwrap_or_default();
    let has = if diagnosis.direction == Direction::Come { "has come" } else { "was there before and has gone" };
    match diagnosis.verdict {
        ChangeVerdict::Unchanged if has_changed => console.say(
            "Verdict: unchanged. The differences are larger than errors usually make them, but nothing that the model can show explains them better.",
        ),
        ChangeVerdict::Unchanged => console.say("Verdict: unchanged. Nothing needs to have happened to the structure."),
        ChangeVerdict::Effect => {
            let why = if has_changed { "It explains the change." } else { "All numbers together hide it, but what there is points to it." };
            console.say(format!("Verdict: {best} {has}. {why}"));
            tell_near(&diagnosis.candidates, console);
        }
        ChangeVerdict::Ambiguous => {
            let names = diagnosis.ambiguous.iter().flatten().cloned().collect::<Vec<_>>().join(", ");
            console.say(format!("Verdict: ambiguous. One of these {has}, and the data cannot tell which: {names}."));
        }
        ChangeVerdict::Unknown => console.say(
            "Verdict: unknown. Something has changed that no single effect of the catalogue explains: several at once, temperature that is not the same everywhere, or a mode that was identified wrongly.",
        ),
    }
}
