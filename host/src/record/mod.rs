//! Recordings: what a setup's files hold, streamed in blocks, never read whole.
//!
//! Files flow in; rows in the study's channel order and in SI units flow out, with NaN where a sample is missing. The
//! format goes by a file's ending: white space (`.txt`, `.asc`, `.dat`), CSV (`.csv`), NumPy (`.npy`), MATLAB
//! (`.mat`), HDF5 (`.h5`, `.hdf5`), Parquet (`.parquet`), datasets 58 of a universal file (`.uff`, `.unv`), WAV (`.wav`),
//! SAC (`.sac`), miniSEED (`.mseed`), TDMS (`.tdms`), UDBF (`.dat`, `.udbf`). At the end a [`RecordReport`] says what
//! was missing, dead or unusual.

mod array;
mod block;
mod channels;
mod clock;
mod columns;
mod error;
mod files;
mod hdf5;
mod lanes;
mod leap;
mod lines;
pub mod mat;
mod mseed;
mod npy;
mod number;
mod parquet;
mod preamble;
mod rate;
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
mod udbf;
mod uff;
mod warning;
mod wav;

#[cfg(test)]
mod tests;

use std::path::Path;

pub use block::Block;
pub(crate) use columns::si_factor;
pub use error::{At, FilePosition, MatError, RecordError};
pub(crate) use error::{listed, quoted};
pub(crate) use files::{matching_files, named_files};
pub use hdf5::Hdf5Error;
pub(crate) use mseed::head as mseed_head;
pub(crate) use npy::{NpyArray, RowError, read_row};
pub use report::{ChannelReport, Gap, RecordReport};
pub(crate) use traces::utc;
pub(crate) use warning::time_of_day;
pub use warning::{Affected, RecordWarning};

use crate::study::Setup;
use clock::Clock;
use columns::Selection;
use lanes::Lane;
use report::Statistics;
use source_file::SourceFile;

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
    /// One, or several that stand beside each other.
    lanes: Vec<Lane>,
    selection: Selection,
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
        let lanes = lanes::lanes_of(setup, SourceFile::all(files)?)?;
        let selection = Selection::of_parts(lanes.iter().map(|lane| (&lane.selection, lane.places())));
        let statistics = Statistics::new(selection.columns.len());
        Ok(Self { setup: setup.clone(), lanes, selection, statistics, rows_of_file: 0, put_in: 0 })
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
        let starts = self.lanes.iter().map(Lane::start_ns).collect::<Result<Vec<_>, _>>()?;
        Ok(starts.into_iter().flatten().min())
    }

    /// Exact number of rows of the whole recording, filled gaps and those between joined blocks included. At once for NPY, MATLAB, HDF5, WAV,
    /// TDMS, SAC and UDBF, and for Parquet without a time column; heads of records of miniSEED and datasets of universal files are gone through, and
    /// text is read through (without parsing its samples), so call it once.
    ///
    /// # Errors
    /// Where a file cannot be read, or its time column goes wrong.
    pub fn total_rows(&self) -> Result<u64, RecordError> {
        let [lane] = self.lanes.as_slice() else {
            let ends = self.lanes.iter().map(Lane::count_rows).collect::<Result<Vec<_>, _>>()?;
            return Ok(ends.into_iter().max().unwrap_or(0));
        };
        let mut is_first = true;
        let rows = lane.rows_of_files().map(|rows| {
            let rows = rows?;
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
        let values = block.start(channels);
        let [lane] = self.lanes.as_mut_slice() else {
            let (count, firsts) = lanes::read_beside(&mut self.lanes, rows, channels, values)?;
            block.subtract(&self.selection.offsets);
            let lanes = &self.lanes;
            self.statistics.add(block, |row, channel| {
                let lane = lanes::lane_of(lanes, channel);
                let first = firsts.get(lane).copied().unwrap_or(0);
                lanes.get(lane).map_or_else(|| FilePosition::line(Path::new(""), 0), |lane| lane.position(first + row))
            });
            return Ok(count > 0);
        };
        let (count, begins_file) = lane.read(rows, values)?;
        if count == 0 {
            return Ok(false);
        }
        if begins_file {
            self.rows_of_file = 0;
        }
        block.subtract(&self.selection.offsets);
        self.statistics.add(block, |row, _| lane.position(row));
        if let Some(rows) = self.setup.block_rows() {
            let before = block.row_count();
            let is_start = lane.is_in_first_file() && self.rows_of_file == 0;
            self.rows_of_file = block.part(self.rows_of_file, rows, ROWS_BETWEEN_BLOCKS, is_start);
            self.put_in += (block.row_count() - before) as u64;
        }
        Ok(true)
    }

    /// What was read so far, and what the user should know about it.
    pub fn finish(self) -> RecordReport {
        // Of lanes, gaps in time are of some channels, and among what is missing of these.
        let of_all = Clock::new(self.setup.sampling_rate_hz);
        let clock = match self.lanes.as_slice() {
            [lane] => &lane.clock,
            _ => &of_all,
        };
        let mut report = self.statistics.report(&self.selection, clock, self.setup.sampling_rate_hz);
        report.rows += self.put_in;
        report.warnings.extend(lanes::warnings(&self.lanes, self.setup.sampling_rate_hz));
        report
    }
}
