//! A setup with its averaged cross spectra: what identification starts from.
//!
//! The study says what stands where; the spectra come from [`crate::spectra`].

use super::resonance::Quantity;
use crate::spectra::CrossSpectrum;
use crate::study::{Motion, Sensor, Setup};

/// A setup with its averaged cross spectra.
#[derive(Debug, Clone)]
pub struct MeasuredSetup<'a> {
    /// What stands where.
    pub setup: &'a Setup,
    /// Its cross-spectral matrices.
    pub spectrum: CrossSpectrum,
}

/// What a setup's recording is of.
pub(super) fn quantity(setup: &Setup) -> Quantity {
    if setup.motion() == Motion::Velocity { Quantity::Velocity } else { Quantity::Acceleration }
}

/// Sensors with their setups, but for references that stand among them already: several setups share those.
pub(super) fn each_once<'a>(
    sensors: impl Iterator<Item = (&'a Setup, &'a Sensor)>,
) -> impl Iterator<Item = (&'a Setup, &'a Sensor)> {
    let mut points: Vec<&str> = Vec::new();
    sensors.filter(move |(_, sensor)| {
        let is_new = !(sensor.reference && points.contains(&sensor.point.as_str()));
        if is_new {
            points.push(&sensor.point);
        }
        is_new
    })
}

/// Which of several setups a channel is of, in words; nothing where there is one.
pub(super) fn of_setup(name: &str, has_setups: bool) -> String {
    if has_setups { format!(" of setup \"{name}\"") } else { String::new() }
}
