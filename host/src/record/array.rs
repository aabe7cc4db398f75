//! Arrays of binary numbers, in a file or in memory, read row by row: what NPY, MATLAB and HDF5 files have in common.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::PathBuf;

use nalgebra::DMatrix;

use super::columns::Selection;
use super::error::{FilePosition, RecordError};
use super::row_reader::{Progress, RowReader, Rows};

/// More bytes than this are not kept in memory: what is inflated or put together goes into a file without a name.
pub(super) const MOST_IN_MEMORY: u64 = 1 << 26;

/// How a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sample {
    I8,
    U8,
    I16,
    U16,
    I24,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Sample {
    /// Size of a number in bytes.
    pub(super) fn bytes(self) -> usize {
        match self {
            Sample::I8 | Sample::U8 => 1,
            Sample::I16 | Sample::U16 => 2,
            Sample::I24 => 3,
            Sample::I32 | Sample::U32 | Sample::F32 => 4,
            Sample::I64 | Sample::U64 | Sample::F64 => 8,
        }
    }

    /// Decodes little-endian numbers to where `placement` wants them.
    pub(super) fn decode(self, raw: &[u8], placement: Placement<'_>) {
        match self {
            Sample::I8 => placement.fill(raw, |bytes| f64::from(i8::from_le_bytes(bytes))),
            Sample::U8 => placement.fill(raw, |bytes| f64::from(u8::from_le_bytes(bytes))),
            Sample::I16 => placement.fill(raw, |bytes| f64::from(i16::from_le_bytes(bytes))),
            Sample::U16 => placement.fill(raw, |bytes| f64::from(u16::from_le_bytes(bytes))),
            Sample::I24 => {
                placement.fill(raw, |[low, middle, high]| f64::from(i32::from_le_bytes([0, low, middle, high]) >> 8))
            }
            Sample::I32 => placement.fill(raw, |bytes| f64::from(i32::from_le_bytes(bytes))),
            Sample::U32 => placement.fill(raw, |bytes| f64::from(u32::from_le_bytes(bytes))),
            Sample::I64 => placement.fill(raw, |bytes| i64::from_le_bytes(bytes) as f64),
            Sample::U64 => placement.fill(raw, |bytes| u64::from_le_bytes(bytes) as f64),
            Sample::F32 => placement.fill(raw, |bytes| f64::from(f32::from_le_bytes(bytes))),
            Sample::F64 => placement.fill(raw, f64::from_le_bytes),
        }
    }

    /// Decodes a whole array of numbers; what is left of `raw` after the last whole number is passed over.
    pub(super) fn decode_all(self, raw: &mut [u8], big_endian: bool) -> Vec<f64> {
        if big_endian {
            self.swap(raw);
        }
        let mut values = vec![0.0; raw.len() / self.bytes()];
        self.decode(raw, Placement::Column { values: &mut values, start: 0, stride: 1, factor: 1.0 });
        values
    }

    /// Turns big-endian numbers into little-endian ones.
    pub(super) fn swap(self, raw: &mut [u8]) {
        raw.chunks_exact_mut(self.bytes()).for_each(<[u8]>::reverse);
    }
}

/// A whole number without a sign, of eight bytes at most.
pub(super) fn whole_number(bytes: &[u8], big_endian: bool) -> u64 {
    let add = |number: u64, byte: &u8| (number << 8) | u64::from(*byte);
    if big_endian { bytes.iter().fold(0, add) } else { bytes.iter().rev().fold(0, add) }
}

/// Where decoded numbers go in a block's row-major values.
pub(super) enum Placement<'a> {
    /// `raw` holds whole rows of `width` numbers, of which the selected columns are taken.
    Rows { values: &'a mut [f64], width: usize, selection: &'a Selection },
    /// `raw` holds one channel, which goes to every `stride`-th value from `start` on.
    Column { values: &'a mut [f64], start: usize, stride: usize, factor: f64 },
}

impl Placement<'_> {
    fn fill<const N: usize>(self, raw: &[u8], decode: impl Fn([u8; N]) -> f64) {
        let (numbers, _) = raw.as_chunks::<N>();
        match self {
            Placement::Rows { values, width, selection } => {
                let channels = selection.columns.len().max(1);
                let rows = numbers.chunks_exact(width.max(1)).zip(values.chunks_exact_mut(channels));
                if selection.columns.iter().copied().eq(0..width) {
                    for (numbers, values) in rows {
                        for ((value, number), factor) in values.iter_mut().zip(numbers).zip(&selection.factors) {
                            *value = decode(*number) * factor;
                        }
                    }
                    return;
                }
                for (numbers, values) in rows {
                    let channels = selection.columns.iter().zip(&selection.factors);
                    for (value, (column, factor)) in values.iter_mut().zip(channels) {
                        *value = numbers.get(*column).map_or(f64::NAN, |number| decode(*number) * factor);
                    }
                }
            }
            Placement::Column { values, start, stride, factor } => {
                let values = values.iter_mut().skip(start).step_by(stride.max(1));
                for (value, number) in values.zip(numbers) {
                    *value = decode(*number) * factor;
                }
            }
        }
    }
}

