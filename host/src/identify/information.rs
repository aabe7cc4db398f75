//! Fisher information and gradient, from the derivatives at each line.
//!
//! Derivatives of a small Hermitian matrix by all unknowns flow in, line by line; their sums of products flow out. Most of a joint fit's
//! time goes here, so the loops are written for wide registers.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use crate::processor::{loaded, on_this_processor, store};

/// Unknowns that are worked out at once.
const LANES: usize = 8;

/// Derivatives of a Hermitian matrix at one line. Its entries are real numbers: those of the diagonal, and real and imaginary part of
/// those above it times the root of 2, so that sums of squares are those of the whole matrix.
pub(super) struct Derivatives {
    size: usize,
    unknowns: usize,
    /// Entry by entry, unknown by unknown, with zeros behind the last up to `wide`.
    values: Vec<f64>,
    wide: usize,
    /// The unknown that comes next.
    next: usize,
    /// Working space.
    column: Vec<Complex64>,
    row: Vec<Complex64>,
}

impl Derivatives {
    pub(super) fn new(size: usize, unknowns: usize) -> Self {
        let wide = unknowns.next_multiple_of(LANES);
        let (column, row) = (vec![Complex64::ZERO; size], vec![Complex64::ZERO; size]);
        Self { size, unknowns, values: vec![0.0; size * size * wide], wide, next: 0, column, row }
    }

    /// Begins another line.
    pub(super) fn start(&mut self) {
        self.next = 0;
    }

    /// Takes the derivative `u q + (u q)ᴴ` by the next unknown, u a column and q a row.
    pub(super) fn put(&mut self, u: impl Fn(usize) -> Complex64, q: impl Fn(usize) -> Complex64) {
        for at in 0..self.size {
            (self.column[at], self.row[at]) = (u(at), q(at));
        }
        let mut place = self.next;
        let mut put = |value: f64| {
            self.values[place] = value;
            place += self.wide;
        };
        for k in 0..self.size {
            put(2.0 * (self.column[k] * self.row[k]).re);
            for l in k + 1..self.size {
                let value = self.column[k] * self.row[l] + (self.column[l] * self.row[k]).conj();
                put(std::f64::consts::SQRT_2 * value.re);
                put(std::f64::consts::SQRT_2 * value.im);
            }
        }
        self.next += 1;
    }
}

/// The sums over lines.
pub(super) struct Information {
    unknowns: usize,
    wide: usize,
    gradient: Vec<f64>,
    /// Row by row, of which what is above the diagonal counts.
    fisher: Vec<f64>,
}

impl Information {
    pub(super) fn zero(unknowns: usize) -> Self {
        let wide = unknowns.next_multiple_of(LANES);
        Self { unknowns, wide, gradient: vec![0.0; wide], fisher: vec![0.0; unknowns * wide] }
    }

    /// Adds a line's: its derivatives, and what the matrix has there beyond what is expected, in the same entries.
    pub(super) fn add(&mut self, derivatives: &Derivatives, excess: &[f64]) {
        debug_assert_eq!((derivatives.unknowns, derivatives.next), (self.unknowns, self.unknowns));
        let (wide, values) = (self.wide, &derivatives.values);
        on_this_processor(
            #[inline(always)]
            |arithmetic| {
                let mut first = 0;
                while first < wide {
                    let mut sums = loaded::<f64, LANES>(&self.gradient, first);
                    for entry in 0..excess.len() {
                        let (excess, others) = (excess[entry], loaded::<f64, LANES>(values, entry * wide + first));
                        for lane in 0..LANES {
                            sums[lane] = arithmetic.multiply_add(excess, others[lane], sums[lane]);
                        }
                    }
                    store(&mut self.gradient, first, &sums);
                    for row in 0..(first + LANES).min(self.unknowns) {
                        let mut sums = loaded::<f64, LANES>(&self.fisher, row * wide + first);
                        for entry in 0..excess.len() {
                            let own = values[entry * wide + row];
                            let others = loaded::<f64, LANES>(values, entry * wide + first);
                            for lane in 0..LANES {
                                sums[lane] = arithmetic.multiply_add(own, others[lane], sums[lane]);
                            }
                        }
                        store(&mut self.fisher, row * wide + first, &sums);
                    }
                    first += LANES;
                }
            },
        );
    }

    /// The gradient and the Fisher information.
    pub(super) fn sums(&self) -> (DVector<f64>, DMatrix<f64>) {
        let above = |row: usize, column: usize| self.fisher[row.min(column) * self.wide + row.max(column)];
        let fisher = DMatrix::from_fn(self.unknowns, self.unknowns, above);
        (DVector::from_column_slice(&self.gradient[..self.unknowns]), fisher)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sums_are_those_of_the_products_of_whole_matrices() {
        // One mode with its 6 unknowns, and numbers of unknowns that are no multiple of the lanes, and are one.
        for (size, unknowns) in [(1, 6), (2, 16), (3, 11), (4, 24)] {
            compare_with_whole_matrices(size, unknowns);
        }
    }

    fn compare_with_whole_matrices(size: usize, unknowns: usize) {
        let value = |seed: usize| Complex64::new((seed as f64 * 0.7).sin(), (seed as f64 * 1.3).cos());
        let mut information = Information::zero(unknowns);
        let mut derivatives = Derivatives::new(size, unknowns);
        let mut fisher: DMatrix<f64> = DMatrix::zeros(unknowns, unknowns);
        let mut gradient: DVector<f64> = DVector::zeros(unknowns);
        for line in 0..4 {
            let column = |unknown: usize, at: usize| value(97 * line + 13 * unknown + at);
            let row = |unknown: usize, at: usize| value(89 * line + 17 * unknown + at + 7);
            derivatives.start();
            for unknown in 0..unknowns {
                derivatives.put(|k| column(unknown, k), |l| row(unknown, l));
            }
            let half = DMatrix::from_fn(size, size, |k, l| value(71 * line + 5 * k + 3 * l + 1));
            let excess = &half + half.adjoint();
            let mut entries = Vec::new();
            for k in 0..size {
                entries.push(excess[(k, k)].re);
                for l in k + 1..size {
                    entries.extend([excess[(k, l)].re, excess[(k, l)].im].map(|part| std::f64::consts::SQRT_2 * part));
                }
            }
            information.add(&derivatives, &entries);
            let whole = |unknown: usize| {
                let half = DMatrix::from_fn(size, size, |k, l| column(unknown, k) * row(unknown, l));
                &half + half.adjoint()
            };
            fisher += DMatrix::from_fn(unknowns, unknowns, |a, b| (whole(a) * whole(b)).trace().re);
            gradient += DVector::from_fn(unknowns, |a, _| (whole(a) * &excess).trace().re);
        }
        let (found_gradient, found_fisher) = information.sums();
        assert!((found_fisher - &fisher).norm() < 1e-12 * fisher.norm(), "{size}, {unknowns}");
        assert!((found_gradient - &gradient).norm() < 1e-12 * gradient.norm(), "{size}, {unknowns}");
    }
}
