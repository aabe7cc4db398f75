//! Dense eigenproblems and the Cholesky factor that reduces a generalised one.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::{Eigen, Llt, SelfAdjointEigen, Svd};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, MatMut, MatRef, Par, Side};
use nalgebra::{Complex, DMatrix};

/// A matrix as the solvers' library sees it; both store column after column.
fn view(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

/// The same of a complex matrix.
fn complex_view(matrix: &DMatrix<Complex<f64>>) -> MatRef<'_, Complex<f64>> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

fn from_solver<T: nalgebra::Scalar>(matrix: MatRef<'_, T>) -> DMatrix<T> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |row, column| matrix[(row, column)].clone())
}

/// Eigenvalues and their eigenvectors.
#[derive(Debug, Clone, PartialEq)]
pub struct EigenPairs<T> {
    /// The values.
    pub values: Vec<T>,
    /// The vectors, a column a value.
    pub vectors: DMatrix<T>,
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

    /// Solves `other x = value (L Lᵀ) x`: values, ascending, and vectors with `xᵀ L Lᵀ x = 1` (Golub and Van Loan, "Matrix
    /// Computations", section 8.7); `None` where the iteration does not converge.
    pub fn generalised_eigen(&self, other: &DMatrix<f64>) -> Option<EigenPairs<f64>> {
        let mut half = view(other).to_owned();
        solve_lower_triangular_in_place(self.0.L(), half.as_mut(), Par::Seq);
        let mut whole = half.transpose().to_owned();
        solve_lower_triangular_in_place(self.0.L(), whole.as_mut(), Par::Seq);
        // Rounding leaves it a little unsymmetric.
        let symmetric = (&whole + whole.transpose()) * faer::Scale(0.5);
        let eigen = SelfAdjointEigen::new(symmetric.as_ref(), Side::Lower).ok()?;
        let mut vectors = eigen.U().to_owned();
        solve_upper_triangular_in_place(self.0.L().transpose(), vectors.as_mut(), Par::Seq);
        let values = eigen.S().column_vector().iter().copied().collect();
        Some(EigenPairs { values, vectors: from_solver(vectors.as_ref()) })
    }
}
