//! `belfry update`: the direct update of the stiffness matrix by Psi.

use std::path::PathBuf;

use clap::Args;

use super::Console;
use super::interrupt::{alone, leave_nothing_unfinished};
use super::text::{Columns, in_shell, mac_text, next_lines, p_is};
use crate::model::{Body, Freedoms};
use crate::numbers::signed;
use crate::story::{Case, Project, UpdateReport};
use crate::update::Weights;

const EXAMPLES: &str = "Examples:
  belfry update canton                      all modes that have a partner
  belfry update canton --modes 1,2,3,4,5    these only
  belfry update canton --shape-weights 1    every shape weighs the same
  belfry update canton --json > update.json

K* = K + M Phi1 Psi Phi1ᵀ M (Lei, Wang, Shen 2012, eqs. 8 to 14) meets the used frequencies exactly and turns the used shapes within their own span; every other mode stays as it is.

Writes update.json, stiffness_updated.mtx (and .npy) and mass.mtx into `results`, for a beam table also nodes.csv: together they are a model for [model] matrices. Of a model of many degrees of freedom it writes stiffness.mtx, mass.mtx, update_factor.npy (F = M Phi1) and psi.npy: K* = K + F Psi F^T.";

/// Update the model's stiffness matrix directly (Psi)
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// The study's folder
    #[arg(value_name = "STUDY")]
    pub study: PathBuf,
    /// Numbers of the measured modes to use, as in 1,2,5 [default: all that have a partner]
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    pub modes: Vec<usize>,
    /// Weight of frequencies in the objective; it changes the objective's value alone, as frequencies are met exactly
    #[arg(long, value_name = "WEIGHT", default_value_t = 10.0, value_parser = weight)]
    pub frequency_weight: f64,
    /// Weights of shapes: one for all, two for the lower and the upper half of the modes, or one a mode
    #[arg(long, value_name = "WEIGHTS", value_delimiter = ',', default_values_t = [2.0, 0.5], value_parser = weight)]
    pub shape_weights: Vec<f64>,
}

fn weight(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(weight) if weight > 0.0 && weight.is_finite() => Ok(weight),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// When the study cannot be read, no mode has a partner, or a result cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    leave_nothing_unfinished()?;
    let _lock = alone(&arguments.study, console)?;
    let mut project = Project::open(&arguments.study)?;
    let weights = Weights { frequency: arguments.frequency_weight, shape: arguments.shape_weights.clone() };
    let report = update_project(&mut project, &arguments.modes, &weights, console)?;
    console.json("update-1", &report)?;
    if !project.study().setups.is_empty() {
        let study = in_shell(&project.study().folder);
        console.say(next_lines(&[(format!("covalidate {study}"), "predict sensors that the model is not shown")]));
    }
    Ok(())
}

/// Updates and tells.
pub(super) fn update_project(
    project: &mut Project,
    modes: &[usize],
    weights: &Weights,
    console: &Console,
) -> anyhow::Result<UpdateReport> {
    let report = project.update(modes, weights)?;
    let case = project.case()?;
    console.warn_all(&case.warnings);
    console.warn_all(&report.warnings);
    tell(&report, case, console);
    let (of_beam, freedoms) = (matches!(case.model.body, Body::Beam(_)), case.model.freedoms());
    let path = |name: &str| project.results().path(name).display().to_string();
    let nodes = if of_beam { format!(", the nodes of their rows in {}", path("nodes.csv")) } else { String::new() };
    console.detail(match freedoms {
        Freedoms::Reduced => format!(
            "The updated stiffness matrix is full, so it is written as K + F Psi F^T: K in {}, F = M Phi1 in {}, Psi in {}; the mass matrix, which stays, in {}.",
            path("stiffness.mtx"),
            path("update_factor.npy"),
            path("psi.npy"),
            path("mass.mtx")
        ),
        Freedoms::Modes => "A model of modes has no matrices to write; Psi is in update.json.".to_owned(),
        Freedoms::Own => format!(
            "The updated stiffness matrix is in {} (and .npy), the mass matrix, which stays, in {}{nodes}.",
            path("stiffness_updated.mtx"),
            path("mass.mtx")
        ),
    });
    Ok(report)
}

/// Below this probability shapes are said to differ.
const SIGNIFICANT: f64 = 0.01;
/// A cosine that is uncertain by this much could be anything.
const TOO_UNCERTAIN: f64 = 0.3;

