//! The modes that `belfry identify` found, at the study's sensors.

use std::path::PathBuf;

use num_complex::Complex64;
use serde::Deserialize;

use super::ExportError;
use crate::study::{Sensor, Study};

/// Modes to export.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// The file they come from.
    pub file: PathBuf,
    /// Its text: the JSON of `belfry identify`.
    pub json: String,
    /// The study's sensors, each point once.
    pub sensors: Vec<Sensor>,
    /// The modes, in the file's order.
    pub modes: Vec<Mode>,
}

/// A mode.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// Its number, from 1.
    pub number: usize,
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Its standard deviation in Hz, where known.
    pub frequency_std_hz: Option<f64>,
    /// Damping ratio (1 is critical), where known.
    pub damping_ratio: Option<f64>,
    /// Its standard deviation, where known.
    pub damping_ratio_std: Option<f64>,
    /// Modal phase collinearity, where known.
    pub phase_collinearity: Option<f64>,
    /// The shape at each of the sensors; `None` where it was not measured.
    pub shape: Vec<Option<Component>>,
}

/// A mode shape at one sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component {
    /// In the sensor's positive direction.
    pub value: Complex64,
    /// Its standard deviation, where known.
    pub std: Option<f64>,
}

/// What `modes.json` holds of use here. Numbers that are not known stand as null there, hence not
/// [`crate::identify::Identification`] itself.
#[derive(Deserialize)]
struct File {
    modes: Vec<FileMode>,
}

#[derive(Deserialize)]
struct FileMode {
    number: usize,
    frequency_hz: f64,
    frequency_std_hz: Option<f64>,
    damping_ratio: Option<f64>,
    damping_ratio_std: Option<f64>,
    phase_collinearity: Option<f64>,
    shape: Vec<FileComponent>,
}

#[derive(Deserialize)]
struct FileComponent {
    channel: String,
    point: String,
    re: Option<f64>,
    im: Option<f64>,
    std: Option<f64>,
}

impl Modes {
    /// Reads `results/modes.json` of a study.
    ///
    /// # Errors
    /// Where the file is missing, or does not fit the study.
    pub fn load(study: &Study) -> Result<Self, ExportError> {
        let file = study.folder.join("results").join("modes.json");
        if !file.exists() {
            return Err(ExportError::NoModes { file, study: study.folder.clone() });
        }
        let json =
            std::fs::read_to_string(&file).map_err(|source| ExportError::Unreadable { file: file.clone(), source })?;
        let read: File =
            serde_json::from_str(&json).map_err(|source| ExportError::Syntax { file: file.clone(), source })?;
        if read.modes.is_empty() {
            return Err(ExportError::Empty { file });
        }
        let sensors = study.sensors();
        let mut modes = Vec::new();
        for mode in read.modes {
            let mut shape = vec![None; sensors.len()];
            for component in &mode.shape {
                let place = sensor(&sensors, component).and_then(|sensor| shape.get_mut(sensor));
                let place = place.ok_or_else(|| ExportError::UnknownChannel {
                    file: file.clone(),
                    number: mode.number,
                    channel: component.channel.clone(),
                })?;
                *place = component
                    .re
                    .map(|re| Component { value: Complex64::new(re, component.im.unwrap_or(0.0)), std: component.std });
            }
            modes.push(Mode {
                number: mode.number,
                frequency_hz: mode.frequency_hz,
                frequency_std_hz: mode.frequency_std_hz,
                damping_ratio: mode.damping_ratio,
                damping_ratio_std: mode.damping_ratio_std,
                phase_collinearity: mode.phase_collinearity,
                shape,
            });
        }
        Ok(Self { file, json, sensors, modes })
    }

    /// Whether any mode has a component at a sensor.
    pub fn is_measured(&self, sensor: usize) -> bool {
        self.modes.iter().any(|mode| mode.shape.get(sensor).is_some_and(Option::is_some))
    }
}

/// The sensor a component stands at: by its channel, else by its point where only one sensor has it. A reference goes by
/// the first setup that could be measured, which need not be the study's first.
fn sensor(sensors: &[Sensor], component: &FileComponent) -> Option<usize> {
    sensors.iter().position(|sensor| sensor.channel == component.channel).or_else(|| {
        let mut at_point = (0..sensors.len()).filter(|&index| sensors[index].point == component.point);
        at_point.next().filter(|_| at_point.next().is_none())
    })
}
