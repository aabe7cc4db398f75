//! A table written row by row, as Parquet or as CSV: columns of text, whole numbers and numbers that may be missing.

use std::path::{Path, PathBuf};

use super::ExportError;
use super::parquet::{Cell, Kind, ParquetTable};
use super::table::{csv_writer, known};
use crate::files::WholeFile;

/// What a table is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableFormat {
    /// Apache Parquet.
    Parquet,
    /// Text with commas between cells, and a header.
    Csv,
}

/// A file that appears when it is finished; dropped before that, it leaves nothing behind.
pub(super) enum RowsFile {
    Parquet(Box<ParquetTable>),
    Csv { path: PathBuf, writer: Box<csv::Writer<WholeFile>>, rows: u64 },
}

impl RowsFile {
    /// A file of the given columns.
    pub(super) fn create(path: &Path, columns: &[(&str, Kind)], format: TableFormat) -> Result<Self, ExportError> {
        if format == TableFormat::Parquet {
            return Ok(Self::Parquet(Box::new(ParquetTable::create(path, columns)?)));
        }
        let mut writer = Box::new(csv_writer(path)?);
        let header = columns.iter().map(|(name, _)| name);
        writer.write_record(header).map_err(|error| ExportError::write(path)(error.into()))?;
        Ok(Self::Csv { path: path.to_owned(), writer, rows: 0 })
    }

    /// Appends a row, whose cells are of the columns' kinds, in their order.
    pub(super) fn push(&mut self, row: &[Cell<'_>]) -> Result<(), ExportError> {
        match self {
            Self::Parquet(table) => table.push(row),
            Self::Csv { path, writer, rows } => {
                *rows += 1;
                let cells = row.iter().map(|cell| match cell {
                    Cell::Text(text) => text.text().into_owned(),
                    Cell::Whole(number) => number.to_string(),
                    Cell::Number(number) => known(*number),
                });
                writer.write_record(cells).map_err(|error| ExportError::write(path)(error.into()))
            }
        }
    }

    /// Makes the file whole, and returns its rows.
    pub(super) fn finish(self) -> Result<u64, ExportError> {
        match self {
            Self::Parquet(table) => table.finish(),
            Self::Csv { path, writer, rows } => {
                let file = writer.into_inner().map_err(|error| ExportError::write(&path)(error.into_error()))?;
                file.finish().map_err(ExportError::write(&path))?;
                Ok(rows)
            }
        }
    }
}
