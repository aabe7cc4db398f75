//! Modes as a CSV table: `mode, frequency_hz, frequency_std_hz, damping_ratio, model_mode`, then a column a channel, and `CHANNEL_std`.
//!
//! Only `frequency_hz` is needed. A component is a number, or a complex one as `0.5-0.1i`; an empty cell or NaN is a
//! component that is not known.

use std::path::Path;

use num_complex::Complex64;

use super::channel::{known_channels, sensor_named};
use super::error::MeasuredError;
use super::shape::{RawComponent, RawMode};
use super::stated::StatedMode;
use crate::study::Sensor;

/// What a column holds.
enum Column {
    Number,
    Frequency,
    FrequencyStd,
    Damping,
    DampingStd,
    /// Which of the model's modes it is.
    ModelMode,
    /// Of a computed shape.
    ModalMass,
    /// Of later use, or of other tools: what identify prints beside.
    Ignored,
    Component(usize),
    ComponentStd(usize),
}

pub(super) fn modes(path: &Path, text: &str, sensors: &[Sensor]) -> Result<Vec<RawMode>, MeasuredError> {
    let mut reader = reader(text);
    let header = reader.headers().map_err(|error| syntax(path, &error))?.clone();
    let columns = header.iter().map(|name| column(path, name, sensors)).collect::<Result<Vec<_>, _>>()?;
    if !columns.iter().any(|column| matches!(column, Column::Frequency)) {
        let reason = "the column `frequency_hz` is missing; expected mode,frequency_hz,frequency_std_hz,damping_ratio and a column a channel";
        return Err(MeasuredError::Syntax { file: path.to_owned(), line: 1, reason: reason.to_owned() });
    }
    let mut modes: Vec<RawMode> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| syntax(path, &error))?;
        let row = Row { path, header: &header, line: record.position().map_or(0, csv::Position::line) };
        let mode = row.mode(&record, &columns, modes.len() + 1)?;
        if let Some(stated) = &mode.stated {
            let same = |other: &&RawMode| other.stated.as_ref().is_some_and(|other| other.number == stated.number);
            if let Some(other) = modes.iter().find(same) {
                let (file, line, number) = (path.to_owned(), stated.line, stated.number);
                return Err(MeasuredError::SameModelMode { file, line, number, other: other.number });
            }
        }
        modes.push(mode);
    }
    Ok(modes)
}

/// The columns that are not of the mode as a whole: the places of shapes that a program computed.
///
/// # Errors
/// [`MeasuredError::Syntax`] where there is no header.
pub(super) fn places(path: &Path, text: &str) -> Result<Vec<String>, MeasuredError> {
    let mut reader = reader(text);
    let header = reader.headers().map_err(|error| syntax(path, &error))?;
    Ok(header.iter().filter(|name| of_the_mode(name).is_none()).map(str::to_owned).collect())
}

/// What a column of this name holds of the mode as a whole.
fn of_the_mode(name: &str) -> Option<Column> {
    Some(match name {
        "mode" | "number" => Column::Number,
        "frequency_hz" | "measured_hz" => Column::Frequency,
        "frequency_std_hz" => Column::FrequencyStd,
        "damping_ratio" => Column::Damping,
        "damping_ratio_std" => Column::DampingStd,
        "model_mode" => Column::ModelMode,
        "modal_mass" | "modal_mass_kg" => Column::ModalMass,
        "phase_collinearity" | "type" => Column::Ignored,
        _ => return None,
    })
}

fn column(path: &Path, name: &str, sensors: &[Sensor]) -> Result<Column, MeasuredError> {
    Ok(match of_the_mode(name) {
        Some(column) => column,
        None => match (sensor_named(sensors, name), name.strip_suffix("_std")) {
            (Some(sensor), _) => Column::Component(sensor),
            (None, Some(channel)) if sensor_named(sensors, channel).is_some() => {
                Column::ComponentStd(sensor_named(sensors, channel).unwrap_or_default())
            }
            _ => {
                return Err(MeasuredError::UnknownChannel {
                    file: path.to_owned(),
                    channel: name.to_owned(),
                    known: known_channels(sensors),
                });
            }
        },
    })
}

fn reader(text: &str) -> csv::Reader<&[u8]> {
    csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(text.as_bytes())
}