fn tell_hints(report: &UpdateReport, console: &Console) {
    console.detail("\nWhat Psi says (hints, no diagnosis: that is `belfry diagnose`)");
    let hints = &report.hints;
    let outside = hints.span.iter().max_by(|a, b| a.outside_percent.total_cmp(&b.outside_percent));
    if let (Some(p_value), Some(worst)) = (hints.span_p_value, outside) {
        let says = if p_value < SIGNIFICANT {
            "no Psi reaches what is outside; physics or sensors that the model does not have"
        } else {
            "within their deviations"
        };
        console.detail(format!(
            "  Span: measured shapes lie up to {:.1} % of their length (mode {}) outside that of the model's, {}: {says}.",
            worst.outside_percent,
            worst.measured,
            p_is(p_value)
        ));
    }
    if let Some(test) = &hints.orthogonality {
        let says = if test.p_value < SIGNIFICANT {
            "the model's mass or the sensors differ from what the study says"
        } else if test.cosine_std > TOO_UNCERTAIN {
            "too uncertain to say anything of the model's mass"
        } else {
            "nothing contradicts the model's mass"
        };
        console.detail(format!(
            "  Orthogonality by mass: worst between modes {} and {} (cosine {:.3} ± {:.3}), {}: {says}.",
            test.worst[0],
            test.worst[1],
            test.cosine,
            test.cosine_std,
            p_is(test.p_value)
        ));
    }
    console.detail(format!("  Size of Psi: {:.2} % of the eigenvalues.", 100.0 * report.psi_size));
    for explained in &report.psi_explained {
        console.detail(format!(
            "  Without {} it is {:.2} %: the effect explains {:.0} % of Psi squared.",
            if explained.effect == "all" { "any effect" } else { &explained.effect },
            100.0 * explained.psi_size_without,
            100.0 * explained.explained
        ));
    }
}

fn tell(report: &UpdateReport, case: &Case, console: &Console) {
    console.say(format!(
        "\n{}: K* = K + M Phi1 Psi Phi1ᵀ M with {} modes at {} sensors",
        case.study.structure.name,
        report.pairs.len(),
        case.sensors.len()
    ));
    let mut table = Columns::new([
        "mode",
        "measured Hz",
        "model Hz",
        "error %",
        "updated Hz",
        "error %",
        "MAC",
        "updated",
        "ceiling",
    ])
    .expendable(&[2, 5, 4]);
    for (pair, ceiling) in report.pairs.iter().zip(&report.mac_ceiling) {
        table.row([
            pair.measured.to_string(),
            format!("{:.4}", pair.measured_hz),
            format!("{:.4}", pair.before.model_hz),
            signed(pair.before.frequency_error_percent, 2),
            format!("{:.4}", pair.after.model_hz),
            signed(pair.after.frequency_error_percent, 2),
            mac_text(pair.before.mac, 4),
            mac_text(pair.after.mac, 4),
            mac_text(*ceiling, 4),
        ]);
    }
    console.detail(table);
    let errors = report.mean_abs_frequency_error_percent;
    let macs = report.mean_mac.map_or(String::new(), |mac| format!(", mean MAC {:.3} -> {:.3}", mac.before, mac.after));
    console.say(format!(
        "Mean frequency error {:.2} -> {:.2} %{macs}; objective {:.3e}.",
        errors.before, errors.after, report.objective,
    ));
    let others: Vec<String> = report
        .other_modes
        .iter()
        .map(|other| format!("mode {} {:.4} -> {:.4} Hz", other.model, other.before_hz, other.after_hz))
        .collect();
    if !others.is_empty() {
        console.detail(format!(
            "The {} other modes of the model stay: {}{}\nTheir eigenvalues changed by at most {:.1e}, their shapes turned by at most {:.1e} (1 - MAC by mass).",
            report.other_eigenvalues,
            others.join(", "),
            if report.other_eigenvalues > others.len() { ", ..." } else { "." },
            report.max_relative_change_of_other_eigenvalues,
            report.max_turn_of_other_shapes
        ));
    }
    tell_hints(report, console);
    console.detail(
        "\nPsi is in update.json; `belfry report` draws it. Any orthogonal matrix in place of the one found would meet the frequencies just as well, so their agreement after this update is no evidence that the model is right. The MAC cannot pass its ceiling, whatever Psi is: what is missing there is not in the span of the model's shapes. `belfry covalidate` shows whether the model predicts what it was not shown.",
    );
}
