//! Text recordings: white space without a header (`.txt`, `.asc`, `.dat`), CSV with one (`.csv`), and TOA5 of Campbell's loggers (`.dat`).
//!
//! Lines flow in, rows of the setup's channels flow out; where there is a time column, rows of NaN stand for the rows
//! that it says are missing.

use std::path::Path;

use super::clock::{Clock, check_rate};
use super::columns::{Columns, Selection, is_time_column};
use super::error::{At, FilePosition, RecordError, quoted};
use super::lines::Lines;
use super::number::{parse_cell, parse_number};
use super::preamble::{preamble, words};
use super::row_reader::{RowReader, Rows};
use super::stamp;
use crate::study::Sensor;

/// Rows read ahead to compare a time column with the sampling rate.
const ROWS_TO_CHECK: usize = 1024;
const WHITE_SPACE_HINT: &str = "expected numbers with a decimal point between blanks; a header line must start with #, and a missing sample is NaN";
const STAMP_HINT: &str = "expected a date and a time of day such as 2026-03-01 12:00:00.05";
const CSV_HINT: &str = "expected a number with a decimal point; leave the cell empty where the sample is missing";

/// What stands between two cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Separator {
    WhiteSpace,
    Byte(u8),
}

/// The time column of a CSV or of a Campbell logger's file.
#[derive(Debug, Clone, PartialEq)]
struct TimeColumn {
    column: usize,
    name: String,
    /// Whether it holds dates and times of day instead of seconds.
    is_stamp: bool,
}

/// Reads one text file row by row.
#[derive(Debug)]
pub(super) struct TextReader {
    lines: Lines,
    separator: Separator,
    /// The header's names; `None` before the first row of a file without a header, whose width is then `width`.
    names: Option<Vec<String>>,
    units: Vec<String>,
    width: usize,
    time: Option<TimeColumn>,
    cells: Vec<(usize, usize)>,
    unquoted: csv::ByteRecord,
    /// Rows of NaN that stand before the line reached.
    missing_before: u64,
    /// A row has been read.
    begun: bool,
    /// Blank lines between the last two rows, which no time column explains: the first one, and how many.
    blank_lines: Option<(FilePosition, u64)>,
    /// The line reached holds a row not yet handed out.
    row_waits: bool,
    line_of_row: Vec<u64>,
}

impl TextReader {
    /// Opens a file of numbers between blanks; lines that start with # or % are comments.
    pub(super) fn open_white_space(path: &Path) -> Result<Self, RecordError> {
        Ok(Self::new(Lines::open(path, b"#%")?, Separator::WhiteSpace))
    }

    /// Opens a CSV file and reads its header ([`preamble`]); lines that start with # are comments. Cells are separated by comma, semicolon or
    /// tabulator. A time column that no sensor claims is noted.
    pub(super) fn open_csv(path: &Path, sensors: &[Sensor]) -> Result<Self, RecordError> {
        let preamble = preamble(path)?;
        let mut reader = Self::new(Lines::open(path, b"#")?, Separator::Byte(preamble.separator));
        if !preamble.has_names {
            return Ok(reader);
        }
        for _ in 0..=preamble.lines_before {
            reader.lines.advance()?;
        }
        reader.take_names(sensors)?;
        if preamble.has_units {
            while reader.lines.advance()? && reader.lines.line().trim_ascii().is_empty() {}
            reader.take_units()?;
        }
        reader.lines.expect_rows(Some(preamble.separator), reader.width);
        Ok(reader)
    }

    /// Opens a file of a Campbell logger: four lines of header, the second with the names; a column of dates and times.
    pub(super) fn open_toa5(path: &Path, sensors: &[Sensor]) -> Result<Self, RecordError> {
        let mut reader = Self::new(Lines::open(path, b"")?, Separator::Byte(b','));
        for line in 1..=4 {
            if !reader.lines.advance()? {
                return Err(RecordError::Empty { file: path.to_owned() });
            }
            match line {
                2 => reader.take_names(sensors)?,
                3 => reader.take_units()?,
                _ => {}
            }
        }
        if let Some(time) = &mut reader.time {
            time.is_stamp = true;
        }
        Ok(reader)
    }

    /// Takes the line reached for the names of columns.
    fn take_names(&mut self, sensors: &[Sensor]) -> Result<(), RecordError> {
        self.split()?;
        let names: Vec<String> = (0..self.cell_count()).map(|cell| words(self.cell(cell))).collect();
        self.width = names.len();
        self.time = names
            .iter()
            .position(|name| is_time_column(name, sensors))
            .and_then(|column| Some(TimeColumn { column, name: names.get(column)?.clone(), is_stamp: false }));
        self.names = Some(names);
        Ok(())
    }

