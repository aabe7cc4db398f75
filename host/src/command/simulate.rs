//! `belfry simulate`: recordings of a study's setups from a structure whose truth is known.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use serde::Serialize;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::route::in_range;
use super::text::{in_shell, next_lines};
use crate::files::write_whole;
use crate::model::effect::Effect;
use crate::model::{BeamTable, Body, Freedoms, Structure, load_up_to, read_beam};
use crate::numbers::counted;
use crate::simulate::{Options, PlannedRecording, Simulation, Truth, adopt, plan, scatter_groups, scattered};
use crate::study::{Model, Study};

const EXAMPLES: &str = "Examples:
  belfry simulate canton --effect base-rotation=7.21e-15 --hours 24 --seed 1
  belfry simulate canton --effect added-mass@443.6m=2e5 --effect mass-scale=0.02
  belfry simulate canton --effect base-rotation=flexibility_x=1e-14,flexibility_y=5e-15
  belfry simulate canton --effect sensor-polarity@07 --scatter 0.7 --adopt
  belfry simulate bridge --effect group@span2=-0.2 --adopt
  belfry simulate canton --beam tower_as_built.csv --output recordings --force

A tower is clamped at its base unless an effect frees it. White noise loads the structure at all nodes, coherent over a tenth of the height (of its longest side, where nodes do not stand above each other); the top of the Canton Tower's body then moves by about 3e-4 m/s² RMS. truth.json holds what identification should find. Interrupted, the command leaves no unfinished recording behind.";

/// Simulate recordings of a structure with effects that the model lacks
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder; every setup gets a recording
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// An effect in the simulated structure; repeat for more
    #[arg(long = "effect", value_name = "KIND[@WHERE]=VALUE")]
    effects: Vec<Effect>,
    /// Length of each recording in hours
    #[arg(long, default_value_t = 1.0, value_parser = hours)]
    hours: f64,
    /// Seed of load and noise: the same seed gives the same bytes
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Beam table of the simulated structure [default: the study's model]
    #[arg(long, value_name = "FILE")]
    beam: Option<PathBuf>,
    /// Scatter the segments smoothly over the height, and groups each by itself, by this many standard deviations of what they are trusted to
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = scatter)]
    scatter: f64,
    /// Seed of that scatter, for one structure under several loads [default: --seed]
    #[arg(long, value_name = "SEED", requires = "scatter")]
    scatter_seed: Option<u64>,
    /// Damping ratio of every mode
    #[arg(long, default_value_t = Options::default().damping_ratio)]
    damping_ratio: f64,
    /// White sensor noise in percent of each channel's RMS
    #[arg(long, default_value_t = Options::default().noise_percent)]
    noise_percent: f64,
    /// Distance in m at which two loads have the correlation 1/e; 0 for independent loads [default: a tenth of the height]
    #[arg(long, value_name = "M", value_parser = length)]
    coherence_m: Option<f64>,
    /// Folder for recordings and truth.json [default: the study's]
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Overwrite recordings and truth.json that are there
    #[arg(long)]
    force: bool,
    /// Put the recordings into the setups' `files` in study.toml (comments and order stay)
    #[arg(long)]
    adopt: bool,
}

#[derive(Serialize)]
struct Outcome {
    recordings: Vec<Recording>,
    truth: Truth,
    /// Where the truth stands as a file.
    truth_file: PathBuf,
}

#[derive(Serialize)]
struct Recording {
    setup: String,
    file: PathBuf,
    rows: u64,
    sampling_rate_hz: f64,
    /// Expected RMS of each channel without noise, in the setup's unit.
    channel_rms: Vec<f64>,
    /// What the setup's `files` must hold for the study to read it; null where it does.
    put_into_study: Option<String>,
}

fn scatter(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=5.0, "a number from 0 to 5")
}

fn length(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=1e6, "a length in m, 0 or above")
}

