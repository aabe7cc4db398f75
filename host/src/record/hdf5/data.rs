//! The numbers of a dataset: where they stand, or, of one in chunks, put together into memory or a file without a name.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};

use flate2::read::ZlibDecoder;

use super::bytes::{Fault, damaged};
use super::message::{Filter, Kind, Layout};
use super::tree::{self, Chunk};
use super::{Dataset, Hdf5Error, Hdf5File, Object};
use crate::record::array::{MOST_IN_MEMORY, Sample, Source, whole_number};

/// Bytes of one chunk. The library makes chunks of a megabyte, MATLAB of less.
const MOST_CHUNK_BYTES: u64 = 1 << 28;
/// Deflate makes no more of a byte.
const MOST_INFLATION: u64 = 1032;

/// Numbers one after the other, the last dimension fastest.
#[derive(Debug)]
pub(crate) struct Numbers {
    pub(crate) source: Source,
    /// Byte of the first.
    pub(crate) offset: u64,
    pub(crate) sample: Sample,
    pub(crate) big_endian: bool,
}

impl Hdf5File {
    /// Where the numbers of a dataset are. Those in chunks are put together.
    ///
    /// # Errors
    /// Where the object is no dataset of real numbers, is damaged, or filtered by what is not read.
    pub(crate) fn numbers(&self, object: &Object) -> Result<Numbers, Hdf5Error> {
        self.find_numbers(object).map_err(|fault| self.error(&format!("`{}`", object.path), fault))
    }

    /// All numbers of a dataset that has `most` at most.
    ///
    /// # Errors
    /// As [`Hdf5File::numbers`], or where it has more.
    pub(crate) fn all_numbers(&self, object: &Object, most: u64) -> Result<Vec<f64>, Hdf5Error> {
        let fault = |fault| self.error(&format!("`{}`", object.path), fault);
        let count = object.dataset.as_ref().and_then(Dataset::count).unwrap_or(u64::MAX);
        if count > most {
            let all = count.to_string();
            return Err(fault(Fault::Damaged(format!("{all} numbers where there are {most} at most"))));
        }
        let Numbers { mut source, offset, sample, big_endian } = self.numbers(object)?;
        let mut raw = vec![0; count as usize * sample.bytes()];
        source.fetch(offset, &mut raw).map_err(|error| fault(error.into()))?;
        Ok(sample.decode_all(&mut raw, big_endian))
    }

    fn find_numbers(&self, object: &Object) -> Result<Numbers, Fault> {
        let Some(dataset) = &object.dataset else { return damaged("a group where a dataset was expected") };
        let (sample, big_endian) = match dataset.kind {
            Kind::Number { sample, big_endian } => (sample, big_endian),
            Kind::Text | Kind::LongText => return Err(Fault::Unsupported("text".to_owned())),
            Kind::Other(what) => return Err(Fault::Unsupported(what.to_owned())),
        };
        let count = dataset.count().and_then(|count| count.checked_mul(sample.bytes() as u64));
        let Some(bytes) = count else { return damaged("more numbers than any file holds") };
        let numbers = |source, offset| Numbers { source, offset, sample, big_endian };
        let (chunks, lengths) = match &dataset.layout {
            Layout::Unread(what) => return Err(Fault::Unsupported(what.clone())),
            Layout::Compact(content) if content.len() as u64 >= bytes => {
                return Ok(numbers(Source::Memory(content.clone()), 0));
            }
            Layout::Compact(content) => {
                return damaged(format!("{} bytes of numbers where {bytes} are needed", content.len()));
            }
            Layout::Contiguous { address: None, .. }
            | Layout::Chunked { tree: None, .. }
            | Layout::SingleChunk { address: None, .. } => {
                return damaged("its numbers were never written");
            }
            Layout::Contiguous { address: Some(address), bytes: announced } => {
                if *announced < bytes {
                    return damaged(format!("{announced} bytes of numbers where {bytes} are needed"));
                }
                return Ok(numbers(Source::File(self.file.try_clone()?), self.place(*address, bytes)?));
            }
            Layout::SingleChunk { address: Some(address), filtered } => {
                let (stored, left_out) = filtered.unwrap_or((bytes, 0));
                let start = vec![0; dataset.lengths.len()];
                (vec![Chunk { start, address: *address, bytes: stored, left_out }], dataset.lengths.clone())
            }
            Layout::Chunked { tree: Some(tree), chunk } => {
                let of_one = |(length, of_chunk): (&u64, &u64)| length.div_ceil((*of_chunk).max(1));
                let most = dataset.lengths.iter().zip(chunk).map(of_one).fold(1_u64, u64::saturating_mul);
                let chunks = tree::chunks(self, *tree, dataset.lengths.len(), most)?;
                if (chunks.len() as u64) < most {
                    return damaged(format!(
                        "{} of its {most} chunks were never written: the program that wrote it was stopped",
                        most - chunks.len() as u64
                    ));
                }
                (chunks, chunk.clone())
            }
        };
        if lengths.len() != dataset.lengths.len() || lengths.is_empty() {
            return damaged("chunks of other dimensions than its own");
        }
        // Each chunk's bytes are its own, so that no more can come out of the file. A small file is rounded up by the room of one chunk.
        let chunk_bytes = lengths.iter().fold(sample.bytes() as u64, |all, length| all.saturating_mul(*length));
        if chunk_bytes > MOST_CHUNK_BYTES {
            return Err(Fault::Unsupported(format!(
                "in chunks of {chunk_bytes} bytes; write it again with chunks of a megabyte"
            )));
        }
        if bytes > self.size.saturating_mul(MOST_INFLATION).saturating_add(chunk_bytes) {
            return damaged(format!("{bytes} bytes of numbers are announced, more than the file can hold"));
        }
        let rows = dataset.lengths.first().copied().unwrap_or(1).max(1);
        let mut whole = Whole::new(bytes, (bytes / rows).saturating_mul(lengths.first().copied().unwrap_or(1)))?;
        for chunk in &chunks {
            let raw = self.chunk(chunk, chunk_bytes as usize, &dataset.filters)?;
            whole.put(&raw, &chunk.start, &lengths, &dataset.lengths, sample.bytes() as u64)?;
        }
        Ok(numbers(whole.source()?, 0))
    }

