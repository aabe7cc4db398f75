//! `belfry plan`: before anything is measured, which sensors and how long a record will find an effect.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::diagnose::kind;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::route::in_range;
use super::text::{Columns, short, unit_text, values_text};
use crate::diagnose::Estimate;
use crate::model::effect::{Effect, find, named};
use crate::plan::{ORDINARY_DAMPING, ORDINARY_NOISE_PERCENT, Obstacle, Plan, SensorOption};
use crate::story::{PlanRequest, Project};
use crate::study::Model;

const EXAMPLES: &str = "Examples:
  belfry plan canton --effect added-mass@443.6m=2e6
  belfry plan canton --effect added-mass@443.6m=2e5 --against stiffness-loss@430m
  belfry plan canton --effect base-rotation=7e-15 --hours 1,24 --places places.csv
  belfry plan canton --effect stiffness-loss@200m=0.3 --damping-ratio 0.02 --json

The study needs a model and sensors, but no recording and no modes. Modes are expected as the model has them with the effect, loads as those of `belfry simulate`. Deviations of frequencies are 1.4 times the lower bound of any method (Au 2014); those of shapes follow from noise, neighbouring modes and the number of averages. 200 measurements are drawn, with the scatter that background_stiffness and background_mass in [model] allow, and diagnosed in the linear approximation of `belfry diagnose`.

`found` is the probability that the effect stands out by 20 to 1 from the model as it is; `named` that it also does from every rival, so that the verdict is this effect. Without --against every kind of the catalogue is a rival. Both are upper bounds: a mode that is identified wrongly is not foreseen.

places.csv has a row for each place where a sensor could stand: channel,elevation_m,azimuth_deg and, off the axis, offset_x_m,offset_y_m.

Writes plan.json into `results`.";

/// Say before a measurement which effect it will find
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// The effect that the model may lack, of the size that is to be found
    #[arg(long, value_name = "KIND[@WHERE]=VALUE")]
    effect: Effect,
    /// An effect that it is to be told from; repeat for more [default: the whole catalogue]
    #[arg(long, value_name = "KIND[@WHERE]", value_parser = rival)]
    against: Vec<String>,
    /// Leave a kind of effect out; repeat for more
    #[arg(long, value_name = "KIND", value_parser = kind, conflicts_with = "against")]
    without: Vec<String>,
    /// Lengths of the record in hours
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 6.0, 24.0], value_parser = hours)]
    hours: Vec<f64>,
    /// Table of places where a sensor could stand
    #[arg(long, value_name = "FILE")]
    places: Option<PathBuf>,
    /// Sensors to add at these places, the one that helps most first
    #[arg(long, value_name = "N", default_value_t = 1, requires = "places")]
    add: usize,
    /// Damping ratio of every mode
    #[arg(long, default_value_t = ORDINARY_DAMPING, value_parser = damping_ratio)]
    damping_ratio: f64,
    /// White noise of each sensor in percent of its RMS response, both within the band
    #[arg(long, default_value_t = ORDINARY_NOISE_PERCENT, value_parser = noise_percent)]
    noise_percent: f64,
    /// Seed of what is drawn
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A number between bounds.
fn between(text: &str, least: f64, greatest: f64, expected: &str) -> Result<f64, String> {
    in_range(text.trim(), least..=greatest, &format!("{expected}, from {least} to {greatest}"))
}

fn hours(text: &str) -> Result<f64, String> {
    between(text, 0.1, 720.0, "hours")
}

fn damping_ratio(text: &str) -> Result<f64, String> {
    between(text, 1e-4, 0.5, "a damping ratio (1 is critical)")
}

fn noise_percent(text: &str) -> Result<f64, String> {
    between(text, 0.0, 1000.0, "percent")
}

/// `KIND[@WHERE]`.
fn rival(text: &str) -> Result<String, String> {
    let known = if text.contains('@') { named(text).map(drop) } else { find(text).map(drop) };
    known.map(|()| text.to_owned()).map_err(|error| error.to_string())
}

