//! From paired modes to Psi: the small problem, its ceiling and its solution.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::rotation::{ShapeTerm, minimise};
use crate::compare::{ModelView, Pair};
use crate::modes::MeasuredMode;

/// Weights of the objective `sum w_f ((f* - f)/f)² + sum w_s (1 - MAC)²` (eq. 14).
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// Of every frequency; it has no influence, as frequencies are matched exactly, and is kept for comparison with the paper.
    pub frequency: f64,
    /// Of the shapes, from the lowest pair up; the last holds for all that follow. The paper has two: here the first is
    /// for the lower half of the pairs, the second for the upper half.
    pub shape: Vec<f64>,
}

impl Default for Weights {
    /// As the paper: 10 for frequencies, 2.0 and 0.5 for shapes.
    fn default() -> Self {
        Self { frequency: 10.0, shape: vec![2.0, 0.5] }
    }
}

impl Weights {
    /// A weight for each of `count` pairs: two weights go to the halves, any other number one by one.
    pub fn shapes(&self, count: usize) -> Vec<f64> {
        match self.shape[..] {
            [lower, upper] => (0..count).map(|index| if 2 * index < count { lower } else { upper }).collect(),
            [] => vec![1.0; count],
            [.., last] => (0..count).map(|index| self.shape.get(index).copied().unwrap_or(last)).collect(),
        }
    }
}

/// Why there is no update.
#[derive(Debug, Error, PartialEq)]
pub enum UpdateError {
    /// Nothing to update with.
    #[error("no measured mode has a partner in the model, so there is nothing to update; look at `belfry compare`")]
    NoPairs,
    /// No shape at all.
    #[error(
        "none of the paired modes has a measured shape: with frequencies alone Psi is just the difference of eigenvalues; measure shapes"
    )]
    NoShapes,
}

/// The update as a problem of the m paired modes.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    /// The model's eigenvalues in 1/s², pair by pair.
    pub model_lambda: Vec<f64>,
    /// The measured eigenvalues in 1/s², pair by pair.
    pub measured_lambda: Vec<f64>,
    /// The model's mass-normalised shapes at the sensors (chi), sensors x pairs.
    pub shapes: DMatrix<f64>,
    /// Measured shapes: sensors at which a component is known, and the components; `None` where only the frequency is.
    pub measured: Vec<Option<(Vec<usize>, DVector<f64>)>>,
    /// Weight of each shape.
    pub weights: Vec<f64>,
}

/// Psi and what comes with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Psi in 1/s², pairs x pairs, symmetric.
    pub psi: DMatrix<f64>,
    /// V, pairs x pairs, orthogonal: the updated shape of pair i is Phi1 times its column i.
    pub rotation: DMatrix<f64>,
    /// The paper's objective at the solution.
    pub objective: f64,
    /// MAC of each pair with the updated shape; `None` without a measured shape.
    pub mac: Vec<Option<f64>>,
    /// The highest MAC that any shape in the span of Phi1 has: |P phihat|².
    pub mac_ceiling: Vec<Option<f64>>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// Singular values of chi below this share of the largest leave a direction of V undetermined.
const RANK_TOLERANCE: f64 = 1e-8;

impl Problem {
    /// The problem of some pairs.
    pub fn of(view: &ModelView, measured: &[MeasuredMode], pairs: &[Pair], weights: &Weights) -> Self {
        let models: Vec<usize> = pairs.iter().map(|pair| pair.model).collect();
        let lambda = |frequency_hz: f64| (TAU * frequency_hz).powi(2);
        Self {
            model_lambda: models.iter().map(|&model| lambda(view.modes.frequency_hz[model])).collect(),
            measured_lambda: pairs.iter().map(|pair| lambda(measured[pair.measured].frequency_hz)).collect(),
            shapes: view.at_sensors.select_columns(&models),
            measured: pairs
                .iter()
                .map(|pair| {
                    let shape = measured[pair.measured].shape.as_ref()?;
                    Some((shape.sensors.clone(), shape.values.clone()))
                })
                .collect(),
            weights: weights.shapes(pairs.len()),
        }
    }

