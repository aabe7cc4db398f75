//! Two measurements of one structure: what errors make is no change, what is a change shows.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{changes, differences};
use crate::diagnose::testing::{measured, study};
use crate::modes::{DrawnErrors, MeasuredMode, MeasuredShape};

/// A mode of one to four sensors with deviations of 0.1 % and 0.01.
fn mode(number: usize, frequency_hz: f64, shape: &[f64]) -> MeasuredMode {
    MeasuredMode {
        number,
        frequency_hz,
        frequency_std_hz: Some(1e-3 * frequency_hz),
        damping_ratio: Some(0.01),
        damping_ratio_std: Some(0.001),
        stated: None,
        shape: (!shape.is_empty()).then(|| MeasuredShape {
            sensors: (0..shape.len()).collect(),
            values: DVector::from_column_slice(shape),
            imaginary: None,
            stds: Some(DVector::from_element(shape.len(), 0.01)),
        }),
        covariance_factor: None,
    }
}

/// Whitened differences of a structure that has not changed have squares of mean one, and p-values are as often small as they say; errors
/// that the components of a shape have in common count as such.
#[test]
fn errors_of_two_measurements_alone_are_no_change() {
    let (structure, _, sensors) = study();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut exact = measured(&structure, &sensors, 13, &mut random);
    for mode in &mut exact {
        // Half of the variance of every number is one error.
        let size = mode.shape.as_ref().unwrap().values.len();
        let share = f64::sqrt(0.5);
        mode.covariance_factor = Some(crate::modes::MeasuredCovarianceFactor {
            group: mode.number,
            frequency_hz: nalgebra::RowDVector::from_element(1, share * mode.frequency_std_hz.unwrap()),
            shape: DMatrix::from_element(size, 1, share * 3e-3),
        });
    }
    // An error of the frequency goes with that of the shape.
    let draw = |random: &mut ChaCha8Rng| -> Vec<MeasuredMode> {
        let of = |mode: &MeasuredMode, random: &mut ChaCha8Rng| {
            let factor = mode.covariance_factor.as_ref().unwrap();
            let common = crate::modes::normals(1, random)[0];
            let own = crate::modes::normals(1 + factor.shape.nrows(), random) * f64::sqrt(0.5);
            let errors = DrawnErrors {
                frequency_hz: factor.frequency_hz[0] * common + own[0] * mode.frequency_std_hz.unwrap(),
                shape: factor.shape.column(0) * common + own.rows(1, factor.shape.nrows()) * 3e-3,
                imaginary: DVector::zeros(factor.shape.nrows()),
            };
            mode.clone().with_errors(&errors)
        };
        exact.iter().map(|mode| of(mode, random)).collect()
    };
    let (mut square, mut freedom, mut small) = (0.0, 0, 0);
    for _ in 0..40 {
        let test = changes(&draw(&mut random), &draw(&mut random)).test.unwrap();
        square += test.chi_squared;
        freedom += test.degrees_of_freedom;
        small += usize::from(test.p_value < 0.1);
    }
    // 40 x some 240 numbers: one standard deviation of the mean is 0.014.
    let mean = square / freedom as f64;
    assert!((0.95..1.05).contains(&mean), "{mean}");
    // More than 9 of 40 at 10 % happen with a probability of 0.5 %.
    assert!(small <= 9, "{small}");
}

/// Two close modes turn by 40 degrees within their span at the slightest change: no change of the structure. Two that stand apart do not.
#[test]
fn close_modes_are_compared_by_their_span() {
    let (one, other) = ([1.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5]);
    let (sin, cos) = 40f64.to_radians().sin_cos();
    let turned = |by: [f64; 2]| [0, 1, 2, 3].map(|at| by[0] * one[at] + by[1] * other[at]);
    for (second_hz, is_change) in [(1.01, false), (1.1, true)] {
        let before = [mode(1, 1.0, &one), mode(2, second_hz, &other)];
        let now = [mode(1, 1.0, &turned([cos, sin])), mode(2, second_hz, &turned([-sin, cos]))];
        let found = changes(&before, &now);
        assert_eq!(found.has_changed(), Some(is_change), "{second_hz} Hz: {found:?}");
        assert_eq!(found.modes.iter().all(|mode| mode.close_to.len() == 2), !is_change);
    }
    // What leaves the span is a change all the same.
    let before = [mode(1, 1.0, &one), mode(2, 1.01, &other)];
    let now = [mode(1, 1.0, &[1.0, 0.6, 0.0, 0.0]), mode(2, 1.01, &other)];
    let found = changes(&before, &now);
    assert!(found.modes[0].p_value_of_shape.unwrap() < 1e-4, "{:?}", found.modes[0]);
    assert!(found.modes[1].p_value_of_shape.unwrap() > 0.9, "{:?}", found.modes[1]);
}

