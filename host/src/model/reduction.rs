//! A model of many degrees of freedom, reduced once to few: matrices as they are in files flow in, the same structure in generalised
//! coordinates flows out, in which everything costs the same for 200 and for 20 000 degrees of freedom.
//!
//! The coordinates are the lowest modes and static corrections: how the structure gives way, `K⁻¹ dK φ` and `K⁻¹ dM φ λ`, to what each
//! group and each hypothesis of the user's own does to each mode that is measured (Bouazzouni, Lallement and Cogan 1997, "Selecting a Ritz
//! basis for the reanalysis of the frequency response functions of modified structures", J. Sound Vib. 199, 309). Frequencies are exact
//! without changes, and to second order in what corrections leave with them.

use std::f64::consts::TAU;
use std::sync::Arc;

use belfry_numerics::{EigenPairs, SparseFactor, count_below, factor_entries, lowest_sparse_modes, symmetric_pairs};
use nalgebra::DMatrix;
use nalgebra_sparse::CscMatrix;

use super::custom::Custom;
use super::eigen::{EigenError, is_held};
use super::layout::is_line;
use super::matrices::{ImportedMatrices, WholeMatrices, symmetric};
use super::size;

/// Smaller models gain nothing.
const LEAST_DOFS: usize = 200;
/// Modes are kept up to this many times the highest measured frequency, for changes that lower them that far.
const BEYOND: f64 = 2.0;
/// At least and at most so many modes are kept, and at most so many of them corrected.
const MODES: [usize; 2] = [20, 150];
const MOST_CORRECTED: usize = 30;
/// Where no mode is measured yet, this many modes are kept.
const MODES_IF_UNKNOWN: usize = 60;
/// Modes are corrected up to this many times the highest measured frequency.
const CORRECTED: f64 = 1.6;
/// Corrections of a second kind: how the structure gives way to what a change does to the first.
const ORDERS: usize = 2;
/// A direction that corrections have in common is left out where a change of all of a group strains it by less than this share of what
/// the mode strains all, as an energy.
const NEGLIGIBLE: f64 = 1e-7;
/// No more directions than this.
const MOST_CORRECTIONS: usize = 150;
/// So many are gathered before those that have next to nothing of their own are left out.
const GATHERED: usize = 1000;
/// A solution that is off by more than this share is one of a structure that can move without strain.
const UNSUPPORTED: f64 = 1e-4;

/// Whether matrices are worth reducing: many degrees of freedom, whose nodes do not stand above each other (effects of masts act at their
/// nodes).
pub(super) fn is_worthwhile(whole: &WholeMatrices) -> bool {
    whole.stiffness.nrows() >= LEAST_DOFS && !is_line(&whole.nodes)
}

/// The same in few coordinates, exact up to about `highest_hz`, with what hypotheses and groups change.
///
/// # Errors
/// Where K is not that of a supported structure, M has no mass, or its modes are not found.
pub(super) fn reduced(
    whole: WholeMatrices,
    customs: Vec<Custom>,
    highest_hz: Option<f64>,
) -> Result<(ImportedMatrices, Vec<Custom>), EigenError> {
    let reducer = Reducer::of(&whole, highest_hz)?;
    let coordinates = reducer.coordinates(&whole.stiffness, &customs, highest_hz);
    let across = coordinates.transpose();
    let within = |matrix: &CscMatrix<f64>| symmetric(&(&across * (matrix * &coordinates)));
    let customs = customs.into_iter().map(|custom| custom.within(&within)).collect();
    let body = ImportedMatrices {
        stiffness: within(&whole.stiffness),
        mass: within(&whole.mass),
        nodes: whole.nodes.clone(),
        coordinates: Some(Arc::new(coordinates)),
        places: whole.places.clone(),
        whole: Some(Arc::new(whole)),
    };
    Ok((body, customs))
}

/// The lowest modes of a large model, and what solves for any other motion.
struct Reducer {
    factor: SparseFactor,
    /// Of unit strain energy.
    modes: EigenPairs<f64>,
}

/// Solutions that turn any motion into the slowest one, where that is slower than all others by far.
const SOLUTIONS: usize = 3;

/// An upper bound of the lowest eigenvalue in 1/s² by inverse iteration: close to it where K hardly resists some motion.
fn lowest_lambda(factor: &SparseFactor, mass: &CscMatrix<f64>) -> f64 {
    // Any motion that is at right angles to none.
    let mut motion = DMatrix::from_fn(mass.nrows(), 1, |row, _| (1.0 + row as f64).sin());
    let mut lambda = f64::INFINITY;
    for _ in 0..SOLUTIONS {
        let loads = mass * &motion;
        let solved = factor.solve(&loads);
        // K times what was solved is the loads.
        lambda = solved.dot(&loads) / solved.dot(&(mass * &solved));
        motion = &solved / solved.norm();
    }
    lambda
}

