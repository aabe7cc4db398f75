//! The elements of a MATLAB v5 file: tags, variables' headers, and where their numbers stand. Files of version 7.3 are handed on.

use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::read::ZlibDecoder;

use super::hdf5::{self, Place};
use crate::record::array::{MOST_IN_MEMORY, Sample, Source};
use crate::record::error::MatError;
use crate::record::hdf5::{Dataset, Hdf5File, is_hdf5};

const FILE_HEADER_BYTES: usize = 128;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
const COMPLEX_FLAG: u32 = 0x0800;
/// Bytes of a variable's flags, dimensions or name; more is damage.
const LONGEST_HEADER_PART: u32 = 1 << 16;
/// MATLAB's own names have 63 bytes at most.
const LONGEST_NAME: usize = 255;

/// What a variable is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// A full array of numbers.
    Numeric,
    /// A sparse matrix.
    Sparse,
    /// Something else, by MATLAB's name for it.
    Other(&'static str),
}

impl fmt::Display for Class {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Class::Numeric => "numeric",
            Class::Sparse => "sparse",
            Class::Other(name) => name,
        })
    }
}

/// A named variable of a MATLAB file.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// What it is.
    pub class: Class,
    /// Its dimensions, two at least.
    pub dimensions: Vec<u64>,
    /// Whether its numbers have an imaginary part.
    pub complex: bool,
    pub(super) storage: Storage,
}

/// Where a variable is in its file.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Storage {
    Version5(Element),
    Hdf5(Box<Place>),
}

impl Variable {
    /// Whether its numbers must be inflated or put together before they can be read.
    pub fn is_compressed(&self) -> bool {
        match &self.storage {
            Storage::Version5(element) => element.compressed,
            Storage::Hdf5(place) => match place.as_ref() {
                Place::Full(object) => object.dataset.as_ref().is_some_and(Dataset::is_in_chunks),
                _ => true,
            },
        }
    }

    /// Its dimensions as people write them: `3 × 2`; of very many the first.
    pub fn dimensions_text(&self) -> String {
        const MOST: usize = 8;
        let first: Vec<String> = self.dimensions.iter().take(MOST).map(u64::to_string).collect();
        let more = if self.dimensions.len() > MOST { " × …" } else { "" };
        format!("{}{more}", first.join(" × "))
    }
}

impl fmt::Display for Variable {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "`{}` ({}, {})", self.name, self.dimensions_text(), self.class)
    }
}

/// An element's content in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Element {
    offset: u64,
    bytes: u64,
    compressed: bool,
}

/// Where a variable's numbers are and how they are stored.
#[derive(Debug)]
pub(super) struct Numbers {
    pub(super) sample: Sample,
    pub(super) big_endian: bool,
    /// Byte of the first number, in the file or in `inflated`.
    pub(super) offset: u64,
    /// The numbers, where they had to be inflated.
    pub(super) inflated: Option<Source>,
}

impl Numbers {
    pub(super) fn none() -> Self {
        Self { sample: Sample::F64, big_endian: false, offset: 0, inflated: Some(Source::Memory(Vec::new())) }
    }
}

/// A MATLAB file, its header read.
#[derive(Debug)]
pub(super) struct MatFile {
    path: PathBuf,
    bytes: u64,
    big_endian: bool,
    /// Of a file of version 7.3.
    hdf5: Option<Hdf5File>,
}

impl MatFile {
    pub(super) fn open(path: &Path) -> Result<Self, MatError> {
        let mut file = File::open(path).map_err(MatError::io(path))?;
        let bytes = file.metadata().map_err(MatError::io(path))?.len();
        if bytes == 0 {
            return Err(MatError::EmptyFile { file: path.to_owned() });
        }
        let mut header = Vec::new();
        (&mut file).take(FILE_HEADER_BYTES as u64).read_to_end(&mut header).map_err(MatError::io(path))?;
        if is_hdf5(path) || header.starts_with(b"MATLAB 7.3") {
            let hdf5 = Some(Hdf5File::open(path)?);
            return Ok(Self { path: path.to_owned(), bytes, big_endian: false, hdf5 });
        }
        // Version 0x0100, then "MI" as a 16-bit number: which shows the file's byte order.
        let big_endian = match header.get(124..) {
            Some([0x00, 0x01, b'I', b'M']) => false,
            Some([0x01, 0x00, b'M', b'I']) => true,
            _ => return Err(MatError::NotMatlab { file: path.to_owned() }),
        };
        Ok(Self { path: path.to_owned(), bytes, big_endian, hdf5: None })
    }

