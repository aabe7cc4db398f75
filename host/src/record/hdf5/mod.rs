//! HDF5 files, as h5py, MATLAB (v7.3) and programs for data acquisition write them: the tree of groups and datasets, their attributes and
//! their numbers.
//!
//! The format is that of the "HDF5 File Format Specification Version 3.0". It is read here and not by a library: those in Rust are of 30 000
//! lines and more, map files into memory or read them whole, while a recording needs little of the format and must be streamed. What is read:
//! superblocks 0 to 3, headers of both versions, groups by symbol table or by links in their header, datasets in one piece or in chunks with
//! gzip, shuffle and Fletcher32. Sizes that a file announces are checked against its own before anything is taken for them.

mod bytes;
mod data;
mod message;
pub(super) mod recording;
mod tree;

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use bytes::{Bytes, Fault, Sizes, damaged};
use message::{Filter, Layout};

pub(crate) use message::{Attribute, COMPOUND, Kind, Value};

const SIGNATURE: &[u8; 8] = b"\x89HDF\r\n\x1a\n";
/// A user's own block may stand before the file; its length is a power of two.
const LAST_START: u64 = 1 << 24;
/// Groups in groups.
const MOST_LEVELS: usize = 32;
/// Groups and datasets that are looked at.
const MOST_OBJECTS: usize = 100_000;
/// Messages of one header.
const MOST_MESSAGES: usize = 1 << 14;
/// Pieces of one header.
const MOST_PIECES: usize = 256;
/// Bytes of one piece of a header.
const MOST_PIECE_BYTES: u64 = 1 << 22;

/// Why an HDF5 file was refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what each field is
pub enum Hdf5Error {
    #[error("{} cannot be read: {source}", file.display())]
    Io { file: PathBuf, source: std::io::Error },
    #[error("{} is not an HDF5 file: write it again with h5py, or with save('name.mat', '-v7.3') in MATLAB", file.display())]
    NotHdf5 { file: PathBuf },
    #[error("{}, {place}: damaged: {reason}; copy or save the file again", file.display())]
    Damaged { file: PathBuf, place: String, reason: String },
    #[error("{}, {place}: {}", file.display(), not_read(what))]
    Unread { file: PathBuf, place: String, what: String },
}

/// That something is not read, and then what to do where that is known.
fn not_read(what: &str) -> String {
    match what.split_once("; ") {
        Some((what, advice)) => format!("{what}, which is not read; {advice}"),
        None => format!("{what}, which is not read"),
    }
}

/// A group or a dataset.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Object {
    /// From the root: `measurement/top-x`; empty of the root.
    pub(crate) path: String,
    pub(crate) attributes: Vec<Attribute>,
    /// `None` of a group.
    pub(crate) dataset: Option<Dataset>,
}

/// An array of numbers, or of something else.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Dataset {
    /// Lengths along its dimensions.
    pub(crate) lengths: Vec<u64>,
    /// What its elements are.
    pub(crate) kind: Kind,
    layout: Layout,
    filters: Vec<Filter>,
}

impl Object {
    /// The text of an attribute.
    pub(crate) fn text(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find_map(|attribute| match &attribute.value {
            Value::Text(text) if attribute.name == name => Some(text.as_str()),
            _ => None,
        })
    }

    /// The number of an attribute.
    pub(crate) fn number(&self, name: &str) -> Option<f64> {
        self.attributes.iter().find_map(|attribute| match attribute.value {
            Value::Number(number) if attribute.name == name => Some(number),
            _ => None,
        })
    }
}

/// An HDF5 file, its superblock read.
#[derive(Debug)]
pub(crate) struct Hdf5File {
    path: PathBuf,
    file: File,
    /// Bytes of the whole file.
    size: u64,
    /// Where addresses count from.
    base: u64,
    sizes: Sizes,
    /// Address of the root group's header.
    root: u64,
}

