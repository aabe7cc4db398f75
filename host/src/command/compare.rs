//! `belfry compare`: the model against the measured modes, and where it fails.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, in_shell, mac_text, next_lines, or_dash, p_is, width};
use crate::compare::{Comparison, Side};
use crate::diagnose::FAILS;
use crate::model::{Body, Freedoms};
use crate::numbers::signed;
use crate::story::{Case, Project};

const EXAMPLES: &str = "Examples:
  belfry compare canton                        after `belfry identify canton`
  belfry compare bridge                        a study with [measured] modes of another tool
  belfry compare canton --json

Modes are paired by shape and frequency together. z is the frequency's error in standard deviations of the measurement. Misfit is the difference of the shapes in shares of their RMS component. COMAC is 1 where a sensor fits in all modes. chi-squared weighs every difference by the measurement's deviations and, with background_stiffness and background_mass in [model], by the model's own tolerance.

Writes comparison.json and comparison.svg into `results`.";

/// Compare the model with the measured modes: where it fails
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// When the study, its model or its modes cannot be read, or do not go together.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    let comparison = compare_project(&mut project, console)?;
    console.json("compare-1", &comparison)?;
    if comparison.mean_mac.is_some() {
        let study = in_shell(&project.study().folder);
        console.say(next_lines(&[
            (format!("diagnose {study}"), "which physical effect the model lacks"),
            (format!("update {study}"), "the paper's direct update of the stiffness matrix"),
        ]));
    }
    Ok(())
}

/// Compares and tells.
pub(super) fn compare_project(project: &mut Project, console: &Console) -> anyhow::Result<Comparison> {
    let compared = project.compare()?;
    let case = project.case()?;
    console.warn_all(&case.warnings);
    tell(&compared.comparison, case, console);
    console.warn_all(&compared.comparison.warnings);
    if let Some(picture) = compared.picture {
        console.detail(format!("Picture: {}", picture.display()));
    }
    Ok(compared.comparison)
}

fn tell(comparison: &Comparison, case: &Case, console: &Console) {
    let effects = case.effect_names();
    let with = if effects.is_empty() { String::new() } else { format!(", with {}", effects.join(", ")) };
    console.say(format!("\n{}: model{with} against {}", case.study.structure.name, case.measured.file.display()));
    let assembly = &case.assembly;
    let extent = assembly
        .node_elevations_m()
        .last()
        .map_or(String::new(), |top_m| format!(", from {} m to {top_m} m", assembly.z_base_m()));
    console.say(match case.model.freedoms() {
        Freedoms::Reduced => format!(
            "The model has {} degrees of freedom, reduced to {} coordinates: modes and static corrections.",
            assembly.rows(),
            assembly.dofs()
        ),
        Freedoms::Modes => format!("The model is known by its modes, at {} places.", assembly.rows()),
        Freedoms::Own => format!("The model has {} degrees of freedom{extent}.", assembly.dofs()),
    });
    let close = comparison.pairs.iter().any(|pair| pair.subspace_mac.is_some());
    let mut header = vec!["mode", "measured Hz", "model", "model Hz", "error %", "z", "MAC"];
    header.extend(close.then_some("MAC of close modes together"));
    let mut table = Columns::new(header).expendable(&[5, 2]);
    for pair in &comparison.pairs {
        let mut row = vec![
            pair.measured.to_string(),
            format!("{:.4}", pair.measured_hz),
            pair.model.to_string(),
            format!("{:.4}", pair.model_hz),
            signed(pair.frequency_error_percent, 2),
            pair.frequency_z.map_or_else(|| "-".to_owned(), |z| signed(z, 1)),
            mac_text(pair.mac, 4),
        ];
        row.extend(close.then(|| mac_text(pair.subspace_mac, 4)));
        table.row(row);
    }
    console.detail(table);
    match (comparison.mean_abs_frequency_error_percent, comparison.mean_mac) {
        (Some(error), Some(mac)) => console.say(format!("Mean frequency error {error:.2} %, mean MAC {mac:.4}.")),
        (Some(error), None) => console.say(format!("Mean frequency error {error:.2} %; no shapes were measured.")),
        (None, _) if case.measured.modes.iter().any(|mode| mode.shape.is_some()) => {
            let numbering = match case.model.body {
                Body::Matrices(_) => ", and whether rows are numbered as the matrices have them",
                Body::Beam(_) => "",
            };
            console.say(format!(
                "No measured mode resembles any of the model's: check units, heights and azimuths{numbering}."
            ));
        }
        (None, _) => console.say("No measured frequency is near one of the model's: check units."),
    }
    tell_unpaired(comparison, console);
    tell_where(comparison, console);
    tell_test(comparison, case, console);
}

