//! The load: white noise at every node, as strong as its mass, coherent over a part of the height as gusts are.
//!
//! The force on a node of mass m has a density in proportion to `m m_total`, in X and in Y; the forces on two nodes a distance d
//! apart have the correlation exp(-d / L), the root of their coherence, at all frequencies. (Davenport's decays with frequency too, exp(-C f d / U); one length
//! stands for it, so that the load stays white.) The forces' sum has the one-sided density `level² m_total²`: the whole mass moving
//! rigidly would have an acceleration density of `level²`, whatever L and however fine the mesh. Long waves drive a structure
//! more than short ones, so the lowest modes move most, and the forces on two modes are correlated. Torsional moments get the
//! density that belongs to the node's polar inertia, less by [`TORSION_SHARE`] in amplitude.

use nalgebra::DMatrix;

use crate::model::{Assembly, DOFS_A_NODE, MassAtRow};

/// Torsional moments relative to those that would drive torsion as hard as bending: wind drives it less.
const TORSION_SHARE: f64 = 0.3;

/// Coherent loads on the degrees of freedom.
pub(crate) enum Loading {
    /// Of a beam.
    Beam {
        /// The loaded DOFs.
        dofs: Vec<usize>,
        /// Forces a sample in N or N m from independent unit normals, DOFs x normals.
        factor: DMatrix<f64>,
    },
    /// Of nodes in space, or of rows of which no more is known: what is loaded in each direction, those of different directions independent.
    Space {
        /// Along X, along Y, upwards; all in one where directions are not known.
        directions: Vec<Vec<LoadedRow>>,
        /// Distance over which loads are coherent, in m.
        length_m: f64,
    },
}

/// A row of imported matrices with a load.
pub(crate) struct LoadedRow {
    row: usize,
    /// Of the force in each sample, N.
    std: f64,
    /// Where it acts; unknown places are far from each other.
    place_m: Option<[f64; 3]>,
}

impl Loading {
    /// Loads at `level` in m/s²/√Hz, held for one sample each, coherent over `length_m`; independent where that is 0, or where
    /// nodes have no heights.
    pub(crate) fn new(assembly: &Assembly, level: f64, length_m: f64, sampling_rate_hz: f64) -> Self {
        if let Some(masses) = assembly.masses_in_space() {
            // White noise of one-sided density G has the variance G fs / 2 in each sample.
            let of_direction = |masses: &Vec<MassAtRow>| {
                let total_kg: f64 = masses.iter().map(|mass| mass.mass_kg).sum();
                let load = |mass: &MassAtRow| LoadedRow {
                    row: mass.row,
                    std: level * (mass.mass_kg * total_kg * sampling_rate_hz / 2.0).max(0.0).sqrt(),
                    place_m: mass.place_m,
                };
                masses.iter().map(load).filter(|load| load.std > 0.0).collect()
            };
            return Self::Space { directions: masses.iter().map(of_direction).collect(), length_m };
        }
        let inertia = assembly.mass.diagonal();
        let along = |dof: usize| inertia.iter().copied().enumerate().skip(dof).step_by(DOFS_A_NODE);
        let total_mass_kg: f64 = along(0).map(|(_, mass)| mass).sum();
        // White noise of one-sided density G has the variance G fs / 2 in each sample.
        let std = |inertia: f64| level * (inertia * total_mass_kg * sampling_rate_hz / 2.0).max(0.0).sqrt();
        let heights_m = assembly.node_elevations_m();
        let blocks = [(0, 1.0), (1, 1.0), (4, TORSION_SHARE)].map(|(first, share)| {
            let nodes = along(first).enumerate().map(|(node, (dof, inertia))| (dof, share * std(inertia), node));
            let loads: Vec<(usize, f64, Option<f64>)> = nodes
                .filter(|(_, std, _)| *std > 0.0)
                .map(|(dof, std, node)| (dof, std, heights_m.get(node).copied()))
                .collect();
            let factor = coherent(&loads.iter().map(|(_, std, z_m)| (*std, *z_m)).collect::<Vec<_>>(), length_m);
            (loads.iter().map(|(dof, ..)| *dof).collect::<Vec<_>>(), factor)
        });
        let dofs: Vec<usize> = blocks.iter().flat_map(|(dofs, _)| dofs.iter().copied()).collect();
        let mut factor = DMatrix::zeros(dofs.len(), dofs.len());
        let mut first = 0;
        for (_, block) in &blocks {
            factor.view_mut((first, first), block.shape()).copy_from(block);
            first += block.nrows();
        }
        Self::Beam { dofs, factor }
    }

    /// Modal forces from unit normals, modes x normals; `shapes` are those of the rows that nodes name.
    pub(crate) fn on_modes(&self, shapes: &DMatrix<f64>) -> DMatrix<f64> {
        match self {
            Self::Beam { dofs, factor } => shapes.select_rows(dofs).tr_mul(factor),
            Self::Space { directions, length_m } => {
                let modes = shapes.ncols();
                let nothing = DMatrix::zeros(modes, modes);
                root(directions.iter().fold(nothing, |sum, loads| sum + covariance(loads, *length_m, shapes)))
            }
        }
    }
}

