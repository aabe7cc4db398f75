//! The generalised symmetric eigenproblem K x = lambda M x: matrices flow in, frequencies and mass-normalised shapes out.

use std::f64::consts::TAU;

use belfry_numerics::{CholeskyFactor, EigenPairs, Envelope, EnvelopeFactor, lowest_modes};
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

/// Eigenvectors of a supported structure: all of them, those without mass included, so that they span every motion; or the lowest ones with
/// what tells of all others.
#[derive(Debug, Clone, PartialEq)]
pub struct ModalBasis {
    /// 1/lambda in s², descending (lowest frequency first); zero for motions without mass.
    pub inverse_lambda: Vec<f64>,
    /// The vectors, DOFs x vectors, `xᵀ K x = 1` and `xᵀ M x = inverse_lambda`.
    pub vectors: DMatrix<f64>,
    /// The sign that makes each vector's largest component positive.
    signs: Vec<f64>,
    /// K and M, where these are the lowest vectors only.
    rest: Option<Rest>,
}

/// What tells of vectors that are not there.
#[derive(Debug, Clone, PartialEq)]
struct Rest {
    stiffness: EnvelopeFactor,
    mass: Envelope,
    /// So many of the vectors that are there are exact.
    sharp: usize,
}

/// The lowest modes alone are looked for where they are at most this share of all, and matrices have at most this share of their entries.
const FEW: f64 = 0.5;
const SPARSE: f64 = 0.25;
/// Terms of a series in the ratio of a mode's lambda to that of the first mode that is not there: with as many modes beside those that are asked
/// for as [`ModalBasis::near`] is given, that is some hundredth.
const TERMS: usize = 4;