    /// A chunk's numbers, its filters undone.
    fn chunk(&self, chunk: &Chunk, bytes: usize, filters: &[Filter]) -> Result<Vec<u8>, Fault> {
        if chunk.bytes > MOST_CHUNK_BYTES {
            return damaged(format!("a chunk of {} bytes", chunk.bytes));
        }
        let mut raw = self.fetch(chunk.address, chunk.bytes as usize)?;
        for (place, filter) in filters.iter().enumerate().rev() {
            if chunk.left_out >> place & 1 == 1 {
                continue;
            }
            raw = match filter {
                Filter::Deflate => {
                    let mut inflated = Vec::new();
                    // A checksum may stand behind the numbers.
                    let most = bytes as u64 + 4;
                    ZlibDecoder::new(&raw[..]).take(most).read_to_end(&mut inflated).map_err(|error| {
                        Fault::Damaged(format!("the chunk at byte {} cannot be inflated ({error})", chunk.address))
                    })?;
                    inflated
                }
                Filter::Shuffle { bytes } => unshuffled(&raw, *bytes),
                Filter::Fletcher32 => without_checksum(raw, chunk.address)?,
                Filter::Unread(name) => {
                    return Err(Fault::Unsupported(format!("compressed by {name}; write it again with gzip")));
                }
            };
        }
        if raw.len() < bytes {
            return damaged(format!("the chunk at byte {} has {} bytes, {bytes} are needed", chunk.address, raw.len()));
        }
        Ok(raw)
    }
}

impl Dataset {
    /// Whether its numbers have to be put together before they can be read.
    pub(crate) fn is_in_chunks(&self) -> bool {
        matches!(self.layout, Layout::Chunked { .. } | Layout::SingleChunk { .. } | Layout::Unread(_))
    }

    /// Its elements; `None` where no memory or file holds so many.
    pub(crate) fn count(&self) -> Option<u64> {
        self.lengths.iter().try_fold(1_u64, |count, length| count.checked_mul(*length))
    }
}

/// First bytes of all elements, then second bytes and so on: back to element after element.
fn unshuffled(raw: &[u8], bytes: usize) -> Vec<u8> {
    let elements = raw.len().checked_div(bytes).unwrap_or(0);
    let mut whole = raw.to_vec();
    if elements > 0 {
        for (byte, plane) in raw.chunks_exact(elements).enumerate().take(bytes) {
            for (value, from) in whole.iter_mut().skip(byte).step_by(bytes).zip(plane) {
                *value = *from;
            }
        }
    }
    whole
}

/// Checks and cuts Fletcher's checksum: of 16-bit words, the first byte high, as the library counts it.
fn without_checksum(mut raw: Vec<u8>, address: u64) -> Result<Vec<u8>, Fault> {
    let Some(length) = raw.len().checked_sub(4) else { return damaged("a chunk without its checksum") };
    let found = raw.split_off(length);
    let (pairs, odd) = raw.as_chunks::<2>();
    let mut sums = [0_u32; 2];
    let last = odd.first().map(|byte| [*byte, 0]);
    for pair in pairs.iter().chain(&last) {
        sums[0] = (sums[0] + u32::from(u16::from_be_bytes(*pair))) % 0xffff;
        sums[1] = (sums[1] + sums[0]) % 0xffff;
    }
    // The library's own sums reach 0xffff where these reach 0.
    let same = |sum: u32, bytes: &[u8]| whole_number(bytes, false) % 0xffff == u64::from(sum);
    let (low, high) = found.split_at(2);
    if same(sums[0], low) && same(sums[1], high) {
        return Ok(raw);
    }
    damaged(format!("the checksum of the chunk at byte {address} does not match its numbers"))
}

