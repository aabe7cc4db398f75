//! The updated stiffness matrix, and the check that everything else stayed as it was.

use nalgebra::DMatrix;

use crate::model::{Assembly, EigenError, ModalBasis, Modes};

/// K* and what its eigenproblem says.
#[derive(Debug, Clone)]
pub struct UpdatedMatrices {
    /// K* = K + M Phi1 Psi Phi1ᵀ M, DOFs x DOFs, symmetric.
    pub stiffness: DMatrix<f64>,
    /// Phi1, DOFs x used modes.
    pub used_shapes: DMatrix<f64>,
    /// Psi, symmetric.
    pub psi: DMatrix<f64>,
    /// Its modes, solved anew.
    pub modes: Modes,
    /// The largest relative change of an eigenvalue that does not belong to the updated modes; 1 where one has appeared or
    /// vanished.
    pub max_relative_change_of_other_eigenvalues: f64,
    /// The largest turn of a mode that was not used, as 1 minus the squared cosine, by mass, of its shapes.
    pub max_turn_of_other_shapes: f64,
    /// The modes that were not used, lowest first.
    pub others: Vec<Other>,
}

/// A mode that was not used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Other {
    /// Index into the model's modes.
    pub mode: usize,
    /// Its frequency in K.
    pub before_hz: f64,
    /// Its frequency in K*.
    pub after_hz: f64,
}

/// Builds K* from the used model modes (0-based) and Psi, solves its eigenproblem anew, and holds it against the old one.
///
/// # Errors
/// [`EigenError`] where K* is no longer that of a supported structure.
pub fn updated(
    assembly: &Assembly,
    modes: &Modes,
    used: &[usize],
    psi: &DMatrix<f64>,
    measured_lambda: &[f64],
) -> Result<UpdatedMatrices, EigenError> {
    let used_shapes = modes.shapes.select_columns(used);
    let momentum = &assembly.mass * &used_shapes;
    let change = &momentum * psi * momentum.transpose();
    let stiffness = &assembly.stiffness + (&change + change.transpose()) * 0.5;
    let basis = ModalBasis::of(&stiffness, &assembly.mass)?;
    let solved = basis.modes(usize::MAX);
    let lambda = |frequency_hz: f64| (std::f64::consts::TAU * frequency_hz).powi(2);
    let mut left: Vec<usize> = (0..solved.frequency_hz.len()).collect();
    for &updated in measured_lambda {
        let distance = |mode: usize| (lambda(solved.frequency_hz[mode]) - updated).abs();
        let nearest = left.iter().enumerate().min_by(|a, b| distance(*a.1).total_cmp(&distance(*b.1)));
        if let Some((index, _)) = nearest {
            left.remove(index);
        }
    }
    let unused: Vec<usize> = (0..modes.frequency_hz.len()).filter(|mode| !used.contains(mode)).collect();
    let others: Vec<Other> = unused
        .iter()
        .zip(&left)
        .map(|(&mode, &after)| Other {
            mode,
            before_hz: modes.frequency_hz[mode],
            after_hz: solved.frequency_hz[after],
        })
        .collect();
    let appeared_or_vanished = if unused.len() == left.len() { 0.0 } else { 1.0 };
    let change = |other: &Other| (lambda(other.after_hz) / lambda(other.before_hz) - 1.0).abs();
    Ok(UpdatedMatrices {
        max_relative_change_of_other_eigenvalues: others.iter().map(change).fold(appeared_or_vanished, f64::max),
        max_turn_of_other_shapes: greatest_turn(&assembly.mass, modes, &unused, &solved, &left),
        used_shapes,
        psi: psi.clone(),
        stiffness,
        modes: solved,
        others,
    })
}

/// Eigenvalues that differ by less than this share have a common span, in which each shape may stand anywhere.
const SAME_EIGENVALUE: f64 = 1e-6;

/// The largest `1 - (phiᵀ M phi*)²` of modes before and after; of modes with nearly one eigenvalue, that with the span of
/// the modes after.
fn greatest_turn(mass: &DMatrix<f64>, before: &Modes, unused: &[usize], after: &Modes, left: &[usize]) -> f64 {
    let products = (mass * before.shapes.select_columns(unused)).tr_mul(&after.shapes.select_columns(left));
    let near = |one: usize, other: usize| {
        (before.frequency_hz[unused[one]] / after.frequency_hz[left[other]] - 1.0).abs() < SAME_EIGENVALUE
    };
    let turn = |one: usize| {
        let kept: f64 = (0..left.len())
            .filter(|&other| other == one || near(one, other))
            .map(|other| products[(one, other)].powi(2))
            .sum();
        (1.0 - kept).max(0.0)
    };
    (0..unused.len().min(left.len())).map(turn).fold(0.0, f64::max)
}
