//! Recordings in HDF5 files as programs for data acquisition lay them out: one dataset of rows and channels, or one of each channel.
//!
//! The sampling rate is an attribute of the dataset, of a group above it, or of the file; a dataset of times is compared with it.

use std::path::{Path, PathBuf};

use super::data::Numbers;
use super::{Dataset, Hdf5File, Kind, Object};
use crate::record::array::{ArrayReader, Layout};
use crate::record::channels::{Channel, ChannelReader, Form, Stretch};
use crate::record::clock::{Clock, check_rate, is_rate};
use crate::record::columns::{Columns, is_time_column};
use crate::record::error::{At, FilePosition, RecordError, listed};
use crate::record::row_reader::RowReader;
use crate::study::Setup;

/// Attributes that mean samples a second, in lower case and without what stands between letters.
const RATES: [&str; 10] = [
    "samplingratehz",
    "samplingrate",
    "samplerate",
    "sampleratehz",
    "samplingfrequency",
    "samplingfrequencyhz",
    "fs",
    "fshz",
    "rate",
    "ratehz",
];
/// Attributes that mean seconds from one sample to the next.
const STEPS: [&str; 7] = ["dt", "dts", "samplinginterval", "sampleinterval", "wfincrement", "timestep", "delta"];
/// Times that are fetched at once.
const TIMES: usize = 4096;

/// The datasets of a file that make up the setup's recording.
#[derive(Debug)]
pub(in crate::record) struct Hdf5Recording {
    path: PathBuf,
    file: Hdf5File,
    rows: u64,
    parts: Parts,
}

#[derive(Debug)]
enum Parts {
    /// One dataset: its columns, and whether a row's numbers stand together.
    Matrix { object: Box<Object>, columns: usize, row_by_row: bool, rate_hz: Option<f64> },
    /// One dataset a channel: its name in the file, itself, and its rate.
    Channels(Vec<(Object, Option<f64>)>),
}

impl Hdf5Recording {
    /// Finds what the setup's sensors name; `variable` names a dataset, or a group of them, where there are several.
    pub(in crate::record) fn open(path: &Path, setup: &Setup) -> Result<Self, RecordError> {
        if path.metadata().map_err(RecordError::io(path))?.len() == 0 {
            return Err(RecordError::Empty { file: path.to_owned() });
        }
        let file = Hdf5File::open(path)?;
        let objects = file.objects()?;
        let rate = |object: &Object| rate_hz(object, &objects);
        let is_named = |object: &&Object| setup.variable.as_deref().is_none_or(|name| is_at(&object.path, name));
        let numbers: Vec<&Object> = objects
            .iter()
            .filter(|object| object.dataset.as_ref().is_some_and(|dataset| matches!(dataset.kind, Kind::Number { .. })))
            .filter(is_named)
            .collect();
        let long = |object: &&Object| lengths(object).iter().filter(|length| **length > 1).count();
        let rows = numbers.iter().filter(|object| long(object) == 1).map(|object| count(object)).max().unwrap_or(0);
        let series = numbers.iter().filter(|object| long(object) == 1 && count(object) == rows).copied();
        let (times, channels): (Vec<&Object>, Vec<&Object>) =
            series.partition(|object| is_time_column(last_name(&object.path), &setup.sensors));
        let matrices: Vec<&Object> = numbers.iter().filter(|object| long(object) == 2).copied().collect();
        let paths = Columns::Paths(channels.iter().map(|object| object.path.clone()).collect());
        let are_named = setup.sensors.iter().all(|sensor| {
            // A number alone is a column of a matrix, where there is one.
            (matrices.is_empty() || sensor.channel.trim().parse::<usize>().is_err())
                && paths.find(&sensor.channel, path).is_ok()
        });
        let named = |objects: &[&Object]| {
            listed(objects.iter().map(|object| format!("`{}` ({})", object.path, sizes(object))), "")
        };
        let wrong = |reason: String| RecordError::Format { file: path.to_owned(), reason };
        let (rows, parts) = match matrices[..] {
            [object] if !are_named || channels.is_empty() || setup.sensors.is_empty() => {
                let long: Vec<u64> = lengths(object).iter().copied().filter(|length| *length > 1).collect();
                let [first, second] = long[..] else {
                    return Err(wrong("a dataset without two dimensions".to_owned()));
                };
                let row_by_row = first >= second;
                let (rows, columns) = if row_by_row { (first, second) } else { (second, first) };
                let columns = usize::try_from(columns).map_err(|_| wrong(format!("{columns} channels")))?;
                (rows, Parts::Matrix { object: Box::new(object.clone()), columns, row_by_row, rate_hz: rate(object) })
            }
            [_, _, ..] if !are_named || channels.is_empty() || setup.sensors.is_empty() => {
                return Err(wrong(format!("several matrices: say which with `variable`, one of {}", named(&matrices))));
            }
            _ if channels.is_empty() => {
                let what = match &setup.variable {
                    Some(name) => format!("no numbers at `{name}`"),
                    None => "no dataset of numbers".to_owned(),
                };
                let all: Vec<&Object> = objects.iter().filter(|object| object.dataset.is_some()).take(12).collect();
                return Err(wrong(format!("{what}; its datasets are {}", named(&all))));
            }
            _ => (rows, Parts::Channels(channels.iter().map(|object| ((*object).clone(), rate(object))).collect())),
        };
        let recording = Self { path: path.to_owned(), file, rows, parts };
        if let (Parts::Matrix { rate_hz: Some(measured_hz), object, .. }, false) =
            (&recording.parts, setup.sensors.is_empty())
        {
            let stated_hz = setup.sampling_rate_hz;
            if !is_rate(*measured_hz, stated_hz) {
                let (file, channel) = (path.to_owned(), object.path.clone());
                return Err(RecordError::StatedRate { file, channel, measured_hz: *measured_hz, stated_hz });
            }
        }
        // Without sensors the file is looked into, not read.
        if let Some(times) = times.first().filter(|times| count(times) == rows && !setup.sensors.is_empty()) {
            recording.check_times(times, setup.sampling_rate_hz)?;
        }
        Ok(recording)
    }

