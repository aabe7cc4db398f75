//! `belfry demo`: the whole story in one go, on a structure whose truth is known and whose model lacks something.

mod hidden;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use nalgebra::DVector;
use num_complex::Complex64;
use serde::Serialize;

use super::Console;
use super::add::add;
use super::case::{Case, results_folder};
use super::compare::compare_case;
use super::covalidate::{CovalidationReport, MOST_NOISE_GAIN, Request, covalidate_case, noise_gain};
use super::diagnose::{diagnose_case, short};
use super::history::show_history;
use super::identify::{Report, align_right, identify_study, summary, write_results};
use super::paper;
use super::steps::{ChangeReport, HISTORY_FILE};
use super::update::{UpdateReport, update_case};
use crate::compare::Comparison;
use crate::diagnose::Diagnosis;
use crate::identify::{Mode, mac};
use crate::link::fleet::FleetOptions;
use crate::link::memory::Faults;
use crate::measure::Route;
use crate::model::effect::{Effect, EffectRecord, Where, named};
use crate::model::{BeamTable, Structure};
use crate::picture::TrueShape;
use crate::simulate::{Options, Simulation, TrueMode, Truth, scattered};
use crate::study::{STUDY_FILE, Study, template};
use crate::update::Weights;

const EXAMPLES: &str = "Examples:
  belfry demo                         in the new folder belfry-demo; the seed draws what is hidden
  belfry demo tower --hours 4         a longer recording: finer lines, smaller deviations
  belfry demo --seed 5                another recording of another tower with another effect
  belfry demo --effect added-mass@300m=8e6
  belfry demo --paper                 the stand-in that has the frequencies measured on the Canton Tower, beside the paper's tables

The tower is its model with segments that scatter by 1 to 2 %, and with one effect that the model does not know. Its recording
goes to simulated sensor nodes that run the real firmware, over serial lines that damage 2 % of all frames, to the host. Then
the model is compared with the modes, updated as in the paper, and put to the test on sensors that it was not shown; and the
diagnosis looks for the effect, adds it, and the error falls. At the end the truth is told. Afterwards the folder is a
study like any other.";

/// First line of the demo's study.toml, by which a later demo knows that it may write over it.
const MARK: &str = "# Made by `belfry demo`; the next `belfry demo` here writes it anew.\n";
const RECORDING: &str = "recording.npy";
/// Segments scatter by this share of what the model's tolerance allows.
const SCATTER: f64 = 0.5;
/// The flexibility that gives the stand-in tower its measured frequencies.
const BASE_ROTATION: &str = "base-rotation=7.21e-15";
const DAMAGED_SHARE: f64 = 0.02;
/// A measured mode belongs to a true one when it is this near (relative) and this alike.
const NEAR: f64 = 0.05;
const ALIKE: f64 = 0.5;

/// Show the whole story on a simulated tower: nodes, serial link, modes, a model, and what it lacks
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Folder for the demo's study
    #[arg(value_name = "DIR", default_value = "belfry-demo")]
    pub folder: PathBuf,
    /// Hours of recording
    #[arg(long, default_value_t = 1.0, value_parser = hours)]
    pub hours: f64,
    /// Seed of load, noise, clocks and damage
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The effect to hide [default: drawn by the seed]
    #[arg(long, value_name = "KIND[@WHERE]=VALUE", conflicts_with = "paper")]
    pub effect: Option<Effect>,
    /// The stand-in that has the frequencies measured on the Canton Tower, beside the tables of the paper
    #[arg(long)]
    pub paper: bool,
}

fn hours(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(hours) if (0.2..=240.0).contains(&hours) => Ok(hours),
        _ => Err("expected a number of hours from 0.2 to 240".to_owned()),
    }
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Outcome {
    study: String,
    pairs: Vec<Pair>,
    missed_hz: Vec<f64>,
    spurious_hz: Vec<f64>,
    #[serde(flatten)]
    report: Report,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<Comparison>,
    #[serde(skip_serializing_if = "Option::is_none")]
    update: Option<UpdateReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    covalidation: Option<CovalidationReport>,
    /// What the tower has and its model does not know.
    hidden: Vec<EffectRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    diagnosis: Option<Diagnosis>,
    /// The effect found, added.
    #[serde(skip_serializing_if = "Option::is_none")]
    added: Option<ChangeReport>,
    /// The left-out sensors predicted with the effect added.
    #[serde(skip_serializing_if = "Option::is_none")]
    covalidation_with_effects: Option<CovalidationReport>,
}

