//! Channels as stretches of samples in files: what WAV, HDF5, TDMS, SAC, miniSEED and UDBF have in common.
//!
//! A format's reader says where the samples of each channel stand; rows flow out, NaN where no stretch reaches. Samples of several channels
//! that stand in turn are fetched once.

use std::path::{Path, PathBuf};

use super::array::{Placement, Sample, Source};
use super::clock::is_rate;
use super::columns::Columns;
use super::error::{At, FilePosition, RecordError};
use super::row_reader::{Progress, RowReader, Rows};
use super::steim::{self, Steim};
use crate::study::Setup;

/// Bytes that are fetched at once, where a row is no longer.
const MOST_FETCHED: u64 = 1 << 24;

/// How samples stand in a stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Form {
    /// Each `stride` bytes after the one before; the first in a record of as many bytes that starts at `record`.
    Plain { sample: Sample, big_endian: bool, stride: u64, record: u64 },
    /// Compressed into so many bytes.
    Steim { kind: Steim, bytes: u32, big_endian: bool },
}

impl Form {
    /// Samples one after the other, from byte `offset` on.
    pub(super) fn packed(sample: Sample, big_endian: bool, offset: u64) -> Self {
        Self::Plain { sample, big_endian, stride: sample.bytes() as u64, record: offset }
    }
}

/// A stretch of one channel's samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stretch {
    /// The row of its first sample.
    pub(super) row: u64,
    pub(super) count: u64,
    /// Which of the sources it is in.
    pub(super) source: usize,
    /// Byte of its first sample.
    pub(super) offset: u64,
    pub(super) form: Form,
}

/// A channel's rate in Hz and its unit, as its file says them.
pub(super) type RateAndUnit = (Option<f64>, Option<String>);

/// Numbers that are the quantity itself.
pub(super) const UNSCALED: [f64; 2] = [1.0, 0.0];

/// One channel of a file or of several.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Channel {
    pub(super) name: String,
    /// Samples a second, where the file says it.
    pub(super) rate_hz: Option<f64>,
    /// What makes its quantity of its numbers: times this, plus that.
    pub(super) scale: [f64; 2],
    /// In the order of time, none over another.
    pub(super) stretches: Vec<Stretch>,
    /// The file's word for its unit.
    pub(super) unit: Option<String>,
}

impl Channel {
    /// The row behind its last.
    pub(super) fn end(&self) -> u64 {
        self.stretches.last().map_or(0, |last| last.row.saturating_add(last.count))
    }
}

/// Reads the channels of one file, or of several that stand beside each other, row by row.
#[derive(Debug)]
pub(super) struct ChannelReader {
    sources: Vec<(PathBuf, Source)>,
    channels: Vec<Channel>,
    has_names: bool,
    /// When the first row was, in nanoseconds since 1970, where files say it.
    start_ns: Option<i64>,
    /// By how many rows each channel's samples are later than the rows that they become, where files say when they were.
    late_rows: Vec<f64>,
    progress: Progress,
    /// The next stretch of each channel that may reach into the rows to come.
    next: Vec<usize>,
    /// Bytes fetched last: of which source, and from where on.
    window: Option<(usize, u64, Vec<u8>)>,
    packed: Vec<u8>,
    /// The compressed stretch of each channel that was decoded last.
    decoded: Vec<Option<(usize, Vec<f64>)>>,
}

impl ChannelReader {
    /// A reader of `channels`, whose stretches are in `sources`, one at least.
    ///
    /// # Errors
    /// Where no channel has a sample, or a channel's rate is not the setup's.
    pub(super) fn new(
        sources: Vec<(PathBuf, Source)>,
        channels: Vec<Channel>,
        has_names: bool,
        setup: &Setup,
    ) -> Result<Self, RecordError> {
        let rows = channels.iter().map(Channel::end).max().unwrap_or(0);
        let file = path_of(&sources, 0);
        if rows == 0 {
            return Err(RecordError::Empty { file });
        }
        let (next, decoded) = (vec![0; channels.len()], channels.iter().map(|_| None).collect());
        let reader = Self {
            sources,
            channels,
            has_names,
            start_ns: None,
            late_rows: Vec::new(),
            progress: Progress::new(rows),
            next,
            window: None,
            packed: Vec::new(),
            decoded,
        };
        let columns = reader.columns();
        for sensor in &setup.sensors {
            let Some(channel) = reader.channels.get(columns.find(&sensor.channel, &file)?) else { continue };
            let stated_hz = setup.sampling_rate_hz;
            let Some(measured_hz) = channel.rate_hz else { continue };
            if !is_rate(measured_hz, stated_hz) {
                let file = path_of(&reader.sources, channel.stretches.first().map_or(0, |first| first.source));
                return Err(RecordError::StatedRate { file, channel: sensor.channel.clone(), measured_hz, stated_hz });
            }
        }
        Ok(reader)
    }

