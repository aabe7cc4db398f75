//! `belfry demo`: the whole story in one go, on a structure whose truth is known and whose model lacks something.

mod ending;
mod hidden;
mod measured;
mod tower;

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use self::ending::{Ending, Hidden};
use self::measured::Measured;
use self::tower::{Tower, write_study};
use super::Console;
use super::compare::compare_project;
use super::covalidate::covalidate_project;
use super::diagnose::{diagnose_project, tell_verdict};
use super::history::show_history;
use super::identify::{summary, tell_warnings};
use super::interrupt::leave_nothing_unfinished;
use super::paper;
use super::report::open;
use super::route::in_range;
use super::steps::tell_change;
use super::text::{in_shell, next_lines};
use super::update::update_project;
use crate::compare::Comparison;
use crate::diagnose::{Diagnosis, Verdict};
use crate::fleet::FleetOptions;
use crate::link::memory::Faults;
use crate::measure::Route;
use crate::model::effect::{Effect, EffectRecord};
use crate::picture;
use crate::story::{
    ChangeReport, CovalidationReport, CovalidationRequest, IdentifyRequest, ModesReport, Project, UpdateReport,
    worst_channel,
};
use crate::update::Weights;

const EXAMPLES: &str = "Examples:
  belfry demo                    in the new folder belfry-demo
  belfry demo tower --hours 12   finer lines, smaller deviations
  belfry demo --seed 5           another tower with another effect
  belfry demo --effect added-mass@300m=8e6
  belfry demo --open             opens the report at the end
  belfry demo --paper            beside the tables of the paper

The tower is its model with segments that scatter by 1 to 2 %, and with one effect that the model does not know. Simulated sensor nodes, which run the real firmware, measure it and send what they find over serial lines that damage 2 % of all frames. Then the model is compared with the modes, updated as in the paper, and tested on sensors that it was not shown. The diagnosis looks for the effect and adds it, and the error falls. At the end the demo says what was hidden, and whether it was found, and writes a report of everything.

With --paper the tower is the stand-in that has the frequencies measured on the Canton Tower. Afterwards the folder is a study like any other.";

/// Share of the frames that the demo's serial lines damage.
const DAMAGED_SHARE: f64 = 0.02;

/// Run the whole story on a simulated tower that hides an effect
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Folder for the demo's study
    #[arg(value_name = "DIR", default_value = "belfry-demo")]
    pub folder: PathBuf,
    /// Hours of recording
    #[arg(long, default_value_t = 4.0, value_parser = hours)]
    pub hours: f64,
    /// Seed of load, noise, clocks and damage
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The effect to hide [default: drawn by the seed]
    #[arg(long, value_name = "KIND[@WHERE]=VALUE", conflicts_with = "paper")]
    pub effect: Option<Effect>,
    /// Open the report in the browser at the end
    #[arg(long)]
    pub open: bool,
    /// The stand-in that has the frequencies measured on the Canton Tower, beside the tables of the paper
    #[arg(long)]
    pub paper: bool,
}

fn hours(text: &str) -> Result<f64, String> {
    in_range(text, 0.2..=240.0, "a number of hours from 0.2 to 240")
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Outcome {
    study: String,
    #[serde(flatten)]
    measured: Measured,
    #[serde(flatten)]
    report: ModesReport,
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
    /// What the model with the effect lacks.
    #[serde(skip_serializing_if = "Option::is_none")]
    diagnosis_with_effects: Option<Diagnosis>,
    /// Whether what was hidden was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    ending: Option<Ending>,
}

/// Runs the command.
///
/// # Errors
/// When the folder holds another study, or cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let tower = match arguments.paper {
        true => Tower::of_paper()?,
        false => Tower::with_hidden(arguments.effect.as_ref(), arguments.seed)?,
    };
    let (study, _lock) = write_study(&arguments.folder, console)?;
    console.say(format!(
        "A synthetic stand-in for the Canton Tower, {} h at 50 Hz, 20 accelerometers on 8 sensor nodes.",
        arguments.hours
    ));
    if !arguments.paper {
        console.say(
            "Its segments differ from the model's by 1 to 2 %, and it has one effect that the model does not know.",
        );
    }
    let truth = tower.record(&study, arguments.hours, arguments.seed, console)?;
    let faults = Faults::damaging(DAMAGED_SHARE);
    let route = Route::Nodes(FleetOptions { faults, seed: arguments.seed, ..FleetOptions::default() });
    let mut project = Project::open(&study.folder)?;
    let report = console.with_progress(|on_progress| project.identify(&IdentifyRequest::by(route), on_progress))?;
    tell_warnings(&report, console);
    let modes = &report.identification;
    let measured = Measured::of(&modes.modes, &truth, study.analysis.band_hz.unwrap_or([0.0, f64::INFINITY]));
    if let Some(picture) = picture::mode_shapes(&study.structure.name, &study.setups, modes, &measured.shapes)? {
        project.results().write("mode_shapes.svg", picture.as_bytes())?;
    }
    measured.tell(console);
    console.say(summary(&report));
    let mut outcome = Outcome {
        study: study.folder.display().to_string(),
        measured,
        report,
        comparison: None,
        update: None,
        covalidation: None,
        hidden: tower.effects.iter().map(Effect::record).collect(),
        diagnosis: None,
        added: None,
        covalidation_with_effects: None,
        diagnosis_with_effects: None,
        ending: None,
    };
    // The commands one by one say more.
    let brief = console.brief();
    hold_model(&mut outcome, &mut project, route, arguments.paper, &brief)?;
    if let (false, [effect]) = (arguments.paper, &tower.effects[..]) {
        find_effect(&mut outcome, &mut project, &Hidden { effect, beam: &tower.beam }, route, &brief)?;
    }
    let report = project.report(None)?.file;
    console.say(format!("\nReport: {}, all of this in pictures; open it in the browser", report.display()));
    if arguments.open {
        open(&report)?;
    }
    let folder = in_shell(&study.folder);
    console.say(next_lines(&[
        (format!("serve {folder} --open"), "in the browser, with next steps"),
        (format!("compare {folder}"), "step by step; all have --json"),
        (format!("identify {folder} --direct"), "modes without nodes and link"),
    ]));
    console.json("demo-1", &outcome)
}