/// Runs the command.
///
/// # Errors
/// When the study, its model or the table of places cannot be read, or the effect cannot be planned for.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let project = Project::open(&arguments.study)?;
    let request = PlanRequest {
        effect: arguments.effect.clone(),
        against: arguments.against.clone(),
        without: arguments.without.clone(),
        hours: arguments.hours.clone(),
        places: arguments.places.clone(),
        add: arguments.add,
        damping_ratio: arguments.damping_ratio,
        noise_percent: arguments.noise_percent,
        seed: arguments.seed,
    };
    let plan = console.with_progress(|on_progress| project.plan(&request, on_progress))?;
    let study = project.study();
    console.warn_all(&plan.warnings);
    if study.setups.len() > 1 {
        console.warn("the sensors of all setups are taken to record together");
    }
    let is_trusted = |model: &Model| {
        model.background_stiffness.or(model.background_mass).is_none()
            && model.customs.iter().all(|one| one.group.is_none())
    };
    if study.model.as_ref().is_none_or(is_trusted) {
        console.warn("the model has no tolerance (background_stiffness and background_mass in [model], or [[model.group]]), so the plan takes it as exact");
    }
    if plan.options.iter().flat_map(|option| &option.records).any(|record| record.hours < plan.least_hours) {
        console.warn(format!(
            "below {:.1} h there are fewer than four averages of the lowest mode, and the deviations of so short a record are guesses",
            plan.least_hours
        ));
    }
    tell(&plan, &study.structure.name, console);
    console.json("plan-1", &plan)
}

fn percent(probability: f64) -> String {
    format!("{:.0} %", 100.0 * probability)
}

fn hours_text(hours: f64) -> String {
    match hours {
        hours if hours < 48.0 => format!("{hours:.1} h"),
        hours => format!("{:.0} days", hours / 24.0),
    }
}

fn tell(plan: &Plan, name: &str, console: &Console) {
    let values = match values_text(&plan.parameters).replace('\n', ", ") {
        values if values.is_empty() => values,
        values => format!(" ({values})"),
    };
    console.say(format!("\n{name}: what will a measurement show of {}{values}?", plan.effect));
    let assumed = &plan.assumed;
    console.say(format!(
        "Expected: {} modes from {:.3} to {:.3} Hz, {} % damping, {} % noise.",
        assumed.frequencies_hz.len(),
        assumed.frequencies_hz.first().copied().unwrap_or_default(),
        assumed.frequencies_hz.last().copied().unwrap_or_default(),
        short(100.0 * assumed.damping_ratio),
        short(assumed.noise_percent)
    ));
    let mut table = Columns::new(["sensors", "record", "found", "named", "strongest rival", "ln B", "over the rival"]);
    for option in &plan.options {
        for record in &option.records {
            table.row([
                sensors_text(option),
                hours_text(record.hours),
                percent(record.probability_found),
                percent(record.probability_named),
                record.strongest_rival.clone().unwrap_or_else(|| "-".to_owned()),
                format!("{:+.1}", record.log_bayes_factor),
                record.log_bayes_factor_over_rival.map_or_else(|| "-".to_owned(), |over| format!("{over:+.1}")),
            ]);
        }
    }
    console.say(table);
    if !plan.twins.is_empty() {
        console.say(format!(
            "{} does the same to every mode: no vibration test tells it from {}. They count as one here.",
            plan.twins.join(", "),
            plan.effect
        ));
    }
    for option in &plan.options {
        console.say(format!("With {}: {}", sensors_text(option), conclusion(option, plan)));
    }
}

fn sensors_text(option: &SensorOption) -> String {
    match option.added.as_slice() {
        [] => format!("{} sensors", option.sensors),
        added => format!("{} sensors, with {}", option.sensors, added.join(", ")),
    }
}

fn conclusion(option: &SensorOption, plan: &Plan) -> String {
    let wanted = percent(plan.wanted_probability);
    let longest = hours_text(plan.longest_hours);
    if let Some(hours) = option.shortest_hours {
        let or_less = if hours <= plan.least_hours { " (the shortest record considered)" } else { "" };
        return format!("{} of record{or_less} name it with {wanted}.", hours_text(hours));
    }
    let none = format!("no record up to {longest} names it with {wanted}");
    let findable = |findable_share: &Option<f64>, findable: &Option<Estimate>| match (findable, findable_share) {
        (Some(value), _) => {
            format!(" {longest} would do for {} {}{} or more.", value.name, short(value.value), unit_text(&value.unit))
        }
        (None, Some(share)) => format!(" {longest} would do for {share:.1} times as much."),
        (None, None) => String::new(),
    };
    match &option.obstacle {
        Some(Obstacle::Twins { rival }) => {
            format!(
                "{none}: {rival} does the same to all modes at these sensors. Only another kind of measurement tells them apart."
            )
        }
        Some(Obstacle::Tolerance { findable_share, findable: value }) => {
            format!("{none}: so small an effect lies within the model's tolerance.{}", findable(findable_share, value))
        }
        Some(Obstacle::Rival { rival, findable_share, findable: value }) => {
            format!("{none}: {rival} explains it too well.{}", findable(findable_share, value))
        }
        None => format!("{none}."),
    }
}
