//! `belfry diagnose`: which physical effect the model lacks.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, in_shell, next_lines, p_is, p_text, short, values_before_units, values_text, width};
use crate::diagnose::steps::Step;
use crate::diagnose::{
    CandidateReport, Diagnosis, Estimate, FAILS, GoodnessOfFit, Part, PartialEffect, Probabilities, Unexplained,
    Verdict,
};
use crate::model::effect::{self, Evidence};
use crate::numbers::{probability_text, signed};
use crate::page::capital;
use crate::results::FINGERPRINTS_PICTURE;
use crate::story::{AutoEnd, Project};
use crate::study::Study;

const EXAMPLES: &str = "Examples:
  belfry diagnose canton                       after `belfry identify canton`
  belfry diagnose canton --auto                add and drop effects until nothing is gained
  belfry diagnose canton --without p-delta     as if there were no such effect
  belfry diagnose canton --json

Every effect of the catalogue (belfry effects), at every height, channel or node, is scored by how much of the difference between model and measurement it explains beyond what measurement noise and the model's own tolerance (background_stiffness and background_mass in [model]) allow. The best are refitted. Probabilities sum to one over the model as it is, every effect, and something else; they follow from the evidence (log_bayes_factor in --json) and from odds before anything is measured (prior_odds in [model]). p is the probability of as much misfit as is left, were the effect all that is missing.

Where no single effect explains the measurement, the small set that explains most is shown too: effects added one after the other and fitted together, each with its probability if the others are right, chi-squared without it, and the kind that does best in its place. That is a lead and no finding, and nothing is written.

With --auto the best effect is added, those that it makes needless are dropped, and so on until nothing more is called for. study.toml and the history change as with `belfry add`, and what is printed is the final state.

Writes diagnosis.json into `results`, and fingerprints.json and fingerprints.svg: what the model misses, number by number, beside what each of the first effects would do.";

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
pub(super) fn kind(text: &str) -> Result<String, String> {
    effect::find(text).map(|kind| kind.name().to_owned()).map_err(|error| error.to_string())
}

/// Runs the command.
///
/// # Errors
/// When the study, its model or its modes cannot be read, or do not go together.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    console.warn_all(&project.case()?.warnings);
    if arguments.auto {
        auto(&mut project, &arguments.without, console)?;
    }
    let diagnosis = diagnose_project(&mut project, &arguments.without, console)?;
    if diagnosis.fingerprints.is_some() {
        let picture = project.results().path(FINGERPRINTS_PICTURE);
        console.say(format!("Picture: {}, why these effects fit or do not", picture.display()));
    }
    tell_next(&diagnosis, arguments.auto, project.study(), console);
    console.json("diagnose-1", &diagnosis)
}

/// Adds and drops effects until nothing is gained.
fn auto(project: &mut Project, without: &[String], console: &Console) -> anyhow::Result<()> {
    let mut say_step = |step: &Step| {
        let record = &step.record;
        console.say(format!(
            "{}: chi-squared {:.0} over {} numbers, frequency error {:.2} %",
            step.action, record.chi_squared, record.degrees_of_freedom, record.mean_abs_frequency_error_percent
        ));
    };
    let end =
        console.with_progress(|on_progress| project.add_until_nothing_gains(without, on_progress, &mut say_step))?;
    match end {
        AutoEnd::NothingGained => console.say("No effect is called for; the model stays as it is."),
        AutoEnd::FrequenciesAlone => console.warn(
            "frequencies alone do not say which mode is which; nothing was added. If you know, state it (model_mode in a CSV file of modes); `belfry add` puts an effect in all the same",
        ),
        AutoEnd::Unexplained { p_value } => console.warn(format!(
            "these effects do not explain the measurement ({}); nothing was added. `belfry add` puts one in all the same",
            p_is(p_value)
        )),
        AutoEnd::Adopted => console.warn_all(&project.case()?.warnings),
    }
    Ok(())
}

