//! Recordings in HDF5 files as programs for data acquisition lay them out: one dataset of rows and channels, or one of each channel.
//!
//! The sampling rate is an attribute of the dataset, of a group above it, or of the file. A dataset of times is compared with it, and says where
//! rows are missing. Attributes `scale_factor` and `add_offset` are those of the CF conventions.

use std::path::{Path, PathBuf};

use super::data::Numbers;
use super::{Dataset, Hdf5File, Kind, Object};
use crate::record::array::{ArrayReader, Layout};
use crate::record::channels::{Channel, ChannelReader, Form, RateAndUnit, Stretch, UNSCALED};
use crate::record::clock::{Clock, UNIX_S, check_rate, is_rate, rate_of_times_hz, unix_ns};
use crate::record::columns::{Columns, is_time_column};
use crate::record::error::{FilePosition, RecordError, listed};
use crate::record::row_reader::RowReader;
use crate::record::{rate, stamp};
use crate::study::Setup;

/// Times that are fetched at once.
const TIMES: usize = 4096;
/// Attributes that say when a recording began: seconds since 1970, or a date and a time of day in UTC.
const STARTS: [&str; 4] = ["start_time", "start_time_utc", "StartTime", "starttime"];
/// A dataset that is shorter than the longest is a channel that ended early while it has this part of its rows.
const LEAST_OF_ROWS: f64 = 0.99;

/// The datasets of a file that make up the setup's recording.
#[derive(Debug)]
pub(in crate::record) struct Hdf5Recording {
    path: PathBuf,
    file: Hdf5File,
    /// Rows of the longest dataset.
    rows: u64,
    parts: Parts,
    times: Option<Object>,
    /// Rows that follow each other without a gap.
    pieces: Vec<Piece>,
    /// When it began in s since 1970, as an attribute says it.
    started_s: Option<f64>,
    /// Series of numbers beside the channels.
    others: Option<String>,
}