    /// Its channels' rates and units, as attributes give them.
    pub(in crate::record) fn said(&self) -> Vec<(Option<f64>, Option<String>)> {
        const UNITS: [&str; 4] = ["units", "unit", "Unit", "Units"];
        let said = |object: &Object, rate_hz: Option<f64>| {
            (rate_hz, UNITS.iter().find_map(|name| object.text(name)).map(str::to_owned))
        };
        match &self.parts {
            Parts::Matrix { object, columns, rate_hz, .. } => vec![said(object, *rate_hz); *columns],
            Parts::Channels(channels) => channels.iter().map(|(object, rate_hz)| said(object, *rate_hz)).collect(),
        }
    }

    pub(in crate::record) fn rows(&self) -> u64 {
        self.rows
    }

    pub(in crate::record) fn columns(&self) -> Columns {
        match &self.parts {
            Parts::Matrix { columns, .. } => Columns::Numbered(*columns),
            Parts::Channels(channels) => {
                Columns::Paths(channels.iter().map(|(object, _)| object.path.clone()).collect())
            }
        }
    }

    /// What reads its rows; datasets in chunks are put together first.
    pub(in crate::record) fn reader(self, setup: &Setup) -> Result<Box<dyn RowReader>, RecordError> {
        let columns = self.columns();
        match self.parts {
            Parts::Matrix { object, columns, row_by_row, .. } => {
                let Numbers { source, offset, sample, big_endian } = self.file.numbers(&object)?;
                let layout = Layout { offset, sample, big_endian, rows: self.rows, columns, row_by_row };
                Ok(Box::new(ArrayReader::new(self.path, source, layout)))
            }
            Parts::Channels(objects) => {
                let wanted = columns.find_all(&setup.sensors, &self.path)?;
                let (mut sources, mut channels) = (Vec::new(), Vec::new());
                for (index, (object, rate_hz)) in objects.into_iter().enumerate() {
                    let mut stretches = Vec::new();
                    if wanted.contains(&index) {
                        let Numbers { source, offset, sample, big_endian } = self.file.numbers(&object)?;
                        let form = Form::packed(sample, big_endian, offset);
                        stretches.push(Stretch { row: 0, count: self.rows, source: sources.len(), offset, form });
                        sources.push((self.path.clone(), source));
                    }
                    channels.push(Channel { name: object.path, rate_hz, scale: [1.0, 0.0], stretches, unit: None });
                }
                Ok(Box::new(ChannelReader::new(sources, channels, true, setup)?))
            }
        }
    }

