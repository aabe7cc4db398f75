//! Recordings in MATLAB files: one matrix, its longer dimension being time, or a vector of each channel.
//!
//! A scalar such as `fs` says the rate, and a vector of times is no channel.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::element::{Class, MatFile, Numbers, Variable};
use super::{find, list, real_dimensions};
use crate::record::array::{ArrayReader, Layout, Source};
use crate::record::channels::{Channel, ChannelReader, Form, Stretch, UNSCALED};
use crate::record::clock::{check_rate, is_rate, rate_of_times_hz};
use crate::record::columns::{Columns, is_time_column};
use crate::record::error::{FilePosition, MatError, RecordError};
use crate::record::rate::rate_hz;
use crate::record::row_reader::RowReader;
use crate::study::Setup;

/// Times that are compared with the sampling rate.
const TIMES: u64 = 1024;

/// What of a file is the setup's recording.
#[derive(Debug)]
pub(in crate::record) struct MatRecording {
    path: PathBuf,
    file: MatFile,
    rows: u64,
    parts: Parts,
    /// As a scalar or a vector of times says it.
    rate_hz: Option<f64>,
    /// Numbers beside the channels, in words.
    others: Option<String>,
}

#[derive(Debug)]
enum Parts {
    /// A matrix, or a vector alone: how many channels, and whether a row's numbers stand together.
    Matrix { variable: Variable, columns: usize, row_by_row: bool },
    /// One vector a channel.
    Vectors(Vec<Variable>),
}

impl MatRecording {
    /// Finds what the setup's sensors name: the variable that the setup names, else vectors of these names, else the only matrix, else (no matrix)
    /// the longest vectors.
    pub(in crate::record) fn open(path: &Path, setup: &Setup) -> Result<Self, RecordError> {
        let file = MatFile::open(path)?;
        let all = file.variables()?;
        let stated = scalar_rate_hz(&file, &all)?;
        let parts_of = |variable: Variable| -> Result<(u64, Parts), MatError> {
            let (rows, columns, row_by_row) = shape_of(path, &variable)?;
            Ok((rows, Parts::Matrix { variable, columns, row_by_row }))
        };
        let named = setup.variable.as_deref().map(|name| find(path, all.clone(), name)).transpose()?;
        let available = list(&all);
        let is_real = |variable: &Variable| variable.class == Class::Numeric && !variable.complex;
        let real: Vec<Variable> =
            all.into_iter().filter(|variable| is_real(variable) && variable.dimensions.len() == 2).collect();
        let longer_than_one = |variable: &Variable| variable.dimensions.iter().filter(|length| **length > 1).count();
        let (mut matrices, vectors): (Vec<Variable>, Vec<Variable>) = real
            .into_iter()
            .filter(|variable| longer_than_one(variable) > 0)
            .partition(|one| longer_than_one(one) == 2);
        let (times, vectors): (Vec<Variable>, Vec<Variable>) =
            vectors.into_iter().partition(|vector| is_time_column(&vector.name, &setup.sensors));
        let rows = vectors.iter().map(length).max().unwrap_or(0);
        let (mut vectors, mut left): (Vec<Variable>, Vec<Variable>) =
            vectors.into_iter().partition(|vector| length(vector) == rows);
        let is_named = |channel: &str| vectors.iter().any(|vector| vector.name == channel.trim());
        let are_named = !setup.sensors.is_empty() && setup.sensors.iter().all(|sensor| is_named(&sensor.channel));
        // A matrix that is no longer than vectors beside it is a calibration or the like, unless sensors count its columns.
        let are_longer =
            matrices.is_empty() || (setup.sensors.is_empty() && matrices.iter().all(|matrix| length(matrix) < rows));
        let (rows, parts) = match (named, matrices.len()) {
            (Some(named), _) => parts_of(named)?,
            (None, _) if are_named || (are_longer && vectors.len() > 1) => {
                left.append(&mut matrices);
                (rows, Parts::Vectors(vectors))
            }
            (None, 0 | 1) => match matrices.pop().or_else(|| vectors.pop()) {
                Some(only) => parts_of(only)?,
                None => return Err(MatError::NoMatrix { file: path.to_owned(), available }.into()),
            },
            (None, _) => {
                return Err(MatError::SeveralMatrices { file: path.to_owned(), candidates: list(&matrices) }.into());
            }
        };
        let others = (matches!(parts, Parts::Vectors(_)) && !left.is_empty())
            .then(|| format!("{}, beside vectors of {rows} numbers", list(&left)));
        let rate_hz = stated.as_ref().map(|(_, rate_hz)| *rate_hz);
        if let Some((name, measured_hz)) = stated.filter(|_| !setup.sensors.is_empty())
            && !is_rate(measured_hz, setup.sampling_rate_hz)
        {
            let (file, stated_hz) = (path.to_owned(), setup.sampling_rate_hz);
            return Err(RecordError::StatedRate { file, channel: name, measured_hz, stated_hz });
        }
        let recording = Self { path: path.to_owned(), file, rows, parts, rate_hz, others };
        let times = times.iter().find(|times| length(times) == recording.rows);
        let recording = match times {
            Some(times) => recording.with_times(times, setup)?,
            None => recording,
        };
        recording.checked()
    }