    pub(super) fn variables(&self) -> Result<Vec<Variable>, MatError> {
        if let Some(file) = &self.hdf5 {
            return hdf5::variables(file);
        }
        let mut variables = Vec::new();
        let mut offset = FILE_HEADER_BYTES as u64;
        while offset < self.bytes {
            let part = format!("the element at byte {offset}");
            let tag = self.tag_at(offset).map_err(MatError::reading(&self.path, &part))?;
            let element =
                Element { offset: offset + 8, bytes: u64::from(tag.bytes), compressed: tag.kind == COMPRESSED };
            let end = if tag.packed.is_some() { element.offset } else { element.offset + element.bytes };
            if tag.kind == MATRIX || tag.kind == COMPRESSED {
                let header = self.content(element).and_then(|mut content| content.variable_header());
                // What has no name is MATLAB's own.
                let header = header.map_err(MatError::reading(&self.path, &part))?;
                if let Some(header) = header.filter(|header| !header.name.is_empty()) {
                    let Header { name, class, dimensions, complex } = header;
                    let storage = Storage::Version5(element);
                    variables.push(Variable { name, class, dimensions, complex, storage });
                }
            }
            if end > self.bytes {
                let part = variables.last().map_or(part, |variable| format!("variable `{}`", variable.name));
                return Err(MatError::Truncated { file: self.path.clone(), part });
            }
            offset = end;
        }
        Ok(variables)
    }

    /// Finds a full variable's numbers; inflates them where they are compressed.
    pub(super) fn numbers(&self, variable: &Variable) -> Result<Numbers, MatError> {
        let element = match &variable.storage {
            Storage::Version5(element) => *element,
            Storage::Hdf5(place) => {
                return self.hdf5.as_ref().map_or(Ok(Numbers::none()), |file| hdf5::numbers(file, place));
            }
        };
        let part = format!("variable `{}`", variable.name);
        let reading = MatError::reading(&self.path, &part);
        let mut content = self.after_header(element).map_err(&reading)?;
        let tag = content.tag().map_err(&reading)?;
        let damaged =
            |reason: String| MatError::Damaged { file: self.path.clone(), variable: variable.name.clone(), reason };
        let sample = sample_of(tag.kind).ok_or_else(|| damaged(format!("its numbers are of type {}", tag.kind)))?;
        let expected = variable
            .dimensions
            .iter()
            .try_fold(sample.bytes() as u64, |bytes, length| bytes.checked_mul(*length))
            .unwrap_or(u64::MAX);
        if u64::from(tag.bytes) != expected {
            return Err(damaged(format!(
                "{} bytes of numbers where {} need {expected}",
                tag.bytes,
                variable.dimensions_text()
            )));
        }
        if tag.packed.is_none() && !element.compressed {
            let offset = element.offset + content.consumed;
            if offset + expected > self.bytes {
                return Err(reading(io::ErrorKind::UnexpectedEof.into()));
            }
            return Ok(Numbers { sample, big_endian: self.big_endian, offset, inflated: None });
        }
        let inflated = content.inflated(&tag).map_err(&reading)?;
        Ok(Numbers { sample, big_endian: self.big_endian, offset: 0, inflated: Some(inflated) })
    }

    /// All numbers of a full variable, column after column, `most` at most.
    pub(super) fn full(&self, variable: &Variable, most: u64) -> Result<Vec<f64>, MatError> {
        let element = match &variable.storage {
            Storage::Version5(element) => *element,
            Storage::Hdf5(place) => {
                return self.hdf5.as_ref().map_or(Ok(Vec::new()), |file| hdf5::full(file, place, most));
            }
        };
        let part = format!("variable `{}`", variable.name);
        let reading = MatError::reading(&self.path, &part);
        self.numbers(variable)?; // checks type and size
        self.after_header(element).and_then(|mut content| content.values(most)).map_err(&reading)
    }

