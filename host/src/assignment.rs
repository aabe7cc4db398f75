//! Who belongs to whom: how alike each of some is to each of others flows in, pairs flow out.

use pathfinding::prelude::{Matrix, kuhn_munkres};

/// Likeness is brought to whole numbers for the assignment.
const WHOLE: f64 = 1e9;

/// How alike two modes are: their MAC, or what stands for it, times `exp(-(ln ratio)²/(2 deviation²))` of their frequencies' ratio; nothing below
/// `least`.
pub(crate) fn likeness(mac: f64, ratio: f64, deviation: f64, least: f64) -> f64 {
    let off = ratio.ln() / deviation;
    let likeness = mac * (-0.5 * off * off).exp();
    if likeness < least { 0.0 } else { likeness }
}

/// Pairs of rows and columns, each in one pair at most, so that the sum of likeness is the largest; what has none is no pair. In the order of
/// the rows.
pub(crate) fn assigned(rows: usize, columns: usize, likeness: &dyn Fn(usize, usize) -> f64) -> Vec<(usize, usize)> {
    if rows == 0 || columns == 0 {
        return Vec::new();
    }
    // A column for every row that stays without a partner: the assignment wants no fewer columns than rows.
    let weights = Matrix::from_fn(rows, columns + rows, |(row, column)| {
        if column < columns { (likeness(row, column) * WHOLE) as i64 } else { 0 }
    });
    let (_, assignment) = kuhn_munkres(&weights);
    let is_pair = |&(row, column): &(usize, usize)| column < columns && weights[(row, column)] > 0;
    assignment.into_iter().enumerate().filter(is_pair).collect()
}
