//! Any bytes, taken as choices one after the other.

use belfry_shared::frame::MAX_MESSAGE_BYTES;
use belfry_shared::message::{self, Readable};

/// What is left of the bytes.
pub(super) struct Input<'a>(pub(super) &'a [u8]);

impl<'a> Input<'a> {
    pub(super) fn byte(&mut self) -> Option<u8> {
        let (&first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(first)
    }

    /// A number, little endian; 0 where the bytes have ended.
    pub(super) fn number<const BYTES: usize>(&mut self) -> u64 {
        (0..BYTES).fold(0, |number, place| number | (u64::from(self.byte().unwrap_or(0)) << (8 * place)))
    }

    /// A well-formed message, where the bytes have one behind its length in two bytes.
    pub(super) fn message<T: Readable<'a>>(&mut self) -> Option<T> {
        let length = self.number::<2>() as usize % (MAX_MESSAGE_BYTES + 1);
        let (message, rest) = self.0.split_at(length.min(self.0.len()));
        self.0 = rest;
        message::decode(message).ok()
    }
}
