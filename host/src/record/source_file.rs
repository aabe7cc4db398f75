//! A setup's file, its format known by its ending: the choice among the readers.
//!
//! Paths flow in; the file's columns, its number of rows, or a reader that starts at its first row flow out.

use std::path::{Path, PathBuf};

use super::array::ArrayReader;
use super::clock::Clock;
use super::columns::Columns;
use super::error::RecordError;
use super::parquet::ParquetReader;
use super::row_reader::RowReader;
use super::text::TextReader;
use super::uff::UffReader;
use super::{mat, npy};
use crate::study::Setup;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    WhiteSpace,
    Csv,
    Npy,
    Mat,
    Parquet,
    Uff,
}

/// One of a setup's files, its format known by its ending.
#[derive(Debug, Clone)]
pub(super) struct SourceFile {
    pub(super) path: PathBuf,
    format: Format,
}

impl SourceFile {
    pub(super) fn new(path: PathBuf) -> Result<Self, RecordError> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let format = match ending.as_deref() {
            Some("txt" | "asc" | "dat") => Format::WhiteSpace,
            Some("csv") => Format::Csv,
            Some("npy") => Format::Npy,
            Some("mat") => Format::Mat,
            Some("parquet") => Format::Parquet,
            Some("uff" | "unv") => Format::Uff,
            _ => return Err(RecordError::UnknownEnding { file: path }),
        };
        Ok(Self { path, format })
    }

    /// The file's columns; finds what its first bytes or its size show to be wrong.
    pub(super) fn inspect(&self, setup: &Setup) -> Result<Columns, RecordError> {
        match self.format {
            Format::WhiteSpace => TextReader::open_white_space(&self.path)?.inspect(setup.sampling_rate_hz),
            Format::Csv => TextReader::open_csv(&self.path, &setup.sensors)?.inspect(setup.sampling_rate_hz),
            Format::Npy => Ok(Columns::Numbered(npy::open(&self.path)?.columns())),
            Format::Mat => Ok(Columns::Numbered(mat::recording_shape(&self.path, setup.variable.as_deref())?.columns)),
            Format::Parquet => ParquetReader::open(&self.path, &setup.sensors)?.inspect(setup.sampling_rate_hz),
            Format::Uff => Ok(UffReader::open(&self.path, setup)?.columns()),
        }
    }

    pub(super) fn open(&self, setup: &Setup) -> Result<Box<dyn RowReader>, RecordError> {
        Ok(match self.format {
            Format::WhiteSpace => Box::new(TextReader::open_white_space(&self.path)?),
            Format::Csv => Box::new(TextReader::open_csv(&self.path, &setup.sensors)?),
            Format::Npy => Box::new(npy::open(&self.path)?),
            Format::Mat => Box::new(self.open_mat(setup)?),
            Format::Parquet => Box::new(ParquetReader::open(&self.path, &setup.sensors)?),
            Format::Uff => Box::new(UffReader::open(&self.path, setup)?),
        })
    }

    fn open_mat(&self, setup: &Setup) -> Result<ArrayReader, RecordError> {
        Ok(mat::open_recording(&self.path, setup.variable.as_deref())?)
    }

    /// Exact number of rows, those included that the time column says are missing.
    pub(super) fn count_rows(&self, setup: &Setup, clock: &mut Clock) -> Result<u64, RecordError> {
        match self.format {
            Format::WhiteSpace => TextReader::open_white_space(&self.path)?.count_rows(clock),
            Format::Csv => TextReader::open_csv(&self.path, &setup.sensors)?.count_rows(clock),
            Format::Npy => Ok(npy::open(&self.path)?.rows()),
            Format::Mat => Ok(mat::recording_shape(&self.path, setup.variable.as_deref())?.rows),
            Format::Parquet => ParquetReader::open(&self.path, &setup.sensors)?.count_rows(clock),
            Format::Uff => Ok(UffReader::open(&self.path, setup)?.rows()),
        }
    }
}

/// Checks that no two files differ in their columns and returns those of the first.
pub(super) fn common_columns(files: &[SourceFile], setup: &Setup) -> Result<Option<Columns>, RecordError> {
    let mut first: Option<(&Path, Columns)> = None;
    for file in files {
        let columns = file.inspect(setup)?;
        match &first {
            None => first = Some((&file.path, columns)),
            Some((_, expected)) if *expected == columns => {}
            Some((first_file, expected)) => {
                return Err(RecordError::OtherColumns {
                    file: file.path.clone(),
                    found: columns.to_string(),
                    first_file: (*first_file).to_owned(),
                    expected: expected.to_string(),
                });
            }
        }
    }
    Ok(first.map(|(_, columns)| columns))
}