/// A dataset that is put together of its chunks: in memory, or in a file through the part of it that is being filled.
struct Whole {
    /// Bytes of all.
    bytes: u64,
    file: Option<File>,
    /// All of it; in front of a file its part from `from` on, or nothing, where every number is written as it comes.
    part: Vec<u8>,
    from: u64,
}

impl Whole {
    /// Chunks come in the order of the first dimension, and all that start at one place there take up `band` bytes.
    fn new(bytes: u64, band: u64) -> Result<Self, Fault> {
        if bytes <= MOST_IN_MEMORY {
            return Ok(Self { bytes, file: None, part: vec![0; bytes as usize], from: 0 });
        }
        let file = tempfile::tempfile()?;
        file.set_len(bytes)?;
        let part = vec![0; if band <= MOST_IN_MEMORY { band as usize } else { 0 }];
        Ok(Self { bytes, file: Some(file), part, from: 0 })
    }

    /// Puts the elements of a chunk of `lengths` where they belong in a dataset of `of_all`.
    fn put(&mut self, raw: &[u8], start: &[u64], lengths: &[u64], of_all: &[u64], element: u64) -> Result<(), Fault> {
        // Elements of the chunk along each dimension that are the dataset's: at its end a chunk may reach over.
        let mut inside = Vec::new();
        for ((start, length), all) in start.iter().zip(lengths).zip(of_all) {
            if start >= all || start % length != 0 {
                return damaged(format!("a chunk that starts at element {start} of {all}"));
            }
            inside.push((*length).min(all - start));
        }
        let Some((row, outer)) = inside.split_last() else { return Ok(()) };
        let rows: u64 = outer.iter().product();
        for number in 0..rows {
            // Which row of the chunk that is, dimension by dimension, the last but one fastest.
            let (mut rest, mut from, mut to) = (number, 0, 0);
            let (mut of_chunk, mut of_dataset) = (1, 1);
            let dimensions = inside.iter().zip(start).zip(lengths).zip(of_all).enumerate().rev();
            for (dimension, (((inside, start), length), all)) in dimensions {
                let place = if dimension == outer.len() { 0 } else { rest % inside };
                if dimension < outer.len() {
                    rest /= inside;
                }
                from += place * of_chunk;
                to += (start + place) * of_dataset;
                of_chunk *= length;
                of_dataset *= all;
            }
            let (from, bytes) = ((from * element) as usize, (row * element) as usize);
            let Some(numbers) = raw.get(from..from + bytes) else { return damaged("a chunk that is too short") };
            self.write(to * element, numbers)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u64, bytes: &[u8]) -> Result<(), Fault> {
        if let (Some(file), true) = (&mut self.file, self.part.is_empty()) {
            file.seek(SeekFrom::Start(offset))?;
            return Ok(file.write_all(bytes)?);
        }
        let length = self.part.len() as u64;
        if !(self.from..self.from + length).contains(&offset) {
            self.store()?;
            self.from = offset / length * length;
            self.load()?;
        }
        let at = (offset - self.from) as usize;
        match self.part.get_mut(at..at + bytes.len()) {
            Some(room) => room.copy_from_slice(bytes),
            None => return damaged("a chunk outside its dataset"),
        }
        Ok(())
    }

    /// Bytes of the part that are the dataset's.
    fn part_bytes(&self) -> usize {
        self.part.len().min((self.bytes - self.from.min(self.bytes)) as usize)
    }

    fn store(&mut self) -> Result<(), Fault> {
        let bytes = self.part_bytes();
        if let Some(file) = &mut self.file {
            file.seek(SeekFrom::Start(self.from))?;
            file.write_all(self.part.get(..bytes).unwrap_or_default())?;
        }
        Ok(())
    }

    fn load(&mut self) -> Result<(), Fault> {
        let bytes = self.part_bytes();
        if let Some(file) = &mut self.file {
            file.seek(SeekFrom::Start(self.from))?;
            file.read_exact(self.part.get_mut(..bytes).unwrap_or_default())?;
        }
        Ok(())
    }

    fn source(mut self) -> Result<Source, Fault> {
        self.store()?;
        Ok(match self.file {
            Some(file) => Source::File(file),
            None => Source::Memory(self.part),
        })
    }
}
