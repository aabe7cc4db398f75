//! Parquet recordings: flat columns of numbers, named by the file's schema; a null is a missing sample.
//!
//! Row groups flow in, a batch of rows at a time and of them only the columns that are wanted; rows of the setup's channels
//! flow out. A time column is followed as in CSV; besides seconds as plain numbers it may hold timestamps.

mod chunks;
mod column;
mod footer;
mod guard;

use std::fmt;
use std::path::{Path, PathBuf};

use parquet::column::reader::ColumnReader;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::schema::types::ColumnDescriptor;

use super::clock::{Clock, check_rate};
use super::columns::{Columns, is_time_column};
use super::error::{At, FilePosition, RecordError};
use super::files::open_file;
use super::row_reader::{RowReader, Rows};
use crate::study::Sensor;
use chunks::Chunks;
use column::{Cells, Numbers, Scratch, is_local, is_timestamp};
use footer::announces_too_much;
use guard::guarded;

/// Rows read ahead to compare a time column with the sampling rate.
const ROWS_TO_CHECK: usize = 1024;
/// Rows decoded at once where only time is wanted.
const ROWS_TO_COUNT: usize = 4096;

/// The time column of a file.
#[derive(Debug, Clone)]
struct TimeColumn {
    column: usize,
    name: String,
    numbers: Numbers,
    /// It holds dates and times of day of no known zone.
    is_local: bool,
}

/// A row group being read: the wanted columns, then the time column.
struct OpenGroup {
    columns: Vec<(ColumnReader, Cells)>,
    time: Option<(ColumnReader, Cells)>,
    rows_left: usize,
}

/// Rows decoded and not yet handed out.
#[derive(Debug, Default)]
struct Batch {
    /// Row-major, as wide as there are wanted columns.
    values: Vec<f64>,
    times_s: Vec<f64>,
    rows: usize,
    next: usize,
}

/// Reads one Parquet file row by row.
pub(super) struct ParquetReader {
    path: PathBuf,
    file: SerializedFileReader<Chunks>,
    names: Vec<String>,
    time: Option<TimeColumn>,
    next_group: usize,
    group: Option<OpenGroup>,
    scratch: Scratch,
    batch: Batch,
    /// Rows of the file before the batch.
    rows_before: u64,
    /// Rows of NaN that stand before the row reached.
    missing_before: u64,
    /// The clock has seen the row reached.
    row_timed: bool,
    /// The file's row of each row handed out last.
    row_of: Vec<u64>,
}

impl fmt::Debug for ParquetReader {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("ParquetReader").field("path", &self.path).finish_non_exhaustive()
    }
}

impl ParquetReader {
    /// Opens a file and finds that the channels of `sensors` are numbers. A time column that no sensor claims is noted.
    pub(super) fn open(path: &Path, sensors: &[Sensor]) -> Result<Self, RecordError> {
        let (mut file, _) = open_file(path)?;
        if announces_too_much(&mut file).map_err(RecordError::io(path))? {
            return Err(RecordError::parquet(path, "its footer announces more than a footer holds"));
        }
        guarded(path, || {
            let file = SerializedFileReader::new(Chunks(file)).map_err(|error| RecordError::parquet(path, error))?;
            let descriptors = file.metadata().file_metadata().schema_descr().columns();
            let names: Vec<String> = descriptors.iter().map(|descriptor| descriptor.path().string()).collect();
            for (name, descriptor) in names.iter().zip(descriptors) {
                let wanted = sensors.iter().any(|sensor| sensor.channel.trim() == name);
                if wanted && !Numbers::of(descriptor).is_some_and(Numbers::is_sample) {
                    return Err(RecordError::ParquetType {
                        file: path.to_owned(),
                        channel: name.clone(),
                        found: type_name(descriptor),
                    });
                }
            }
            // Dates and times of day are no samples: the only such column has the times, whatever its name is.
            let mut dated = (0..).zip(descriptors).filter(|(_, descriptor)| is_timestamp(descriptor)).map(|(at, _)| at);
            let only_dated: Option<usize> = dated.next().filter(|_| dated.next().is_none());
            let named = names.iter().position(|name| is_time_column(name, sensors));
            let time = match named.or(only_dated) {
                Some(column) => Some(time_column(path, column, &names, descriptors.get(column).map(AsRef::as_ref))?),
                None => None,
            };
            Ok(Self {
                path: path.to_owned(),
                file,
                names,
                time,
                next_group: 0,
                group: None,
                scratch: Scratch::default(),
                batch: Batch::default(),
                rows_before: 0,
                missing_before: 0,
                row_timed: false,
                row_of: Vec::new(),
            })
        })
    }

