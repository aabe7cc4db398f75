//! How the errors of a mode's numbers are correlated, and those of modes whose spectra overlap.
//!
//! What each group of windows changes flows in; a few columns a mode flow out, so that the covariance of two numbers is the sum of
//! the products of their rows.

use nalgebra::{DMatrix, RowDVector};
use serde::{Deserialize, Serialize};

use super::scatter::GroupChanges;
use crate::statistics::largest_first;

/// More columns than this are replaced by as many that hold most.
const MOST_COLUMNS: usize = 24;
/// Modes are known jointly where their distance is below this many bandwidths of the wider one, and so many lines.
const REACH_BANDWIDTHS: f64 = 1.0;
const REACH_LINES: f64 = 2.0;
/// And where more than this share of the correlations between them is more than chance.
const LEAST_KEPT: f64 = 0.5;
/// Digits that are kept.
const DIGITS: usize = 4;

/// The errors of a mode's numbers as sums of independent ones of unit variance. The covariance of two numbers is the sum over the
/// columns of the products of their entries, also of numbers of two modes of one group; a number's variance is the square of its
/// standard deviation, which is no less than its entries' squares: what they lack is its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CovarianceFactor {
    /// Modes of one group have errors that are correlated; those of different groups are independent.
    pub group: usize,
    /// Of the frequency, in Hz, column by column.
    pub frequency_hz: Vec<f64>,
    /// Of the damping ratio.
    pub damping_ratio: Vec<f64>,
    /// Of each component of the shape.
    pub shape: Vec<Vec<f64>>,
}

/// The numbers of one mode: their standard deviations (frequency in Hz, damping ratio, shape), and what each group changes.
pub(super) struct Numbers<'a> {
    pub(super) frequency_hz: f64,
    pub(super) bandwidth_hz: f64,
    pub(super) stds: Vec<f64>,
    pub(super) changes: &'a GroupChanges,
}