/// Whether a file starts as one of HDF5, with its signature at the start or behind MATLAB's block.
pub(crate) fn is_hdf5(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(520).read_to_end(&mut start));
    read.is_ok() && (start.starts_with(SIGNATURE) || start.get(512..).is_some_and(|rest| rest == SIGNATURE))
}

impl Hdf5File {
    /// # Errors
    /// Where the file cannot be read, is none of HDF5, or its superblock is damaged.
    pub(crate) fn open(path: &Path) -> Result<Self, Hdf5Error> {
        let io = |source| Hdf5Error::Io { file: path.to_owned(), source };
        let file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let starts = std::iter::once(0).chain((9..).map(|power| 1 << power)).take_while(|start| *start <= LAST_START);
        let mut opened =
            Self { path: path.to_owned(), file, size, base: 0, sizes: Sizes { address: 8, length: 8 }, root: 0 };
        for start in starts.take_while(|start| start.saturating_add(8) <= size) {
            if opened.fetch(start, 8).is_ok_and(|found| found == SIGNATURE) {
                let read = opened.read_superblock(start);
                read.map_err(|fault| opened.error("its first block", fault))?;
                return Ok(opened);
            }
        }
        Err(Hdf5Error::NotHdf5 { file: path.to_owned() })
    }

    fn read_superblock(&mut self, start: u64) -> Result<(), Fault> {
        // The longest has 4 + 20 + 6 addresses of 8 bytes; those of small files may end before.
        let room = self.size.saturating_sub(start + 8).min(120);
        let block = self.fetch(start + 8, room as usize)?;
        let mut block = Bytes::new(&block, self.sizes);
        let version = block.byte()?;
        let before = if version < 2 { 4 } else { 0 };
        if version > 3 {
            return Err(Fault::Unsupported(format!("a superblock of version {version}")));
        }
        block.take(before)?;
        let sizes = Sizes { address: usize::from(block.byte()?), length: usize::from(block.byte()?) };
        if !(matches!(sizes.address, 2 | 4 | 8) && matches!(sizes.length, 2 | 4 | 8)) {
            return damaged(format!("addresses of {} and lengths of {} bytes", sizes.address, sizes.length));
        }
        block = Bytes::new(block.take(block.left())?, sizes);
        block.take(match version {
            0 => 9,
            1 => 13,
            _ => 1,
        })?;
        for _ in 0..if version < 2 { 4 } else { 3 } {
            block.address()?;
        }
        if version < 2 {
            block.address()?; // the root's name
        }
        let Some(root) = block.address()? else { return damaged("no root group") };
        (self.base, self.sizes, self.root) = (start, sizes, root);
        Ok(())
    }

    /// All groups and datasets, the root first, each before its members.
    ///
    /// # Errors
    /// Where the file is damaged, or lists the members of a group in a way that is not read.
    pub(crate) fn objects(&self) -> Result<Vec<Object>, Hdf5Error> {
        let mut objects = Vec::new();
        // Links may go round in circles, and one object may have several names: it goes by the first.
        let mut seen = HashSet::from([self.root]);
        let mut open = vec![(String::new(), self.root, 0)];
        while let Some((path, address, level)) = open.pop() {
            let place = if path.is_empty() { "the root group".to_owned() } else { format!("`{path}`") };
            let (object, members) = self.object(path, address).map_err(|fault| self.error(&place, fault))?;
            if level == MOST_LEVELS || objects.len() >= MOST_OBJECTS {
                let reason = format!("more than {MOST_LEVELS} groups in each other, or {MOST_OBJECTS} altogether");
                return Err(self.error(&place, Fault::Damaged(reason)));
            }
            for (name, member) in members.into_iter().rev() {
                if seen.insert(member) {
                    let slash = if object.path.is_empty() { "" } else { "/" };
                    open.push((format!("{}{slash}{name}", object.path), member, level + 1));
                }
            }
            objects.push(object);
        }
        Ok(objects)
    }

