//! Reading: what the host asks for, found by the sectors' headers and read step by step.

use belfry_shared::message::{Again, MAX_AGAIN};
use heapless::Vec;

use super::Store;
use super::chip::{Chip, SECTOR_BYTES, STEP_BYTES};
use super::record::{
    Key, MAX_RECORD_BYTES, RECORD_HEADER_BYTES, RecordHeader, SECTOR_HEADER_BYTES, STATE, content, is_sealed,
};

/// Where the reading is.
#[derive(Debug, Clone, Copy)]
enum Place {
    /// Nowhere yet.
    Unknown,
    /// The oldest window that is wanted begins in one of these sectors, counted from the oldest.
    Between { low: u32, high: u32 },
    /// At a record of a sector, counted from the oldest as well.
    Record { behind_oldest: u32, sequence: u32, offset: usize },
}

/// The store's reading end.
#[derive(Debug)]
pub(super) struct Reader {
    /// The first is being read.
    wanted: Vec<(u32, Again), MAX_AGAIN>,
    place: Place,
    /// Bytes of the record that is being read, and how many are here; 0 before its header is.
    length: usize,
    count: usize,
    is_loaded: bool,
    record: [u8; MAX_RECORD_BYTES],
}

impl Reader {
    pub(super) const fn new() -> Self {
        Self {
            wanted: Vec::new(),
            place: Place::Unknown,
            length: 0,
            count: 0,
            is_loaded: false,
            record: [0; MAX_RECORD_BYTES],
        }
    }

    pub(super) fn is_wanted(&self) -> bool {
        !self.wanted.is_empty() && !self.is_loaded
    }

    pub(super) fn is_loaded(&self) -> bool {
        self.is_loaded
    }

    pub(super) fn take_loaded(&mut self) -> Option<&[u8]> {
        if !core::mem::take(&mut self.is_loaded) {
            return None;
        }
        let length = core::mem::take(&mut self.length);
        self.record.get(..length).map(content)
    }

    /// Asks for parts, unless they are asked for already. A host asks again for whatever finds no room.
    pub(super) fn want(&mut self, boot: u32, parts: Again) {
        let has = |(known, asked): &(u32, Again)| {
            *known == boot
                && asked.first_window <= parts.first_window
                && asked.last_window >= parts.last_window
                && asked.first_part <= parts.first_part
                && asked.last_part >= parts.last_part
        };
        if !self.wanted.iter().any(has) {
            let _ = self.wanted.push((boot, parts));
        }
    }

    /// Forgets what is wanted before a window, for the host has it.
    pub(super) fn is_had(&mut self, before: Key) {
        let first = self.wanted.first().copied();
        self.wanted.retain_mut(|(boot, parts)| {
            if *boot == before.boot {
                parts.first_window = parts.first_window.max(before.window);
            }
            parts.first_window <= parts.last_window
        });
        if self.wanted.first().copied().map(|(boot, parts)| (boot, parts.last_window))
            != first.map(|(boot, parts)| (boot, parts.last_window))
        {
            self.begin_anew();
        }
    }

    /// Looks for the place again: another is wanted, or sectors were overwritten.
    pub(super) fn begin_anew(&mut self) {
        self.place = Place::Unknown;
        if !self.is_loaded {
            self.length = 0;
        }
    }

    fn end_range(&mut self) {
        if !self.wanted.is_empty() {
            self.wanted.remove(0);
        }
        self.begin_anew();
    }
}

impl<C: Chip> Store<C> {
    /// One step of reading; whether there was one to do.
    pub(super) fn read_on(&mut self) -> Result<bool, C::Error> {
        if !self.reader.is_wanted() {
            return Ok(false);
        }
        let Some(&(boot, parts)) = self.reader.wanted.first() else { return Ok(false) };
        let first = Key { boot, window: parts.first_window };
        match self.reader.place {
            Place::Unknown => self.reader.place = Place::Between { low: 0, high: self.used },
            Place::Between { low, high } if high - low > 1 => {
                let middle = low + (high - low) / 2;
                let header = self.sector_header(self.sector(middle))?;
                let is_at_or_before = header.is_some_and(|header| !first.is_before(header.begins));
                self.reader.place = if is_at_or_before {
                    Place::Between { low: middle, high }
                } else {
                    Place::Between { low, high: middle }
                };
            }
            Place::Between { low, .. } => self.enter(low)?,
            Place::Record { behind_oldest, sequence, offset } => {
                if self.reader.length > 0 {
                    self.read_piece(behind_oldest, sequence, offset)?;
                } else {
                    self.look_at_record(behind_oldest, sequence, offset, boot, &parts)?;
                }
            }
        }
        Ok(true)
    }

    /// Goes to the first record of a sector, or ends where there is none.
    fn enter(&mut self, behind_oldest: u32) -> Result<(), C::Error> {
        if behind_oldest >= self.used {
            self.reader.end_range();
            return Ok(());
        }
        let header = self.sector_header(self.sector(behind_oldest))?;
        // A damaged sector is passed over.
        let (sequence, offset) = match header {
            Some(header) => (header.sequence, SECTOR_HEADER_BYTES),
            None => (0, SECTOR_BYTES as usize),
        };
        self.reader.place = Place::Record { behind_oldest, sequence, offset };
        Ok(())
    }

    fn look_at_record(
        &mut self,
        behind_oldest: u32,
        sequence: u32,
        offset: usize,
        boot: u32,
        parts: &Again,
    ) -> Result<(), C::Error> {
        let is_newest = behind_oldest + 1 == self.used;
        let end = if is_newest { self.offset } else { SECTOR_BYTES as usize };
        let mut header = None;
        if offset + RECORD_HEADER_BYTES <= end {
            let mut bytes = [0; RECORD_HEADER_BYTES];
            self.chip.read(Self::address(self.sector(behind_oldest), offset), &mut bytes)?;
            self.reader.record[..RECORD_HEADER_BYTES].copy_from_slice(&bytes);
            header = RecordHeader::read(&bytes, sequence);
        }
        let Some(header) = header.filter(|header| offset + header.record_bytes() <= end) else {
            return self.enter(behind_oldest + 1);
        };
        if (Key { boot, window: parts.last_window }).is_before(header.key) && header.part != STATE {
            self.reader.end_range();
            return Ok(());
        }
        let is_wanted = header.key.boot == boot
            && header.part != STATE
            && (parts.first_window..=parts.last_window).contains(&header.key.window)
            && (parts.first_part..=parts.last_part).contains(&header.part);
        if is_wanted {
            (self.reader.length, self.reader.count) = (header.record_bytes(), RECORD_HEADER_BYTES);
        } else {
            self.reader.place = Place::Record { behind_oldest, sequence, offset: offset + header.record_bytes() };
        }
        Ok(())
    }

    fn read_piece(&mut self, behind_oldest: u32, sequence: u32, offset: usize) -> Result<(), C::Error> {
        let address = Self::address(self.sector(behind_oldest), offset + self.reader.count);
        let Reader { record, length, count, .. } = &mut self.reader;
        let end = *length.min(&mut (*count + STEP_BYTES));
        if let Some(place) = record.get_mut(*count..end) {
            self.chip.read(address, place)?;
        }
        *count = end;
        if self.reader.count < self.reader.length {
            return Ok(());
        }
        let length = self.reader.length;
        self.reader.place = Place::Record { behind_oldest, sequence, offset: offset + length };
        self.reader.is_loaded = self.reader.record.get(..length).is_some_and(is_sealed);
        if !self.reader.is_loaded {
            self.reader.length = 0;
        }
        Ok(())
    }
}