/// Covariance of modal forces by the loads of one direction: exp(-d / L) between two places, the sum as strong as that of independent forces.
fn covariance(loads: &[LoadedRow], length_m: f64, shapes: &DMatrix<f64>) -> DMatrix<f64> {
    let rows: Vec<usize> = loads.iter().map(|load| load.row).collect();
    let at_rows = shapes.select_rows(&rows);
    let correlation = |one: &LoadedRow, other: &LoadedRow| match (one.place_m, other.place_m) {
        (Some(one), Some(other)) if length_m > 0.0 => {
            let distance_m = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            (-distance_m / length_m).exp()
        }
        _ => 0.0,
    };
    // Row by row: a matrix over all rows of a large model would not fit.
    let mut forces = DMatrix::zeros(loads.len(), shapes.ncols());
    let (mut sum, mut independent) = (0.0, 0.0);
    let mut row = nalgebra::RowDVector::zeros(loads.len());
    for (index, one) in loads.iter().enumerate() {
        for (at, other) in loads.iter().enumerate() {
            row[at] = one.std * other.std * if at == index { 1.0 } else { correlation(one, other) };
        }
        sum += row.sum();
        independent += one.std * one.std;
        forces.set_row(index, &(&row * &at_rows));
    }
    let of_modes = at_rows.tr_mul(&forces);
    if sum > 0.0 { of_modes * (independent / sum) } else { of_modes }
}

/// A matrix whose product with its transpose is this one, symmetric and without negative eigenvalues but for rounding.
fn root(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let eigen = ((&matrix + matrix.transpose()) * 0.5).symmetric_eigen();
    let mut vectors = eigen.eigenvectors;
    for (mut vector, value) in vectors.column_iter_mut().zip(eigen.eigenvalues.iter()) {
        vector *= value.max(0.0).sqrt();
    }
    vectors
}

/// Forces of these standard deviations at these heights, lowest first, from independent normals: exp(-d / L) is the correlation of a
/// Markov chain up the height. Their sum has the variance that independent forces would have.
fn coherent(loads: &[(f64, Option<f64>)], length_m: f64) -> DMatrix<f64> {
    let size = loads.len();
    let mut factor = DMatrix::zeros(size, size);
    for (row, (std, z_m)) in loads.iter().enumerate() {
        let distance_m = row.checked_sub(1).and_then(|below| Some((*z_m)? - loads[below].1?));
        let kept = distance_m.filter(|_| length_m > 0.0).map_or(0.0, |distance_m| (-distance_m.abs() / length_m).exp());
        if kept > 0.0 {
            let below = factor.row(row - 1) * (kept * std / loads[row - 1].0);
            factor.row_mut(row).copy_from(&below);
        }
        factor[(row, row)] = std * (1.0 - kept * kept).sqrt();
    }
    let independent: f64 = loads.iter().map(|(std, _)| std * std).sum();
    let sum = factor.row_sum().norm_squared();
    if sum > 0.0 { factor * (independent / sum).sqrt() } else { factor }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of two rows whose motion two modes have each to itself, the covariance of modal forces is that of the forces.
    #[test]
    fn forces_in_space_are_as_correlated_as_their_distance_says() {
        let load = |row, std, x: f64| LoadedRow { row, std, place_m: Some([x, 3.0, 4.0]) };
        let loads = vec![load(0, 1.0, 0.0), load(1, 2.0, 5.0)];
        let factor = Loading::Space { directions: vec![loads], length_m: 10.0 }.on_modes(&DMatrix::identity(2, 2));
        let covariance = &factor * factor.transpose();
        let correlation = covariance[(0, 1)] / (covariance[(0, 0)] * covariance[(1, 1)]).sqrt();
        assert!((correlation - (-0.5_f64).exp()).abs() < 1e-12, "{correlation}");
        assert!((covariance.sum() - 5.0).abs() < 1e-12, "{covariance}");
    }

    #[test]
    fn forces_have_the_stated_correlation_and_their_sum_the_stated_variance() {
        let loads = [(1.0, Some(0.0)), (2.0, Some(5.0)), (0.5, Some(20.0)), (1.5, None)];
        let factor = coherent(&loads, 10.0);
        let covariance = &factor * factor.transpose();
        let correlation = |a: usize, b: usize| covariance[(a, b)] / (covariance[(a, a)] * covariance[(b, b)]).sqrt();
        for (a, b, distance_m) in [(0, 1, 5.0_f64), (1, 2, 15.0), (0, 2, 20.0)] {
            assert!((correlation(a, b) - (-distance_m / 10.0).exp()).abs() < 1e-12, "{a} {b}");
        }
        assert!(correlation(0, 3).abs() < 1e-12, "nothing is known of where it stands");
        assert!((covariance.sum() - (1.0 + 4.0 + 0.25 + 2.25)).abs() < 1e-12);
        assert!((covariance[(1, 1)] / covariance[(0, 0)] - 4.0).abs() < 1e-12);
        assert_eq!(coherent(&loads, 0.0), DMatrix::from_diagonal(&nalgebra::dvector![1.0, 2.0, 0.5, 1.5]));
    }
}
