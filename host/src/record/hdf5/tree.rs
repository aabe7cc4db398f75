//! What lists a group's members and a dataset's chunks: B-trees of version 1, symbol tables and heaps of names.

use super::Hdf5File;
use super::bytes::{Fault, damaged};
use super::message::text;

/// Levels of a tree; a file of 2^63 bytes has fewer.
const MOST_LEVELS: u64 = 24;
/// Nodes of one tree; each is kept for no longer than it is read.
const MOST_NODES: usize = 1 << 20;
/// Members of a group.
pub(super) const MOST_MEMBERS: usize = 100_000;
/// Bytes of all names of one group.
const MOST_NAME_BYTES: usize = 1 << 24;
const OF_GROUP: u64 = 0;
const OF_CHUNKS: u64 = 1;

/// Takes the key before a child, and the child's address.
type OnChild<'a> = &'a mut dyn FnMut(&[u8], u64) -> Result<(), Fault>;

/// Where a chunk's bytes are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chunk {
    /// Its first element along each dimension.
    pub(super) start: Vec<u64>,
    pub(super) address: u64,
    /// Bytes that it takes in the file.
    pub(super) bytes: u64,
    /// Bit n is set where filter n was left out.
    pub(super) left_out: u32,
}

/// Members of a group: their names, and the addresses of their headers.
pub(super) fn members(file: &Hdf5File, tree: u64, heap: u64) -> Result<Vec<(String, u64)>, Fault> {
    let names = names(file, heap)?;
    let mut members = Vec::new();
    let length = file.sizes().length;
    walk(file, tree, OF_GROUP, length, &mut |_, table| {
        if members.len() > MOST_MEMBERS {
            return damaged(format!("a group of more than {MOST_MEMBERS} members"));
        }
        let head = file.fetch(table, 8)?;
        let mut head = file.bytes(&head);
        if head.take(4)? != b"SNOD" {
            return damaged(format!("no symbol table at byte {table}"));
        }
        head.take(2)?;
        let count = head.short()?;
        let entry_bytes = 2 * file.sizes().address + 24;
        let entries = file.fetch(table.saturating_add(8), count * entry_bytes)?;
        let mut entries = file.bytes(&entries);
        for _ in 0..count {
            let (name, address) = (entries.address()?, entries.address()?);
            let cached = entries.word()?;
            entries.take(20)?;
            const SOFT_LINK: u32 = 2;
            if let (Some(name), Some(address)) = (name, address)
                && cached != SOFT_LINK
            {
                let name = usize::try_from(name).ok().and_then(|from| names.get(from..));
                let Some(name) = name else { return damaged("a name outside its heap") };
                members.push((text(name), address));
            }
        }
        Ok(())
    })?;
    Ok(members)
}

/// The text of a local heap, with all names of a group.
fn names(file: &Hdf5File, heap: u64) -> Result<Vec<u8>, Fault> {
    let head = file.fetch(heap, 8 + 2 * file.sizes().length + file.sizes().address)?;
    let mut head = file.bytes(&head);
    if head.take(4)? != b"HEAP" {
        return damaged(format!("no heap of names at byte {heap}"));
    }
    head.take(4)?;
    let bytes = head.length()?;
    head.length()?;
    let Some(address) = head.address()? else { return damaged("a heap of names without an address") };
    match usize::try_from(bytes) {
        Ok(bytes) if bytes <= MOST_NAME_BYTES => file.fetch(address, bytes),
        _ => damaged(format!("a heap of names of {bytes} bytes")),
    }
}

/// All chunks of a dataset with so many dimensions, which has `most` of them at most.
pub(super) fn chunks(file: &Hdf5File, tree: u64, rank: usize, most: u64) -> Result<Vec<Chunk>, Fault> {
    let mut chunks: Vec<Chunk> = Vec::new();
    walk(file, tree, OF_CHUNKS, 8 + 8 * (rank + 1), &mut |key, address| {
        if chunks.len() as u64 >= most {
            return damaged(format!("more than the {most} chunks that its size has room for"));
        }
        let mut key = file.bytes(key);
        let (bytes, left_out) = (u64::from(key.word()?), key.word()?);
        let start = (0..rank).map(|_| key.number(8)).collect::<Result<Vec<u64>, _>>()?;
        chunks.push(Chunk { start, address, bytes, left_out });
        Ok(())
    })?;
    Ok(chunks)
}

/// Hands out what a tree lists, with the key before each.
fn walk(file: &Hdf5File, root: u64, kind: u64, key_bytes: usize, on_child: OnChild<'_>) -> Result<(), Fault> {
    // A child is one level below its parent, so that no tree goes round in circles.
    let mut open: Vec<(u64, Option<u64>)> = vec![(root, None)];
    let mut nodes = 0;
    while let Some((address, expected)) = open.pop() {
        nodes += 1;
        if nodes > MOST_NODES {
            return damaged("a tree of more nodes than any file has");
        }
        let address_bytes = file.sizes().address;
        let head = file.fetch(address, 8 + 2 * address_bytes)?;
        let mut head = file.bytes(&head);
        if head.take(4)? != b"TREE" || head.number(1)? != kind {
            return damaged(format!("no node of the tree at byte {address}"));
        }
        let level = head.number(1)?;
        if expected.is_some_and(|expected| expected != level) || level > MOST_LEVELS {
            return damaged(format!("a node of level {level} in a tree, at byte {address}"));
        }
        let count = head.short()?;
        let pair = key_bytes + address_bytes;
        let entries = file.fetch(address.saturating_add(8 + 2 * address_bytes as u64), count * pair)?;
        let mut entries = file.bytes(&entries);
        let mut below = Vec::new();
        for _ in 0..count {
            let key = entries.take(key_bytes)?;
            let Some(child) = entries.address()? else { return damaged("a tree that leads nowhere") };
            match level.checked_sub(1) {
                None => on_child(key, child)?,
                Some(level) => below.push((child, Some(level))),
            }
        }
        open.extend(below.into_iter().rev());
        if open.len() > MOST_NODES {
            return damaged("a tree of more nodes than any file has");
        }
    }
    Ok(())
}