/// Diagnoses and tells.
pub(super) fn diagnose_project(
    project: &mut Project,
    without: &[String],
    console: &Console,
) -> anyhow::Result<Diagnosis> {
    let diagnosis = console.with_progress(|on_progress| project.diagnose(without, on_progress))?;
    tell(&diagnosis, &project.case()?.effect_names(), project.study(), console);
    console.warn_all(&diagnosis.warnings);
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

fn tell(diagnosis: &Diagnosis, effects: &[String], study: &Study, console: &Console) {
    let with = if effects.is_empty() { String::new() } else { format!(", with {},", effects.join(", ")) };
    console.say(format!("\n{}: which effect does the model{with} lack?", study.structure.name));
    let in_words = |test: GoodnessOfFit| {
        format!(
            "chi-squared {:.0} over {} numbers, {}{}.",
            test.chi_squared,
            test.degrees_of_freedom,
            p_is(test.p_value),
            if test.p_value < FAILS { worst_text(test.worst) } else { "" }
        )
    };
    console.say(format!("The model as it is: {}", in_words(diagnosis.present)));
    if let Some(test) = diagnosis.present_beside_best {
        let best = if diagnosis.ambiguous.is_empty() { &best_name(diagnosis) } else { "the best of these" };
        console.say(format!("If it may miss no more than with {best}: {}", in_words(test)));
    }
    if !diagnosis.candidates.is_empty() {
        tell_table(diagnosis, console);
        for candidate in shown(diagnosis) {
            for estimate in candidate.parameters.iter().filter(|estimate| estimate.is_unusual()) {
                let sizes = estimate.typical_sizes.map_or_else(String::new, |sizes| format!("{sizes:.0} times "));
                console.say(format!(
                    "{}: {} is {sizes}what is usual for such an effect; check whether it can be true.",
                    candidate.name(),
                    estimate.name
                ));
            }
        }
        for candidate in diagnosis.candidates.iter().filter(|candidate| !candidate.admissible) {
            console.say(format!(
                "{} would need an impossible value ({}).",
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
    tell_verdict(diagnosis, console);
}

/// Hypotheses by their probability.
fn tell_table(diagnosis: &Diagnosis, console: &Console) {
    let of_candidate = |candidate: &CandidateReport| {
        let left = if in_modes(candidate) { format!("{:.0}", candidate.chi_squared) } else { "-".to_owned() };
        let probability = candidate.probability.unwrap_or(0.0);
        let [name, values, probable] =
            cells(candidate.name(), candidate.where_std_m, &candidate.parameters, probability);
        (probability, [name, values, probable, left, p_text(candidate.p_value)])
    };
    let Probabilities { adequate, something_else } = diagnosis.probabilities;
    let dash = || "-".to_owned();
    // The test that goes with its probability.
    let test = match diagnosis.verdict {
        Verdict::Adequate => diagnosis.goodness_of_fit,
        _ => diagnosis.present_beside_best.unwrap_or(diagnosis.present),
    };
    let as_it_is = [
        "none".to_owned(),
        dash(),
        probability_text(adequate),
        format!("{:.0}", test.chi_squared),
        p_text(test.p_value),
    ];
    let other = ["something else".to_owned(), dash(), probability_text(something_else), dash(), dash()];
    let mut rows: Vec<(f64, [String; 5])> = shown(diagnosis).into_iter().map(of_candidate).collect();
    rows.extend([(adequate, as_it_is), (something_else, other)]);
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut table = Columns::new(["effect", "value", "probability", "chi-squared left", "p"]).expendable(&[3]);
    for (_, row) in rows {
        table.row(row);
    }
    console.say(table);
}

/// In fewer columns of text, units stand below their values.
const WIDE: u16 = 100;

/// An effect's name with how well its height is known, its values and its probability, as tables have them.
pub(super) fn cells(name: String, where_std_m: Option<f64>, parameters: &[Estimate], probability: f64) -> [String; 3] {
    let place_std = where_std_m.map_or_else(String::new, |std| format!("\n± {} m", short(std)));
    let is_narrow = width().is_some_and(|width| width < WIDE);
    let values = values_before_units(parameters, if is_narrow { "\n" } else { " " });
    [name + &place_std, values, probability_text(probability)]
}

/// The effect that is named first; empty where none is.
fn best_name(diagnosis: &Diagnosis) -> String {
    diagnosis.best.first().cloned().unwrap_or_default()
}

pub(super) fn tell_verdict(diagnosis: &Diagnosis, console: &Console) {
    let best = best_name(diagnosis);
    match diagnosis.verdict {
        Verdict::Adequate if diagnosis.present.p_value < FAILS => {
            console.say(
                "Verdict: adequate. The model misses more than its tolerance says, but no effect accounts for that.",
            );
        }
        Verdict::Adequate if diagnosis.discrepancy.missed_in_words().is_some() => {
            console.say("Verdict: adequate. The model explains the measurement within its tolerance and what it misses besides; no effect is called for.");
        }
        Verdict::Adequate => {
            console.say("Verdict: adequate. The model explains the measurement within its tolerance, and no effect is called for.");
        }
        Verdict::Effect => {
            match &diagnosis.reason {
                Some(reason) => console.say(format!("Verdict: {best}: {reason}.")),
                None => console.say(format!("Verdict: {best}. It explains what the model does not.")),
            }
            tell_near(&diagnosis.candidates, console);
            tell_explained(diagnosis, console);
        }
        Verdict::Ambiguous => {
            let names = diagnosis.ambiguous.iter().flatten().cloned().collect::<Vec<_>>().join(", ");
            console.say(format!("Verdict: ambiguous. The data cannot tell these apart: {names}."));
            tell_explained(diagnosis, console);
        }
        Verdict::Unknown => {
            const NONE: &str = "Verdict: unknown. No single effect of the catalogue explains the measurement.";
            match &diagnosis.partial {
                Some(partial) => {
                    console.say(NONE);
                    super::partial::tell(partial, console);
                }
                None => {
                    console.say(format!("{NONE} What the best of them leaves:"));
                    tell_unexplained(&diagnosis.unexplained, console);
                }
            }
        }
    }
    tell_discrepancy(diagnosis, console);
    diagnosis.joint.iter().flat_map(|joint| joint.in_words()).for_each(|sentence| console.say(sentence + "."));
    if let Some(next) = &diagnosis.next_measurement {
        console.say(format!("To settle it, measure: {next}."));
    }
}

/// What the model misses besides, where that is anything.
fn tell_discrepancy(diagnosis: &Diagnosis, console: &Console) {
    if diagnosis.verdict == Verdict::Unknown {
        return;
    }
    if let Some(missed) = diagnosis.discrepancy.missed_in_words() {
        let which = if diagnosis.best.is_empty() { "Your model" } else { "With it your model" };
        console.say(format!("{which} misses {missed}, for reasons that no effect explains."));
    }
    if let Some(scatter) = diagnosis.discrepancy.scatter_in_words() {
        console.say(format!("{}.", capital(&scatter)));
    }
}

/// What one can do about a verdict.
fn tell_next(diagnosis: &Diagnosis, auto: bool, study: &Study, console: &Console) {
    let folder = in_shell(&study.folder);
    let best = diagnosis.best.first();
    let mut next: Vec<(String, &str)> = Vec::new();
    match (diagnosis.verdict, best) {
        (Verdict::Adequate, _) if study.setups.is_empty() => {
            next.push((format!("compare {folder}"), "the model against the measured modes"));
        }
        (Verdict::Adequate, _) => next.push((format!("covalidate {folder}"), "predicts sensors that it is not shown")),
        (Verdict::Effect, Some(best)) => {
            next.push((format!("add {folder} {best}"), "puts it into the model and refits"));
        }
        (Verdict::Ambiguous, _) => {
            console.say("Measure that; or decide by what you know of the structure, and add one of them.");
            let names = diagnosis.ambiguous.iter().flatten();
            next.extend(names.map(|name| (format!("add {folder} {name}"), "where you know of it")));
        }
        _ => {
            console.say(unknown_advice(diagnosis, auto));
            let surest = diagnosis.partial.as_ref().and_then(|partial| partial.effects.first());
            let ranked = diagnosis.candidates.iter().find(|candidate| candidate.stands_out());
            if let Some(first) = surest.map(PartialEffect::name).or_else(|| ranked.map(CandidateReport::name)) {
                next.push((format!("add {folder} {first}"), "the one that explains most, and what it leaves"));
            }
            if auto {
                next.push((format!("compare {folder}"), "where the model fails, by mode, sensor and height"));
            } else {
                next.insert(0, (format!("diagnose {folder} --auto"), "looks for several effects together"));
            }
        }
    }
    if auto && study.model.as_ref().is_some_and(|model| !model.effects.is_empty()) {
        next.push((format!("history {folder}"), "how the error fell, step by step"));
    }
    console.say(next_lines(&next));
}

/// What to make of a ranking without a verdict.
fn unknown_advice(diagnosis: &Diagnosis, auto: bool) -> String {
    let standing: Vec<String> =
        diagnosis.candidates.iter().filter(|candidate| candidate.stands_out()).map(CandidateReport::name).collect();
    if diagnosis.partial.is_some() && !auto {
        return "Other sets may explain as much. Take from it what you know of the structure (a tower on soil has base-rotation, a new antenna is an added-mass), add that by hand and diagnose again. --auto writes a set into study.toml, but only one that explains the measurement.".to_owned();
    }
    match (standing.len(), auto) {
        (0, _) => "No effect gains 20 to 1 either. Look at where the model fails; a hypothesis of your own can be tried as [[model.custom]] in study.toml.".to_owned(),
        (_, true) => "The ranked effects explain part of it, and together not enough. If you know one of them to be there, add it by hand; a hypothesis of your own can be tried as [[model.custom]] in study.toml.".to_owned(),
        (_, false) => format!(
            "Each of the ranked effects explains part of it, so several may be missing together. The order is by what each explains alone, and effects that move the same modes stand close together in it. Use --auto where you do not know which to take: it looks for effects that explain the measurement together, and writes nothing unless they do. Add one by hand where you know it to be there (a tower on soil has base-rotation, a new antenna is an added-mass), also if it is not the first of {}; then diagnose again.",
            standing.len()
        ),
    }
}

/// What a probability is of, where it is not of all numbers.
fn worst_text(worst: Part) -> &'static str {
    match worst {
        Part::All => "",
        Part::Frequencies => " by its frequencies alone",
        Part::Scatter => " by how far the stiffness and mass of its parts had to be adjusted",
        Part::Phases => " by the phases of its shapes alone",
        Part::Discrepancy => " by how much it would miss for reasons that no effect explains",
    }
}

/// Where else the first of the candidates could be.
pub(super) fn tell_near(candidates: &[CandidateReport], console: &Console) {
    if let Some(best) = candidates.first().filter(|best| !best.near.is_empty()) {
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

pub(super) fn tell_unexplained(left: &Unexplained, console: &Console) {
    let mut modes: Vec<_> = left.by_mode.iter().collect();
    modes.sort_by(|a, b| b.mean_square.total_cmp(&a.mean_square));
    for mode in modes.iter().take(NAMED_MODES) {
        console.say(format!(
            "  mode {} at {:.4} Hz: {:.1} times what is allowed (frequency {} %)",
            mode.measured,
            mode.measured_hz,
            mode.mean_square,
            signed(mode.frequency_error_percent, 2)
        ));
    }
    let mut sensors: Vec<_> = left.by_sensor.iter().collect();
    sensors.sort_by(|a, b| b.mean_square.total_cmp(&a.mean_square));
    for sensor in sensors.iter().take(NAMED_MODES) {
        console.say(format!("  channel {}: {:.1} times what is allowed", sensor.channel, sensor.mean_square));
    }
    let mut groups: Vec<_> = left.by_group.iter().collect();
    groups.sort_by(|a, b| b.mean_square.total_cmp(&a.mean_square));
    for group in groups.iter().take(NAMED_MODES) {
        console.say(format!("  sensors at group {}: {:.1} times what is allowed", group.group, group.mean_square));
    }
}