    /// The same with a time of its first row, and by how many rows each channel is later than that has it.
    pub(super) fn from(self, start_ns: i64, late_rows: Vec<f64>) -> Self {
        Self { start_ns: Some(start_ns), late_rows, ..self }
    }

    pub(super) fn start_ns(&self) -> Option<i64> {
        self.start_ns
    }

    /// Its channels' rates and units, as its files have them.
    pub(super) fn said(&self) -> Vec<(Option<f64>, Option<String>)> {
        self.channels.iter().map(|channel| (channel.rate_hz, channel.unit.clone())).collect()
    }

    /// The columns of what it reads.
    pub(super) fn columns(&self) -> Columns {
        if self.has_names {
            Columns::Paths(self.channels.iter().map(|channel| channel.name.clone()).collect())
        } else {
            Columns::Numbered(self.channels.len())
        }
    }

    pub(super) fn rows(&self) -> u64 {
        self.progress.rows
    }

    /// Puts the samples of a channel that stand in the next rows where `values`, row after row, wants them, times `factor`.
    fn fill(&mut self, column: usize, rows: u64, to: &mut Target<'_>, factor: f64) -> Result<(), RecordError> {
        let (first, last) = (self.progress.next, self.progress.next + rows);
        let Some(scale) = self.channels.get(column).map(|channel| channel.scale) else { return Ok(()) };
        let reached = self.next.get(column).copied().unwrap_or(0);
        for index in reached.. {
            let Some(stretch) = self.channels.get(column).and_then(|channel| channel.stretches.get(index)).copied()
            else {
                break;
            };
            let end = stretch.row.saturating_add(stretch.count);
            if stretch.row >= last {
                break;
            }
            if end <= first {
                if let Some(next) = self.next.get_mut(column) {
                    *next = index + 1;
                }
                continue;
            }
            let (from, until) = (stretch.row.max(first), end.min(last));
            let skipped = from - stretch.row;
            let start = to.start + (from - first) as usize * to.stride;
            let count = (until - from) as usize;
            match stretch.form {
                Form::Steim { .. } => {
                    self.decode(column, index, &stretch)?;
                    let samples =
                        self.decoded.get(column).and_then(Option::as_ref).map(|(_, samples)| samples.as_slice());
                    let samples = samples.unwrap_or_default().iter().skip(skipped as usize).take(count);
                    for (value, sample) in to.values.iter_mut().skip(start).step_by(to.stride.max(1)).zip(samples) {
                        *value = sample * (scale[0] * factor);
                    }
                }
                Form::Plain { sample, big_endian, stride, record } => {
                    let within = stretch.offset.saturating_sub(record);
                    let mut done = 0;
                    while done < count {
                        let most = (MOST_FETCHED / stride.max(1)).max(1) as usize;
                        let part = (count - done).min(most);
                        let from_row = skipped + done as u64;
                        self.pack(&stretch, [record + from_row * stride, within], part, sample.bytes(), stride)?;
                        if big_endian {
                            sample.swap(&mut self.packed);
                        }
                        let start = start + done * to.stride;
                        let (values, stride) = (&mut *to.values, to.stride);
                        let factor = scale[0] * factor;
                        sample.decode(&self.packed, Placement::Column { values, start, stride, factor });
                        done += part;
                    }
                }
            }
            if scale[1] != 0.0 {
                for value in to.values.iter_mut().skip(start).step_by(to.stride.max(1)).take(count) {
                    *value += scale[1] * factor;
                }
            }
        }
        Ok(())
    }