/// A measured mode beside its truth.
#[derive(Debug, Clone, Serialize)]
struct Pair {
    number: usize,
    true_frequency_hz: f64,
    frequency_hz: f64,
    frequency_std_hz: f64,
    frequency_error_percent: f64,
    true_damping_ratio: f64,
    damping_ratio: f64,
    damping_ratio_std: f64,
    mac: f64,
}

/// Runs the command.
///
/// # Errors
/// When the folder holds another study, or cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let tower = Tower::of(arguments)?;
    let study = write_study(&arguments.folder)?;
    console.say(format!(
        "A synthetic stand-in for the Canton Tower, {} h at 50 Hz, 20 accelerometers on 8 sensor nodes.",
        arguments.hours
    ));
    if !arguments.paper {
        console.say(
            "Its segments differ from the model's by 1 to 2 %, and it has one effect that the model does not know.",
        );
    }
    let truth = simulate(&study, &tower, arguments, console)?;
    let faults = Faults::damaging(DAMAGED_SHARE);
    let options = FleetOptions { faults, seed: arguments.seed, ..FleetOptions::default() };
    let report = identify_study(&study, Route::Nodes(options), console)?;
    let band_hz = study.analysis.band_hz.unwrap_or([0.0, f64::INFINITY]);
    let in_band = |mode: &&TrueMode| (band_hz[0]..=band_hz[1]).contains(&mode.frequency_hz);
    let true_modes: Vec<&TrueMode> = truth.modes.iter().filter(in_band).collect();
    let matches = pair(&report.identification().modes, &true_modes, &truth);
    let shapes: Vec<Option<TrueShape>> = matches
        .iter()
        .zip(&report.identification().modes)
        .map(|(found, mode)| found.map(|index| true_shape(mode, true_modes[index], &truth)))
        .collect();
    write_results(&study, &report, &shapes)?;
    let mut outcome = outcome(&study, report, &matches, &true_modes, &truth);
    tell(&outcome, &study, console);
    outcome.hidden = tower.effects.iter().map(Effect::record).collect();
    hold_model(&mut outcome, &study, Route::Nodes(options), arguments.paper, console)?;
    if !arguments.paper {
        find_effect(&mut outcome, &study, Route::Nodes(options), console)?;
        reveal(&outcome, &tower.effects, console);
    }
    tell_next(&study, console);
    console.json(&outcome)
}

/// The structure that is simulated.
struct Tower {
    beam: BeamTable,
    effects: Vec<Effect>,
}

impl Tower {
    fn of(arguments: &Arguments) -> anyhow::Result<Self> {
        let read = |text: &str, name: &str| BeamTable::from_reader(text.as_bytes(), Path::new(name));
        if arguments.paper {
            let beam = read(template::CANTON_BEAM_FIELD, "beam_field.csv")?;
            return Ok(Self { beam, effects: vec![BASE_ROTATION.parse()?] });
        }
        let effect = match &arguments.effect {
            Some(effect) => effect.clone(),
            None => hidden::drawn(arguments.seed)?,
        };
        hidden::check(&effect)?;
        let study = Study::from_text(template::CANTON_STUDY, &arguments.folder)?;
        let model = study.model.as_ref().context("the demo's study has no model")?;
        let beam = scattered(read(template::CANTON_BEAM, "beam.csv")?, model, SCATTER, arguments.seed);
        let effect = effect.in_study(&study.sensors())?;
        Structure::with_effects(beam.clone(), std::slice::from_ref(&effect))?;
        Ok(Self { beam, effects: vec![effect] })
    }
}

/// Sensors that the paper leaves out of its co-validation.
const LEFT_OUT: [&str; 2] = ["09", "12"];

