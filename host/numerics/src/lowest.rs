//! The modes of lowest frequency of a large structure near one whose modes are known: factors of matrices with few entries beside the
//! diagonal, and subspace iteration.

use nalgebra::DMatrix;

use crate::eigen::{EigenPairs, reduced_eigen};

/// The entries of a row from the first one to the diagonal.
#[derive(Debug, Clone, PartialEq)]
struct EnvelopeRow {
    first: usize,
    entries: Vec<f64>,
}

/// The lower triangle of a symmetric matrix, row by row from the first entry that is not zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Envelope {
    rows: Vec<EnvelopeRow>,
}

impl Envelope {
    /// Of a symmetric matrix.
    ///
    /// # Panics
    /// Where the matrix is not square.
    pub fn of(matrix: &DMatrix<f64>) -> Self {
        assert!(matrix.is_square(), "a matrix that is {} x {} is not symmetric", matrix.nrows(), matrix.ncols());
        // A column of the upper triangle is a row of the lower one, and columns are stored one after the other.
        let row = |(index, column): (usize, nalgebra::DVectorView<'_, f64>)| {
            let upper = column.rows(0, index + 1);
            let first = upper.iter().position(|&entry| entry != 0.0).unwrap_or(index).min(index);
            EnvelopeRow { first, entries: upper.iter().skip(first).copied().collect() }
        };
        Self { rows: matrix.column_iter().enumerate().map(row).collect() }
    }

    /// Entries that are stored.
    pub fn entries(&self) -> usize {
        self.rows.iter().map(|row| row.entries.len()).sum()
    }

    /// The product with vectors, which stand in the rows of `transposed`, vectors x rows; so do the products.
    ///
    /// # Panics
    /// Where it has not as many columns as the matrix has rows.
    pub fn times(&self, transposed: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(transposed.ncols(), self.rows.len(), "vectors of another length");
        let mut product = DMatrix::zeros(transposed.nrows(), transposed.ncols());
        for (index, row) in self.rows.iter().enumerate() {
            for (offset, &entry) in row.entries.iter().enumerate().filter(|(_, entry)| **entry != 0.0) {
                let other = row.first + offset;
                product.column_mut(index).axpy(entry, &transposed.column(other), 1.0);
                if other != index {
                    product.column_mut(other).axpy(entry, &transposed.column(index), 1.0);
                }
            }
        }
        product
    }

    /// The factors; `None` where the matrix is not positive definite, or singular up to rounding: a pivot at or below the share `negligible` of
    /// its own diagonal entry counts as zero.
    pub fn factor(&self, negligible: f64) -> Option<EnvelopeFactor> {
        let factor = self.clone().eliminated()?;
        let diagonal = self.rows.iter().filter_map(|row| row.entries.last());
        let is_sound = |(pivot, diagonal): (&f64, &f64)| *pivot > (negligible * diagonal).max(0.0);
        factor.pivots.iter().zip(diagonal).all(is_sound).then_some(factor)
    }

    /// How many eigenvalues of `self x = value other x` lie below `value`, `other` positive definite: negative pivots of
    /// `self - value other` (Sylvester's law of inertia). `None` where a pivot vanishes, for `value` is one of them.
    ///
    /// # Panics
    /// Where the two are not of the same size.
    pub fn count_below(&self, other: &Self, value: f64) -> Option<usize> {
        assert_eq!(self.rows.len(), other.rows.len(), "matrices of different sizes");
        let difference = |(index, (own, other)): (usize, (&EnvelopeRow, &EnvelopeRow))| {
            let first = own.first.min(other.first);
            let mut entries = vec![0.0; index + 1 - first];
            for (row, factor) in [(own, 1.0), (other, -value)] {
                let places = entries[row.first - first..].iter_mut();
                places.zip(&row.entries).for_each(|(entry, more)| *entry += factor * more);
            }
            EnvelopeRow { first, entries }
        };
        let rows = self.rows.iter().zip(&other.rows).enumerate().map(difference).collect();
        let factor = Self { rows }.eliminated()?;
        Some(factor.pivots.iter().filter(|pivot| **pivot < 0.0).count())
    }

    /// The matrix as `L D Lᵀ`; `None` where a pivot vanishes.
    fn eliminated(mut self) -> Option<EnvelopeFactor> {
        let mut pivots: Vec<f64> = Vec::with_capacity(self.rows.len());
        for index in 0..self.rows.len() {
            let (done, rest) = self.rows.split_at_mut(index);
            let EnvelopeRow { first, entries } = rest.first_mut()?;
            let first = *first;
            // Those of L D.
            for offset in 0..index - first {
                let other = &done[first + offset];
                let from = first.max(other.first);
                let products = entries[from - first..offset].iter().zip(&other.entries[from - other.first..]);
                entries[offset] -= products.map(|(a, b)| a * b).sum::<f64>();
            }
            let mut pivot = entries.pop()?;
            for (entry, above) in entries.iter_mut().zip(&pivots[first..]) {
                let scaled = *entry / above;
                pivot -= scaled * *entry;
                *entry = scaled;
            }
            if pivot == 0.0 || !pivot.is_finite() {
                return None;
            }
            pivots.push(pivot);
        }
        Some(EnvelopeFactor { rows: self.rows, pivots })
    }
}