/// The covariance factors of modes, lowest frequency first; `None` for a mode of which it is not known.
pub(super) fn factors(modes: &[Numbers<'_>], spacing_hz: f64) -> Vec<Option<CovarianceFactor>> {
    let rows: Vec<Option<DMatrix<f64>>> = modes.iter().map(unit_rows).collect();
    let is_joint = |first: usize, second: usize| {
        let (a, b) = (&modes[first], &modes[second]);
        let reach_hz = REACH_BANDWIDTHS * a.bandwidth_hz.max(b.bandwidth_hz) + REACH_LINES * spacing_hz;
        let both = rows[first].as_ref().zip(rows[second].as_ref()).filter(|(a, b)| a.ncols() == b.ncols());
        b.frequency_hz - a.frequency_hz < reach_hz
            && both.is_some_and(|(a, b)| beyond_chance(&(a * b.transpose()), a.ncols(), false) > LEAST_KEPT)
    };
    let mut all = Vec::new();
    let mut first = 0;
    for last in 0..modes.len() {
        if last + 1 < modes.len() && is_joint(last, last + 1) {
            continue;
        }
        all.extend(of_group(&modes[first..=last], &rows[first..=last], first + 1));
        first = last + 1;
    }
    all
}

fn of_group(modes: &[Numbers<'_>], rows: &[Option<DMatrix<f64>>], group: usize) -> Vec<Option<CovarianceFactor>> {
    let stacked: Vec<RowDVector<f64>> =
        rows.iter().flatten().flat_map(|rows| rows.row_iter().map(|row| row.into_owned())).collect();
    if stacked.is_empty() {
        return vec![None; modes.len()];
    }
    let stacked = DMatrix::from_rows(&stacked);
    let kept = beyond_chance(&(&stacked * stacked.transpose()), stacked.ncols(), true).sqrt();
    let turn = principal(&stacked) * kept;
    // What no group shows has columns of its own behind those of the groups, mode after mode.
    let beside: usize = modes.iter().map(|mode| mode.changes.beside.ncols()).sum();
    let mut first = 0;
    let mut factor = |(mode, rows): (&Numbers<'_>, &Option<DMatrix<f64>>)| {
        let own = &mode.changes.beside;
        let columns = first..first + own.ncols();
        first = columns.end;
        let rows = rows.as_ref()? * &turn;
        let row = |index: usize| -> Vec<f64> {
            let own = index.checked_sub(2).map(|component| own.row(component));
            let own_square = own.map_or(0.0, |own| own.norm_squared());
            let std = (mode.stds[index].powi(2) - own_square).max(0.0).sqrt();
            let of_groups = rows.row(index).iter().map(|value| value * std).collect::<Vec<f64>>();
            let at = |column: usize| match own {
                Some(own) if columns.contains(&column) => own[column - columns.start],
                _ => 0.0,
            };
            of_groups.into_iter().chain((0..beside).map(at)).map(rounded).collect()
        };
        let shape = (2..rows.nrows()).map(row).collect();
        Some(CovarianceFactor { group, frequency_hz: row(0), damping_ratio: row(1), shape })
    };
    modes.iter().zip(rows).map(&mut factor).collect()
}

/// A mode's rows of unit length: their products are correlations. Zero for a number whose deviation is not known.
fn unit_rows(mode: &Numbers<'_>) -> Option<DMatrix<f64>> {
    let changes = mode.changes;
    let groups = changes.groups();
    if groups < 2 {
        return None;
    }
    let mut rows = DMatrix::zeros(2 + changes.shape.nrows(), groups);
    rows.set_row(0, &RowDVector::from_row_slice(&changes.frequency_hz));
    rows.set_row(1, &RowDVector::from_row_slice(&changes.damping_ratio));
    rows.rows_mut(2, changes.shape.nrows()).copy_from(&changes.shape);
    for (index, mut row) in rows.row_iter_mut().enumerate() {
        let length = row.norm();
        let is_known = mode.stds.get(index).is_some_and(|std| std.is_finite()) && length > 0.0 && length.is_finite();
        row.iter_mut().for_each(|value| *value = if is_known { *value / length } else { 0.0 });
    }
    Some(rows)
}

/// The share of correlations that is more than chance: what a few groups change is correlated by chance too, and is shrunk as far as
/// that goes (Schaefer and Strimmer 2005, eq. 8, with the variance of a normal variable's correlation). `own`: of a matrix of
/// correlations among themselves, where those above the diagonal are the same again.
fn beyond_chance(correlations: &DMatrix<f64>, groups: usize, own: bool) -> f64 {
    let (mut chance, mut squares) = (0.0, 0.0);
    for column in 0..correlations.ncols() {
        let rows = if own { column } else { correlations.nrows() };
        for row in 0..rows {
            let square = correlations[(row, column)].powi(2);
            chance += (1.0 - square).powi(2) / (groups as f64 - 1.0).max(1.0);
            squares += square;
        }
    }
    if squares > 0.0 { (1.0 - chance / squares).max(0.0) } else { 0.0 }
}

/// What columns are multiplied by so that a few of them hold most: the first principal axes.
fn principal(rows: &DMatrix<f64>) -> DMatrix<f64> {
    let columns = rows.ncols();
    if columns <= MOST_COLUMNS {
        return DMatrix::identity(columns, columns);
    }
    let eigen = rows.tr_mul(rows).symmetric_eigen();
    let order = largest_first(eigen.eigenvalues.as_slice());
    eigen.eigenvectors.select_columns(&order[..MOST_COLUMNS])
}

fn rounded(value: f64) -> f64 {
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Two modes of four numbers each, 24 groups: the first three numbers of each go with one common error, and the fourth by itself.
    /// `shared` is how much the second mode's has of the first's.
    fn changes(shared: f64, random: &mut ChaCha8Rng) -> [GroupChanges; 2] {
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        let mut rows = [[[0.0; 24]; 4]; 2];
        for group in 0..24 {
            let common = normal();
            for (mode, rows) in rows.iter_mut().enumerate() {
                let common =
                    if mode == 0 { common } else { shared * common + (1.0 - shared * shared).sqrt() * normal() };
                for (number, row) in rows.iter_mut().enumerate() {
                    row[group] = if number < 3 { common + 0.2 * normal() } else { normal() };
                }
            }
        }
        rows.map(|rows| GroupChanges {
            beside: DMatrix::zeros(2, 0),
            frequency_hz: rows[0].to_vec(),
            damping_ratio: rows[1].to_vec(),
            shape: DMatrix::from_fn(2, 24, |row, group| rows[2 + row][group]),
        })
    }

    fn product(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    /// The mean covariances over many draws: of frequency and damping, of frequency and the number of its own, and of the two
    /// modes' frequencies where they are of one group.
    fn means(shared: f64, apart_hz: f64) -> [f64; 3] {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        const DRAWS: usize = 200;
        let mut sums = [0.0; 3];
        for _ in 0..DRAWS {
            let drawn = changes(shared, &mut random);
            let stds = vec![0.1, 0.2, 0.3, 0.4];
            let numbers = |mode: usize| Numbers {
                frequency_hz: 1.0 + apart_hz * mode as f64,
                bandwidth_hz: 0.02,
                stds: stds.clone(),
                changes: &drawn[mode],
            };
            let found = factors(&[numbers(0), numbers(1)], 0.001);
            let [Some(a), Some(b)] = found.as_slice() else { panic!("{found:?}") };
            for (row, std) in [&a.frequency_hz, &a.damping_ratio, &a.shape[0], &a.shape[1]].into_iter().zip(&stds) {
                assert!(product(row, row) <= std * std * 1.001, "no more than the variance");
            }
            sums[0] += product(&a.frequency_hz, &a.damping_ratio) / (0.1 * 0.2);
            sums[1] += product(&a.frequency_hz, &a.shape[1]) / (0.1 * 0.4);
            sums[2] += if a.group == b.group { product(&a.frequency_hz, &b.frequency_hz) / 0.01 } else { 0.0 };
        }
        sums.map(|sum| sum / DRAWS as f64)
    }

    #[test]
    fn common_errors_are_kept_and_chance_is_not() {
        let [together, own, between] = means(0.0, 0.01);
        assert!((0.75..1.0).contains(&together), "{together}");
        assert!(own.abs() < 0.05 && between.abs() < 0.03, "{own} {between}");
        let [.., between] = means(0.9, 0.01);
        assert!((0.6..0.95).contains(&between), "{between}");
        let [.., between] = means(0.9, 0.1);
        assert_eq!(between, 0.0, "their spectral lines are others");
    }

    #[test]
    fn an_error_that_no_group_shows_has_a_column_of_its_own_and_keeps_deviations() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let [mut first, mut second] = changes(0.9, &mut random);
        first.beside = DMatrix::from_column_slice(2, 1, &[3.0, -4.0]);
        second.beside = DMatrix::from_column_slice(2, 1, &[1.0, 2.0]);
        let numbers = |changes, frequency_hz, stds: [f64; 4]| Numbers {
            frequency_hz,
            bandwidth_hz: 0.1,
            stds: stds.to_vec(),
            changes,
        };
        let modes = [numbers(&first, 1.0, [1.0, 1.0, 5.0, 5.0]), numbers(&second, 1.01, [1.0, 1.0, 1.0, 3.0])];
        let found = factors(&modes, 0.01);
        let [Some(one), Some(other)] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!(one.group, other.group, "their groups' errors go together");
        let [at_one, at_other] = [one, other].map(|factor| factor.shape.clone());
        let count = at_one[0].len();
        assert_eq!([at_one[0][count - 2], at_one[1][count - 2], at_one[0][count - 1]], [3.0, -4.0, 0.0]);
        assert_eq!([at_other[0][count - 2], at_other[0][count - 1], at_other[1][count - 1]], [0.0, 1.0, 2.0]);
        assert_eq!(one.frequency_hz[count - 2..], [0.0, 0.0]);
        // A number's variance is the square of its deviation, and its column holds all of the second mode's first component.
        assert!(product(&at_one[0], &at_one[0]) <= 25.0 && at_other[0][..count - 1].iter().all(|value| *value == 0.0));
    }

    #[test]
    fn many_columns_become_few_that_hold_most() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let rows = DMatrix::from_fn(6, 3, |_, _| normal()) * DMatrix::from_fn(3, 80, |_, _| normal());
        let turned = &rows * principal(&rows);
        assert_eq!(turned.ncols(), MOST_COLUMNS);
        let (before, after) = (&rows * rows.transpose(), &turned * turned.transpose());
        assert!((&before - after).amax() < 1e-9 * before.amax());
    }
}