/// Why there are no modes.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum EigenError {
    /// The matrices do not fit.
    #[error("K is {} x {} and M is {} x {}; both must be square and of the same size", stiffness.0, stiffness.1, mass.0, mass.1)]
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
    /// The factor of K does not fit into memory.
    #[error(
        "the modes of {dofs} degrees of freedom take about {needed_gb:.1} GB of memory, and {free_gb:.1} GB are free; bring a coarser model"
    )]
    TooLarge {
        /// Rows of K.
        dofs: usize,
        /// What it would take.
        needed_gb: f64,
        /// What there is.
        free_gb: f64,
    },
    /// K allows motion without strain, and its factor tells no more.
    #[error(
        "K is not positive definite: the structure can move without strain, or a stiffness is negative; support it, check the signs"
    )]
    NotSupported,
    /// K allows motion without strain.
    #[error(
        "K is not positive definite (lambda = {lambda:.3e} 1/s²): the structure can move without strain, or a stiffness is negative; support it, check the signs"
    )]
    Unsupported {
        /// The lowest eigenvalue.
        lambda: f64,
    },
    /// K holds some motion by rounding alone.
    #[error(
        "the lowest mode is at {frequency_hz:.1e} Hz, where no structure swings: it can move without strain, and K holds it by rounding alone; support it, or export K with its supports"
    )]
    HeldByRounding {
        /// The lowest frequency.
        frequency_hz: f64,
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

/// No structure swings as slowly: its period would be three hours.
const SLOWEST_HZ: f64 = 1e-4;

/// Whether a structure of this lowest eigenvalue (1/s²) stands on more than rounding.
///
/// # Errors
/// [`EigenError::HeldByRounding`].
pub(super) fn is_held(lambda: f64) -> Result<(), EigenError> {
    let frequency_hz = lambda.max(0.0).sqrt() / TAU;
    if frequency_hz < SLOWEST_HZ { Err(EigenError::HeldByRounding { frequency_hz }) } else { Ok(()) }
}

impl Modes {
    /// Whether the structure stands on more than rounding, as one that is given must. What a fit tries on its way need not.
    ///
    /// # Errors
    /// [`EigenError::HeldByRounding`].
    pub(crate) fn are_held(&self) -> Result<(), EigenError> {
        self.frequency_hz.first().map_or(Ok(()), |lowest_hz| is_held((TAU * lowest_hz).powi(2)))
    }
}

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
        let not_converged = || EigenError::NotConverged { dofs: stiffness.nrows() };
        let Some(factor) = CholeskyFactor::of(stiffness, NEGLIGIBLE) else {
            let factor = CholeskyFactor::of(mass, NEGLIGIBLE).ok_or(EigenError::NotDefinite)?;
            let lambda = least(&factor.generalised_eigen(stiffness).ok_or_else(not_converged)?.values);
            return Err(EigenError::Unsupported { lambda });
        };
        let EigenPairs { values, vectors } = factor.generalised_eigen(mass).ok_or_else(not_converged)?.reversed();
        let greatest = values.iter().fold(0.0, |most: f64, mu| most.max(mu.abs()));
        if greatest == 0.0 {
            return Err(EigenError::Massless);
        }
        let inverse_lambda = least(&values);
        if inverse_lambda < -1e-9 * greatest {
            return Err(EigenError::NegativeMass { inverse_lambda });
        }
        let inverse_lambda = values.into_iter().map(|mu| if mu > NEGLIGIBLE * greatest { mu } else { 0.0 });
        Ok(Self { inverse_lambda: inverse_lambda.collect(), signs: signs(&vectors), vectors, rest: None })
    }

    /// The `count` lowest modes of a structure near this one, the `sharp` lowest as exact as those of all are. `None` where they are not found
    /// sooner than all, or not at all: matrices that are full, or of another size, or too far from this.
    pub(crate) fn near(
        &self,
        stiffness: &DMatrix<f64>,
        mass: &DMatrix<f64>,
        sharp: usize,
        count: usize,
    ) -> Option<Self> {
        let dofs = self.vectors.nrows();
        let fits = stiffness.shape() == (dofs, dofs) && mass.shape() == (dofs, dofs);
        let is_finite = |matrix: &DMatrix<f64>| matrix.iter().all(|value| value.is_finite());
        let is_small = sharp < count && count <= self.vectors.ncols() && count as f64 <= FEW * dofs as f64;
        if !fits || !is_small || !is_finite(stiffness) || !is_finite(mass) {
            return None;
        }
        let (stiffness, mass) = (Envelope::of(stiffness), Envelope::of(mass));
        if (stiffness.entries() + mass.entries()) as f64 > SPARSE * (dofs * dofs) as f64 {
            return None;
        }
        let factor = stiffness.factor(NEGLIGIBLE)?;
        let near = self.vectors.columns(0, count).transpose();
        let EigenPairs { values, vectors } = lowest_modes(&stiffness, &factor, &mass, &near, sharp)?;
        // The last one of all must have mass.
        let has_mass = values.last().is_some_and(|last| *last > NEGLIGIBLE * values[0]);
        let rest = Some(Rest { stiffness: factor, mass, sharp });
        has_mass.then_some(Self { inverse_lambda: values, signs: signs(&vectors), vectors, rest })
    }

    /// How many of the vectors, from the first, are exact.
    pub(crate) fn sharp(&self) -> usize {
        self.rest.as_ref().map_or(self.vectors.ncols(), |rest| rest.sharp)
    }

    /// What sensors see of motion by a force at each DOF in the vectors that are not there, each over a power of lambda: `S sum_j x_j x_jᵀ mu_j^k`
    /// for k from 0 on, each sensors x DOFs; empty where all are there. `rows` is what sensors see of each DOF, sensors x DOFs, `sensor_vectors`
    /// the vectors there, and `transposed` those at the DOFs.
    pub(super) fn left_out(
        &self,
        rows: &DMatrix<f64>,
        sensor_vectors: &DMatrix<f64>,
        transposed: &DMatrix<f64>,
    ) -> Vec<DMatrix<f64>> {
        let Some(rest) = &self.rest else { return Vec::new() };
        let mut weighted = sensor_vectors.clone();
        let mut whole = rest.stiffness.solve(rows);
        let mut left_out = Vec::with_capacity(TERMS);
        for term in 0..TERMS {
            if term > 0 {
                whole = rest.stiffness.solve(&rest.mass.times(&whole));
                weighted.column_iter_mut().zip(&self.inverse_lambda).for_each(|(mut column, mu)| column *= *mu);
            }
            // All vectors together are K⁻¹, and K⁻¹ M K⁻¹ with mu.
            left_out.push(&whole - &weighted * transposed);
        }
        left_out
    }

    /// The sign that makes a vector's largest component positive.
    pub(super) fn sign(&self, mode: usize) -> f64 {
        self.signs[mode]
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

/// The sign that makes each vector's largest component positive.
fn signs(vectors: &DMatrix<f64>) -> Vec<f64> {
    vectors.column_iter().map(|vector| if vector[vector.icamax()] < 0.0 { -1.0 } else { 1.0 }).collect()
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}
