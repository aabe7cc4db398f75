//! What a segment of a TDMS file says of an object: how its numbers stand, and its properties.

use std::collections::HashMap;

use crate::record::array::{Sample, whole_number};
use crate::record::error::quoted;

/// No numbers in this segment; numbers as before.
const NO_DATA: u32 = u32::MAX;
const AS_BEFORE: u32 = 0;
const FORMAT_CHANGING: u32 = 0x1269;
const DIGITAL_LINE: u32 = 0x126a;
const TEXT: u32 = 0x20;
const TIMESTAMP: u32 = 0x44;
/// Raw numbers of a channel, or cards of a segment.
const MOST_OF_DAQMX: u32 = 1 << 10;

/// Fields of metadata, one after the other; `None` where it ends too early.
pub(super) struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    pub(super) fn word(&mut self) -> Option<u32> {
        Some(whole_number(self.take(4)?, false) as u32)
    }

    pub(super) fn long(&mut self) -> Option<u64> {
        Some(whole_number(self.take(8)?, false))
    }

    pub(super) fn text(&mut self) -> Option<String> {
        let length = self.word()? as usize;
        Some(String::from_utf8_lossy(self.take(length)?).into_owned())
    }
}

/// How a channel's numbers stand in a segment.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Index {
    pub(super) kind: Kind,
    /// Numbers in a chunk.
    pub(super) count: u64,
    /// Bytes that they take, where one channel stands after the other.
    pub(super) bytes: u64,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Kind {
    Numbers(Sample),
    /// The last of so many raw numbers of a sample, and the bytes of each card's rows.
    Daqmx {
        scaler: Scaler,
        scalers: u32,
        widths: Vec<u64>,
    },
    /// In words.
    Other(&'static str),
}

/// A raw number of DAQmx: which card's, and where in its row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scaler {
    pub(super) sample: Sample,
    pub(super) buffer: usize,
    pub(super) offset: u64,
    pub(super) id: u32,
}

impl Index {
    pub(super) fn sample(&self) -> Option<Sample> {
        match self.kind {
            Kind::Numbers(sample) => Some(sample),
            _ => None,
        }
    }
}

/// The property that says when a channel's first sample was.
pub(super) const START_TIME: &str = "wf_start_time";
/// The property with the time from there to the first number, in s.
pub(super) const START_OFFSET: &str = "wf_start_offset";

/// What a property says.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Property {
    Number(f64),
    Text(String),
    /// In nanoseconds since 1970, UTC.
    Moment(i64),
}

impl Property {
    pub(super) fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Text(_) | Self::Moment(_) => None,
        }
    }

    pub(super) fn moment(&self) -> Option<i64> {
        match self {
            Self::Moment(ns) => Some(*ns),
            Self::Text(_) | Self::Number(_) => None,
        }
    }

    pub(super) fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            Self::Number(_) | Self::Moment(_) => None,
        }
    }
}

/// A moment as NI writes it: parts of 2^-64 s, then seconds since 1904. In nanoseconds since 1970; `None` centuries away.
fn moment(parts: u64, seconds: i64) -> Option<i64> {
    const FROM_1904_S: i64 = 2_082_844_800;
    let ns = (u128::from(parts) * 1_000_000_000) >> 64;
    seconds.checked_sub(FROM_1904_S)?.checked_mul(1_000_000_000)?.checked_add(ns as i64)
}

/// How numbers of a type are stored, by NI's number of it.
fn sample_of(kind: u32) -> Option<Sample> {
    Some(match kind {
        1 => Sample::I8,
        2 => Sample::I16,
        3 => Sample::I32,
        4 => Sample::I64,
        5 => Sample::U8,
        6 => Sample::U16,
        7 => Sample::U32,
        8 => Sample::U64,
        9 | 0x19 => Sample::F32,
        10 | 0x1a => Sample::F64,
        _ => return None,
    })
}

