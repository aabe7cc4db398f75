//! Messages of an object's header: shape, type, layout, filters and attributes of a dataset, and links of a group.
//!
//! Their layouts are those of the "HDF5 File Format Specification Version 3.0", section IV.A.2.

use super::bytes::{Bytes, Fault, damaged};
use crate::record::array::Sample;

/// Dimensions of a dataset; the library allows as many.
const MOST_DIMENSIONS: usize = 32;
/// Filters one after the other; the library allows as many.
const MOST_FILTERS: usize = 32;

/// What [`Kind::Other`] calls elements of several parts.
pub(crate) const COMPOUND: &str = "a compound (complex numbers, or records)";

/// What a dataset's or an attribute's elements are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Real numbers.
    Number { sample: Sample, big_endian: bool },
    /// Text of a fixed length, in bytes.
    Text,
    /// Text that stands elsewhere in the file.
    LongText,
    /// Something else, in a word.
    Other(&'static str),
}

/// A type, and the bytes of an element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Datatype {
    pub(super) kind: Kind,
    pub(super) bytes: usize,
}

/// Where a dataset's numbers are.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Layout {
    Compact(Vec<u8>),
    /// `None` where nothing was ever written.
    Contiguous {
        address: Option<u64>,
        bytes: u64,
    },
    /// With chunks of so many elements along each dimension, and the tree that lists them.
    Chunked {
        tree: Option<u64>,
        chunk: Vec<u64>,
    },
    /// One chunk for all: its address, the bytes that it takes where they are filtered, and the filters that were left out.
    SingleChunk {
        address: Option<u64>,
        filtered: Option<(u64, u32)>,
    },
    /// What is not read, in words.
    Unread(String),
}

/// What was done to a chunk's bytes, in the order of writing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Filter {
    Deflate,
    Shuffle { bytes: usize },
    Fletcher32,
    Unread(String),
}

/// What an attribute says.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Number(f64),
    Text(String),
    /// The address of a heap, and the index of the text in it.
    Elsewhere {
        address: u64,
        index: u32,
    },
    Other,
}

/// An attribute of a dataset or a group.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Attribute {
    pub(crate) name: String,
    pub(crate) value: Value,
}

/// Lengths along the dimensions; none of a scalar, and `None` of what has no elements at all.
pub(super) fn dataspace(mut bytes: Bytes<'_>) -> Result<Option<Vec<u64>>, Fault> {
    let (version, rank) = (bytes.byte()?, usize::from(bytes.byte()?));
    bytes.byte()?;
    match version {
        1 => drop(bytes.take(5)?),
        2 if bytes.byte()? == 2 => return Ok(None),
        2 => {}
        _ => return damaged(format!("a dataspace of version {version}")),
    }
    if rank > MOST_DIMENSIONS {
        return damaged(format!("{rank} dimensions"));
    }
    (0..rank).map(|_| bytes.length()).collect::<Result<Vec<u64>, _>>().map(Some)
}

pub(super) fn datatype(bytes: &mut Bytes<'_>) -> Result<Datatype, Fault> {
    let first = bytes.byte()?;
    let bits = bytes.number(3)?;
    let size = bytes.word()? as usize;
    let (class, big_endian) = (first & 0x0f, bits & 1 == 1);
    let kind = match class {
        0 => {
            let whole = [bytes.number(2)?, bytes.number(2)?] == [0, 8 * size as u64];
            match (size, bits & 8 != 0) {
                _ if !whole => Kind::Other("integers that do not fill their bytes"),
                (1, true) => Kind::Number { sample: Sample::I8, big_endian },
                (1, false) => Kind::Number { sample: Sample::U8, big_endian },
                (2, true) => Kind::Number { sample: Sample::I16, big_endian },
                (2, false) => Kind::Number { sample: Sample::U16, big_endian },
                (4, true) => Kind::Number { sample: Sample::I32, big_endian },
                (4, false) => Kind::Number { sample: Sample::U32, big_endian },
                (8, true) => Kind::Number { sample: Sample::I64, big_endian },
                (8, false) => Kind::Number { sample: Sample::U64, big_endian },
                _ => Kind::Other("integers of an unusual size"),
            }
        }
        1 => {
            let fields = [bytes.number(2)?, bytes.number(2)?];
            // Where the exponent stands and its size, the same of the mantissa, and what is added to the exponent: IEEE 754 or not.
            let form = [bytes.number(1)?, bytes.number(1)?, bytes.number(1)?, bytes.number(1)?, bytes.number(4)?];
            match (size, fields, form) {
                _ if bits & 0x40 != 0 => Kind::Other("VAX numbers"),
                (4, [0, 32], [23, 8, 0, 23, 127]) => Kind::Number { sample: Sample::F32, big_endian },
                (8, [0, 64], [52, 11, 0, 52, 1023]) => Kind::Number { sample: Sample::F64, big_endian },
                _ => Kind::Other("numbers of another precision than single and double"),
            }
        }
        3 => Kind::Text,
        6 => Kind::Other(COMPOUND),
        7 => Kind::Other("references"),
        8 => Kind::Other("an enumeration"),
        9 if bits & 0x0f == 1 => Kind::LongText,
        9 => Kind::Other("lists of any length"),
        _ => Kind::Other("an unusual type"),
    };
    if size == 0 {
        return damaged("elements of no bytes");
    }
    Ok(Datatype { kind, bytes: size })
}