fn tell_unpaired(comparison: &Comparison, console: &Console) {
    for mode in &comparison.unpaired {
        let whose = if mode.side == Side::Measured { "Measured mode" } else { "Model mode" };
        let like = match (mode.nearest, mode.nearest_mac) {
            (Some(number), Some(mac)) => {
                let other = if mode.side == Side::Measured { "model" } else { "measured" };
                format!("; it resembles {other} mode {number} most (MAC {mac:.2})")
            }
            _ => String::new(),
        };
        console.say(format!("{whose} {} at {:.4} Hz has no partner{like}.", mode.number, mode.frequency_hz));
    }
}

/// How many sensors are named as the worst.
const WORST_SENSORS: usize = 6;
/// Columns of text before a bar.
const BEFORE_BAR: f64 = 60.0;
/// Columns of the longest bar.
const BAR: f64 = 30.0;

fn tell_where(comparison: &Comparison, console: &Console) {
    if comparison.pairs.is_empty() {
        return;
    }
    console.say("\nWhere it fails");
    let worst = |value: &dyn Fn(usize) -> Option<f64>| {
        let values = (0..comparison.pairs.len()).filter_map(|index| Some((index, value(index)?)));
        values.max_by(|a, b| a.1.total_cmp(&b.1)).and_then(|(index, _)| comparison.pairs.get(index))
    };
    if let Some(pair) = worst(&|index| Some(comparison.pairs[index].frequency_error_percent.abs())) {
        console.say(format!(
            "  by mode: frequency worst in mode {} at {:.4} Hz ({} %)",
            pair.measured,
            pair.measured_hz,
            signed(pair.frequency_error_percent, 2)
        ));
    }
    if let Some(pair) = worst(&|index| comparison.pairs[index].mac.map(|mac| -mac)) {
        console.say(format!(
            "           shape worst in mode {} at {:.4} Hz (MAC {})",
            pair.measured,
            pair.measured_hz,
            mac_text(pair.mac, 4)
        ));
    }
    let mut sensors: Vec<_> = comparison.by_sensor.iter().collect();
    sensors.sort_by(|a, b| b.misfit.total_cmp(&a.misfit));
    // As long as fits behind the text.
    let bar = width().map_or(BAR, |width| (f64::from(width) - BEFORE_BAR).clamp(5.0, BAR));
    let largest = sensors.first().map_or(1.0, |sensor| sensor.misfit).max(f64::MIN_POSITIVE);
    for (index, sensor) in sensors.iter().take(WORST_SENSORS).enumerate() {
        console.detail(format!(
            "  {:10} channel {:>8}  misfit {:5.3}  COMAC {}  {}",
            if index == 0 { "by sensor:" } else { "" },
            sensor.channel,
            sensor.misfit,
            or_dash(sensor.comac, 3),
            "▪".repeat((bar * sensor.misfit / largest).round() as usize)
        ));
    }
    let groups = comparison.by_group.iter().map(|of| (of.group.clone(), of.misfit));
    tell_places("by group:", &groups.collect::<Vec<_>>(), bar, console);
    if !comparison.groups_without_sensors.is_empty() && !console.is_brief() {
        console.say(format!(
            "  no sensor at group {}; `channels` in a [[model.group]] says which sensors stand at it",
            comparison.groups_without_sensors.join(", ")
        ));
    }
    let heights = comparison.by_height.iter().rev().map(|of| (format!("{:9.2} m", of.elevation_m), of.misfit));
    tell_places("by height:", &heights.collect::<Vec<_>>(), bar, console);
}

/// A line for each place and its misfit; where only the story is told, the worst place is enough.
fn tell_places(label: &str, places: &[(String, f64)], bar: f64, console: &Console) {
    let largest = places.iter().map(|(_, misfit)| *misfit).fold(f64::MIN_POSITIVE, f64::max);
    let is_told = |(_, misfit): &&(String, f64)| !console.is_brief() || *misfit >= largest;
    for (index, (place, misfit)) in places.iter().filter(is_told).enumerate() {
        console.say(format!(
            "  {:10} {place:17}   misfit {misfit:5.3}               {}",
            if index == 0 { label } else { "" },
            "▪".repeat((bar * misfit / largest).round() as usize)
        ));
    }
}

fn tell_test(comparison: &Comparison, case: &Case, console: &Console) {
    let (Some(chi_squared), Some(degrees), Some(p_value)) =
        (comparison.chi_squared, comparison.degrees_of_freedom, comparison.p_value)
    else {
        return;
    };
    let allowance = if case.tolerance.is_some() {
        "the measurement's deviations and the model's tolerance"
    } else if matches!(case.model.body, Body::Matrices(_)) {
        "the measurement's deviations alone (no [[model.group]] says how far parts of the matrices are trusted)"
    } else {
        "the measurement's deviations alone (no background_stiffness or background_mass in [model])"
    };
    let verdict = if p_value < FAILS {
        "the model as it is lies further off than they allow"
    } else {
        "they can account for what differs; `belfry diagnose` asks whether a missing effect accounts for it better"
    };
    console.say(format!(
        "\nchi-squared {chi_squared:.1} on {degrees} degrees of freedom, {}, against {allowance}: {verdict}.",
        p_is(p_value)
    ));
}
