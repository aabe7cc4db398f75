//! Any bytes, taken as choices one after the other.

use serde::Deserialize;

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

    /// A well-formed message, where the bytes begin with one.
    pub(super) fn message<T: Deserialize<'a>>(&mut self) -> Option<T> {
        let (message, rest) = postcard::take_from_bytes(self.0).ok()?;
        self.0 = rest;
        Some(message)
    }
}
