//! miniSEED recordings of versions 2 and 3: records of one channel each, in any order, of one file or several.
//!
//! Formats are those of the "SEED Reference Manual" 2.4 and of the FDSN's "miniSEED 3". Heads of records are read on opening, some 150 bytes kept of
//! each; samples when rows reach them. Of both compressions of Steim and of plain numbers.

use std::io::{BufReader, Read};
use std::path::Path;

use super::array::{Sample, Source, whole_number};
use super::channels::{Form, wrong_form};
use super::error::RecordError;
use super::files::open_file;
use super::steim::Steim;
use super::traces::{Piece, Traces, unix_ns};

/// The shortest record; heads with their blockettes are in its first part.
const SHORTEST: u64 = 64;
/// So much of a record's start is looked at.
const HEAD_BYTES: u64 = 256;
const LONGEST: u64 = 1 << 20;

/// What a record's head says.
struct Record {
    name: String,
    start_ns: i64,
    rate_hz: f64,
    count: u64,
    encoding: u8,
    big_endian: bool,
    /// Bytes of the record, and of its first sample and those behind it.
    bytes: u64,
    data: [u64; 2],
}

/// The channel and the start, in ns of Unix time, of a record of version 2 that is as long as it says; `None` of anything else.
pub(crate) fn head(bytes: &[u8]) -> Option<(String, i64)> {
    let record = version_2(bytes).filter(|record| record.bytes == bytes.len() as u64)?;
    Some((record.name, record.start_ns))
}

/// Adds the records of a file to those of others.
pub(super) fn add(path: &Path, traces: &mut Traces) -> Result<(), RecordError> {
    let (file, size) = open_file(path)?;
    let source = traces.sources.len();
    let again = file.try_clone().map_err(RecordError::io(path))?;
    traces.sources.push((path.to_owned(), Source::File(again)));
    let mut reader = BufReader::with_capacity(1 << 16, file);
    let mut offset = 0;
    while offset < size {
        let wanted = HEAD_BYTES.min(size - offset);
        let mut head = vec![0; wanted as usize];
        reader.read_exact(&mut head).map_err(RecordError::io(path))?;
        let at = |reason: &str| wrong_form(path, format!("byte {offset}: {reason}"));
        let record = if head.starts_with(b"MS\x03") { version_3(&head) } else { version_2(&head) };
        let Some(record) = record else { return at("no record of miniSEED 2 or 3 starts here; copy the file again") };
        if !(SHORTEST..=LONGEST).contains(&record.bytes) || record.data[1] > record.bytes {
            return at(&format!("a record of {} bytes", record.bytes));
        }
        if record.bytes > size - offset {
            return at(&format!("the file is cut short: its last record has {} bytes", record.bytes));
        }
        let [from, length] = record.data;
        let start = offset + from;
        if let Some(form) = form(&record, start).filter(|_| record.count > 0) {
            let needed = match form {
                Form::Plain { stride, .. } => record.count.saturating_mul(stride),
                // A frame of 64 bytes holds 105 differences at most.
                Form::Steim { .. } => record.count.div_ceil(105).saturating_mul(64),
            };
            if needed > length {
                return at(&format!("a record of {} samples in {length} bytes", record.count));
            }
            let name = traces.name(&record.name);
            let Record { start_ns, rate_hz, count, .. } = record;
            traces.push(Piece { name, start_ns, rate_hz, count, source, offset: start, form });
        } else if record.count > 0 && record.encoding != 0 {
            return at(&format!(
                "`{}` is encoded by number {}; whole numbers, floats and Steim 1 and 2 are read",
                record.name, record.encoding
            ));
        }
        offset += record.bytes;
        reader.seek_relative(record.bytes as i64 - wanted as i64).map_err(RecordError::io(path))?;
    }
    Ok(())
}

/// How its samples stand, the first at byte `start`; `None` of text, and of what is not read.
fn form(record: &Record, start: u64) -> Option<Form> {
    let sample = match record.encoding {
        1 => Sample::I16,
        3 => Sample::I32,
        4 => Sample::F32,
        5 => Sample::F64,
        10 | 11 => {
            let kind = if record.encoding == 10 { Steim::One } else { Steim::Two };
            return Some(Form::Steim { kind, bytes: record.data[1] as u32, big_endian: record.big_endian });
        }
        _ => return None,
    };
    Some(Form::packed(sample, record.big_endian, start))
}

/// Whole numbers of a record, in its order of bytes.
struct Fields<'a> {
    bytes: &'a [u8],
    big_endian: bool,
}

impl Fields<'_> {
    fn number(&self, at: usize, count: usize) -> Option<u64> {
        Some(whole_number(self.bytes.get(at..at + count)?, self.big_endian))
    }

    fn short(&self, at: usize) -> Option<i64> {
        Some(i64::from((self.number(at, 2)? as u16).cast_signed()))
    }

    fn text(&self, at: usize, count: usize) -> Option<String> {
        let text = String::from_utf8_lossy(self.bytes.get(at..at + count)?).into_owned();
        Some(text.trim().escape_debug().to_string())
    }
}

