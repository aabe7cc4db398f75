//! Why one effect fits and another does not: what the model misses, number by number, beside what each effect would do.
//!
//! The present model and what a search found flow in; fingerprints flow out: for every mode the change of its frequency and of its shape
//! at each sensor, in units in which all numbers are independent and of unit variance, as far as measurement, tolerance and discrepancy
//! can tell. The nearer an effect's fingerprint is to the misfit, the more it explains: squares of the difference are what is left of
//! chi-squared, but for the step from a straight line. What modes have in common, as a common error of segments would make it, hardly
//! counts there: where all are slower, the one that is least so may stand above zero.

use belfry_numerics::{CholeskyFactor, EigenPairs};
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::fit::Fit;
use super::found::Found;
use super::problem::Problem;
use super::state::State;
use crate::compare::Block;
use crate::study::Direction;

/// The misfit of the present model, no segment adjusted, beside what the candidates would do.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fingerprints {
    /// The measured modes.
    pub modes: Vec<FingerprintMode>,
    /// The sensors, the lowest first.
    pub sensors: Vec<FingerprintSensor>,
    /// What was measured, less what the model says.
    pub measured: Fingerprint,
    /// What candidates would do, the most probable first.
    pub candidates: Vec<CandidateFingerprint>,
}

/// A measured mode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FingerprintMode {
    /// Its number.
    pub measured: usize,
    /// Its frequency.
    pub measured_hz: f64,
}

/// A sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FingerprintSensor {
    /// The channel.
    pub channel: String,
    /// Its height, where it has one.
    pub elevation_m: Option<f64>,
    /// Its direction, where it is level.
    pub azimuth_deg: Option<f64>,
}

/// Changes in standard deviations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fingerprint {
    /// Of the frequency, mode by mode: above zero is faster, beside what modes have in common as segments could make it.
    pub frequency: Vec<f64>,
    /// Of the shape, modes x sensors: above zero is more motion in the direction in which the model moves; null where nothing is compared.
    pub shape: Vec<Vec<Option<f64>>>,
}

/// What a candidate would do.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CandidateFingerprint {
    /// The effect.
    pub effect: String,
    /// The probability that it is what the model lacks.
    pub probability: f64,
    /// The share of the squares of the misfit that it explains; below zero where it makes the misfit larger.
    pub explained: f64,
    /// What it would do.
    pub fingerprint: Fingerprint,
}

impl Problem {
    /// The misfit of the present model beside what was found; `None` where the model cannot be compared without its scatter.
    pub(super) fn fingerprints(&self, present: &Fit, found: &[(&Found, f64)]) -> Option<Fingerprints> {
        let straight = self.without_scatter(present).ok()?;
        let white = White::of(&straight)?;
        let missed = white.whiten(-straight.state.residual.vector());
        let order = self.sensors_upwards();
        let print = |whitened: &DVector<f64>| self.fingerprint(&straight.state, whitened, &order);
        let candidate = |(found, probability): &(&Found, f64)| {
            let there = self.state_without_scatter(found.own().effects()).ok()?;
            let change = white.whiten(change(&straight.state, &there)?);
            let explained = 1.0 - (&missed - &change).norm_squared() / missed.norm_squared().max(f64::MIN_POSITIVE);
            let (effect, fingerprint) = (found.effect().to_string(), print(&change));
            Some(CandidateFingerprint { effect, probability: *probability, explained: rounded(explained), fingerprint })
        };
        let modes = straight.state.residual.blocks().map(|(_, block)| {
            let mode = &self.measured[block.measured];
            FingerprintMode { measured: mode.number, measured_hz: mode.frequency_hz }
        });
        let sensor = |&index: &usize| {
            let sensor = &self.sensors[index];
            let azimuth_deg = match sensor.direction {
                Some(Direction::AzimuthDeg(azimuth_deg)) => Some(azimuth_deg),
                _ => None,
            };
            FingerprintSensor { channel: sensor.channel.clone(), elevation_m: sensor.elevation_m, azimuth_deg }
        };
        Some(Fingerprints {
            modes: modes.collect(),
            sensors: order.iter().map(sensor).collect(),
            measured: print(&missed),
            candidates: found.iter().filter_map(candidate).collect(),
        })
    }

