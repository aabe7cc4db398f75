//! Dense eigenproblems and the Cholesky factor that reduces a generalised one.

use faer::linalg::solvers::{Eigen, Llt, SelfAdjointEigen};
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{MatRef, Par, Side};
use nalgebra::{Complex, DMatrix};

/// A matrix as the solvers' library sees it; both store column after column.
fn view(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
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

#[cfg(test)]
mod tests {
    use nalgebra::{Complex, DMatrix};

    use super::{CholeskyFactor, EigenPairs, general_eigen};

    #[test]
    fn a_rotation_turns_with_conjugate_values() {
        let EigenPairs { values, vectors } =
            general_eigen(&DMatrix::from_row_slice(2, 2, &[0.0, -2.0, 2.0, 0.0])).unwrap();
        let turn = DMatrix::from_row_slice(2, 2, &[0.0, -2.0, 2.0, 0.0]).map(Complex::from);
        for (column, value) in values.iter().enumerate() {
            assert!(value.re.abs() < 1e-14 && (value.im.abs() - 2.0).abs() < 1e-14);
            let left = &turn * vectors.column(column);
            assert!((left - vectors.column(column) * *value).norm() < 1e-14);
        }
    }

    #[test]
    fn two_equal_masses_between_three_equal_springs_move_together_and_apart() {
        let stiffness = DMatrix::from_row_slice(2, 2, &[2.0, -1.0, -1.0, 2.0]);
        let mass = CholeskyFactor::of(&DMatrix::identity(2, 2), 1e-13).unwrap();
        let EigenPairs { values, vectors } = mass.generalised_eigen(&stiffness).unwrap();
        assert!((values[0] - 1.0).abs() < 1e-14 && (values[1] - 3.0).abs() < 1e-14);
        assert!((vectors[(0, 0)] - vectors[(1, 0)]).abs() < 1e-14, "together: {vectors}");
        assert!((vectors[(0, 1)] + vectors[(1, 1)]).abs() < 1e-14, "apart: {vectors}");
    }

    #[test]
    fn a_generalised_problem_is_solved_in_the_metric_of_its_factor() {
        let (metric, other) =
            (DMatrix::from_diagonal_element(3, 3, 4.0), DMatrix::from_fn(3, 3, |i, j| 1.0 / (i + j + 1) as f64));
        let EigenPairs { values, vectors } =
            CholeskyFactor::of(&metric, 1e-13).unwrap().generalised_eigen(&other).unwrap();
        for (column, value) in values.iter().enumerate() {
            let x = vectors.column(column);
            assert!((&other * x - &metric * x * *value).norm() < 1e-14);
            assert!((x.dot(&(&metric * x)) - 1.0).abs() < 1e-14);
        }
        assert!(values.is_sorted());
    }

    #[test]
    fn what_is_singular_up_to_rounding_has_no_factor() {
        let singular = DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.0 + 1e-15]);
        assert!(CholeskyFactor::of(&singular, 1e-13).is_none());
        assert!(CholeskyFactor::of(&DMatrix::from_element(1, 1, -1.0), 1e-13).is_none());
    }
}
