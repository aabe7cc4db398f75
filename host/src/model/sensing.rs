//! What sensors really are where that differs from what the study says: turned, swapped, of another sensitivity, or late.

use std::f64::consts::TAU;
use std::fmt;
use std::sync::Arc;

use nalgebra::{DMatrix, RowDVector};

use crate::study::Sensor;

/// One thing that is different about the sensors; what it leaves alone keeps its default.
pub trait SensorChange: fmt::Debug + Send + Sync {
    /// Turns a sensor to where it really points.
    fn turn(&self, _sensor: &mut Sensor) {}

    /// Changes what channels record, given what their sensors see: rows, sensors x anything.
    fn record(&self, _rows: &mut DMatrix<f64>, _sensors: &[Sensor]) {}

    /// By how many seconds a sensor's samples come late.
    fn delay_s(&self, _sensor: &Sensor) -> f64 {
        0.0
    }
}

/// Everything that is different about the sensors, in the order of the effects.
#[derive(Debug, Clone, Default)]
pub struct Sensing {
    changes: Vec<Arc<dyn SensorChange>>,
}

impl Sensing {
    /// All of these changes, one after the other.
    pub(super) fn of(changes: impl Iterator<Item = Arc<dyn SensorChange>>) -> Self {
        Self { changes: changes.collect() }
    }

    /// A sensor as it really points.
    pub(super) fn turned(&self, sensor: &Sensor) -> Sensor {
        let mut turned = sensor.clone();
        for change in &self.changes {
            change.turn(&mut turned);
        }
        turned
    }

    /// What channels record, given what their sensors see: gains and swaps on rows, sensors x anything.
    pub(crate) fn record(&self, rows: &mut DMatrix<f64>, sensors: &[Sensor]) {
        for change in &self.changes {
            change.record(rows, sensors);
        }
    }

    /// By how many seconds each sensor's samples come late; `None` where none does.
    pub fn delays_s(&self, sensors: &[Sensor]) -> Option<RowDVector<f64>> {
        let mut delays = RowDVector::zeros(sensors.len());
        for change in &self.changes {
            for (delay, sensor) in delays.iter_mut().zip(sensors) {
                *delay += change.delay_s(sensor);
            }
        }
        delays.iter().any(|delay| *delay != 0.0).then_some(delays)
    }
}

/// The phases in rad at which sensors record a real shape of a mode, turned so that the recorded shape is the most real:
/// `-2 pi f tau` each, less what all have in common (the phase of the sum of squares, halved).
pub fn phases_rad(shape: &[f64], delays_s: &RowDVector<f64>, frequency_hz: f64) -> Vec<f64> {
    let phases: Vec<f64> = delays_s.iter().map(|delay| -TAU * frequency_hz * delay).collect();
    let squares = shape.iter().zip(&phases).map(|(value, phase)| {
        let (sin, cos) = (2.0 * phase).sin_cos();
        (value * value * cos, value * value * sin)
    });
    let (re, im) = squares.fold((0.0, 0.0), |(re, im), (a, b)| (re + a, im + b));
    let common = 0.5 * im.atan2(re);
    phases.iter().map(|phase| phase - common).collect()
}

/// The row of a channel among the sensors; a `ch` in front of its name may be left out or not.
pub(crate) fn row_of(channel: &str, sensors: &[Sensor]) -> Option<usize> {
    let row = |name: &str| sensors.iter().position(|sensor| sensor.channel == name);
    row(channel).or_else(|| row(channel.strip_prefix("ch")?))
}
