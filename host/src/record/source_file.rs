//! A setup's file, its format known by its ending: the choice among the readers.
//!
//! Paths flow in; the file's columns, its number of rows, or a reader that starts at its first row flow out.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::channels::{ChannelReader, RateAndUnit};
use super::clock::{Clock, UNIX_S, is_rate, unix_ns};
use super::columns::Columns;
use super::error::RecordError;
use super::hdf5::recording::Hdf5Recording;
use super::mat::MatRecording;
use super::parquet::ParquetReader;
use super::row_reader::RowReader;
use super::text::TextReader;
use super::traces::Traces;
use super::uff::UffReader;
use super::{mseed, npy, sac, tdms, udbf, wav};
use crate::study::Setup;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    WhiteSpace,
    Csv,
    Toa5,
    Udbf,
    Npy,
    Mat,
    Hdf5,
    Parquet,
    Uff,
    Wav,
    Sac,
    MiniSeed,
    Tdms,
}

/// What a file says of its channels, in their order; nothing of one whose format has no place for it.
#[derive(Debug, Default)]
pub(super) struct Said {
    pub(super) channels: Vec<RateAndUnit>,
    pub(super) start_ns: Option<i64>,
    /// The same by a logger's own clock, where nobody says how far that is ahead of UTC.
    pub(super) local_ns: Option<i64>,
    /// What of its numbers is no channel, in words.
    pub(super) others: Option<String>,
    /// The column of times, where its name need not tell.
    pub(super) time: Option<String>,
}

/// Where a file's rows stand in time, as its header says it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    /// When the first was, in nanoseconds since 1970.
    pub(super) start_ns: i64,
    /// Its own rate, or else that of the setup.
    pub(super) rate_hz: f64,
    /// How many there are, those included that are missing within it.
    pub(super) rows: u64,
}

impl Said {
    /// Of a file whose times are those of the logger's own clock, s.
    fn by_own_clock(first_s: Option<f64>, setup: &Setup) -> Self {
        match setup.utc_offset_h {
            Some(ahead_h) => {
                Self { start_ns: first_s.map(|first_s| unix_ns(first_s - 3600.0 * ahead_h)), ..Self::default() }
            }
            None => Self { local_ns: first_s.map(unix_ns), ..Self::default() },
        }
    }
}

/// One of a setup's files, its format known by its ending; or several, where each has a channel or a part of one.
#[derive(Debug, Clone)]
pub(super) struct SourceFile {
    pub(super) path: PathBuf,
    /// Files whose traces stand beside its own, by their times.
    beside: Vec<PathBuf>,
    format: Format,
}

impl SourceFile {
    /// A setup's files, those together whose traces are put on one line of time.
    pub(super) fn all(paths: Vec<PathBuf>) -> Result<Vec<Self>, RecordError> {
        let mut files: Vec<Self> = Vec::new();
        for path in paths {
            let file = Self::new(path)?;
            match files.iter_mut().find(|first| first.has_traces() && file.has_traces()) {
                Some(first) => first.beside.push(file.path),
                None => files.push(file),
            }
        }
        Ok(files)
    }

    fn has_traces(&self) -> bool {
        matches!(self.format, Format::Sac | Format::MiniSeed | Format::Udbf)
    }

    fn traces(&self, setup: &Setup) -> Result<ChannelReader, RecordError> {
        let mut traces = Traces::default();
        for path in std::iter::once(&self.path).chain(&self.beside) {
            match format_of(path) {
                Some(Format::Sac) => sac::add(path, &mut traces)?,
                Some(Format::MiniSeed) => mseed::add(path, &mut traces)?,
                _ => udbf::add(path, &mut traces)?,
            }
        }
        traces.reader(setup)
    }

    fn new(path: PathBuf) -> Result<Self, RecordError> {
        let format = match format_of(&path) {
            Some(Format::WhiteSpace | Format::Csv) if is_toa5(&path) => Format::Toa5,
            Some(Format::WhiteSpace) if udbf::is_udbf(&path) => Format::Udbf,
            // Full SEED, and what else is called so, is not read.
            Some(Format::MiniSeed) if has_ending(&path, &["msd", "seed"]) && !is_mini_seed(&path) => {
                return Err(RecordError::UnknownEnding { file: path });
            }
            Some(format) => format,
            None => return Err(RecordError::UnknownEnding { file: path }),
        };
        Ok(Self { path, beside: Vec::new(), format })
    }