fn hours(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(hours) if hours > 0.0 && hours <= 10_000.0 => Ok(hours),
        _ => Err("expected hours, above 0 and at most 10000".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// What cannot be read, does not fit the structure, or would be overwritten.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let is_in_study = arguments.output.is_none() || arguments.adopt;
    let _lock = if is_in_study { alone(&arguments.study, console)? } else { None };
    let study = Study::load(&arguments.study)?;
    if study.model.as_ref().is_some_and(|model| !model.effects.is_empty()) {
        console.warn("the [[model.effect]] of study.toml are not in the simulated structure; name them with --effect");
    }
    let structure = simulated(&study, arguments)?;
    let sensors = study.sensors();
    let effects = arguments.effects.iter().map(|effect| effect.in_study(&sensors)).collect::<Result<Vec<_>, _>>()?;
    if let Some(effect) = effects.iter().find(|effect| effect.of_kind().is_of_the_study())
        && arguments.beam.is_some()
    {
        bail!(
            "{effect} is of the study's model, not of the simulated structure; change the beam table that --beam names instead"
        );
    }
    let assembly = structure.and(&effects)?.assemble();
    let planned = plan(&study, arguments.output.as_deref())?;
    let truth_file = arguments.output.as_ref().unwrap_or(&study.folder).join("truth.json");
    refuse_overwriting(arguments, &planned, &truth_file)?;

    // All of them before the first file: a sensor off the structure should not leave half of the recordings.
    let mut simulations = Vec::new();
    for (setup, stream) in study.setups.iter().zip(0u32..) {
        let options = Options {
            damping_ratio: arguments.damping_ratio,
            noise_percent: arguments.noise_percent,
            coherence_length_m: arguments.coherence_m,
            seed: arguments.seed,
            stream,
            ..Options::default()
        };
        simulations.push(Simulation::new(&assembly, &effects, setup, &options)?);
    }
    let truth = Truth::joined(simulations.iter().map(Simulation::truth)).context("the study has no setups")?;

    let mut recordings = Vec::new();
    for (simulation, recording) in simulations.iter_mut().zip(&planned) {
        let sampling_rate_hz = simulation.sampling_rate_hz();
        let rows = ((arguments.hours * 3600.0 * sampling_rate_hz).round() as u64).max(1);
        let bar = console.progress(rows, &recording.setup);
        simulation.write(&recording.path, rows, |made| bar.inc(made))?;
        bar.finish_and_clear();
        recordings.push(Recording {
            setup: recording.setup.clone(),
            file: recording.path.clone(),
            rows,
            sampling_rate_hz,
            channel_rms: simulation.channel_rms().to_vec(),
            put_into_study: recording.adopt_as.clone().filter(|_| !arguments.adopt),
        });
    }
    write_whole(&truth_file, (serde_json::to_string_pretty(&truth)? + "\n").as_bytes())
        .with_context(|| format!("{}: cannot be written", truth_file.display()))?;
    if arguments.adopt {
        adopt(&study.folder, &planned)?;
    }

    let outcome = Outcome { recordings, truth, truth_file };
    tell(&outcome, console);
    if outcome.recordings.iter().all(|recording| recording.put_into_study.is_none()) {
        let study = in_shell(&study.folder);
        console.say(next_lines(&[(format!("identify {study}"), "the modes of the recording")]));
    }
    console.json("simulate-1", &outcome)
}

/// The structure without the effects that are asked for: the study's model, or the beam table that is named, scattered where that is asked for.
fn simulated(study: &Study, arguments: &Arguments) -> anyhow::Result<Structure> {
    let model = study.model.as_ref();
    let seed = arguments.scatter_seed.unwrap_or(arguments.seed);
    if arguments.scatter > 0.0 {
        let has_deviations = |model: &Model| {
            model.background_stiffness.or(model.background_mass).is_some()
                || (arguments.beam.is_none() && model.customs.iter().any(|custom| custom.group.is_some()))
        };
        if !model.is_some_and(has_deviations) {
            bail!("--scatter needs background_stiffness or background_mass in [model], or a [[model.group]]");
        }
    }
    let scattered = |beam: BeamTable| match model.filter(|_| arguments.scatter > 0.0) {
        Some(model) => scattered(beam, model, arguments.scatter, seed),
        None => beam,
    };
    if let Some(beam) = &arguments.beam {
        return Ok(Structure::new(scattered(read_beam(beam)?)));
    }
    if model.is_none() {
        bail!("the study has no [model]; name the structure's beam table with --beam FILE");
    }
    let highest_hz = study.setups.iter().map(|setup| 0.5 * setup.sampling_rate_hz).reduce(f64::max);
    let loaded = load_up_to(study, highest_hz)?;
    if loaded.freedoms() == Freedoms::Modes {
        bail!(
            "the study's model is known by its modes alone, which say nothing of its masses; simulate with your own program, or name a beam table with --beam FILE"
        );
    }
    let body = match loaded.body {
        Body::Beam(beam) => Body::Beam(scattered(beam)),
        matrices @ Body::Matrices(_) => matrices,
    };
    let mut structure = Structure::new(body).with_customs(loaded.customs);
    if arguments.scatter > 0.0 {
        scatter_groups(&mut structure, arguments.scatter, seed);
    }
    Ok(structure)
}

fn refuse_overwriting(
    arguments: &Arguments,
    planned: &[PlannedRecording],
    truth_file: &std::path::Path,
) -> anyhow::Result<()> {
    let mut files = planned.iter().map(|recording| recording.path.as_path()).chain([truth_file]);
    match files.find(|file| file.exists()) {
        Some(file) if !arguments.force => {
            bail!("{} is there already; --force overwrites it, --output DIR writes elsewhere", file.display())
        }
        _ => Ok(()),
    }
}

fn tell(outcome: &Outcome, console: &Console) {
    for recording in &outcome.recordings {
        console.say(format_args!(
            "{}: {} at {} Hz in {}",
            recording.setup,
            counted(recording.rows, "row"),
            recording.sampling_rate_hz,
            recording.file.display()
        ));
        if let Some(files) = &recording.put_into_study {
            console.say(format_args!(
                "  to have the study read it, put files = [\"{files}\"] into setup {} of study.toml, or run with --adopt",
                recording.setup
            ));
        }
    }
    let lowest: Vec<_> = outcome.truth.modes.iter().take(12).map(|mode| format!("{:.4}", mode.frequency_hz)).collect();
    console.say(format_args!(
        "{} modes, the lowest at {} Hz; all in {}",
        outcome.truth.modes.len(),
        lowest.join(", "),
        outcome.truth_file.display()
    ));
}