    /// Takes the line reached for the units of columns.
    fn take_units(&mut self) -> Result<(), RecordError> {
        self.split()?;
        self.units = (0..self.cell_count()).map(|cell| words(self.cell(cell))).collect();
        Ok(())
    }

    /// The units that the header has, in the columns' order; empty where it has none.
    pub(super) fn units(&self) -> Vec<Option<String>> {
        self.units.iter().map(|unit| Some(unit.clone()).filter(|unit| !unit.is_empty())).collect()
    }

    /// The time of the first row in s, where there is a column of times: since 1970 by the logger's clock where they are of the calendar.
    pub(super) fn first_time_s(mut self) -> Result<Option<f64>, RecordError> {
        let Some(time) = self.time.clone() else { return Ok(None) };
        while self.lines.advance()? {
            if !self.lines.line().trim_ascii().is_empty() {
                self.split()?;
                return self.time_s(&time).map(Some);
            }
        }
        Ok(None)
    }

    fn new(lines: Lines, separator: Separator) -> Self {
        Self {
            lines,
            separator,
            names: None,
            units: Vec::new(),
            width: 0,
            time: None,
            cells: Vec::new(),
            unquoted: csv::ByteRecord::new(),
            missing_before: 0,
            begun: false,
            blank_lines: None,
            row_waits: false,
            line_of_row: Vec::new(),
        }
    }

    /// The file's columns, and whether its time column keeps `sampling_rate_hz`; consumes the first rows.
    pub(super) fn inspect(mut self, sampling_rate_hz: f64) -> Result<Columns, RecordError> {
        if !self.next_line()? {
            return Err(RecordError::Empty { file: self.lines.path().to_owned() });
        }
        let first_line = self.lines.position();
        let columns = match &self.names {
            Some(names) => Columns::Named(names.clone()),
            None => Columns::Numbered(self.width),
        };
        let Some(time) = self.time.clone() else { return Ok(columns) };
        let mut times_s = Vec::new();
        // The finest digit of any of the times shows how far they are rounded.
        let mut resolution_s: f64 = 1.0;
        loop {
            let text = self.cell(time.column);
            let decimals = text.iter().rev().position(|byte| matches!(byte, b'.' | b',')).unwrap_or(0);
            resolution_s = resolution_s.min(0.1_f64.powi(decimals.min(30) as i32));
            times_s.push(self.time_s(&time)?);
            if times_s.len() >= ROWS_TO_CHECK || !self.next_line()? {
                break;
            }
        }
        check_rate(&times_s, resolution_s, sampling_rate_hz, &time.name, &first_line)?;
        Ok(columns)
    }

    /// Exact number of rows that [`RowReader::read`] will give, filled rows included.
    pub(super) fn count_rows(mut self, clock: &mut Clock) -> Result<u64, RecordError> {
        // Only where blank lines or the time column make rows must the lines be looked into.
        let is_only_column = self.names.is_some() && self.width == 1;
        let blanks_are_cells = is_only_column || self.separator == Separator::Byte(b'\t');
        if self.time.is_none() && !blanks_are_cells {
            // The first row says how many cells the others have.
            return Ok(if self.next_line()? { 1 + self.lines.count_rest()? } else { 0 });
        }
        clock.start_file();
        let mut rows = 0;
        while self.next_row(clock)? {
            rows += 1 + std::mem::take(&mut self.missing_before);
        }
        Ok(rows)
    }

    /// Goes to the next row and finds what is missing before it.
    fn next_row(&mut self, clock: &mut Clock) -> Result<bool, RecordError> {
        if !self.next_line()? {
            // Blank lines at the end of a file with one column are the end of the file.
            self.missing_before = 0;
            return Ok(false);
        }
        if let Some((position, count)) = self.blank_lines.take() {
            clock.note_blank_lines(position, count);
        }
        if let Some(time) = &self.time {
            let time_s = self.time_s(time)?;
            self.missing_before += clock.advance(time_s, &time.name, &self.lines.position())?;
        }
        Ok(true)
    }

    /// Goes to the next line with cells and splits it. In a CSV with one column a blank line is an empty cell.
    fn next_line(&mut self) -> Result<bool, RecordError> {
        loop {
            if !self.lines.advance()? {
                return Ok(false);
            }
            if !self.is_blank() {
                break;
            }
            if self.time.is_some() {
                continue;
            }
            if self.width == 1 && self.names.is_some() {
                self.missing_before += 1;
            } else if self.begun {
                let (_, count) = self.blank_lines.get_or_insert_with(|| (self.lines.position(), 0));
                *count += 1;
            }
        }
        self.begun = true;
        self.split()?;
        let found = self.cell_count();
        if self.names.is_none() && self.width == 0 {
            self.width = found;
            let separator = match self.separator {
                Separator::WhiteSpace => None,
                Separator::Byte(separator) => Some(separator),
            };
            self.lines.expect_rows(separator, found);
        }
        if found == self.width {
            return Ok(true);
        }
        Err(RecordError::Ragged { position: self.lines.position(), expected: self.width, found })
    }

