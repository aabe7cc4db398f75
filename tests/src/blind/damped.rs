//! Damped modes: a structure's own with a damping ratio each, or complex ones where oscillators hang on it.
//!
//! With p the forces on the structure's undamped modes, each damped mode's state obeys `s' = pole s + input p`, and the motion
//! at the sensors is the sum of 2 Re(shape s) (Géradin and Rixen, "Mechanical Vibrations", section 3.3).

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};

use super::banded::Modes;
use super::body::Body;

#[derive(Debug, Clone)]
pub(super) struct DampedMode {
    pub(super) pole: Complex<f64>,
    /// At the sensors, clock offsets left out.
    pub(super) shape: Vec<Complex<f64>>,
    /// From forces on the undamped modes.
    pub(super) input: Vec<Complex<f64>>,
}

impl DampedMode {
    /// Undamped frequency.
    pub(super) fn frequency_hz(&self) -> f64 {
        self.pole.norm() / TAU
    }

    pub(super) fn damping_ratio(&self) -> f64 {
        -self.pole.re / self.pole.norm()
    }
}

/// Damped modes below a frequency, lowest first; `damping_ratios` are those of the structure alone.
pub(super) fn damped_modes(body: &Body, modes: &Modes, damping_ratios: &[f64], highest_hz: f64) -> Vec<DampedMode> {
    let at_sensors = body.at_sensors(&modes.shapes);
    let mut damped = if body.attachments.is_empty() {
        alone(modes, damping_ratios, &at_sensors)
    } else {
        with_attachments(body, modes, damping_ratios, &at_sensors)
    };
    damped.retain(|mode| mode.frequency_hz() < highest_hz);
    damped.sort_by(|a, b| a.frequency_hz().total_cmp(&b.frequency_hz()));
    damped
}

fn alone(modes: &Modes, damping_ratios: &[f64], at_sensors: &DMatrix<f64>) -> Vec<DampedMode> {
    let count = modes.frequencies_hz.len();
    (0..count)
        .map(|at| {
            let (omega, zeta) = (TAU * modes.frequencies_hz[at], damping_ratios[at]);
            let turning = omega * (1.0 - zeta * zeta).sqrt();
            let mut input = vec![Complex::from(0.0); count];
            input[at] = Complex::new(0.0, 2.0 * turning).inv();
            DampedMode {
                pole: Complex::new(-zeta * omega, turning),
                shape: at_sensors.column(at).iter().map(|&value| Complex::from(value)).collect(),
                input,
            }
        })
        .collect()
}

fn with_attachments(body: &Body, modes: &Modes, damping_ratios: &[f64], at_sensors: &DMatrix<f64>) -> Vec<DampedMode> {
    let (own, all) = (modes.frequencies_hz.len(), modes.frequencies_hz.len() + body.attachments.len());
    let mut mass = DVector::from_element(all, 1.0);
    let (mut damping, mut stiffness) = (DMatrix::zeros(all, all), DMatrix::zeros(all, all));
    for (at, (hz, zeta)) in modes.frequencies_hz.iter().zip(damping_ratios).enumerate() {
        damping[(at, at)] = 2.0 * zeta * TAU * hz;
        stiffness[(at, at)] = (TAU * hz).powi(2);
    }
    for (attachment, dof) in body.attachments.iter().zip(own..) {
        let omega = TAU * attachment.frequency_hz;
        // Motion in units of 1/√mass like the modes', so that the mass matrix is the identity.
        let root = attachment.mass_kg.sqrt();
        let mut stretch = DVector::zeros(all);
        for (row, value) in body.motion_row(attachment.z_m, attachment.azimuth_deg, [0.0; 2]) {
            for mode in 0..own {
                stretch[mode] += root * value * modes.shapes[(row, mode)];
            }
        }
        stretch[dof] = -1.0;
        mass[dof] = 1.0;
        damping += &stretch * stretch.transpose() * (2.0 * attachment.damping_ratio * omega);
        stiffness += &stretch * stretch.transpose() * (omega * omega);
    }
    let mut state = DMatrix::zeros(2 * all, 2 * all);
    state.view_mut((0, all), (all, all)).fill_with_identity();
    state.view_mut((all, 0), (all, all)).copy_from(&(-&stiffness));
    state.view_mut((all, all), (all, all)).copy_from(&(-&damping));
    let poles = state.complex_eigenvalues();
    let upper = poles.iter().copied().filter(|pole| pole.im > 0.0);
    upper
        .filter_map(|pole| {
            let (pole, shape) = quadratic_mode(pole, &mass, &damping, &stiffness)?;
            // Residue of the receptance: shape shapeᵀ / (shapeᵀ (2 pole M + C) shape).
            let norm = shape.iter().zip(mass.iter()).map(|(s, m)| s * s * pole * 2.0 * *m).sum::<Complex<f64>>()
                + shape.dot(&(damping.map(Complex::from) * &shape));
            let on_channel = |channel: usize| (0..own).map(|mode| shape[mode] * at_sensors[(channel, mode)]).sum();
            Some(DampedMode {
                pole,
                shape: (0..at_sensors.nrows()).map(on_channel).collect(),
                input: (0..own).map(|mode| shape[mode] / norm).collect(),
            })
        })
        .collect()
}

