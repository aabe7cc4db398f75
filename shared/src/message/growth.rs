//! How messages grow: structs that a peer of another version may have sent shorter or longer.
//!
//! A struct's fields stand one behind the other, without names. A later version adds fields at the end only, marked
//! `#[serde(default)]`. So a reader of an older version leaves the rest unread, and a reader of a newer one takes the default for what is not
//! there. Fields without that mark have been there from the start; a body that ends before the last of them cannot be read.
//!
//! Within another struct, one that may grow says its length first ([`delimited`], [`optional`]). An enum's later values go in front of its
//! `Unknown`, which is last and never sent: it is what a reader makes of a value that it does not know. They carry nothing, except where
//! nothing stands behind them.

use serde::de::value::SeqAccessDeserializer;
use serde::de::{DeserializeSeed, Error as _, SeqAccess};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::frame::FrameError;

/// Most bytes of a struct within another.
const MAX_NESTED_BYTES: usize = 96;

/// Fields that have not been read yet.
struct Fields<'de>(&'de [u8]);

impl<'de> SeqAccess<'de> for Fields<'de> {
    type Error = postcard::Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, postcard::Error> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let mut fields = postcard::Deserializer::from_bytes(self.0);
        let value = seed.deserialize(&mut fields)?;
        self.0 = fields.finalize()?;
        Ok(Some(value))
    }
}

/// Reads a struct from all of `bytes`.
pub(super) fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, FrameError> {
    T::deserialize(SeqAccessDeserializer::new(Fields(bytes))).map_err(|_| FrameError::Message)
}

/// A struct within another, with its length in front.
pub(super) mod delimited {
    use super::*;

    pub(in super::super) fn serialize<T: Serialize, S: Serializer>(value: &T, to: S) -> Result<S::Ok, S::Error> {
        let mut buffer = [0; MAX_NESTED_BYTES];
        let bytes = postcard::to_slice(value, &mut buffer).map_err(S::Error::custom)?;
        to.serialize_bytes(bytes)
    }

    pub(in super::super) fn deserialize<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
        from: D,
    ) -> Result<T, D::Error> {
        read(<&[u8]>::deserialize(from)?).map_err(D::Error::custom)
    }
}

/// The same for one that may be missing: its length is 0 then.
pub(super) mod optional {
    use super::*;

    pub(in super::super) fn serialize<T: Serialize, S: Serializer>(
        value: &Option<T>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        match value {
            Some(value) => delimited::serialize(value, to),
            None => to.serialize_bytes(&[]),
        }
    }

    pub(in super::super) fn deserialize<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<T>, D::Error> {
        let bytes = <&[u8]>::deserialize(from)?;
        if bytes.is_empty() { Ok(None) } else { read(bytes).map(Some).map_err(D::Error::custom) }
    }
}