    /// The terms of the objective that depend on V.
    fn terms(&self) -> Vec<Option<ShapeTerm>> {
        self.measured
            .iter()
            .zip(&self.weights)
            .map(|(measured, &weight)| {
                let (sensors, values) = measured.as_ref()?;
                ShapeTerm::new(&self.shapes.select_rows(sensors), values, weight)
            })
            .collect()
    }
}

/// Solves for Psi.
///
/// # Errors
/// [`UpdateError`] without pairs or without any shape.
pub fn solve(problem: &Problem) -> Result<Solution, UpdateError> {
    if problem.model_lambda.is_empty() {
        return Err(UpdateError::NoPairs);
    }
    let terms = problem.terms();
    if terms.iter().all(Option::is_none) {
        return Err(UpdateError::NoShapes);
    }
    let rotation = minimise(&terms);
    let measured_lambda = DMatrix::from_diagonal(&DVector::from_column_slice(&problem.measured_lambda));
    let model_lambda = DMatrix::from_diagonal(&DVector::from_column_slice(&problem.model_lambda));
    let psi = &rotation * measured_lambda * rotation.transpose() - model_lambda;
    let psi = (&psi + psi.transpose()) * 0.5;
    let mac: Vec<Option<f64>> = terms
        .iter()
        .zip(rotation.column_iter())
        .map(|(term, column)| term.as_ref().map(|term| term.mac(&column.into_owned())))
        .collect();
    let objective =
        mac.iter().zip(&problem.weights).map(|(mac, weight)| weight * (1.0 - mac.unwrap_or(1.0)).powi(2)).sum();
    let mac_ceiling = terms.iter().map(|term| term.as_ref().map(ShapeTerm::ceiling)).collect();
    Ok(Solution { psi, rotation, objective, mac, mac_ceiling, warnings: rank_warnings(problem) })
}

/// Warnings about modes that the sensors cannot separate.
fn rank_warnings(problem: &Problem) -> Vec<String> {
    let mut warnings = Vec::new();
    let modes = problem.shapes.ncols();
    // By the sensors at which a shape is known: (sensors, rank, pairs).
    let mut poor: Vec<(usize, usize, Vec<String>)> = Vec::new();
    for (index, measured) in problem.measured.iter().enumerate() {
        let Some((sensors, _)) = measured else { continue };
        let singular = problem.shapes.select_rows(sensors).singular_values();
        let greatest = singular.iter().copied().fold(0.0, f64::max);
        let rank = singular.iter().filter(|&&value| value > RANK_TOLERANCE * greatest).count();
        if rank < modes {
            let pair = (index + 1).to_string();
            match poor.iter_mut().find(|(count, other, _)| (*count, *other) == (sensors.len(), rank)) {
                Some((_, _, pairs)) => pairs.push(pair),
                None => poor.push((sensors.len(), rank, vec![pair])),
            }
        }
    }
    for (sensors, rank, pairs) in poor {
        let which = if pairs.len() == modes { String::new() } else { format!("for pair {}, ", pairs.join(", ")) };
        warnings.push(format!(
            "{which}{modes} modes at {sensors} sensors: the model's shapes have rank {rank} there, so {} of the {modes} directions of V are not determined by the measurement; do not trust shapes between the sensors then; MAC says little. Use fewer modes (--modes) or more sensors",
            modes - rank
        ));
    }
    let without: Vec<String> = problem
        .measured
        .iter()
        .enumerate()
        .filter(|(_, measured)| measured.is_none())
        .map(|(index, _)| (index + 1).to_string())
        .collect();
    if !without.is_empty() {
        warnings.push(format!(
            "no shape was measured for pair {}: its frequency is matched; its shape is only determined by the others",
            without.join(", ")
        ));
    }
    warnings
}