    /// Each channel's rate and unit, and when the first row was, where the format has a place for it.
    pub(super) fn said(&self, setup: &Setup) -> Result<Said, RecordError> {
        let of_units = |units: Vec<Option<String>>| units.into_iter().map(|unit| (None, unit)).collect();
        let of_channels =
            |reader: ChannelReader| Said { channels: reader.said(), start_ns: reader.start_ns(), ..Said::default() };
        Ok(match self.format {
            Format::Hdf5 => {
                let recording = Hdf5Recording::open(&self.path, setup)?;
                Said {
                    channels: recording.said()?,
                    start_ns: recording.start_ns()?,
                    others: recording.others().map(str::to_owned),
                    ..Said::default()
                }
            }
            Format::Wav => of_channels(wav::open(&self.path, setup)?),
            Format::Tdms => of_channels(tdms::open(&self.path, setup)?),
            Format::Sac | Format::MiniSeed | Format::Udbf => of_channels(self.traces(setup)?),
            Format::Uff => {
                let reader = UffReader::open(&self.path, setup)?;
                let rates = reader.rates_hz().into_iter().map(Some);
                let units = reader.units().into_iter().map(|unit| Some(unit?.to_owned()));
                Said { channels: rates.zip(units).collect(), ..Said::default() }
            }
            Format::Toa5 => {
                let reader = TextReader::open_toa5(&self.path, &setup.sensors)?;
                let (channels, first_s) = (of_units(reader.units()), reader.first_time_s()?);
                Said { channels, ..Said::by_own_clock(first_s, setup) }
            }
            Format::Csv => {
                let reader = TextReader::open_csv(&self.path, &setup.sensors)?;
                let (channels, first_s) = (of_units(reader.units()), reader.first_time_s()?);
                Said {
                    channels,
                    start_ns: first_s.filter(|first_s| UNIX_S.contains(first_s)).map(unix_ns),
                    ..Said::default()
                }
            }
            Format::Parquet => {
                let reader = ParquetReader::open(&self.path, &setup.sensors)?;
                let (time, is_local) = (reader.time_name().map(str::to_owned), reader.has_local_times());
                let first_s = reader.first_time_s()?.filter(|first_s| UNIX_S.contains(first_s));
                let said = if is_local {
                    Said::by_own_clock(first_s, setup)
                } else {
                    Said { start_ns: first_s.map(unix_ns), ..Said::default() }
                };
                Said { time, ..said }
            }
            Format::Mat => {
                let recording = MatRecording::open(&self.path, setup)?;
                let others = recording.others().map(str::to_owned);
                Said { channels: recording.said(), others, ..Said::default() }
            }
            Format::WhiteSpace | Format::Npy => Said::default(),
        })
    }

    /// Where its rows stand in time by its header; `None` of formats whose times are followed row by row from file to file, and of files that say no
    /// start.
    pub(super) fn span(&self, setup: &Setup) -> Result<Option<Span>, RecordError> {
        let (start_ns, channels, rows) = match self.format {
            Format::Hdf5 => {
                let recording = Hdf5Recording::open(&self.path, setup)?;
                (recording.start_ns()?, recording.said()?, recording.rows())
            }
            Format::Tdms => {
                let reader = tdms::open(&self.path, setup)?;
                (reader.start_ns(), reader.said(), reader.rows())
            }
            _ => return Ok(None),
        };
        let mut rates_hz = channels.into_iter().filter_map(|(rate_hz, _)| rate_hz);
        let rate_hz = rates_hz.find(|rate_hz| is_rate(*rate_hz, setup.sampling_rate_hz));
        let rate_hz = rate_hz.unwrap_or(setup.sampling_rate_hz);
        Ok(start_ns.filter(|start_ns| *start_ns > 0).map(|start_ns| Span { start_ns, rate_hz, rows }))
    }

    /// Whether a column may hold something else than numbers, which only reading shows.
    pub(super) fn may_hold_words(&self) -> bool {
        matches!(self.format, Format::WhiteSpace | Format::Csv | Format::Toa5 | Format::Parquet)
    }

    /// The files that it stands for.
    pub(super) fn paths(&self) -> impl Iterator<Item = &Path> {
        std::iter::once(&self.path).chain(&self.beside).map(PathBuf::as_path)
    }

    /// The file's columns; finds what its first bytes or its size show to be wrong.
    pub(super) fn inspect(&self, setup: &Setup) -> Result<Columns, RecordError> {
        match self.format {
            Format::WhiteSpace => TextReader::open_white_space(&self.path)?.inspect(setup.sampling_rate_hz),
            Format::Csv => TextReader::open_csv(&self.path, &setup.sensors)?.inspect(setup.sampling_rate_hz),
            Format::Toa5 => TextReader::open_toa5(&self.path, &setup.sensors)?.inspect(setup.sampling_rate_hz),
            Format::Npy => Ok(Columns::Numbered(npy::open(&self.path)?.columns())),
            Format::Mat => Ok(MatRecording::open(&self.path, setup)?.columns()),
            Format::Hdf5 => Ok(Hdf5Recording::open(&self.path, setup)?.columns()),
            Format::Wav => Ok(wav::open(&self.path, setup)?.columns()),
            Format::Tdms => Ok(tdms::open(&self.path, setup)?.columns()),
            Format::Sac | Format::MiniSeed | Format::Udbf => Ok(self.traces(setup)?.columns()),
            Format::Parquet => ParquetReader::open(&self.path, &setup.sensors)?.inspect(setup.sampling_rate_hz),
            Format::Uff => Ok(UffReader::open(&self.path, setup)?.columns()),
        }
    }

