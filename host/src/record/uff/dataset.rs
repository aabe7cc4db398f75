//! The datasets of a universal file: where each time response's numbers stand, and what its header says about them.
//!
//! The format is that of SDRC's universal file datasets: between lines of `-1` a dataset, its number first. A dataset 58
//! has eleven lines of header (records 1 to 11) and its numbers; a 58b says in its first line how many bytes they take.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use crate::numbers::fortran;
use crate::record::array::Sample;
use crate::record::error::{At, FilePosition, RecordError, listed, quoted};
use crate::record::response_name::ResponseName;

/// Specific data types, of record 9.
pub(super) const UNKNOWN: i64 = 0;
pub(super) const DISPLACEMENT: i64 = 8;
pub(super) const VELOCITY: i64 = 11;
pub(super) const ACCELERATION: i64 = 12;
/// The specific data type of an abscissa in seconds, of record 8.
const TIME: i64 = 17;
/// Function types, of record 6.
const GENERAL: i64 = 0;
const TIME_RESPONSE: i64 = 1;
/// IEEE 754, of a 58b's first line.
const IEEE: i64 = 2;
const LITTLE_ENDIAN: i64 = 1;
const BIG_ENDIAN: i64 = 2;
/// Lines of text between a dataset's first line and its numbers.
const HEADER_LINES: usize = 11;
/// No line of a universal file is longer; binary numbers taken for text are.
const LONGEST_LINE: u64 = 1 << 16;

/// One channel of a recording.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimeResponse {
    pub(super) name: ResponseName,
    /// Specific data type of the ordinate.
    pub(super) ordinate: i64,
    /// How precise the numbers are; how they are stored, in a 58b.
    pub(super) sample: Sample,
    /// Numbers there are.
    pub(super) count: u64,
    pub(super) start_s: f64,
    pub(super) step_s: f64,
    pub(super) data: Data,
}

/// Where a response's numbers stand in the file, in bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Data {
    Text { start: u64, end: u64 },
    Binary { offset: u64, big_endian: bool },
}

/// The kind of motion that an ordinate's specific data type stands for, if any.
pub(super) fn motion(ordinate: i64) -> Option<&'static str> {
    match ordinate {
        DISPLACEMENT => Some("displacement"),
        9 | 13 => Some("force"),
        VELOCITY => Some("velocity"),
        ACCELERATION => Some("acceleration"),
        _ => None,
    }
}

/// All time responses of a file of so many bytes, in its order; other datasets and functions are passed over.
pub(super) fn time_responses(path: &Path, file: &mut File, bytes: u64) -> Result<Vec<TimeResponse>, RecordError> {
    let mut scanner = Scanner {
        path,
        reader: BufReader::with_capacity(1 << 18, file),
        bytes,
        offset: 0,
        line: Vec::new(),
        dataset: 0,
    };
    let mut responses = Vec::new();
    let mut others: Vec<String> = Vec::new();
    while scanner.next_line()? {
        if !scanner.at_mark() {
            continue;
        }
        if !scanner.next_line()? {
            break;
        }
        scanner.dataset += 1;
        match scanner.response()? {
            Ok(response) => responses.push(response),
            Err(other) => others.push(other),
        }
    }
    if responses.is_empty() {
        let found = if others.is_empty() { "no datasets".to_owned() } else { listed(others, "") };
        return Err(RecordError::NoTimeResponse { file: path.to_owned(), found });
    }
    Ok(responses)
}

/// Goes through a file line by line, and over binary numbers.
struct Scanner<'a> {
    path: &'a Path,
    reader: BufReader<&'a mut File>,
    bytes: u64,
    /// Of the byte after the line reached.
    offset: u64,
    line: Vec<u8>,
    /// The dataset reached, from 1.
    dataset: u64,
}

