//! Modes that a program of the user's computed: a file of modes flows in, frequencies and mass-normalised shapes at all of its places flow
//! out, whether sensors stand there or not.
//!
//! The files are those of measured modes: a CSV table, whose columns are the places, or UFF 55, whose places are called `12x`.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use nalgebra::DMatrix;

use super::error::MeasuredError;
use super::{Format, csv_table, uff};
use crate::study::Sensor;

/// No structure has frequencies beyond these; their squares' squares are still numbers.
const POSSIBLE_HZ: RangeInclusive<f64> = 1e-6..=1e9;

/// Computed modes, lowest first.
#[derive(Debug, Clone, PartialEq)]
pub struct ComputedModes {
    /// Where they come from.
    pub file: PathBuf,
    /// The places, in the order of the file.
    pub places: Vec<String>,
    /// Natural frequencies in Hz, above 0.
    pub frequencies_hz: Vec<f64>,
    /// Shapes of unit modal mass, where the file has them so or states `modal_mass`: places x modes, real.
    pub shapes: DMatrix<f64>,
}

/// Reads a file of modes without knowing what stands at its places.
///
/// # Errors
/// [`MeasuredError`] names the file, and the line or the mode and the place: each mode has a real component at each place.
pub fn read_computed(path: &Path) -> Result<ComputedModes, MeasuredError> {
    let file = path.to_owned();
    let bytes = std::fs::read(path).map_err(|source| MeasuredError::UnreadableRun { file: file.clone(), source })?;
    let text = String::from_utf8_lossy(&bytes);
    let text = text.trim_start_matches('\u{feff}');
    let format = Format::of(path, text);
    let places = match format {
        Format::Json => {
            let reason = "computed modes are read from CSV and UFF 55".to_owned();
            return Err(MeasuredError::Syntax { file, line: 1, reason });
        }
        Format::Csv => csv_table::places(path, text)?,
        Format::Uff => uff::places(path, text)?,
    };
    let places: Vec<Sensor> = places.into_iter().map(|name| Sensor::new(name, 0)).collect();
    let mut modes = format.modes(path, text, &places, &mut Vec::new())?;
    if modes.is_empty() {
        return Err(MeasuredError::NoModes { file });
    }
    modes.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let mut shapes = DMatrix::from_element(places.len(), modes.len(), f64::NAN);
    for (column, mode) in modes.iter().enumerate() {
        let number = mode.number;
        if !POSSIBLE_HZ.contains(&mode.frequency_hz) {
            return Err(MeasuredError::Frequency { file, number, frequency_hz: mode.frequency_hz });
        }
        for component in &mode.components {
            let place = &places[component.sensor].channel;
            if component.value.im != 0.0 {
                return Err(MeasuredError::Complex { file, number, place: place.clone() });
            }
            shapes[(component.sensor, column)] = component.value.re / mode.modal_mass.unwrap_or(1.0).sqrt();
        }
        if let Some(place) = shapes.column(column).iter().position(|value| !value.is_finite()) {
            return Err(MeasuredError::NoComponent { file, number, place: places[place].channel.clone() });
        }
        if shapes.column(column).amax() == 0.0 {
            return Err(MeasuredError::ZeroShape { file, number });
        }
    }
    Ok(ComputedModes {
        file,
        places: places.into_iter().map(|place| place.channel).collect(),
        frequencies_hz: modes.iter().map(|mode| mode.frequency_hz).collect(),
        shapes,
    })
}