    /// Brings `count` samples together, of records from byte `record` on.
    fn pack(
        &mut self,
        stretch: &Stretch,
        [record, within]: [u64; 2],
        count: usize,
        size: usize,
        stride: u64,
    ) -> Result<(), RecordError> {
        // Behind the last sample the file may end.
        let wanted = (count as u64 - 1) * stride + within + size as u64;
        let is_there = self.window.as_ref().is_some_and(|(source, from, bytes)| {
            *source == stretch.source && *from <= record && record + wanted <= from + bytes.len() as u64
        });
        if !is_there {
            let Some((path, source)) = self.sources.get_mut(stretch.source) else { return Ok(()) };
            // Whole records, for the channels that follow; the last may end with this one.
            let whole = count as u64 * stride.max(size as u64);
            let mut bytes = self.window.take().map(|(_, _, bytes)| bytes).unwrap_or_default();
            bytes.resize(whole.max(wanted) as usize, 0);
            if source.fetch(record, &mut bytes).is_err() {
                bytes.resize(wanted as usize, 0);
                source.fetch(record, &mut bytes).map_err(RecordError::io(path))?;
            }
            self.window = Some((stretch.source, record, bytes));
        }
        self.packed.clear();
        let Some((_, from, bytes)) = &self.window else { return Ok(()) };
        let start = (record - from + within) as usize;
        for sample in bytes.get(start..).unwrap_or_default().chunks(stride.max(1) as usize).take(count) {
            self.packed.extend_from_slice(sample.get(..size).unwrap_or_default());
        }
        Ok(())
    }

    /// Decodes a compressed stretch, where that is not done yet.
    fn decode(&mut self, column: usize, index: usize, stretch: &Stretch) -> Result<(), RecordError> {
        let Form::Steim { kind, bytes, big_endian } = stretch.form else { return Ok(()) };
        let Some(slot) = self.decoded.get_mut(column) else { return Ok(()) };
        if slot.as_ref().is_some_and(|(there, _)| *there == index) {
            return Ok(());
        }
        let Some((path, source)) = self.sources.get_mut(stretch.source) else { return Ok(()) };
        let mut raw = vec![0; bytes as usize];
        source.fetch(stretch.offset, &mut raw).map_err(RecordError::io(path))?;
        if !big_endian {
            Sample::I32.swap(&mut raw);
        }
        let samples = steim::decode(kind, &raw, stretch.count as usize).map_err(|reason| RecordError::Format {
            file: path.clone(),
            reason: format!("the record with its samples at byte {}: {reason}", stretch.offset),
        })?;
        *slot = Some((index, samples));
        Ok(())
    }
}

/// Every `stride`-th of `values` from `start` on.
struct Target<'a> {
    values: &'a mut [f64],
    start: usize,
    stride: usize,
}

impl RowReader for ChannelReader {
    fn late_rows(&self) -> &[f64] {
        &self.late_rows
    }

    fn read(&mut self, most: usize, rows: &mut Rows<'_>) -> Result<usize, RecordError> {
        let (count, selection) = (self.progress.upcoming(most), rows.selection);
        if count == 0 {
            return Ok(0);
        }
        let values = rows.grow(count);
        values.fill(f64::NAN);
        for (channel, (column, factor)) in selection.columns.iter().zip(&selection.factors).enumerate() {
            let mut target = Target { values: &mut *values, start: channel, stride: selection.columns.len() };
            self.fill(*column, count as u64, &mut target, *factor)?;
        }
        self.progress.advance(count);
        Ok(count)
    }

    fn position(&self, row: usize) -> FilePosition {
        let row = self.progress.row(row);
        // Of several files the one in which a channel has this row.
        let holds = |stretch: &&Stretch| stretch.row <= row && row - stretch.row < stretch.count;
        let stretch = self.channels.iter().zip(&self.next).find_map(|(channel, next)| {
            channel.stretches.get(next.saturating_sub(1)..).unwrap_or_default().iter().take(1 << 13).find(holds)
        });
        let file = path_of(&self.sources, stretch.map_or(0, |stretch| stretch.source));
        FilePosition { file, at: At::Row(row + 1) }
    }
}

/// The file that a source is in.
pub(super) fn path_of(sources: &[(PathBuf, Source)], source: usize) -> PathBuf {
    sources.get(source).map(|(path, _)| path.clone()).unwrap_or_default()
}

/// For what is wrong with a file's form.
pub(super) fn wrong_form<T>(file: &Path, reason: impl Into<String>) -> Result<T, RecordError> {
    Err(RecordError::Format { file: file.to_owned(), reason: reason.into() })
}
