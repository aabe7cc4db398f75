//! Families of modes: bending along each of a structure's two principal directions, and torsion.
//!
//! What a table has wrong about a family (a torsion constant, how stiff joints are along X) shifts all of its modes. The modes of a structure
//! flow in; each mode's share in each family flows out.

use nalgebra::{DMatrix, Matrix2};

use crate::compare::{ModelView, Pair};
use crate::model::Assembly;

/// How many families there are.
const FAMILIES: usize = 3;
/// A family of fewer modes has nothing in common.
const LEAST_MODES: usize = 2;

/// Shares of the paired modes in each family, by kinetic energy, measured modes x families: a relative error of a family's stiffness shifts
/// eigenvalues by these shares of it. Other modes, of which there are `measured` in all, belong to none. No families where the nodes do not
/// stand above each other.
pub(super) fn families(view: &ModelView, assembly: &Assembly, pairs: &[Pair], measured: usize) -> DMatrix<f64> {
    let energies: Option<Vec<[f64; 4]>> =
        pairs.iter().map(|pair| assembly.energies(view.modes.shapes.column(pair.model))).collect();
    let Some(energies) = energies else { return DMatrix::zeros(measured, 0) };
    // Directions a quarter turn apart are opposite at twice the angle, so the axis there along which modes lie is that of the families.
    let twice = |[xx, yy, xy, _]: &[f64; 4]| [xx - yy, 2.0 * xy];
    let spread = energies.iter().map(twice).fold(Matrix2::zeros(), |sum, [cos, sin]| {
        sum + Matrix2::new(cos * cos, cos * sin, cos * sin, sin * sin)
    });
    let axes = spread.symmetric_eigen();
    let axis = axes.eigenvectors.column(axes.eigenvalues.imax()).into_owned();
    let mut shares = DMatrix::zeros(measured, FAMILIES);
    for (mode, energies) in energies.iter().enumerate() {
        let [xx, yy, _, torsion] = energies;
        let [cos, sin] = twice(energies);
        let (bending, along) = (xx + yy, axis[0] * cos + axis[1] * sin);
        let all = [0.5 * (bending + along), 0.5 * (bending - along), *torsion];
        let total: f64 = all.iter().sum();
        for (family, energy) in all.into_iter().enumerate().filter(|_| total > 0.0) {
            shares[(mode, family)] = energy / total;
        }
    }
    let is_one = |&family: &usize| shares.column(family).iter().filter(|share| **share > 0.5).count() >= LEAST_MODES;
    let kept: Vec<usize> = (0..FAMILIES).filter(is_one).collect();
    shares.select_columns(&kept)
}
