//! A look at a Parquet file's footer and at its pages' headers before the library reads them.
//!
//! Both are Thrift's compact protocol. The library counts through what it skips: a list of two thousand million booleans, which it takes
//! for entries of no length, holds it for seconds and costs a file five bytes. So lists must fit into what is left of the footer, or of
//! the longest header.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

/// The file ends with the length of the footer and this word.
const MAGIC: &[u8; 4] = b"PAR1";
/// Structures and lists within each other that are followed; Parquet has a dozen.
const DEEPEST: usize = 32;

/// Whether a list in the footer announces more entries than the footer has bytes left. What cannot be followed is left to the library, which
/// says what is wrong with it. The file is at its beginning afterwards.
///
/// # Errors
/// Of the file.
pub(super) fn announces_too_much(file: &mut File) -> io::Result<bool> {
    let footer = read_footer(file)?;
    file.seek(SeekFrom::Start(0))?;
    Ok(footer.is_some_and(|footer| {
        let mut compact = Compact { left: &footer };
        matches!(compact.skip_structure(0), Err(Stop::TooMany))
    }))
}

/// How the structure that these bytes begin with is refused; `None` where it fits, or is left to the library. `is_cut`: the file goes on
/// behind them.
pub(super) fn refused_header(bytes: &[u8], is_cut: bool) -> Option<&'static str> {
    let mut compact = Compact { left: bytes };
    match compact.skip_structure(0) {
        Err(Stop::TooMany) => Some("a page's header announces more than any header holds"),
        Err(Stop::Ended) if is_cut => Some("a page's header is longer than any header"),
        _ => None,
    }
}

/// The footer without its length and the last word; `None` where the file has none.
fn read_footer(file: &mut File) -> io::Result<Option<Vec<u8>>> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut end = [0; 8];
    if length < end.len() as u64 {
        return Ok(None);
    }
    file.seek(SeekFrom::End(-(end.len() as i64)))?;
    file.read_exact(&mut end)?;
    let [a, b, c, d, magic @ ..] = end;
    let footer = u64::from(u32::from_le_bytes([a, b, c, d]));
    let whole = footer + end.len() as u64;
    if magic != *MAGIC || whole > length {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(length - whole))?;
    let mut bytes = Vec::new();
    file.take(footer).read_to_end(&mut bytes)?;
    Ok(Some(bytes))
}

/// Why a footer is followed no further.
#[derive(Debug, PartialEq)]
enum Stop {
    /// It announces more than it can hold, or what Parquet does not have and the library counts through or follows deeper than this.
    TooMany,
    /// The bytes end within it.
    Ended,
    /// It is no such structure.
    Lost,
}

/// Thrift's compact protocol (Apache Thrift, "Thrift Compact protocol encoding").
struct Compact<'a> {
    left: &'a [u8],
}