/// The eigenvector of (pole² M + pole C + K), by inverse iteration from the pole, which it refines.
fn quadratic_mode(
    start: Complex<f64>,
    mass: &DVector<f64>,
    damping: &DMatrix<f64>,
    stiffness: &DMatrix<f64>,
) -> Option<(Complex<f64>, DVector<Complex<f64>>)> {
    let order = mass.len();
    let dynamic = |pole: Complex<f64>| {
        let full = |i: usize, j: usize| {
            let inertia = if i == j { pole * pole * mass[i] } else { Complex::from(0.0) };
            inertia + pole * damping[(i, j)] + stiffness[(i, j)]
        };
        DMatrix::from_fn(order, order, full)
    };
    let mut shape = DVector::from_fn(order, |at, _| Complex::new(1.0, 0.1 * (at as f64).sin()));
    let mut pole = start;
    // Off the eigenvalue by a hair, or the matrix is singular.
    let factor = dynamic(start * (1.0 + 1e-9)).lu();
    for _ in 0..4 {
        shape = factor.solve(&shape)?;
        let largest = shape.iter().copied().max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        shape /= largest;
    }
    // The pole of this shape: Newton on shapeᵀ D(pole) shape.
    for _ in 0..3 {
        let value = shape.dot(&(dynamic(pole) * &shape));
        let slope = shape.iter().zip(mass.iter()).map(|(s, m)| s * s * pole * 2.0 * *m).sum::<Complex<f64>>()
            + shape.dot(&(damping.map(Complex::from) * &shape));
        pole -= value / slope;
    }
    Some((pole, shape))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::body::Attachment;
    use crate::blind::structures::Structure;

    #[test]
    fn a_damper_splits_the_mode_that_it_is_tuned_to_and_residues_sum_up() {
        let structure = Structure::named("chimney").expect("it needs no files");
        let mut body = Body::fine(&structure);
        let modes = body.modes(12).expect("stable");
        let zeta = vec![0.01; 12];
        let before = damped_modes(&body, &modes, &zeta, 100.0);
        let tuned_hz = modes.frequencies_hz[0];
        for azimuth_deg in [0.0, 90.0] {
            body.attachments.push(Attachment {
                z_m: 175.0,
                azimuth_deg,
                mass_kg: 0.01 * body.total_mass_kg(),
                frequency_hz: tuned_hz,
                damping_ratio: 0.05,
            });
        }
        let after = damped_modes(&body, &modes, &zeta, 100.0);
        assert_eq!((before.len(), after.len()), (12, 14));
        assert!(after[0].frequency_hz() < 0.97 * tuned_hz && after[3].frequency_hz() > 1.02 * tuned_hz);
        assert!(after[..4].iter().all(|mode| mode.damping_ratio() > 0.015));
        // Static deflection is the same with or without: -sum of 2 Re(shape input / pole).
        let sag =
            |modes: &[DampedMode]| -> f64 { modes.iter().map(|m| -2.0 * (m.shape[0] * m.input[0] / m.pole).re).sum() };
        assert!((sag(&after) / sag(&before) - 1.0).abs() < 1e-6, "{} {}", sag(&after), sag(&before));
    }
}