/// Rows that follow each other: the first and how many, and which row of the recording the first is.
#[derive(Debug, Clone, Copy)]
struct Piece {
    from: u64,
    count: u64,
    row: u64,
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
        let series = || numbers.iter().copied().filter(|object| long_dimensions(object) == 1);
        let rows = series().map(count).max().unwrap_or(0);
        let is_channel =
            |object: &&Object| count(object) as f64 >= LEAST_OF_ROWS * rows as f64 || own_rate_hz(object).is_some();
        let is_time = |object: &&Object| is_time_column(last_name(&object.path), &setup.sensors);
        let (channels, others): (Vec<&Object>, Vec<&Object>) =
            series().filter(|object| !is_time(object)).partition(is_channel);
        let matrices: Vec<&Object> = numbers.iter().copied().filter(|object| long_dimensions(object) == 2).collect();
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
        // Of channels with rates of their own those count that are read.
        let rows = match &parts {
            Parts::Channels(objects) if !setup.sensors.is_empty() => {
                let wanted = paths.find_all(&setup.sensors, path)?;
                wanted.iter().filter_map(|&at| objects.get(at)).map(|(object, _)| count(object)).max().unwrap_or(rows)
            }
            _ => rows,
        };
        let times = times_among(series().filter(is_time), rows).cloned();
        let pieces = vec![Piece { from: 0, count: rows, row: 0 }];
        let started_s = objects.iter().find_map(start_s);
        let others = (matches!(parts, Parts::Channels(_)) && !others.is_empty())
            .then(|| format!("{}, much shorter than the longest channel and without a rate", named(&others)));
        let mut recording = Self { path: path.to_owned(), file, rows, parts, times, pieces, started_s, others };
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
        if !setup.sensors.is_empty() {
            recording.follow_times(setup.sampling_rate_hz)?;
        }
        Ok(recording)
    }

    /// Its channels' rates and units, as attributes give them.
    pub(in crate::record) fn said(&self) -> Result<Vec<RateAndUnit>, RecordError> {
        const UNITS: [&str; 4] = ["units", "unit", "Unit", "Units"];
        let of_times_hz = self.rate_of_times_hz()?;
        let said = |object: &Object, rate_hz: Option<f64>| {
            (rate_hz.or(of_times_hz), UNITS.iter().find_map(|name| object.text(name)).map(str::to_owned))
        };
        Ok(match &self.parts {
            Parts::Matrix { object, columns, rate_hz, .. } => vec![said(object, *rate_hz); *columns],
            Parts::Channels(channels) => channels.iter().map(|(object, rate_hz)| said(object, *rate_hz)).collect(),
        })
    }

    /// What stands beside its channels, in words.
    pub(in crate::record) fn others(&self) -> Option<&str> {
        self.others.as_deref()
    }

    /// When its first row was, in nanoseconds since 1970, where its times or an attribute say it.
    pub(in crate::record) fn start_ns(&self) -> Result<Option<i64>, RecordError> {
        let first_s = match &self.times {
            // In single precision, times since 1970 step by two minutes.
            Some(times) if self.file.numbers(times)?.sample.bytes() == size_of::<f64>() => {
                self.times_s(times, 0, 1)?.first().copied()
            }
            _ => None,
        };
        let start_s = first_s.filter(|first_s| UNIX_S.contains(first_s)).or(self.started_s);
        Ok(start_s.map(unix_ns))
    }

    /// The recording's rows, those included that are missing by its times.
    pub(in crate::record) fn rows(&self) -> u64 {
        self.pieces.last().map_or(0, |last| last.row + last.count)
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
        let wanted = columns.find_all(&setup.sensors, &self.path)?;
        let Self { path, file, rows, parts, pieces, .. } = self;
        let (mut sources, mut channels) = (Vec::new(), Vec::new());
        match parts {
            Parts::Matrix { object, columns, row_by_row, .. } => {
                let Numbers { source, offset, sample, big_endian } = file.numbers(&object)?;
                let scale = scale_of(&object);
                if pieces.len() == 1 && scale == UNSCALED {
                    let layout = Layout { offset, sample, big_endian, rows, columns, row_by_row };
                    return Ok(Box::new(ArrayReader::new(path, source, layout)));
                }
                let bytes = sample.bytes() as u64;
                for column in 0..columns {
                    let at = column as u64 * bytes;
                    let stretch = |piece: &Piece| {
                        if row_by_row {
                            let stride = columns as u64 * bytes;
                            let record = offset + piece.from * stride;
                            piece.stretch(0, record + at, Form::Plain { sample, big_endian, stride, record })
                        } else {
                            let first = offset + rows * at + piece.from * bytes;
                            piece.stretch(0, first, Form::packed(sample, big_endian, first))
                        }
                    };
                    let is_wanted = wanted.contains(&column);
                    let stretches = pieces.iter().filter(|_| is_wanted).map(stretch).collect();
                    let name = (column + 1).to_string();
                    channels.push(Channel { name, rate_hz: None, scale, stretches, unit: None });
                }
                sources.push((path, source));
                Ok(Box::new(ChannelReader::new(sources, channels, false, setup)?))
            }
            Parts::Channels(objects) => {
                for (index, (object, rate_hz)) in objects.into_iter().enumerate() {
                    let mut stretches = Vec::new();
                    if wanted.contains(&index) {
                        let Numbers { source, offset, sample, big_endian } = file.numbers(&object)?;
                        let stretch = |piece: &Piece| {
                            let first = offset + piece.from * sample.bytes() as u64;
                            piece.stretch(sources.len(), first, Form::packed(sample, big_endian, first))
                        };
                        stretches.extend(
                            pieces.iter().filter_map(|piece| piece.up_to(count(&object))).map(|piece| stretch(&piece)),
                        );
                        sources.push((path.clone(), source));
                    }
                    let scale = scale_of(&object);
                    channels.push(Channel { name: object.path, rate_hz, scale, stretches, unit: None });
                }
                Ok(Box::new(ChannelReader::new(sources, channels, true, setup)?))
            }
        }
    }

    /// Times of rows from `row` on, in s.
    fn times_s(&self, times: &Object, row: u64, count: usize) -> Result<Vec<f64>, RecordError> {
        let Numbers { mut source, offset, sample, big_endian } = self.file.numbers(times)?;
        let mut raw = vec![0; count * sample.bytes()];
        source.fetch(offset + row * sample.bytes() as u64, &mut raw).map_err(RecordError::io(&self.path))?;
        Ok(sample.decode_all(&mut raw, big_endian))
    }

    /// The rate by its first times.
    fn rate_of_times_hz(&self) -> Result<Option<f64>, RecordError> {
        let Some(times) = &self.times else { return Ok(None) };
        let times_s = self.times_s(times, 0, usize::try_from(count(times)).unwrap_or(usize::MAX).min(TIMES))?;
        Ok(rate_of_times_hz(&times_s))
    }

    /// Finds where rows are missing by its times; refuses those of another rate.
    fn follow_times(&mut self, sampling_rate_hz: f64) -> Result<(), RecordError> {
        let Some(times) = &self.times else { return Ok(()) };
        let Numbers { mut source, offset, sample, big_endian } = self.file.numbers(times)?;
        let (name, bytes) = (last_name(&times.path), sample.bytes());
        let mut clock = Clock::new(sampling_rate_hz);
        let mut pieces: Vec<Piece> = Vec::new();
        let mut row = 0;
        let timed = count(times).min(self.rows);
        while row < timed {
            let count = usize::try_from(timed - row).unwrap_or(usize::MAX).min(TIMES);
            let mut raw = vec![0; count * bytes];
            source.fetch(offset + row * bytes as u64, &mut raw).map_err(RecordError::io(&self.path))?;
            let times_s = sample.decode_all(&mut raw, big_endian);
            let position = |row: u64| FilePosition::row(&self.path, row + 1);
            if row == 0 {
                // Times in single precision show the rate, and no longer single steps.
                let is_coarse = bytes < size_of::<f64>();
                let resolution_s =
                    if is_coarse { f64::from(f32::EPSILON) * times_s.last().map_or(0.0, |s| s.abs()) } else { 0.0 };
                check_rate(&times_s, resolution_s, sampling_rate_hz, name, &position(0))?;
                if is_coarse {
                    return Ok(());
                }
            }
            for (at, time_s) in (row..).zip(&times_s) {
                if !time_s.is_finite() {
                    let (position, column, text) = (position(at), name.to_owned(), time_s.to_string());
                    return Err(RecordError::TimeNotSeconds { position, column, text });
                }
                let missing = clock.advance(*time_s, name, &position(at))?;
                match pieces.last_mut().filter(|_| missing == 0) {
                    Some(last) => last.count += 1,
                    None => {
                        let end = pieces.last().map_or(0, |last| last.row + last.count);
                        pieces.push(Piece { from: at, count: 1, row: end + missing });
                    }
                }
            }
            row += count as u64;
        }
        if let Some(last) = pieces.last_mut() {
            // Rows behind the last time follow it.
            last.count += self.rows - timed;
            self.pieces = pieces;
        }
        Ok(())
    }
}

