//! Little-endian fields of an HDF5 file's structures, taken one after the other; what is not there is damage, never a panic.

use std::io;

use crate::record::array::whole_number;

/// Why a structure could not be read.
#[derive(Debug)]
pub(super) enum Fault {
    Io(io::Error),
    /// What is wrong with it.
    Damaged(String),
    /// What is sound, as far as can be seen, and not read here; with what to do.
    Unsupported(String),
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Damaged("the file is cut short".to_owned()),
            _ => Self::Io(error),
        }
    }
}

/// For what is damaged.
pub(super) fn damaged<T>(reason: impl Into<String>) -> Result<T, Fault> {
    Err(Fault::Damaged(reason.into()))
}

/// The bytes of a structure that are left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bytes<'a> {
    rest: &'a [u8],
    sizes: Sizes,
}

/// Bytes that addresses and lengths take, as the superblock says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sizes {
    pub(super) address: usize,
    pub(super) length: usize,
}

impl<'a> Bytes<'a> {
    pub(super) fn new(rest: &'a [u8], sizes: Sizes) -> Self {
        Self { rest, sizes }
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let Some((taken, rest)) = self.rest.split_at_checked(count) else {
            return damaged("a structure of the file ends too early");
        };
        self.rest = rest;
        Ok(taken)
    }

    /// An unsigned number of `count` bytes, eight at most.
    pub(super) fn number(&mut self, count: usize) -> Result<u64, Fault> {
        Ok(whole_number(self.take(count)?, false))
    }

    pub(super) fn byte(&mut self) -> Result<u8, Fault> {
        Ok(self.number(1)? as u8)
    }

    /// A count of at most 16 bits.
    pub(super) fn short(&mut self) -> Result<usize, Fault> {
        Ok(self.number(2)? as usize)
    }

    pub(super) fn word(&mut self) -> Result<u32, Fault> {
        Ok(self.number(4)? as u32)
    }

    pub(super) fn length(&mut self) -> Result<u64, Fault> {
        self.number(self.sizes.length)
    }

    /// An address; `None` where it is the undefined one, all bits set.
    pub(super) fn address(&mut self) -> Result<Option<u64>, Fault> {
        let bits = 8 * self.sizes.address as u32;
        let address = self.number(self.sizes.address)?;
        Ok((address != u64::MAX >> (64 - bits)).then_some(address))
    }

    pub(super) fn left(&self) -> usize {
        self.rest.len()
    }

    pub(super) fn sizes(&self) -> Sizes {
        self.sizes
    }
}
