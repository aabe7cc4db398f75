//! How the errors of a mode's numbers hang together, and those of modes whose spectra overlap.
//!
//! What each group of windows changes flows in; a few columns a mode flow out, so that the covariance of two numbers is the sum of
//! the products of their rows.

use nalgebra::{DMatrix, RowDVector};
use serde::{Deserialize, Serialize};

use super::scatter::GroupChanges;

/// More columns than this are replaced by as many that hold most.
const MOST_COLUMNS: usize = 24;
/// Modes are known jointly where their distance is below this many bandwidths of the wider one, and so many lines.
const REACH_BANDWIDTHS: f64 = 1.0;
const REACH_LINES: f64 = 2.0;
/// Digits that are kept.
const DIGITS: usize = 4;

/// The errors of a mode's numbers as sums of independent ones of unit variance. The covariance of two numbers is the sum over the
/// columns of the products of their entries, also of numbers of two modes of one group; a number's variance is the square of its
/// standard deviation, which is no less than its entries' squares: what they lack is its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointScatter {
    /// Modes of one group have errors that hang together; those of different groups are independent.
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

/// The joint scatter of modes, lowest frequency first; `None` for a mode of which it is not known.
pub(super) fn joint(modes: &[Numbers<'_>], spacing_hz: f64) -> Vec<Option<JointScatter>> {
    let is_joint = |pair: &[Numbers<'_>]| {
        let reach_hz = REACH_BANDWIDTHS * pair[0].bandwidth_hz.max(pair[1].bandwidth_hz) + REACH_LINES * spacing_hz;
        pair[1].frequency_hz - pair[0].frequency_hz < reach_hz && pair[0].changes.groups() == pair[1].changes.groups()
    };
    let mut all = Vec::new();
    let mut first = 0;
    for last in 0..modes.len() {
        if last + 1 < modes.len() && is_joint(&modes[last..last + 2]) {
            continue;
        }
        all.extend(of_group(&modes[first..=last], first + 1));
        first = last + 1;
    }
    all
}

fn of_group(modes: &[Numbers<'_>], group: usize) -> Vec<Option<JointScatter>> {
    let rows: Vec<Option<DMatrix<f64>>> = modes.iter().map(correlated).collect();
    let stacked: Vec<RowDVector<f64>> =
        rows.iter().flatten().flat_map(|rows| rows.row_iter().map(|row| row.into_owned())).collect();
    let turn = (!stacked.is_empty()).then(|| principal(&DMatrix::from_rows(&stacked)));
    let scatter = |(mode, rows): (&Numbers<'_>, &Option<DMatrix<f64>>)| {
        let (rows, turn) = rows.as_ref().zip(turn.as_ref())?;
        let rows = rows * turn;
        let row =
            |index: usize| rows.row(index).iter().map(|value| rounded(value * mode.stds[index])).collect::<Vec<f64>>();
        let shape = (2..rows.nrows()).map(row).collect();
        Some(JointScatter { group, frequency_hz: row(0), damping_ratio: row(1), shape })
    };
    modes.iter().zip(&rows).map(scatter).collect()
}

/// A mode's rows in units of their standard deviations. What a few groups change has correlations by chance, so they are shrunk as
/// far as chance goes (Schaefer and Strimmer 2005, eq. 8, with the variance of a normal variable's correlation).
fn correlated(mode: &Numbers<'_>) -> Option<DMatrix<f64>> {
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
    let correlations = &rows * rows.transpose();
    let (mut chance, mut squares) = (0.0, 0.0);
    for column in 0..correlations.ncols() {
        for row in 0..column {
            let square = correlations[(row, column)].powi(2);
            chance += (1.0 - square).powi(2) / (groups as f64 - 1.0);
            squares += square;
        }
    }
    let kept = if squares > 0.0 { (1.0 - chance / squares).max(0.0) } else { 0.0 };
    Some(rows * kept.sqrt())
}

/// What columns are multiplied by so that a few of them hold most: the first principal axes.
fn principal(rows: &DMatrix<f64>) -> DMatrix<f64> {
    let columns = rows.ncols();
    if columns <= MOST_COLUMNS {
        return DMatrix::identity(columns, columns);
    }
    let eigen = rows.tr_mul(rows).symmetric_eigen();
    let mut order: Vec<usize> = (0..columns).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    eigen.eigenvectors.select_columns(&order[..MOST_COLUMNS])
}

fn rounded(value: f64) -> f64 {
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(0.0)
}
