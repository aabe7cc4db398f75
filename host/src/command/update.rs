//! `belfry update`: the direct update of the stiffness matrix by Psi.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::Console;
use super::case::{Case, write_json, write_result};
use super::compare::mac_text;
use super::diagnose::p_is;
use super::identify::align_right;
use crate::compare::{ModelView, Pair, frequency_z, mac, pair};
use crate::model::effect::Effect;
use crate::model::{Assembly, Body, matrix_market, npy};
use crate::update::{Hints, Problem, Solution, Weights, hints, solve, updated};

const EXAMPLES: &str = "Examples:
  belfry update canton                              all modes that have a partner
  belfry update canton --modes 1,2,3,4,5,7,8,9,10,11    without torsion, as in the paper
  belfry update canton --shape-weights 1            every shape weighs the same
  belfry update canton --json > update.json

K* = K + M Phi1 Psi Phi1ᵀ M (Lei, Wang, Shen 2012, eqs. 8 to 14) meets the used frequencies exactly and turns the used
shapes within their own span; every other mode stays as it is. Writes update.json, stiffness_updated.mtx (and .npy) and
mass.mtx into `results`, for a beam table also nodes.csv: together they are a model for [model] matrices.";

/// The largest relative change of another eigenvalue that passes for rounding.
const UNCHANGED: f64 = 1e-9;

/// How many of the modes that the update does not use are shown.
const OTHERS_SHOWN: usize = 4;

/// Update the stiffness matrix directly (Psi), as the paper does
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

/// What `--json` prints and `results/update.json` holds.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct UpdateReport {
    /// Psi in 1/s², row by row, in the order of the pairs.
    pub psi: Vec<Vec<f64>>,
    /// The paper's objective at the solution.
    pub objective: f64,
    /// Used modes before and after.
    pub pairs: Vec<UpdatedPair>,
    /// The highest MAC that any update within the model's span can reach, pair by pair.
    pub mac_ceiling: Vec<Option<f64>>,
    /// The largest relative change of an eigenvalue of K* that was not updated.
    pub max_relative_change_of_other_eigenvalues: f64,
    /// How many such eigenvalues there are.
    pub other_eigenvalues: usize,
    /// The largest turn of another mode: 1 minus the squared cosine, by mass, of its shapes before and after.
    pub max_turn_of_other_shapes: f64,
    /// The lowest of the other modes before and after.
    pub other_modes: Vec<OtherMode>,
    /// Mean absolute frequency error of the used modes before and after.
    pub mean_abs_frequency_error_percent: BeforeAfter,
    /// Mean MAC of the used modes before and after.
    pub mean_mac: Option<BeforeAfter>,
    /// V, row by row: the updated shape of pair i is Phi1 times its column i.
    pub rotation: Vec<Vec<f64>>,
    /// Effects that were in the model.
    pub effects: Vec<String>,
    /// What the measured shapes say of the span and the mass of the model.
    pub hints: Hints,
    /// Size of Psi (Frobenius norm) in shares of that of the modes' eigenvalues.
    pub psi_size: f64,
    /// What each effect in the model spares Psi.
    pub psi_explained: Vec<PsiExplained>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// A mode that the update does not use.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct OtherMode {
    /// Number of the model's mode.
    pub model: usize,
    /// Its frequency in the model.
    pub before_hz: f64,
    /// Its frequency in the updated model.
    pub after_hz: f64,
}

/// What an effect spares Psi.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PsiExplained {
    /// The effect; `all` for all of them together.
    pub effect: String,
    /// Size of Psi without it, in shares of the modes' eigenvalues.
    pub psi_size_without: f64,
    /// Share of the square of that which the effect explains; negative where Psi grows with it.
    pub explained: f64,
}

/// A figure before and after.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// Of the model.
    pub before: f64,
    /// Of the updated model.
    pub after: f64,
}

/// A pair before and after.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct UpdatedPair {
    /// Number of the measured mode.
    pub measured: usize,
    /// Number of the model's mode.
    pub model: usize,
    /// Measured frequency.
    pub measured_hz: f64,
    /// The model.
    pub before: PairState,
    /// The updated model.
    pub after: PairState,
}

