//! NPY files: recordings of `rows × channels` or of one channel, and matrices.
//!
//! The format is that of NumPy Enhancement Proposal 1: a short header, a Python dictionary, that says type, order and
//! shape, then the numbers. The header is read here and not by a library because a damaged one must not end the
//! program: those at hand multiply the shape unchecked and follow nested brackets without a limit.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use thiserror::Error;

use super::array::{ArrayReader, Layout, Sample, Source};
use super::error::{RecordError, quoted};

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// NumPy itself refuses longer headers.
const LONGEST_HEADER: u64 = 10_000;

/// What a header says.
#[derive(Debug, PartialEq)]
struct Header {
    descr: String,
    fortran_order: bool,
    shape: Vec<u64>,
}

/// An array in a file, of real numbers as its header describes them.
#[derive(Debug)]
pub(crate) struct NpyArray {
    path: PathBuf,
    file: File,
    header: Header,
    sample: Sample,
    big_endian: bool,
    /// Byte at which the numbers start.
    offset: u64,
    /// Bytes from there on.
    found: u64,
}

impl NpyArray {
    /// Reads the header of an NPY file.
    ///
    /// # Errors
    /// [`RecordError`] names the file and what is wrong with its header.
    pub(crate) fn open(path: &Path) -> Result<Self, RecordError> {
        let file = File::open(path).map_err(RecordError::io(path))?;
        let file_bytes = file.metadata().map_err(RecordError::io(path))?.len();
        let damaged = |reason: String| RecordError::NpyHeader { file: path.to_owned(), reason };
        let (text, offset) = header_text(BufReader::new(&file)).map_err(damaged)?;
        let header = parse_header(&text).map_err(damaged)?;
        let (sample, big_endian) = sample_type(&header.descr).ok_or_else(|| {
            let (file, found) = (path.to_owned(), header.descr.clone());
            if is_complex(&found) {
                RecordError::ComplexNumbers { file, found }
            } else {
                RecordError::WrongDtype { file, found }
            }
        })?;
        let found = file_bytes.saturating_sub(offset);
        Ok(Self { path: path.to_owned(), file, header, sample, big_endian, offset, found })
    }

    /// Numbers along each dimension.
    pub(crate) fn shape(&self) -> &[u64] {
        &self.header.shape
    }

    /// Reads all numbers of an array of two dimensions.
    ///
    /// # Errors
    /// [`RecordError`] where it has other dimensions, is cut short or cannot be read.
    pub(crate) fn read_matrix(self) -> Result<DMatrix<f64>, RecordError> {
        let [rows, columns] = self.header.shape[..] else { return Err(shape_error(&self.path, self.shape())) };
        let row_by_row = !self.header.fortran_order;
        self.reader(rows, columns, row_by_row)?.read_matrix()
    }

    /// A reader of the numbers as `rows × columns`.
    fn reader(self, rows: u64, columns: u64, row_by_row: bool) -> Result<ArrayReader, RecordError> {
        let Self { path, file, header, sample, big_endian, offset, found } = self;
        let wrong_shape = || shape_error(&path, &header.shape);
        let columns = usize::try_from(columns).map_err(|_| wrong_shape())?;
        let layout = Layout { offset, sample, big_endian, rows, columns, row_by_row };
        let expected = layout.bytes().ok_or_else(wrong_shape)?;
        if found < expected {
            return Err(RecordError::Truncated { file: path, expected, found });
        }
        if found > expected {
            // A damaged shape would take some of the numbers, and perhaps in the wrong order.
            let reason = format!("its header says {rows} × {columns} numbers, {expected} bytes, but {found} follow");
            return Err(RecordError::NpyHeader { file: path, reason });
        }
        Ok(ArrayReader::new(path, Source::File(file), layout))
    }
}

/// Opens an NPY file for reading row by row. Of two dimensions the longer is time (the first, where they are equal).
pub(super) fn open(path: &Path) -> Result<ArrayReader, RecordError> {
    if path.metadata().map_err(RecordError::io(path))?.len() == 0 {
        return Err(RecordError::Empty { file: path.to_owned() });
    }
    let array = NpyArray::open(path)?;
    let (first, second) = match array.header.shape[..] {
        [rows] => (rows, 1),
        [first, second] => (first, second),
        _ => return Err(shape_error(path, array.shape())),
    };
    if first == 0 || second == 0 {
        return Err(RecordError::Empty { file: path.to_owned() });
    }
    // In C order the second index runs fastest: a row stands together if rows are the first dimension.
    let time_first = first >= second || array.shape().len() == 1;
    let (rows, columns) = if time_first { (first, second) } else { (second, first) };
    let row_by_row = time_first != array.header.fortran_order;
    array.reader(rows, columns, row_by_row)
}

/// Why an array of one dimension is not read.
#[derive(Debug, Error)]
pub(crate) enum RowError {
    /// Its numbers are complex.
    #[error("its numbers are complex (`{0}`)")]
    Complex(String),
    /// Anything else, as a sentence.
    #[error("{0}")]
    Unusable(String),
}

impl From<String> for RowError {
    fn from(reason: String) -> Self {
        Self::Unusable(reason)
    }
}