    /// Refuses times that leave rows out, or that are of another rate.
    fn check_times(&self, times: &Object, sampling_rate_hz: f64) -> Result<(), RecordError> {
        let numbers = self.file.numbers(times)?;
        let (mut source, bytes) = (numbers.source, numbers.sample.bytes());
        let name = last_name(&times.path);
        let mut clock = Clock::new(sampling_rate_hz);
        let mut row = 0;
        while row < self.rows {
            let count = usize::try_from(self.rows - row).unwrap_or(usize::MAX).min(TIMES);
            let mut raw = vec![0; count * bytes];
            source.fetch(numbers.offset + row * bytes as u64, &mut raw).map_err(RecordError::io(&self.path))?;
            let times_s = numbers.sample.decode_all(&mut raw, numbers.big_endian);
            let position = |row: u64| FilePosition { file: self.path.clone(), at: At::Row(row + 1) };
            if row == 0 {
                check_rate(&times_s, 0.0, sampling_rate_hz, name, &position(0))?;
            }
            for (at, time_s) in (row..).zip(&times_s) {
                if !time_s.is_finite() {
                    let (position, column, text) = (position(at), name.to_owned(), time_s.to_string());
                    return Err(RecordError::TimeNotSeconds { position, column, text });
                }
                let missing = clock.advance(*time_s, name, &position(at))?;
                if missing > 0 {
                    let reason = format!(
                        "row {}: {missing} rows are missing before it by the times in `{}`; write rows of NaN there, or make setups of the parts",
                        at + 1,
                        times.path
                    );
                    return Err(RecordError::Format { file: self.path.clone(), reason });
                }
            }
            row += count as u64;
        }
        Ok(())
    }
}

fn lengths(object: &Object) -> &[u64] {
    object.dataset.as_ref().map_or(&[], |dataset| &dataset.lengths)
}

fn count(object: &Object) -> u64 {
    object.dataset.as_ref().and_then(Dataset::count).unwrap_or(0)
}

/// Its lengths as people write them.
fn sizes(object: &Object) -> String {
    let lengths: Vec<String> = lengths(object).iter().map(u64::to_string).collect();
    if lengths.is_empty() { "a number".to_owned() } else { lengths.join(" × ") }
}

fn last_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Whether an object is what `name` says, or stands in the group of that name.
fn is_at(path: &str, name: &str) -> bool {
    let name = name.trim_matches('/');
    path == name
        || path.strip_prefix(name).is_some_and(|rest| rest.starts_with('/'))
        || path.strip_suffix(name).is_some_and(|before| before.ends_with('/'))
}

/// The rate that an object states, or a group above it.
fn rate_hz(object: &Object, objects: &[Object]) -> Option<f64> {
    let plain = |name: &str| name.chars().filter(|c| c.is_alphanumeric()).collect::<String>().to_lowercase();
    let of_one = |object: &Object| {
        object.attributes.iter().find_map(|attribute| {
            let name = plain(&attribute.name);
            let number = object.number(&attribute.name).filter(|number| *number > 0.0)?;
            let is_rate = RATES.contains(&name.as_str());
            is_rate.then_some(number).or_else(|| STEPS.contains(&name.as_str()).then_some(number.recip()))
        })
    };
    let mut path = object.path.as_str();
    loop {
        if let Some(rate_hz) = objects.iter().find(|other| other.path == path).and_then(of_one) {
            return Some(rate_hz);
        }
        if path.is_empty() {
            return None;
        }
        path = path.rsplit_once('/').map_or("", |(above, _)| above);
    }
}
