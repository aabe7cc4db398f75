//! The numbers of a dataset 58 in text: parsed a piece at a time, so that several datasets can be read in step.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::dataset::TimeResponse;
use crate::record::array::Sample;
use crate::record::error::{At, FilePosition, RecordError, quoted};
use crate::record::number::parse_number;

/// Bytes read at once. There is one such piece a channel.
const PIECE_BYTES: u64 = 1 << 15;
const HINT: &str = "expected numbers as 6E13.5 or 4E20.12 writes them; a missing sample is NaN";

/// Reads the numbers of one response in order.
#[derive(Debug)]
pub(super) struct TextValues {
    channel: String,
    /// Columns of a number where numbers touch.
    width: usize,
    /// The next byte to read, and the one after the last.
    next: u64,
    end: u64,
    /// Bytes read that are no whole line yet.
    text: Vec<u8>,
    /// Numbers parsed, of which the first `taken` are handed out.
    values: Vec<f64>,
    taken: usize,
    /// Numbers handed out before `values`.
    before: u64,
}

impl TextValues {
    pub(super) fn new(start: u64, end: u64, response: &TimeResponse) -> Self {
        Self {
            channel: response.name.to_string(),
            width: if response.sample == Sample::F32 { 13 } else { 20 },
            next: start,
            end,
            text: Vec::new(),
            values: Vec::new(),
            taken: 0,
            before: 0,
        }
    }

    /// The next `count` numbers; with `last` they must be the dataset's last.
    pub(super) fn take(
        &mut self,
        path: &Path,
        file: &mut File,
        count: usize,
        last: bool,
    ) -> Result<&[f64], RecordError> {
        self.values.drain(..self.taken);
        self.before += self.taken as u64;
        self.taken = 0;
        let at = |row: u64| FilePosition { file: path.to_owned(), at: At::Row(row) };
        while (self.values.len() < count || last) && self.next < self.end {
            self.parse_piece(path, file)?;
        }
        let found = self.before + self.values.len() as u64;
        if self.values.len() < count {
            let reason = format!("channel `{}` ends before this row; its dataset announces more samples", self.channel);
            return Err(RecordError::Uff { position: at(found + 1), reason });
        }
        if last && self.values.len() > count {
            let announced = self.before + count as u64;
            let reason =
                format!("channel `{}` has {found} samples, but its dataset announces {announced}", self.channel);
            return Err(RecordError::Uff { position: at(announced + 1), reason });
        }
        self.taken = count;
        Ok(self.values.get(..count).unwrap_or_default())
    }

    fn parse_piece(&mut self, path: &Path, file: &mut File) -> Result<(), RecordError> {
        let size = PIECE_BYTES.min(self.end - self.next);
        let kept = self.text.len();
        self.text.resize(kept + size as usize, 0);
        let room = self.text.get_mut(kept..).unwrap_or_default();
        let fetched = file.seek(SeekFrom::Start(self.next)).and_then(|_| file.read_exact(room));
        fetched.map_err(RecordError::io(path))?;
        self.next += size;
        let whole = if self.next == self.end {
            self.text.len()
        } else {
            self.text.iter().rposition(|byte| *byte == b'\n').map_or(0, |position| position + 1)
        };
        for line in self.text.get(..whole).unwrap_or_default().split(|byte| *byte == b'\n') {
            if let Err(text) = parse_line(line, self.width, &mut self.values) {
                return Err(RecordError::NotANumber {
                    position: FilePosition {
                        file: path.to_owned(),
                        at: At::Row(self.before + self.values.len() as u64 + 1),
                    },
                    channel: self.channel.clone(),
                    text,
                    hint: HINT,
                });
            }
        }
        self.text.drain(..whole);
        Ok(())
    }
}

/// Appends the numbers of a line; fails with the text that is not a number.
///
/// Blanks stand between numbers, but a number that fills its columns (such as -1.00000e-100) touches the one before: then
/// they are split by columns.
fn parse_line(line: &[u8], width: usize, values: &mut Vec<f64>) -> Result<(), String> {
    let line = line.trim_ascii_end();
    let start = values.len();
    let words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    let Err(word) = append(words, values) else { return Ok(()) };
    values.truncate(start);
    let cells = line.chunks(width).map(<[u8]>::trim_ascii);
    append(cells, values).map_err(|cell| {
        // Where columns do not help, the word is what an editor shows.
        let text = if line.len() <= width { cell } else { word };
        quoted(text)
    })
}

fn append<'a>(words: impl Iterator<Item = &'a [u8]>, values: &mut Vec<f64>) -> Result<(), &'a [u8]> {
    for word in words {
        let number = parse_number(word).or_else(|| {
            // Fortran's double precision exponent.
            let with_e: Vec<u8> =
                word.iter().map(|byte| if matches!(byte, b'd' | b'D') { b'e' } else { *byte }).collect();
            parse_number(&with_e)
        });
        values.push(number.ok_or(word)?);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::parse_line;

    #[test]
    fn numbers_that_touch_are_told_apart_by_their_columns() {
        let mut values = Vec::new();
        parse_line(b" -1.50000e+00-1.00000e-100  2.50000D+00", 13, &mut values).unwrap();
        assert_eq!(values, [-1.5, -1e-100, 2.5]);
        assert_eq!(parse_line(b"  1.5  volt  2.5", 13, &mut values).unwrap_err(), "volt");
        assert!(parse_line(b"", 13, &mut values).is_ok());
    }
}