    /// An object, and the names and addresses of its members.
    fn object(&self, path: String, address: u64) -> Result<(Object, Vec<(String, u64)>), Fault> {
        const DATASPACE: u64 = 0x01;
        const LINK_INFO: u64 = 0x02;
        const DATATYPE: u64 = 0x03;
        const LINK: u64 = 0x06;
        const LAYOUT: u64 = 0x08;
        const FILTERS: u64 = 0x0b;
        const ATTRIBUTE: u64 = 0x0c;
        const SYMBOL_TABLE: u64 = 0x11;
        let (mut members, mut attributes) = (Vec::new(), Vec::new());
        let (mut lengths, mut kind, mut layout, mut filters) = (None, None, None, Vec::new());
        for Message { number, shared, content } in self.messages(address)? {
            let mut bytes = self.bytes(&content);
            match number {
                _ if shared => {}
                DATASPACE => lengths = message::dataspace(bytes)?,
                DATATYPE => kind = Some(message::datatype(&mut bytes)?),
                LAYOUT => layout = Some(message::layout(bytes)?),
                FILTERS => filters = message::filters(bytes)?,
                ATTRIBUTE => attributes.extend(message::attribute(bytes)?),
                LINK => members.extend(message::link(bytes)?),
                LINK_INFO if message::has_heap_of_links(bytes)? => {
                    return Err(Fault::Unsupported(
                        "a group with its members in a heap; write the file again with h5py.File(..., libver='earliest')".to_owned(),
                    ));
                }
                SYMBOL_TABLE => {
                    if let (Some(tree), Some(heap)) = (bytes.address()?, bytes.address()?) {
                        members.extend(tree::members(self, tree, heap)?);
                    }
                }
                _ => {}
            }
        }
        for attribute in &mut attributes {
            if let Value::Elsewhere { address, index } = attribute.value {
                attribute.value = Value::Text(self.long_text(address, index)?);
            }
        }
        let dataset = layout.map(|layout| {
            let kind = kind.map_or(Kind::Other("a type kept elsewhere in the file"), |kind| kind.kind);
            Dataset { lengths: lengths.unwrap_or_else(|| vec![0]), kind, layout, filters }
        });
        Ok((Object { path, attributes, dataset }, members))
    }

    /// The messages of a header, those in its continuations included.
    fn messages(&self, address: u64) -> Result<Vec<Message>, Fault> {
        let start = self.fetch(address, 8)?;
        let is_second = start.starts_with(b"OHDR");
        let mut pieces = Vec::new();
        let mut tracks_order = false;
        if is_second {
            let flags = start.get(5).copied().unwrap_or_default();
            tracks_order = flags & 0x04 != 0;
            let times = if flags & 0x20 != 0 { 16 } else { 0 };
            let phases = if flags & 0x10 != 0 { 4 } else { 0 };
            let (before, width) = (6 + times + phases, 1_usize << (flags & 3));
            let head = self.fetch(address, before + width)?;
            let mut head = self.bytes(&head);
            head.take(before)?;
            let bytes = head.number(width)?;
            pieces.push((address.saturating_add((before + width) as u64), bytes));
        } else {
            let [1, _, _, _, _, _, _, _] = start[..] else {
                return damaged(format!("no header of an object at byte {address}"));
            };
            let head = self.fetch(address, 16)?;
            let mut head = self.bytes(&head);
            head.take(8)?;
            pieces.push((address.saturating_add(16), u64::from(head.word()?)));
        }
        let mut messages = Vec::new();
        let mut next = 0;
        while let Some((address, bytes)) = pieces.get(next).copied() {
            next += 1;
            if next > MOST_PIECES || bytes > MOST_PIECE_BYTES {
                return damaged("a header in more or longer pieces than any has");
            }
            let piece = self.fetch(address, bytes as usize)?;
            let mut piece = self.bytes(&piece);
            if is_second && next > 1 && piece.take(4)? != b"OCHK" {
                return damaged(format!("no continuation of a header at byte {address}"));
            }
            // The continuations of the second version end with their checksum; a gap shorter than a message may stand before it.
            let end = if is_second && next > 1 { 4 } else { 0 };
            let head = if is_second { 4 + if tracks_order { 2 } else { 0 } } else { 8 };
            while piece.left() >= head + end {
                const CONTINUATION: u64 = 0x10;
                let number = if is_second { piece.number(1)? } else { piece.number(2)? };
                let (size, flags) = (piece.short()?, piece.byte()?);
                piece.take(if is_second { head - 4 } else { 3 })?;
                let content = piece.take(size)?;
                if number == CONTINUATION {
                    let mut content = self.bytes(content);
                    if let Some(address) = content.address()? {
                        pieces.push((address, content.length()?));
                    }
                    continue;
                }
                if messages.len() >= MOST_MESSAGES {
                    return damaged("a header of more messages than any has");
                }
                messages.push(Message { number, shared: flags & 0x02 != 0, content: content.to_vec() });
            }
        }
        Ok(messages)
    }