    /// Finds a file cut short before the reading starts.
    fn checked(self) -> Result<Self, RecordError> {
        let variables = match &self.parts {
            Parts::Matrix { variable, .. } => std::slice::from_ref(variable),
            Parts::Vectors(vectors) => vectors.as_slice(),
        };
        for variable in variables.iter().filter(|variable| !variable.is_compressed()) {
            self.file.numbers(variable)?;
        }
        Ok(self)
    }

    /// With a vector of times, whose rate must be the setup's where that has sensors.
    fn with_times(mut self, times: &Variable, setup: &Setup) -> Result<Self, RecordError> {
        let numbers = self.file.numbers(times)?;
        let (sample, big_endian, offset) = (numbers.sample, numbers.big_endian, numbers.offset);
        let mut source = self.source(numbers)?;
        let mut raw = vec![0; length(times).min(TIMES) as usize * sample.bytes()];
        source.fetch(offset, &mut raw).map_err(RecordError::io(&self.path))?;
        let times_s = sample.decode_all(&mut raw, big_endian);
        let resolution_s = if sample.bytes() == 8 { 0.0 } else { times_s.last().map_or(0.0, |last| 1e-6 * last.abs()) };
        let position = FilePosition::row(&self.path, 1);
        if setup.sensors.is_empty() {
            self.rate_hz = self.rate_hz.or_else(|| rate_of_times_hz(&times_s));
        } else {
            check_rate(&times_s, resolution_s, setup.sampling_rate_hz, &times.name, &position)?;
        }
        Ok(self)
    }

    fn source(&self, numbers: Numbers) -> Result<Source, RecordError> {
        match numbers.inflated {
            Some(source) => Ok(source),
            None => Ok(Source::File(File::open(&self.path).map_err(RecordError::io(&self.path))?)),
        }
    }

    pub(in crate::record) fn rows(&self) -> u64 {
        self.rows
    }

    pub(in crate::record) fn columns(&self) -> Columns {
        match &self.parts {
            Parts::Matrix { columns, .. } => Columns::Numbered(*columns),
            Parts::Vectors(vectors) => Columns::Paths(vectors.iter().map(|vector| vector.name.clone()).collect()),
        }
    }

    /// The rate of each of its channels, as the file says it; it has no units.
    pub(in crate::record) fn said(&self) -> Vec<(Option<f64>, Option<String>)> {
        let channels = match &self.parts {
            Parts::Matrix { columns, .. } => *columns,
            Parts::Vectors(vectors) => vectors.len(),
        };
        vec![(self.rate_hz, None); channels]
    }

    /// What stands beside its channels, in words.
    pub(in crate::record) fn others(&self) -> Option<&str> {
        self.others.as_deref()
    }

