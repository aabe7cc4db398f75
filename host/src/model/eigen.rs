//! The generalised symmetric eigenproblem K x = lambda M x: matrices flow in, frequencies and mass-normalised shapes out.

use std::f64::consts::TAU;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SymmetricEigen};
use thiserror::Error;

/// Modes of a structure, lowest frequency first.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// Frequencies in Hz, ascending.
    pub frequency_hz: Vec<f64>,
    /// Mode shapes, DOFs x modes, `shapeᵀ M shape = 1`, the largest component positive.
    pub shapes: DMatrix<f64>,
}

/// Why there are no modes.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum EigenError {
    /// The matrices do not fit.
    #[error("K is {stiffness:?} and M is {mass:?}; both must be square and alike")]
    Shape {
        /// Rows and columns of K.
        stiffness: (usize, usize),
        /// Rows and columns of M.
        mass: (usize, usize),
    },
    /// An entry is not a finite number.
    #[error("{matrix} has an entry that is not a finite number at row {row}, column {column} (counted from 1)")]
    NotFinite {
        /// `K` or `M`.
        matrix: &'static str,
        /// 1-based row.
        row: usize,
        /// 1-based column.
        column: usize,
    },
    /// Neither matrix has a Cholesky factor.
    #[error(
        "neither K nor M is positive definite: the structure can move freely and parts of it have no mass; support it, or give it mass"
    )]
    NotDefinite,
    /// The structure can move without strain.
    #[error(
        "K is not positive definite (lambda = {lambda:.3e} 1/s²): the structure can move without strain; support it"
    )]
    Unsupported {
        /// The lowest eigenvalue.
        lambda: f64,
    },
    /// M gives some motion a negative mass.
    #[error("M is not positive semi-definite (1/lambda = {inverse_lambda:.3e} s²): some motion has a negative mass")]
    NegativeMass {
        /// The most negative inverse eigenvalue.
        inverse_lambda: f64,
    },
    /// Every mass is zero.
    #[error("M is zero: a structure without mass has no modes")]
    Massless,
    /// The iteration did not converge.
    #[error("the eigenvalues of this {dofs} x {dofs} problem did not converge")]
    NotConverged {
        /// Size of the problem.
        dofs: usize,
    },
}

/// An eigenvalue below this share of the largest is rounding: it belongs to a motion without mass (or without strain).
const NEGLIGIBLE: f64 = 1e-13;

/// Far more sweeps than the QR iteration needs (about two an eigenvalue); a bound so that it ends.
const MOST_SWEEPS_A_DOF: usize = 100;

/// Solves K x = lambda M x through M x = mu K x with a Cholesky factor of K, where K is positive definite (the structure
/// is supported): M may then have massless or nearly massless motions, only the modes with mass are returned, and it
/// is the lowest frequencies that are the most accurate. A factor of M would mix them with the huge eigenvalues of small
/// rotary inertias; it serves where K is not positive definite, to say by how much (Golub and Van Loan, "Matrix
/// Computations", section 8.7).
///
/// # Errors
/// [`EigenError`] says which matrix is not what a supported structure has.
pub fn eigenmodes(stiffness: &DMatrix<f64>, mass: &DMatrix<f64>) -> Result<Modes, EigenError> {
    if !stiffness.is_square() || stiffness.shape() != mass.shape() {
        return Err(EigenError::Shape { stiffness: stiffness.shape(), mass: mass.shape() });
    }
    for (matrix, name) in [(stiffness, "K"), (mass, "M")] {
        if let Some(index) = matrix.iter().position(|value| !value.is_finite()) {
            let (row, column) = matrix.vector_to_matrix_index(index);
            return Err(EigenError::NotFinite { matrix: name, row: row + 1, column: column + 1 });
        }
    }
    let Some(factor) = sound_factor(stiffness) else {
        let factor = sound_factor(mass).ok_or(EigenError::NotDefinite)?;
        let (lambdas, vectors) = reduced(&factor, stiffness)?;
        return match lambdas.iter().copied().reduce(f64::min) {
            Some(least) if least <= NEGLIGIBLE * lambdas.amax() => Err(EigenError::Unsupported { lambda: least }),
            _ => Ok(ascending(&lambdas, |lambda| lambda, &vectors, |_| 1.0)),
        };
    };
    let (inverses, vectors) = reduced(&factor, mass)?;
    let greatest = inverses.amax();
    if greatest == 0.0 {
        return Err(EigenError::Massless);
    }
    if let Some(&inverse_lambda) = inverses.iter().find(|&&mu| mu < -1e-9 * greatest) {
        return Err(EigenError::NegativeMass { inverse_lambda });
    }
    // xᵀ K x = 1 here, so xᵀ M x = mu; a mass-normalised shape is x / sqrt(mu).
    let massive = |mu: f64| if mu > NEGLIGIBLE * greatest { 1.0 / mu } else { f64::INFINITY };
    Ok(ascending(&inverses, massive, &vectors, |mu| 1.0 / mu.sqrt()))
}

/// A Cholesky factor, unless a pivot shows that the matrix is singular up to rounding (entries are of
/// different units and rightly differ by many powers of ten, so each pivot is held against its own diagonal entry).
fn sound_factor(matrix: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let factor = Cholesky::new(matrix.clone())?;
    let sound = factor
        .l_dirty()
        .diagonal()
        .iter()
        .zip(matrix.diagonal().iter())
        .all(|(&pivot, &entry)| pivot * pivot > NEGLIGIBLE * entry);
    sound.then_some(factor)
}

/// Eigenvalues and vectors of `other x = value (L Lᵀ) x`, vectors with `xᵀ L Lᵀ x = 1`.
fn reduced(factor: &Cholesky<f64, Dyn>, other: &DMatrix<f64>) -> Result<(DVector<f64>, DMatrix<f64>), EigenError> {
    let dofs = other.nrows();
    let lower = factor.l_dirty();
    let not_converged = EigenError::NotConverged { dofs };
    let half = lower.solve_lower_triangular(other).ok_or(not_converged.clone())?;
    let whole = lower.solve_lower_triangular(&half.transpose()).ok_or(not_converged.clone())?;
    let symmetric = (&whole + whole.transpose()) * 0.5;
    let eigen = SymmetricEigen::try_new(symmetric, f64::EPSILON, MOST_SWEEPS_A_DOF * dofs.max(1))
        .ok_or(not_converged.clone())?;
    let vectors = lower.tr_solve_lower_triangular(&eigen.eigenvectors).ok_or(not_converged)?;
    Ok((eigen.eigenvalues, vectors))
}

/// Sorts by `lambda(value)`, drops the infinite, scales each vector by `scale(value)` and fixes its sign.
fn ascending(
    values: &DVector<f64>,
    lambda: impl Fn(f64) -> f64,
    vectors: &DMatrix<f64>,
    scale: impl Fn(f64) -> f64,
) -> Modes {
    let mut order: Vec<usize> = (0..values.len()).filter(|&i| lambda(values[i]).is_finite()).collect();
    order.sort_by(|&i, &j| lambda(values[i]).total_cmp(&lambda(values[j])));
    let frequency_hz = order.iter().map(|&i| lambda(values[i]).max(0.0).sqrt() / TAU).collect();
    let mut shapes = DMatrix::zeros(vectors.nrows(), order.len());
    for (mut shape, &i) in shapes.column_iter_mut().zip(&order) {
        let vector = vectors.column(i);
        let largest = vector[vector.icamax()];
        shape.copy_from(&(vector * (scale(values[i]) * if largest < 0.0 { -1.0 } else { 1.0 })));
    }
    Modes { frequency_hz, shapes }
}
