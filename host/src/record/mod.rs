//! Recordings: what a setup's files hold, streamed in blocks, never read whole.
//!
//! Files flow in; rows in the study's channel order and in SI units flow out, with NaN where a sample is missing. The
//! format goes by a file's ending: white space (`.txt`, `.asc`, `.dat`), CSV (`.csv`), NumPy (`.npy`), MATLAB
//! (`.mat`), HDF5 (`.h5`, `.hdf5`), Parquet (`.parquet`), datasets 58 of a universal file (`.uff`, `.unv`), WAV (`.wav`),
//! SAC (`.sac`), miniSEED (`.mseed`), TDMS (`.tdms`). At the end a [`RecordReport`] says what
//! was missing, dead or unusual.

mod array;
mod block;
mod channels;
mod clock;
mod columns;
mod error;
mod files;
mod hdf5;
mod lines;
pub mod mat;
mod mseed;
mod npy;
mod number;
mod parquet;
mod report;
mod response_name;
mod row_reader;
mod sac;
mod source_file;
mod stamp;
mod steim;
pub mod survey;
mod tdms;
mod text;
mod traces;
mod uff;
mod warning;
mod wav;

#[cfg(test)]
mod tests;

use std::path::Path;

pub use block::Block;
pub(crate) use columns::si_factor;
pub(crate) use error::quoted;
pub use error::{At, FilePosition, MatError, RecordError};
pub(crate) use files::matching_files;
pub use hdf5::Hdf5Error;
pub(crate) use npy::{NpyArray, RowError, read_row};
pub use report::{ChannelReport, Gap, RecordReport};
pub(crate) use traces::utc;
pub(crate) use warning::time_of_day;
pub use warning::{Affected, RecordWarning};

use crate::study::Setup;
use clock::Clock;
use columns::Selection;
use report::Statistics;
use row_reader::{RowReader, Rows};
use source_file::{SourceFile, common_columns};

/// Values in a block: few enough to stay in the second-level cache while they are decoded and analysed.
const BLOCK_VALUES: usize = 1 << 15;
/// Rows in a block, whatever the number of channels.
const BLOCK_ROWS: std::ops::RangeInclusive<usize> = 64..=4096;

/// One setup's files as one stream in time, in m/s².
///
/// Numbers recorded in g or volts are converted. Those recorded as velocity ([`crate::study::Unit::MetrePerSecond`])
/// stay m/s: differentiating is a multiplication in the spectrum, and is left to what makes the spectra.
#[derive(Debug)]
pub struct Recording {
    setup: Setup,
    files: Vec<SourceFile>,
    selection: Selection,
    clock: Clock,
    next_file: usize,
    reader: Option<Box<dyn RowReader>>,
    statistics: Statistics,
    /// Rows read of the open file, where it is joined of blocks.
    rows_of_file: u64,
    /// Missing rows put in so far.
    put_in: u64,
}

/// Missing rows between the blocks that a file is joined of: more than are filled by straight lines.
const ROWS_BETWEEN_BLOCKS: usize = 4;

impl Recording {
    /// Opens the files of `setup`, whose patterns start at `folder`, and checks that they have its channels and
    /// agree with each other and with its sampling rate.
    ///
    /// # Errors
    /// What is wrong with the setup or can be seen without reading the files through: patterns that match nothing,
    /// unknown formats, missing channels, differing columns, empty or truncated files, the rate of a time column.
    pub fn open(setup: &Setup, folder: &Path) -> Result<Self, RecordError> {
        let sampling_rate_hz = setup.sampling_rate_hz;
        if setup.sensors.is_empty() {
            return Err(RecordError::NoSensors { setup: setup.name.clone() });
        }
        if !(sampling_rate_hz.is_normal() && sampling_rate_hz > 0.0) {
            return Err(RecordError::SamplingRate { setup: setup.name.clone(), sampling_rate_hz });
        }
        let files = files::matching_files(setup, folder)?;
        let files = SourceFile::all(files)?;
        let (Some(columns), Some(first)) = (common_columns(&files, setup)?, files.first()) else {
            return Err(RecordError::NoFiles { setup: setup.name.clone() });
        };
        let selection = Selection::new(setup, &columns, &first.path)?;
        Ok(Self {
            statistics: Statistics::new(selection.columns.len()),
            clock: Clock::new(sampling_rate_hz),
            setup: setup.clone(),
            files,
            selection,
            next_file: 0,
            reader: None,
            rows_of_file: 0,
            put_in: 0,
        })
    }