    /// Hands out the entries of a sparse variable of so many rows and columns: row and column from 0, and value. No more is read than so
    /// many can have: a small compressed file may announce billions.
    pub(super) fn sparse(
        &self,
        variable: &Variable,
        [rows, columns]: [u64; 2],
        on_entry: &mut dyn FnMut(usize, usize, f64) -> Result<(), MatError>,
    ) -> Result<(), MatError> {
        let damaged = |reason: String| {
            let (file, variable) = (self.path.clone(), variable.name.clone());
            MatError::Damaged { file, variable, reason }
        };
        let element = match &variable.storage {
            Storage::Version5(element) => *element,
            Storage::Hdf5(place) => {
                let Some(file) = &self.hdf5 else { return Ok(()) };
                return hdf5::sparse(file, place, [rows, columns], on_entry, damaged);
            }
        };
        let part = format!("variable `{}`", variable.name);
        let reading = MatError::reading(&self.path, &part);
        let most = rows.saturating_mul(columns);
        let mut content = self.after_header(element).map_err(&reading)?;
        // MATLAB writes one entry where there is none.
        let row_numbers = content.values(most.max(1)).map_err(&reading)?;
        let starts = content.values(columns.saturating_add(1)).map_err(&reading)?;
        let values = content.values(most.max(1)).map_err(&reading)?;
        sparse_columns(&row_numbers, &starts, &values, on_entry, damaged)
    }

    fn tag_at(&self, offset: u64) -> io::Result<Tag> {
        self.from(offset)?.tag()
    }

    /// The file's bytes from `offset` on.
    fn from(&self, offset: u64) -> io::Result<Content> {
        let mut file = File::open(&self.path)?;
        file.seek(SeekFrom::Start(offset))?;
        let reader = Box::new(BufReader::with_capacity(1 << 10, file));
        Ok(Content { reader, big_endian: self.big_endian, consumed: 0 })
    }

    /// A variable's content, inflated where it is compressed.
    fn content(&self, element: Element) -> io::Result<Content> {
        let raw = self.from(element.offset)?;
        if !element.compressed {
            return Ok(raw);
        }
        let inflated = Box::new(BufReader::new(ZlibDecoder::new(raw.reader.take(element.bytes))));
        let mut content = Content { reader: inflated, big_endian: self.big_endian, consumed: 0 };
        match content.tag()?.kind {
            MATRIX => Ok(content),
            kind => Err(invalid(format!("a compressed element of type {kind}, expected a matrix"))),
        }
    }

    /// A variable's content from behind its header on.
    fn after_header(&self, element: Element) -> io::Result<Content> {
        let mut content = self.content(element)?;
        content.variable_header()?;
        Ok(content)
    }
}

/// Hands out the entries of a sparse matrix of compressed columns: row and column from 0, and value.
pub(super) fn sparse_columns(
    rows: &[f64],
    starts: &[f64],
    values: &[f64],
    on_entry: &mut dyn FnMut(usize, usize, f64) -> Result<(), MatError>,
    damaged: impl Fn(String) -> MatError,
) -> Result<(), MatError> {
    for (column, bounds) in starts.windows(2).enumerate() {
        let (start, end) = (bounds[0] as usize, bounds[1] as usize);
        let (Some(rows), Some(values)) = (rows.get(start..end), values.get(start..end)) else {
            let column = column + 1;
            return Err(damaged(format!("column {column} of the sparse matrix has no entries {start} to {end}")));
        };
        rows.iter().zip(values).try_for_each(|(row, value)| on_entry(*row as usize, column, *value))?;
    }
    Ok(())
}

/// An element's tag. Up to four bytes of content can be packed into the tag itself.
#[derive(Debug)]
struct Tag {
    kind: u32,
    bytes: u32,
    packed: Option<[u8; 4]>,
}

/// A variable's header.
struct Header {
    name: String,
    class: Class,
    dimensions: Vec<u64>,
    complex: bool,
}

/// Reads elements one after the other.
struct Content {
    reader: Box<dyn Read>,
    big_endian: bool,
    consumed: u64,
}