/// A symmetric matrix as `L D Lᵀ`, where L has ones on its diagonal and in each row nothing before the first entry of the matrix' row
/// (skyline storage: Bathe 2014, "Finite Element Procedures", section 8.2.3). For a beam it takes a hundredth of the work of a whole one.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvelopeFactor {
    /// Rows of L without their ones.
    rows: Vec<EnvelopeRow>,
    /// The diagonal of D.
    pivots: Vec<f64>,
}

impl EnvelopeFactor {
    /// Solves `L D Lᵀ x = b` for vectors that stand in the rows of `transposed`, vectors x rows; so do the solutions.
    ///
    /// # Panics
    /// Where it has not as many columns as the matrix has rows.
    pub fn solve(&self, transposed: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(transposed.ncols(), self.rows.len(), "vectors of another length");
        let count = transposed.nrows();
        let mut solved = transposed.clone();
        let all = solved.as_mut_slice();
        for (index, row) in self.rows.iter().enumerate() {
            let (before, own) = all.split_at_mut(index * count);
            for (offset, entry) in row.entries.iter().enumerate() {
                let other = &before[(row.first + offset) * count..][..count];
                own.iter_mut().zip(other).for_each(|(own, other)| *own -= entry * other);
            }
        }
        for (own, pivot) in all.chunks_exact_mut(count.max(1)).zip(&self.pivots) {
            own.iter_mut().for_each(|own| *own /= pivot);
        }
        for (index, row) in self.rows.iter().enumerate().rev() {
            let (before, own) = all.split_at_mut(index * count);
            for (offset, entry) in row.entries.iter().enumerate() {
                let other = &mut before[(row.first + offset) * count..][..count];
                other.iter_mut().zip(&*own).for_each(|(other, own)| *other -= entry * own);
            }
        }
        solved
    }
}

/// At most so many steps: vectors that take more are no longer near.
const MOST_STEPS: usize = 8;
/// Vectors are brought nearer so often before they are turned within their span, which takes several times as long.
const SOLUTIONS_A_STEP: usize = 2;
/// How far off sharp vectors may be, in shares of their length.
const SHARP: f64 = 1e-7;

/// The eigenpairs of `mass x = mu stiffness x` of largest mu (lowest frequency), as many as there are vectors in the rows of `near`, which are
/// to be near them; largest first, `xᵀ stiffness x = 1`. The first `sharp` of them have vectors that are right to some 1e-7 of their length;
/// the others are as near as these need.
///
/// Subspace iteration (Bathe 2014, section 11.6): `stiffness Y = mass X`, then the eigenpairs of both matrices in the span of Y. A vector's error
/// falls in each step by the ratio of the first mu that is left out to its own. That no mode is left out among the sharp ones is checked by
/// the count of eigenvalues (Sturm). `None` where it does not converge, or one is left out.
///
/// # Panics
/// Where sizes do not fit.
pub fn lowest_modes(
    stiffness: &Envelope,
    factor: &EnvelopeFactor,
    mass: &Envelope,
    near: &DMatrix<f64>,
    sharp: usize,
) -> Option<EigenPairs<f64>> {
    let count = near.nrows();
    let sharp = sharp.min(count.saturating_sub(1));
    let mut inertia = mass.times(near);
    let mut before: Option<Vec<f64>> = None;
    for _ in 0..MOST_STEPS {
        let mut loads = inertia;
        let mut solved = factor.solve(&loads);
        for _ in 1..SOLUTIONS_A_STEP {
            // Each as long as it was: the higher ones shrink faster.
            let products = solved.row_iter().zip(loads.row_iter()).map(|(solved, load)| solved.dot(&load));
            let lengths: Vec<f64> = products.map(f64::sqrt).collect();
            solved.row_iter_mut().zip(lengths).for_each(|(mut solved, length)| solved /= length);
            loads = mass.times(&solved);
            solved = factor.solve(&loads);
        }
        // K Y = M X, so that Yᵀ K Y needs no product with K.
        let strain = &solved * loads.transpose();
        inertia = mass.times(&solved);
        let kinetic = &solved * inertia.transpose();
        let EigenPairs { values, vectors } = reduced_eigen(&strain, &kinetic)?;
        let turned = vectors.transpose();
        let least = *values.last()?;
        let is_sharp = |(mode, &mu): (usize, &f64)| {
            let change = before.as_ref().map_or(1.0, |before| (1.0 - before[mode] / mu).abs());
            // An eigenvalue is off by the square of what its vector is off by.
            change.sqrt() * (least / mu).abs().powi(SOLUTIONS_A_STEP as i32) < SHARP
        };
        if values.iter().take(sharp).enumerate().all(is_sharp) {
            let vectors = (turned * solved).transpose();
            let is_complete = match sharp {
                0 => true,
                _ => stiffness.count_below(mass, 2.0 / (values[sharp - 1] + values[sharp]))? == sharp,
            };
            return is_complete.then_some(EigenPairs { values, vectors });
        }
        inertia = turned * inertia;
        before = Some(values);
    }
    None
}
