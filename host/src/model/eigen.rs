//! The generalised symmetric eigenproblem K x = lambda M x: matrices flow in, frequencies and mass-normalised shapes out.

use std::f64::consts::TAU;

use faer::linalg::solvers::{Llt, SelfAdjointEigen};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, MatRef, Par, Side};
use nalgebra::DMatrix;
use thiserror::Error;

/// Modes of a structure, lowest frequency first.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// Frequencies in Hz, ascending.
    pub frequency_hz: Vec<f64>,
    /// Mode shapes, DOFs x modes, `shapeᵀ M shape = 1`, the largest component positive.
    pub shapes: DMatrix<f64>,
}

/// All eigenvectors of a supported structure, those without mass included, so that they span every motion.
#[derive(Debug, Clone, PartialEq)]
pub struct ModalBasis {
    /// 1/lambda in s², descending (lowest frequency first); zero for motions without mass.
    pub inverse_lambda: Vec<f64>,
    /// The vectors, DOFs x DOFs, `xᵀ K x = 1` and `xᵀ M x = inverse_lambda`.
    pub vectors: DMatrix<f64>,
}

/// Why there are no modes.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum EigenError {
    /// The matrices do not fit.
    #[error("K is {} x {} and M is {} x {}; both must be square and alike", stiffness.0, stiffness.1, mass.0, mass.1)]
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
    /// K allows motion without strain.
    #[error(
        "K is not positive definite (lambda = {lambda:.3e} 1/s²): the structure can move without strain, or a stiffness is negative; support it, check the signs"
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

/// Solves K x = lambda M x; only the modes that have mass are returned.
///
/// # Errors
/// As [`ModalBasis::of`].
pub fn eigenmodes(stiffness: &DMatrix<f64>, mass: &DMatrix<f64>) -> Result<Modes, EigenError> {
    Ok(ModalBasis::of(stiffness, mass)?.modes(usize::MAX))
}

impl ModalBasis {
    /// Solves K x = lambda M x through M x = mu K x with a Cholesky factor of K, where K is positive definite (the
    /// structure is supported): M may then have massless or nearly massless motions, and it is the lowest frequencies
    /// that are the most accurate. A factor of M would mix them with the huge eigenvalues of small rotary inertias; it
    /// serves where K is not positive definite, to say by how much (Golub and Van Loan, "Matrix Computations",
    /// section 8.7). Rounding is some 1e-16 of the largest 1/lambda: a mode at 1000 times the lowest frequency has lost
    /// six of sixteen digits.
    ///
    /// # Errors
    /// [`EigenError`] says which matrix is not what a supported structure has.
    pub fn of(stiffness: &DMatrix<f64>, mass: &DMatrix<f64>) -> Result<Self, EigenError> {
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
            let lambda = least(&reduced(&factor, stiffness)?.0);
            return Err(EigenError::Unsupported { lambda });
        };
        let (ascending, reduced_vectors) = reduced(&factor, mass)?;
        let greatest = ascending.iter().fold(0.0, |most: f64, mu| most.max(mu.abs()));
        if greatest == 0.0 {
            return Err(EigenError::Massless);
        }
        let inverse_lambda = least(&ascending);
        if inverse_lambda < -1e-9 * greatest {
            return Err(EigenError::NegativeMass { inverse_lambda });
        }
        let mut vectors = reduced_vectors;
        solve_upper_triangular_in_place(factor.L().transpose(), vectors.as_mut(), Par::Seq);
        let dofs = ascending.len();
        let inverse_lambda = ascending.iter().rev().map(|&mu| if mu > NEGLIGIBLE * greatest { mu } else { 0.0 });
        Ok(Self {
            inverse_lambda: inverse_lambda.collect(),
            vectors: DMatrix::from_fn(dofs, dofs, |row, mode| vectors[(row, dofs - 1 - mode)]),
        })
    }

    /// The sign that makes a vector's largest component positive.
    pub(super) fn sign(&self, mode: usize) -> f64 {
        let vector = self.vectors.column(mode);
        if vector[vector.icamax()] < 0.0 { -1.0 } else { 1.0 }
    }

    /// The lowest modes that have mass, at most `most` of them.
    pub fn modes(&self, most: usize) -> Modes {
        let massive: Vec<f64> = self.inverse_lambda.iter().copied().take_while(|&mu| mu > 0.0).take(most).collect();
        let mut shapes = self.vectors.columns(0, massive.len()).into_owned();
        for (mode, (mut shape, &mu)) in shapes.column_iter_mut().zip(&massive).enumerate() {
            // xᵀ M x = mu here, so a mass-normalised shape is x / sqrt(mu).
            shape *= self.sign(mode) / mu.sqrt();
        }
        Modes { frequency_hz: massive.iter().map(|mu| 1.0 / (TAU * mu.sqrt())).collect(), shapes }
    }
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// A matrix as the eigen-solver's library sees it; both store column after column.
fn view(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

/// A Cholesky factor, unless a pivot shows that the matrix is singular up to rounding (entries are of
/// different units and rightly differ by many powers of ten, so each pivot is held against its own diagonal entry).
fn sound_factor(matrix: &DMatrix<f64>) -> Option<Llt<f64>> {
    let factor = Llt::new(view(matrix), Side::Lower).ok()?;
    let lower = factor.L();
    let sound = (0..matrix.nrows()).all(|i| lower[(i, i)] * lower[(i, i)] > NEGLIGIBLE * matrix[(i, i)]);
    sound.then_some(factor)
}

/// Eigenvalues, ascending, and vectors y of `L⁻¹ other L⁻ᵀ y = value y`.
fn reduced(factor: &Llt<f64>, other: &DMatrix<f64>) -> Result<(Vec<f64>, Mat<f64>), EigenError> {
    let mut half = view(other).to_owned();
    solve_lower_triangular_in_place(factor.L(), half.as_mut(), Par::Seq);
    let mut whole = half.transpose().to_owned();
    solve_lower_triangular_in_place(factor.L(), whole.as_mut(), Par::Seq);
    let symmetric = (&whole + whole.transpose()) * faer::Scale(0.5);
    let eigen = SelfAdjointEigen::new(symmetric.as_ref(), Side::Lower)
        .map_err(|_| EigenError::NotConverged { dofs: other.nrows() })?;
    Ok((eigen.S().column_vector().iter().copied().collect(), eigen.U().to_owned()))
}