    /// What reads its rows.
    pub(in crate::record) fn reader(self, setup: &Setup) -> Result<Box<dyn RowReader>, RecordError> {
        let names = self.columns();
        match &self.parts {
            Parts::Matrix { variable, columns, row_by_row } => {
                let numbers = self.file.numbers(variable)?;
                let (offset, sample, big_endian) = (numbers.offset, numbers.sample, numbers.big_endian);
                let (rows, columns, row_by_row) = (self.rows, *columns, *row_by_row);
                let layout = Layout { offset, sample, big_endian, rows, columns, row_by_row };
                let source = self.source(numbers)?;
                Ok(Box::new(ArrayReader::new(self.path, source, layout)))
            }
            Parts::Vectors(vectors) => {
                let wanted = names.find_all(&setup.sensors, &self.path)?;
                let (mut sources, mut channels) = (Vec::new(), Vec::new());
                for (index, vector) in vectors.iter().enumerate() {
                    let mut stretches = Vec::new();
                    if wanted.contains(&index) {
                        let numbers = self.file.numbers(vector)?;
                        let (source, offset) = (sources.len(), numbers.offset);
                        let form = Form::packed(numbers.sample, numbers.big_endian, offset);
                        stretches.push(Stretch { row: 0, count: self.rows, source, offset, form });
                        sources.push((self.path.clone(), self.source(numbers)?));
                    }
                    let (name, scale) = (vector.name.clone(), UNSCALED);
                    channels.push(Channel { name, rate_hz: None, scale, stretches, unit: None });
                }
                Ok(Box::new(ChannelReader::new(sources, channels, true, setup)?))
            }
        }
    }
}

/// Numbers in a vector.
fn length(vector: &Variable) -> u64 {
    vector.dimensions.iter().copied().max().unwrap_or(0)
}

/// The rate that a scalar of the file says by its name, and that name.
fn scalar_rate_hz(file: &MatFile, variables: &[Variable]) -> Result<Option<(String, f64)>, MatError> {
    for variable in variables {
        let is_scalar = variable.class == Class::Numeric && variable.dimensions.iter().all(|length| *length == 1);
        // Only the name tells, so a number that is not asked for is not read.
        if is_scalar && rate_hz(&variable.name, 1.0).is_some() {
            let value = file.full(variable, 1)?.first().copied();
            if let Some(rate_hz) = value.and_then(|value| rate_hz(&variable.name, value)) {
                return Ok(Some((variable.name.clone(), rate_hz)));
            }
        }
    }
    Ok(None)
}

/// Rows and columns of a recording, and whether a row's numbers stand together: its longer dimension is time (the first, where they are equal).
fn shape_of(path: &Path, variable: &Variable) -> Result<(u64, usize, bool), MatError> {
    let (first, second) = real_dimensions(path, variable)?;
    let (file, name) = (path.to_owned(), variable.name.clone());
    if variable.class != Class::Numeric {
        return Err(MatError::NotNumeric { file, variable: name, found: variable.class.to_string() });
    }
    if first == 0 || second == 0 {
        return Err(MatError::Empty { file, variable: name });
    }
    let row_by_row = second > first;
    let (rows, columns) = if row_by_row { (second, first) } else { (first, second) };
    let columns = usize::try_from(columns).map_err(|_| MatError::TooLarge { file, variable: name, rows, columns })?;
    Ok((rows, columns, row_by_row))
}

/// Whether a compressed recording's numbers are kept in memory.
#[cfg(test)]
pub(in crate::record) fn inflated_into_memory(path: &Path) -> Option<bool> {
    let setup = Setup::new("", 1.0, Vec::new());
    let recording = MatRecording::open(path, &setup).ok()?;
    let Parts::Matrix { variable, .. } = &recording.parts else { return None };
    recording.file.numbers(variable).ok()?.inflated.map(|source| matches!(source, Source::Memory(_)))
}