    /// The file's columns, and whether its time column keeps `sampling_rate_hz`; consumes the first rows.
    pub(super) fn inspect(mut self, sampling_rate_hz: f64) -> Result<Columns, RecordError> {
        if self.rows_in_file()? == 0 {
            return Err(RecordError::Empty { file: self.path });
        }
        let columns = Columns::Named(self.names.clone());
        let Some(time) = self.time.clone() else { return Ok(columns) };
        let mut times_s = Vec::new();
        while times_s.len() < ROWS_TO_CHECK && self.next_batch(ROWS_TO_CHECK - times_s.len(), &[])? {
            for (row, time_s) in self.batch.times_s.iter().enumerate() {
                times_s.push(self.known_time_s(&time, *time_s, row)?);
            }
        }
        let resolution_s = time.numbers.resolution_s(&times_s);
        check_rate(&times_s, resolution_s, sampling_rate_hz, &time.name, &self.row_position(1))?;
        Ok(columns)
    }

    /// Exact number of rows that [`RowReader::read`] will give, filled rows included. At once without a time column;
    /// otherwise that column is read through, and it alone.
    pub(super) fn count_rows(mut self, clock: &mut Clock) -> Result<u64, RecordError> {
        let rows = self.rows_in_file()?;
        let Some(time) = self.time.clone() else { return Ok(rows) };
        clock.start_file();
        let mut missing = 0;
        while self.next_batch(ROWS_TO_COUNT, &[])? {
            for (row, time_s) in self.batch.times_s.iter().enumerate() {
                missing += self.time_row(&time, *time_s, row, clock)?;
            }
        }
        Ok(rows + missing)
    }

    /// The column of times.
    pub(super) fn time_name(&self) -> Option<&str> {
        self.time.as_ref().map(|time| time.name.as_str())
    }

    /// Whether its times are dates and times of day of no known zone.
    pub(super) fn has_local_times(&self) -> bool {
        self.time.as_ref().is_some_and(|time| time.is_local)
    }

    /// The time of the first row in s, where there is a column of times: since 1970 where it holds timestamps.
    pub(super) fn first_time_s(mut self) -> Result<Option<f64>, RecordError> {
        let Some(time) = self.time.clone() else { return Ok(None) };
        if !self.next_batch(1, &[])? {
            return Ok(None);
        }
        let first_s = self.batch.times_s.first().copied();
        first_s.map(|first_s| self.known_time_s(&time, first_s, 0)).transpose()
    }

    /// Rows by the file's metadata.
    fn rows_in_file(&self) -> Result<u64, RecordError> {
        let mut rows = self.file.metadata().row_groups().iter().map(|group| u64::try_from(group.num_rows()).ok());
        let total = rows.try_fold(0_u64, |total, rows| total.checked_add(rows?));
        total.ok_or_else(|| RecordError::parquet(&self.path, "a row group announces an impossible number of rows"))
    }

    /// Decodes the next rows, `rows` at most, of `columns` and of the time column; false at the end of the file.
    fn next_batch(&mut self, rows: usize, columns: &[usize]) -> Result<bool, RecordError> {
        self.rows_before += self.batch.rows as u64;
        self.batch.rows = 0;
        self.batch.next = 0;
        let path = self.path.clone();
        guarded(&path, || self.decode_batch(rows, columns))
    }

    fn decode_batch(&mut self, rows: usize, columns: &[usize]) -> Result<bool, RecordError> {
        let Self { path, names, scratch, batch, .. } = self;
        loop {
            let Some(group) = &mut self.group else {
                if self.next_group >= self.file.num_row_groups() {
                    return Ok(false);
                }
                let opened = self.file.get_row_group(self.next_group);
                let opened = opened.map_err(|error| RecordError::parquet(path, error))?;
                self.group = Some(open_group(path, opened.as_ref(), columns, self.time.as_ref())?);
                self.next_group += 1;
                continue;
            };
            let rows = rows.min(group.rows_left);
            if rows == 0 {
                self.group = None;
                continue;
            }
            let short = |column: usize, decoded: Result<usize, ParquetError>| {
                let name = names.get(column).map_or("", String::as_str);
                match decoded {
                    Ok(decoded) if decoded == rows => Ok(()),
                    Ok(_) => Err(RecordError::parquet(
                        path,
                        format!("column `{name}` ends within row group {}, before its last row", self.next_group),
                    )),
                    Err(error) => Err(RecordError::parquet(
                        path,
                        format!("row group {}, column `{name}`: {error}", self.next_group),
                    )),
                }
            };
            let width = group.columns.len();
            batch.values.resize(rows * width, 0.0);
            for (place, ((reader, cells), column)) in group.columns.iter_mut().zip(columns).enumerate() {
                let values = batch.values.iter_mut().skip(place).step_by(width);
                short(*column, cells.read(reader, rows, scratch, values))?;
            }
            if let (Some((reader, cells)), Some(time)) = (&mut group.time, &self.time) {
                batch.times_s.resize(rows, 0.0);
                short(time.column, cells.read(reader, rows, scratch, batch.times_s.iter_mut()))?;
            }
            group.rows_left -= rows;
            batch.rows = rows;
            return Ok(true);
        }
    }

