//! What can be wrong with a recording, or with a MATLAB file.
//!
//! Readers put in the file, the position and what they found there; a sentence comes out that names them and says what to do.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use super::clock::{UNIX_S, unix_ns};
use super::hdf5::Hdf5Error;

/// A position in a file of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePosition {
    /// The file.
    pub file: PathBuf,
    /// Where in the file.
    pub at: At,
}

/// A position in a file, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum At {
    /// A line of a text file, as an editor counts it.
    Line(u64),
    /// A row of samples of a binary file.
    Row(u64),
    /// A dataset of a universal file.
    Dataset(u64),
}

impl FilePosition {
    pub(super) fn line(file: &Path, line: u64) -> Self {
        Self { file: file.to_owned(), at: At::Line(line) }
    }

    pub(super) fn row(file: &Path, row: u64) -> Self {
        Self { file: file.to_owned(), at: At::Row(row) }
    }
}

impl fmt::Display for FilePosition {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.at {
            At::Line(line) => write!(formatter, "{}, line {line}", self.file.display()),
            At::Row(row) => write!(formatter, "{}, row {row}", self.file.display()),
            At::Dataset(dataset) => write!(formatter, "{}, dataset {dataset}", self.file.display()),
        }
    }
}

/// Why a recording could not be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what each field is
pub enum RecordError {
    #[error("setup `{setup}` has no sensors: add a [[setup.sensor]] for each channel to read")]
    NoSensors { setup: String },
    #[error("setup `{setup}` names no files: give `files`, such as files = [\"record_*.txt\"]")]
    NoFiles { setup: String },
    #[error(
        "setup `{setup}` has a sampling rate of {sampling_rate_hz} Hz: expected a positive number of rows a second"
    )]
    SamplingRate { setup: String, sampling_rate_hz: f64 },
    #[error(
        "channel `{channel}` is recorded in volts, but its sensor has no usable sensitivity: give the sensor its sensitivity in V/(m/s²), not zero"
    )]
    NoSensitivity { channel: String },
    #[error("file pattern `{pattern}` cannot be read: {reason}")]
    Pattern { pattern: String, reason: String },
    #[error(
        "no file matches `{pattern}` in {folder}: check `files` of the setup; patterns start at the study's folder"
    )]
    NothingMatches { pattern: String, folder: PathBuf },
    #[error("{file} is named twice by the setup's `files`: its rows would count twice, so make the patterns disjoint")]
    FileTwice { file: PathBuf },
    #[error(
        "{file}: the ending says nothing about the format: expected .txt, .asc or .dat (white space, TOA5, UDBF), .csv, .npy, .mat, .parquet, .uff or .unv, .h5, .hdf5 or .hdf, .wav or .rf64, .sac, .mseed or .miniseed (.msd and .seed where they hold that), .tdms or .udbf; rename the file where it is of one of these formats, or export the recording from your program as CSV"
    )]
    UnknownEnding { file: PathBuf },
    #[error("{file} cannot be read: {source}")]
    Io { file: PathBuf, source: io::Error },
    #[error(
        "{file} is empty: expected at least one row of samples, so take the file out of the setup's `files` or restore it"
    )]
    Empty { file: PathBuf },
    #[error(
        "{file} has {found}, but the setup's first file {first_file} has {expected}: all files of one setup must have the same columns"
    )]
    OtherColumns { file: PathBuf, found: String, first_file: PathBuf, expected: String },
    #[error("{file} has no channel `{channel}`: it has {available}; correct `channel` of the sensor")]
    UnknownChannel { file: PathBuf, channel: String, available: String },
    #[error(
        "{file} has more than one column named `{channel}`: rename them so that the sensor's channel is one of them"
    )]
    AmbiguousChannel { file: PathBuf, channel: String },
    #[error(
        "{file} has other channels than another logger's file of this setup, and does not say when it begins in UTC: give the setup `utc_offset_h` where a TOA5 or Parquet file has times without a zone, a table a column of seconds since 1970, or make two setups"
    )]
    LoggerWithoutTime { file: PathBuf },
    #[error(
        "{file} has a channel `{channel}`, as another logger's file of this setup has: rename one of them, or make two setups"
    )]
    AmbiguousLogger { file: PathBuf, channel: String },
    #[error(
        "{file} begins {late_s:.0} s after the setup's first file: filling that would take more than {limit} rows; make two setups"
    )]
    LoggerTooLate { file: PathBuf, late_s: f64, limit: u64 },
    #[error(
        "{position}: {found} values, but the rows before it (or the header) have {expected}: complete or remove the line; a missing sample is written NaN"
    )]
    Ragged { position: FilePosition, expected: usize, found: usize },
    #[error("{position}, channel `{channel}`: `{text}` is not a number: {hint}")]
    NotANumber { position: FilePosition, channel: String, text: String, hint: &'static str },
    #[error("{position}: longer than {limit} bytes: expected one row of numbers a line; is this a text file?")]
    LineTooLong { position: FilePosition, limit: usize },
    #[error("{position}: a quote is not closed on its line: cells of a recording must not run over several lines")]
    OpenQuote { position: FilePosition },
    #[error(
        "{position}: the rows follow each other at {measured_hz:.4} Hz by the time column `{column}`, but the setup's sampling_rate_hz is {stated_hz}: correct sampling_rate_hz, or the column where it is not in seconds"
    )]
    RateDiffers { position: FilePosition, column: String, measured_hz: f64, stated_hz: f64 },
    #[error(
        "{position}: time column `{column}` holds `{text}`: only seconds as plain numbers are read; convert the column, or rename it (to `clock`, say) to go by sampling_rate_hz alone"
    )]
    TimeNotSeconds { position: FilePosition, column: String, text: String },
    #[error(
        "{position}: time goes from {} to {}: it must advance with every row; {}put rows and files in the order of time, or rename the time column to go by sampling_rate_hz alone", clock_time(*previous_s), clock_time(*time_s), set_back(time_s - previous_s)
    )]
    TimeBackwards { position: FilePosition, previous_s: f64, time_s: f64 },
    #[error(
        "{position}: time jumps from {} to {}: filling the gap would take the recording beyond {limit} filled rows; make two setups of the parts, or correct the times (files recorded now and then on purpose are joined by `block_s`)", clock_time(*previous_s), clock_time(*time_s)
    )]
    GapTooLong { position: FilePosition, previous_s: f64, time_s: f64, limit: u64 },
    #[error(
        "{file} is cut short: {expected} bytes of numbers announced, {found} there; copy the file again, or cut the shape in its header"
    )]
    Truncated { file: PathBuf, expected: u64, found: u64 },
    #[error(
        "{file} holds numbers of type `{found}`: expected real numbers (f4, f8 or integers of 1 to 8 bytes); convert with numpy's astype('<f8')"
    )]
    WrongDtype { file: PathBuf, found: String },
    #[error(
        "{file} holds complex numbers (`{found}`): expected real ones (f4, f8 or integers of 1 to 8 bytes); where the imaginary parts are zero, save the real ones alone, with numpy's real.astype('<f8')"
    )]
    ComplexNumbers { file: PathBuf, found: String },
    #[error("{file} is not a NumPy array file: {reason}; save it again with numpy.save")]
    NpyHeader { file: PathBuf, reason: String },
    #[error("{file} holds an array of shape {shape}: expected rows × channels (or one channel)")]
    Shape { file: PathBuf, shape: String },
    #[error("{file} cannot be read as Parquet: {reason}; write or copy the recording again")]
    Parquet { file: PathBuf, reason: String },
    #[error(
        "{file}, channel `{channel}`: the column holds {found}, where FLOAT, DOUBLE or plain integers were expected; convert the column"
    )]
    ParquetType { file: PathBuf, channel: String, found: String },
    #[error("{position}: {reason}")]
    Uff { position: FilePosition, reason: String },
    #[error(
        "{file} has no time response (dataset 58, function type 1): it has {found}; export the time histories of the measurement"
    )]
    NoTimeResponse { file: PathBuf, found: String },
    #[error(
        "{file}, channel `{channel}`: the samples are {found} by the dataset's ordinate, which the setup's unit contradicts: correct `unit`, or name another channel"
    )]
    UffOrdinate { file: PathBuf, channel: String, found: &'static str },
    #[error(
        "{file}, channel `{channel}`: the samples follow each other at {measured_hz:.4} Hz by the dataset's abscissa, but the setup's sampling_rate_hz is {stated_hz}: correct sampling_rate_hz"
    )]
    UffRate { file: PathBuf, channel: String, measured_hz: f64, stated_hz: f64 },
    #[error(
        "{file}, channel `{channel}`: {rows} samples, where the setup's first channel has {expected}: channels of one setup must be equally long; cut the longer ones, or leave the sensor out of the setup"
    )]
    UffLength { file: PathBuf, channel: String, rows: u64, expected: u64 },
    #[error(
        "{file}, channel `{channel}`: starts {late_s} s after the setup's first channel: channels of one setup must start together; cut them so, or leave the sensor out of the setup"
    )]
    UffStart { file: PathBuf, channel: String, late_s: f64 },
    #[error(
        "{file}, channel `{channel}`: sampled at {measured_hz:.4} Hz by the file, but the setup's sampling_rate_hz is {stated_hz}: correct sampling_rate_hz"
    )]
    StatedRate { file: PathBuf, channel: String, measured_hz: f64, stated_hz: f64 },
    #[error("{file}: {reason}")]
    Format { file: PathBuf, reason: String },
    #[error(transparent)]
    Mat(#[from] MatError),
    #[error(transparent)]
    Hdf5(#[from] Hdf5Error),
}

impl RecordError {
    /// For `map_err` on what is done to `file`.
    pub(super) fn io(file: &Path) -> impl Fn(io::Error) -> RecordError + '_ {
        move |source| RecordError::Io { file: file.to_owned(), source }
    }

    /// A Parquet file that is damaged, by what shows it.
    pub(super) fn parquet(file: &Path, reason: impl fmt::Display) -> Self {
        RecordError::Parquet { file: file.to_owned(), reason: reason.to_string() }
    }
}

