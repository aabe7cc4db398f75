//! Dense eigenproblems and the Cholesky factor that reduces a generalised one.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::evd::{ComputeEigenvectors, SelfAdjointEvdParams, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::solvers::{DenseSolveCore, Eigen, Llt, Solve, Svd};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, Mat, MatMut, MatRef, Par, Side, Spec};
use nalgebra::{Complex, DMatrix, DVector};

use super::sets::sets_apart;

/// A matrix as the solvers' library sees it; both store column after column.
fn view(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

/// The same of a complex matrix.
fn complex_view(matrix: &DMatrix<Complex<f64>>) -> MatRef<'_, Complex<f64>> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

fn from_solver<T: nalgebra::Scalar>(matrix: MatRef<'_, T>) -> DMatrix<T> {
    let values = matrix.col_iter().flat_map(|column| column.iter().cloned());
    DMatrix::from_iterator(matrix.nrows(), matrix.ncols(), values)
}

/// Eigenvalues and their eigenvectors.
#[derive(Debug, Clone, PartialEq)]
pub struct EigenPairs<T> {
    /// The values.
    pub values: Vec<T>,
    /// The vectors, a column a value.
    pub vectors: DMatrix<T>,
}

impl EigenPairs<f64> {
    /// The same pairs in the opposite order.
    pub fn reversed(self) -> Self {
        let columns: Vec<_> = (0..self.values.len()).rev().map(|index| self.vectors.column(index)).collect();
        let vectors = if columns.is_empty() { DMatrix::zeros(0, 0) } else { DMatrix::from_columns(&columns) };
        Self { values: self.values.into_iter().rev().collect(), vectors }
    }
}

/// Eigenvalues and eigenvectors of a square matrix; `None` where the iteration does not converge.
pub fn general_eigen(matrix: &DMatrix<f64>) -> Option<EigenPairs<Complex<f64>>> {
    let eigen = Eigen::new_from_real(view(matrix)).ok()?;
    let values = eigen.S().column_vector().iter().copied().collect();
    Some(EigenPairs { values, vectors: from_solver(eigen.U()) })
}

/// The same of a complex matrix.
pub fn general_eigen_complex(matrix: &DMatrix<Complex<f64>>) -> Option<EigenPairs<Complex<f64>>> {
    let eigen = Eigen::new(complex_view(matrix)).ok()?;
    let values = eigen.S().column_vector().iter().copied().collect();
    Some(EigenPairs { values, vectors: from_solver(eigen.U()) })
}

/// The product of two complex matrices.
///
/// # Panics
/// Where the first has not as many columns as the second has rows.
pub fn complex_product(left: &DMatrix<Complex<f64>>, right: &DMatrix<Complex<f64>>) -> DMatrix<Complex<f64>> {
    let mut product = DMatrix::zeros(left.nrows(), right.ncols());
    let (rows, columns) = product.shape();
    let into = MatMut::from_column_major_slice_mut(product.as_mut_slice(), rows, columns);
    matmul(into, Accum::Replace, complex_view(left), complex_view(right), Complex::ONE, Par::Seq);
    product
}

/// A matrix as `left diag(values) right^H`.
#[derive(Debug, Clone, PartialEq)]
pub struct SingularTriplets {
    /// Singular values, largest first: as many as the smaller of both dimensions.
    pub values: Vec<f64>,
    /// Left singular vectors, a column a value.
    pub left: DMatrix<Complex<f64>>,
    /// Right singular vectors, a column a value.
    pub right: DMatrix<Complex<f64>>,
}

/// The thin singular value decomposition of a complex matrix; `None` where the iteration does not converge.
pub fn singular_triplets(matrix: &DMatrix<Complex<f64>>) -> Option<SingularTriplets> {
    let svd = Svd::new_thin(complex_view(matrix)).ok()?;
    let values = svd.S().column_vector().iter().map(|value| value.re).collect();
    Some(SingularTriplets { values, left: from_solver(svd.U()), right: from_solver(svd.V()) })
}

/// The lower Cholesky factor L of a symmetric positive definite matrix.
#[derive(Debug, Clone)]
pub struct CholeskyFactor(Llt<f64>);

impl CholeskyFactor {
    /// `None` where the matrix is not positive definite, or singular up to rounding: a pivot is held against its own diagonal
    /// entry, for entries of different units rightly differ by many powers of ten. `negligible` is the share below which a pivot
    /// counts as zero.
    pub fn of(matrix: &DMatrix<f64>, negligible: f64) -> Option<Self> {
        let factor = Llt::new(view(matrix), Side::Lower).ok()?;
        let lower = factor.L();
        let is_sound = (0..matrix.nrows()).all(|i| lower[(i, i)] * lower[(i, i)] > negligible * matrix[(i, i)]);
        is_sound.then_some(Self(factor))
    }

    /// The logarithm of the determinant of L.
    pub fn log_volume(&self) -> f64 {
        self.0.L().diagonal().column_vector().iter().map(|value| value.ln()).sum()
    }

    /// The solution x of `L Lᵀ x = right`.
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let solved = self.0.solve(MatRef::from_column_major_slice(right.as_slice(), right.len(), 1));
        DVector::from_iterator(right.len(), solved.col(0).iter().copied())
    }

    /// The inverse of `L Lᵀ`.
    pub fn inverse(&self) -> DMatrix<f64> {
        from_solver(self.0.inverse().as_ref())
    }

    /// Solves `other x = value (L Lᵀ) x`: values, ascending, and vectors with `xᵀ L Lᵀ x = 1` (Golub and Van Loan, "Matrix
    /// Computations", section 8.7); `None` where the iteration does not converge. Motions that nothing couples, such as torsion
    /// and bending of a mast without eccentric masses, are solved each on their own: a third of the rows is a 27th of the work.
    pub fn generalised_eigen(&self, other: &DMatrix<f64>) -> Option<EigenPairs<f64>> {
        let (lower, other) = (self.0.L(), view(other));
        let sets = uncoupled(lower, other);
        if sets.len() == 1 {
            return whole_eigen(lower, other.to_owned());
        }
        let mut pairs: Vec<(f64, DVector<f64>)> = Vec::with_capacity(other.nrows());
        for rows in sets {
            let part = |whole: MatRef<'_, f64>| Mat::from_fn(rows.len(), rows.len(), |i, j| whole[(rows[i], rows[j])]);
            let eigen = whole_eigen(part(lower).as_ref(), part(other))?;
            for (value, vector) in eigen.values.into_iter().zip(eigen.vectors.column_iter()) {
                let mut everywhere = DVector::zeros(other.nrows());
                rows.iter().zip(vector.iter()).for_each(|(&row, share)| everywhere[row] = *share);
                pairs.push((value, everywhere));
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (values, vectors): (Vec<f64>, Vec<DVector<f64>>) = pairs.into_iter().unzip();
        let vectors = if vectors.is_empty() { DMatrix::zeros(0, 0) } else { DMatrix::from_columns(&vectors) };
        Some(EigenPairs { values, vectors })
    }
}

/// The rows of two symmetric matrices, of which the lower triangles are looked at, in sets between which both have nothing but
/// zeros; each set ascending. A Cholesky factor has the sets of its matrix.
fn uncoupled(one: MatRef<'_, f64>, other: MatRef<'_, f64>) -> Vec<Vec<usize>> {
    sets_apart(one.nrows(), |row, column| one[(row, column)] != 0.0 || other[(row, column)] != 0.0)
}

/// Solves `other x = value (L Lᵀ) x` with all rows at once.
fn whole_eigen(lower: MatRef<'_, f64>, mut half: Mat<f64>) -> Option<EigenPairs<f64>> {
    solve_lower_triangular_in_place(lower, half.as_mut(), Par::Seq);
    let mut whole = half.transpose().to_owned();
    solve_lower_triangular_in_place(lower, whole.as_mut(), Par::Seq);
    // Rounding leaves it a little unsymmetric.
    let symmetric = (&whole + whole.transpose()) * faer::Scale(0.5);
    let (values, mut vectors) = symmetric_eigen(symmetric.as_ref())?;
    solve_upper_triangular_in_place(lower.transpose(), vectors.as_mut(), Par::Seq);
    Some(EigenPairs { values, vectors: from_solver(vectors.as_ref()) })
}

/// Solves `kinetic z = mu strain z`, strain positive definite: largest mu first, `zᵀ strain z = 1`; `None` where strain is not positive
/// definite or the iteration does not converge.
pub(crate) fn reduced_eigen(strain: &DMatrix<f64>, kinetic: &DMatrix<f64>) -> Option<EigenPairs<f64>> {
    let factor = Llt::new(view(strain), Side::Lower).ok()?;
    whole_eigen(factor.L(), view(kinetic).to_owned()).map(EigenPairs::reversed)
}

/// The eigenpairs of a symmetric matrix, largest value first; `None` where the iteration does not converge.
pub fn symmetric_pairs(matrix: &DMatrix<f64>) -> Option<EigenPairs<f64>> {
    let (values, vectors) = symmetric_eigen(view(matrix))?;
    Some(EigenPairs { values, vectors: from_solver(vectors.as_ref()) }.reversed())
}

/// Problems of this size and more are worth several threads.
const SHARED: usize = 400;
/// Parts of this size and less are solved by rotations, of which there are as many as the square of the size: left at the library's 128,
/// they took a third of the time for 185 rows.
const ROTATED: usize = 32;

/// Eigenvalues, ascending, and eigenvectors of a symmetric matrix.
fn symmetric_eigen(matrix: MatRef<'_, f64>) -> Option<(Vec<f64>, Mat<f64>)> {
    let rows = matrix.nrows();
    let par = if rows < SHARED { Par::Seq } else { faer::get_global_parallelism() };
    let mut params = Spec::<SelfAdjointEvdParams, f64>::default();
    params.recursion_threshold = ROTATED;
    let mut values = Diag::zeros(rows);
    let mut vectors = Mat::zeros(rows, rows);
    let scratch = self_adjoint_evd_scratch::<f64>(rows, ComputeEigenvectors::Yes, par, params);
    let mut memory = MemBuffer::new(scratch);
    let stack = MemStack::new(&mut memory);
    self_adjoint_evd(matrix, values.as_mut(), Some(vectors.as_mut()), par, stack, params).ok()?;
    Some((values.column_vector().iter().copied().collect(), vectors))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_solves_inverts_and_has_the_volume() {
        // Its determinant is 11.
        let factor = CholeskyFactor::of(&DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 3.0]), 0.0).unwrap();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-14, "{a} {b}");
        near(factor.log_volume(), 0.5 * 11.0_f64.ln());
        let solved = factor.solve(&DVector::from_row_slice(&[1.0, 2.0]));
        near(solved[0], 1.0 / 11.0);
        near(solved[1], 7.0 / 11.0);
        let inverse = factor.inverse();
        for (at, value) in [((0, 0), 3.0), ((0, 1), -1.0), ((1, 0), -1.0), ((1, 1), 4.0)] {
            near(inverse[at], value / 11.0);
        }
    }
}
