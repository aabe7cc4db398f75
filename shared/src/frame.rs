//! Frames: a payload, made safe to find and to trust on a byte stream.
//!
//! A frame on the line is `COBS(version, message, CRC-32) 0x00`. COBS (Cheshire & Baker 1999) takes every zero out of the
//! body, so that a zero always ends a frame. A receiver that joins late, or has lost bytes, is back in step at the next zero. The
//! CRC is CRC-32/ISO-HDLC (Ethernet's) over version and message, little endian. The version stands outside the message, so that
//! each end recognises a peer of another version whatever its messages look like. This has been so since version 1.
//!
//! A sealed frame ([`crate::seal`]) is `COBS(version + 128, message, counter, tag, CRC-32) 0x00`: the seal stands between message and CRC, and the
//! version's highest bit says so. The CRC stays, so that noise on the line is not taken for an attack.
//!
//! Both ends send an empty frame, a lone zero, when a conversation begins. It ends a frame that an earlier conversation left
//! unfinished, or noise on the line, which would otherwise spoil the first message.

use crc::{CRC_32_ISO_HDLC, Crc};
use thiserror::Error;

/// The version of framing and messages. [`crate::message`] says what a change needs, and when it needs another version.
pub const PROTOCOL_VERSION: u8 = 6;
/// Longest message in a frame, in bytes.
pub const MAX_MESSAGE_BYTES: usize = 512;
/// Counter and tag of a sealed frame.
pub const SEAL_BYTES: usize = 9;
const COUNTER_BYTES: usize = 1;
/// Set in the version byte of a sealed frame; so versions go up to 127.
const SEALED: u8 = 0x80;
/// Version byte and CRC.
const ENVELOPE_BYTES: usize = 1 + CRC_BYTES;
const CRC_BYTES: usize = 4;
/// Longest frame body before COBS.
const MAX_BODY_BYTES: usize = MAX_MESSAGE_BYTES + SEAL_BYTES + ENVELOPE_BYTES;
/// Longest frame on the line, with its end mark.
pub const MAX_FRAME_BYTES: usize = cobs::max_encoding_length(MAX_BODY_BYTES) + 1;
/// The byte that ends a frame and occurs nowhere else.
pub const END_OF_FRAME: u8 = 0;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// CRC-32 as frames carry it; also the hash of a configuration.
pub fn crc32(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Why a frame was not made or not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// The body is not valid COBS: bytes were lost or changed.
    #[error("the frame's byte stuffing is broken")]
    Stuffing,
    /// More bytes came without an end mark than any frame has.
    #[error("the frame is longer than {MAX_FRAME_BYTES} bytes")]
    TooLong,
    /// The frame has fewer bytes than its envelope needs.
    #[error("the frame is too short")]
    TooShort,
    /// The checksum does not match: bytes were changed.
    #[error("the frame's checksum is wrong")]
    Checksum,
    /// The checksum is right, but the message contradicts its layout.
    #[error("the frame's message cannot be read")]
    Message,
    /// The message is one that a later version has added.
    #[error("the frame has a message of kind {kind}, which this version does not know")]
    Unknown {
        /// Its kind.
        kind: u32,
    },
}

/// What shows who has made a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seal {
    /// The low 8 bits of its counter.
    pub counter: u8,
    /// The tag.
    pub tag: [u8; SEAL_BYTES - COUNTER_BYTES],
}

/// What is in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Opened<'a> {
    /// The version of the message.
    pub version: u8,
    /// The message.
    pub message: &'a [u8],
    /// Its seal, which nobody has checked yet.
    pub seal: Option<Seal>,
}

/// Writes the frame of `message` to `frame` and returns its length.
///
/// `message` may be up to [`MAX_MESSAGE_BYTES`] long; a longer one is refused with [`FrameError::TooLong`].
pub fn encode(message: &[u8], frame: &mut [u8; MAX_FRAME_BYTES]) -> Result<usize, FrameError> {
    encode_as(PROTOCOL_VERSION, message, frame)
}

/// The same for a message of another version.
pub fn encode_as(version: u8, message: &[u8], frame: &mut [u8; MAX_FRAME_BYTES]) -> Result<usize, FrameError> {
    write(version, message, &[], frame)
}

/// The same with a seal.
pub fn encode_sealed(
    version: u8,
    message: &[u8],
    seal: &Seal,
    frame: &mut [u8; MAX_FRAME_BYTES],
) -> Result<usize, FrameError> {
    let mut bytes = [seal.counter; SEAL_BYTES];
    bytes[COUNTER_BYTES..].copy_from_slice(&seal.tag);
    write(version | SEALED, message, &bytes, frame)
}

fn write(version: u8, message: &[u8], seal: &[u8], frame: &mut [u8; MAX_FRAME_BYTES]) -> Result<usize, FrameError> {
    if message.len() > MAX_MESSAGE_BYTES {
        return Err(FrameError::TooLong);
    }
    let mut body = [0_u8; MAX_BODY_BYTES];
    let (length, end) = (message.len(), message.len() + seal.len());
    let body = body.get_mut(..end + ENVELOPE_BYTES).ok_or(FrameError::TooLong)?;
    body[0] = version;
    body[1..=length].copy_from_slice(message);
    body[length + 1..=end].copy_from_slice(seal);
    let checksum = crc32(&body[..=end]);
    body[end + 1..].copy_from_slice(&checksum.to_le_bytes());
    let stuffed = cobs::try_encode(body, frame).map_err(|_| FrameError::TooLong)?;
    *frame.get_mut(stuffed).ok_or(FrameError::TooLong)? = END_OF_FRAME;
    Ok(stuffed + 1)
}