/// The model that does not know what the tower has, against what was measured: compared, updated, co-validated.
fn hold_model(
    outcome: &mut Outcome,
    study: &Study,
    route: Route,
    beside_paper: bool,
    console: &Console,
) -> anyhow::Result<()> {
    let case = Case::load(&study.folder, console)?;
    console.say(heading("The model against the measurement (belfry compare)"));
    let comparison = compare_case(&case, console)?;
    if comparison.pairs.is_empty() {
        return Ok(());
    }
    console.say(heading("The paper's direct update (belfry update)"));
    let update = update_case(&case, &Weights::default(), console)?;
    console.say(heading("Sensors that the model was not shown (belfry covalidate)"));
    let left_out =
        if beside_paper { LEFT_OUT.map(str::to_owned).to_vec() } else { worst_channel(&case, &comparison, route) };
    let covalidation = covalidate(&case, &left_out, route, console)?;
    if beside_paper {
        console.say(heading("Beside the paper: Lei, Wang, Shen (2012)"));
        console.say(paper::tables(&update, &covalidation)?);
    }
    outcome.comparison = Some(comparison);
    outcome.update = Some(update);
    outcome.covalidation = Some(covalidation);
    Ok(())
}

/// The channel at which the model fails most, of those whose motion the others see.
fn worst_channel(case: &Case, comparison: &Comparison, route: Route) -> Vec<String> {
    let gain = |channel: &String| {
        let request = leaving_out(std::slice::from_ref(channel), route);
        noise_gain(case, &request).unwrap_or(f64::INFINITY)
    };
    let mut sensors: Vec<_> = comparison.by_sensor.iter().collect();
    sensors.sort_by(|a, b| b.misfit.total_cmp(&a.misfit));
    let seen = sensors.iter().find(|sensor| gain(&sensor.channel) < MOST_NOISE_GAIN);
    seen.or(sensors.first()).map(|sensor| sensor.channel.clone()).into_iter().collect()
}

fn leaving_out(channels: &[String], route: Route) -> Request<'_> {
    Request { channels, setup: None, start_s: 0.0, duration_s: None, route }
}

fn covalidate(case: &Case, channels: &[String], route: Route, console: &Console) -> anyhow::Result<CovalidationReport> {
    covalidate_case(case, &leaving_out(channels, route), console)
}

/// What the model lacks: found, added, and the error falls.
fn find_effect(outcome: &mut Outcome, study: &Study, route: Route, console: &Console) -> anyhow::Result<()> {
    let case = Case::load(&study.folder, console)?;
    console.say(heading("Which physical effect is missing? (belfry diagnose)"));
    let diagnosis = diagnose_case(&case, &[], false, console)?;
    if let Some(best) = diagnosis.best.first() {
        console.say(heading(&format!("Into the model with it (belfry add {best})")));
        outcome.added = Some(add(&case, best, console)?);
        let case = Case::load(&study.folder, console)?;
        console.say(heading("The left-out sensors again, with the effect (belfry covalidate)"));
        let before = outcome.covalidation.iter().flat_map(|report| &report.channels);
        let left_out: Vec<String> = before.map(|channel| channel.channel.clone()).collect();
        outcome.covalidation_with_effects = Some(covalidate(&case, &left_out, route, console)?);
        console.say(heading("How the error fell (belfry history)"));
        show_history(&case.study, console)?;
    }
    outcome.diagnosis = Some(diagnosis);
    Ok(())
}

/// Tells what was hidden, and whether it was found.
fn reveal(outcome: &Outcome, effects: &[Effect], console: &Console) {
    console.say(heading("What was hidden"));
    for effect in effects {
        let values: Vec<String> = effect
            .parameters()
            .map(|(parameter, value)| format!("{} = {} {}", parameter.name, short(value), parameter.unit))
            .collect();
        console.say(format!("The tower had {effect}   {}", values.join(", ")));
    }
    let named: Vec<&String> = outcome
        .diagnosis
        .iter()
        .flat_map(|diagnosis| diagnosis.best.iter().chain(diagnosis.ambiguous.iter().flatten()))
        .collect();
    let is_hidden = |name: &&&String| effects.iter().any(|effect| is_same(effect, name));
    console.say(match (named.first(), named.iter().find(is_hidden)) {
        (Some(first), Some(found)) if first == found => format!("and the diagnosis said {found}."),
        (Some(first), Some(found)) => {
            format!("and the diagnosis named {found} among those that the data cannot tell from {first}.")
        }
        (Some(first), None) => format!("and the diagnosis said {first}: wrong, on this record."),
        (None, _) => "and the diagnosis named no effect: on this record it lies within what is uncertain.".to_owned(),
    });
}

