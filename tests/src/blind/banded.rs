//! Symmetric matrices that reach no further than one node, and the lowest modes of a pair of them.
//!
//! Modes come from subspace iteration (Bathe, "Finite Element Procedures", section 11.6): a matrix of 600 rows gives its
//! forty lowest modes in some hundredths of a second.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Entries below the diagonal that a row can have: two nodes of five DOFs.
const REACH: usize = 9;
const MOST_ROUNDS: usize = 60;
const TOLERANCE: f64 = 1e-10;

/// The lower half, row by row, `REACH` entries left of the diagonal and it.
#[derive(Debug, Clone)]
pub(super) struct Banded {
    rows: Vec<[f64; REACH + 1]>,
}

impl Banded {
    pub(super) fn zeros(order: usize) -> Self {
        Self { rows: vec![[0.0; REACH + 1]; order] }
    }

    pub(super) fn order(&self) -> usize {
        self.rows.len()
    }

    /// Adds to an entry; of the two that mirror each other only the lower counts.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        if column <= row {
            self.rows[row][REACH + column - row] += value;
        }
    }

    pub(super) fn diagonal(&self, row: usize) -> f64 {
        self.rows[row][REACH]
    }

    /// Takes a DOF out: nothing of it is left but `value` on the diagonal.
    pub(super) fn fix(&mut self, dof: usize, value: f64) {
        self.rows[dof] = [0.0; REACH + 1];
        self.rows[dof][REACH] = value;
        for below in dof + 1..self.order().min(dof + REACH + 1) {
            self.rows[below][REACH + dof - below] = 0.0;
        }
    }

    /// Row, columns from the first that the band reaches, entries.
    fn lower(&self, row: usize) -> (usize, &[f64]) {
        let first = row.saturating_sub(REACH);
        (first, &self.rows[row][REACH + first - row..])
    }

    pub(super) fn times(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(self.order(), columns.ncols());
        for (input, mut output) in columns.column_iter().zip(product.column_iter_mut()) {
            for row in 0..self.order() {
                let (first, entries) = self.lower(row);
                for (column, entry) in (first..).zip(entries) {
                    output[row] += entry * input[column];
                    if column != row {
                        output[column] += entry * input[row];
                    }
                }
            }
        }
        product
    }

    /// The Cholesky factor, in the same form; `None` where the matrix is not positive definite.
    fn cholesky(mut self) -> Option<Self> {
        for row in 0..self.order() {
            let first = row.saturating_sub(REACH);
            for column in first..=row {
                let from = first.max(column.saturating_sub(REACH));
                let dot: f64 = (from..column)
                    .map(|inner| self.rows[row][REACH + inner - row] * self.rows[column][REACH + inner - column])
                    .sum();
                let rest = self.rows[row][REACH + column - row] - dot;
                self.rows[row][REACH + column - row] = if column < row {
                    rest / self.rows[column][REACH]
                } else if rest > 0.0 {
                    rest.sqrt()
                } else {
                    return None;
                };
            }
        }
        Some(self)
    }

    /// Solves with the Cholesky factor that this is.
    fn solve(&self, mut right: DMatrix<f64>) -> DMatrix<f64> {
        for mut x in right.column_iter_mut() {
            for row in 0..self.order() {
                let (first, entries) = self.lower(row);
                let dot: f64 = (first..row).zip(entries).map(|(column, entry)| entry * x[column]).sum();
                x[row] = (x[row] - dot) / self.rows[row][REACH];
            }
            for row in (0..self.order()).rev() {
                x[row] /= self.rows[row][REACH];
                let (first, entries) = self.lower(row);
                for (column, entry) in (first..row).zip(entries) {
                    x[column] -= entry * x[row];
                }
            }
        }
        right
    }
}

/// Undamped modes, lowest first, shapes of unit modal mass in columns.
#[derive(Debug, Clone)]
pub(super) struct Modes {
    pub(super) frequencies_hz: Vec<f64>,
    pub(super) shapes: DMatrix<f64>,
}

