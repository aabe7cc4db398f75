//! The modes that a measurement is expected to find, and how sure it will be of them.
//!
//! A structure, its sensors and [`Conditions`] flow in; modes with standard deviations flow out, in the form in which a diagnosis
//! takes measured ones.
//!
//! Frequencies: the lower bound of any method (Au 2014, "Uncertainty law in ambient modal identification, part I"), times
//! [`OVER_BOUND`]. Shapes: the first eigenvector of a cross-spectral matrix averaged over n independent values errs along the
//! eigenvector j by a variance of `λ₁λⱼ / (n (λ₁ - λⱼ)²)`, half of it in phase (Brillinger 1981, "Time Series", theorem 9.4.4). At a
//! mode's resonance λ₁ is its own response, the λⱼ are those of the other modes and the noise, and n is the length of the record
//! times the half-power bandwidth 2ζf; of noise alone this is the law of Au (2014) for shapes. Loads are those of `belfry simulate`:
//! as strong as the mass on which they act, weak in torsion.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector, RowDVector};

use crate::compare::ModelView;
use crate::identify::accuracy::std_bounds;
use crate::model::{Assembly, DOFS_A_NODE};
use crate::modes::{MeasuredCovarianceFactor, MeasuredMode, MeasuredShape};
use crate::simulate::{Loading, default_coherence_length_m};

/// What a measurement is assumed to be like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions {
    /// Damping ratio of every mode, dashpots aside.
    pub damping_ratio: f64,
    /// Standard deviation of white noise at each sensor in percent of the RMS of its response, both within the band.
    pub noise_percent: f64,
    /// The band in which modes are looked for.
    pub band_hz: [f64; 2],
}

/// The damping ratio where nothing is known of it.
pub const ORDINARY_DAMPING: f64 = 0.01;
/// Noise in percent of the response where nothing is known of it.
pub const ORDINARY_NOISE_PERCENT: f64 = 2.0;
/// Standard deviations of frequencies that identification attains, in shares of the lower bound: on simulated records of 1 and 6 h of
/// the Canton Tower (14 modes, 1 % damping) 1.2 to 1.6, in the mean 1.4.
pub(crate) const OVER_BOUND: f64 = 1.4;
/// The response at a mode's resonance stands out from the noise by this factor, or the mode is not found.
const STANDS_OUT_OF_NOISE: f64 = 4.0;
/// A neighbour that responds more than this share of a mode's own response mixes with it as if it responded so much.
const MOST_MIXED: f64 = 0.5;

/// The modes of a structure as a record of `hours` is expected to show them, without errors; numbered from 1.
pub(crate) fn expected_modes(
    assembly: &Assembly,
    view: &ModelView,
    conditions: &Conditions,
    hours: f64,
) -> Vec<MeasuredMode> {
    let responses = Responses::of(assembly, view, conditions);
    let visible = (0..responses.modes.len()).filter(|&at| responses.is_visible(at));
    let mode = |(index, at): (usize, usize)| responses.expected(view, at, index + 1, 3600.0 * hours);
    visible.enumerate().map(mode).collect()
}

/// What the modes in the band respond.
struct Responses {
    /// Indices of the model's modes in the band that the sensors see.
    modes: Vec<usize>,
    frequencies_hz: Vec<f64>,
    damping_ratios: Vec<f64>,
    /// One-sided densities of the modal forces, for mass-normalised shapes.
    loads: Vec<f64>,
    /// Mass-normalised shapes at the sensors, sensors x modes.
    shapes: DMatrix<f64>,
    /// One-sided density of the noise at each sensor.
    noise: DVector<f64>,
}

