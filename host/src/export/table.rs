//! Modes as a CSV table: a row a mode, a column a channel and one with its standard deviation.

use std::collections::BTreeSet;
use std::path::Path;

use num_complex::Complex64;

use super::ExportError;
use super::modes::{Component, Modes};
use crate::files::WholeFile;

const COLUMNS: [&str; 6] =
    ["mode", "frequency_hz", "frequency_std_hz", "damping_ratio", "damping_ratio_std", "phase_collinearity"];

/// Writes the table. Numbers are written so that reading gives the same doubles; what is not known is an empty cell.
///
/// # Errors
/// Where a channel's name would make two columns of one name, or the file cannot be written.
pub fn write_csv(path: &Path, modes: &Modes) -> Result<(), ExportError> {
    let mut header: Vec<String> = COLUMNS.iter().map(ToString::to_string).collect();
    let mut taken: BTreeSet<String> = header.iter().cloned().collect();
    let measured: Vec<usize> = (0..modes.sensors.len()).filter(|sensor| modes.is_measured(*sensor)).collect();
    for sensor in &measured {
        let channel = modes.sensors.get(*sensor).map_or("", |sensor| sensor.channel.as_str());
        for column in [channel.to_owned(), format!("{channel}_std")] {
            if !taken.insert(column.clone()) {
                return Err(ExportError::ColumnTwice { channel: channel.to_owned(), column });
            }
            header.push(column);
        }
    }
    let mut rows = vec![header];
    for mode in &modes.modes {
        let mut row = vec![mode.number.to_string(), mode.frequency_hz.to_string()];
        let rest = [mode.frequency_std_hz, mode.damping_ratio, mode.damping_ratio_std, mode.phase_collinearity];
        row.extend(rest.map(known));
        for sensor in &measured {
            let component = mode.shape.get(*sensor).copied().flatten();
            row.push(component.map_or_else(String::new, |Component { value, .. }| complex(value)));
            row.push(known(component.and_then(|component| component.std)));
        }
        rows.push(row);
    }
    write_rows(path, &rows)
}

/// Writes rows of cells as CSV, quoted where they must be; a # too, as readers may take it for a comment.
pub(super) fn write_rows(path: &Path, rows: &[Vec<String>]) -> Result<(), ExportError> {
    let fail = |error: csv::Error| ExportError::write(path)(error.into());
    let file = WholeFile::create(path).map_err(ExportError::write(path))?;
    let mut csv = csv::WriterBuilder::new().comment(Some(b'#')).from_writer(file);
    rows.iter().try_for_each(|row| csv.write_record(row)).map_err(fail)?;
    let file = csv.into_inner().map_err(|error| ExportError::write(path)(error.into_error()))?;
    file.finish().map_err(ExportError::write(path))
}

pub(super) fn known(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

fn complex(value: Complex64) -> String {
    if value.im == 0.0 { value.re.to_string() } else { format!("{}{:+}i", value.re, value.im) }
}