impl Scanner<'_> {
    /// Goes to the next line; false at the end of the file.
    fn next_line(&mut self) -> Result<bool, RecordError> {
        self.line.clear();
        let mut limited = (&mut self.reader).take(LONGEST_LINE);
        let read = limited.read_until(b'\n', &mut self.line).map_err(RecordError::io(self.path))? as u64;
        self.offset += read;
        if read == LONGEST_LINE {
            return Err(self.fault(format!("a line is longer than {LONGEST_LINE} bytes; is it a universal file?")));
        }
        Ok(read > 0)
    }

    /// Whether the line reached begins or ends a dataset.
    fn at_mark(&self) -> bool {
        self.line.trim_ascii() == b"-1"
    }

    fn fault(&self, reason: String) -> RecordError {
        let position = FilePosition { file: self.path.to_owned(), at: At::Dataset(self.dataset.max(1)) };
        RecordError::Uff { position, reason }
    }

    /// Goes to the next line, which a header needs.
    fn header_line(&mut self, what: &str) -> Result<String, RecordError> {
        if !self.next_line()? {
            return Err(self.fault(format!("the file is cut off within the header, before {what}")));
        }
        if self.at_mark() {
            return Err(self.fault(format!("it ends within its header, before {what}")));
        }
        Ok(String::from_utf8_lossy(&self.line).trim_end().to_owned())
    }

    /// Goes over the lines up to the end of the dataset; the offset of the line that ends it.
    fn skip_to_mark(&mut self) -> Result<u64, RecordError> {
        loop {
            let before = self.offset;
            if !self.next_line()? {
                return Err(self.fault("the file is cut off: the line -1 that ends the dataset is missing".to_owned()));
            }
            if self.at_mark() {
                return Ok(before);
            }
        }
    }

    /// Reads the dataset whose first line is reached, to its end; what it is, where it is no time response.
    fn response(&mut self) -> Result<Result<TimeResponse, String>, RecordError> {
        let kind = String::from_utf8_lossy(&self.line).trim().to_owned();
        // `58` and the 58b's fields may touch: I6, A1, then I6, I6, I12, I12.
        let mut words = kind.split_whitespace();
        let number = words.next().unwrap_or("");
        let binary = match number {
            "58" => match words.next() {
                Some("b" | "B") => true,
                None => false,
                Some(_) => return Err(self.fault(format!("its first line is `{}`", quoted(kind.as_bytes())))),
            },
            "58b" | "58B" => true,
            _ => {
                self.skip_to_mark()?;
                return Ok(Err(format!("dataset {}", quoted(number.as_bytes()))));
            }
        };
        let storage = if binary { Some(self.storage(&mut words)?) } else { None };
        let header = self.header(storage.as_ref().map_or(HEADER_LINES, |storage| storage.header_lines))?;
        let data = match &storage {
            None => {
                let start = self.offset;
                Data::Text { start, end: self.skip_to_mark()? }
            }
            Some(storage) => self.binary(storage, &header)?,
        };
        let is_time = header.function == TIME_RESPONSE || (header.function == GENERAL && header.abscissa == TIME);
        if !is_time {
            return Ok(Err(format!("a function of type {}", header.function)));
        }
        let sample = match header.data_type {
            2 => Sample::F32,
            4 => Sample::F64,
            other => {
                return Err(
                    self.fault(format!("its numbers are of type {other}, where real ones (2 or 4) were expected"))
                );
            }
        };
        if header.spacing != 1 {
            return Err(self.fault("its samples are spaced unevenly; resample the recording evenly".to_owned()));
        }
        Ok(Ok(TimeResponse {
            name: header.name,
            ordinate: header.ordinate,
            sample,
            count: header.count,
            start_s: header.start_s,
            step_s: header.step_s,
            data,
        }))
    }

    /// What a 58b's first line says, after its number.
    fn storage<'w>(&self, words: &mut impl Iterator<Item = &'w str>) -> Result<Storage, RecordError> {
        let mut next = |what: &str| {
            let number = words.next().and_then(|word| word.parse::<i64>().ok());
            number.ok_or_else(|| self.fault(format!("its first line does not give {what}")))
        };
        let (order, format) = (next("the order of bytes")?, next("the format of numbers")?);
        let (lines, bytes) = (next("the number of header lines")?, next("the number of bytes")?);
        if format != IEEE {
            return Err(self.fault(format!(
                "its numbers are of the floating-point format {format}, where IEEE 754 ({IEEE}) was expected; convert the file to text"
            )));
        }
        let big_endian = match order {
            LITTLE_ENDIAN => false,
            BIG_ENDIAN => true,
            _ => return Err(self.fault(format!("the order of its bytes is {order}, where 1 or 2 was expected"))),
        };
        let header_lines = usize::try_from(lines).ok().filter(|lines| (HEADER_LINES..=100).contains(lines));
        let header_lines =
            header_lines.ok_or_else(|| self.fault(format!("{lines} header lines, where 11 were expected")))?;
        let bytes = u64::try_from(bytes).map_err(|_| self.fault(format!("{bytes} bytes of numbers")))?;
        Ok(Storage { big_endian, header_lines, bytes })
    }

    /// Goes over a 58b's numbers to the end of the dataset.
    fn binary(&mut self, storage: &Storage, header: &Header) -> Result<Data, RecordError> {
        let offset = self.offset;
        let needed =
            header.bytes().ok_or_else(|| self.fault(format!("{} numbers do not fit any file", header.count)))?;
        if storage.bytes < needed {
            let (count, bytes) = (header.count, storage.bytes);
            return Err(
                self.fault(format!("{count} numbers take {needed} bytes, but its first line announces {bytes}"))
            );
        }
        let there = self.bytes.saturating_sub(offset);
        if there < storage.bytes {
            return Err(self.fault(format!(
                "the file is cut short: {} bytes of samples announced, {there} there; copy the file again",
                storage.bytes
            )));
        }
        self.offset = offset + storage.bytes;
        self.reader.seek(SeekFrom::Start(self.offset)).map_err(RecordError::io(self.path))?;
        // Some writers break the line after the numbers, some do not.
        loop {
            if !self.next_line()? {
                return Err(self.fault("the file is cut off: the line -1 that ends the dataset is missing".to_owned()));
            }
            if self.at_mark() {
                return Ok(Data::Binary { offset, big_endian: storage.big_endian });
            }
            if !self.line.trim_ascii().is_empty() {
                return Err(self.fault(format!(
                    "it does not end after the {} bytes that its first line announces",
                    storage.bytes
                )));
            }
        }
    }

    /// Records 1 to 11.
    fn header(&mut self, lines: usize) -> Result<Header, RecordError> {
        let title = self.header_line("its title")?;
        for _ in 0..4 {
            self.header_line("the end of its text")?;
        }
        let line = self.header_line("record 6, its function and node")?;
        let identity = identity(&line).ok_or_else(|| {
            self.fault(format!(
                "record 6 is `{}`, where function, node and direction were expected",
                quoted(line.as_bytes())
            ))
        })?;
        let line = self.header_line("record 7, its length and spacing")?;
        let shape = shape(&line).ok_or_else(|| {
            self.fault(format!(
                "record 7 is `{}`, where type, number of samples, spacing, start and step were expected",
                quoted(line.as_bytes())
            ))
        })?;
        let kind = |line: &str| line.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or(UNKNOWN);
        let abscissa = kind(&self.header_line("record 8, its abscissa")?);
        let ordinate = kind(&self.header_line("record 9, its ordinate")?);
        for _ in 9..lines {
            self.header_line("the end of its header")?;
        }
        let [data_type, count, spacing] = shape.0;
        let [start_s, step_s] = shape.1;
        Ok(Header {
            function: identity.0,
            name: ResponseName::new(identity.1, identity.2, title.trim()),
            data_type,
            count: u64::try_from(count).map_err(|_| self.fault(format!("it announces {count} samples")))?,
            spacing,
            start_s,
            step_s,
            abscissa,
            ordinate,
        })
    }
}