    /// Whether the line reached is no row; tabulators between empty cells are one.
    fn is_blank(&self) -> bool {
        let blank = |byte: &u8| byte.is_ascii_whitespace() && self.separator != Separator::Byte(*byte);
        self.lines.line().iter().all(blank)
    }

    /// Finds the cells of the line reached.
    fn split(&mut self) -> Result<(), RecordError> {
        self.cells.clear();
        self.unquoted.clear();
        let line = self.lines.line();
        match self.separator {
            Separator::WhiteSpace => {
                let mut start = None;
                for (position, byte) in line.iter().enumerate() {
                    match (byte.is_ascii_whitespace(), start) {
                        (false, None) => start = Some(position),
                        (true, Some(begun)) => {
                            self.cells.push((begun, position));
                            start = None;
                        }
                        _ => {}
                    }
                }
                self.cells.extend(start.map(|begun| (begun, line.len())));
            }
            Separator::Byte(separator) if line.contains(&b'"') => {
                if line.iter().filter(|byte| **byte == b'"').count() % 2 == 1 {
                    return Err(RecordError::OpenQuote { position: self.lines.position() });
                }
                csv::ReaderBuilder::new()
                    .delimiter(separator)
                    .has_headers(false)
                    .flexible(true)
                    .from_reader(line)
                    .read_byte_record(&mut self.unquoted)
                    .map_err(|error| RecordError::io(self.lines.path())(error.into()))?;
            }
            Separator::Byte(separator) => {
                let mut start = 0;
                for (position, byte) in line.iter().enumerate() {
                    if *byte == separator {
                        self.cells.push((start, position));
                        start = position + 1;
                    }
                }
                self.cells.push((start, line.len()));
            }
        }
        Ok(())
    }

    fn cell_count(&self) -> usize {
        self.cells.len() + self.unquoted.len()
    }

    /// A cell of the line reached, without blanks around it; empty where the line has no such cell.
    fn cell(&self, index: usize) -> &[u8] {
        let cell = match self.cells.get(index) {
            Some(&(start, end)) => self.lines.line().get(start..end),
            None => self.unquoted.get(index),
        };
        cell.unwrap_or_default().trim_ascii()
    }

    fn time_s(&self, time: &TimeColumn) -> Result<f64, RecordError> {
        let text = self.cell(time.column);
        if time.is_stamp {
            return stamp::seconds(text).ok_or_else(|| RecordError::NotANumber {
                position: self.lines.position(),
                channel: time.name.clone(),
                text: quoted(text),
                hint: STAMP_HINT,
            });
        }
        self.number(text).filter(|time_s| time_s.is_finite()).ok_or_else(|| RecordError::TimeNotSeconds {
            position: self.lines.position(),
            column: time.name.clone(),
            text: quoted(text),
        })
    }

    fn number(&self, cell: &[u8]) -> Option<f64> {
        match self.separator {
            Separator::WhiteSpace => parse_number(cell),
            Separator::Byte(separator) => parse_cell(cell, separator),
        }
    }

    /// Appends the channels of the line reached.
    fn push_row(&self, selection: &Selection, values: &mut Vec<f64>) -> Result<(), RecordError> {
        for (channel, (column, factor)) in selection.columns.iter().zip(&selection.factors).enumerate() {
            let text = self.cell(*column);
            let value = self.number(text).ok_or_else(|| RecordError::NotANumber {
                position: self.lines.position(),
                channel: selection.channel(channel),
                text: quoted(text),
                hint: if self.separator == Separator::WhiteSpace { WHITE_SPACE_HINT } else { CSV_HINT },
            })?;
            values.push(value * factor);
        }
        Ok(())
    }
}

impl RowReader for TextReader {
    fn read(&mut self, most: usize, rows: &mut Rows<'_>) -> Result<usize, RecordError> {
        self.line_of_row.clear();
        while self.line_of_row.len() < most {
            if !self.row_waits {
                if !self.next_row(rows.clock)? {
                    break;
                }
                self.row_waits = true;
            }
            if self.missing_before > 0 {
                self.missing_before -= 1;
                rows.push_missing();
            } else {
                self.push_row(rows.selection, rows.values)?;
                self.row_waits = false;
            }
            self.line_of_row.push(self.lines.number());
        }
        Ok(self.line_of_row.len())
    }

    fn position(&self, row: usize) -> FilePosition {
        let line = self.line_of_row.get(row).copied().unwrap_or_else(|| self.lines.number());
        FilePosition { file: self.lines.path().to_owned(), at: At::Line(line) }
    }
}
