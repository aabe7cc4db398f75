//! Modes as tables: as CSV a row a mode, a column a channel and one with its standard deviation; as Parquet a row a mode and channel.

use std::collections::BTreeSet;
use std::path::Path;

use num_complex::Complex64;

use super::ExportError;
use super::modes::{Component, Modes};
use super::parquet::{Cell, Kind, ParquetTable, Text};
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

/// Writes a table of a row a mode and channel as Parquet, and returns its rows. What is not known is missing.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_parquet(path: &Path, modes: &Modes) -> Result<u64, ExportError> {
    let numbers = [COLUMNS[1], COLUMNS[2], COLUMNS[3], COLUMNS[4], COLUMNS[5]].map(|name| (name, Kind::Number));
    let mut columns = vec![(COLUMNS[0], Kind::Whole)];
    columns.extend(numbers);
    columns.push(("channel", Kind::Text));
    columns.extend(["re", "im", "std"].map(|name| (name, Kind::Number)));
    let mut table = ParquetTable::create(path, &columns)?;
    let names: Vec<Text> = modes.sensors.iter().map(|sensor| Text::new(&sensor.channel)).collect();
    for mode in &modes.modes {
        let of_mode = [
            Some(mode.frequency_hz),
            mode.frequency_std_hz,
            mode.damping_ratio,
            mode.damping_ratio_std,
            mode.phase_collinearity,
        ];
        for (name, component) in names.iter().zip(&mode.shape) {
            let Some(Component { value, std }) = component else { continue };
            let mut cells = vec![Cell::Whole(mode.number as i64)];
            cells.extend(of_mode.map(Cell::Number));
            cells.push(Cell::Text(name));
            cells.extend([Some(value.re), Some(value.im), *std].map(Cell::Number));
            table.push(&cells)?;
        }
    }
    table.finish()
}

/// Writes rows of cells as CSV, quoted where they must be.
pub(super) fn write_rows(path: &Path, rows: &[Vec<String>]) -> Result<(), ExportError> {
    let fail = |error: csv::Error| ExportError::write(path)(error.into());
    let mut csv = csv_writer(path)?;
    rows.iter().try_for_each(|row| csv.write_record(row)).map_err(fail)?;
    let file = csv.into_inner().map_err(|error| ExportError::write(path)(error.into_error()))?;
    file.finish().map_err(ExportError::write(path))
}

/// A file that appears when it is finished. A # is quoted too, as readers may take it for a comment.
pub(super) fn csv_writer(path: &Path) -> Result<csv::Writer<WholeFile>, ExportError> {
    let file = WholeFile::create(path).map_err(ExportError::write(path))?;
    Ok(csv::WriterBuilder::new().comment(Some(b'#')).from_writer(file))
}

pub(super) fn known(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

fn complex(value: Complex64) -> String {
    if value.im == 0.0 { value.re.to_string() } else { format!("{}{:+}i", value.re, value.im) }
}