/// Where an array's bytes are.
#[derive(Debug)]
pub(super) enum Source {
    File(File),
    Memory(Vec<u8>),
}

impl Source {
    /// Fills `raw` from `offset` on.
    pub(super) fn fetch(&mut self, offset: u64, raw: &mut [u8]) -> io::Result<()> {
        match self {
            Source::File(file) => {
                file.seek(SeekFrom::Start(offset))?;
                file.read_exact(raw)
            }
            Source::Memory(bytes) => {
                let start = usize::try_from(offset).unwrap_or(usize::MAX).min(bytes.len());
                bytes.get(start..).unwrap_or_default().read_exact(raw)
            }
        }
    }
}

/// How an array of `rows × columns` lies in its source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// Byte at which the first number stands.
    pub(super) offset: u64,
    pub(super) sample: Sample,
    pub(super) big_endian: bool,
    /// Samples in time.
    pub(super) rows: u64,
    /// Columns of the file.
    pub(super) columns: usize,
    /// Whether the numbers of one row stand together, or else those of one column.
    pub(super) row_by_row: bool,
}

impl Layout {
    /// Bytes of all numbers; `None` where no file could be so large.
    pub(super) fn bytes(&self) -> Option<u64> {
        self.rows.checked_mul(self.columns as u64)?.checked_mul(self.sample.bytes() as u64)
    }
}

/// Reads an array row by row, in blocks.
#[derive(Debug)]
pub(super) struct ArrayReader {
    path: PathBuf,
    source: Source,
    layout: Layout,
    progress: Progress,
    raw: Vec<u8>,
}

impl ArrayReader {
    /// A reader of an array in `source`, which was read from the file `path`.
    pub(super) fn new(path: PathBuf, source: Source, layout: Layout) -> Self {
        Self { path, source, progress: Progress::new(layout.rows), layout, raw: Vec::new() }
    }

    pub(super) fn rows(&self) -> u64 {
        self.layout.rows
    }

    pub(super) fn columns(&self) -> usize {
        self.layout.columns
    }

    /// Reads all numbers at once.
    pub(super) fn read_matrix(mut self) -> Result<DMatrix<f64>, RecordError> {
        let Layout { rows, columns, sample, row_by_row, .. } = self.layout;
        let rows = usize::try_from(rows).unwrap_or(usize::MAX);
        self.fetch(0, rows.saturating_mul(columns))?;
        let values = sample.decode_all(&mut self.raw, false);
        Ok(if row_by_row {
            DMatrix::from_row_slice(rows, columns, &values)
        } else {
            DMatrix::from_vec(rows, columns, values)
        })
    }

    /// Fetches `count` numbers from the `first` on, little-endian, into `raw`.
    fn fetch(&mut self, first: u64, count: usize) -> Result<(), RecordError> {
        let size = self.layout.sample.bytes();
        self.raw.resize(count * size, 0);
        let offset = self.layout.offset + first * size as u64;
        self.source.fetch(offset, &mut self.raw).map_err(RecordError::io(&self.path))?;
        if self.layout.big_endian {
            self.layout.sample.swap(&mut self.raw);
        }
        Ok(())
    }
}

impl RowReader for ArrayReader {
    fn read(&mut self, most: usize, rows: &mut Rows<'_>) -> Result<usize, RecordError> {
        let Layout { columns, sample, .. } = self.layout;
        let (first, count, selection) = (self.progress.next, self.progress.upcoming(most), rows.selection);
        let values = rows.grow(count);
        if self.layout.row_by_row {
            self.fetch(first * columns as u64, count * columns)?;
            sample.decode(&self.raw, Placement::Rows { values, width: columns, selection });
        } else {
            let stride = selection.columns.len();
            for (channel, (column, factor)) in selection.columns.iter().zip(&selection.factors).enumerate() {
                self.fetch(*column as u64 * self.layout.rows + first, count)?;
                sample.decode(&self.raw, Placement::Column { values, start: channel, stride, factor: *factor });
            }
        }
        self.progress.advance(count);
        Ok(count)
    }

    fn position(&self, row: usize) -> FilePosition {
        self.progress.position(&self.path, row)
    }
}