fn syntax(path: &Path, error: &csv::Error) -> MeasuredError {
    MeasuredError::Syntax {
        file: path.to_owned(),
        line: error.position().map_or(1, csv::Position::line),
        reason: format!("not a CSV row like its header ({error})"),
    }
}

struct Row<'a> {
    path: &'a Path,
    header: &'a csv::StringRecord,
    line: u64,
}

impl Row<'_> {
    fn mode(&self, record: &csv::StringRecord, columns: &[Column], number: usize) -> Result<RawMode, MeasuredError> {
        let mut mode = RawMode {
            scatter: None,
            number,
            frequency_hz: f64::NAN,
            frequency_std_hz: None,
            damping_ratio: None,
            damping_ratio_std: None,
            stated: None,
            modal_mass: None,
            components: Vec::new(),
        };
        let mut stds = Vec::new();
        for (index, column) in columns.iter().enumerate() {
            let cell = record.get(index).unwrap_or("");
            match column {
                Column::Number => {
                    mode.number = cell.parse().map_err(|_| self.value(index, cell, "the mode's number"))?;
                }
                Column::Frequency => {
                    let expected = "a frequency in Hz, above 0,";
                    let frequency = self.number(index, cell, expected)?;
                    mode.frequency_hz =
                        frequency.filter(|f| *f > 0.0).ok_or_else(|| self.value(index, cell, expected))?;
                }
                Column::FrequencyStd => mode.frequency_std_hz = self.number(index, cell, "a standard deviation")?,
                Column::Damping => mode.damping_ratio = self.number(index, cell, "a damping ratio")?,
                Column::DampingStd => mode.damping_ratio_std = self.number(index, cell, "a standard deviation")?,
                Column::ModelMode if cell.is_empty() => {}
                Column::ModelMode => {
                    let number = cell.parse().ok().filter(|number| *number > 0);
                    let number =
                        number.ok_or_else(|| self.value(index, cell, "the number of a mode of the model, from 1,"))?;
                    mode.stated = Some(StatedMode::new(number, self.line));
                }
                Column::ModalMass => {
                    let expected = "a modal mass in kg, above 0,";
                    let mass = self.number(index, cell, expected)?;
                    if mass.is_some_and(|mass| mass <= 0.0) {
                        return Err(self.value(index, cell, expected));
                    }
                    mode.modal_mass = mass;
                }
                Column::Ignored => {}
                Column::Component(sensor) => {
                    let value = self.component(index, cell)?;
                    mode.components.push(RawComponent { sensor: *sensor, value, std: None, scatter: Vec::new() });
                }
                Column::ComponentStd(sensor) => {
                    stds.push((*sensor, self.number(index, cell, "a standard deviation")?));
                }
            }
        }
        for component in &mut mode.components {
            component.std = stds.iter().find(|(sensor, _)| *sensor == component.sensor).and_then(|(_, std)| *std);
        }
        Ok(mode)
    }

    /// A finite number; `None` for an empty cell or NaN.
    fn number(&self, index: usize, cell: &str, expected: &'static str) -> Result<Option<f64>, MeasuredError> {
        if cell.is_empty() {
            return Ok(None);
        }
        match cell.parse::<f64>() {
            Ok(number) if number.is_nan() => Ok(None),
            Ok(number) if number.is_finite() => Ok(Some(number)),
            _ => Err(self.value(index, cell, expected)),
        }
    }

    fn component(&self, index: usize, cell: &str) -> Result<Complex64, MeasuredError> {
        if cell.is_empty() {
            return Ok(Complex64::new(f64::NAN, 0.0));
        }
        let expected = "a number, or a complex one such as 0.5-0.1i,";
        let with_i = cell.replace('j', "i");
        let number = cell.parse::<f64>().map(Complex64::from).or_else(|_| with_i.parse::<Complex64>());
        number.ok().filter(|number| !number.is_infinite()).ok_or_else(|| self.value(index, cell, expected))
    }

    fn value(&self, index: usize, value: &str, expected: &'static str) -> MeasuredError {
        MeasuredError::Value {
            file: self.path.to_owned(),
            line: self.line,
            column: self.header.get(index).unwrap_or("").to_owned(),
            value: value.to_owned(),
            expected,
        }
    }
}
