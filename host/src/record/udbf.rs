//! UDBF, the "Universal Data Bin File" of Gantner's loggers (`.dat`), version 1.07: rows of a time and one number of each variable.
//!
//! Gantner's description is not public; the layout is that on which public readers agree (UDBF.NET, pyudbf). The head is read on opening, and so
//! many of the times that gaps are found and no others: where two times are as far apart as the rows between them, nothing is missing there.

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::array::{Sample, Source, whole_number};
use super::channels::{Form, wrong_form};
use super::error::{RecordError, listed};
use super::files::open_file;
use super::traces::{Piece, Traces};

/// Byte of the vendor's name in the head, with which it tells itself.
const VENDOR_AT: usize = 5;
const VENDOR: &[u8] = b"UniversalDataBinFile";
const VERSION: u64 = 107;
/// A head is no longer: 65 535 variables with names of 16 bytes.
const MOST_HEAD_BYTES: u64 = 1 << 22;
/// Behind the head stand so many characters at least, and as many more as bring the rows to a multiple of 16.
const SEPARATION: u64 = 8;
const ALIGNMENT: u64 = 16;
/// Pieces between gaps. More are no gaps: the rate is not that of the times.
const MOST_PIECES: usize = 1 << 16;
/// Days from 1899-12-30, from which OLE counts, to 1970.
const FROM_OLE_DAYS: f64 = 25_569.0;
const DAY_NS: f64 = 86_400e9;

/// Whether a file begins as one of a Gantner logger.
pub(super) fn is_udbf(path: &Path) -> bool {
    let mut start = [0; VENDOR_AT + VENDOR.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start.ends_with(VENDOR)
}

/// What a head says.
struct Head {
    big_endian: bool,
    /// What the times count from, in nanoseconds since 1970, and nanoseconds of one of their steps.
    start_ns: i64,
    step_ns: f64,
    time: Sample,
    rate_hz: f64,
    /// Name, unit, form, and byte within a row.
    variables: Vec<(String, Option<String>, Sample, u64)>,
    row_bytes: u64,
    /// Byte of the first row.
    data: u64,
}

/// Adds the variables of a file to the traces of others.
pub(super) fn add(path: &Path, traces: &mut Traces) -> Result<(), RecordError> {
    let (mut file, size) = open_file(path)?;
    let mut bytes = Vec::new();
    (&mut file).take(MOST_HEAD_BYTES).read_to_end(&mut bytes).map_err(RecordError::io(path))?;
    let head = parse(&bytes).or_else(|reason| wrong_form(path, reason))?;
    let rows = size.saturating_sub(head.data) / head.row_bytes.max(1);
    if rows == 0 {
        return Err(RecordError::Empty { file: path.to_owned() });
    }
    let pieces = pieces(path, &mut file, &head, rows)?;
    let source = traces.sources.len();
    traces.sources.push((path.to_owned(), Source::File(file)));
    for (name, unit, sample, within) in &head.variables {
        let name = traces.name(name);
        if let Some(unit) = unit {
            traces.set_unit(name, unit);
        }
        for (row, count, start_ns) in &pieces {
            let record = head.data + row * head.row_bytes;
            let form = Form::Plain { sample: *sample, big_endian: head.big_endian, stride: head.row_bytes, record };
            let (start_ns, count, offset) = (*start_ns, *count, record + within);
            traces.push(Piece { name, start_ns, rate_hz: head.rate_hz, count, source, offset, form });
        }
    }
    Ok(())
}

/// The fields of a head, one after the other.
struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl Fields<'_> {
    fn take(&mut self, count: usize) -> Result<&[u8], String> {
        let end = self.at.saturating_add(count);
        let taken = self.bytes.get(self.at..end).ok_or("its head ends too early: copy the file again")?;
        self.at = end;
        Ok(taken)
    }

    fn word(&mut self) -> Result<u64, String> {
        let big_endian = self.big_endian;
        Ok(whole_number(self.take(2)?, big_endian))
    }

    fn real(&mut self) -> Result<f64, String> {
        let big_endian = self.big_endian;
        Ok(f64::from_bits(whole_number(self.take(8)?, big_endian)))
    }

    /// Of Latin-1, with a zero behind it.
    fn text(&mut self) -> Result<String, String> {
        let length = self.word()? as usize;
        let text: String =
            self.take(length)?.iter().take_while(|byte| **byte != 0).map(|byte| char::from(*byte)).collect();
        Ok(text.trim().escape_debug().to_string())
    }
}