fn version_2(bytes: &[u8]) -> Option<Record> {
    const YEAR: usize = 20;
    if !matches!(bytes.get(6), Some(b'D' | b'R' | b'Q' | b'M')) {
        return None;
    }
    let is_year = |big_endian| {
        let year = Fields { bytes, big_endian }.number(YEAR, 2);
        year.is_some_and(|year| (1900..=2200).contains(&year))
    };
    let fields = Fields { bytes, big_endian: is_year(true) };
    if !fields.big_endian && !is_year(false) {
        return None;
    }
    let name = [fields.text(18, 2)?, fields.text(8, 5)?, fields.text(13, 2)?, fields.text(15, 3)?].join(".");
    let whole = |at: usize, count: usize| Some(fields.number(at, count)? as i64);
    let time = [whole(24, 1)?, whole(25, 1)?, whole(26, 1)?];
    let start_ns = unix_ns(whole(YEAR, 2)?, whole(22, 2)?, time, whole(28, 2)? * 100_000)?;
    // Ten thousandths of a second, where they are not in the time already.
    let is_corrected = fields.number(36, 1)? & 2 != 0;
    let correction = i64::from((fields.number(40, 4)? as u32).cast_signed());
    let start_ns = if is_corrected { start_ns } else { start_ns.checked_add(correction * 100_000)? };
    let [factor, multiplier] = [fields.short(32)? as f64, fields.short(34)? as f64];
    let of = |number: f64| if number < 0.0 { -number.recip() } else { number };
    let mut record = Record {
        name,
        start_ns,
        rate_hz: of(factor) * of(multiplier),
        count: fields.number(30, 2)?,
        encoding: 0,
        big_endian: fields.big_endian,
        bytes: 0,
        data: [fields.number(44, 2)?, 0],
    };
    let mut at = fields.number(46, 2)? as usize;
    // Blockettes follow each other onwards.
    while at >= 48 {
        let (kind, next) = (fields.number(at, 2)?, fields.number(at + 2, 2)? as usize);
        match kind {
            100 => record.rate_hz = f64::from(f32::from_bits(fields.number(at + 4, 4)? as u32)),
            1000 => {
                record.encoding = fields.number(at + 4, 1)? as u8;
                record.big_endian = fields.number(at + 5, 1)? != 0;
                record.bytes = 1_u64.checked_shl(fields.number(at + 6, 1)? as u32).unwrap_or(u64::MAX);
            }
            1001 => {
                let microseconds = i64::from((fields.number(at + 5, 1)? as u8).cast_signed());
                record.start_ns = record.start_ns.checked_add(microseconds * 1000)?;
            }
            _ => {}
        }
        if next <= at {
            break;
        }
        at = next;
    }
    record.data[1] = record.bytes.saturating_sub(record.data[0]);
    checked(record)
}

fn version_3(bytes: &[u8]) -> Option<Record> {
    const FIXED: u64 = 40;
    let fields = Fields { bytes, big_endian: false };
    let whole = |at: usize, count: usize| Some(fields.number(at, count)? as i64);
    let time = [whole(12, 1)?, whole(13, 1)?, whole(14, 1)?];
    let start_ns = unix_ns(whole(8, 2)?, whole(10, 2)?, time, whole(4, 4)?)?;
    let rate = f64::from_bits(fields.number(16, 8)?);
    let [name, extra, data] = [fields.number(33, 1)?, fields.number(34, 2)?, fields.number(36, 4)?];
    let identifier = fields.text(FIXED as usize, name as usize)?;
    // FDSN:NET_STA_LOC_B_S_SS, its last three letters or words being the channel.
    let parts: Vec<&str> = identifier.trim_start_matches("FDSN:").split('_').collect();
    let name_of = match parts[..] {
        [network, station, location, band, source, subsource] => {
            let is_short = [band, source, subsource].iter().all(|part| part.len() <= 1);
            let between = if is_short { "" } else { "_" };
            format!("{network}.{station}.{location}.{band}{between}{source}{between}{subsource}")
        }
        _ => identifier.clone(),
    };
    let encoding = fields.number(15, 1)? as u8;
    let from = FIXED + name + extra;
    checked(Record {
        name: name_of,
        start_ns,
        rate_hz: if rate < 0.0 { -rate.recip() } else { rate },
        count: fields.number(24, 4)?,
        encoding,
        // Numbers are little-endian, Steim's frames are not.
        big_endian: matches!(encoding, 10 | 11),
        bytes: from + data,
        data: [from, data],
    })
}

/// A record whose samples follow each other; of text there is no rate.
fn checked(record: Record) -> Option<Record> {
    let is_series = record.rate_hz.is_normal() && record.rate_hz > 0.0;
    (is_series || record.count == 0 || record.encoding == 0).then_some(record)
}