    /// A text of a global heap.
    fn long_text(&self, address: u64, index: u32) -> Result<String, Fault> {
        const MOST_BYTES: u64 = 1 << 20;
        let head_bytes = 8 + self.sizes.length;
        let head = self.fetch(address, head_bytes)?;
        let mut head = self.bytes(&head);
        if head.take(4)? != b"GCOL" {
            return damaged(format!("no heap of texts at byte {address}"));
        }
        head.take(4)?;
        let bytes = head.length()?.saturating_sub(head_bytes as u64);
        if bytes > MOST_BYTES {
            return Ok(String::new());
        }
        let heap = self.fetch(address.saturating_add(head_bytes as u64), bytes as usize)?;
        let mut heap = self.bytes(&heap);
        while heap.left() >= 8 + self.sizes.length {
            let found = heap.short()?;
            heap.take(6)?;
            let size = usize::try_from(heap.length()?).unwrap_or(usize::MAX);
            let text = heap.take(size)?;
            if found == index as usize {
                return Ok(message::text(text));
            }
            heap.take((size.next_multiple_of(8) - size).min(heap.left()))?;
        }
        damaged(format!("no text {index} in the heap at byte {address}"))
    }

    fn sizes(&self) -> Sizes {
        self.sizes
    }

    fn bytes<'a>(&self, bytes: &'a [u8]) -> Bytes<'a> {
        Bytes::new(bytes, self.sizes)
    }

    /// So many bytes from an address on; no more is taken than the file has.
    fn fetch(&self, address: u64, count: usize) -> Result<Vec<u8>, Fault> {
        let from = self.place(address, count as u64)?;
        let mut bytes = vec![0; count];
        let mut file = &self.file;
        file.seek(SeekFrom::Start(from))?;
        file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Where so many bytes from an address on stand in the file.
    fn place(&self, address: u64, count: u64) -> Result<u64, Fault> {
        let from = address.checked_add(self.base);
        match from.and_then(|from| from.checked_add(count)) {
            Some(end) if end <= self.size => Ok(from.unwrap_or_default()),
            _ => damaged(format!("the file is cut short: {count} bytes at byte {address} are not there")),
        }
    }

    fn error(&self, place: &str, fault: Fault) -> Hdf5Error {
        let (file, place) = (self.path.clone(), place.to_owned());
        match fault {
            Fault::Io(source) => Hdf5Error::Io { file, source },
            Fault::Damaged(reason) => Hdf5Error::Damaged { file, place, reason },
            Fault::Unsupported(what) => Hdf5Error::Unread { file, place, what },
        }
    }
}

/// A message of an object's header.
struct Message {
    number: u64,
    /// Whether it says only where it is kept.
    shared: bool,
    content: Vec<u8>,
}