/// The lowest `count` modes; `None` where the stiffness is not positive definite (it buckles).
pub(super) fn lowest_modes(stiffness: &Banded, mass: &Banded, count: usize) -> Option<Modes> {
    let factor = stiffness.clone().cholesky()?;
    let order = stiffness.order();
    let width = (count + count / 2 + 8).min(order);
    // Any start that is not blind to a mode will do.
    let mut basis = DMatrix::from_fn(order, width, |row, column| {
        ((row as f64 + 1.3) * (column as f64 + 0.7) * 0.618_033_988_7).fract() - 0.5
    });
    let mut eigenvalues = vec![0.0; count];
    for _ in 0..MOST_ROUNDS {
        let moved = mass.times(&basis);
        let next = factor.solve(moved);
        // mu (K) v = (M) v with mu = 1/lambda, in the span.
        let reduced_stiffness = next.transpose() * stiffness.times(&next);
        let reduced_mass = next.transpose() * mass.times(&next);
        let scale = DVector::from_fn(width, |at, _| 1.0 / reduced_stiffness[(at, at)].sqrt());
        let scaled = |matrix: &DMatrix<f64>| {
            DMatrix::from_fn(width, width, |i, j| 0.5 * (matrix[(i, j)] + matrix[(j, i)]) * scale[i] * scale[j])
        };
        // The span's own metric, by its eigenvectors: the first rounds' vectors are nearly dependent.
        let metric = SymmetricEigen::new(scaled(&reduced_stiffness));
        let kept: Vec<usize> =
            (0..width).filter(|&at| metric.eigenvalues[at] > 1e-13 * metric.eigenvalues.amax()).collect();
        let whitening = DMatrix::from_fn(width, kept.len(), |i, j| {
            scale[i] * metric.eigenvectors[(i, kept[j])] / metric.eigenvalues[kept[j]].sqrt()
        });
        let symmetric = whitening.transpose() * &reduced_mass * &whitening;
        let solved = SymmetricEigen::new((&symmetric + symmetric.transpose()) * 0.5);
        let mut order_of: Vec<usize> = (0..kept.len()).collect();
        order_of.sort_by(|&a, &b| solved.eigenvalues[b].total_cmp(&solved.eigenvalues[a]));
        let turned = DMatrix::from_fn(kept.len(), kept.len(), |i, j| solved.eigenvectors[(i, order_of[j])]);
        let found: Vec<f64> = order_of.iter().take(count).map(|&at| 1.0 / solved.eigenvalues[at]).collect();
        let mut ritz = next * whitening * turned;
        // K-normalised so far.
        for (at, mut column) in ritz.column_iter_mut().enumerate() {
            column /= solved.eigenvalues[order_of[at]].abs().max(f64::MIN_POSITIVE).sqrt();
        }
        let moved = found.iter().zip(&eigenvalues).map(|(new, old)| ((new - old) / new).abs()).fold(0.0, f64::max);
        let complete = ritz.ncols() >= count;
        eigenvalues = found;
        if complete && moved < TOLERANCE {
            let shapes = ritz.columns(0, count).into_owned();
            return Some(Modes { frequencies_hz: eigenvalues.iter().map(|l| l.sqrt() / TAU).collect(), shapes });
        }
        basis = DMatrix::from_fn(order, width, |row, column| {
            if column < ritz.ncols() {
                ritz[(row, column)]
            } else {
                ((row as f64 + 2.1) * (column as f64 + 0.3) * 0.414_213_562_4).fract() - 0.5
            }
        });
    }
    let columns = count.min(basis.ncols());
    Some(Modes {
        frequencies_hz: eigenvalues.iter().map(|l| l.sqrt() / TAU).collect(),
        shapes: basis.columns(0, columns).into_owned(),
    })
}