/// What a 58b's first line says.
struct Storage {
    big_endian: bool,
    header_lines: usize,
    bytes: u64,
}

/// What a dataset 58's header says.
struct Header {
    function: i64,
    name: ResponseName,
    data_type: i64,
    count: u64,
    spacing: i64,
    start_s: f64,
    step_s: f64,
    abscissa: i64,
    ordinate: i64,
}

impl Header {
    /// Bytes of the numbers of a real, evenly spaced function; less than any other function's.
    fn bytes(&self) -> Option<u64> {
        let sample = if matches!(self.data_type, 2 | 5) { Sample::F32 } else { Sample::F64 };
        self.count.checked_mul(sample.bytes() as u64)
    }
}

/// Function type, response node and response direction of record 6.
///
/// The record's format is 2(I5,I10), 2(1X,10A1,I10,I4). Entity names may hold blanks or nothing, so that columns are tried
/// first; words, for writers that do not keep to them.
fn identity(line: &str) -> Option<(i64, i64, i64)> {
    let field = |from: usize, to: usize| line.get(from..to.min(line.len()))?.trim().parse::<i64>().ok();
    let by_columns = || Some((field(0, 5)?, field(41, 51)?, field(51, 55)?));
    let by_words = || {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |index: usize| words.get(index)?.parse().ok();
        (words.len() == 10).then(|| Some((number(0)?, number(5)?, number(6)?)))?
    };
    by_columns().or_else(by_words)
}

/// Data type, count and spacing; start and step of record 7, whose format is 3I10, 3E13.5.
fn shape(line: &str) -> Option<([i64; 3], [f64; 2])> {
    let real = |text: &str| fortran(text.trim()).filter(|number| number.is_finite());
    let words: Vec<&str> = line.split_whitespace().collect();
    let by_words = || {
        let whole = |index: usize| words.get(index)?.parse::<i64>().ok();
        let real = |index: usize| real(words.get(index)?);
        Some(([whole(0)?, whole(1)?, whole(2)?], [real(3)?, real(4)?]))
    };
    let by_columns = || {
        let field = |from: usize, to: usize| line.get(from..to.min(line.len()));
        let whole = |from: usize, to: usize| field(from, to)?.trim().parse::<i64>().ok();
        Some(([whole(0, 10)?, whole(10, 20)?, whole(20, 30)?], [real(field(30, 43)?)?, real(field(43, 56)?)?]))
    };
    by_words().or_else(by_columns)
}