/// The numbers of an array of one dimension that a reader holds, at most so many.
///
/// # Errors
/// [`RowError`], where it is none, of other numbers than real ones, longer, or cut short.
pub(crate) fn read_row(mut reader: impl Read, most: u64) -> Result<Vec<f64>, RowError> {
    let (text, _) = header_text(&mut reader)?;
    let header = parse_header(&text)?;
    if is_complex(&header.descr) {
        return Err(RowError::Complex(header.descr));
    }
    let (sample, big_endian) =
        sample_type(&header.descr).ok_or_else(|| format!("its numbers are of type `{}`", header.descr))?;
    let &[length] = &header.shape[..] else {
        return Err(format!("its shape is {:?}, not one row", header.shape).into());
    };
    if length > most {
        return Err(format!("it announces {length} numbers, and no more than {most} are read").into());
    }
    let bytes = length * sample.bytes() as u64;
    let mut raw = Vec::new();
    reader.take(bytes).read_to_end(&mut raw).map_err(|error| error.to_string())?;
    if (raw.len() as u64) < bytes {
        return Err("it is cut short".to_owned().into());
    }
    Ok(sample.decode_all(&mut raw, big_endian))
}

fn shape_error(path: &Path, shape: &[u64]) -> RecordError {
    RecordError::Shape { file: path.to_owned(), shape: format!("{shape:?}") }
}

/// The header's text, and the byte at which the numbers start.
fn header_text(mut reader: impl Read) -> Result<(Vec<u8>, u64), String> {
    let mut start = [0; 8];
    let cut = |_| "it ends within its header".to_owned();
    reader.read_exact(&mut start).map_err(cut)?;
    let Some([major, _]) = start.strip_prefix(MAGIC) else {
        return Err(format!("it starts with `{}`", quoted(&start)));
    };
    let (length, before) = match major {
        1 => {
            let mut length = [0; 2];
            reader.read_exact(&mut length).map_err(cut)?;
            (u64::from(u16::from_le_bytes(length)), 10)
        }
        2 | 3 => {
            let mut length = [0; 4];
            reader.read_exact(&mut length).map_err(cut)?;
            (u64::from(u32::from_le_bytes(length)), 12)
        }
        _ => return Err(format!("its format version {major} is unknown (1, 2 and 3 are known)")),
    };
    if length > LONGEST_HEADER {
        return Err(format!("its header of {length} bytes is no description of a plain array"));
    }
    let mut text = Vec::new();
    reader.take(length).read_to_end(&mut text).map_err(|error| error.to_string())?;
    if (text.len() as u64) < length {
        return Err("it ends within its header".to_owned());
    }
    Ok((text, before + length))
}

/// Reads `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 2), }`.
fn parse_header(text: &[u8]) -> Result<Header, String> {
    let text = std::str::from_utf8(text).map_err(|_| "its header is not text".to_owned())?;
    let value_of = |key: &str| {
        let found = ['\'', '"'].into_iter().find_map(|quote| text.split_once(&format!("{quote}{key}{quote}")));
        let value = found.and_then(|(_, rest)| rest.trim_start().strip_prefix(':'));
        value.map(str::trim_start).ok_or_else(|| format!("its header has no `{key}`"))
    };
    let descr = value_of("descr")?;
    let fortran = value_of("fortran_order")?;
    let shape = value_of("shape")?;
    // A description that is not one quoted word (a list: named fields) is kept as written, to be refused by name.
    let descr = ['\'', '"']
        .into_iter()
        .find_map(|quote| descr.strip_prefix(quote)?.split_once(quote))
        .map_or_else(|| quoted(descr.as_bytes()), |(word, _)| word.escape_debug().to_string());
    let fortran_order = match (fortran.starts_with("True"), fortran.starts_with("False")) {
        (true, _) => true,
        (_, true) => false,
        _ => return Err("its `fortran_order` is neither True nor False".to_owned()),
    };
    let inside = shape.strip_prefix('(').and_then(|rest| rest.split_once(')')).map(|(inside, _)| inside.trim());
    let inside = inside.ok_or_else(|| "its `shape` is not a tuple".to_owned())?;
    let shape = match inside.strip_suffix(',').unwrap_or(inside) {
        "" => Vec::new(),
        lengths => lengths
            .split(',')
            .map(|length| {
                length.trim().parse().map_err(|_| format!("its `shape` holds `{}`", quoted(length.as_bytes())))
            })
            .collect::<Result<_, _>>()?,
    };
    Ok(Header { descr, fortran_order, shape })
}

/// Whether the numbers that NumPy describes so are complex: `<c8`, `<c16`.
fn is_complex(descr: &str) -> bool {
    descr.trim_start_matches(['<', '>', '|', '=']).starts_with('c')
}

/// How the numbers that NumPy describes so are stored, and whether big-endian; `None` where they are no real numbers.
fn sample_type(descr: &str) -> Option<(Sample, bool)> {
    let (order, kind) = descr.split_at_checked(1)?;
    let sample = match kind {
        "i1" => Sample::I8,
        "u1" => Sample::U8,
        "i2" => Sample::I16,
        "u2" => Sample::U16,
        "i4" => Sample::I32,
        "u4" => Sample::U32,
        "i8" => Sample::I64,
        "u8" => Sample::U64,
        "f4" => Sample::F32,
        "f8" => Sample::F64,
        _ => return None,
    };
    match order {
        "<" | "|" => Some((sample, false)),
        ">" => Some((sample, true)),
        _ => None,
    }
}
