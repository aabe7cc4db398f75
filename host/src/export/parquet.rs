//! A Parquet file written row by row: a few columns of text, whole numbers and numbers that may be missing.

use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as PhysicalType};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::ExportError;
use crate::files::WholeFile;

/// Rows kept until they are written together: a few megabytes.
const ROWS_IN_GROUP: usize = 1 << 16;

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Text,
    Whole,
    Number,
}

/// Text of a cell, shared by all rows that have it.
#[derive(Debug, Clone)]
pub(super) struct Text(ByteArray);

impl Text {
    pub(super) fn new(text: &str) -> Self {
        Self(ByteArray::from(text))
    }

    /// The text.
    pub(super) fn text(&self) -> Cow<'_, str> {
        String::from_utf8_lossy(self.0.data())
    }
}

/// A cell of a row.
#[derive(Debug, Clone, Copy)]
pub(super) enum Cell<'a> {
    Text(&'a Text),
    Whole(i64),
    Number(Option<f64>),
}

/// The cells of a column that are not written yet.
enum Column {
    Text(Vec<ByteArray>),
    Whole(Vec<i64>),
    /// Numbers that are there, and for each row whether one is (1) or not (0).
    Number(Vec<f64>, Vec<i16>),
}

/// A file that appears when it is finished; dropped before that, it leaves nothing behind.
pub(super) struct ParquetTable {
    path: PathBuf,
    writer: SerializedFileWriter<WholeFile>,
    columns: Vec<Column>,
    waiting: usize,
    rows: u64,
}

impl ParquetTable {
    /// A file of the given columns.
    pub(super) fn create(path: &Path, columns: &[(&str, Kind)]) -> Result<Self, ExportError> {
        let file = WholeFile::create(path).map_err(ExportError::write(path))?;
        let schema = schema(columns).map_err(|error| failed(path, error))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by(concat!("belfry version ", env!("CARGO_PKG_VERSION")).to_owned())
            .build();
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))
            .map_err(|error| failed(path, error))?;
        let columns = columns
            .iter()
            .map(|(_, kind)| match kind {
                Kind::Text => Column::Text(Vec::new()),
                Kind::Whole => Column::Whole(Vec::new()),
                Kind::Number => Column::Number(Vec::new(), Vec::new()),
            })
            .collect();
        Ok(Self { path: path.to_owned(), writer, columns, waiting: 0, rows: 0 })
    }

    /// Appends a row, whose cells are of the columns' kinds, in their order.
    pub(super) fn push(&mut self, row: &[Cell<'_>]) -> Result<(), ExportError> {
        for (column, cell) in self.columns.iter_mut().zip(row) {
            match (column, cell) {
                (Column::Text(column), Cell::Text(text)) => column.push(text.0.clone()),
                (Column::Whole(column), Cell::Whole(number)) => column.push(*number),
                (Column::Number(column, levels), Cell::Number(number)) => {
                    column.extend(number);
                    levels.push(i16::from(number.is_some()));
                }
                // The writer then finds columns of differing length and refuses the group.
                _ => {}
            }
        }
        self.waiting += 1;
        self.rows += 1;
        if self.waiting < ROWS_IN_GROUP { Ok(()) } else { self.write_group() }
    }

    /// Writes what waits, makes the file whole, and returns its rows.
    pub(super) fn finish(mut self) -> Result<u64, ExportError> {
        if self.waiting > 0 {
            self.write_group()?;
        }
        let file = self.writer.into_inner().map_err(|error| failed(&self.path, error))?;
        file.finish().map_err(ExportError::write(&self.path))?;
        Ok(self.rows)
    }

    fn write_group(&mut self) -> Result<(), ExportError> {
        self.waiting = 0;
        let Self { path, writer, columns, .. } = self;
        write_group(writer, columns).map_err(|error| failed(path, error))
    }
}

fn write_group(writer: &mut SerializedFileWriter<WholeFile>, columns: &mut [Column]) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    for column in columns {
        let Some(mut chunk) = group.next_column()? else { break };
        match (chunk.untyped(), column) {
            (ColumnWriter::ByteArrayColumnWriter(writer), Column::Text(values)) => {
                writer.write_batch(values, None, None)?;
                values.clear();
            }
            (ColumnWriter::Int64ColumnWriter(writer), Column::Whole(values)) => {
                writer.write_batch(values, None, None)?;
                values.clear();
            }
            (ColumnWriter::DoubleColumnWriter(writer), Column::Number(values, levels)) => {
                writer.write_batch(values, Some(levels), None)?;
                values.clear();
                levels.clear();
            }
            _ => return Err(ParquetError::General("a column is of another type than its cells".to_owned())),
        }
        chunk.close()?;
    }
    group.close()?;
    Ok(())
}

fn schema(columns: &[(&str, Kind)]) -> Result<Type, ParquetError> {
    let fields = columns.iter().map(|(name, kind)| {
        let (physical, logical, repetition) = match kind {
            Kind::Text => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String), Repetition::REQUIRED),
            Kind::Whole => (PhysicalType::INT64, None, Repetition::REQUIRED),
            Kind::Number => (PhysicalType::DOUBLE, None, Repetition::OPTIONAL),
        };
        let field = Type::primitive_type_builder(name, physical);
        Ok(Arc::new(field.with_logical_type(logical).with_repetition(repetition).build()?))
    });
    Type::group_type_builder("schema").with_fields(fields.collect::<Result<_, ParquetError>>()?).build()
}

fn failed(path: &Path, error: ParquetError) -> ExportError {
    let source = match error {
        ParquetError::External(error) => io::Error::other(error),
        error => io::Error::other(error),
    };
    ExportError::Write { file: path.to_owned(), source }
}
