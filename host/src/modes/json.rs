//! Modes as `belfry identify` writes them; of another tool's JSON only `frequency_hz` is needed.

use std::path::Path;

use num_complex::Complex64;
use serde::Deserialize;
use serde_json::{Value, json};

use super::channel::{known_channels, sensor_named};
use super::error::MeasuredError;
use super::measured::MeasuredMode;
use super::shape::{RawComponent, RawMode};
use crate::identify::CovarianceFactor;
use crate::study::Sensor;

#[derive(Deserialize)]
struct File {
    modes: Vec<Mode>,
}

#[derive(Deserialize)]
struct Mode {
    number: Option<usize>,
    frequency_hz: f64,
    frequency_std_hz: Option<f64>,
    damping_ratio: Option<f64>,
    damping_ratio_std: Option<f64>,
    #[serde(default)]
    shape: Vec<Component>,
    covariance_factor: Option<Factor>,
}

/// Another tool's field of this name counts only where it is the same.
#[derive(Deserialize)]
#[serde(untagged)]
enum Factor {
    Joint(CovarianceFactor),
    Other(serde::de::IgnoredAny),
}

#[derive(Deserialize)]
struct Component {
    channel: String,
    point: Option<String>,
    re: Option<f64>,
    #[serde(default)]
    im: Option<f64>,
    std: Option<f64>,
}

pub(super) fn modes(path: &Path, text: &str, sensors: &[Sensor]) -> Result<Vec<RawMode>, MeasuredError> {
    let file: File = serde_json::from_str(text).map_err(|error| MeasuredError::Syntax {
        file: path.to_owned(),
        line: error.line() as u64,
        reason: format!("not the JSON of modes ({error})"),
    })?;
    let component = |(component, scatter): (Component, Vec<f64>)| {
        let by_point = component.point.as_deref().and_then(|point| sensor_named(sensors, point));
        let sensor = sensor_named(sensors, &component.channel).or(by_point);
        let sensor = sensor.ok_or_else(|| MeasuredError::UnknownChannel {
            file: path.to_owned(),
            channel: component.channel.clone(),
            known: known_channels(sensors),
        })?;
        let value = Complex64::new(component.re.unwrap_or(f64::NAN), component.im.unwrap_or(0.0));
        Ok(RawComponent { sensor, value, std: component.std, scatter })
    };
    let mode = |(index, mode): (usize, Mode)| {
        let is_whole = |scatter: &CovarianceFactor| {
            let columns = scatter.frequency_hz.len();
            scatter.shape.len() == mode.shape.len() && scatter.shape.iter().all(|row| row.len() == columns)
        };
        let scatter = match mode.covariance_factor {
            Some(Factor::Joint(scatter)) if is_whole(&scatter) => Some(scatter),
            _ => None,
        };
        let (of_frequency, of_shape) = match scatter {
            Some(scatter) => (Some((scatter.group, scatter.frequency_hz)), scatter.shape),
            None => (None, vec![Vec::new(); mode.shape.len()]),
        };
        Ok(RawMode {
            modal_mass: None,
            number: mode.number.unwrap_or(index + 1),
            frequency_hz: mode.frequency_hz,
            frequency_std_hz: mode.frequency_std_hz,
            stated: None,
            damping_ratio: mode.damping_ratio,
            damping_ratio_std: mode.damping_ratio_std,
            scatter: of_frequency,
            components: mode.shape.into_iter().zip(of_shape).map(component).collect::<Result<_, _>>()?,
        })
    };
    file.modes.into_iter().enumerate().map(mode).collect()
}
/// Modes over these sensors under the names that a report of `belfry identify` has for what is known of them.
pub fn as_reported(modes: &[MeasuredMode], sensors: &[Sensor]) -> Value {
    let mode = |mode: &MeasuredMode| {
        let shape = mode.shape.iter().flat_map(|shape| {
            shape.sensors.iter().enumerate().map(|(row, &sensor)| {
                let sensor = sensors.get(sensor);
                json!({
                    "channel": sensor.map(|sensor| &sensor.channel),
                    "point": sensor.map(|sensor| &sensor.point),
                    "re": shape.values[row],
                    "im": shape.imaginary.as_ref().map(|imaginary| imaginary[row]),
                    "std": shape.stds.as_ref().map(|stds| stds[row]),
                })
            })
        });
        json!({
            "number": mode.number,
            "frequency_hz": mode.frequency_hz,
            "frequency_std_hz": mode.frequency_std_hz,
            "damping_ratio": mode.damping_ratio,
            "damping_ratio_std": mode.damping_ratio_std,
            "shape": shape.collect::<Vec<Value>>(),
        })
    };
    modes.iter().map(mode).collect()
}
