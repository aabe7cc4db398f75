//! Seals: what a frame carries so that only an end with the node's key can have made it, and only once.
//!
//! The tag is BLAKE2s with a key and 8 bytes of output (RFC 7693) over who says it, the node's boot id, the counter, the version and the message.
//! The counter numbers a sender's sealed frames within the node's boot from 1, over all its ports and all hosts; the frame carries its low 8 bits. A
//! receiver takes only a higher one than the last. So a frame counts once, and after a restart, which draws another boot id, none from before
//! does. Greetings of either end carry the whole counter: with one of them, both go on after more than 255 frames were lost in a row. Nothing depends on the time, and neither end keeps anything over a restart: [`crate::message`] says how they agree on boot and
//! counters.
//!
//! A node finds its key where the key's image was written, 48 bytes: `BELFRKEY`, the node's number (16 bits), two zeros, the key, and the CRC-32 of all
//! that, little endian.

use blake2::Blake2sMac;
use blake2::digest::consts::U8;
use blake2::digest::{FixedOutput, KeyInit, Update};

use crate::frame::{FrameError, MAX_FRAME_BYTES, Opened, PROTOCOL_VERSION, SEAL_BYTES, Seal, crc32, encode_sealed};

/// Bytes of a key.
pub const KEY_BYTES: usize = 32;
/// Bytes of a tag. A forger who sends frames as fast as a line of 115 200 baud carries them needs 500 million years for an even chance.
pub const TAG_BYTES: usize = 8;
/// Bytes of a key's image.
pub const IMAGE_BYTES: usize = 48;

const MAGIC: [u8; 8] = *b"BELFRKEY";
const KEY_AT: usize = 12;
const CHECK_AT: usize = KEY_AT + KEY_BYTES;
/// Sender, boot, counter and version, in front of the message.
const HEADER_BYTES: usize = 10;

const _: () = assert!(CHECK_AT + 4 == IMAGE_BYTES && SEAL_BYTES == 1 + TAG_BYTES);

/// A node's key. It does not show itself in logs.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; KEY_BYTES]);

impl core::fmt::Debug for Key {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str("Key")
    }
}

/// Who says a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sender {
    /// The node.
    Node = 1,
    /// A host.
    Host = 2,
}

/// Why an image gives no key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// It is something else, or damaged.
    #[error("the image of the key is damaged")]
    Damaged,
    /// It is for another node.
    #[error("the key is node {0}'s")]
    OtherNode(u16),
}

impl Key {
    /// The key of these bytes, which are drawn at random.
    pub const fn new(bytes: [u8; KEY_BYTES]) -> Self {
        Self(bytes)
    }

    /// Its bytes, for where it is kept.
    pub fn bytes(&self) -> &[u8; KEY_BYTES] {
        &self.0
    }

    fn tag(&self, sender: Sender, boot: u32, counter: u32, version: u8, message: &[u8]) -> [u8; TAG_BYTES] {
        let mut header = [0; HEADER_BYTES];
        header[0] = sender as u8;
        header[1..5].copy_from_slice(&boot.to_le_bytes());
        header[5..9].copy_from_slice(&counter.to_le_bytes());
        header[9] = version;
        let mut mac = Blake2sMac::<U8>::new(&self.0.into());
        Update::update(&mut mac, &header);
        Update::update(&mut mac, message);
        mac.finalize_fixed().into()
    }

    /// The seal of a message.
    pub fn seal(&self, sender: Sender, boot: u32, counter: u32, version: u8, message: &[u8]) -> Seal {
        Seal { counter: counter as u8, tag: self.tag(sender, boot, counter, version, message) }
    }

    /// Writes the sealed frame of a message of this version, and returns its length.
    pub fn encode(
        &self,
        sender: Sender,
        boot: u32,
        counter: u32,
        message: &[u8],
        frame: &mut [u8; MAX_FRAME_BYTES],
    ) -> Result<usize, FrameError> {
        let seal = self.seal(sender, boot, counter, PROTOCOL_VERSION, message);
        encode_sealed(PROTOCOL_VERSION, message, &seal, frame)
    }

    /// Whether the frame was sealed with this key by that sender in that boot under that counter. It takes as long whatever the tag is.
    pub fn admits(&self, sender: Sender, boot: u32, counter: u32, frame: &Opened<'_>) -> bool {
        let Some(seal) = &frame.seal else { return false };
        let tag = self.tag(sender, boot, counter, frame.version, frame.message);
        seal.counter == counter as u8 && subtle::ConstantTimeEq::ct_eq(&tag[..], &seal.tag[..]).into()
    }

    /// What is written into a node.
    pub fn image(&self, node: u16) -> [u8; IMAGE_BYTES] {
        let mut image = [0; IMAGE_BYTES];
        image[..8].copy_from_slice(&MAGIC);
        image[8..10].copy_from_slice(&node.to_le_bytes());
        image[KEY_AT..CHECK_AT].copy_from_slice(&self.0);
        let check = crc32(&image[..CHECK_AT]);
        image[CHECK_AT..].copy_from_slice(&check.to_le_bytes());
        image
    }

    /// The key in an image; `None` where nothing was ever written (flash is all ones then, an emulator's all zeros).
    pub fn from_image(image: &[u8; IMAGE_BYTES], node: u16) -> Result<Option<Self>, ImageError> {
        if [0, 0xFF].iter().any(|blank| image.iter().all(|byte| byte == blank)) {
            return Ok(None);
        }
        let check = crc32(&image[..CHECK_AT]).to_le_bytes();
        if image[..8] != MAGIC || image[CHECK_AT..] != check {
            return Err(ImageError::Damaged);
        }
        let found = u16::from_le_bytes([image[8], image[9]]);
        if found != node {
            return Err(ImageError::OtherNode(found));
        }
        let mut key = [0; KEY_BYTES];
        key.copy_from_slice(&image[KEY_AT..CHECK_AT]);
        Ok(Some(Self(key)))
    }
}