    /// Sensors by height and direction.
    fn sensors_upwards(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.sensors.len()).collect();
        let height = |sensor: &usize| self.sensors[*sensor].elevation_m.unwrap_or(f64::INFINITY);
        order.sort_by(|a, b| height(a).total_cmp(&height(b)));
        order
    }

    /// From directions of each block to its sensors, in the order given.
    fn fingerprint(&self, state: &State, whitened: &DVector<f64>, order: &[usize]) -> Fingerprint {
        let blocks = || state.residual.blocks();
        let of_block = |(first, block): (usize, &Block)| {
            let mut at_sensors = vec![None; self.sensors.len()];
            if let Some(shape) = &block.shape {
                let along = &shape.directions * whitened.rows(first + 1, block.size() - 1);
                for ((&sensor, along), model) in shape.sensors.iter().zip(along.iter()).zip(shape.nearest().iter()) {
                    at_sensors[sensor] = Some(rounded(along * model.signum()));
                }
            }
            order.iter().map(|&sensor| at_sensors[sensor]).collect()
        };
        Fingerprint {
            frequency: blocks().map(|(first, _)| rounded(whitened[first])).collect(),
            shape: blocks().map(of_block).collect(),
        }
    }
}

/// Three decimals say all that there is to say of a number of unit variance.
fn rounded(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0 + 0.0
}

/// By how much the model's numbers are others in another state, along the directions of this one; `None` where it has other modes.
fn change(here: &State, there: &State) -> Option<DVector<f64>> {
    let mut change = DVector::zeros(here.residual.size());
    for (first, block) in here.residual.blocks() {
        let (_, other) = there.residual.block_of(block.measured)?;
        change[first] = other.residual[0] - block.residual[0];
        if let Some(shape) = &block.shape {
            let other = other.shape.as_ref().filter(|other| other.sensors == shape.sensors)?;
            let along = shape.directions.tr_mul(&(other.nearest() - shape.nearest()));
            change.rows_mut(first + 1, block.size() - 1).copy_from(&along);
        }
    }
    Some(change)
}

/// Takes differences to numbers that are independent and of unit variance, each as near to its own difference as can be: the symmetric
/// root of the inverse covariance (Kessy, Lewin and Strimmer 2018, Am. Stat. 72, 309).
struct White {
    /// Standard deviations by which differences are scaled first: of each frequency, and one of each shape, so that directions may be any.
    scales: DVector<f64>,
    root: DMatrix<f64>,
}

impl White {
    /// By measurement, discrepancy and what the background may do, at a fit without scatter; `None` where the covariance is not positive
    /// definite.
    fn of(fit: &Fit) -> Option<Self> {
        let residual = &fit.state.residual;
        let size = residual.size();
        let first_number = fit.knobs.len();
        let mut by_numbers = fit.slopes.view((0, first_number), (size, fit.slopes.ncols() - first_number)).into_owned();
        let mut covariance = DMatrix::zeros(size, size);
        fit.state.unwhiten(&mut by_numbers);
        for (first, block, factor) in fit.state.blocks() {
            let lower = factor.l();
            covariance.view_mut((first, first), (block.size(), block.size())).copy_from(&(&lower * lower.transpose()));
        }
        covariance += &by_numbers * by_numbers.transpose();
        let mut scales = DVector::zeros(size);
        for (first, block) in residual.blocks() {
            let count = block.size() - 1;
            scales[first] = covariance[(first, first)].sqrt();
            if count > 0 {
                let mean = (first + 1..=first + count).map(|row| covariance[(row, row)]).sum::<f64>() / count as f64;
                scales.rows_mut(first + 1, count).fill(mean.sqrt());
            }
        }
        for (row, column) in (0..size).flat_map(|row| (0..size).map(move |column| (row, column))) {
            covariance[(row, column)] /= scales[row] * scales[column];
        }
        let EigenPairs { values, vectors } =
            CholeskyFactor::of(&DMatrix::identity(size, size), 0.0)?.generalised_eigen(&covariance)?;
        if values.iter().any(|value| !value.is_finite() || *value <= 0.0) {
            return None;
        }
        let mut halves = vectors.clone();
        for (mut half, value) in halves.column_iter_mut().zip(&values) {
            half /= value.sqrt();
        }
        Some(Self { scales, root: halves * vectors.transpose() })
    }