/// Why a MATLAB file's variable could not be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what each field is
pub enum MatError {
    #[error("{file} cannot be read: {source}")]
    Io { file: PathBuf, source: io::Error },
    #[error("{file} is empty: expected a MATLAB file")]
    EmptyFile { file: PathBuf },
    #[error("{file} is not a MATLAB file of version 5 or 7.3: save it again in MATLAB with save('name.mat', '-v7')")]
    NotMatlab { file: PathBuf },
    #[error(transparent)]
    Hdf5(#[from] Hdf5Error),
    #[error("{file} is cut short within {part}: copy or save the file again")]
    Truncated { file: PathBuf, part: String },
    #[error("{file}, variable `{variable}`: damaged: {reason}; copy or save the file again")]
    Damaged { file: PathBuf, variable: String, reason: String },
    #[error("{file} has no variable `{variable}`: it has {available}")]
    NoVariable { file: PathBuf, variable: String, available: String },
    #[error("{file} has several matrices: say which with `variable`, one of {candidates}")]
    SeveralMatrices { file: PathBuf, candidates: String },
    #[error("{file} has no matrix of real numbers: it has {available}")]
    NoMatrix { file: PathBuf, available: String },
    #[error(
        "{file}, variable `{variable}` is of class {found}: expected a full matrix of real numbers (double, single or integer)"
    )]
    NotNumeric { file: PathBuf, variable: String, found: String },
    #[error("{file}, variable `{variable}` is complex: expected real numbers, so save its real part")]
    Complex { file: PathBuf, variable: String },
    #[error("{file}, variable `{variable}` is {dimensions}: expected two dimensions")]
    Shape { file: PathBuf, variable: String, dimensions: String },
    #[error("{file}, variable `{variable}` is empty: expected at least one row of samples")]
    Empty { file: PathBuf, variable: String },
    #[error("{file}, variable `{variable}` of {rows} × {columns} does not fit memory as a full matrix")]
    TooLarge { file: PathBuf, variable: String, rows: u64, columns: u64 },
}

