//! The modes of lowest frequency of a large structure near one whose modes are known: factors of matrices with few entries beside the
//! diagonal, and subspace iteration.

use nalgebra::DMatrix;

use crate::eigen::{EigenPairs, reduced_eigen};

/// The Cholesky factor L of a symmetric positive definite matrix, which has in each row nothing before the first entry of the matrix' row
/// (skyline storage: Bathe 2014, "Finite Element Procedures", section 8.2.3). For a beam it takes a hundredth of the work of a whole one.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvelopeFactor {
    rows: Vec<EnvelopeRow>,
}

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

    /// The Cholesky factor; `None` where the matrix is not positive definite, or singular up to rounding: a pivot at or below the share
    /// `negligible` of its own diagonal entry counts as zero.
    pub fn factor(&self, negligible: f64) -> Option<EnvelopeFactor> {
        let mut rows: Vec<EnvelopeRow> = Vec::with_capacity(self.rows.len());
        for (index, row) in self.rows.iter().enumerate() {
            let mut entries = row.entries.clone();
            for offset in 0..entries.len() {
                let other = row.first + offset;
                let done = if other < index { Some(&rows[other]) } else { None };
                let first = done.map_or(row.first, |done| row.first.max(done.first));
                let own = &entries[first - row.first..offset];
                match done {
                    Some(done) => {
                        let products = own.iter().zip(&done.entries[first - done.first..]);
                        let left = entries[offset] - products.map(|(a, b)| a * b).sum::<f64>();
                        entries[offset] = left / done.entries[other - done.first];
                    }
                    None => {
                        let pivot = entries[offset] - own.iter().map(|own| own * own).sum::<f64>();
                        if pivot.is_nan() || pivot <= negligible * entries[offset] || pivot <= 0.0 {
                            return None;
                        }
                        entries[offset] = pivot.sqrt();
                    }
                }
            }
            rows.push(EnvelopeRow { first: row.first, entries });
        }
        Some(EnvelopeFactor { rows })
    }

    /// How many eigenvalues of `self x = value other x` lie below `value`, `other` positive definite: negative pivots of
    /// `self - value other` (Sylvester's law of inertia). `None` where a pivot vanishes, for `value` is one of them.
    ///
    /// # Panics
    /// Where the two are not of the same size.
    pub fn count_below(&self, other: &Self, value: f64) -> Option<usize> {
        assert_eq!(self.rows.len(), other.rows.len(), "matrices of different sizes");
        let mut rows: Vec<EnvelopeRow> = Vec::with_capacity(self.rows.len());
        let mut pivots: Vec<f64> = Vec::with_capacity(self.rows.len());
        for (index, (own, other)) in self.rows.iter().zip(&other.rows).enumerate() {
            let first = own.first.min(other.first);
            let mut entries = vec![0.0; index + 1 - first];
            for (row, factor) in [(own, 1.0), (other, -value)] {
                let places = entries[row.first - first..].iter_mut();
                places.zip(&row.entries).for_each(|(entry, more)| *entry += factor * more);
            }
            // Row by row, `entries` become those of L D first, then of L.
            for offset in 0..entries.len() - 1 {
                let done = &rows[first + offset];
                let from = first.max(done.first);
                let products = entries[from - first..offset].iter().zip(&done.entries[from - done.first..]);
                entries[offset] -= products.map(|(a, b)| a * b).sum::<f64>();
            }
            let mut pivot = entries[index - first];
            for (offset, &pivot_there) in pivots[first..index].iter().enumerate() {
                let scaled = entries[offset] / pivot_there;
                pivot -= scaled * entries[offset];
                entries[offset] = scaled;
            }
            if pivot == 0.0 || !pivot.is_finite() {
                return None;
            }
            entries[index - first] = 1.0;
            rows.push(EnvelopeRow { first, entries });
            pivots.push(pivot);
        }
        Some(pivots.iter().filter(|pivot| **pivot < 0.0).count())
    }
}

impl EnvelopeFactor {
    /// Solves `L Lᵀ x = b` for vectors that stand in the rows of `transposed`, vectors x rows: the solutions take their place.
    ///
    /// # Panics
    /// Where it has not as many columns as the matrix has rows.
    pub fn solve(&self, transposed: &mut DMatrix<f64>) {
        assert_eq!(transposed.ncols(), self.rows.len(), "vectors of another length");
        let count = transposed.nrows();
        let all = transposed.as_mut_slice();
        for (index, row) in self.rows.iter().enumerate() {
            let (before, own) = all.split_at_mut(index * count);
            let own = &mut own[..count];
            let (pivot, entries) = row.entries.split_last().unwrap_or((&1.0, &[]));
            for (offset, entry) in entries.iter().enumerate() {
                let other = &before[(row.first + offset) * count..][..count];
                own.iter_mut().zip(other).for_each(|(own, other)| *own -= entry * other);
            }
            own.iter_mut().for_each(|own| *own /= pivot);
        }
        for (index, row) in self.rows.iter().enumerate().rev() {
            let (before, own) = all.split_at_mut(index * count);
            let own = &mut own[..count];
            let (pivot, entries) = row.entries.split_last().unwrap_or((&1.0, &[]));
            own.iter_mut().for_each(|own| *own /= pivot);
            for (offset, entry) in entries.iter().enumerate() {
                let other = &mut before[(row.first + offset) * count..][..count];
                other.iter_mut().zip(&*own).for_each(|(other, own)| *other -= entry * own);
            }
        }
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
        let mut solved = loads.clone();
        factor.solve(&mut solved);
        for _ in 1..SOLUTIONS_A_STEP {
            // Each as long as it was: the higher ones shrink faster.
            let products = solved.row_iter().zip(loads.row_iter()).map(|(solved, load)| solved.dot(&load));
            let lengths: Vec<f64> = products.map(f64::sqrt).collect();
            solved.row_iter_mut().zip(lengths).for_each(|(mut solved, length)| solved /= length);
            loads = mass.times(&solved);
            solved.copy_from(&loads);
            factor.solve(&mut solved);
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