pub(super) fn layout(mut bytes: Bytes<'_>) -> Result<Layout, Fault> {
    const COMPACT: u8 = 0;
    const CONTIGUOUS: u8 = 1;
    const CHUNKED: u8 = 2;
    let version = bytes.byte()?;
    match version {
        1 | 2 => {
            let (rank, class) = (usize::from(bytes.byte()?), bytes.byte()?);
            bytes.take(5)?;
            let address = if class == COMPACT { None } else { bytes.address()? };
            let lengths = (0..rank.min(MOST_DIMENSIONS + 1))
                .map(|_| Ok(u64::from(bytes.word()?)))
                .collect::<Result<Vec<u64>, Fault>>()?;
            match class {
                COMPACT => {
                    let count = bytes.word()? as usize;
                    Ok(Layout::Compact(bytes.take(count)?.to_vec()))
                }
                // Its size is that of the elements.
                CONTIGUOUS => Ok(Layout::Contiguous { address, bytes: u64::MAX }),
                CHUNKED => Ok(Layout::Chunked { tree: address, chunk: without_element(lengths)? }),
                _ => damaged(format!("a layout of class {class}")),
            }
        }
        3..=5 => match bytes.byte()? {
            COMPACT => {
                let count = bytes.short()?;
                Ok(Layout::Compact(bytes.take(count)?.to_vec()))
            }
            CONTIGUOUS => Ok(Layout::Contiguous { address: bytes.address()?, bytes: bytes.length()? }),
            CHUNKED if version == 3 => {
                let rank = usize::from(bytes.byte()?).min(MOST_DIMENSIONS + 1);
                let tree = bytes.address()?;
                let lengths = (0..rank).map(|_| Ok(u64::from(bytes.word()?))).collect::<Result<Vec<u64>, Fault>>()?;
                Ok(Layout::Chunked { tree, chunk: without_element(lengths)? })
            }
            CHUNKED => chunked_4(&mut bytes),
            3 => Ok(Layout::Unread("a virtual dataset, whose numbers are in other files".to_owned())),
            class => damaged(format!("a layout of class {class}")),
        },
        _ => Ok(Layout::Unread(format!(
            "of a layout of version {version}; write the file again with h5py.File(..., libver='earliest')"
        ))),
    }
}

/// Chunks as the library writes them for its newest format.
fn chunked_4(bytes: &mut Bytes<'_>) -> Result<Layout, Fault> {
    const FILTERED_SINGLE: u8 = 2;
    let flags = bytes.byte()?;
    let (rank, width) = (usize::from(bytes.byte()?), usize::from(bytes.byte()?));
    if rank > MOST_DIMENSIONS + 1 || !(1..=8).contains(&width) {
        return damaged(format!("chunks of {rank} dimensions, each of {width} bytes"));
    }
    for _ in 0..rank {
        bytes.number(width)?;
    }
    match bytes.byte()? {
        1 => {
            let filtered = flags & FILTERED_SINGLE != 0;
            let filtered = if filtered { Some((bytes.length()?, bytes.word()?)) } else { None };
            Ok(Layout::SingleChunk { address: bytes.address()?, filtered })
        }
        _ => Ok(Layout::Unread(
            "in chunks that only the newest libraries list so; write the file again with h5py.File(..., libver='earliest')"
                .to_owned(),
        )),
    }
}

/// The last of a chunk's lengths is the size of an element.
fn without_element(mut lengths: Vec<u64>) -> Result<Vec<u64>, Fault> {
    lengths.pop();
    if lengths.is_empty() || lengths.contains(&0) {
        return damaged("chunks without a size");
    }
    Ok(lengths)
}

