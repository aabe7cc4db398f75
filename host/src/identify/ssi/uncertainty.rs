//! How far poles and shapes move when the covariances do, to first order.
//!
//! A subspace, a model of it and a small change of the covariances flow in; the changes of poles and shapes flow out. This is the
//! perturbation of the singular vectors, of the least-squares solution and of the eigenvalues (Reynders, Pintelon and De Roeck
//! 2008; Doehler and Mevel 2013), applied to each group of windows that is left out instead of a covariance matrix of covariances:
//! there are far fewer groups than covariances.

use belfry_numerics::complex_product;
use nalgebra::DMatrix;
use num_complex::Complex64;

use super::covariance::Covariances;
use super::subspace::{Model, Subspace, first_row, hankel};
use crate::identify::shape::Shape;

/// A change of the covariances in terms of the singular vectors; serves all orders.
#[derive(Debug, Clone)]
pub(super) struct Change {
    /// The change of the Hankel matrix between the singular vectors: U^H dH V.
    inside: DMatrix<Complex64>,
    /// What of dH V lies outside the space of the left singular vectors.
    outside: DMatrix<Complex64>,
    /// The change of the first row times V.
    first_row: DMatrix<Complex64>,
}

/// How a model's poles and shapes move.
#[derive(Debug, Clone)]
pub(super) struct Moved {
    /// Changes of the poles.
    pub(super) poles: Vec<Complex64>,
    /// Changes of the states' eigenvectors and of the output matrix, from which shapes follow.
    vectors: DMatrix<Complex64>,
    output: DMatrix<Complex64>,
}

impl Change {
    /// The change from `covariances` to `others`.
    pub(super) fn new(subspace: &Subspace, covariances: &Covariances, others: &Covariances) -> Self {
        let difference = |from: &[DMatrix<Complex64>], to: &[DMatrix<Complex64>]| -> Vec<DMatrix<Complex64>> {
            from.iter().zip(to).map(|(from, to)| to - from).collect()
        };
        let hankel = hankel(&difference(&covariances.outputs, &others.outputs));
        let right = complex_product(&hankel, &subspace.triplets.right);
        let inside = complex_product(&subspace.triplets.left.adjoint(), &right);
        let outside = &right - complex_product(&subspace.triplets.left, &inside);
        let first_row = first_row(&difference(&covariances.channels, &others.channels));
        Self { outside, inside, first_row: complex_product(&first_row, &subspace.triplets.right) }
    }

    /// How the model of an order moves. The basis of the subspace is kept where it lies within the subspace itself: another basis
    /// changes neither poles nor shapes.
    pub(super) fn of(&self, subspace: &Subspace, model: &Model) -> Moved {
        let (order, values) = (model.order, &subspace.triplets.values);
        let rest = values.len() - order;
        let left = &subspace.triplets.left;
        let over = |matrix: &mut DMatrix<Complex64>, power: i32| {
            for (mut column, value) in matrix.column_iter_mut().zip(values) {
                column /= Complex64::from(value.powi(power));
            }
        };
        // Towards the singular vectors that the order leaves out...
        let towards = DMatrix::from_fn(rest, order, |l, j| {
            let (kept, left_out) = (values[j], values[order + l]);
            let sum = self.inside[(order + l, j)] * kept + self.inside[(j, order + l)].conj() * left_out;
            sum / (kept * kept - left_out * left_out)
        });
        let mut observability = complex_product(&left.columns(order, rest).into_owned(), &towards);
        // ...and out of the space of all of them.
        let mut outside = self.outside.columns(0, order).into_owned();
        over(&mut outside, 1);
        observability += outside;
        let (upper_moved, lower_moved) =
            (subspace.without_a_block(&observability, 0), subspace.without_a_block(&observability, 1));
        let (upper, misfit) = (&model.upper, &model.misfit);
        let moved = lower_moved - complex_product(&upper_moved, &model.transition);
        let sides = complex_product(&upper.adjoint(), &moved) + complex_product(&upper_moved.adjoint(), misfit);
        let transition = model.normal.solve(&sides);
        let mixed = &model.inverse * transition * &model.vectors;
        let poles = (0..order).map(|pole| mixed[(pole, pole)]).collect();
        let mixing = DMatrix::from_fn(order, order, |other, pole| {
            let apart = model.poles[pole] - model.poles[other];
            if other == pole || apart.norm() == 0.0 { Complex64::ZERO } else { mixed[(other, pole)] / apart }
        });
        // The output matrix is the first row times the pseudo-inverse of (kept vectors' adjoint times the Hankel matrix).
        let mut output = self.first_row.columns(0, order).into_owned();
        output -= &model.output * self.inside.view((0, 0), (order, order));
        over(&mut output, 1);
        let mut beyond = self.inside.view((0, order), (order, rest)).adjoint();
        for (row, value) in values[order..].iter().enumerate() {
            let mut beyond_row = beyond.row_mut(row);
            beyond_row += towards.row(row) * Complex64::from(*value);
        }
        let mut beyond = complex_product(&subspace.first_row_right.columns(order, rest).into_owned(), &beyond);
        over(&mut beyond, 2);
        output += beyond;
        Moved { poles, vectors: &model.vectors * mixing, output }
    }
}

impl Moved {
    /// The change of a pole's shape, but for scale and phase.
    pub(super) fn shape(&self, model: &Model, pole: usize) -> Shape {
        let shape = model.shape(pole);
        let mut change = &self.output * model.vectors.column(pole) + &model.output * self.vectors.column(pole);
        let norm = shape.norm_squared();
        if norm > 0.0 {
            let along = shape.dotc(&change) / norm;
            change.axpy(-along, &shape, Complex64::ONE);
        }
        change
    }
}