/// A model's mode beside its measured one.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct PairState {
    /// Its frequency.
    pub model_hz: f64,
    /// Against the measured one.
    pub frequency_error_percent: f64,
    /// In standard deviations of the measurement.
    pub frequency_z: Option<f64>,
    /// Modal assurance criterion.
    pub mac: Option<f64>,
}

/// Runs the command.
///
/// # Errors
/// When the study cannot be read, no mode has a partner, or a result cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let mut case = Case::load(&arguments.study, console)?;
    case.keep_modes(&arguments.modes)?;
    let weights = Weights { frequency: arguments.frequency_weight, shape: arguments.shape_weights.clone() };
    let report = update_case(&case, &weights, console)?;
    console.json(&report)?;
    if !case.study.setups.is_empty() {
        let study = case.study.folder.display();
        console.say(format!(
            "Next: belfry covalidate {study} --channels CHANNELS    predict sensors that the model is not shown"
        ));
    }
    Ok(())
}

/// Updates, tells and stores.
pub(super) fn update_case(case: &Case, weights: &Weights, console: &Console) -> anyhow::Result<UpdateReport> {
    let pairs = case.pairs();
    if ![1, 2, pairs.len()].contains(&weights.shape.len()) {
        bail!(
            "--shape-weights has {} weights; give 1, 2 or one for each of the {} modes that have a partner",
            weights.shape.len(),
            pairs.len()
        );
    }
    let problem = Problem::of(&case.view, &case.measured.modes, &pairs, weights);
    let solution = solve(&problem)?;
    let used: Vec<usize> = pairs.iter().map(|pair| pair.model).collect();
    let matrices = updated(&case.assembly, &case.view.modes, &used, &solution.psi, &problem.measured_lambda)
        .context("the updated model")?;
    let at_sensors = case.view.at_sensors.select_columns(&used) * &solution.rotation;
    let state = |measured: usize, model_hz: f64, mac: Option<f64>| {
        let mode = &case.measured.modes[measured];
        PairState {
            model_hz,
            frequency_error_percent: 100.0 * (model_hz / mode.frequency_hz - 1.0),
            frequency_z: frequency_z(mode, model_hz),
            mac,
        }
    };
    let pair_reports: Vec<UpdatedPair> = pairs
        .iter()
        .enumerate()
        .map(|(index, pair)| {
            let mode = &case.measured.modes[pair.measured];
            let shape: Vec<f64> = at_sensors.column(index).iter().copied().collect();
            let after_mac = mode.shape.as_ref().map(|measured| mac(&shape, measured));
            // Of K* solved anew, not what it should be.
            let after_hz = nearest(&matrices.modes.frequency_hz, mode.frequency_hz);
            UpdatedPair {
                measured: mode.number,
                model: pair.model + 1,
                measured_hz: mode.frequency_hz,
                before: state(pair.measured, case.view.modes.frequency_hz[pair.model], pair.mac),
                after: state(pair.measured, after_hz, after_mac),
            }
        })
        .collect();
    let report = report(case, &pairs, &solution, weights, pair_reports, &matrices);
    for warning in &report.warnings {
        console.warn(warning);
    }
    tell(&report, case, console);
    write_json(&case.study, "update.json", &report)?;
    let mtx = write_result(&case.study, "stiffness_updated.mtx", matrix_market(&matrices.stiffness).as_bytes())?;
    write_result(&case.study, "stiffness_updated.npy", &npy(&matrices.stiffness)?)?;
    let mass = write_result(&case.study, "mass.mtx", matrix_market(&case.assembly.mass).as_bytes())?;
    let mut written = format!(
        "The updated stiffness matrix is in {} (and .npy), the mass matrix, which stays, in {}",
        mtx.display(),
        mass.display()
    );
    if matches!(case.model.body, Body::Beam(_)) {
        let nodes = write_result(&case.study, "nodes.csv", nodes_csv(&case.assembly).as_bytes())?;
        written += &format!(", the nodes of their rows in {}", nodes.display());
    }
    console.say(written + ".");
    Ok(report)
}

