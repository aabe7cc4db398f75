//! Modes of lowest frequency near known ones, against those of the whole problem.

use belfry_numerics::{CholeskyFactor, EigenPairs, Envelope, lowest_modes};
use nalgebra::{DMatrix, DVector};

/// A chain of `size` masses, each tied to its neighbours and to the one after the next; `softer` is the share that is missing of some.
fn chain(size: usize, softer: f64) -> [DMatrix<f64>; 2] {
    let spring = |i: usize| 1.0 - if i % 7 == 3 { softer } else { 0.3 * (i as f64).sin() };
    let mut stiffness = DMatrix::zeros(size, size);
    for (reach, share) in [(1, 1.0), (2, 0.4)] {
        for i in 0..size {
            let k = share * spring(i);
            stiffness[(i, i)] += k;
            if let Some(j) = i.checked_sub(reach) {
                stiffness[(j, j)] += k;
                stiffness[(i, j)] -= k;
                stiffness[(j, i)] -= k;
            }
        }
    }
    // The base is tied to the first two masses only.
    let mut mass = DMatrix::from_diagonal(&DVector::from_fn(size, |i, _| 1.0 + 0.4 * (0.7 * i as f64).cos()));
    for i in 1..size {
        (mass[(i, i - 1)], mass[(i - 1, i)]) = (0.1, 0.1);
    }
    for i in 2..size {
        stiffness[(i, i)] += 1e-4;
    }
    [stiffness, mass]
}

fn whole([stiffness, mass]: &[DMatrix<f64>; 2]) -> EigenPairs<f64> {
    CholeskyFactor::of(stiffness, 1e-13).unwrap().generalised_eigen(mass).unwrap().reversed()
}

#[test]
fn an_envelope_multiplies_and_solves_as_the_whole_matrix_does() {
    let [stiffness, mass] = chain(40, 0.2);
    let vectors = DMatrix::from_fn(3, 40, |i, j| ((i * 40 + j) as f64).sin());
    let envelope = Envelope::of(&stiffness);
    assert!(envelope.entries() < 3 * 40);
    assert!((envelope.times(&vectors) - &vectors * &stiffness).amax() < 1e-14);
    let solved = envelope.factor(1e-13).unwrap().solve(&vectors);
    assert!((solved * &stiffness - vectors).amax() < 1e-10);
    assert_eq!(Envelope::of(&(-&mass)).factor(1e-13), None);
}

#[test]
fn eigenvalues_below_a_value_are_counted() {
    let matrices = chain(40, 0.2);
    let mu = whole(&matrices).values;
    let [stiffness, mass] = matrices.map(|matrix| Envelope::of(&matrix));
    for count in 0..40 {
        let upper = if count == 0 { 2.0 * mu[0] } else { mu[count - 1] };
        let between = 0.5 * (upper + mu[count]);
        assert_eq!(stiffness.count_below(&mass, 1.0 / between), Some(count));
    }
}

#[test]
fn modes_near_known_ones_are_those_of_the_whole_problem() {
    let known = whole(&chain(185, 0.0));
    for softer in [0.001, 0.1, 0.6] {
        let matrices = chain(185, softer);
        let exact = whole(&matrices);
        let [stiffness, mass] = matrices.map(|matrix| Envelope::of(&matrix));
        let factor = stiffness.factor(1e-13).unwrap();
        let near = known.vectors.columns(0, 50).transpose();
        let EigenPairs { values, vectors } = lowest_modes(&stiffness, &factor, &mass, &near, 15).unwrap();
        assert_eq!((values.len(), vectors.shape()), (50, (185, 50)));
        for (mode, (value, true_value)) in values.iter().zip(&exact.values).take(15).enumerate() {
            assert!((value / true_value - 1.0).abs() < 1e-12);
            let (found, true_shape) = (vectors.column(mode), exact.vectors.column(mode));
            let off = (found - true_shape).norm().min((found + true_shape).norm()) / true_shape.norm();
            assert!(off < 1e-6, "{softer}, mode {mode}: {off}");
        }
    }
}

/// Vectors that lack a mode altogether do not find it, and it is not taken for found.
#[test]
fn a_mode_that_is_left_out_is_noticed() {
    let matrices = chain(60, 0.0);
    let exact = whole(&matrices);
    let [stiffness, mass] = matrices.map(|matrix| Envelope::of(&matrix));
    let factor = stiffness.factor(1e-13).unwrap();
    let without = exact.vectors.clone().remove_column(4).columns(0, 20).transpose();
    if let Some(found) = lowest_modes(&stiffness, &factor, &mass, &without, 8) {
        assert!((found.values[4] / exact.values[4] - 1.0).abs() < 1e-9, "rounding has brought it back");
    }
}
