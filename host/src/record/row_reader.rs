//! What the readers of all formats have in common: the trait, where their rows go, and how far they are.
//!
//! A block's values, the wanted channels and the clock flow in as [`Rows`]; a reader appends rows to them and can say where in
//! its file each one stands.

use std::path::Path;

use super::clock::Clock;
use super::columns::Selection;
use super::error::{At, FilePosition, RecordError};

/// Reads one file from its first row to its last.
pub(super) trait RowReader: std::fmt::Debug + Send {
    /// Appends up to `most` rows, NaN where a sample is missing, and returns how many; 0 at the end of the file.
    fn read(&mut self, most: usize, rows: &mut Rows<'_>) -> Result<usize, RecordError>;

    /// By how many rows the samples of each column are later than the rows that they become; empty where that is not known.
    fn late_rows(&self) -> &[f64] {
        &[]
    }

    /// Where a row of the last read stands (from 0 within that read).
    fn position(&self, row: usize) -> FilePosition;
}

/// Where rows go: the wanted channels of each, in SI units, behind those that are there.
pub(super) struct Rows<'a> {
    /// The wanted channels.
    pub(super) selection: &'a Selection,
    /// Follows the time column, in formats that have one.
    pub(super) clock: &'a mut Clock,
    /// Row after row.
    pub(super) values: &'a mut Vec<f64>,
}

impl Rows<'_> {
    /// Appends a row that is missing from the file.
    pub(super) fn push_missing(&mut self) {
        self.values.extend(self.selection.columns.iter().map(|_| f64::NAN));
    }

    /// Appends so many rows of zeros and hands them out to be filled.
    pub(super) fn grow(&mut self, rows: usize) -> &mut [f64] {
        let start = self.values.len();
        self.values.resize(start + rows * self.selection.columns.len(), 0.0);
        self.values.get_mut(start..).unwrap_or_default()
    }
}

/// How far a file with a known number of rows is read.
#[derive(Debug)]
pub(super) struct Progress {
    /// Rows of the file.
    pub(super) rows: u64,
    /// The next row to read, from 0.
    pub(super) next: u64,
    /// The first row of the last read.
    last_read: u64,
}

impl Progress {
    pub(super) fn new(rows: u64) -> Self {
        Self { rows, next: 0, last_read: 0 }
    }

    /// How many rows the next read takes, `most` at most.
    pub(super) fn upcoming(&self, most: usize) -> usize {
        usize::try_from(self.rows - self.next).unwrap_or(usize::MAX).min(most)
    }

    /// Notes that `rows` more are read.
    pub(super) fn advance(&mut self, rows: usize) {
        self.last_read = self.next;
        self.next += rows as u64;
    }

    /// A row of the last read among those of the file, from 0.
    pub(super) fn row(&self, row: usize) -> u64 {
        self.last_read + row as u64
    }

    /// Where a row of the last read stands.
    pub(super) fn position(&self, file: &Path, row: usize) -> FilePosition {
        FilePosition { file: file.to_owned(), at: At::Row(self.row(row) + 1) }
    }
}
