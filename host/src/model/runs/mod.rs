//! A model of which only modes are known: modes that the user's own program computed, of the model as it is and once for each group that
//! was changed, flow in; matrices in the coordinates of those modes flow out, which every command takes like imported ones.
//!
//! In the coordinates of its mass-normalised modes Φ a structure has `K = Λ` and `M = 1`. Where a group of K is changed by the share h, the
//! changed modes are `Φ' = Φ A` with `K + h dK = A⁻ᵀ Λ' A⁻¹` and `1 = A⁻ᵀ A⁻¹`: A is orthogonal, so `h dK = A Λ' Aᵀ - Λ`. A follows from the
//! shapes at the places that both runs have (the inverse of modal coordinates of a modified structure, Fox and Kapoor 1968, "Rates of change
//! of eigenvalues and eigenvectors", AIAA J. 6, 2426). Where a group of M is changed, K and M change places. What the changed shapes have
//! that no combination of the base's has, the static share of modes beyond, gets coordinates of its own, to first order.

mod checks;
mod coordinates;
mod paired;
#[cfg(test)]
mod tests;

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::matrices::ImportedMatrices;
use super::size::{self, TooManyUnknowns};
use crate::modes::{ComputedModes, MeasuredError, read_computed};
use crate::study::RunSource;
use checks::{not_linear, not_normalised};
use coordinates::{Coordinates, MOST_BEYOND, bend, forces_on_unseen};
use paired::{Change, Paired};

/// Modes above this share of the highest lambda lack those that come after it: nothing is judged by them.
const WELL_INSIDE: f64 = 0.5;

/// Why modes of the user's own program make no model.
#[derive(Debug, Error)]
pub enum RunError {
    /// A file of modes.
    #[error(transparent)]
    Modes(#[from] MeasuredError),
    /// No place is in the base and in the run.
    #[error("{run} and {base} have no place of the same name; both need the same columns")]
    NoCommonPlace {
        /// The run's file.
        run: String,
        /// That of the model as it is.
        base: String,
    },
    /// The run's modes are not those of the base, slightly changed.
    #[error(
        "{run}: only {paired} of its {modes} modes have shapes like those of {base}; are the places the same, and is the change small?"
    )]
    OtherModes {
        /// The run's file.
        run: String,
        /// That of the model as it is.
        base: String,
        /// How many modes have a partner.
        paired: usize,
        /// How many there are.
        modes: usize,
    },
    /// More modes and changes than fit into memory.
    #[error("[model] modes: {0}; give fewer modes or runs")]
    TooLarge(TooManyUnknowns),
    /// Nothing differs.
    #[error(
        "{run}: the same modes as {base}, up to {largest:.0e} of a frequency; nothing was changed, or the change is too small for the digits of the file"
    )]
    NothingChanged {
        /// The run's file.
        run: String,
        /// That of the model as it is.
        base: String,
        /// The largest relative change of a frequency.
        largest: f64,
    },
}

/// A run that was read: what was changed, by how much, and the modes.
struct Run {
    change: f64,
    is_mass: bool,
    modes: ComputedModes,
}

/// What a change by 1 adds in the coordinates of the modes.
#[derive(Debug, Clone)]
pub(super) struct RunChange {
    /// To K.
    pub(super) stiffness: Arc<DMatrix<f64>>,
    /// To M; `None` where K alone was changed.
    pub(super) mass: Option<Arc<DMatrix<f64>>>,
    /// Between which changes K and M stay positive.
    pub(super) range: [f64; 2],
}

/// A model of modes, and what each name that a run changes does to it.
#[derive(Debug)]
pub(super) struct OfRuns {
    pub(super) body: ImportedMatrices,
    /// By name, in the order of the first run of each.
    pub(super) changes: Vec<(String, RunChange)>,
    pub(super) warnings: Vec<String>,
}

/// Reads the modes of the model as it is, and the runs; paths start at `folder`.
///
/// # Errors
/// [`RunError`] names the file.
pub(super) fn read(base: &Path, runs: &[RunSource], folder: &Path) -> Result<OfRuns, RunError> {
    let base = read_computed(&folder.join(base))?;
    let mut names: Vec<(String, Vec<Run>)> = Vec::new();
    for source in runs {
        let modes = read_computed(&folder.join(&source.modes))?;
        let run = Run { change: source.change, is_mass: source.is_mass, modes };
        match names.iter_mut().find(|(name, _)| *name == source.changed) {
            Some((_, runs)) => runs.push(run),
            None => names.push((source.changed.clone(), vec![run])),
        }
    }
    // The smallest change is the nearest to a derivative; the others check it.
    for (_, runs) in &mut names {
        runs.sort_by(|a, b| a.change.abs().total_cmp(&b.change.abs()));
    }
    let paired = names.iter().map(|(_, runs)| runs.iter().map(|run| Paired::of(&base, run)).collect());
    let paired = paired.collect::<Result<Vec<Vec<Paired<'_>>>, _>>()?;
    let changes: Vec<Change> = paired.iter().map(|runs| runs[0].change(&base)).collect();
    let most = base.frequencies_hz.len() * 2 + changes.len() * MOST_BEYOND;
    size::fits_with(most, 6 * changes.len()).map_err(RunError::TooLarge)?;
    let motions: Vec<DMatrix<f64>> = changes.iter().map(|change| change.motions_beyond(&base)).collect();
    let straight = Coordinates::of(&base, &motions, DMatrix::zeros(changes.len(), 0));
    let lambda = base.lambda();
    let bends = paired.iter().zip(&changes).enumerate().map(|(at, (runs, change))| match &runs[1..] {
        [] => DVector::zeros(lambda.len()),
        others => bend(&lambda, &straight.body, change.by, &straight.change(at, change), others),
    });
    let unseen = forces_on_unseen(&bends.collect::<Vec<_>>());
    let coordinates = Coordinates::of(&base, &motions, unseen);
    let changes: Vec<RunChange> =
        changes.iter().enumerate().map(|(at, change)| coordinates.change(at, change)).collect();
    let body = coordinates.body;
    let mut warnings: Vec<String> = not_normalised(&base, paired.iter().map(|runs| &runs[0])).into_iter().collect();
    for ((name, runs), change) in names.iter().zip(&changes) {
        warnings.extend(runs[1..].iter().filter_map(|run| not_linear(name, &body, change, &runs[0], run)));
    }
    let names = names.into_iter().map(|(name, _)| name);
    Ok(OfRuns { body, changes: names.zip(changes).collect(), warnings })
}

impl ComputedModes {
    /// Squared circular frequencies in 1/s².
    fn lambda(&self) -> DVector<f64> {
        let squared = |hz: &f64| (TAU * hz).powi(2);
        DVector::from_iterator(self.frequencies_hz.len(), self.frequencies_hz.iter().map(squared))
    }
}
