//! What `add`, `remove` and `diagnose --auto` share: effects written into the study, the history they leave, and the model
//! before and after.

use std::fs::OpenOptions;
use std::io::Write;

use anyhow::Context;
use belfry_shared::frame::crc32;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;

use super::Console;
use super::case::{Case, results_folder};
use super::compare::{mac_text, or_dash};
use super::diagnose::{p_is, values_text};
use super::identify::align_right;
use crate::compare::{Comparison, ModelView, Tolerance, compare};
use crate::diagnose::steps::{FittedEffect, Step, StepRecord};
use crate::diagnose::{Estimate, STANDS_OUT};
use crate::model::effect::Effect;
use crate::study::edit::{EffectEntry, set_effects};
use crate::study::{STUDY_FILE, Study};

/// One JSON object a step.
pub(super) const HISTORY_FILE: &str = "history.jsonl";

/// What `--json` prints of a change.
#[derive(Debug, Serialize)]
pub(super) struct ChangeReport {
    /// What was done.
    action: String,
    /// The effects of the model now.
    effects: Vec<EffectReport>,
    /// The model before, its modes compared.
    before: Comparison,
    /// The model now.
    after: Comparison,
    /// The step of the history.
    step: StepRecord,
    /// The step before.
    previous: Option<StepRecord>,
}

/// An effect in the model.
#[derive(Debug, Serialize)]
struct EffectReport {
    effect: String,
    r#where: Option<String>,
    parameters: Vec<Estimate>,
}

/// Steps of a study so far; none where nothing was done yet.
///
/// # Errors
/// When the file cannot be read; names the line.
pub(super) fn read_history(study: &Study) -> anyhow::Result<Vec<StepRecord>> {
    let path = results_folder(study).join(HISTORY_FILE);
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let step = |(index, line): (usize, &str)| {
        serde_json::from_str(line)
            .with_context(|| format!("{}, line {}: not a step of `belfry add`", path.display(), index + 1))
    };
    lines.map(step).collect()
}

/// Appends steps, numbered on.
pub(super) fn append_history(case: &Case, steps: &[StepRecord]) -> anyhow::Result<Vec<StepRecord>> {
    let study = &case.study;
    let data = data_mark(case)?;
    let first = read_history(study)?.last().map_or(0, |last| last.step + 1);
    let folder = results_folder(study);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let path = folder.join(HISTORY_FILE);
    let failed = || format!("cannot write {}", path.display());
    let mut file = OpenOptions::new().create(true).append(true).open(&path).with_context(failed)?;
    let mut numbered = Vec::new();
    for (number, step) in (first..).zip(steps) {
        let step = StepRecord { step: number, data: data.clone(), ..step.clone() };
        writeln!(file, "{}", serde_json::to_string(&step)?).with_context(failed)?;
        numbered.push(step);
    }
    Ok(numbered)
}

/// Of the measured modes and the model as given.
fn data_mark(case: &Case) -> anyhow::Result<String> {
    let file = &case.measured.file;
    let modes = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    let given = case.model.as_given();
    let numbers: Vec<u8> =
        given.stiffness.iter().chain(given.mass.iter()).flat_map(|number| number.to_le_bytes()).collect();
    Ok(format!("{:08x}{:08x}", crc32(&modes), crc32(&numbers)))
}

/// The record of the model as it is, where the history has none of it yet; `None` as well where the effects in it cannot be
/// fitted to these data, which only taking one out can mend.
pub(super) fn starting_record(case: &Case) -> anyhow::Result<Option<StepRecord>> {
    let history = read_history(&case.study)?;
    let effects = case.effect_names();
    let data = data_mark(case)?;
    let action = match history.last() {
        None => "start",
        Some(last) if last.data != data => "new measurement or model",
        Some(last) if last.effects == effects && last.modes > 0 => return Ok(None),
        Some(_) => "edited by hand",
    };
    Ok(Some(case.setting()?.refit(action, &case.model.effects)?.record))
}