impl Compact<'_> {
    fn skip(&mut self, bytes: usize) -> Result<(), Stop> {
        self.left = self.left.get(bytes..).ok_or(Stop::Ended)?;
        Ok(())
    }

    fn byte(&mut self) -> Result<u8, Stop> {
        let (first, left) = self.left.split_first().ok_or(Stop::Ended)?;
        self.left = left;
        Ok(*first)
    }

    /// A number in steps of seven bits, the lowest first.
    fn number(&mut self) -> Result<u64, Stop> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(number);
            }
        }
        Err(Stop::TooMany)
    }

    /// How many entries follow: each takes a byte or more.
    fn count(&mut self) -> Result<usize, Stop> {
        let count = self.number()?;
        usize::try_from(count).ok().filter(|count| *count <= self.left.len()).ok_or(Stop::TooMany)
    }

    fn skip_structure(&mut self, depth: usize) -> Result<(), Stop> {
        loop {
            let header = self.byte()?;
            let kind = header & 0x0f;
            if kind == 0 {
                return Ok(());
            }
            if header >> 4 == 0 {
                // The field's number stands on its own.
                self.number()?;
            }
            // A boolean is its kind.
            if !matches!(kind, 1 | 2) {
                self.skip_value(kind, depth)?;
            }
        }
    }

    fn skip_value(&mut self, kind: u8, depth: usize) -> Result<(), Stop> {
        if depth > DEEPEST {
            return Err(Stop::TooMany);
        }
        match kind {
            // Here they take no byte for the library, so that nothing behind them would be where it looks.
            1 | 2 => Err(Stop::TooMany),
            3 => self.skip(1),
            4..=6 => self.number().map(|_| ()),
            7 => self.skip(8),
            8 => {
                let length = self.number()?;
                self.skip(usize::try_from(length).map_err(|_| Stop::Ended)?)
            }
            9 | 10 => {
                let header = self.byte()?;
                let short = usize::from(header >> 4);
                let count = if short == 15 { self.count()? } else { short };
                (0..count).try_for_each(|_| self.skip_value(header & 0x0f, depth + 1))
            }
            11 => {
                let count = self.count()?;
                let kinds = if count == 0 { 0 } else { self.byte()? };
                (0..count).try_for_each(|_| {
                    self.skip_value(kinds >> 4, depth + 1)?;
                    self.skip_value(kinds & 0x0f, depth + 1)
                })
            }
            12 => self.skip_structure(depth + 1),
            13 => self.skip(16),
            _ => Err(Stop::Lost),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn file_of(footer: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(b"PAR1").unwrap();
        file.write_all(footer).unwrap();
        file.write_all(&(footer.len() as u32).to_le_bytes()).unwrap();
        file.write_all(b"PAR1").unwrap();
        file
    }

    #[test]
    fn a_list_that_is_longer_than_the_footer_is_told_and_one_that_fits_is_not() {
        // Field 1: a list of two bytes; field 2: a structure with a map of one number to one number; the end.
        let sound = [0x19, 0x23, 1, 2, 0x1c, 0x1b, 1, 0x55, 7, 9, 0, 0];
        assert!(!announces_too_much(&mut file_of(&sound)).unwrap());
        // The same list with 2^31 - 1 booleans.
        let long = [0x19, 0xf1, 0xff, 0xff, 0xff, 0xff, 0x07, 1, 2, 0];
        assert!(announces_too_much(&mut file_of(&long)).unwrap());
        // Within a structure, and as a map.
        assert!(announces_too_much(&mut file_of(&[0x1c, 0x19, 0xf1, 0xff, 0x7f, 0, 0])).unwrap());
        assert!(announces_too_much(&mut file_of(&[0x1b, 0xff, 0x7f, 0x55, 0])).unwrap());
    }

    #[test]
    fn a_header_that_is_longer_than_any_or_announces_more_is_refused() {
        // A page of data of 7 bytes: type, sizes, and the structure with the number of its values and three encodings; the end.
        let sound = [0x15, 0, 0x15, 14, 0x15, 14, 0x2c, 0x15, 2, 0x15, 0, 0x15, 6, 0x15, 6, 0, 0];
        assert_eq!([true, false].map(|is_cut| refused_header(&sound, is_cut)), [None; 2]);
        let cut = &sound[..9];
        assert_eq!(refused_header(cut, false), None, "the library says that the file ends");
        assert!(refused_header(cut, true).unwrap().contains("longer"));
        for announced in [0xf7, 0x21] {
            let header = [0x19, announced, 0xff, 0xff, 0xff, 0xff, 0x07, 1, 2, 0];
            assert!(refused_header(&header, false).unwrap().contains("announces more"));
        }
    }

    #[test]
    fn what_is_no_footer_is_left_to_the_library() {
        for other in [&b""[..], b"PAR1", b"no parquet file at all", &[0xff; 64]] {
            let mut file = tempfile::tempfile().unwrap();
            file.write_all(other).unwrap();
            assert!(!announces_too_much(&mut file).unwrap());
        }
        // A text longer than the footer, and structures and lists without end.
        assert!(!announces_too_much(&mut file_of(&[0x18, 0x7f, b'a'])).unwrap());
        for endless in [0x1c, 0x19] {
            assert!(announces_too_much(&mut file_of(&[endless; 100_000])).unwrap());
        }
    }
}