    pub(super) fn open(&self, setup: &Setup) -> Result<Box<dyn RowReader>, RecordError> {
        Ok(match self.format {
            Format::WhiteSpace => Box::new(TextReader::open_white_space(&self.path)?),
            Format::Csv => Box::new(TextReader::open_csv(&self.path, &setup.sensors)?),
            Format::Toa5 => Box::new(TextReader::open_toa5(&self.path, &setup.sensors)?),
            Format::Npy => Box::new(npy::open(&self.path)?),
            Format::Mat => MatRecording::open(&self.path, setup)?.reader(setup)?,
            Format::Hdf5 => Hdf5Recording::open(&self.path, setup)?.reader(setup)?,
            Format::Wav => Box::new(wav::open(&self.path, setup)?),
            Format::Tdms => Box::new(tdms::open(&self.path, setup)?),
            Format::Sac | Format::MiniSeed | Format::Udbf => Box::new(self.traces(setup)?),
            Format::Parquet => Box::new(ParquetReader::open(&self.path, &setup.sensors)?),
            Format::Uff => Box::new(UffReader::open(&self.path, setup)?),
        })
    }

    /// Exact number of rows, those included that the time column says are missing.
    pub(super) fn count_rows(&self, setup: &Setup, clock: &mut Clock) -> Result<u64, RecordError> {
        match self.format {
            Format::WhiteSpace => TextReader::open_white_space(&self.path)?.count_rows(clock),
            Format::Csv => TextReader::open_csv(&self.path, &setup.sensors)?.count_rows(clock),
            Format::Toa5 => TextReader::open_toa5(&self.path, &setup.sensors)?.count_rows(clock),
            Format::Npy => Ok(npy::open(&self.path)?.rows()),
            Format::Mat => Ok(MatRecording::open(&self.path, setup)?.rows()),
            Format::Hdf5 => Ok(Hdf5Recording::open(&self.path, setup)?.rows()),
            Format::Wav => Ok(wav::open(&self.path, setup)?.rows()),
            Format::Tdms => Ok(tdms::open(&self.path, setup)?.rows()),
            Format::Sac | Format::MiniSeed | Format::Udbf => Ok(self.traces(setup)?.rows()),
            Format::Parquet => ParquetReader::open(&self.path, &setup.sensors)?.count_rows(clock),
            Format::Uff => Ok(UffReader::open(&self.path, setup)?.rows()),
        }
    }
}

/// The format that a file's ending stands for.
fn format_of(path: &Path) -> Option<Format> {
    let ending = path.extension()?.to_string_lossy().to_ascii_lowercase();
    Some(match ending.as_str() {
        "txt" | "asc" | "dat" => Format::WhiteSpace,
        "csv" => Format::Csv,
        "npy" => Format::Npy,
        "mat" => Format::Mat,
        "h5" | "hdf5" | "hdf" => Format::Hdf5,
        "parquet" => Format::Parquet,
        "udbf" => Format::Udbf,
        "uff" | "unv" => Format::Uff,
        "wav" | "rf64" => Format::Wav,
        "sac" => Format::Sac,
        "tdms" => Format::Tdms,
        "mseed" | "miniseed" | "ms" | "mseed3" | "ms3" | "msd" | "seed" => Format::MiniSeed,
        _ => return None,
    })
}

/// Whether a file has the ending of a recording.
pub(super) fn is_recording(path: &Path) -> bool {
    format_of(path).is_some()
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|ending| endings.iter().any(|one| ending.eq_ignore_ascii_case(one)))
}

/// Whether a file begins as a record of miniSEED: version 3 with its letters, version 2 with a number of six digits and the quality of data.
fn is_mini_seed(path: &Path) -> bool {
    let mut start = [0; 8];
    let is_read = File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok();
    let is_version_2 = start[..6].iter().all(|byte| byte.is_ascii_digit() || *byte == b' ')
        && matches!(start[6], b'D' | b'R' | b'Q' | b'M')
        && matches!(start[7], b' ' | 0);
    is_read && (start.starts_with(b"MS\x03") || is_version_2)
}

/// Whether a text file begins as one of a Campbell logger.
fn is_toa5(path: &Path) -> bool {
    let mut start = [0; 6];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == *b"\"TOA5\""
}

/// Checks that no two files differ in their columns and returns those of the first.
pub(super) fn common_columns(files: &[SourceFile], setup: &Setup) -> Result<Option<Columns>, RecordError> {
    let mut first: Option<(&Path, Columns)> = None;
    for file in files {
        let columns = file.inspect(setup)?;
        match &first {
            None => first = Some((&file.path, columns)),
            Some((_, expected)) if *expected == columns => {}
            Some((first_file, expected)) => {
                return Err(RecordError::OtherColumns {
                    file: file.path.clone(),
                    found: columns.to_string(),
                    first_file: (*first_file).to_owned(),
                    expected: expected.to_string(),
                });
            }
        }
    }
    Ok(first.map(|(_, columns)| columns))
}