impl Responses {
    fn of(assembly: &Assembly, view: &ModelView, conditions: &Conditions) -> Self {
        let [low_hz, high_hz] = conditions.band_hz;
        let hz = &view.modes.frequency_hz;
        let is_seen = |mode: &usize| {
            (low_hz..=high_hz).contains(&hz[*mode]) && view.at_sensors.column(*mode).iter().any(|value| *value != 0.0)
        };
        let modes: Vec<usize> = (0..hz.len()).filter(is_seen).collect();
        let frequencies_hz: Vec<f64> = modes.iter().map(|&mode| hz[mode]).collect();
        let damping_ratios: Vec<f64> =
            modes.iter().map(|&mode| conditions.damping_ratio + view.damping_ratio(mode)).collect();
        let shapes = view.at_sensors.select_columns(&modes);
        let loads = modal_loads(assembly, &view.modes.shapes.select_columns(&modes));
        // White noise of density S through a resonance has the variance S π f / 4ζ.
        let variance = |sensor: usize| -> f64 {
            let of = |mode: usize| {
                shapes[(sensor, mode)].powi(2) * loads[mode] * frequencies_hz[mode] / damping_ratios[mode]
            };
            0.25 * PI * (0..modes.len()).map(of).sum::<f64>()
        };
        let share = (0.01 * conditions.noise_percent).powi(2) / (high_hz - low_hz);
        let noise = DVector::from_fn(shapes.nrows(), |sensor, _| share * variance(sensor));
        Self { modes, frequencies_hz, damping_ratios, loads, shapes, noise }
    }

    /// Density of a mode's response at the resonance of another, in shares of its density at its own resonance for a shape and a
    /// load of one: the acceleration of an oscillator.
    fn density(&self, mode: usize, at: usize) -> f64 {
        let (ratio, damping) = (self.frequencies_hz[at] / self.frequencies_hz[mode], self.damping_ratios[mode]);
        let square = ratio * ratio;
        self.loads[mode] * square * square / ((1.0 - square).powi(2) + (2.0 * damping * ratio).powi(2))
    }

    fn is_visible(&self, mode: usize) -> bool {
        let own = self.density(mode, mode) * self.shapes.column(mode).norm_squared();
        own > STANDS_OUT_OF_NOISE * self.noise.mean()
    }

    fn expected(&self, view: &ModelView, at: usize, number: usize, duration_s: f64) -> MeasuredMode {
        let (frequency_hz, damping_ratio) = (self.frequencies_hz[at], self.damping_ratios[at]);
        let [bound_hz, _] = std_bounds(frequency_hz, damping_ratio, duration_s);
        let frequency_std_hz = OVER_BOUND * bound_hz;
        let shape = self.shapes.column(at);
        let length = shape.norm();
        let direction = shape / length;
        let largest = shape.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
        // From shapes of unit length to those whose largest component is one.
        let scale = length / largest;
        let averages = (duration_s * 2.0 * damping_ratio * frequency_hz).max(1.0);
        let own = self.density(at, at) * length * length;
        let others = (0..self.modes.len()).filter(|&other| other != at).map(|other| {
            let across = self.shapes.column(other) - &direction * direction.dot(&self.shapes.column(other));
            let size = across.norm();
            let share = (self.density(other, at) * size * size / own).min(MOST_MIXED);
            let std = (0.5 * share / averages).sqrt() / (1.0 - share);
            if size > 0.0 { across * (std / size) } else { across }
        });
        let columns: Vec<DVector<f64>> =
            std::iter::once(DVector::zeros(direction.len())).chain(others).map(|column| column * scale).collect();
        let joint = DMatrix::from_columns(&columns);
        let noise = self.noise.map(|noise| scale * scale * 0.5 * noise / own / averages);
        let stds =
            DVector::from_fn(direction.len(), |sensor, _| (joint.row(sensor).norm_squared() + noise[sensor]).sqrt());
        let mut frequency_row = RowDVector::zeros(joint.ncols());
        frequency_row[0] = frequency_std_hz;
        MeasuredMode {
            number,
            frequency_hz,
            frequency_std_hz: Some(frequency_std_hz),
            stated: None,
            damping_ratio: Some(damping_ratio),
            damping_ratio_std: None,
            // Errors of different modes are taken as independent.
            covariance_factor: Some(MeasuredCovarianceFactor {
                group: number,
                frequency_hz: frequency_row,
                shape: joint,
            }),
            shape: Some(MeasuredShape {
                sensors: (0..direction.len()).collect(),
                imaginary: Some(
                    view.imaginary(self.modes[at])
                        .map_or_else(|| DVector::zeros(direction.len()), |imaginary| imaginary / largest),
                ),
                values: shape / largest,
                stds: Some(stds),
            }),
        }
    }
}

