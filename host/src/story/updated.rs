//! The paper's direct update of a study's model, and what it says.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::case::Case;
use super::error::StoryError;
use crate::compare::{ModelView, Pair, frequency_z, mac, pair};
use crate::model::effect::Effect;
use crate::update::{Hints, Problem, Solution, UpdatedMatrices, Weights, hints, solve, updated};

/// The largest relative change of another eigenvalue that passes for rounding.
const UNCHANGED: f64 = 1e-9;
/// How many of the modes that the update does not use are shown.
const OTHERS_SHOWN: usize = 4;

/// What `belfry update --json` prints and `results/update.json` holds.
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

/// What an update gives.
#[derive(Debug)]
pub struct Update {
    /// The figures.
    pub report: UpdateReport,
    /// The updated stiffness matrix, and its modes.
    pub matrices: UpdatedMatrices,
}

/// Updates the stiffness matrix of a case's model; writes nothing.
///
/// # Errors
/// When no mode has a partner, none has a shape, or the number of weights does not fit.
pub fn update(case: &Case, weights: &Weights) -> Result<Update, StoryError> {
    let pairs = case.pairs();
    if ![1, 2, pairs.len()].contains(&weights.shape.len()) {
        return Err(StoryError::ShapeWeights { given: weights.shape.len(), pairs: pairs.len() });
    }
    let problem = Problem::of(&case.view, &case.measured.modes, &pairs, weights);
    let solution = solve(&problem)?;
    let used: Vec<usize> = pairs.iter().map(|pair| pair.model).collect();
    let matrices = updated(&case.assembly, &case.view.modes, &used, &solution.psi, &problem.measured_lambda)
        .map_err(StoryError::UpdatedModel)?;
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
    Ok(Update { report, matrices })
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
    matrices: &UpdatedMatrices,
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