pub(super) fn filters(mut bytes: Bytes<'_>) -> Result<Vec<Filter>, Fault> {
    let (version, count) = (bytes.byte()?, usize::from(bytes.byte()?));
    match version {
        1 => drop(bytes.take(6)?),
        2 => {}
        _ => return damaged(format!("filters of version {version}")),
    }
    if count > MOST_FILTERS {
        return damaged(format!("{count} filters"));
    }
    let mut filters = Vec::new();
    for _ in 0..count {
        let number = bytes.short()?;
        let name_bytes = if version == 1 || number >= 256 { bytes.short()? } else { 0 };
        bytes.short()?;
        let values = bytes.short()?;
        let name = bytes.take(if version == 1 { name_bytes.next_multiple_of(8) } else { name_bytes })?;
        let mut of_client = Bytes::new(bytes.take(4 * values)?, bytes.sizes());
        if version == 1 && values % 2 == 1 {
            bytes.take(4)?;
        }
        filters.push(match number {
            1 => Filter::Deflate,
            2 => Filter::Shuffle { bytes: of_client.word()? as usize },
            3 => Filter::Fletcher32,
            _ => Filter::Unread(match number {
                4 => "szip".to_owned(),
                5 => "nbit".to_owned(),
                6 => "scaleoffset".to_owned(),
                32000 => "lzf".to_owned(),
                _ => format!("number {number} ({})", text(name)),
            }),
        });
    }
    Ok(filters)
}

/// `None` where its type is kept elsewhere.
pub(super) fn attribute(mut bytes: Bytes<'_>) -> Result<Option<Attribute>, Fault> {
    let (version, flags) = (bytes.byte()?, bytes.byte()?);
    if !(1..=3).contains(&version) {
        return damaged(format!("an attribute of version {version}"));
    }
    let [name, kind, space] = [bytes.short()?, bytes.short()?, bytes.short()?];
    if version == 3 {
        bytes.byte()?;
    }
    let padded = |size: usize| if version == 1 { size.next_multiple_of(8) } else { size };
    let name = text(bytes.take(padded(name))?);
    let kind = bytes.take(padded(kind))?;
    let space = Bytes::new(bytes.take(padded(space))?, bytes.sizes());
    if version > 1 && flags & 3 != 0 {
        return Ok(None);
    }
    let kind = datatype(&mut Bytes::new(kind, bytes.sizes()))?;
    let elements =
        dataspace(space)?.map_or(0, |lengths| lengths.iter().fold(1, |all: u64, one| all.saturating_mul(*one)));
    if elements != 1 {
        return Ok(Some(Attribute { name, value: Value::Other }));
    }
    let value = match kind.kind {
        Kind::Number { sample, big_endian } => {
            let mut raw = bytes.take(kind.bytes)?.to_vec();
            sample.decode_all(&mut raw, big_endian).first().map_or(Value::Other, |number| Value::Number(*number))
        }
        Kind::Text => Value::Text(text(bytes.take(kind.bytes)?)),
        Kind::LongText => {
            bytes.word()?;
            match bytes.address()? {
                Some(address) => Value::Elsewhere { address, index: bytes.word()? },
                None => Value::Text(String::new()),
            }
        }
        Kind::Other(_) => Value::Other,
    };
    Ok(Some(Attribute { name, value }))
}

/// A link of a group: its name, and the address of what it leads to; `None` of one that leads to a name or another file.
pub(super) fn link(mut bytes: Bytes<'_>) -> Result<Option<(String, u64)>, Fault> {
    let version = bytes.byte()?;
    if version != 1 {
        return damaged(format!("a link of version {version}"));
    }
    let flags = bytes.byte()?;
    let is_hard = flags & 0x08 == 0 || bytes.byte()? == 0;
    bytes.take(if flags & 0x04 != 0 { 8 } else { 0 })?;
    bytes.take(if flags & 0x10 != 0 { 1 } else { 0 })?;
    let length = bytes.number(1 << (flags & 3))?;
    let name = text(bytes.take(usize::try_from(length).unwrap_or(usize::MAX))?);
    if !is_hard {
        return Ok(None);
    }
    Ok(bytes.address()?.map(|address| (name, address)))
}

/// Whether a group's links stand in a heap of their own.
pub(super) fn has_heap_of_links(mut bytes: Bytes<'_>) -> Result<bool, Fault> {
    bytes.byte()?;
    let flags = bytes.byte()?;
    bytes.take(if flags & 1 != 0 { 8 } else { 0 })?;
    Ok(bytes.address()?.is_some())
}

/// Text up to its first zero byte, printable.
pub(super) fn text(bytes: &[u8]) -> String {
    let bytes = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(bytes).escape_debug().to_string()
}