/// One-sided densities of modal forces, up to a common factor. Where nodes have no heights every mode is loaded alike.
fn modal_loads(assembly: &Assembly, shapes: &DMatrix<f64>) -> Vec<f64> {
    if assembly.node_elevations_m().len() * DOFS_A_NODE != assembly.dofs() {
        return vec![1.0; shapes.ncols()];
    }
    let loading = Loading::new(assembly, 1.0, default_coherence_length_m(assembly), 2.0);
    loading.on_modes(assembly.at_rows(shapes).as_ref()).row_iter().map(|row| row.norm_squared()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::study;

    fn tower(conditions: &Conditions, hours: f64) -> Vec<MeasuredMode> {
        let (structure, _, sensors) = study();
        let assembly = structure.assemble();
        expected_modes(&assembly, &ModelView::of(&assembly, &sensors).unwrap(), conditions, hours)
    }

    const TOWER: Conditions = Conditions { damping_ratio: 0.01, noise_percent: 2.0, band_hz: [0.05, 1.5] };

    /// RMS deviation of the components of a shape of unit length.
    fn shape_std(mode: &MeasuredMode) -> f64 {
        let shape = mode.shape.as_ref().unwrap();
        (shape.stds.as_ref().unwrap().norm_squared() / shape.values.len() as f64).sqrt() / shape.values.norm()
    }

    #[test]
    fn all_deviations_fall_with_the_root_of_the_record() {
        for (one, four) in tower(&TOWER, 6.0).iter().zip(&tower(&TOWER, 24.0)) {
            let ratio = one.frequency_std_hz.unwrap() / four.frequency_std_hz.unwrap();
            assert!((ratio - 2.0).abs() < 1e-9 && (shape_std(one) / shape_std(four) - 2.0).abs() < 1e-6, "{ratio}");
        }
    }

    /// An hour of the simulated tower, 1 % damping, 2 % noise: identification states shapes' deviations of 0.001 to 0.003 (of unit length) for
    /// bending, 0.02 to 0.03 for torsion, which is loaded less and stands beside bending (`belfry identify`, seed 3).
    #[test]
    fn shapes_are_as_sure_as_identification_finds_them() {
        let stated = [
            0.0010, 0.0020, 0.0021, 0.0314, 0.0025, 0.0333, 0.0024, 0.0026, 0.0033, 0.0205, 0.0071, 0.0222, 0.0030,
            0.0034,
        ];
        let modes = tower(&TOWER, 1.0);
        assert_eq!(modes.len(), stated.len());
        for (mode, stated) in modes.iter().zip(stated) {
            let ratio = shape_std(mode) / stated;
            assert!((0.4..2.0).contains(&ratio), "mode {}: {ratio:.2} of what is stated", mode.number);
        }
    }

    #[test]
    fn noise_hides_modes_and_blurs_shapes() {
        let noisy = Conditions { noise_percent: 100.0, ..TOWER };
        let (clear, noisy) = (tower(&TOWER, 6.0), tower(&noisy, 6.0));
        assert!(noisy.len() <= clear.len());
        assert!(shape_std(&noisy[0]) > 3.0 * shape_std(&clear[0]));
        assert!(tower(&Conditions { noise_percent: 1e5, ..TOWER }, 6.0).is_empty());
    }
}
