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
/// At least this share of a number's variance is its own: two dozen groups cannot show less. Along the directions that are known best the
/// mean square error was 2.8 times the stated variance without it and 1.3 times with it, of whole modes 1.19 and 0.88 times (84 modes of six
/// records of a simulated tower, which it was chosen by).
pub(crate) const OWN_SHARE: f64 = 0.01;
/// The groups are taken out in so many folds at most.
const MOST_FOLDS: usize = 24;
/// What is below this share of the largest is rounding.
const ROUNDING: f64 = 1e-12;
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
            && both.is_some_and(|(a, b)| beyond_chance(&(a * b.transpose()), a.ncols()) > LEAST_KEPT)
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
    let common = common_errors(&DMatrix::from_rows(&stacked), rows.iter().flatten().count());
    // What no group shows has columns of its own behind those of the groups, mode after mode.
    let beside: usize = modes.iter().map(|mode| mode.changes.beside.ncols()).sum();
    let (mut first, mut first_row) = (0, 0);
    let mut factor = |(mode, rows): (&Numbers<'_>, &Option<DMatrix<f64>>)| {
        let own = &mode.changes.beside;
        let columns = first..first + own.ncols();
        first = columns.end;
        let count = rows.as_ref()?.nrows();
        let rows = common.rows(first_row, count);
        first_row += count;
        let row = |index: usize| -> Vec<f64> {
            let own = index.checked_sub(2).map(|component| own.row(component));
            let own_square = own.map_or(0.0, |own| own.norm_squared());
            // Of a number whose deviation is not known, nothing goes with others.
            let variance = Some(mode.stds[index].powi(2)).filter(|variance| variance.is_finite());
            let std = (variance.unwrap_or(0.0) - own_square).max(0.0).sqrt();
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

/// The share of correlations that is more than chance: what a few groups change is correlated by chance too (Schaefer and Strimmer 2005,
/// eq. 8, with the variance of a normal variable's correlation).
fn beyond_chance(correlations: &DMatrix<f64>, groups: usize) -> f64 {
    let (mut chance, mut squares) = (0.0, 0.0);
    for correlation in correlations.iter() {
        let square = correlation.powi(2);
        chance += (1.0 - square).powi(2) / (groups as f64 - 1.0).max(1.0);
        squares += square;
    }
    if squares > 0.0 { (1.0 - chance / squares).max(0.0) } else { 0.0 }
}

/// The errors that numbers have in common, a column each, from their rows of unit length (numbers x groups): correlations are the products
/// of the rows that flow out, but for what is each number's own.
///
/// A few groups show the largest errors larger than they are, and the smallest ones, which weigh most in a test of whole modes, far smaller.
/// So the directions of the errors are those that all groups show, and their sizes are [`cross_validated_sizes`].
///
/// `without_error`: how many directions have none, as that along a shape, whose length is free.
fn common_errors(rows: &DMatrix<f64>, without_error: usize) -> DMatrix<f64> {
    let known = rows.row_iter().filter(|row| row.norm_squared() > 0.0).count();
    let directions = directions(rows);
    let (sizes, least) = cross_validated_sizes(rows, known.saturating_sub(without_error), directions.ncols());
    let mut common = directions.columns(0, sizes.len()).into_owned();
    for (mut column, size) in common.column_iter_mut().zip(&sizes) {
        column.scale_mut((size - least).max(0.0).sqrt());
    }
    let kept = sizes.len().min(MOST_COLUMNS);
    // A number's variance is known; what is estimated here is how much of it goes with others'. What is not kept is its own.
    for mut row in common.row_iter_mut() {
        let shared = row.columns(0, kept).norm_squared();
        let whole = (row.norm_squared() + least).max(shared / (1.0 - OWN_SHARE));
        row.scale_mut(if whole > 0.0 { whole.sqrt().recip() } else { 0.0 });
    }
    common.columns(0, kept).into_owned()
}

/// The variances along the directions of the errors, largest first, and in all others: what groups show that had no part in the directions,
/// each fold's along what the others show (Bartz 2016, "Cross-validation based nonlinear shrinkage", with isotonic regression). Of `free`
/// directions that have an error, as many as `seen` at most are told apart.
fn cross_validated_sizes(rows: &DMatrix<f64>, free: usize, seen: usize) -> (Vec<f64>, f64) {
    let groups = rows.ncols();
    let folds = groups.min(MOST_FOLDS);
    // Squares along each direction, and in all others together.
    let (mut along, mut beyond) = (vec![0.0; free.min(seen)], 0.0);
    for fold in 0..folds {
        let (out, others): (Vec<usize>, Vec<usize>) = (0..groups).partition(|group| group % folds == fold);
        let mut others = rows.select_columns(&others);
        let mean = others.column_mean();
        others.column_iter_mut().for_each(|mut column| column -= &mean);
        let out = rows.select_columns(&out);
        let products = directions(&others).tr_mul(&out);
        let squares: Vec<f64> = products.row_iter().take(along.len()).map(|row| row.norm_squared()).collect();
        beyond += (out.norm_squared() - squares.iter().sum::<f64>()).max(0.0);
        along.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
    }
    // Of a direction that no fold had, the same is known as of those that no group shows.
    along.retain(|square| *square > 0.0);
    let rest = free - along.len();
    let mut steps: Vec<(f64, usize)> = along.iter().map(|&square| (square, 1)).collect();
    steps.extend((rest > 0).then(|| (beyond / rest as f64, rest)));
    let mut sizes = falling(&steps);
    let least = sizes.last().copied().unwrap_or(0.0);
    sizes.truncate(along.len());
    (sizes, least)
}

/// Directions in which the columns differ, as far as they do, in the order of how far.
fn directions(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let is_wide = columns.nrows() < columns.ncols();
    let products = if is_wide { columns * columns.transpose() } else { columns.tr_mul(columns) };
    let eigen = products.symmetric_eigen();
    let order = largest_first(eigen.eigenvalues.as_slice());
    let largest = order.first().map_or(0.0, |&first| eigen.eigenvalues[first]);
    let seen: Vec<usize> = order.into_iter().filter(|&at| eigen.eigenvalues[at] > ROUNDING * largest).collect();
    let vectors = eigen.eigenvectors.select_columns(&seen);
    if is_wide {
        return vectors;
    }
    let mut directions = columns * vectors;
    for (mut column, &at) in directions.column_iter_mut().zip(&seen) {
        column.scale_mut(eigen.eigenvalues[at].sqrt().recip());
    }
    directions
}

/// The values that are nearest to these, each with its weight, and nowhere rise (isotonic regression by pooling adjacent violators).
fn falling(steps: &[(f64, usize)]) -> Vec<f64> {
    let mut pools: Vec<(f64, usize, usize)> = Vec::new();
    for &(value, weight) in steps {
        let (mut value, mut weight, mut count) = (value, weight, 1);
        while let Some(&(before, weight_before, count_before)) = pools.last().filter(|pool| pool.0 < value) {
            let both = weight + weight_before;
            value = (value * weight as f64 + before * weight_before as f64) / both.max(1) as f64;
            (weight, count) = (both, count + count_before);
            pools.pop();
        }
        pools.push((value, weight, count));
    }
    pools.into_iter().flat_map(|(value, _, count)| std::iter::repeat_n(value, count)).collect()
}

fn rounded(value: f64) -> f64 {
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;
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

    /// The mean over draws of the squared length of errors in units of their covariance, a number, where numbers have so many common errors
    /// of falling size, and half of the least as their own; both as drawn 24 times, and as often again for each setup that has a third.
    fn squared_length(numbers: usize, causes: usize, groups: usize) -> f64 {
        const DRAWS: usize = 60;
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let mut sum = 0.0;
        for _ in 0..DRAWS {
            let causes = DMatrix::from_fn(numbers, causes, |_, cause| normal() / (1 + cause) as f64);
            let mut draw = || -> DVector<f64> {
                let common = DVector::from_fn(causes.ncols(), |_, _| normal());
                &causes * common + 0.5 / causes.ncols() as f64 * DVector::from_fn(numbers, |_, _| normal())
            };
            let mut drawn = DMatrix::from_columns(&(0..groups).map(|_| draw()).collect::<Vec<_>>());
            let mean = drawn.column_mean();
            drawn.column_iter_mut().for_each(|mut column| column -= &mean);
            let stds: Vec<f64> = drawn.row_iter().map(|row| row.norm() / (groups as f64 - 1.0).sqrt()).collect();
            drawn.row_iter_mut().for_each(|mut row| row.unscale_mut(row.norm()));
            let common = common_errors(&drawn, 0);
            let own = common.row_iter().map(|row| 1.0 - row.norm_squared());
            let own = DMatrix::from_diagonal(&DVector::from_iterator(numbers, own));
            let covariance = own + &common * common.transpose();
            let error = DVector::from_iterator(numbers, draw().iter().zip(&stds).map(|(error, std)| error / std));
            sum += error.dot(&covariance.cholesky().unwrap().solve(&error)) / numbers as f64;
        }
        sum / DRAWS as f64
    }

    /// The covariance of 24 groups as it is, but for the number's own share, gives 2.5 and more; shrunk towards none, 0.6 and less.
    #[test]
    fn errors_of_few_causes_are_as_large_as_their_covariance_says() {
        for numbers in [20, 40] {
            let found = squared_length(numbers, 3, 24);
            assert!((0.8..1.3).contains(&found), "{numbers} numbers: {found}");
        }
    }

    /// As of several setups: more directions than there are columns. What is dropped makes errors no smaller.
    #[test]
    fn what_is_not_kept_of_many_directions_is_each_numbers_own() {
        let found = squared_length(45, 45, 72);
        assert!((0.6..1.4).contains(&found), "{found}");
    }

    #[test]
    fn a_number_whose_deviation_is_not_known_leaves_the_others_theirs() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let [changes, _] = changes(0.0, &mut random);
        let stds = vec![0.1, f64::INFINITY, 0.3, 0.4];
        let numbers = Numbers { frequency_hz: 1.0, bandwidth_hz: 0.02, stds, changes: &changes };
        let found = factors(&[numbers], 0.001).remove(0).unwrap();
        assert!(found.damping_ratio.iter().all(|value| *value == 0.0), "{found:?}");
        // One of the three directions that are left counts as that along the shape, so that the two do not go together all the way.
        let together = product(&found.frequency_hz, &found.shape[0]) / (0.1 * 0.3);
        assert!((0.1..1.0).contains(&together), "{found:?}");
    }

    #[test]
    fn values_that_rise_are_pooled_by_their_weights() {
        assert_eq!(falling(&[(5.0, 1), (1.0, 1), (3.0, 1), (1.0, 2)]), [5.0, 2.0, 2.0, 1.0]);
        assert_eq!(falling(&[(1.0, 3), (5.0, 1)]), [2.0, 2.0]);
        assert!(falling(&[]).is_empty());
    }

    #[test]
    fn many_columns_become_few_that_hold_most() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let causes = DMatrix::from_fn(60, 40, |_, cause| normal() / (1 + cause) as f64);
        let mut rows = causes * DMatrix::from_fn(40, 96, |_, _| normal());
        let mean = rows.column_mean();
        rows.column_iter_mut().for_each(|mut column| column -= &mean);
        rows.row_iter_mut().for_each(|mut row| row.unscale_mut(row.norm()));
        let common = common_errors(&rows, 0);
        assert_eq!(common.ncols(), MOST_COLUMNS);
        let mut off = &common * common.transpose() - &rows * rows.transpose();
        off.fill_diagonal(0.0);
        assert!(off.amax() < 0.15, "{}", off.amax());
    }
}