/// A beam's nodes as `[model] matrices` reads them: the base first, whose rows are left out.
fn nodes_csv(assembly: &Assembly) -> String {
    let heights = std::iter::once(assembly.z_base_m()).chain(assembly.node_elevations_m());
    let lines = heights.zip(1..).map(|(z_m, node)| format!("{node},{z_m}\n"));
    std::iter::once("node,z_m\n".to_owned()).chain(lines).collect()
}

fn nearest(frequencies_hz: &[f64], wanted_hz: f64) -> f64 {
    let distance = |hz: &f64| (hz - wanted_hz).abs();
    frequencies_hz.iter().copied().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(f64::NAN)
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn report(
    case: &Case,
    paired: &[Pair],
    solution: &Solution,
    weights: &Weights,
    pairs: Vec<UpdatedPair>,
    matrices: &crate::update::UpdatedMatrices,
) -> UpdateReport {
    let mean = |value: &dyn Fn(&UpdatedPair) -> Option<f64>| {
        let values: Vec<f64> = pairs.iter().filter_map(value).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let errors = BeforeAfter {
        before: mean(&|pair| Some(pair.before.frequency_error_percent.abs())).unwrap_or(0.0),
        after: mean(&|pair| Some(pair.after.frequency_error_percent.abs())).unwrap_or(0.0),
    };
    let frequency_part: f64 =
        pairs.iter().map(|pair| weights.frequency * (pair.after.frequency_error_percent / 100.0).powi(2)).sum();
    let macs = mean(&|pair| pair.before.mac).zip(mean(&|pair| pair.after.mac));
    let size = psi_size(&case.view, paired, solution);
    let mut warnings = solution.warnings.clone();
    if matrices.max_relative_change_of_other_eigenvalues > UNCHANGED {
        warnings.push(format!(
            "other eigenvalues changed by up to {:.1e}: the matrices are too badly conditioned for the update to leave them alone",
            matrices.max_relative_change_of_other_eigenvalues
        ));
    }
    UpdateReport {
        psi: rows(&solution.psi),
        objective: solution.objective + frequency_part,
        mac_ceiling: solution.mac_ceiling.clone(),
        max_relative_change_of_other_eigenvalues: matrices.max_relative_change_of_other_eigenvalues,
        other_eigenvalues: matrices.others.len(),
        max_turn_of_other_shapes: matrices.max_turn_of_other_shapes,
        other_modes: matrices
            .others
            .iter()
            .take(OTHERS_SHOWN)
            .map(|other| OtherMode { model: other.mode + 1, before_hz: other.before_hz, after_hz: other.after_hz })
            .collect(),
        mean_abs_frequency_error_percent: errors,
        mean_mac: macs.map(|(before, after)| BeforeAfter { before, after }),
        rotation: rows(&solution.rotation),
        effects: case.effect_names(),
        hints: hints(&case.view, &case.measured.modes, paired),
        psi_size: size,
        psi_explained: psi_explained(case, weights, size),
        warnings,
        pairs,
    }
}

/// The Frobenius norm of Psi over that of the used eigenvalues.
fn psi_size(view: &ModelView, pairs: &[Pair], solution: &Solution) -> f64 {
    let lambda = |pair: &Pair| (std::f64::consts::TAU * view.modes.frequency_hz[pair.model]).powi(4);
    solution.psi.norm() / pairs.iter().map(lambda).sum::<f64>().sqrt()
}

/// How much smaller Psi is for each effect in the model: the update again without it. An effect that does not fit a structure
/// without the others, or whose absence leaves no pairs, is left out.
fn psi_explained(case: &Case, weights: &Weights, size: f64) -> Vec<PsiExplained> {
    let effects = &case.model.effects;
    let without = |left: &[Effect]| -> Option<f64> {
        let structure = case.model.bare().and(left).ok()?;
        let view = ModelView::of(&structure.assemble(), case.seen_sensors()).ok()?;
        let pairs = pair(&view, &case.measured.modes);
        let solution = solve(&Problem::of(&view, &case.measured.modes, &pairs, weights)).ok()?;
        Some(psi_size(&view, &pairs, &solution))
    };
    let mut explained = Vec::new();
    let mut note = |effect: String, psi_size_without: Option<f64>| {
        if let Some(psi_size_without) = psi_size_without {
            let explains = 1.0 - (size / psi_size_without).powi(2);
            explained.push(PsiExplained { effect, psi_size_without, explained: explains });
        }
    };
    for index in 0..effects.len() {
        let left: Vec<Effect> =
            effects.iter().enumerate().filter(|(at, _)| *at != index).map(|(_, effect)| effect.clone()).collect();
        note(effects[index].to_string(), without(&left));
    }
    if effects.len() > 1 {
        note("all".to_owned(), without(&[]));
    }
    explained
}

/// Below this probability shapes are said to differ.
const SIGNIFICANT: f64 = 0.01;

fn tell_hints(report: &UpdateReport, console: &Console) {
    console.say("\nWhat Psi says (hints, no diagnosis: that is `belfry diagnose`)");
    let hints = &report.hints;
    let outside = hints.span.iter().max_by(|a, b| a.outside_percent.total_cmp(&b.outside_percent));
    if let (Some(p_value), Some(worst)) = (hints.span_p_value, outside) {
        let says = if p_value < SIGNIFICANT {
            "no Psi reaches what is outside; physics or sensors that the model does not have"
        } else {
            "within their deviations"
        };
        console.say(format!(
            "  Span: measured shapes lie up to {:.1} % of their length (mode {}) outside that of the model's, {}: {says}.",
            worst.outside_percent,
            worst.measured,
            p_is(p_value)
        ));
    }
    if let Some(test) = &hints.orthogonality {
        let says = if test.p_value < SIGNIFICANT {
            "the model's mass, or the sensors, are not what they are said to be"
        } else {
            "nothing contradicts the model's mass"
        };
        console.say(format!(
            "  Orthogonality by mass: worst between modes {} and {} (cosine {:.3} ± {:.3}), {}: {says}.",
            test.worst[0],
            test.worst[1],
            test.cosine,
            test.cosine_std,
            p_is(test.p_value)
        ));
    }
    console.say(format!("  Size of Psi: {:.2} % of the eigenvalues.", 100.0 * report.psi_size));
    for explained in &report.psi_explained {
        console.say(format!(
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
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "mode",
        "measured Hz",
        "model Hz",
        "error %",
        "updated Hz",
        "error %",
        "MAC",
        "updated",
        "ceiling",
    ]);
    for (pair, ceiling) in report.pairs.iter().zip(&report.mac_ceiling) {
        table.add_row([
            pair.measured.to_string(),
            format!("{:.4}", pair.measured_hz),
            format!("{:.4}", pair.before.model_hz),
            signed(pair.before.frequency_error_percent),
            format!("{:.4}", pair.after.model_hz),
            signed(pair.after.frequency_error_percent),
            mac_text(pair.before.mac, 4),
            mac_text(pair.after.mac, 4),
            mac_text(*ceiling, 4),
        ]);
    }
    align_right(&mut table, 9);
    console.say(table);
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
        console.say(format!(
            "The {} other modes of the model stay: {}{}\nTheir eigenvalues changed by at most {:.1e}, their shapes turned by at most {:.1e} (1 - MAC by mass).",
            report.other_eigenvalues,
            others.join(", "),
            if report.other_eigenvalues > others.len() { ", ..." } else { "." },
            report.max_relative_change_of_other_eigenvalues,
            report.max_turn_of_other_shapes
        ));
    }
    tell_hints(report, console);
    console.say("\nPsi in 1/s²:");
    for row in &report.psi {
        console.say(row.iter().map(|value| format!("{value:10.3e}")).collect::<Vec<_>>().join(" "));
    }
    console.say(
        "\nAny orthogonal matrix in place of the one found would meet the frequencies just as well: their agreement after this
update is no evidence that the model is right. The MAC cannot pass its ceiling, whatever Psi is: what is missing there is
not in the span of the model's shapes. Whether the model predicts what it was not shown is for `belfry covalidate`.",
    );
}

/// A percentage with its sign, but for what rounds to nothing.
fn signed(percent: f64) -> String {
    if percent.abs() < 0.005 { "0.00".to_owned() } else { format!("{percent:+.2}") }
}