/// Writes the effects of a step into study.toml and the step into the history, and tells of it.
pub(super) fn adopt(
    case: &Case,
    start: Option<StepRecord>,
    step: &Step,
    console: &Console,
) -> anyhow::Result<ChangeReport> {
    let previous = match &start {
        Some(start) => Some(start.clone()),
        None => read_history(&case.study)?.pop(),
    };
    let effects: Vec<Effect> = step.effects.iter().map(|fitted| fitted.effect.clone()).collect();
    let after = case.compare_with(&effects)?;
    set_effects(&case.study.folder, &entries(&step.effects))?;
    let records: Vec<StepRecord> = start.into_iter().chain([step.record.clone()]).collect();
    let record = append_history(case, &records)?.pop().unwrap_or_else(|| step.record.clone());
    let report = ChangeReport {
        action: step.action.clone(),
        effects: step
            .effects
            .iter()
            .map(|fitted| EffectReport {
                effect: fitted.effect.kind().to_owned(),
                r#where: fitted.effect.place().map(ToString::to_string),
                parameters: fitted.parameters.clone(),
            })
            .collect(),
        before: case.compare(),
        after,
        step: record,
        previous,
    };
    tell(&report, case, console);
    Ok(report)
}

/// Effects as study.toml has them.
pub(super) fn entries(effects: &[FittedEffect]) -> Vec<EffectEntry> {
    let entry = |fitted: &FittedEffect| EffectEntry {
        kind: fitted.effect.kind().to_owned(),
        location: fitted.effect.place().map(ToString::to_string),
        parameters: fitted
            .parameters
            .iter()
            .map(|parameter| (parameter.name.clone(), parameter.value, parameter.std))
            .collect(),
    };
    effects.iter().map(entry).collect()
}

fn tell(report: &ChangeReport, case: &Case, console: &Console) {
    let study = case.study.folder.display();
    console.say(format!("\n{}: {}", case.study.structure.name, report.action));
    if report.effects.is_empty() {
        console.say("The model has no effects now; it is the model as first given.");
    }
    for effect in &report.effects {
        let place = effect.r#where.as_ref().map_or_else(String::new, |place| format!("@{place}"));
        let values = values_text(&effect.parameters).replace('\n', ", ");
        console.say(format!("  {}{place}   {values}", effect.effect));
    }
    console.say(before_and_after(&report.before, &report.after));
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
            "What was left out: sensors {}, frequencies {}.",
            change(before.and_then(|step| step.held_out_error_percent), now.held_out_error_percent, " %"),
            change(before.and_then(|step| step.held_out_mode_error_percent), now.held_out_mode_error_percent, " %")
        ));
    }
    if let Some(gain) = now.log_bayes_factor {
        console.say(gain_text(gain, now, case));
    }
    console.say(format!("Written into {}.", case.study.folder.join(STUDY_FILE).display()));
    console.say(format!("Next: belfry diagnose {study}    is anything else missing?"));
    console.say(format!("      belfry history {study}     how the error fell, step by step"));
}

/// Whether a step was worth it.
fn gain_text(gain: f64, step: &StepRecord, case: &Case) -> String {
    let study = case.study.folder.display();
    let last = step.effects.last().cloned().unwrap_or_default();
    if step.action.starts_with("drop") {
        return match gain > -STANDS_OUT {
            true => format!("The data did not ask for it (ln B = {gain:+.1} without it)."),
            false => format!("The data ask for it: the evidence falls by ln B = {gain:+.1}."),
        };
    }
    if gain > STANDS_OUT {
        format!("It helps: the evidence rises by ln B = {gain:+.1}.")
    } else if gain > 0.0 {
        format!("It gains less than 20 to 1 (ln B = {gain:+.1}): the data do not ask for it.")
    } else {
        format!("It gains nothing (ln B = {gain:+.1}); `belfry remove {study} {last}` takes it out again.")
    }
}

fn before_and_after(before: &Comparison, after: &Comparison) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(vec!["mode", "measured Hz", "error % before", "after", "MAC before", "after"]);
    for pair in &after.pairs {
        let old = before.pairs.iter().find(|old| old.measured == pair.measured);
        table.add_row(vec![
            pair.measured.to_string(),
            format!("{:.4}", pair.measured_hz),
            old.map_or_else(|| "-".to_owned(), |old| format!("{:+.2}", old.frequency_error_percent)),
            format!("{:+.2}", pair.frequency_error_percent),
            mac_text(old.and_then(|old| old.mac), 4),
            mac_text(pair.mac, 4),
        ]);
    }
    align_right(&mut table, 6);
    table
}

impl Case {
    /// The model with other effects against the measurement.
    pub(super) fn compare_with(&self, effects: &[Effect]) -> anyhow::Result<Comparison> {
        let structure = self.model.bare().and(effects)?;
        let sensors = self.seen_sensors();
        let view = ModelView::of(&structure.assemble(), sensors)?;
        let tolerance = self.study.model.as_ref().and_then(|model| Tolerance::of(&structure, model));
        Ok(compare(&view, &self.measured.modes, sensors, tolerance.as_ref()))
    }
}