impl Piece {
    fn stretch(&self, source: usize, offset: u64, form: Form) -> Stretch {
        Stretch { row: self.row, count: self.count, source, offset, form }
    }

    /// Of a dataset with so many numbers.
    fn up_to(self, numbers: u64) -> Option<Self> {
        let count = numbers.saturating_sub(self.from).min(self.count);
        (count > 0).then_some(Self { count, ..self })
    }
}

/// What makes the quantity of a dataset's numbers: times this, plus that (CF conventions, section 8.1).
fn scale_of(object: &Object) -> [f64; 2] {
    let [one, zero] = UNSCALED;
    [object.number("scale_factor").unwrap_or(one), object.number("add_offset").unwrap_or(zero)]
}

/// When a recording began by an attribute, in s since 1970.
fn start_s(object: &Object) -> Option<f64> {
    let of_text = |text: &str| {
        let utc = text.trim().strip_suffix('Z').or_else(|| text.trim().strip_suffix("+00:00"))?;
        stamp::seconds(utc.as_bytes())
    };
    let said = |name: &&str| object.number(name).or_else(|| object.text(name).and_then(of_text));
    STARTS.iter().find_map(said).filter(|start_s| UNIX_S.contains(start_s))
}

fn lengths(object: &Object) -> &[u64] {
    object.dataset.as_ref().map_or(&[], |dataset| &dataset.lengths)
}

/// Dimensions in which it has more than one number.
fn long_dimensions(object: &Object) -> usize {
    lengths(object).iter().filter(|length| **length > 1).count()
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

/// The times of so many rows, or of nearly as many; of several those that have as many.
fn times_among<'a>(times: impl Iterator<Item = &'a Object>, rows: u64) -> Option<&'a Object> {
    let apart = |object: &Object| count(object).abs_diff(rows);
    let is_near = |object: &&Object| apart(object) as f64 <= (1.0 - LEAST_OF_ROWS) * rows as f64;
    times.filter(is_near).min_by_key(|object| apart(object))
}

/// The rate that an object states itself.
fn own_rate_hz(object: &Object) -> Option<f64> {
    let number = |name: &str| object.number(name).and_then(|number| rate::rate_hz(name, number));
    object.attributes.iter().find_map(|attribute| number(&attribute.name))
}

/// The rate that an object states, or a group above it.
fn rate_hz(object: &Object, objects: &[Object]) -> Option<f64> {
    let mut path = object.path.as_str();
    loop {
        if let Some(rate_hz) = objects.iter().find(|other| other.path == path).and_then(own_rate_hz) {
            return Some(rate_hz);
        }
        if path.is_empty() {
            return None;
        }
        path = path.rsplit_once('/').map_or("", |(above, _)| above);
    }
}