    /// Rows per second.
    pub fn sampling_rate_hz(&self) -> f64 {
        self.setup.sampling_rate_hz
    }

    /// Number of channels: the setup's sensors, in their order.
    pub fn channels(&self) -> usize {
        self.selection.columns.len()
    }

    /// When its first row was, in nanoseconds since 1970 (UTC), where its files say it.
    ///
    /// # Errors
    /// Where the first file cannot be read.
    pub fn start_ns(&self) -> Result<Option<i64>, RecordError> {
        let Some(first) = self.files.first() else { return Ok(None) };
        Ok(first.said(&self.setup)?.start_ns.filter(|start_ns| *start_ns > 0))
    }

    /// Exact number of rows of the whole recording, filled gaps and those between joined blocks included. At once for NPY, MATLAB, HDF5, WAV,
    /// TDMS and SAC, and for Parquet without a time column; heads of records of miniSEED and datasets of universal files are gone through, and
    /// text is read through (without parsing its samples), so call it once.
    ///
    /// # Errors
    /// Where a file cannot be read, or its time column goes wrong.
    pub fn total_rows(&self) -> Result<u64, RecordError> {
        let mut clock = Clock::new(self.setup.sampling_rate_hz);
        let mut is_first = true;
        let rows = self.files.iter().map(|file| {
            let rows = file.count_rows(&self.setup, &mut clock)?;
            let within = self.setup.block_rows().map_or(0, |block| rows.saturating_sub(1) / block);
            let before = u64::from(self.setup.block_s.is_some() && rows > 0 && !std::mem::take(&mut is_first));
            let joints = within + before;
            Ok(rows + joints * ROWS_BETWEEN_BLOCKS as u64)
        });
        rows.sum()
    }

    /// Reads the next rows, a few thousand at most, into `block`; false, with `block` empty, at the recording's end.
    ///
    /// A block never reaches over the end of a file, so blocks differ in length.
    ///
    /// # Errors
    /// What is wrong with the file at the position reached. The recording cannot be read further then.
    pub fn next_block(&mut self, block: &mut Block) -> Result<bool, RecordError> {
        let channels = self.channels();
        let rows = (BLOCK_VALUES / channels.max(1)).clamp(*BLOCK_ROWS.start(), *BLOCK_ROWS.end());
        // With room for the rows that are put in.
        let rows = self.setup.block_rows().map_or(rows, |length| {
            let put_in = ROWS_BETWEEN_BLOCKS * (rows / usize::try_from(length).unwrap_or(usize::MAX) + 1);
            rows.saturating_sub(put_in).max(1)
        });
        loop {
            let values = block.start(channels);
            let Some(reader) = &mut self.reader else {
                let Some(file) = self.files.get(self.next_file) else { return Ok(false) };
                self.reader = Some(file.open(&self.setup)?);
                self.next_file += 1;
                self.clock.start_file();
                self.rows_of_file = 0;
                continue;
            };
            let mut into = Rows { selection: &self.selection, clock: &mut self.clock, values };
            if reader.read(rows, &mut into)? > 0 {
                block.subtract(&self.selection.offsets);
                self.statistics.add(block, |row| reader.position(row));
                if let Some(rows) = self.setup.block_rows() {
                    let before = block.row_count();
                    let is_start = self.next_file == 1 && self.rows_of_file == 0;
                    self.rows_of_file = block.part(self.rows_of_file, rows, ROWS_BETWEEN_BLOCKS, is_start);
                    self.put_in += (block.row_count() - before) as u64;
                }
                return Ok(true);
            }
            self.reader = None;
        }
    }

    /// What was read so far, and what the user should know about it.
    pub fn finish(self) -> RecordReport {
        let mut report = self.statistics.report(&self.selection, &self.clock, self.setup.sampling_rate_hz);
        report.rows += self.put_in;
        report
    }
}
