//! WAV recordings: integers of 16, 24 and 32 bits and floating-point numbers, also longer than 4 GB (RF64, BW64).
//!
//! Integers become shares of full scale, -1 to 1, as audio programs read them; floating-point numbers stay as they are. The format is
//! Microsoft's "Multiple Channel Audio Data and WAVE Files" and EBU Tech 3306.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::array::{Sample, Source, whole_number};
use super::channels::{Channel, ChannelReader, Form, Stretch, wrong_form};
use super::error::RecordError;
use super::files::open_file;
use crate::study::Setup;

const PCM: u16 = 1;
const FLOAT: u16 = 3;
const EXTENSIBLE: u16 = 0xfffe;
/// A size that stands elsewhere, in a file longer than 4 GB.
const ELSEWHERE: u32 = u32::MAX;
/// Parts of a file that are looked at.
const MOST_PARTS: usize = 1 << 12;
const MOST_CHANNELS: u16 = 1 << 12;

/// What the part `fmt` says.
struct Format {
    sample: Sample,
    scale: f64,
    channels: u16,
    rate_hz: u32,
    /// Bytes of one sample of every channel.
    stride: u64,
}

/// Opens a file for reading row by row; its channels are numbered from 1.
pub(super) fn open(path: &Path, setup: &Setup) -> Result<ChannelReader, RecordError> {
    let (mut file, size) = open_file(path)?;
    let mut read = |offset: u64, count: u64| -> Result<Vec<u8>, RecordError> {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(offset)).map_err(RecordError::io(path))?;
        (&mut file).take(count).read_to_end(&mut bytes).map_err(RecordError::io(path))?;
        Ok(bytes)
    };
    let start = read(0, 12)?;
    let is_wave = start.get(8..12) == Some(b"WAVE");
    let is_long = match start.get(..4) {
        Some(b"RIFF") if is_wave => false,
        Some(b"RF64" | b"BW64") if is_wave => true,
        _ => return wrong_form(path, "not a WAV file: it does not start with RIFF and WAVE"),
    };
    let (mut offset, mut long_bytes, mut format) = (12, None, None);
    for _ in 0..MOST_PARTS {
        let head = read(offset, 8)?;
        let (Some(name), Some(Ok(bytes))) = (head.get(..4), head.get(4..8).map(<[u8; 4]>::try_from)) else {
            return wrong_form(path, "the file ends before its samples: copy the file again");
        };
        let announced = u32::from_le_bytes(bytes);
        let content = offset + 8;
        match name {
            b"ds64" => {
                let sizes = read(content, 16)?;
                long_bytes = sizes.get(8..16).map(|bytes| whole_number(bytes, false));
            }
            b"fmt " => format = Some(parse_format(path, &read(content, 40)?)?),
            b"data" => {
                let Some(format) = format else {
                    return wrong_form(path, "samples without the part `fmt ` before them, which says what they are");
                };
                let bytes = match long_bytes {
                    Some(bytes) if is_long && announced == ELSEWHERE => bytes,
                    _ => u64::from(announced),
                };
                let found = size.saturating_sub(content);
                if bytes > found {
                    return Err(RecordError::Truncated { file: path.to_owned(), expected: bytes, found });
                }
                let source = Source::File(file);
                return reader(path, setup, source, content, bytes, &format);
            }
            _ => {}
        }
        // Parts are of even length.
        offset = content + u64::from(announced) + u64::from(announced % 2);
    }
    wrong_form(path, format!("no samples within its first {MOST_PARTS} parts"))
}

fn reader(
    path: &Path,
    setup: &Setup,
    source: Source,
    offset: u64,
    bytes: u64,
    format: &Format,
) -> Result<ChannelReader, RecordError> {
    let rows = bytes / format.stride;
    let channel = |number: u64| {
        let form = Form::Plain { sample: format.sample, big_endian: false, stride: format.stride, record: offset };
        let offset = offset + number * format.sample.bytes() as u64;
        Channel {
            name: (number + 1).to_string(),
            rate_hz: Some(f64::from(format.rate_hz)),
            scale: [format.scale, 0.0],
            stretches: vec![Stretch { row: 0, count: rows, source: 0, offset, form }],
            unit: None,
        }
    };
    let channels = (0..u64::from(format.channels)).map(channel).collect();
    ChannelReader::new(vec![(path.to_owned(), source)], channels, false, setup)
}

fn parse_format(path: &Path, bytes: &[u8]) -> Result<Format, RecordError> {
    let number = |at: usize, count: usize| bytes.get(at..at + count).map_or(0, |bytes| whole_number(bytes, false));
    let short = |at: usize| number(at, 2) as u16;
    let rate_hz = number(4, 4) as u32;
    let (channels, stride, bits) = (short(2), u64::from(short(12)), short(14));
    let kind = if short(0) == EXTENSIBLE { short(24) } else { short(0) };
    let (sample, scale) = match (kind, bits) {
        (PCM, 16) => (Sample::I16, 0.5_f64.powi(15)),
        (PCM, 24) => (Sample::I24, 0.5_f64.powi(23)),
        (PCM, 32) => (Sample::I32, 0.5_f64.powi(31)),
        (FLOAT, 32) => (Sample::F32, 1.0),
        (FLOAT, 64) => (Sample::F64, 1.0),
        (PCM | FLOAT, bits) => {
            return wrong_form(
                path,
                format!("samples of {bits} bits; those of 16, 24 and 32 bits and floating-point ones are read"),
            );
        }
        _ => return wrong_form(path, format!("samples of the compressed form {kind}; write it again as PCM or float")),
    };
    if channels == 0 || channels > MOST_CHANNELS || stride != u64::from(channels) * sample.bytes() as u64 {
        return wrong_form(
            path,
            format!("{channels} channels of {bits} bits in rows of {stride} bytes: its head is damaged"),
        );
    }
    Ok(Format { sample, scale, channels, rate_hz, stride })
}
