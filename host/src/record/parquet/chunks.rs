//! The file as the Parquet library reads it: each page's header is looked at first, and the end of the file is an error.
//!
//! The library skips bytes by reading on, and does not notice the end of the file there. A header that announces two thousand million
//! numbers therefore keeps it busy for half an hour.
//!
//! Each read is taken for that of a header: the library asks for a page's data in one piece. It would not where rows are skipped, or
//! columns hold lists, which recordings have none of.

use std::fs::File;
use std::io::{self, Chain, Cursor, ErrorKind, Read, Seek, SeekFrom};

use bytes::Bytes;
use parquet::errors::{ParquetError, Result};
use parquet::file::FOOTER_SIZE;
use parquet::file::reader::{ChunkReader, Length};

use super::footer::refused_header;

/// No page's header is longer: a few numbers, and the least and the greatest value of a column of numbers.
const LONGEST_HEADER: u64 = 8192;

/// A file whose page headers are looked at before they are read.
pub(super) struct Chunks(pub(super) File);

impl Length for Chunks {
    fn len(&self) -> u64 {
        self.0.len()
    }
}

impl ChunkReader for Chunks {
    type T = EndIsError<Chain<Cursor<Vec<u8>>, File>>;

    fn get_read(&self, start: u64) -> Result<Self::T> {
        let mut file = self.0.try_clone()?;
        file.seek(SeekFrom::Start(start))?;
        let mut first = Vec::new();
        file.by_ref().take(LONGEST_HEADER).read_to_end(&mut first)?;
        let is_header = start.checked_add(FOOTER_SIZE as u64) != Some(self.len());
        if let Some(why) = refused_header(&first, first.len() as u64 == LONGEST_HEADER).filter(|_| is_header) {
            return Err(ParquetError::General(why.to_owned()));
        }
        Ok(EndIsError(Cursor::new(first).chain(file)))
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes> {
        self.0.get_bytes(start, length)
    }
}

/// A reader that fails where it has nothing more to give.
pub(super) struct EndIsError<R>(R);

impl<R: Read> Read for EndIsError<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.0.read(buffer)? {
            0 if !buffer.is_empty() => Err(ErrorKind::UnexpectedEof.into()),
            bytes => Ok(bytes),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn the_end_of_the_file_is_an_error_and_its_last_word_is_no_header() {
        let mut file = tempfile::tempfile().unwrap();
        // As a header, the last eight bytes would be a list of 16 383 numbers.
        file.write_all(b"PAR1\x19\xf7\xff\x7fPAR1").unwrap();
        let chunks = Chunks(file);
        let mut bytes = Vec::new();
        chunks.get_read(4).unwrap().take(8).read_to_end(&mut bytes).unwrap();
        assert_eq!(bytes, b"\x19\xf7\xff\x7fPAR1");
        let error = chunks.get_read(4).unwrap().read_to_end(&mut bytes).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::UnexpectedEof);
        let mut again = tempfile::tempfile().unwrap();
        again.write_all(b"PAR1\x19\xf7\xff\x7fPAR1 and more").unwrap();
        assert!(Chunks(again).get_read(4).is_err());
    }
}