/// Finds frames in a byte stream, a byte at a time, in bounded memory.
#[derive(Debug, Clone)]
pub struct FrameDecoder {
    buffer: [u8; MAX_FRAME_BYTES],
    length: usize,
    overrun: bool,
}

impl FrameDecoder {
    /// A decoder at the start of a stream.
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME_BYTES], length: 0, overrun: false }
    }

    /// Takes a byte; at the end of a frame returns what is in it, or why nothing is.
    ///
    /// It skips empty frames (two end marks in a row), so a sender may start with an end mark to flush noise.
    pub fn push(&mut self, byte: u8) -> Option<Result<Opened<'_>, FrameError>> {
        if byte != END_OF_FRAME {
            match self.buffer.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.overrun = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.overrun) {
            return Some(Err(FrameError::TooLong));
        }
        (length > 0).then(|| open(&mut self.buffer[..length]))
    }
}

impl Default for FrameDecoder {
    fn default() -> Self {
        Self::new()
    }
}

/// Takes the envelope off a stuffed body.
fn open(stuffed: &mut [u8]) -> Result<Opened<'_>, FrameError> {
    let length = cobs::decode_in_place(stuffed).map_err(|_| FrameError::Stuffing)?;
    let body = stuffed.get(..length).ok_or(FrameError::Stuffing)?;
    let (content, checksum) = body.split_last_chunk::<CRC_BYTES>().ok_or(FrameError::TooShort)?;
    let (&version, message) = content.split_first().ok_or(FrameError::TooShort)?;
    if crc32(content) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    if version & SEALED == 0 {
        return Ok(Opened { version, message, seal: None });
    }
    let (message, seal) = message.split_last_chunk::<SEAL_BYTES>().ok_or(FrameError::TooShort)?;
    let [counter, tag @ ..] = *seal;
    let seal = Seal { counter, tag };
    Ok(Opened { version: version & !SEALED, message, seal: Some(seal) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn framed(message: &[u8]) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = encode(message, &mut frame).unwrap();
        frame[..length].to_vec()
    }

    fn decoded(bytes: &[u8]) -> Vec<Result<Vec<u8>, FrameError>> {
        let mut decoder = FrameDecoder::new();
        bytes
            .iter()
            .filter_map(|&byte| decoder.push(byte).map(|frame| frame.map(|frame| frame.message.to_vec())))
            .collect()
    }

    /// The frame of the message 11 00 22, its CRC-32 little endian and COBS codes 03 and 06 in place of the zeros, as versions 3, 5 and 6
    /// write it.
    #[test]
    fn golden_frames() {
        let golden = [(3, [0x51, 0xF8, 0x75, 0xFB]), (5, [0x8D, 0xA7, 0x1E, 0xDE]), (6, [0x63, 0x08, 0xAB, 0xCC])];
        for (version, checksum) in golden {
            let mut expected = std::vec![3, version, 0x11, 6, 0x22];
            expected.extend_from_slice(&checksum);
            expected.push(0);
            let mut frame = [0; MAX_FRAME_BYTES];
            let length = encode_as(version, &[0x11, 0, 0x22], &mut frame).unwrap();
            assert_eq!(frame[..length], expected);
            let mut decoder = FrameDecoder::new();
            let opened =
                expected.iter().find_map(|&byte| decoder.push(byte).map(|frame| frame.map(|frame| frame.version)));
            assert_eq!(opened, Some(Ok(version)));
        }
        let mut frame = [0; MAX_FRAME_BYTES];
        encode(&[0x11, 0, 0x22], &mut frame).unwrap();
        assert_eq!(frame[1], PROTOCOL_VERSION);
    }

    #[test]
    fn the_checksum_is_the_one_every_reference_lists() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn a_stream_without_end_marks_is_bounded_and_recovers() {
        let mut bytes = std::vec![1; 3 * MAX_FRAME_BYTES];
        bytes.push(0);
        bytes.extend(framed(b"back in step"));
        assert_eq!(decoded(&bytes), [Err(FrameError::TooLong), Ok(b"back in step".to_vec())]);
    }

    #[test]
    fn a_message_that_is_too_long_is_refused() {
        assert_eq!(encode(&[0; MAX_MESSAGE_BYTES + 1], &mut [0; MAX_FRAME_BYTES]), Err(FrameError::TooLong));
        assert_eq!(decoded(&framed(&[0; MAX_MESSAGE_BYTES])), [Ok(std::vec![0; MAX_MESSAGE_BYTES])]);
    }

    proptest! {
        #[test]
        fn messages_come_back_unchanged_whatever_noise_went_before(
            noise in prop::collection::vec(any::<u8>(), 0..600),
            messages in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..=MAX_MESSAGE_BYTES), 1..4),
        ) {
            let mut bytes = noise;
            bytes.push(END_OF_FRAME);
            let before = decoded(&bytes).len();
            for message in &messages { bytes.extend(framed(message)); }
            let after: Vec<_> = decoded(&bytes).into_iter().skip(before).map(Result::unwrap).collect();
            prop_assert_eq!(after, messages);
        }

        #[test]
        fn a_flipped_bit_never_passes_for_a_message(message in prop::collection::vec(any::<u8>(), 1..200), bit in any::<prop::sample::Index>()) {
            let mut bytes = framed(&message);
            let bit = bit.index((bytes.len() - 1) * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
            prop_assert!(decoded(&bytes).iter().all(Result::is_err));
        }
    }
}