impl MatError {
    /// For `map_err` on what is done to `file`.
    pub(super) fn io(file: &Path) -> impl Fn(io::Error) -> MatError + '_ {
        move |source| MatError::Io { file: file.to_owned(), source }
    }

    /// For `map_err` on what is read of `part` of `file`: the end of the file there is the file's fault.
    pub(super) fn reading<'a>(file: &'a Path, part: &'a str) -> impl Fn(io::Error) -> MatError + 'a {
        move |source| match source.kind() {
            io::ErrorKind::UnexpectedEof => MatError::Truncated { file: file.to_owned(), part: part.to_owned() },
            io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput => {
                MatError::Damaged { file: file.to_owned(), variable: part.to_owned(), reason: source.to_string() }
            }
            _ => MatError::Io { file: file.to_owned(), source },
        }
    }
}

/// A cell's text as an error quotes it: printable and short, whatever the file holds.
pub(crate) fn quoted(cell: &[u8]) -> String {
    const LONGEST: usize = 40;
    let text = String::from_utf8_lossy(cell.get(..LONGEST).unwrap_or(cell));
    let ellipsis = if cell.len() > LONGEST { "…" } else { "" };
    format!("{}{ellipsis}", text.escape_debug())
}

/// A time as a column has it: in seconds, and of the calendar where these are counted from 1970.
fn clock_time(time_s: f64) -> String {
    const LONGEST: usize = 24;
    if !UNIX_S.contains(&time_s) {
        // A damaged number may have 300 digits unless it has an exponent.
        let plain = time_s.to_string();
        return if plain.len() > LONGEST { format!("{time_s:e} s") } else { format!("{plain} s") };
    }
    let time = std::time::UNIX_EPOCH + std::time::Duration::from_nanos(unix_ns(time_s).unsigned_abs());
    humantime::format_rfc3339_micros(time).to_string().trim_end_matches('Z').replace('T', " ")
}

