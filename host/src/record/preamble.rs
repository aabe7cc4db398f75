//! What stands before the rows of a CSV file: the line with the names, and lines about the measurement before it and units behind it, as DIAdem
//! and other programs write them.

use std::path::Path;

use super::error::RecordError;
use super::lines::Lines;
use super::number::parse_cell;

/// The first row of numbers is looked for in so many lines, and so many bytes.
const MOST_LINES: usize = 256;
const MOST_BYTES: usize = 1 << 20;
/// A line of units has one of these, in lower case and without brackets: other words behind the names may be a sample that is none.
const UNITS: [&str; 41] = [
    "s", "ms", "sec", "min", "h", "hz", "v", "mv", "g", "mg", "gn", "m/s2", "m/s^2", "m/s²", "m/s/s", "mm/s2",
    "mm/s^2", "mm/s²", "cm/s2", "cm/s^2", "gal", "m/s", "mm/s", "m", "cm", "mm", "µm", "um", "strain", "µm/m", "um/m",
    "rad", "mrad", "deg", "°", "°c", "degc", "k", "%", "kn", "n",
];

/// Where the names stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Preamble {
    /// What stands between two cells.
    pub(super) separator: u8,
    /// Lines before the one with the names, without comments.
    pub(super) lines_before: usize,
    /// Whether a line has names; without, the first line is a row.
    pub(super) has_names: bool,
    /// A line with units follows.
    pub(super) has_units: bool,
}

/// Finds the names: the last line before the first row of numbers, or the one before that where units stand between. They have as many cells as
/// the row. Where there is no such row, or words before it that are no names, the first line that holds something has the names.
pub(super) fn preamble(path: &Path) -> Result<Preamble, RecordError> {
    let mut lines = Lines::open(path, b"#")?;
    let mut texts: Vec<Vec<u8>> = Vec::new();
    let mut bytes = 0;
    while texts.len() < MOST_LINES && bytes < MOST_BYTES && lines.advance()? {
        let line = lines.line();
        if let Some(separator) = [b'\t', b';', b','].into_iter().find(|separator| is_row(line, *separator)) {
            if let Some(found) = header(&texts, line, separator) {
                return Ok(found);
            }
            let row = line.to_vec();
            let is_first = texts.iter().all(|line| line.trim_ascii().is_empty());
            if is_first && !(lines.advance()? && are_names(&row, lines.line(), separator)) {
                return Ok(Preamble { separator, lines_before: texts.len(), has_names: false, has_units: false });
            }
            if is_first {
                texts.push(row);
            }
            break;
        }
        bytes += line.len();
        texts.push(line.to_vec());
    }
    if texts.is_empty() {
        texts.push(lines.line().to_vec());
    }
    let first = texts.iter().position(|line| !line.trim_ascii().is_empty());
    let Some((lines_before, line)) = first.and_then(|first| Some((first, texts.get(first)?))) else {
        return Err(RecordError::Empty { file: path.to_owned() });
    };
    let count = |separator: u8| line.iter().filter(|byte| **byte == separator).count();
    let separator = [b'\t', b';', b','].into_iter().max_by_key(|separator| count(*separator)).unwrap_or(b',');
    Ok(Preamble { separator, lines_before, has_names: true, has_units: false })
}

/// Whether all cells of a line are numbers or empty. A single cell is one whatever the separator; the comma, which is tried last, has it.
fn is_row(line: &[u8], separator: u8) -> bool {
    let cells = cells(line, separator);
    let is_single = cells.len() == 1 && separator != b',';
    !is_single
        && cells.iter().all(|cell| parse_cell(cell, separator).is_some())
        && cells.iter().any(|cell| !cell.is_empty())
}

/// The preamble of the first row of numbers.
fn header(before: &[Vec<u8>], row: &[u8], separator: u8) -> Option<Preamble> {
    let width = cells(row, separator).len();
    let is_names = |line: &[u8]| {
        let cells = cells(line, separator);
        cells.len() == width && cells.iter().all(|cell| !cell.is_empty() && parse_cell(cell, separator).is_none())
    };
    let mut held = before.iter().enumerate().rev().filter(|(_, line)| !line.trim_ascii().is_empty());
    let ((last, last_line), earlier) = (held.next()?, held.next());
    match earlier {
        Some((names, line)) if is_names(line) && is_units(last_line, width, separator) => {
            Some(Preamble { separator, lines_before: names, has_names: true, has_units: true })
        }
        // Words behind names are a sample that is none.
        Some((_, line)) if is_names(line) => None,
        _ => {
            is_names(last_line).then_some(Preamble { separator, lines_before: last, has_names: true, has_units: false })
        }
    }
}

/// Whether a first line of numbers has names that are numbers: whole ones that count from 0 (as pandas has them) or from 1, or from 1 upwards, no two
/// alike and before a row without whole ones.
fn are_names(first: &[u8], next: &[u8], separator: u8) -> bool {
    let is_whole = |cell: &&[u8]| !cell.is_empty() && cell.iter().all(u8::is_ascii_digit);
    let first = cells(first, separator);
    let counts_from = |start: usize| (start..).zip(&first).all(|(number, cell)| number.to_string().as_bytes() == *cell);
    let counts = first.len() > 1 && (counts_from(0) || counts_from(1));
    let are_unlike = first.iter().enumerate().all(|(at, cell)| !first.iter().take(at).any(|other| other == cell));
    let are_numbers = first.iter().all(is_whole) && !first.contains(&&b"0"[..]);
    let next = cells(next, separator);
    let is_count = |cell: &&[u8]| is_whole(&cell.strip_prefix(b"-").unwrap_or(cell));
    next.len() == first.len() && (counts || (are_numbers && are_unlike && !next.iter().any(is_count)))
}

/// Whether a line has units: one that is known at least, and no numbers.
fn is_units(line: &[u8], width: usize, separator: u8) -> bool {
    let cells = cells(line, separator);
    let is_known = |cell: &&[u8]| {
        let text = words(cell).to_lowercase();
        UNITS.contains(&text.trim_matches(['[', ']', '(', ')', ' ']))
    };
    let is_number = |cell: &&[u8]| !cell.is_empty() && parse_cell(cell, separator).is_some();
    cells.len() == width && !cells.iter().any(is_number) && cells.iter().any(is_known)
}

/// Text of UTF-8, or else of Latin-1, as programs of Windows write it.
pub(super) fn words(cell: &[u8]) -> String {
    std::str::from_utf8(cell).map_or_else(|_| cell.iter().map(|byte| char::from(*byte)).collect(), str::to_owned)
}

/// Cells without quotes and blanks around them; a separator within quotes separates too, of which names and units have none.
fn cells(line: &[u8], separator: u8) -> Vec<&[u8]> {
    fn bare(cell: &[u8]) -> &[u8] {
        let cell = cell.trim_ascii();
        cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\"")).unwrap_or(cell).trim_ascii()
    }
    line.split(|byte| *byte == separator).map(bare).collect()
}
