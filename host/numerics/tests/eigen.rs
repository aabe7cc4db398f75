//! Eigenproblems with known answers.

use belfry_numerics::{
    CholeskyFactor, EigenPairs, SingularTriplets, complex_product, general_eigen, general_eigen_complex,
    singular_triplets,
};
use nalgebra::{Complex, DMatrix, DVector};

#[test]
fn a_rotation_turns_with_conjugate_values() {
    let EigenPairs { values, vectors } = general_eigen(&DMatrix::from_row_slice(2, 2, &[0.0, -2.0, 2.0, 0.0])).unwrap();
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
    let EigenPairs { values, vectors } = CholeskyFactor::of(&metric, 1e-13).unwrap().generalised_eigen(&other).unwrap();
    for (column, value) in values.iter().enumerate() {
        let x = vectors.column(column);
        assert!((&other * x - &metric * x * *value).norm() < 1e-14);
        assert!((x.dot(&(&metric * x)) - 1.0).abs() < 1e-14);
    }
    assert!(values.is_sorted());
}

#[test]
fn rows_that_nothing_couples_are_solved_apart_and_come_in_one_order() {
    // Rows 0 and 2 hang together, as do 1 and 4 through the metric alone; row 3 is on its own.
    let mut metric = DMatrix::from_diagonal(&DVector::from_row_slice(&[2.0, 3.0, 4.0, 1.0, 5.0]));
    let mut other = DMatrix::from_diagonal(&DVector::from_row_slice(&[1.0, 2.0, 7.0, 3.0, 0.5]));
    (other[(0, 2)], other[(2, 0)]) = (0.7, 0.7);
    (metric[(1, 4)], metric[(4, 1)]) = (-0.9, -0.9);
    let EigenPairs { values, vectors } = CholeskyFactor::of(&metric, 1e-13).unwrap().generalised_eigen(&other).unwrap();
    assert!(values.is_sorted());
    let whole = vectors.transpose() * &metric * &vectors;
    assert!((whole - DMatrix::identity(5, 5)).norm() < 1e-14);
    assert!((&other * &vectors - &metric * &vectors * DMatrix::from_diagonal(&values.into())).norm() < 1e-14);
    for vector in vectors.column_iter() {
        let moves = |rows: &[usize]| rows.iter().any(|&row| vector[row] != 0.0);
        let sets = [moves(&[0, 2]), moves(&[1, 4]), moves(&[3])];
        assert_eq!(sets.iter().filter(|&&moves| moves).count(), 1, "{vector}");
    }
}

#[test]
fn what_is_singular_up_to_rounding_has_no_factor() {
    let singular = DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.0 + 1e-15]);
    assert!(CholeskyFactor::of(&singular, 1e-13).is_none());
    assert!(CholeskyFactor::of(&DMatrix::from_element(1, 1, -1.0), 1e-13).is_none());
}

fn complex(rows: usize, columns: usize) -> DMatrix<Complex<f64>> {
    DMatrix::from_fn(rows, columns, |row, column| {
        let turn = (3 * row + 7 * column * column) as f64;
        Complex::new(turn.sin(), (1.7 * turn).cos())
    })
}

#[test]
fn a_complex_matrix_is_the_product_of_its_singular_triplets() {
    let matrix = complex(6, 4);
    let SingularTriplets { values, left, right } = singular_triplets(&matrix).unwrap();
    assert!(values.windows(2).all(|pair| pair[0] >= pair[1]), "{values:?}");
    let scaled = DMatrix::from_fn(6, 4, |row, column| left[(row, column)] * values[column]);
    assert!((complex_product(&scaled, &right.adjoint()) - matrix).norm() < 1e-13);
    assert!((left.adjoint() * left - DMatrix::identity(4, 4)).norm() < 1e-13);
}

#[test]
fn a_complex_matrix_only_stretches_its_eigenvectors() {
    let matrix = complex(5, 5);
    let EigenPairs { values, vectors } = general_eigen_complex(&matrix).unwrap();
    for (column, value) in values.iter().enumerate() {
        let stretched = &matrix * vectors.column(column);
        assert!((stretched - vectors.column(column) * *value).norm() < 1e-12, "{value}");
    }
}

/// As large as problems are that are solved by parts.
#[test]
fn vectors_of_a_large_problem_solve_it_to_rounding() {
    let size = 185;
    let spring = |i: usize, j: usize| match i.abs_diff(j) {
        0 => 3.0 + (i as f64 * 0.7).sin(),
        1 => -0.9,
        7 => 0.05,
        _ => 0.0,
    };
    let metric = DMatrix::from_fn(size, size, spring);
    let other = DMatrix::from_diagonal(&DVector::from_fn(size, |i, _| 1.0 + 0.5 * (i as f64 * 0.3).cos()));
    let EigenPairs { values, vectors } = CholeskyFactor::of(&metric, 1e-13).unwrap().generalised_eigen(&other).unwrap();
    let greatest = values.iter().copied().fold(0.0, f64::max);
    assert!(values.is_sorted());
    assert!((vectors.transpose() * &metric * &vectors - DMatrix::identity(size, size)).amax() < 1e-12);
    let left = &other * &vectors - &metric * &vectors * DMatrix::from_diagonal(&values.into());
    assert!(left.amax() < 1e-12 * greatest, "{}", left.amax());
}