impl Content {
    fn bytes<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes)?;
        self.consumed += N as u64;
        Ok(bytes)
    }

    fn number(&self, bytes: [u8; 4]) -> u32 {
        if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }

    fn tag(&mut self) -> io::Result<Tag> {
        let first = self.bytes()?;
        let second = self.bytes()?;
        let kind = self.number(first);
        if kind >> 16 == 0 {
            return Ok(Tag { kind, bytes: self.number(second), packed: None });
        }
        match kind >> 16 {
            bytes @ 1..=4 => Ok(Tag { kind: kind & 0xffff, bytes, packed: Some(second) }),
            bytes => Err(invalid(format!("a packed element of {bytes} bytes, expected 4 at most"))),
        }
    }

    /// The bytes behind `tag`, and past what fills them up to eight.
    fn payload(&mut self, tag: &Tag) -> io::Result<Vec<u8>> {
        if let Some(packed) = tag.packed {
            return Ok(packed.into_iter().take(tag.bytes as usize).collect());
        }
        // Not allocated at once: a damaged tag may claim gigabytes.
        let mut payload = Vec::new();
        let bytes = u64::from(tag.bytes);
        if (&mut self.reader).take(bytes).read_to_end(&mut payload)? as u64 != bytes {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let padding = bytes.next_multiple_of(8) - bytes;
        let skipped = io::copy(&mut (&mut self.reader).take(padding), &mut io::sink())?;
        self.consumed += bytes + skipped;
        Ok(payload)
    }

    /// The bytes behind `tag`, in memory where they are few, else in a file without a name: a small file may inflate to gigabytes.
    fn inflated(&mut self, tag: &Tag) -> io::Result<Source> {
        let bytes = u64::from(tag.bytes);
        if tag.packed.is_some() || bytes <= MOST_IN_MEMORY {
            return self.payload(tag).map(Source::Memory);
        }
        let mut file = tempfile::tempfile()?;
        if io::copy(&mut (&mut self.reader).take(bytes), &mut file)? != bytes {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.consumed += bytes;
        Ok(Source::File(file))
    }

    fn header_part(&mut self) -> io::Result<Vec<u8>> {
        let tag = self.tag()?;
        if tag.bytes > LONGEST_HEADER_PART {
            return Err(invalid(format!("{} bytes in a variable's header", tag.bytes)));
        }
        self.payload(&tag)
    }

    /// Reads a variable's flags, dimensions and name; `None` for what has another layout (objects of newer classes).
    fn variable_header(&mut self) -> io::Result<Option<Header>> {
        let flags = self.header_part()?;
        let Some((flags, _)) = flags.split_first_chunk() else {
            return Err(invalid("a variable without flags".to_owned()));
        };
        let flags = self.number(*flags);
        let class = match flags & 0xff {
            1 => Class::Other("cell"),
            2 => Class::Other("struct"),
            3 => Class::Other("object"),
            4 => Class::Other("char"),
            5 => Class::Sparse,
            6..=15 => Class::Numeric,
            _ => return Ok(None),
        };
        let dimensions = self.header_part()?;
        let (dimensions, _) = dimensions.as_chunks();
        // They are signed (MAT-file format, section "Dimensions array subelement").
        let length = |bytes: &[u8; 4]| {
            let length = self.number(*bytes).cast_signed();
            u64::try_from(length).map_err(|_| invalid(format!("a dimension of {length}")))
        };
        let dimensions: Vec<u64> = dimensions.iter().map(length).collect::<io::Result<_>>()?;
        let name = self.header_part()?;
        if name.len() > LONGEST_NAME {
            return Err(invalid(format!("a variable's name of {} bytes", name.len())));
        }
        let name = String::from_utf8_lossy(&name).escape_debug().to_string();
        Ok(Some(Header { name, class, dimensions, complex: flags & COMPLEX_FLAG != 0 }))
    }

    /// Reads an element of numbers, of which there are `most` at most.
    fn values(&mut self, most: u64) -> io::Result<Vec<f64>> {
        let tag = self.tag()?;
        let sample = sample_of(tag.kind).ok_or_else(|| invalid(format!("numbers of type {}", tag.kind)))?;
        let numbers = u64::from(tag.bytes) / sample.bytes() as u64;
        if numbers > most {
            return Err(invalid(format!("{numbers} numbers where there are {most} at most")));
        }
        let mut raw = self.payload(&tag)?;
        Ok(sample.decode_all(&mut raw, self.big_endian))
    }
}

/// How numbers of an element's type are stored: MATLAB saves whole numbers small, whatever the variable's class.
fn sample_of(kind: u32) -> Option<Sample> {
    Some(match kind {
        1 => Sample::I8,
        2 => Sample::U8,
        3 => Sample::I16,
        4 => Sample::U16,
        5 => Sample::I32,
        6 => Sample::U32,
        7 => Sample::F32,
        9 => Sample::F64,
        12 => Sample::I64,
        13 => Sample::U64,
        _ => return None,
    })
}

fn invalid(reason: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, reason)
}
