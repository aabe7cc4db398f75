//! What a comparison says, as it is printed and stored.

use serde::Serialize;

use super::deviation::{FREQUENCY_ASSUMED, SHAPE_ASSUMED, frequency_deviation};
use super::misfit::{comac, misfit_by_sensor};
use super::pairing::Pair;
use super::residual::ChiSquared;
use super::shape::mac;
use super::view::ModelView;
use crate::modes::MeasuredMode;
use crate::study::Sensor;

/// Pairs, and where they disagree.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// In the order of the measured modes.
    pub pairs: Vec<PairReport>,
    /// Mean absolute frequency error of the pairs.
    pub mean_abs_frequency_error_percent: Option<f64>,
    /// Mean MAC of the pairs whose shape was measured.
    pub mean_mac: Option<f64>,
    /// Squared length of the whitened residual.
    pub chi_squared: Option<f64>,
    /// Numbers compared.
    pub degrees_of_freedom: Option<usize>,
    /// Probability of so large a chi-squared, or a larger one, of a right model.
    pub p_value: Option<f64>,
    /// Misfit of each sensor that a paired shape knows.
    pub by_sensor: Vec<SensorMisfit>,
    /// Misfit of each height with sensors, lowest first.
    pub by_height: Vec<HeightMisfit>,
    /// Of a structure that is no tower, instead: misfit of each group with sensors at its nodes.
    pub by_group: Vec<GroupMisfit>,
    /// Groups of such a structure at which no sensor stands, so that no misfit is known of them.
    pub groups_without_sensors: Vec<String>,
    /// Modes without a partner.
    pub unpaired: Vec<Unpaired>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// A measured mode and the model mode that belongs to it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairReport {
    /// Number of the measured mode.
    pub measured: usize,
    /// Number of the model's mode, from 1, lowest first.
    pub model: usize,
    /// Measured frequency.
    pub measured_hz: f64,
    /// The model's frequency.
    pub model_hz: f64,
    /// The model's frequency against the measured one.
    pub frequency_error_percent: f64,
    /// The same in standard deviations of the measurement; null where its deviation is unknown.
    pub frequency_z: Option<f64>,
    /// Whether the file of modes states that they belong together.
    pub stated: bool,
    /// Modal assurance criterion; null where no shape was measured.
    pub mac: Option<f64>,
    /// For one of several close modes: the MAC with the span of the close model modes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subspace_mac: Option<f64>,
}

/// Misfit at a sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorMisfit {
    /// The channel.
    pub channel: String,
    /// Root mean square over the pairs of the shapes' difference, in shares of the shapes' RMS component.
    pub misfit: f64,
    /// Coordinate MAC: 1 where the sensor fits in all pairs.
    pub comac: Option<f64>,
}

/// Misfit at a height.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeightMisfit {
    /// The height.
    pub elevation_m: f64,
    /// Root mean square of its sensors' misfit.
    pub misfit: f64,
}

/// Misfit at a group of the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupMisfit {
    /// The group's name.
    pub group: String,
    /// Root mean square of the misfit of the sensors at its nodes.
    pub misfit: f64,
}

/// Whose mode has no partner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The measurement's.
    Measured,
    /// The model's.
    Model,
}

/// A mode without a partner; of the model's, those between the lowest and the highest paired one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unpaired {
    /// Whose it is.
    pub side: Side,
    /// Its number.
    pub number: usize,
    /// Its frequency.
    pub frequency_hz: f64,
    /// The mode of the other side that it resembles most, by MAC.
    pub nearest: Option<usize>,
    /// The MAC with it.
    pub nearest_mac: Option<f64>,
}

pub(super) fn comparison(
    view: &ModelView,
    measured: &[MeasuredMode],
    sensors: &[Sensor],
    pairs: &[Pair],
    chi_squared: Option<ChiSquared>,
) -> Comparison {
    let reports: Vec<PairReport> = pairs.iter().map(|pair| report(view, &measured[pair.measured], pair)).collect();
    let mean = |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let misfits = misfit_by_sensor(view, measured, pairs, sensors.len());
    let comacs = comac(view, measured, pairs, sensors.len());
    let by_sensor = sensors.iter().zip(misfits.iter().zip(&comacs)).filter_map(|(sensor, (misfit, comac))| {
        Some(SensorMisfit { channel: sensor.channel.clone(), misfit: (*misfit)?, comac: *comac })
    });
    Comparison {
        mean_abs_frequency_error_percent: mean(reports.iter().map(|pair| pair.frequency_error_percent.abs()).collect()),
        mean_mac: mean(reports.iter().filter_map(|pair| pair.mac).collect()),
        chi_squared: chi_squared.map(|test| test.chi_squared),
        degrees_of_freedom: chi_squared.map(|test| test.degrees_of_freedom),
        p_value: chi_squared.map(|test| test.p_value),
        by_sensor: by_sensor.collect(),
        by_height: by_height(sensors, &misfits),
        by_group: Vec::new(),
        groups_without_sensors: Vec::new(),
        unpaired: unpaired(view, measured, pairs),
        warnings: warnings(measured, &reports, chi_squared.is_some()),
        pairs: reports,
    }
}

/// Shapes with a MAC below this stand more than 45° apart, from where on a |phi - phihat| projected shrinks again.
const FAR_APART: f64 = 0.5;