/// Sensors that the paper leaves out of its co-validation.
const LEFT_OUT: [&str; 2] = ["09", "12"];

/// The model that does not know what the tower has, against what was measured: compared, updated, co-validated.
fn hold_model(
    outcome: &mut Outcome,
    project: &mut Project,
    route: Route,
    beside_paper: bool,
    console: &Console,
) -> anyhow::Result<()> {
    heading("The model against the measurement (belfry compare)", console);
    let comparison = compare_project(project, console)?;
    if comparison.pairs.is_empty() {
        return Ok(());
    }
    heading("The paper's direct update (belfry update)", console);
    let update = update_project(project, &[], &Weights::default(), console)?;
    heading("Sensors that the model was not shown (belfry covalidate)", console);
    let left_out = match beside_paper {
        true => LEFT_OUT.map(str::to_owned).to_vec(),
        false => worst_channel(project.case()?, &comparison)?.into_iter().collect(),
    };
    let covalidation = covalidate_project(project, &CovalidationRequest::of_channels(left_out, route), console)?;
    if beside_paper {
        heading("Beside the paper: Lei, Wang, Shen (2012)", console);
        console.say(paper::tables(&update, &covalidation)?);
    }
    outcome.comparison = Some(comparison);
    outcome.update = Some(update);
    outcome.covalidation = Some(covalidation);
    Ok(())
}

/// What the model lacks: found, added, the error falls, and the truth is told.
fn find_effect(
    outcome: &mut Outcome,
    project: &mut Project,
    hidden: &Hidden<'_>,
    route: Route,
    console: &Console,
) -> anyhow::Result<()> {
    heading("Which physical effect is missing? (belfry diagnose)", console);
    let diagnosis = diagnose_project(project, &[], console)?;
    if let Some(name) = ending::to_add(&diagnosis) {
        heading(&format!("Into the model with it (belfry add {name})"), console);
        if diagnosis.verdict == Verdict::Unknown {
            console.say(format!(
                "The verdict is unknown. The demo adds {name}, which explains most, to show what it does."
            ));
        }
        match console.with_progress(|on_progress| project.add(&name, on_progress)) {
            Ok(report) => {
                tell_change(&report, project.study(), console);
                // Co-validation stands on the update, and report and pictures show the model as it is now.
                project.compare()?;
                if outcome.update.is_some() {
                    project.update(&[], &Weights::default())?;
                }
                show_gain(outcome, project, route, console)?;
                show_state(outcome, project, console)?;
                outcome.added = Some(report);
            }
            Err(error) => console.warn(format!("{name} cannot be added: {error}")),
        }
    }
    heading("What was hidden", console);
    let ending = Ending::of(hidden, &diagnosis, outcome.added.as_ref());
    for line in &ending.sentences {
        console.say(line);
    }
    outcome.diagnosis = Some(diagnosis);
    outcome.ending = Some(ending);
    Ok(())
}

/// What the left-out sensors and the history say of the effect that was added.
fn show_gain(outcome: &mut Outcome, project: &mut Project, route: Route, console: &Console) -> anyhow::Result<()> {
    heading("The left-out sensors again, with the effect (belfry covalidate)", console);
    let before = outcome.covalidation.iter().flat_map(|report| &report.channels);
    let left_out: Vec<String> = before.map(|channel| channel.channel.clone()).collect();
    let request = CovalidationRequest::of_channels(left_out, route);
    outcome.covalidation_with_effects = Some(covalidate_project(project, &request, console)?);
    heading("How the error fell (belfry history)", console);
    show_history(project, console)?;
    Ok(())
}

/// Whether anything else is missing, and what the segments are like.
fn show_state(outcome: &mut Outcome, project: &mut Project, console: &Console) -> anyhow::Result<()> {
    heading("Is anything else missing? (belfry diagnose)", console);
    let diagnosis = console.with_progress(|on_progress| project.diagnose(&[], on_progress))?;
    tell_verdict(&diagnosis, console);
    outcome.diagnosis_with_effects = Some(diagnosis);
    heading("Stiffness and mass over the height (belfry profile)", console);
    console.with_progress(|on_progress| project.profile(None, on_progress))?;
    console.say(format!(
        "Picture: {}, as fitted, without the effect and with it",
        project.results().path("profile.svg").display()
    ));
    Ok(())
}

fn heading(text: &str, console: &Console) {
    console.say(format!("\n{text}\n{}", "─".repeat(text.chars().count())));
}