/// The lowest counter above `last` that ends in these 8 bits. `None` when counters are used up: after 2³² frames, four years at 30 a second, the
/// node has to be restarted.
pub fn next_counter(last: u32, low: u8) -> Option<u32> {
    let next = last.checked_add(1)?;
    next.checked_add(u32::from(low.wrapping_sub(next as u8)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::FrameDecoder;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn key() -> Key {
        Key::new(core::array::from_fn(|index| index as u8))
    }

    fn framed(counter: u32, message: &[u8]) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME_BYTES];
        let seal = key().seal(Sender::Node, 0xB007, counter, 6, message);
        let length = encode_sealed(6, message, &seal, &mut frame).unwrap();
        frame[..length].to_vec()
    }

    fn is_admitted(frame: &[u8], key: &Key, sender: Sender, boot: u32, counter: u32) -> bool {
        let mut decoder = FrameDecoder::new();
        let opened = frame.iter().find_map(|&byte| {
            decoder.push(byte).map(|frame| frame.is_ok_and(|frame| key.admits(sender, boot, counter, &frame)))
        });
        opened.unwrap_or(false)
    }

    /// Against Python: `hashlib.blake2s(bytes.fromhex("0107b00000050000000608ac02"), key=bytes(range(32)), digest_size=8)`.
    #[test]
    fn golden_seal() {
        let seal = key().seal(Sender::Node, 0xB007, 5, 6, &[8, 0xAC, 2]);
        assert_eq!(seal, Seal { counter: 5, tag: GOLDEN });
        let mut decoder = FrameDecoder::new();
        let frame = framed(5, &[8, 0xAC, 2]);
        assert_eq!(frame[1..6], [0x86, 8, 0xAC, 2, 5]);
        let opened = frame.iter().find_map(|&byte| {
            decoder.push(byte).map(Result::unwrap).map(|opened| (opened.version, opened.message.to_vec(), opened.seal))
        });
        assert_eq!(opened, Some((6, std::vec![8, 0xAC, 2], Some(seal))));
    }

    const GOLDEN: [u8; TAG_BYTES] = [0x50, 0x6B, 0x65, 0x44, 0xF6, 0xA8, 0xBF, 0x2B];

    #[test]
    fn a_seal_is_of_its_key_sender_boot_and_counter_alone() {
        let frame = framed(70_000, b"message");
        assert!(is_admitted(&frame, &key(), Sender::Node, 0xB007, 70_000));
        assert!(!is_admitted(&frame, &Key::new([7; 32]), Sender::Node, 0xB007, 70_000));
        assert!(!is_admitted(&frame, &key(), Sender::Host, 0xB007, 70_000));
        assert!(!is_admitted(&frame, &key(), Sender::Node, 0xB008, 70_000));
        assert!(!is_admitted(&frame, &key(), Sender::Node, 0xB007, 70_000 + 256));
        let mut plain = [0; MAX_FRAME_BYTES];
        let length = crate::frame::encode(b"message", &mut plain).unwrap();
        assert!(!is_admitted(&plain[..length], &key(), Sender::Node, 0xB007, 70_000));
    }

    #[test]
    fn a_key_does_not_show_itself() {
        assert_eq!(std::format!("{:?}", key()), "Key");
    }

    #[test]
    fn an_image_gives_its_key_to_its_node_and_nothing_where_nothing_was_written() {
        let image = key().image(300);
        assert_eq!(Key::from_image(&image, 300), Ok(Some(key())));
        assert_eq!(Key::from_image(&image, 301), Err(ImageError::OtherNode(300)));
        for bit in 0..8 * IMAGE_BYTES {
            let mut damaged = image;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Key::from_image(&damaged, 300), Err(ImageError::Damaged), "bit {bit}");
        }
        assert_eq!((Key::from_image(&[0xFF; 48], 1), Key::from_image(&[0; 48], 1)), (Ok(None), Ok(None)));
    }

    proptest! {
        #[test]
        fn a_counter_is_known_from_its_low_bits_as_long_as_fewer_than_256_frames_were_lost(last in 0..u32::MAX - 300, lost in 0_u32..256) {
            let counter = last + 1 + lost;
            prop_assert_eq!(next_counter(last, counter as u8), Some(counter));
        }

        #[test]
        fn counters_never_come_again(last in any::<u32>(), low in any::<u8>()) {
            prop_assert!(next_counter(last, low).is_none_or(|counter| counter > last && counter as u8 == low));
        }

        #[test]
        fn no_changed_bit_is_admitted(message in prop::collection::vec(any::<u8>(), 0..200), bit in any::<prop::sample::Index>(), tagged in any::<bool>()) {
            let seal = key().seal(Sender::Host, 1, 9, 6, &message);
            let (mut message, mut seal) = (message, seal);
            if tagged || message.is_empty() {
                let bit = bit.index(8 * TAG_BYTES);
                seal.tag[bit / 8] ^= 1 << (bit % 8);
            } else {
                let bit = bit.index(8 * message.len());
                message[bit / 8] ^= 1 << (bit % 8);
            }
            let frame = Opened { version: 6, message: &message, seal: Some(seal) };
            prop_assert!(!key().admits(Sender::Host, 1, 9, &frame));
        }
    }
}
