//! `belfry profile`: what the measurement says of the stiffness and mass of the model's segments and groups.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, in_shell, next_lines, p_is, unit_text, values_text, with_std};
use crate::diagnose::steps::Profiles;
use crate::diagnose::{Profile, ProfileSegment, QuantityProfile};
use crate::story::Project;

const EXAMPLES: &str = "Examples:
  belfry profile canton                                after `belfry identify canton`
  belfry profile canton --with added-mass@442.5m       if the model had this effect
  belfry profile canton --json

The segments of a beam table, and the groups that the study names ([[model.group]]), are fitted together with the effects in the model, within the tolerance that the study states (background_stiffness and background_mass in [model], std of a group). Changes are in percent of the table, or of the group, with one standard deviation; the last rows are that deviation before anything was measured, as stated and, where the data ask for another, as fitted. In brackets stands what the measurement says next to nothing of: a deviation that it lowers by less than a tenth.

Writes profile.json, profile.csv (factors of every segment and group, with and without effects) and profile.svg into `results`. The study stays as it is.";

/// Show stiffness and mass over the height, as fitted, with standard deviations
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Fit one effect more, without putting it into the model
    #[arg(long, value_name = "KIND[@WHERE]")]
    pub with: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// When the study, its model or its modes cannot be read, the model has neither segments nor groups, or the effects cannot be fitted.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    console.warn_all(&project.case()?.warnings);
    let with = arguments.with.as_deref();
    let profiles = console.with_progress(|on_progress| project.profile(with, on_progress))?;
    tell(&profiles, &project, console);
    console.json("profile-1", &profiles)
}

fn tell(profiles: &Profiles, project: &Project, console: &Console) {
    let study = project.study();
    let profile = profiles.present();
    let with = if profile.effects.is_empty() { String::new() } else { format!(" with {}", profile.effects.join(", ")) };
    let of =
        if profile.quantities.is_empty() { "the groups of the model" } else { "stiffness and mass over the height" };
    console.say(format!("\n{}: {of}, as fitted{with}", study.structure.name));
    if !profile.quantities.is_empty() {
        console.say(table(profile));
    }
    if !profile.groups.is_empty() {
        console.say(groups(profile));
    }
    let of = if profile.quantities.is_empty() { "group" } else { "table" };
    console.say(format!("In % of the {of}, ± one standard deviation. In brackets: hardly measured."));
    if let Some(masses) = &profile.masses {
        let [x, y] = &masses.offset;
        let text = |estimate: &_| values_text(std::slice::from_ref(estimate));
        console.say(format!("Centres of mass off the axis: {} along X, {} along Y.", text(x), text(y)));
    }
    if let Some(sections) = &profile.sections {
        let ratio = values_text(std::slice::from_ref(&sections.narrowing));
        console.say(format!("Sections narrow in bending with a Poisson's ratio of {ratio}; floors make it 0."));
    }
    for value in profile.joint.iter().flat_map(|joint| &joint.values) {
        let estimate = with_std(value.value, value.std);
        console.say(format!("{}: {} {estimate}{}", value.effect, value.parameter, unit_text(&value.unit)));
    }
    profile.joint.iter().flat_map(|joint| joint.in_words()).for_each(|sentence| console.say(sentence + "."));
    let (test, discrepancy) = (profile.goodness_of_fit, profile.discrepancy);
    let missed = discrepancy.missed_in_words().map(|missed| format!("the model misses {missed}"));
    let allowed: Vec<String> = [discrepancy.scatter_in_words(), missed].into_iter().flatten().collect();
    console.say(format!(
        "Chi-squared {:.0} over {} numbers, {}{}{}.",
        test.chi_squared,
        test.degrees_of_freedom,
        p_is(test.p_value),
        if allowed.is_empty() { "" } else { "; that allows that " },
        allowed.join(" and ")
    ));
    console.say(format!("Picture: {}", project.results().path("profile.svg").display()));
    if profiles.with_effects.is_none() {
        let folder = in_shell(&study.folder);
        let purpose = "an effect that the model lacks bends the profile";
        console.say(next_lines(&[(format!("diagnose {folder}"), purpose)]));
    }
}

/// Heights in the table.
const MOST_ROWS: usize = 10;
/// A deviation that is lowered by less than this share of it says next to nothing.
const HARDLY: f64 = 0.1;

/// Changes in percent at a few heights, the highest first, and the tolerance.
fn table(profile: &Profile) -> Columns {
    let names: Vec<String> =
        profile.quantities.iter().map(|one| one.quantity.name().replace('_', " ") + " %").collect();
    let mut table = Columns::new(std::iter::once("height m").chain(names.iter().map(String::as_str))).expendable(&[2]);
    let segments = profile.quantities.first().map_or(0, |one| one.segments.len());
    let rows = segments.min(MOST_ROWS);
    let at = |row: usize| if rows > 1 { row * (segments - 1) / (rows - 1) } else { 0 };
    for index in (0..rows).rev().map(at) {
        let Some(first) = profile.quantities.first().and_then(|one| one.segments.get(index)) else { continue };
        // Metres say enough of a tall structure, and leave room.
        let places = if first.z_top_m < 100.0 { 1 } else { 0 };
        let height = format!("{:.places$} - {:.places$}", first.z_bottom_m, first.z_top_m);
        let cells = profile.quantities.iter().map(|one| one.segments.get(index).map_or_else(dash, cell));
        table.row(std::iter::once(height).chain(cells));
    }
    let scatter = profile.discrepancy.scatter;
    let before = |times: f64| -> Vec<String> {
        let tolerance = |one: &QuantityProfile| 100.0 * one.prior_std() * times / scatter;
        profile.quantities.iter().map(|one| format!("± {:.1}", tolerance(one))).collect()
    };
    table.row(std::iter::once("study.toml".to_owned()).chain(before(1.0)));
    if profile.discrepancy.scatter_in_words().is_some() {
        table.row(std::iter::once(format!("times {scatter:.1}")).chain(before(scatter)));
    }
    table
}

/// Changes of groups in percent, the highest first where heights are known.
fn groups(profile: &Profile) -> Columns {
    let mut table = Columns::new(["group", "height m", "change %", "study.toml"]).expendable(&[1]);
    for group in profile.groups_from_the_top().into_iter().map(|at| &profile.groups[at]) {
        let height = match group.span_m {
            Some([low, high]) if low == high => format!("{low:.1}"),
            Some([low, high]) => format!("{low:.1} - {high:.1}"),
            None => dash(),
        };
        let change = percent_with_std(group.factor, group.std, group.prior_std);
        let stated = 100.0 * group.prior_std / profile.discrepancy.scatter;
        table.row([group.name.clone(), height, change, format!("± {stated:.1}")]);
    }
    table
}

fn dash() -> String {
    "-".to_owned()
}

fn cell(segment: &ProfileSegment) -> String {
    if segment.given.is_none() {
        return dash();
    }
    percent_with_std(segment.factor, segment.std, segment.prior_std)
}

/// In brackets where the measurement says next to nothing.
fn percent_with_std(factor: f64, std: f64, prior_std: f64) -> String {
    let percent = 100.0 * (factor - 1.0);
    let change = if percent.abs() < 0.05 { "0.0".to_owned() } else { format!("{percent:+.1}") };
    let text = format!("{change} ± {:.1}", 100.0 * std);
    if std > (1.0 - HARDLY) * prior_std { format!("({text})") } else { text }
}