    fn whiten(&self, differences: DVector<f64>) -> DVector<f64> {
        &self.root * differences.component_div(&self.scales)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::testing::{measured, scattered, study};
    use super::super::{Options, Signals, diagnose};
    use super::*;

    fn problem(word: &str) -> Problem {
        let (structure, model, sensors) = study();
        let truth = scattered(&structure, &model, 0.5, 2).and(&[word.parse().unwrap()]).unwrap();
        let modes = measured(&truth, &sensors, 12, &mut ChaCha8Rng::seed_from_u64(2));
        Problem::new(structure, &[], &model, &sensors, &modes).unwrap()
    }

    /// Squares of whitened differences are those of the generalised distance, which Woodbury's identity gives without a root.
    #[test]
    fn squares_are_those_of_measurement_and_tolerance_together() {
        let problem = problem("base-rotation=8e-15");
        let straight = problem.without_scatter(&problem.present(&[]).unwrap()).unwrap();
        let white = White::of(&straight).unwrap();
        let squares = white.whiten(straight.state.residual.vector()).norm_squared();
        let slopes = straight.slopes.rows(0, straight.state.modes.len()).into_owned();
        let along = slopes.tr_mul(&straight.state.modes);
        let prior = DMatrix::identity(along.len(), along.len());
        let moved = (slopes.transpose() * &slopes + prior).try_inverse().unwrap() * &along;
        let expected = straight.state.modes.norm_squared() - along.dot(&moved);
        assert!((squares / expected - 1.0).abs() < 1e-6, "{squares} {expected}");
    }

    /// What the true effect would do is what is missed; what rivals would do is not.
    #[test]
    fn the_true_effect_explains_and_rivals_do_not() {
        let diagnosis =
            diagnose(&problem("added-mass@443.6m=4e6"), &[], &Signals::default(), &Options::default()).unwrap();
        let prints = diagnosis.fingerprints.unwrap();
        let (best, rivals) = prints.candidates.split_first().unwrap();
        assert!(best.effect.starts_with("added-mass"), "{}", best.effect);
        // What it leaves is what errors of unit variance make; twenty numbers a mode, less the length of the shape, were measured.
        let print = &prints.measured;
        let shapes = print.shape.iter().flatten().flatten();
        let all: f64 = print.frequency.iter().chain(shapes).map(|value| value * value).sum();
        let left = (1.0 - best.explained) * all / 240.0;
        assert!((0.5..1.5).contains(&left) && all > 3.0 * 240.0, "{left} of {}", all / 240.0);
        let explained = |rival: &CandidateFingerprint| rival.explained < 0.7 * best.explained;
        assert!(!rivals.is_empty() && rivals.iter().all(explained), "{rivals:?}");
        // What stands out goes the way that the effect drives it.
        let pairs = || print.frequency.iter().zip(&best.fingerprint.frequency).filter(|(missed, _)| missed.abs() > 3.0);
        assert!(pairs().count() > 2 && pairs().all(|(missed, change)| missed * change > 0.0), "{:?}", print.frequency);
        // Heights ascend, and every mode has a number at every sensor.
        let heights: Vec<f64> = prints.sensors.iter().filter_map(|sensor| sensor.elevation_m).collect();
        assert!(heights.len() == 20 && heights.is_sorted());
        assert!(prints.measured.shape.iter().all(|row| row.iter().all(Option::is_some)));
    }
}