fn parse(bytes: &[u8]) -> Result<Head, String> {
    let big_endian = match bytes.first() {
        Some(0) => false,
        Some(1) => true,
        _ => return Err("not a UDBF file: its first byte says no order of bytes".to_owned()),
    };
    let mut fields = Fields { bytes, at: 1, big_endian };
    let version = fields.word()?;
    if version != VERSION {
        return Err(format!(
            "UDBF of version {}.{:02}; 1.07 is read: export it as that, or as CSV",
            version / 100,
            version % 100
        ));
    }
    fields.text()?;
    if fields.take(1)? != [0] {
        return Err(
            "rows with a checksum, which are not read; let the logger write them without, or export CSV".to_owned()
        );
    }
    let module = fields.word()? as usize;
    fields.take(module)?;
    let day_factor = fields.real()?;
    let time = match sample_of(fields.word()?) {
        Some(sample) => sample,
        None => return Err("rows without a time, so that gaps do not show; let the logger write times".to_owned()),
    };
    let (step_s, start_days, rate_hz) = (fields.real()?, fields.real()?, fields.real()?);
    let start_ns = (start_days * day_factor - FROM_OLE_DAYS) * DAY_NS;
    let is_time = step_s.is_normal() && step_s > 0.0 && start_ns.abs() < i64::MAX as f64;
    if !(is_time && rate_hz.is_normal() && rate_hz > 0.0) {
        // A damaged number may have 300 digits unless it has an exponent.
        return Err(format!(
            "{rate_hz:?} samples a second, of times in steps of {step_s:?} s from day {start_days:?} on"
        ));
    }
    let mut row_bytes = time.bytes() as u64;
    let mut variables = Vec::new();
    let mut names = HashSet::new();
    for _ in 0..fields.word()? {
        let name = fields.text()?;
        let (direction, kind) = (fields.word()?, fields.word()?);
        // Width and decimals of a display.
        fields.take(4)?;
        let unit = fields.text()?;
        let additional = fields.word()? as usize;
        fields.take(additional)?;
        // What only leaves the logger is in no row.
        if matches!(direction, 1 | 3) {
            continue;
        }
        let sample = sample_of(kind)
            .ok_or_else(|| format!("variable {} is of type {kind}, which is not known", listed([&name], "`")))?;
        if !names.insert(name.clone()) {
            return Err(format!("two variables are called {}; rename one in the logger", listed([&name], "`")));
        }
        variables.push((name, Some(unit).filter(|unit| !unit.is_empty()), sample, row_bytes));
        row_bytes += sample.bytes() as u64;
    }
    let data = (fields.at as u64 + SEPARATION).next_multiple_of(ALIGNMENT);
    let (start_ns, step_ns) = (start_ns.round() as i64, whole_where_it_is(1e9 * step_s));
    Ok(Head { big_endian, start_ns, step_ns, time, rate_hz, variables, row_bytes, data })
}

/// How numbers of a type are stored, by Gantner's number of it; sets of bits are whole numbers.
fn sample_of(kind: u64) -> Option<Sample> {
    Some(match kind {
        1 | 3 | 9 => Sample::U8,
        2 => Sample::I8,
        4 => Sample::I16,
        5 | 10 => Sample::U16,
        6 => Sample::I32,
        7 | 11 => Sample::U32,
        8 => Sample::F32,
        12 => Sample::F64,
        13 => Sample::I64,
        14 | 15 => Sample::U64,
        _ => return None,
    })
}

/// A factor without what its own rounding made of it: 1 and not 1.0000000000000002.
fn whole_where_it_is(factor: f64) -> f64 {
    let whole = factor.round();
    if whole >= 1.0 && (factor / whole - 1.0).abs() < 1e-12 { whole } else { factor }
}

impl Head {
    /// When a row was, in nanoseconds since 1970.
    fn time_ns(&self, path: &Path, file: &mut File, row: u64) -> Result<i64, RecordError> {
        let mut raw = [0; 8];
        let Some(raw) = raw.get_mut(..self.time.bytes()) else { return Ok(0) };
        let from = SeekFrom::Start(self.data + row * self.row_bytes);
        file.seek(from).and_then(|_| file.read_exact(raw)).map_err(RecordError::io(path))?;
        let since_ns = match self.time {
            // Nanoseconds of decades are more than a float holds.
            Sample::U64 | Sample::I64 | Sample::U32 if self.step_ns.fract() == 0.0 => {
                let count = whole_number(raw, self.big_endian);
                i64::try_from(count).ok().and_then(|count| count.checked_mul(self.step_ns as i64))
            }
            time => {
                let count = time.decode_all(raw, self.big_endian).first().copied().unwrap_or(f64::NAN);
                let ns = count * self.step_ns;
                (ns.abs() < i64::MAX as f64).then(|| ns.round() as i64)
            }
        };
        match since_ns.and_then(|ns| ns.checked_add(self.start_ns)) {
            Some(ns) => Ok(ns),
            None => wrong_form(path, format!("row {} has no time", row + 1)),
        }
    }
}

/// Runs of rows that follow each other within half a sample: the first row, how many, and when the first was. Only as many times are read as it takes.
fn pieces(path: &Path, file: &mut File, head: &Head, rows: u64) -> Result<Vec<(u64, u64, i64)>, RecordError> {
    let first_ns = head.time_ns(path, file, 0)?;
    let mut pieces = Vec::new();
    let mut begun = (0, first_ns);
    // Parts that are still to be looked at, the next one last; each by its first and its last row.
    let mut open = Vec::new();
    if rows > 1 {
        open.push([(0, first_ns), (rows - 1, head.time_ns(path, file, rows - 1)?)]);
    }
    while let Some([(from, from_ns), (to, to_ns)]) = open.pop() {
        if to_ns <= from_ns {
            return wrong_form(path, format!("the time of row {} is not after that of row {}", to + 1, from + 1));
        }
        let apart = to_ns.saturating_sub(from_ns) as f64 * 1e-9 * head.rate_hz;
        let is_whole = (apart - (to - from) as f64).abs() <= 0.5;
        if !is_whole && to - from > 1 {
            let middle = from + (to - from) / 2;
            let middle_ns = head.time_ns(path, file, middle)?;
            open.push([(middle, middle_ns), (to, to_ns)]);
            open.push([(from, from_ns), (middle, middle_ns)]);
            continue;
        }
        // A new piece also where nothing is missing and the clock has drifted: the drift adds up in the pieces' times.
        let (row, row_ns) = if is_whole { (from, from_ns) } else { (to, to_ns) };
        if row > begun.0 {
            pieces.push((begun.0, row - begun.0, begun.1));
            begun = (row, row_ns);
        }
        if pieces.len() > MOST_PIECES {
            let rate_hz = head.rate_hz;
            return wrong_form(path, format!("the times of its rows do not fit its rate of {rate_hz:?} Hz"));
        }
    }
    pieces.push((begun.0, rows - begun.0, begun.1));
    Ok(pieces)
}