/// A height is found when it is off by no more than this share of the tower's.
const FOUND_WITHIN: f64 = 0.05;
const TOWER_HEIGHT_M: f64 = 618.0;

/// Whether a name is that of an effect: of its kind, at its channels or node, or about its height.
fn is_same(effect: &Effect, name: &str) -> bool {
    let Ok((kind, place)) = named(name) else { return false };
    let is_there = match (effect.place(), &place) {
        (Some(Where::Height(hidden_m)), Some(Where::Height(found_m))) => {
            (hidden_m - found_m).abs() <= FOUND_WITHIN * TOWER_HEIGHT_M
        }
        (hidden, found) => hidden == found.as_ref(),
    };
    effect.of_kind() == kind && is_there
}

fn tell_next(study: &Study, console: &Console) {
    let folder = study.folder.display();
    console.say(format!(
        "\nNext:     belfry compare {folder}                  the steps one by one; every one has --json"
    ));
    console.say(format!("          belfry diagnose {folder}                 is anything else missing?"));
    console.say(format!("          belfry identify {folder} --direct        modes without nodes and link"));
}

fn heading(text: &str) -> String {
    format!("\n{text}\n{}", "─".repeat(text.chars().count()))
}

/// Writes the demo's study.
fn write_study(folder: &Path) -> anyhow::Result<Study> {
    let path = folder.join(STUDY_FILE);
    if fs::read_to_string(&path).is_ok_and(|text| !text.starts_with(MARK)) {
        bail!(
            "{} is a study of your own: name another folder, as in `belfry demo {}-demo`",
            path.display(),
            folder.display()
        );
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let mut study: toml_edit::DocumentMut = template::CANTON_STUDY.parse()?;
    if let Some(setups) = study.get_mut("setup").and_then(|item| item.as_array_of_tables_mut())
        && let Some(setup) = setups.get_mut(0)
    {
        setup["files"] = toml_edit::value(toml_edit::Array::from_iter([RECORDING]));
    }
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    // A history is of the tower that was.
    match fs::remove_file(folder.join("results").join(HISTORY_FILE)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(error).with_context(|| format!("cannot remove the old history in {}", folder.display()));
        }
        _ => {}
    }
    write("beam.csv", template::CANTON_BEAM)?;
    write(STUDY_FILE, &format!("{MARK}{study}"))?;
    Ok(Study::load(folder)?)
}

/// Simulates the stand-in tower's recording into the study.
fn simulate(study: &Study, tower: &Tower, arguments: &Arguments, console: &Console) -> anyhow::Result<Truth> {
    let setup = study.setups.first().context("the demo's study has no setup")?;
    let options = Options { seed: arguments.seed, ..Options::default() };
    let mut simulation = Simulation::of_beam(tower.beam.clone(), &tower.effects, setup, &options)?;
    let rows = (arguments.hours * 3600.0 * setup.sampling_rate_hz).round() as u64;
    let bar = console.progress(rows, "recording");
    simulation.write(&study.folder.join(RECORDING), rows, |done| bar.set_position(done))?;
    bar.finish_and_clear();
    let truth = simulation.truth().clone();
    let path = study.folder.join("truth.json");
    fs::write(&path, serde_json::to_string_pretty(&truth)? + "\n")
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(truth)
}

/// For each measured mode the true mode that is near and most alike, each true mode once.
fn pair(modes: &[Mode], true_modes: &[&TrueMode], truth: &Truth) -> Vec<Option<usize>> {
    let mut candidates: Vec<(f64, usize, usize)> = Vec::new();
    for (measured, mode) in modes.iter().enumerate() {
        for (index, true_mode) in true_modes.iter().enumerate() {
            let alike = shape_mac(mode, true_mode, truth);
            if (mode.frequency_hz / true_mode.frequency_hz - 1.0).abs() < NEAR && alike > ALIKE {
                candidates.push((alike, measured, index));
            }
        }
    }
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut pairs = vec![None; modes.len()];
    for (_, measured, index) in candidates {
        if pairs[measured].is_none() && !pairs.contains(&Some(index)) {
            pairs[measured] = Some(index);
        }
    }
    pairs
}

