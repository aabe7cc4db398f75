//! A model of many degrees of freedom, reduced once to few: matrices with the modes of the model flow in, the same structure in generalised
//! coordinates flows out, in which a fit of effects costs the same for 200 and for 20 000 degrees of freedom.
//!
//! The coordinates are the lowest modes and static corrections: how the structure gives way, `K⁻¹ dK φ` and `K⁻¹ dM φ λ`, to what each
//! group and each hypothesis of the user's own does to each mode that was measured (Bouazzouni, Lallement and Cogan 1997, "Selecting a Ritz
//! basis for the reanalysis of the frequency response functions of modified structures", J. Sound Vib. 199, 309). Frequencies are exact
//! without changes, and to second order in what corrections leave with them.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::custom::Custom;
use super::eigen::ModalBasis;
use super::matrices::ImportedMatrices;
use super::structure::{Body, Structure};

/// Smaller models gain nothing.
const LEAST_DOFS: usize = 200;
/// Modes are kept up to this many times the highest measured frequency, for changes that lower them that far.
const BEYOND: f64 = 2.0;
/// So many modes are kept, and so many of them corrected.
const MODES: [usize; 2] = [20, 150];
const MOST_CORRECTED: usize = 30;
/// Modes are corrected up to this many times the highest measured frequency.
const CORRECTED: f64 = 1.6;
/// Corrections of a second kind: how the structure gives way to what a change does to the first.
const ORDERS: usize = 2;
/// A direction that corrections have in common is left out where a change of all of a group strains it by less than this share of what
/// the mode strains all, as an energy.
const NEGLIGIBLE: f64 = 1e-7;
/// No more directions than this.
const MOST_CORRECTIONS: usize = 150;

impl Structure {
    /// Whether [`Structure::reduced`] makes it another.
    pub fn is_reducible(&self) -> bool {
        matches!(&self.body, Body::Matrices(matrices) if !matrices.is_line()) && self.dofs() >= LEAST_DOFS
    }

    /// The same in few coordinates, exact up to about `highest_hz`, where it is given as matrices of many degrees of freedom whose nodes do
    /// not stand above each other (effects of masts act at their nodes); `basis` has all vectors of it as it is, without contributions.
    #[must_use]
    pub fn reduced(&self, basis: &ModalBasis, highest_hz: f64) -> Self {
        let Body::Matrices(matrices) = &self.body else { return self.clone() };
        let dofs = self.dofs();
        if !self.is_reducible() || basis.vectors.shape() != (dofs, dofs) {
            return self.clone();
        }
        let coordinates = coordinates(basis, &self.customs, highest_hz);
        if coordinates.ncols() >= dofs {
            return self.clone();
        }
        let within = |matrix: &DMatrix<f64>| symmetric(coordinates.tr_mul(&(matrix * &coordinates)));
        let customs = self.customs.iter().map(|custom| custom.within(&within)).collect();
        let body = ImportedMatrices {
            stiffness: within(&matrices.stiffness),
            mass: within(&matrices.mass),
            nodes: matrices.nodes.clone(),
            coordinates: Some(Arc::new(coordinates)),
        };
        Self::new(Body::Matrices(body)).with_customs(customs)
    }
}

/// Coordinates of unit strain energy, at right angles by K: DOFs x coordinates.
fn coordinates(basis: &ModalBasis, customs: &[Custom], highest_hz: f64) -> DMatrix<f64> {
    let below = |hz: f64| {
        let least = (std::f64::consts::TAU * hz).powi(-2);
        basis.inverse_lambda.iter().take_while(|inverse_lambda| **inverse_lambda > least).count()
    };
    let kept = below(BEYOND * highest_hz).clamp(MODES[0], MODES[1]).min(basis.vectors.ncols());
    let corrected = below(CORRECTED * highest_hz).clamp(1, MOST_CORRECTED).min(kept);
    let modes = basis.vectors.columns(0, kept).into_owned();
    // Vectors of unit strain energy that span every motion: K⁻¹ is the sum of their squares.
    let rest = basis.vectors.columns(kept, basis.vectors.ncols() - kept);
    let inverse_lambda = DVector::from_column_slice(&basis.inverse_lambda[..corrected]);
    let mut corrections: Vec<DMatrix<f64>> = Vec::new();
    for matrix in customs.iter().flat_map(Custom::matrices) {
        // In units of a mode that strains the whole by one.
        let scale = |mut forces: DMatrix<f64>| {
            if matrix.is_mass {
                forces.column_iter_mut().zip(inverse_lambda.iter()).for_each(|(mut column, mu)| column /= *mu);
            }
            forces
        };
        let mut motion = modes.columns(0, corrected).into_owned();
        for _ in 0..ORDERS {
            let forces = scale(matrix.entries * &motion);
            motion = rest.tr_mul(&forces);
            corrections.push(motion.clone());
            motion = rest * &motion;
        }
    }
    let columns: usize = corrections.iter().map(DMatrix::ncols).sum();
    if columns == 0 || rest.ncols() == 0 {
        return modes;
    }
    // By coordinates of the rest, which are at right angles by K: the Gram matrix is that of strain energies.
    let all = DMatrix::from_columns(&corrections.iter().flat_map(DMatrix::column_iter).collect::<Vec<_>>());
    let eigen = symmetric(all.tr_mul(&all)).symmetric_eigen();
    let mut order: Vec<usize> = (0..columns).filter(|&at| eigen.eigenvalues[at] > NEGLIGIBLE).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    order.truncate(MOST_CORRECTIONS);
    let mut directions = eigen.eigenvectors.select_columns(&order);
    for (mut direction, &at) in directions.column_iter_mut().zip(&order) {
        direction /= eigen.eigenvalues[at].sqrt();
    }
    let more = rest * (all * directions);
    let mut coordinates = modes.resize_horizontally(kept + more.ncols(), 0.0);
    coordinates.columns_mut(kept, more.ncols()).copy_from(&more);
    coordinates
}

fn symmetric(matrix: DMatrix<f64>) -> DMatrix<f64> {
    (&matrix + matrix.transpose()) * 0.5
}