    /// Lets the clock see a row of the batch and returns the rows missing before it.
    fn time_row(&self, time: &TimeColumn, time_s: f64, row: usize, clock: &mut Clock) -> Result<u64, RecordError> {
        let time_s = self.known_time_s(time, time_s, row)?;
        clock.advance(time_s, &time.name, &self.row_position(self.rows_before + row as u64 + 1))
    }

    fn known_time_s(&self, time: &TimeColumn, time_s: f64, row: usize) -> Result<f64, RecordError> {
        if time_s.is_finite() {
            return Ok(time_s);
        }
        let position = self.row_position(self.rows_before + row as u64 + 1);
        let text = if time_s.is_nan() { "null".to_owned() } else { time_s.to_string() };
        Err(RecordError::TimeNotSeconds { position, column: time.name.clone(), text })
    }

    fn row_position(&self, row: u64) -> FilePosition {
        FilePosition { file: self.path.clone(), at: At::Row(row) }
    }
}

impl RowReader for ParquetReader {
    fn read(&mut self, most: usize, rows: &mut Rows<'_>) -> Result<usize, RecordError> {
        self.row_of.clear();
        let time = self.time.clone();
        let selection = rows.selection;
        let width = selection.columns.len();
        while self.row_of.len() < most {
            if self.batch.next >= self.batch.rows && !self.next_batch(most, &selection.columns)? {
                break;
            }
            let row = self.batch.next;
            if let (Some(time), false) = (&time, self.row_timed) {
                let time_s = self.batch.times_s.get(row).copied().unwrap_or(f64::NAN);
                self.missing_before += self.time_row(time, time_s, row, rows.clock)?;
                self.row_timed = true;
            }
            if self.missing_before > 0 {
                self.missing_before -= 1;
                rows.push_missing();
            } else {
                let cells = self.batch.values.get(row * width..).unwrap_or_default();
                rows.values.extend(cells.iter().zip(&selection.factors).map(|(value, factor)| value * factor));
                self.batch.next += 1;
                self.row_timed = false;
            }
            self.row_of.push(self.rows_before + row as u64 + 1);
        }
        Ok(self.row_of.len())
    }

    fn position(&self, row: usize) -> FilePosition {
        self.row_position(self.row_of.get(row).copied().unwrap_or(self.rows_before))
    }
}

fn time_column(
    path: &Path,
    column: usize,
    names: &[String],
    descriptor: Option<&ColumnDescriptor>,
) -> Result<TimeColumn, RecordError> {
    let name = names.get(column).cloned().unwrap_or_default();
    match descriptor.and_then(Numbers::of) {
        Some(numbers) => Ok(TimeColumn { column, name, numbers, is_local: descriptor.is_some_and(is_local) }),
        None => Err(RecordError::TimeNotSeconds {
            position: FilePosition { file: path.to_owned(), at: At::Row(1) },
            column: name,
            text: descriptor.map_or_else(String::new, type_name),
        }),
    }
}

fn open_group(
    path: &Path,
    group: &dyn RowGroupReader,
    columns: &[usize],
    time: Option<&TimeColumn>,
) -> Result<OpenGroup, RecordError> {
    let open = |column: usize| {
        let descriptor = group.metadata().schema_descr().columns().get(column);
        let cells = descriptor.and_then(|descriptor| Some(Cells::new(Numbers::of(descriptor)?, descriptor)));
        // Names are checked against the schema before, so that only damage leads here.
        let cells = cells.ok_or_else(|| RecordError::parquet(path, "a row group lacks a column of the schema"))?;
        let reader = group.get_column_reader(column).map_err(|error| RecordError::parquet(path, error))?;
        Ok::<_, RecordError>((reader, cells))
    };
    Ok(OpenGroup {
        columns: columns.iter().map(|column| open(*column)).collect::<Result<_, _>>()?,
        time: time.map(|time| open(time.column)).transpose()?,
        rows_left: usize::try_from(group.metadata().num_rows())
            .map_err(|_| RecordError::parquet(path, "a row group announces an impossible number of rows"))?,
    })
}

/// A column's type as an error names it.
fn type_name(descriptor: &ColumnDescriptor) -> String {
    if is_timestamp(descriptor) {
        return "dates and times of day".to_owned();
    }
    let logical = descriptor.logical_type_ref().map(|logical| format!(" ({logical:?})")).unwrap_or_default();
    let several = if descriptor.max_rep_level() > 0 { "lists of " } else { "" };
    format!("{several}{}{logical}", descriptor.physical_type())
}