/// Modes are paired by what they look like, also where their frequencies have crossed; those without a partner are listed.
#[test]
fn modes_keep_their_partner_and_those_without_one_are_listed() {
    let (x, y) = ([1.0, 0.0, 0.5], [0.0, 1.0, -0.2]);
    let before = [mode(1, 1.0, &x), mode(2, 1.05, &y), mode(3, 3.0, &x)];
    let now = [mode(1, 1.0, &y), mode(2, 1.04, &x), mode(3, 5.0, &y)];
    let found = changes(&before, &now);
    let pairs: Vec<(usize, usize)> = found.modes.iter().map(|mode| (mode.before, mode.now)).collect();
    assert_eq!(pairs, [(2, 1), (1, 2)]);
    let numbers = |modes: &[super::LonelyMode]| modes.iter().map(|mode| mode.number).collect::<Vec<_>>();
    assert_eq!((numbers(&found.only_before), numbers(&found.only_now)), (vec![3], vec![3]));
    assert_eq!(changes(&before[..1], &now[2..]).test, None);
}

/// 1 ± 0.1 % before, 0.99 ± 0.1 % now: -1 % ± 0.14 %, seven deviations. All modes alike are what temperature does; one alone is a mode to look
/// at.
#[test]
fn changes_are_stated_with_the_deviations_of_both() {
    let frequencies = [1.0, 2.0, 4.0];
    let at = |factors: [f64; 3]| -> Vec<MeasuredMode> {
        (1..)
            .zip(frequencies.iter().zip(factors))
            .map(|(number, (hz, factor))| mode(number, hz * factor, &[]))
            .collect()
    };
    let before = at([1.0; 3]);
    let alike = changes(&before, &at([0.99; 3]));
    assert!((alike.modes[0].change_percent + 1.0).abs() < 1e-9);
    assert!((alike.modes[0].change_percent_std - 0.99 * 0.1 * f64::sqrt(2.0)).abs() < 1e-9);
    assert_eq!(alike.modes[0].damping_z, Some(0.0));
    assert!(alike.is_common() && alike.has_changed() == Some(true));
    let one = changes(&before, &at([1.0, 0.99, 1.0]));
    // Seven deviations of one mode of three: identification gets as many wrong, so it may have been this one.
    assert!(!one.is_common() && one.has_changed() == Some(false), "{one:?}");
    assert_eq!(one.test.unwrap().may_be_wrong, [2]);
    let further = changes(&before, &at([1.0, 0.97, 1.0]));
    assert_eq!(further.has_changed(), Some(true), "wrong by so much is none: {further:?}");
    let none = changes(&before, &at([1.0005, 0.9995, 1.0]));
    assert!(!none.is_common() && none.has_changed() == Some(false) && none.test.unwrap().may_be_wrong.is_empty());
}

/// A model that is right before shows what was measured now; one that is 3 % too stiff shows it 3 % higher.
#[test]
fn a_model_moves_as_the_measurement_does() {
    let before = [mode(1, 1.0, &[1.0, 0.5, 0.2])];
    let now = [mode(4, 0.98, &[1.0, 0.6, 0.2])];
    let difference = &differences(&before, &now)[0];
    let unit = |mode: &MeasuredMode| mode.shape.as_ref().unwrap().values.normalize();
    let moved = difference.moved_from(&now[0], 1.03, &[unit(&before[0])]);
    assert!((moved.frequency_hz - 0.98 * 1.03).abs() < 1e-12 && moved.number == 4);
    let std = moved.frequency_std_hz.unwrap() / moved.frequency_hz;
    assert!((std - 1e-3 * f64::sqrt(2.0)).abs() < 1e-9);
    let shape = moved.shape.unwrap();
    assert!((&shape.values - unit(&now[0])).norm() < 1e-12);
    // The shapes are 1.14 and 1.18 long, so their deviations are 0.0088 and 0.0085 of that.
    let expected = (0.01 / f64::sqrt(1.29)).hypot(0.01 / f64::sqrt(1.4));
    assert!(shape.stds.unwrap().iter().all(|std| (std / expected - 1.0).abs() < 0.02));
}
