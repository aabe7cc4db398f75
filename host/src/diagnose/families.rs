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
    let spread = energies
        .iter()
        .map(twice)
        .fold(Matrix2::zeros(), |sum, [cos, sin]| sum + Matrix2::new(cos * cos, cos * sin, cos * sin, sin * sin));
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::testing::{measured, study};
    use super::super::*;
    use super::{FAMILIES, LEAST_MODES};
    use crate::model::Structure;

    /// Shares of the first modes of a structure in its families.
    fn shares(structure: &Structure) -> nalgebra::DMatrix<f64> {
        let (_, model, sensors) = study();
        let modes = measured(structure, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(1));
        Problem::new(structure.clone(), &[], &model, &sensors, &modes).unwrap().families
    }

    /// The template's tower bends along X and along Y and twists. Its axes turn a little with the height, so a mode has a few hundredths of
    /// another family.
    #[test]
    fn modes_of_a_straight_tower_are_of_one_family_each() {
        let (structure, ..) = study();
        let shares = shares(&structure);
        assert_eq!(shares.ncols(), FAMILIES);
        for row in shares.row_iter() {
            assert!((row.sum() - 1.0).abs() < 1e-9 && row.max() > 0.95, "{row}");
        }
    }

    /// A torsion constant off by 1.6 % moves all frequencies of torsion by 0.8 %: a fault of the table, not a reason to call the structure
    /// unknown.
    #[test]
    fn torsion_that_is_off_as_a_whole_is_no_effect() {
        let (structure, model, sensors) = study();
        let mut modes = measured(&structure, &sensors, 13, &mut ChaCha8Rng::seed_from_u64(11));
        let shares = shares(&structure);
        let twists = |mode: &usize| *mode < shares.nrows() && shares[(*mode, 2)] > 0.5;
        let twisted: Vec<usize> = (0..modes.len()).filter(twists).collect();
        assert!(twisted.len() >= LEAST_MODES);
        twisted.iter().for_each(|&mode| modes[mode].frequency_hz *= 1.008);
        let problem = Problem::new(structure, &[], &model, &sensors, &modes).unwrap();
        let diagnosis = diagnose(&problem, &[], &Signals::default(), &Options::default()).unwrap();
        assert_eq!(diagnosis.verdict, Verdict::Adequate, "{:?}", diagnosis.candidates.first());
    }
}
