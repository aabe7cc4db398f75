//! UFF 58 recordings: datasets 58 of a universal file, in text or binary (58b), each the time response of one channel.
//!
//! A file's datasets are found and their headers read on opening; then all channels are read in step, each from its own
//! place in the file, so that memory does not grow with the recording.

mod dataset;
mod values;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::array::Placement;
use super::clock::is_rate;
use super::columns::Columns;
use super::error::{FilePosition, RecordError};
use super::files::open_file;
use super::row_reader::{Progress, RowReader, Rows};
use crate::study::{Sensor, Setup, Unit};
use dataset::{Data, TimeResponse, time_responses};
use values::TextValues;

/// Reads the setup's channels of one universal file row by row.
#[derive(Debug)]
pub(super) struct UffReader {
    path: PathBuf,
    file: File,
    responses: Vec<TimeResponse>,
    /// Through the rows, which every channel that the setup names has.
    progress: Progress,
    /// Of each response in text that is read, how far it is read.
    texts: Vec<Option<TextValues>>,
    raw: Vec<u8>,
}

impl UffReader {
    /// Opens a file and finds that the setup's channels are in it, in step with each other and at its sampling rate.
    pub(super) fn open(path: &Path, setup: &Setup) -> Result<Self, RecordError> {
        let (mut file, bytes) = open_file(path)?;
        let responses = time_responses(path, &mut file, bytes)?;
        let columns = columns_of(&responses);
        let mut first: Option<&TimeResponse> = None;
        for sensor in &setup.sensors {
            let column = columns.find(&sensor.channel, path)?;
            let Some(response) = responses.get(column) else { continue };
            check(path, setup, sensor, response, first)?;
            first = first.or(Some(response));
        }
        // Without sensors it is looked into, not read.
        let first = first.or_else(|| responses.first().filter(|_| setup.sensors.is_empty()));
        let rows = first.map_or(0, |response| response.count);
        if rows == 0 {
            return Err(RecordError::Empty { file: path.to_owned() });
        }
        let texts = responses.iter().map(|_| None).collect();
        let (path, raw) = (path.to_owned(), Vec::new());
        Ok(Self { path, file, responses, progress: Progress::new(rows), texts, raw })
    }

    /// The file's channels.
    pub(super) fn columns(&self) -> Columns {
        columns_of(&self.responses)
    }

    /// Its channels' samples a second.
    pub(super) fn rates_hz(&self) -> Vec<f64> {
        self.responses.iter().map(|response| response.step_s.recip()).collect()
    }

    /// What the ordinates of its channels stand for, where they say it.
    pub(super) fn units(&self) -> Vec<Option<&'static str>> {
        let unit = |response: &TimeResponse| match response.ordinate {
            dataset::ACCELERATION => Some("m/s2"),
            dataset::VELOCITY => Some("m/s"),
            dataset::DISPLACEMENT => Some("m"),
            _ => None,
        };
        self.responses.iter().map(unit).collect()
    }

    pub(super) fn rows(&self) -> u64 {
        self.progress.rows
    }

    /// Puts the next `rows` numbers of a response, times `factor`, to every `stride`-th of `values`.
    fn read_response(
        &mut self,
        column: usize,
        rows: usize,
        (values, stride): (&mut [f64], usize),
        factor: f64,
    ) -> Result<(), RecordError> {
        let (Some(response), Some(text)) = (self.responses.get(column), self.texts.get_mut(column)) else {
            return Ok(());
        };
        match response.data {
            Data::Binary { offset, big_endian } => {
                let size = response.sample.bytes();
                self.raw.resize(rows * size, 0);
                let from = offset + self.progress.next * size as u64;
                let fetched = self.file.seek(SeekFrom::Start(from)).and_then(|_| self.file.read_exact(&mut self.raw));
                fetched.map_err(RecordError::io(&self.path))?;
                if big_endian {
                    response.sample.swap(&mut self.raw);
                }
                response.sample.decode(&self.raw, Placement::Column { values, start: 0, stride, factor });
            }
            Data::Text { start, end } => {
                let text = text.get_or_insert_with(|| TextValues::new(start, end, response));
                let is_last = self.progress.next + rows as u64 == self.progress.rows;
                let numbers = text.take(&self.path, &mut self.file, rows, is_last)?;
                for (value, number) in values.iter_mut().step_by(stride.max(1)).zip(numbers) {
                    *value = number * factor;
                }
            }
        }
        Ok(())
    }
}

impl RowReader for UffReader {
    fn read(&mut self, most: usize, rows: &mut Rows<'_>) -> Result<usize, RecordError> {
        let (count, selection) = (self.progress.upcoming(most), rows.selection);
        if count == 0 {
            return Ok(0);
        }
        let values = rows.grow(count);
        for (channel, (column, factor)) in selection.columns.iter().zip(&selection.factors).enumerate() {
            let values = values.get_mut(channel..).unwrap_or_default();
            self.read_response(*column, count, (values, selection.columns.len()), *factor)?;
        }
        self.progress.advance(count);
        Ok(count)
    }

    fn position(&self, row: usize) -> FilePosition {
        self.progress.position(&self.path, row)
    }
}

fn columns_of(responses: &[TimeResponse]) -> Columns {
    Columns::Responses(responses.iter().map(|response| response.name.clone()).collect())
}

/// Checks a channel's response against the setup and the `first` of its channels.
fn check(
    path: &Path,
    setup: &Setup,
    sensor: &Sensor,
    response: &TimeResponse,
    first: Option<&TimeResponse>,
) -> Result<(), RecordError> {
    let (file, channel) = (path.to_owned(), sensor.channel.clone());
    let expected = match setup.unit_of(sensor) {
        Unit::MetrePerSecondSquared | Unit::StandardGravity => dataset::ACCELERATION,
        Unit::MetrePerSecond => dataset::VELOCITY,
        Unit::Metre => dataset::DISPLACEMENT,
        // Volts stand for acceleration by the sensor's sensitivity, whatever the file calls them; of rotations it has no number.
        Unit::Volt | Unit::Radian | Unit::Strain => dataset::UNKNOWN,
    };
    if let Some(found) = dataset::motion(response.ordinate)
        && expected != dataset::UNKNOWN
        && response.ordinate != expected
    {
        return Err(RecordError::UffOrdinate { file, channel, found });
    }
    let stated_hz = setup.sampling_rate_hz;
    let measured_hz = response.step_s.recip();
    if !is_rate(measured_hz, stated_hz) {
        return Err(RecordError::UffRate { file, channel, measured_hz, stated_hz });
    }
    let Some(first) = first else { return Ok(()) };
    if response.count != first.count {
        let (rows, expected) = (response.count, first.count);
        return Err(RecordError::UffLength { file, channel, rows, expected });
    }
    let late_s = response.start_s - first.start_s;
    if late_s.abs() * stated_hz > 0.5 {
        return Err(RecordError::UffStart { file, channel, late_s });
    }
    Ok(())
}
