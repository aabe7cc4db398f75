//! Modes with dashpots are those of a dense solver.

use belfry_numerics::{dashpot_modes, general_eigen};
use nalgebra::{Complex, DMatrix};

/// Numbers between two others that spread evenly and repeat nowhere: multiples of the golden ratio.
struct Spread(f64);

impl Spread {
    fn next(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.0 = (self.0 + 0.618_033_988_749_894_9).fract();
        low + (high - low) * (self.0 * 997.0).fract()
    }
}

/// Poles of the first-order form, in the upper half plane, by frequency.
fn dense(omega: &[f64], damping: &DMatrix<f64>) -> Vec<Complex<f64>> {
    let count = omega.len();
    let mut state = DMatrix::zeros(2 * count, 2 * count);
    for a in 0..count {
        state[(a, count + a)] = 1.0;
        state[(count + a, a)] = -omega[a].powi(2);
        for b in 0..count {
            state[(count + a, count + b)] = -damping[(a, b)];
        }
    }
    upper(general_eigen(&state).unwrap().values)
}

fn upper(values: Vec<Complex<f64>>) -> Vec<Complex<f64>> {
    let mut values: Vec<Complex<f64>> = values.into_iter().filter(|value| value.im > 0.0).collect();
    values.sort_by(|a, b| a.im.total_cmp(&b.im));
    values
}

/// Largest residual of `(s² + s C + omega²) q` for vectors of length 1, in units of the largest omega squared.
fn residual(omega: &[f64], damping: &DMatrix<f64>) -> f64 {
    let modes = dashpot_modes(omega, damping).unwrap();
    assert_eq!(modes.values.len(), 2 * omega.len());
    let most = omega.iter().fold(0.0_f64, |most, omega| most.max(*omega)).powi(2);
    let of = |(at, s): (usize, &Complex<f64>)| {
        let q = modes.vectors.column(at);
        assert!((q.norm() - 1.0).abs() < 1e-12);
        let damped = damping.map(Complex::from) * q * *s;
        let elastic = q.map_with_location(|row, _, value| value * (s * s + omega[row].powi(2)));
        (damped + elastic).norm() / most
    };
    modes.values.iter().enumerate().map(of).fold(0.0, f64::max)
}

#[test]
fn poles_are_those_of_a_dense_solver() {
    let mut spread = Spread(0.1);
    for case in 0..60 {
        let (count, dashpots) = (spread.next([1.0, 40.0]) as usize, 1 + case % 3);
        let mut omega: Vec<f64> = (0..count).map(|_| spread.next([0.5, 40.0])).collect();
        omega.sort_by(f64::total_cmp);
        // From next to nothing to a fifth of critical damping.
        let size = 10.0_f64.powf(spread.next([-4.0, 0.0]));
        let motions = DMatrix::from_fn(count, dashpots, |_, _| size * spread.next([-1.0, 1.0]));
        let damping = &motions * motions.transpose();
        assert!(residual(&omega, &damping) < 1e-11, "case {case}");
        let (ours, theirs) = (upper(dashpot_modes(&omega, &damping).unwrap().values), dense(&omega, &damping));
        assert_eq!(ours.len(), theirs.len(), "case {case}");
        for (ours, theirs) in ours.iter().zip(&theirs) {
            assert!((ours - theirs).norm() < 1e-9 * theirs.norm().max(1.0), "case {case}: {ours} and {theirs}");
        }
    }
}

/// A pair of one frequency, of which one dashpot damps each; and one that no dashpot feels.
#[test]
fn pairs_of_one_frequency_are_told_apart_by_their_dashpots() {
    let omega = [2.0, 2.0, 3.0, 3.0, 5.0];
    let motions = DMatrix::from_row_slice(5, 2, &[0.3, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.5, 0.0, 0.0]);
    let damping = &motions * motions.transpose();
    assert!(residual(&omega, &damping) < 1e-12);
    let poles = dashpot_modes(&omega, &damping).unwrap().values;
    assert!(poles.iter().any(|pole| *pole == Complex::new(0.0, 5.0)), "{poles:?}");
    // Both halves of each pair.
    for pole in poles.iter().filter(|pole| pole.re < 0.0) {
        assert_eq!(poles.iter().filter(|other| (*other - pole).norm() < 1e-12).count(), 2, "{poles:?}");
    }
}

/// What it is not made for is left to a dense solver.
#[test]
fn poles_that_do_not_turn_and_damping_of_full_rank_are_left_alone() {
    let heavy = DMatrix::from_element(1, 1, 10.0);
    assert!(dashpot_modes(&[1.0], &heavy).is_none());
    let full = DMatrix::from_diagonal_element(6, 6, 0.1) + DMatrix::from_element(6, 6, 0.01);
    assert!(dashpot_modes(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &full).is_none());
    // Of two of one frequency that one dashpot joins, half does not move it.
    assert!(dashpot_modes(&[1.0, 1.0], &DMatrix::from_element(2, 2, 0.02)).is_none());
}
