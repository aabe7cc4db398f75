//! SAC recordings: one trace a file, of single precision, with a header of 632 bytes. Files of several channels stand beside each other.
//!
//! The format is that of the "SAC Data File Format" (versions 6 and 7, evenly spaced time series), in either order of bytes.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::array::{Sample, Source};
use super::channels::{Form, wrong_form};
use super::error::RecordError;
use super::files::open_file;
use super::traces::{Piece, Traces, unix_ns};

const HEADER_BYTES: u64 = 632;
/// What a field holds that is not known.
const UNKNOWN: i32 = -12345;
/// Words of the header: floats first, then whole numbers.
const STEP: usize = 0;
const BEGIN: usize = 5;
const YEAR: usize = 70;
const VERSION: usize = 76;
const COUNT: usize = 79;
const KIND: usize = 85;
const IS_EVEN: usize = 105;
/// Names, in bytes: network, station, hole and component.
const NAMES: [usize; 4] = [608, 440, 464, 600];
const TIME_SERIES: i32 = 1;
/// Doubles behind the samples in version 7: the step first, then the beginning.
const FOOTER_BYTES: u64 = 22 * 8;

/// Adds the trace of a file to those of others.
pub(super) fn add(path: &Path, traces: &mut Traces) -> Result<(), RecordError> {
    let (mut file, size) = open_file(path)?;
    let mut header = Vec::new();
    (&mut file).take(HEADER_BYTES).read_to_end(&mut header).map_err(RecordError::io(path))?;
    if (header.len() as u64) < HEADER_BYTES {
        return wrong_form(path, "not a SAC file: it is shorter than a header");
    }
    let raw = |at: usize| header.get(4 * at..4 * at + 4).and_then(|word| word.try_into().ok()).unwrap_or([0; 4]);
    let is_version = |version: i32| (6..=7).contains(&version);
    let big_endian = is_version(i32::from_be_bytes(raw(VERSION)));
    if !big_endian && !is_version(i32::from_le_bytes(raw(VERSION))) {
        return wrong_form(path, "not a SAC file of version 6 or 7");
    }
    let whole = |at: usize| if big_endian { i32::from_be_bytes(raw(at)) } else { i32::from_le_bytes(raw(at)) };
    let real = |at: usize| f64::from(f32::from_bits(whole(at).cast_unsigned()));
    if whole(KIND) != TIME_SERIES || whole(IS_EVEN) != 1 {
        return wrong_form(path, "no evenly spaced time series; only those are read");
    }
    let count = u64::try_from(whole(COUNT)).unwrap_or(0);
    let (expected, found) = (4 * count, size - HEADER_BYTES);
    if found < expected {
        return Err(RecordError::Truncated { file: path.to_owned(), expected, found });
    }
    let (mut step_s, mut begin_s) = (shortest(real(STEP)), shortest(real(BEGIN)));
    if whole(VERSION) == 7 && found >= expected + FOOTER_BYTES {
        let mut footer = [0; 16];
        let from = SeekFrom::Start(HEADER_BYTES + expected);
        file.seek(from).and_then(|_| file.read_exact(&mut footer)).map_err(RecordError::io(path))?;
        if let [step, begin] = Sample::F64.decode_all(&mut footer, big_endian)[..] {
            (step_s, begin_s) = (step, begin);
        }
    }
    if !(step_s.is_normal() && step_s > 0.0 && begin_s.is_finite()) {
        return wrong_form(path, format!("a sample every {step_s} s, from {begin_s} s on"));
    }
    // Without a date all files of the setup count from the same zero.
    let time: Vec<i64> = (YEAR..YEAR + 6).map(|at| i64::from(whole(at))).collect();
    let zero_ns = match time[..] {
        [year, ..] if year == i64::from(UNKNOWN) => Some(0),
        [year, day, hours, minutes, seconds, ms] => unix_ns(year, day, [hours, minutes, seconds], ms * 1_000_000),
        _ => None,
    };
    let Some(zero_ns) = zero_ns else { return wrong_form(path, format!("no date: {time:?}")) };
    let text = |from: usize| {
        let text = String::from_utf8_lossy(header.get(from..from + 8).unwrap_or_default()).into_owned();
        let text = text.split('\0').next().unwrap_or_default().trim().escape_debug().to_string();
        if text == UNKNOWN.to_string() { String::new() } else { text }
    };
    let name = NAMES.map(text).join(".");
    let name = if name == "..." {
        path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
    } else {
        name
    };
    let form = Form::packed(Sample::F32, big_endian, HEADER_BYTES);
    let (name, source) = (traces.name(&name), traces.sources.len());
    traces.sources.push((path.to_owned(), Source::File(file)));
    let start_ns = zero_ns.saturating_add((begin_s * 1e9).round() as i64);
    traces.push(Piece { name, start_ns, rate_hz: step_s.recip(), count, source, offset: HEADER_BYTES, form });
    Ok(())
}

/// A number of single precision as the decimal that it was written as: 0.02 and not 0.0199999996.
fn shortest(number: f64) -> f64 {
    (number as f32).to_string().parse().unwrap_or(number)
}