/// What to do where a clock was set back by an hour.
fn set_back(step_s: f64) -> &'static str {
    if is_summer_time(-step_s) {
        "a clock that is set back from summer time does this, so let loggers keep to winter time or UTC; of this file make two setups; or "
    } else {
        ""
    }
}

/// Whether a step in time is the hour by which clocks are moved for summer.
pub(super) fn is_summer_time(step_s: f64) -> bool {
    const WITHIN_S: f64 = 5.0;
    (step_s - 3600.0).abs() <= WITHIN_S
}

/// Things as an error lists them: as many as one reads, each short, and how many more there are.
pub(crate) fn listed<T: fmt::Display>(things: impl IntoIterator<Item = T>, around: &str) -> String {
    const LONGEST: usize = 300;
    const LONGEST_OF_ONE: usize = 60;
    let mut list = String::new();
    let mut things = things.into_iter();
    while list.len() < LONGEST {
        let Some(thing) = things.next() else { return list };
        let thing = thing.to_string();
        let mut rest = thing.char_indices().skip(LONGEST_OF_ONE);
        let shown = match rest.next() {
            Some((end, _)) => &format!("{}…", thing.get(..end).unwrap_or_default()),
            None => &thing,
        };
        let comma = if list.is_empty() { "" } else { ", " };
        list.push_str(&format!("{comma}{around}{shown}{around}"));
    }
    match things.count() {
        0 => list,
        more => format!("{list} and {more} more"),
    }
}

#[cfg(test)]
mod tests {
    use super::listed;

    #[test]
    fn lists_end_where_nobody_reads_on() {
        assert_eq!(listed(["x", "y"], "`"), "`x`, `y`");
        assert_eq!(listed::<&str>([], "`"), "");
        let names: Vec<String> = (1..=500).map(|number| format!("channel {number:03}")).collect();
        let list = listed(&names, "`");
        assert!(list.starts_with("`channel 001`, `channel 002`"), "{list}");
        assert!(list.ends_with("`channel 020`, `channel 021` and 479 more") && list.len() < 400, "{list}");
        let long = "ü".repeat(400);
        assert_eq!(listed([&long], "`"), format!("`{}…`", "ü".repeat(60)));
    }
}
