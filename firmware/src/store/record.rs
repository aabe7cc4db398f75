//! How the store's bytes lie on the chip: sectors with a header, records one behind the other, each with a checksum at its end.
//!
//! All numbers are little endian. A sector begins with [`SectorHeader`]; a record is [`RecordHeader`], its content, and the CRC-32 of both. A
//! record says the sequence number of its sector, so that what is left of a sector's earlier use is never taken for a record of the present one.

use belfry_shared::frame::{MAX_MESSAGE_BYTES, crc32};
use belfry_shared::message::{Calibration, Configuration};
use belfry_shared::time::HostTime;

/// Marks a sector of a store of this layout.
const MAGIC: u32 = 0x0157_5342;
/// Bytes of a sector's header.
pub(super) const SECTOR_HEADER_BYTES: usize = 24;
/// Bytes of a record's header.
pub(super) const RECORD_HEADER_BYTES: usize = 16;
const CRC_BYTES: usize = 4;
/// What a record takes beside its content.
pub(super) const RECORD_OVERHEAD_BYTES: usize = RECORD_HEADER_BYTES + CRC_BYTES;
/// The longest record.
pub(super) const MAX_RECORD_BYTES: usize = MAX_MESSAGE_BYTES + RECORD_OVERHEAD_BYTES;
/// In the place of a window's part: the record is the state.
pub(super) const STATE: u16 = u16::MAX;

/// A boot and a window: the order in which records are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) boot: u32,
    pub(super) window: u32,
}

impl Key {
    /// Whether it comes before another. Boots are counted up, and may run over.
    pub(super) fn is_before(self, other: Self) -> bool {
        if self.boot == other.boot { self.window < other.window } else { is_earlier_boot(self.boot, other.boot) }
    }
}

/// Whether one boot came before another.
pub(super) fn is_earlier_boot(boot: u32, other: u32) -> bool {
    boot != other && other.wrapping_sub(boot) < 1 << 31
}

/// A sector's header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SectorHeader {
    /// Counts the sectors that were ever begun.
    pub(super) sequence: u32,
    /// The boot that began it, and the first window of that boot that begins here or later.
    pub(super) begins: Key,
    /// One above the last window of that boot that was whole before.
    pub(super) whole: u32,
}

impl SectorHeader {
    pub(super) fn write(&self) -> [u8; SECTOR_HEADER_BYTES] {
        let mut bytes = [0; SECTOR_HEADER_BYTES];
        let words = [MAGIC, self.sequence, self.begins.boot, self.begins.window, self.whole];
        put_words(&mut bytes, &words);
        seal(&mut bytes);
        bytes
    }

    pub(super) fn read(bytes: &[u8; SECTOR_HEADER_BYTES]) -> Option<Self> {
        let [magic, sequence, boot, window, whole] = words(bytes);
        (magic == MAGIC && is_sealed(bytes)).then_some(Self { sequence, begins: Key { boot, window }, whole })
    }
}

/// A record's header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RecordHeader {
    /// Bytes of its content.
    pub(super) length: u16,
    /// The part of the window, or [`STATE`].
    pub(super) part: u16,
    /// Its sector's.
    pub(super) sequence: u32,
    pub(super) key: Key,
}

impl RecordHeader {
    /// Writes a record into `buffer`; its length in bytes. `None` where there is no room.
    pub(super) fn write(&self, content: &[u8], buffer: &mut [u8; MAX_RECORD_BYTES]) -> Option<usize> {
        let length = content.len() + RECORD_OVERHEAD_BYTES;
        let record = buffer.get_mut(..length)?;
        let first = u32::from(self.length) | u32::from(self.part) << 16;
        put_words(record, &[first, self.sequence, self.key.boot, self.key.window]);
        record.get_mut(RECORD_HEADER_BYTES..length - CRC_BYTES)?.copy_from_slice(content);
        seal(record);
        Some(length)
    }

    /// Reads the header of a record of the sector with this sequence number, as far as it can be one. Its checksum has still to be looked at.
    pub(super) fn read(bytes: &[u8; RECORD_HEADER_BYTES], in_sequence: u32) -> Option<Self> {
        let [first, sequence, boot, window] = words(bytes);
        let header = Self { length: first as u16, part: (first >> 16) as u16, sequence, key: Key { boot, window } };
        (sequence == in_sequence && usize::from(header.length) <= MAX_MESSAGE_BYTES).then_some(header)
    }

