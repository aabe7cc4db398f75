//! Lines of a text file: read one after the other into one buffer, counted as an editor counts them.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::error::{FilePosition, RecordError};

/// No row of numbers is longer; a binary file taken for text is.
const LONGEST_LINE: usize = 1 << 20;
const BUFFER_BYTES: usize = 1 << 18;
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Reads a file line by line, passing over comment lines.
#[derive(Debug)]
pub(super) struct Lines {
    path: PathBuf,
    reader: BufReader<File>,
    comment_marks: &'static [u8],
    line: Vec<u8>,
    number: u64,
    /// Between which bytes cells stand (`None`: blanks), and how many there are in a row, once that is known.
    row: Option<(Option<u8>, usize)>,
}

impl Lines {
    /// Opens `path`; a line whose first visible byte is one of `comment_marks` is passed over.
    pub(super) fn open(path: &Path, comment_marks: &'static [u8]) -> Result<Self, RecordError> {
        let file = File::open(path).map_err(RecordError::io(path))?;
        let mut reader = BufReader::with_capacity(BUFFER_BYTES, file);
        if reader.fill_buf().map_err(RecordError::io(path))?.starts_with(BYTE_ORDER_MARK) {
            reader.consume(BYTE_ORDER_MARK.len());
        }
        Ok(Self { path: path.to_owned(), reader, comment_marks, line: Vec::new(), number: 0, row: None })
    }

    /// From here on lines of so many cells are rows even where they begin with a spreadsheet's error value, such as #N/A.
    pub(super) fn expect_rows(&mut self, separator: Option<u8>, cells: usize) {
        self.row = Some((separator, cells));
    }

    /// Whether the line read is passed over.
    fn is_comment(&self) -> bool {
        let first = self.line.trim_ascii_start().first();
        first.is_some_and(|first| self.comment_marks.contains(first))
            && !self.row.is_some_and(|(separator, cells)| begins_with_error_value(self.line(), separator, cells))
    }

    /// Goes to the next line that is no comment; false at the end of the file.
    pub(super) fn advance(&mut self) -> Result<bool, RecordError> {
        loop {
            self.line.clear();
            let mut limited = (&mut self.reader).take(LONGEST_LINE as u64);
            let bytes = limited.read_until(b'\n', &mut self.line).map_err(RecordError::io(&self.path))?;
            if bytes == 0 {
                return Ok(false);
            }
            self.number += 1;
            if bytes == LONGEST_LINE && self.line.last() != Some(&b'\n') {
                return Err(RecordError::LineTooLong { position: self.position(), limit: LONGEST_LINE });
            }
            if !self.is_comment() {
                return Ok(true);
            }
        }
    }

    /// The line reached, without its line break.
    pub(super) fn line(&self) -> &[u8] {
        let line = self.line.strip_suffix(b"\n").unwrap_or(&self.line);
        line.strip_suffix(b"\r").unwrap_or(line)
    }

    /// The reached line's number, from 1.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The reached line's position.
    pub(super) fn position(&self) -> FilePosition {
        FilePosition::line(&self.path, self.number)
    }

    /// Counts the lines left that hold something and are no comments, faster than reading them.
    pub(super) fn count_rest(mut self) -> Result<u64, RecordError> {
        let mut count = 0;
        while let Some(first) = first_visible(&mut self.reader).map_err(RecordError::io(&self.path))? {
            if first == b'\n' {
                self.reader.consume(1);
                continue;
            }
            if self.comment_marks.contains(&first) {
                self.line.clear();
                let mut limited = (&mut self.reader).take(LONGEST_LINE as u64);
                limited.read_until(b'\n', &mut self.line).map_err(RecordError::io(&self.path))?;
                if self.line.len() == LONGEST_LINE && self.line.last() != Some(&b'\n') {
                    // Whoever reads the rows is told where.
                    self.reader.skip_until(b'\n').map_err(RecordError::io(&self.path))?;
                }
                count += u64::from(!self.is_comment());
                continue;
            }
            count += 1;
            self.reader.skip_until(b'\n').map_err(RecordError::io(&self.path))?;
        }
        Ok(count)
    }
}

/// Whether a line has a row's number of cells, and a spreadsheet's error value (#N/A, #NV, #DIV/0! or others) in the first that is not empty.
fn begins_with_error_value(line: &[u8], separator: Option<u8>, cells: usize) -> bool {
    let is_between = |byte: &u8| separator.map_or(byte.is_ascii_whitespace(), |separator| *byte == separator);
    let mut found = line.split(is_between).map(<[u8]>::trim_ascii);
    // Blanks in a row are as one; of other separators each ends a cell.
    let count = found.clone().filter(|cell| separator.is_some() || !cell.is_empty()).count();
    let Some([b'#', value @ ..]) = found.find(|cell| !cell.is_empty()) else { return false };
    let is_of_value =
        |byte: &u8| byte.is_ascii_uppercase() || matches!(byte, b'/' | b'0' | b'!' | b'?') || !byte.is_ascii();
    count == cells && !value.is_empty() && value.iter().all(is_of_value)
}

/// The first byte of the line that is no blank, or its line break; `None` at the end of the file.
fn first_visible(reader: &mut impl BufRead) -> io::Result<Option<u8>> {
    loop {
        let buffer = reader.fill_buf()?;
        if buffer.is_empty() {
            return Ok(None);
        }
        let blanks = buffer.iter().take_while(|byte| byte.is_ascii_whitespace() && **byte != b'\n').count();
        let first = buffer.get(blanks).copied();
        reader.consume(blanks);
        if first.is_some() {
            return Ok(first);
        }
    }
}