/// Reads an object behind its path; whether it has numbers in this segment.
///
/// # Errors
/// A sentence.
pub(super) fn read_object(
    fields: &mut Fields<'_>,
    index: &mut Option<Index>,
    properties: &mut HashMap<String, Property>,
) -> Result<bool, String> {
    const SHORT: &str = "its metadata ends too early";
    let head = fields.word().ok_or(SHORT)?;
    match head {
        NO_DATA => {}
        AS_BEFORE if index.is_some() => {}
        AS_BEFORE => return Err("its numbers stand as before, and nothing stood before".to_owned()),
        FORMAT_CHANGING | DIGITAL_LINE => *index = Some(daqmx(fields, head).ok_or(SHORT)??),
        _ => *index = Some(plain(fields, head).ok_or(SHORT)??),
    }
    let count = fields.word().ok_or(SHORT)?;
    for _ in 0..count {
        let (name, kind) = (fields.text().ok_or(SHORT)?, fields.word().ok_or(SHORT)?);
        let property = match (kind, sample_of(kind)) {
            (TEXT, _) => Some(Property::Text(fields.text().ok_or(SHORT)?)),
            (TIMESTAMP, _) => {
                let (parts, seconds) = (fields.long().ok_or(SHORT)?, fields.long().ok_or(SHORT)?);
                moment(parts, seconds.cast_signed()).map(Property::Moment)
            }
            (0x21, _) => {
                fields.take(1).ok_or(SHORT)?;
                None
            }
            (_, Some(sample)) => {
                let mut raw = fields.take(sample.bytes()).ok_or(SHORT)?.to_vec();
                sample.decode_all(&mut raw, false).first().map(|number| Property::Number(*number))
            }
            _ => return Err(format!("its property `{}` is of type {kind:#x}", quoted(name.as_bytes()))),
        };
        // Those that say how to read it; a file may have thousands of others.
        let is_used = matches!(name.as_str(), "wf_increment" | "unit_string" | START_OFFSET) || name.starts_with("NI_");
        match property {
            Some(property) if is_used => drop(properties.insert(name, property)),
            // A recorder that writes it with every segment may say when that began.
            Some(property) if name == START_TIME => drop(properties.entry(name).or_insert(property)),
            _ => {}
        }
    }
    Ok(head != NO_DATA)
}

fn plain(fields: &mut Fields<'_>, length: u32) -> Option<Result<Index, String>> {
    if !matches!(length, 20 | 28) {
        return Some(Err(format!("its numbers are described in {length} bytes, where 20 or 28 were expected")));
    }
    let (kind, dimensions, count) = (fields.word()?, fields.word()?, fields.long()?);
    let announced = if length == 28 { Some(fields.long()?) } else { None };
    if dimensions != 1 {
        return Some(Err(format!("its numbers have {dimensions} dimensions")));
    }
    let of_size = |size: u64| count.checked_mul(size);
    let (kind, bytes) = match (kind, sample_of(kind)) {
        (_, Some(sample)) => (Kind::Numbers(sample), of_size(sample.bytes() as u64)),
        (TEXT, _) => (Kind::Other("text"), announced),
        (TIMESTAMP, _) => (Kind::Other("times"), of_size(16)),
        (0x21, _) => (Kind::Other("truth values"), of_size(1)),
        (0x0008_000c, _) => (Kind::Other("complex numbers"), of_size(8)),
        (0x0010_000d, _) => (Kind::Other("complex numbers"), of_size(16)),
        (kind, _) => return Some(Err(format!("its numbers are of type {kind:#x}"))),
    };
    Some(match bytes {
        Some(bytes) => Ok(Index { kind, count, bytes }),
        None => Err(format!("{count} numbers do not fit any file")),
    })
}

fn daqmx(fields: &mut Fields<'_>, head: u32) -> Option<Result<Index, String>> {
    let (_, dimensions, count, scalers) = (fields.word()?, fields.word()?, fields.long()?, fields.word()?);
    if dimensions != 1 || !(1..=MOST_OF_DAQMX).contains(&scalers) {
        return Some(Err(format!("{scalers} raw numbers a sample, of {dimensions} dimensions")));
    }
    let mut last = None;
    for _ in 0..scalers {
        let (kind, buffer, offset) = (fields.word()?, fields.word()? as usize, u64::from(fields.word()?));
        // The form of a line's bits is a byte.
        fields.take(if head == DIGITAL_LINE { 1 } else { 4 })?;
        let id = fields.word()?;
        let offset = if head == DIGITAL_LINE { offset / 8 } else { offset };
        let sample = match kind {
            0 => Some(Sample::U8),
            1 => Some(Sample::I8),
            2 => Some(Sample::U16),
            3 => Some(Sample::I16),
            4 => Some(Sample::U32),
            5 => Some(Sample::I32),
            6 => Some(Sample::U64),
            7 => Some(Sample::I64),
            8 => Some(Sample::F32),
            9 => Some(Sample::F64),
            _ => None,
        };
        last = sample.map(|sample| Scaler { sample, buffer, offset, id });
    }
    let cards = fields.word()?;
    if cards > MOST_OF_DAQMX {
        return Some(Err(format!("raw numbers of {cards} cards")));
    }
    let widths = (0..cards).map(|_| fields.word().map(u64::from)).collect::<Option<Vec<u64>>>()?;
    Some(match last {
        Some(scaler) => Ok(Index { kind: Kind::Daqmx { scaler, scalers, widths }, count, bytes: 0 }),
        None => Err("raw numbers of an unknown type".to_owned()),
    })
}