    /// Bytes of the whole record.
    pub(super) fn record_bytes(&self) -> usize {
        usize::from(self.length) + RECORD_OVERHEAD_BYTES
    }
}

/// What a node knows beside its windows. Every sector begins with it; the last one counts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct State {
    /// All windows before this one are delivered or overwritten.
    pub(super) done: Key,
    /// The time by the host's clock when this was written, where it was known.
    pub(super) time: Option<HostTime>,
    /// What the node measures.
    pub(super) configuration: Option<Configuration>,
    /// What a host has found out about its axes. It is stored behind the configuration, without which there is no measuring it either.
    pub(super) calibration: Option<Calibration>,
}

/// Bytes of a state in front of its configuration.
const STATE_BYTES: usize = 16;
/// Most bytes of a state: a configuration takes 70, a calibration 71.
pub(super) const MAX_STATE_BYTES: usize = STATE_BYTES + 80 + 80;
/// In the place of the time: it was not known.
const NO_TIME: i64 = i64::MIN;

impl State {
    /// Of a first start.
    pub(super) const fn new(boot: u32) -> Self {
        Self { done: Key { boot, window: 0 }, time: None, configuration: None, calibration: None }
    }

    /// Writes it to `buffer`; its bytes.
    pub(super) fn write<'b>(&self, buffer: &'b mut [u8; MAX_STATE_BYTES]) -> &'b [u8] {
        let time = self.time.map_or(NO_TIME, |time| time.0);
        put_words(buffer, &[self.done.boot, self.done.window, time as u32, (time >> 32) as u32]);
        let mut length = STATE_BYTES;
        if let Some(configuration) = &self.configuration {
            let mut put = |encode: &dyn Fn(&mut [u8]) -> Option<usize>| {
                length += buffer.get_mut(length..).and_then(encode).unwrap_or(0);
            };
            put(&|rest| configuration.bytes(rest).map(<[u8]>::len));
            if let Some(calibration) = &self.calibration {
                put(&|rest| postcard::to_slice(calibration, rest).ok().map(|bytes| bytes.len()));
            }
        }
        buffer.get(..length).unwrap_or(&[])
    }

    /// Reads one.
    pub(super) fn read(content: &[u8]) -> Option<Self> {
        let (fields, rest) = content.split_at_checked(STATE_BYTES)?;
        let [boot, window, low, high] = words(fields);
        let (configuration, rest) = postcard::take_from_bytes(rest).ok().unzip();
        let time = i64::from(high as i32) << 32 | i64::from(low);
        Some(Self {
            done: Key { boot, window },
            time: Some(HostTime(time)).filter(|time| time.0 != NO_TIME),
            configuration,
            calibration: rest.and_then(|rest| postcard::from_bytes(rest).ok()),
        })
    }
}

/// The content of a record.
pub(super) fn content(record: &[u8]) -> &[u8] {
    record.get(RECORD_HEADER_BYTES..record.len().saturating_sub(CRC_BYTES)).unwrap_or(&[])
}

/// Writes the checksum at the end.
fn seal(bytes: &mut [u8]) {
    if let Some((before, place)) = bytes.split_last_chunk_mut::<CRC_BYTES>() {
        *place = crc32(before).to_le_bytes();
    }
}

/// Whether the checksum at the end is right.
pub(super) fn is_sealed(bytes: &[u8]) -> bool {
    bytes.split_last_chunk::<CRC_BYTES>().is_some_and(|(before, place)| *place == crc32(before).to_le_bytes())
}

fn put_words(bytes: &mut [u8], words: &[u32]) {
    for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
        place.copy_from_slice(&word.to_le_bytes());
    }
}

fn words<const N: usize>(bytes: &[u8]) -> [u32; N] {
    let mut words = [0; N];
    for (word, place) in words.iter_mut().zip(bytes.chunks_exact(4)) {
        if let Ok(place) = place.try_into() {
            *word = u32::from_le_bytes(place);
        }
    }
    words
}
