//! Damped modes against closed forms, and their derivatives against differences.

use nalgebra::DVector;

use super::*;
use crate::model::effect::tuned_mass_damper::TunedMass;
use crate::model::tests::Uniform;
use crate::model::{Assembly, Responses, Structure};

const DAMPER: TunedMass =
    TunedMass { z_m: 90.0, mass_kg: 1e3, frequency_hz: 0.5, damping_ratio: 0.06, moves: [true, true] };

fn hung(damper: TunedMass) -> Assembly {
    let beam = Uniform { axis_deg: 20.0, segments: 10, rotary_inertia: 1e-3, ..Uniform::default() };
    let mut structure = Structure::new(beam.table());
    structure.push(std::sync::Arc::new(damper));
    structure.assemble()
}

fn damped(assembly: &Assembly) -> (ModalBasis, DampedModes) {
    let basis = assembly.modal_basis().unwrap();
    let damped = DampedModes::of(&basis, assembly.damping.as_ref().unwrap()).unwrap();
    (basis, damped)
}

/// A damper tuned to the first mode, along X and Y.
fn tuned() -> TunedMass {
    let beam = Uniform { axis_deg: 20.0, segments: 10, rotary_inertia: 1e-3, ..Uniform::default() };
    let first_hz = Structure::new(beam.table()).assemble().modes().unwrap().frequency_hz[0];
    TunedMass { frequency_hz: 0.98 * first_hz, ..DAMPER }
}

/// Two masses, the second on a spring and a dashpot: the roots of the quartic (Den Hartog 1956, section 3.3).
#[test]
fn poles_are_the_roots_of_the_quartic() {
    let (mass, hung_mass, k, kd, c) = (1000.0, 20.0, 4e4, 700.0, 12.0);
    let stiffness = DMatrix::from_row_slice(2, 2, &[k + kd, -kd, -kd, kd]);
    let basis = ModalBasis::of(&stiffness, &DMatrix::from_diagonal(&DVector::from_vec(vec![mass, hung_mass]))).unwrap();
    let damped = DampedModes::of(&basis, &DMatrix::from_row_slice(2, 2, &[c, -c, -c, c])).unwrap();
    let quartic = |s: Complex<f64>| {
        (s * s * mass + s * c + (k + kd)) * (s * s * hung_mass + s * c + kd) - (s * c + kd) * (s * c + kd)
    };
    assert_eq!(damped.poles.len(), 4);
    for pole in &damped.poles {
        assert!(quartic(*pole).norm() < 1e-9 * k * kd, "{pole}");
    }
    let modes = damped.modes(&basis, &DMatrix::from_row_slice(1, 2, &[1.0, 0.0]));
    assert!(modes.frequency_hz[0] < modes.frequency_hz[1]);
    assert!((0..2).all(|mode| damped.damping_ratio(mode) > 0.005));
}

/// A dashpot of next to nothing leaves the undamped modes, in place and sign.
#[test]
fn without_damping_they_are_the_undamped_modes() {
    let assembly = hung(TunedMass { damping_ratio: 1e-9, ..tuned() });
    let (basis, damped) = damped(&assembly);
    let rows = assembly.axis_motion(100.0);
    let (found, expected) = (damped.modes(&basis, &rows), basis.modes(usize::MAX));
    assert_eq!(found.frequency_hz.len(), expected.frequency_hz.len());
    for mode in 0..8 {
        assert!((found.frequency_hz[mode] / expected.frequency_hz[mode] - 1.0).abs() < 1e-7);
        let difference = (found.shapes.column(mode) - expected.shapes.column(mode)).norm();
        assert!(difference < 1e-5 * expected.shapes.column(mode).norm(), "mode {mode}: {difference}");
    }
}

/// A step of a damper's number or of matrix entries, both ways, against the derivative: of frequencies, and of shapes
/// up to their length.
#[test]
fn derivatives_are_those_of_differences() {
    let with = |mass: f64, frequency: f64, damping: f64| {
        let tuned = tuned();
        hung(TunedMass {
            mass_kg: tuned.mass_kg * (1.0 + mass),
            frequency_hz: tuned.frequency_hz * (1.0 + frequency),
            damping_ratio: tuned.damping_ratio * (1.0 + damping),
            ..tuned
        })
    };
    let propped = |by: f64| {
        let mut assembly = with(0.0, 0.0, 0.0);
        assembly.stiffness[(30, 30)] += by * 1e5;
        assembly.mass[(21, 21)] += by * 1e4;
        assembly
    };
    let middle = with(0.0, 0.0, 0.0);
    let (basis, view) = damped(&middle);
    let rows = DMatrix::from_fn(6, middle.dofs(), |row, dof| {
        middle.axis_motion(40.0 + 25.0 * (row / 2) as f64)[(row % 2, dof)]
    });
    let step = 1e-5;
    let moves: [&dyn Fn(f64) -> Assembly; 4] =
        [&|by| with(by, 0.0, 0.0), &|by| with(0.0, by, 0.0), &|by| with(0.0, 0.0, by), &propped];
    for (index, moved) in moves.iter().enumerate() {
        let (above, below) = (moved(step), moved(-step));
        let half = 1.0 / (2.0 * step);
        let difference = |of: &dyn Fn(&Assembly) -> DMatrix<f64>| (of(&above) - of(&below)) * half;
        let dashpots = difference(&|assembly| assembly.damping.clone().unwrap());
        let change = Change::of(
            &difference(&|assembly| assembly.stiffness.clone()),
            &difference(&|assembly| assembly.mass.clone()),
            Some(&dashpots),
        );
        let seen = |assembly: &Assembly| {
            let (basis, damped) = damped(assembly);
            let modes = damped.modes(&basis, &rows);
            (&rows * &modes.shapes, modes.frequency_hz)
        };
        let ratio = |assembly: &Assembly, mode: usize| damped(assembly).1.damping_ratio(mode);
        let ((shapes_above, above_hz), (shapes_below, below_hz)) = (seen(&above), seen(&below));
        let (shapes, _) = seen(&middle);
        let modes = [0, 1, 2, 3, 5, 6];
        let found = Responses::of(&basis, Some(&view), &rows, &modes).derivatives(&change);
        let frequencies = view.frequency_derivatives(&basis, &modes, &change);
        for ((derivative, slope), mode) in found.iter().zip(frequencies).zip(modes) {
            let ln = (above_hz[mode] / below_hz[mode]).ln() * half;
            assert!(
                (slope - ln).abs() < 1e-5 && (derivative.ln_frequency - ln).abs() < 1e-5,
                "{index} {mode}: {slope} {ln}"
            );
            let by_ratio = (ratio(&above, mode) - ratio(&below, mode)) * half;
            // Which modes are mixed is fixed in undamped modes, which move too.
            assert!(
                (derivative.damping_ratio - by_ratio).abs() < 1e-5 + 0.01 * by_ratio.abs(),
                "{index} {mode}: {by_ratio}"
            );
            // Without what only lengthens the shape.
            let shape = shapes.column(mode);
            let across = |change: DVector<f64>| &change - shape * (shape.dot(&change) / shape.norm_squared());
            let expected = across((shapes_above.column(mode) - shapes_below.column(mode)) * half);
            let wrong = (across(derivative.shape.clone()) - &expected).norm();
            assert!(
                wrong < 1e-4 * (expected.norm() + shape.norm()),
                "{index} {mode}: {wrong} of {} beside {}",
                expected.norm(),
                shape.norm()
            );
        }
    }
}
