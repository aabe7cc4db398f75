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
}

impl Lines {
    /// Opens `path`; a line whose first visible byte is one of `comment_marks` is passed over.
    pub(super) fn open(path: &Path, comment_marks: &'static [u8]) -> Result<Self, RecordError> {
        let file = File::open(path).map_err(RecordError::io(path))?;
        let mut reader = BufReader::with_capacity(BUFFER_BYTES, file);
        if reader.fill_buf().map_err(RecordError::io(path))?.starts_with(BYTE_ORDER_MARK) {
            reader.consume(BYTE_ORDER_MARK.len());
        }
        Ok(Self { path: path.to_owned(), reader, comment_marks, line: Vec::new(), number: 0 })
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
            match self.line.trim_ascii_start().first() {
                Some(mark) if self.comment_marks.contains(mark) => {}
                _ => return Ok(true),
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
            count += u64::from(!self.comment_marks.contains(&first));
            self.reader.skip_until(b'\n').map_err(RecordError::io(&self.path))?;
        }
        Ok(count)
    }
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
