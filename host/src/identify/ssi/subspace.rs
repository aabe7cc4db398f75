//! Poles and shapes out of covariances: the stochastic subspace.
//!
//! Covariances at consecutive lags flow in, stacked as a block Hankel matrix whose singular vectors span the observability
//! matrices of all orders (Peeters and De Roeck 1999). Poles of any order with their shapes flow out.

use belfry_numerics::{SingularTriplets, complex_product, general_eigen_complex, singular_triplets};
use nalgebra::{Cholesky, DMatrix, Dyn};
use num_complex::Complex64;

use super::covariance::Covariances;
use crate::identify::shape::Shape;

/// Orders that are tried at most.
const MOST_ORDERS: usize = 14;

/// The subspaces of all orders.
#[derive(Debug, Clone)]
pub(super) struct Subspace {
    pub(super) triplets: SingularTriplets,
    /// Covariances of all channels in the first row of blocks, times the right singular vectors.
    pub(super) first_row_right: DMatrix<Complex64>,
    /// Rows and columns of a block.
    outputs: usize,
    references: usize,
    block_rows: usize,
}

/// A model of one order.
#[derive(Debug, Clone)]
pub(super) struct Model {
    pub(super) order: usize,
    /// The observability matrix without its last block, O, and the Cholesky factor of O^H O.
    pub(super) upper: DMatrix<Complex64>,
    pub(super) normal: Cholesky<Complex64, Dyn>,
    /// What O A leaves of the observability matrix without its first block.
    pub(super) misfit: DMatrix<Complex64>,
    /// The transition matrix A.
    pub(super) transition: DMatrix<Complex64>,
    /// Its eigenvalues.
    pub(super) poles: Vec<Complex64>,
    /// Its eigenvectors, a column a pole.
    pub(super) vectors: DMatrix<Complex64>,
    /// Their inverse.
    pub(super) inverse: DMatrix<Complex64>,
    /// From states to channels.
    pub(super) output: DMatrix<Complex64>,
}

/// How many rows and columns of blocks `lags` consecutive covariances fill.
fn blocks(lags: usize) -> (usize, usize) {
    (lags.div_ceil(2), lags - lags.div_ceil(2) + 1)
}

/// The block Hankel matrix.
pub(super) fn hankel(lags: &[DMatrix<Complex64>]) -> DMatrix<Complex64> {
    let (outputs, references) = lags.first().map_or((0, 0), DMatrix::shape);
    let (rows, columns) = blocks(lags.len());
    DMatrix::from_fn(rows * outputs, columns * references, |row, column| {
        lags[row / outputs + column / references][(row % outputs, column % references)]
    })
}

/// The covariances of all channels side by side, as many as the Hankel matrix has columns of blocks.
pub(super) fn first_row(lags: &[DMatrix<Complex64>]) -> DMatrix<Complex64> {
    let (channels, references) = lags.first().map_or((0, 0), DMatrix::shape);
    let (_, columns) = blocks(lags.len());
    DMatrix::from_fn(channels, columns * references, |row, column| {
        lags[column / references][(row, column % references)]
    })
}

impl Subspace {
    /// `None` where the decomposition fails.
    pub(super) fn of(covariances: &Covariances) -> Option<Self> {
        let (outputs, references) = covariances.outputs.first()?.shape();
        let triplets = singular_triplets(&hankel(&covariances.outputs))?;
        let (block_rows, _) = blocks(covariances.outputs.len());
        let first_row_right = complex_product(&first_row(&covariances.channels), &triplets.right);
        Some(Self { triplets, first_row_right, outputs, references, block_rows })
    }

    /// Orders that can be tried.
    pub(super) fn most_orders(&self) -> usize {
        let rows = (self.block_rows - 1) * self.outputs;
        MOST_ORDERS.min(rows).min(self.triplets.values.len().saturating_sub(1))
    }

    /// The upper (`from` 0) or lower (`from` 1) rows of something as high as the observability matrix, without one block.
    pub(super) fn without_a_block(&self, matrix: &DMatrix<Complex64>, from: usize) -> DMatrix<Complex64> {
        matrix.rows(from * self.outputs, (self.block_rows - 1) * self.outputs).into_owned()
    }

    /// The model of an order; `None` where the covariances do not determine it.
    pub(super) fn model(&self, order: usize) -> Option<Model> {
        let least = self.triplets.values.get(order - 1)?;
        if *least <= f64::EPSILON * self.triplets.values[0] {
            return None;
        }
        let observability = self.triplets.left.columns(0, order).into_owned();
        let (upper, lower) = (self.without_a_block(&observability, 0), self.without_a_block(&observability, 1));
        let normal = (upper.adjoint() * &upper).cholesky()?;
        let transition = normal.solve(&(upper.adjoint() * &lower));
        let misfit = lower - &upper * &transition;
        let pairs = general_eigen_complex(&transition)?;
        let inverse = pairs.vectors.clone().try_inverse()?;
        let mut output = self.first_row_right.columns(0, order).into_owned();
        for (mut column, value) in output.column_iter_mut().zip(&self.triplets.values) {
            column /= Complex64::from(*value);
        }
        Some(Model {
            order,
            upper,
            normal,
            misfit,
            transition,
            poles: pairs.values,
            vectors: pairs.vectors,
            inverse,
            output,
        })
    }

    /// A pole's part of the first covariance's trace, all channels together. With a mode's lag 0 it is real and positive.
    pub(super) fn part(&self, model: &Model, pole: usize) -> Complex64 {
        // Covariances are the sum over poles of shape times participation, a row of inv(Psi) S V^H.
        let participation = |column: usize| -> Complex64 {
            let state = |state: usize| self.triplets.right[(column, state)].conj() * self.triplets.values[state];
            (0..model.order).map(|at| model.inverse[(pole, at)] * state(at)).sum()
        };
        let at_reference = |row: usize| -> Complex64 {
            (0..model.order).map(|at| self.triplets.left[(row, at)] * model.vectors[(at, pole)]).sum()
        };
        let (mut product, mut power) = (Complex64::ZERO, 0.0);
        for reference in 0..self.references {
            let component = at_reference(reference);
            product += component * participation(reference);
            power += component.norm_sqr();
        }
        if power > 0.0 { product / power * model.shape(pole).norm_squared() } else { Complex64::ZERO }
    }
}

impl Model {
    /// The shape of a pole at all channels.
    pub(super) fn shape(&self, pole: usize) -> Shape {
        &self.output * self.vectors.column(pole)
    }
}