impl Reducer {
    fn of(whole: &WholeMatrices, highest_hz: Option<f64>) -> Result<Self, EigenError> {
        let WholeMatrices { stiffness, mass, .. } = whole;
        // Two factors and the basis of modes stand beside each other.
        let entries = factor_entries(stiffness).unwrap_or(usize::MAX);
        let vectors = stiffness.nrows().saturating_mul(MODES[1] * 6);
        size::fit_numbers(entries.saturating_mul(2).saturating_add(vectors))
            .map_err(|[needed_gb, free_gb]| EigenError::TooLarge { dofs: stiffness.nrows(), needed_gb, free_gb })?;
        let factor = SparseFactor::of(stiffness, UNSUPPORTED).ok_or(EigenError::NotSupported)?;
        if mass.values().iter().all(|entry| *entry == 0.0) {
            return Err(EigenError::Massless);
        }
        is_held(lowest_lambda(&factor, mass))?;
        let not_converged = || EigenError::NotConverged { dofs: stiffness.nrows() };
        let up_to = |hz: f64| count_below(stiffness, mass, (TAU * BEYOND * hz).powi(2)).ok_or_else(not_converged);
        let count = highest_hz.map_or(Ok(MODES_IF_UNKNOWN), up_to)?.clamp(MODES[0], MODES[1]);
        let modes = lowest_sparse_modes(&factor, stiffness, mass, count).ok_or_else(not_converged)?;
        Ok(Self { factor, modes })
    }

    /// Coordinates of unit strain energy, at right angles by K: DOFs x coordinates.
    fn coordinates(&self, stiffness: &CscMatrix<f64>, customs: &[Custom], highest_hz: Option<f64>) -> DMatrix<f64> {
        let EigenPairs { values, vectors: modes } = &self.modes;
        let up_to = |highest_hz: f64| {
            let least = (TAU * CORRECTED * highest_hz).powi(-2);
            values.iter().take_while(|value| **value > least).count()
        };
        let corrected = highest_hz.map_or(values.len() / 2, up_to).clamp(1, MOST_CORRECTED.min(values.len()));
        let across = modes.transpose();
        let mut corrections: Vec<DMatrix<f64>> = Vec::new();
        for (custom, matrix) in customs.iter().flat_map(|one| one.whole_matrices().map(move |matrix| (one, matrix))) {
            // All of a group, or what is typical of a hypothesis.
            let amount = if custom.group.is_some() { 1.0 } else { custom.typical };
            let mut motion = modes.columns(0, corrected).into_owned();
            for _ in 0..ORDERS {
                let mut forces = matrix.entries * &motion * amount;
                if matrix.is_mass {
                    forces.column_iter_mut().zip(values).for_each(|(mut column, mu)| column /= *mu);
                }
                // K⁻¹ less its share in the modes, so that a force's work on its motion is the strain energy of what is left.
                motion = self.factor.solve(&forces) - modes * (&across * &forces);
                let energies = symmetric(&(motion.transpose() * &forces));
                corrections.extend(principal(&energies, usize::MAX).map(|directions| &motion * directions.vectors));
            }
            // Many groups have most of their motions in common.
            if corrections.iter().map(DMatrix::ncols).sum::<usize>() > GATHERED
                && let Some((all, energies)) = together(&corrections, stiffness)
            {
                corrections =
                    principal(&energies, GATHERED / 2).map(|directions| all * directions.vectors).into_iter().collect();
            }
        }
        let Some((all, energies)) = together(&corrections, stiffness) else { return modes.clone() };
        let Some(EigenPairs { values, vectors: mut directions }) = principal(&energies, MOST_CORRECTIONS) else {
            return modes.clone();
        };
        for (mut direction, energy) in directions.column_iter_mut().zip(values) {
            direction.unscale_mut(energy.sqrt());
        }
        let more = all * directions;
        let mut coordinates = modes.clone().resize_horizontally(modes.ncols() + more.ncols(), 0.0);
        coordinates.columns_mut(modes.ncols(), more.ncols()).copy_from(&more);
        coordinates
    }
}

/// All motions side by side, and their strain energies; `None` where there is none.
fn together(motions: &[DMatrix<f64>], stiffness: &CscMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let columns: Vec<_> = motions.iter().flat_map(DMatrix::column_iter).collect();
    if columns.is_empty() {
        return None;
    }
    let all = DMatrix::from_columns(&columns);
    let energies = symmetric(&(all.transpose() * (stiffness * &all)));
    Some((all, energies))
}

/// The directions in which motions of these energies (a Gram matrix) have more than next to none, and how much, the most first; `None` where there
/// is none.
fn principal(energies: &DMatrix<f64>, most: usize) -> Option<EigenPairs<f64>> {
    let EigenPairs { mut values, vectors } = symmetric_pairs(energies)?;
    let kept = values.iter().take(most).take_while(|energy| **energy > NEGLIGIBLE).count();
    values.truncate(kept);
    (kept > 0).then(|| EigenPairs { values, vectors: vectors.columns(0, kept).into_owned() })
}