/// MAC of a measured and a true shape over the channels that both have.
fn shape_mac(mode: &Mode, true_mode: &TrueMode, truth: &Truth) -> f64 {
    let expected: BTreeMap<&str, f64> = truth
        .channels
        .iter()
        .zip(&true_mode.shape)
        .map(|(channel, &value)| (channel.channel.as_str(), value))
        .collect();
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for component in &mode.shape {
        if let Some(&value) = expected.get(component.channel.as_str()) {
            a.push(Complex64::new(component.re, component.im));
            b.push(Complex64::from(value));
        }
    }
    mac(&DVector::from_vec(a), &DVector::from_vec(b))
}

/// A true shape by point, with the sign of the measured one.
fn true_shape(mode: &Mode, true_mode: &TrueMode, truth: &Truth) -> TrueShape {
    let value = |channel: &str| {
        let index = truth.channels.iter().position(|other| other.channel == channel)?;
        true_mode.shape.get(index).copied()
    };
    let product: f64 = mode.shape.iter().filter_map(|c| Some(c.re * value(&c.channel)?)).sum();
    let sign = if product < 0.0 { -1.0 } else { 1.0 };
    mode.shape.iter().filter_map(|c| Some((c.point.clone(), sign * value(&c.channel)?))).collect()
}

fn outcome(
    study: &Study,
    report: Report,
    matches: &[Option<usize>],
    true_modes: &[&TrueMode],
    truth: &Truth,
) -> Outcome {
    let modes = &report.identification().modes;
    let pairs = modes
        .iter()
        .zip(matches)
        .filter_map(|(mode, index)| {
            let true_mode = true_modes[(*index)?];
            Some(Pair {
                number: mode.number,
                true_frequency_hz: true_mode.frequency_hz,
                frequency_hz: mode.frequency_hz,
                frequency_std_hz: mode.frequency_std_hz,
                frequency_error_percent: 100.0 * (mode.frequency_hz / true_mode.frequency_hz - 1.0),
                true_damping_ratio: true_mode.damping_ratio,
                damping_ratio: mode.damping_ratio,
                damping_ratio_std: mode.damping_ratio_std,
                mac: shape_mac(mode, true_mode, truth),
            })
        })
        .collect();
    let missed = true_modes.iter().enumerate().filter(|(index, _)| !matches.contains(&Some(*index)));
    let spurious = modes.iter().zip(matches).filter(|(_, index)| index.is_none());
    Outcome {
        study: study.folder.display().to_string(),
        pairs,
        missed_hz: missed.map(|(_, mode)| mode.frequency_hz).collect(),
        spurious_hz: spurious.map(|(mode, _)| mode.frequency_hz).collect(),
        report,
        comparison: None,
        update: None,
        covalidation: None,
        hidden: Vec::new(),
        diagnosis: None,
        added: None,
        covalidation_with_effects: None,
    }
}

fn tell(outcome: &Outcome, study: &Study, console: &Console) {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "mode",
        "true Hz",
        "measured Hz",
        "± Hz",
        "error %",
        "true damping %",
        "measured %",
        "± %",
        "MAC",
    ]);
    for pair in &outcome.pairs {
        table.add_row([
            pair.number.to_string(),
            format!("{:.4}", pair.true_frequency_hz),
            format!("{:.4}", pair.frequency_hz),
            format!("{:.4}", pair.frequency_std_hz),
            format!("{:+.2}", pair.frequency_error_percent),
            format!("{:.2}", 100.0 * pair.true_damping_ratio),
            format!("{:.2}", 100.0 * pair.damping_ratio),
            format!("{:.2}", 100.0 * pair.damping_ratio_std),
            format!("{:.4}", pair.mac),
        ]);
    }
    align_right(&mut table, 9);
    console.say(format!("\n{table}"));
    for frequency_hz in &outcome.missed_hz {
        console.say(format!("Not found: the mode at {frequency_hz:.4} Hz."));
    }
    for frequency_hz in &outcome.spurious_hz {
        console.say(format!("Found at {frequency_hz:.4} Hz, but there is no such mode."));
    }
    console.say(format!("{}\n", summary(&outcome.report)));
    console.say(format!("Pictures: {}", results_folder(study).join("singular_values.svg").display()));
    console.say(format!("          {}", results_folder(study).join("mode_shapes.svg").display()));
}