fn warnings(measured: &[MeasuredMode], pairs: &[PairReport], has_test: bool) -> Vec<String> {
    let mut warnings = Vec::new();
    let paired: Vec<&MeasuredMode> =
        pairs.iter().filter_map(|pair| measured.iter().find(|mode| mode.number == pair.measured)).collect();
    let numbers = |which: &dyn Fn(&MeasuredMode) -> bool| {
        let numbers: Vec<String> =
            paired.iter().filter(|mode| which(mode)).map(|mode| mode.number.to_string()).collect();
        (!numbers.is_empty()).then(|| numbers.join(", "))
    };
    if let Some(numbers) = numbers(&|mode| mode.frequency_std_hz.is_none()) {
        warnings.push(format!(
            "mode {numbers}: the measurement states no deviation of the frequency; chi-squared assumes {} %",
            100.0 * FREQUENCY_ASSUMED
        ));
    }
    let unknown = |mode: &MeasuredMode| {
        let shape = mode.shape.as_ref();
        shape.is_some_and(|shape| shape.stds.as_ref().is_none_or(|stds| stds.iter().any(|std| std.is_nan())))
    };
    if let Some(numbers) = numbers(&unknown) {
        warnings.push(format!(
            "mode {numbers}: the measurement states no deviation of (all of) the shape; chi-squared assumes {SHAPE_ASSUMED} of its length"
        ));
    }
    if let Some(numbers) = numbers(&|mode| mode.shape.is_none() && mode.stated.is_none()) {
        warnings.push(format!(
            "mode {numbers}: no shape was measured, so its partner is a guess by frequency; a model that is wrong by 10 % can have another mode there. If you know which mode it is, state it (model_mode in a CSV file of modes)"
        ));
    }
    for pair in pairs.iter().filter(|pair| pair.subspace_mac.or(pair.mac).is_some_and(|mac| mac < FAR_APART)) {
        warnings.push(format!(
            "mode {}: hardly resembles model mode {} (MAC {:.2}); chi-squared counts its shape for less than it is off",
            pair.measured,
            pair.model,
            pair.mac.unwrap_or(0.0)
        ));
    }
    if !pairs.is_empty() && !has_test {
        warnings.push("no chi-squared: the covariance of the measured modes is not positive definite".to_owned());
    }
    warnings
}

fn report(view: &ModelView, mode: &MeasuredMode, pair: &Pair) -> PairReport {
    let model_hz = view.modes.frequency_hz[pair.model];
    PairReport {
        measured: mode.number,
        model: pair.model + 1,
        measured_hz: mode.frequency_hz,
        model_hz,
        frequency_error_percent: 100.0 * (model_hz / mode.frequency_hz - 1.0),
        frequency_z: frequency_z(mode, model_hz),
        stated: mode.stated.is_some(),
        mac: pair.mac,
        subspace_mac: pair.subspace_mac,
    }
}

/// A model's frequency against a measured one in standard deviations of the latter.
pub(crate) fn frequency_z(mode: &MeasuredMode, model_hz: f64) -> Option<f64> {
    mode.frequency_std_hz.map(|_| (model_hz / mode.frequency_hz).ln() / frequency_deviation(mode))
}

/// Sensors within this distance (in m) stand at one height.
const SAME_HEIGHT_M: f64 = 0.01;

fn by_height(sensors: &[Sensor], misfits: &[Option<f64>]) -> Vec<HeightMisfit> {
    let known = sensors.iter().zip(misfits).filter_map(|(sensor, misfit)| Some((sensor.elevation_m?, (*misfit)?)));
    levels(known.collect())
        .into_iter()
        .map(|(elevation_m, misfits)| HeightMisfit {
            elevation_m,
            misfit: (misfits.iter().map(|misfit| misfit * misfit).sum::<f64>() / misfits.len() as f64).sqrt(),
        })
        .collect()
}

/// How many of the model's modes, from the lowest, one of so many measured ones without a partner is held against.
pub(crate) fn searched(measured: usize) -> usize {
    2 * measured + 4
}

/// Values of sensors (height in m, value) by height, lowest first.
pub(crate) fn levels(mut values: Vec<(f64, f64)>) -> Vec<(f64, Vec<f64>)> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    values
        .chunk_by(|a, b| b.0 - a.0 < SAME_HEIGHT_M)
        .map(|level| (level[0].0, level.iter().map(|(_, value)| *value).collect()))
        .collect()
}

fn unpaired(view: &ModelView, measured: &[MeasuredMode], pairs: &[Pair]) -> Vec<Unpaired> {
    let nearest = |resemblance: &mut dyn Iterator<Item = (usize, f64)>| {
        resemblance.filter(|(_, mac)| *mac > 0.0).max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let mut unpaired = Vec::new();
    for (_, mode) in measured.iter().enumerate().filter(|(index, _)| pairs.iter().all(|pair| pair.measured != *index)) {
        let models = mode.shape.as_ref().map(|shape| {
            (0..view.modes.frequency_hz.len()).map(move |model| (model + 1, mac(view.shape(model), shape)))
        });
        // Far above the measured band anything resembles anything at a few sensors.
        let near = models.and_then(|models| nearest(&mut models.take(searched(measured.len()))));
        unpaired.push(Unpaired {
            side: Side::Measured,
            number: mode.number,
            frequency_hz: mode.frequency_hz,
            nearest: near.map(|(number, _)| number),
            nearest_mac: near.map(|(_, mac)| mac),
        });
    }
    let (first, last) = pairs.iter().fold((usize::MAX, 0), |(a, b), pair| (a.min(pair.model), b.max(pair.model)));
    for model in (first..=last).filter(|model| pairs.iter().all(|pair| pair.model != *model)) {
        let mut modes =
            measured.iter().filter_map(|mode| Some((mode.number, mac(view.shape(model), mode.shape.as_ref()?))));
        let near = nearest(&mut modes);
        unpaired.push(Unpaired {
            side: Side::Model,
            number: model + 1,
            frequency_hz: view.modes.frequency_hz[model],
            nearest: near.map(|(number, _)| number),
            nearest_mac: near.map(|(_, mac)| mac),
        });
    }
    unpaired
}
