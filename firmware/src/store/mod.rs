//! The store: windows, configuration and time on a memory chip, so that they outlast a power cut.
//!
//! Windows flow in part by part as the node makes them ([`Keeper::put`]), and out when the host asks for them ([`Keeper::want`]). The chip is a ring
//! of sectors that are filled one after the other; when all are full, the oldest sector is overwritten, and what it held and nobody had is
//! counted. Nothing is ever changed in place, and a record counts once its checksum is there: a cut at any byte costs the record that was
//! being written, and no other.
//!
//! The store never waits. [`Keeper::step`] moves [`STEP_BYTES`] at most, so that it fits between two samples on the sensor's bus, and
//! returns while the chip still writes or erases.

mod chip;
mod open;
mod reader;
mod record;
mod simulated;
mod spi;
#[cfg(test)]
mod tests;

use belfry_shared::message::{Again, Calibration, Configuration, Kept};
use belfry_shared::time::HostTime;
use heapless::Vec;

pub use chip::{Chip, SECTOR_BYTES, STEP_BYTES};
pub use simulated::{NoSupply, SimulatedChip, Technology};
pub use spi::SpiChip;

use reader::Reader;
use record::{
    Key, MAX_RECORD_BYTES, MAX_STATE_BYTES, RECORD_OVERHEAD_BYTES, RecordHeader, SECTOR_HEADER_BYTES, STATE,
    SectorHeader, State, is_earlier_boot,
};

/// Fewer sectors are no store.
const LEAST_SECTORS: u32 = 8;
/// Earlier boots of which windows are held. A node makes windows once a host has set its clock, so there are few even in a long outage.
const MOST_BOOTS: usize = 4;
/// The time is stored this often, in µs.
const TIME_PERIOD_US: i64 = 600_000_000;
/// Writes of NOR flash stay within a page.
const PAGE_BYTES: u32 = 256;

/// What a node wants of a store. A node without one does nothing of it.
pub trait Keeper {
    /// Begins to keep a part of a window of this boot; `false` where it has to wait. Parts come in the order in which they were made, a window's head last.
    fn put(&mut self, window: u32, part: u16, message: &[u8]) -> bool {
        let _ = (window, part, message);
        false
    }

    /// Whether windows can be put, now or later.
    fn keeps(&self) -> bool {
        false
    }

    /// The part that was put last, once it is kept; each once.
    fn take_written(&mut self) -> Option<(u32, u16)> {
        None
    }

    /// Does one step of the work that waits; whether there was any.
    fn step(&mut self) -> bool {
        false
    }

    /// What is kept of earlier boots.
    fn kept(&self) -> Option<Kept> {
        None
    }

    /// The oldest window of this boot that is kept and not acknowledged.
    fn oldest_window(&self) -> Option<u32> {
        None
    }

    /// Windows that were overwritten before anybody had them.
    fn lost_windows(&self) -> u32 {
        0
    }

    /// Takes note that a host has all windows of a boot with lower numbers; `false` where that cannot be.
    fn acknowledge(&mut self, boot: u32, below: u32) -> bool {
        let _ = (boot, below);
        true
    }

    /// Reads parts, to be sent.
    fn want(&mut self, boot: u32, wanted: &Again) {
        let _ = (boot, wanted);
    }

    /// Whether a part has been read.
    fn is_loaded(&self) -> bool {
        false
    }

    /// The part that has been read; each once.
    fn take_loaded(&mut self) -> Option<&[u8]> {
        None
    }

    /// Whether [`Keeper::kept`] says something else than at the last call.
    fn take_news(&mut self) -> bool {
        false
    }

    /// What the node measured before its start.
    fn configuration(&self) -> Option<Configuration> {
        None
    }

    /// Takes note of what the node measures.
    fn set_configuration(&mut self, configuration: &Configuration) {
        let _ = configuration;
    }

    /// What a host has found out about the node's axes.
    fn calibration(&self) -> Option<Calibration> {
        None
    }

    /// Takes note of that.
    fn set_calibration(&mut self, calibration: &Calibration) {
        let _ = calibration;
    }

    /// Takes note of the time.
    fn set_time(&mut self, now: HostTime) {
        let _ = now;
    }
}

/// Keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoStore;

impl Keeper for NoStore {}

/// Windows of a boot that are held: those from `oldest` up to `next`, which is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Held {
    boot: u32,
    oldest: u32,
    next: u32,
}

/// What is being written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    Header,
    State,
    Part { window: u32, part: u16 },
}

#[derive(Debug, Clone, Copy)]
struct Writing {
    content: Content,
    length: usize,
    written: usize,
}

/// A store on a chip. Without a chip it keeps nothing.
#[derive(Debug)]
pub struct Store<C> {
    chip: C,
    /// 0 without a chip.
    sectors: u32,
    boot: u32,
    /// The sector that is being filled, its sequence number, and where the next record goes; behind its end where it is full.
    newest: u32,
    sequence: u32,
    offset: usize,
    /// Sectors in use, up to the newest.
    used: u32,
    /// Whether the next sector is to be begun.
    must_open: bool,
    /// One above the last window of which a part is written, and of which all parts are.
    begun: u32,
    present: Held,
    /// Oldest first; none of them empty.
    earlier: Vec<Held, MOST_BOOTS>,
    lost_windows: u32,
    state: State,
    is_state_due: bool,
    /// The time as of before the start.
    last_time: Option<HostTime>,
    has_news: bool,
    writing: Option<Writing>,
    written: Option<(u32, u16)>,
    record: [u8; MAX_RECORD_BYTES],
    reader: Reader,
}

impl<C: Chip> Store<C> {
    /// The boot id of this start: one above the last that was stored, or `random` where none was.
    pub fn boot(&self) -> u32 {
        self.boot
    }

    /// Whether it has a chip.
    pub fn has_chip(&self) -> bool {
        self.sectors > 0
    }

    /// Bytes on its chip.
    pub fn size_bytes(&self) -> u32 {
        self.chip.size_bytes()
    }

    /// Its chip.
    pub fn release(self) -> C {
        self.chip
    }

    /// Its chip, while it is in use.
    pub fn chip(&mut self) -> &mut C {
        &mut self.chip
    }

    fn address(sector: u32, offset: usize) -> u32 {
        sector * SECTOR_BYTES + offset as u32
    }

    /// The sector that is so many behind the oldest.
    fn sector(&self, behind_oldest: u32) -> u32 {
        (self.newest + self.sectors + 1 - self.used + behind_oldest) % self.sectors.max(1)
    }

    fn sector_header(&mut self, sector: u32) -> Result<Option<SectorHeader>, C::Error> {
        let mut bytes = [0; SECTOR_HEADER_BYTES];
        self.chip.read(Self::address(sector, 0), &mut bytes)?;
        Ok(SectorHeader::read(&bytes))
    }

    fn has_room(&self, bytes: usize) -> bool {
        self.offset + bytes <= SECTOR_BYTES as usize
    }

    /// One step, if the chip is ready for it.
    fn try_step(&mut self) -> Result<bool, C::Error> {
        if !self.has_work() {
            return Ok(false);
        }
        if self.chip.is_busy()? {
            return Ok(true);
        }
        if self.writing.is_some() {
            self.write_on()?;
        } else if self.must_open {
            self.open_next_sector()?;
        } else if self.offset == 0 {
            let begins = Key { boot: self.boot, window: self.begun };
            let header = SectorHeader { sequence: self.sequence, begins, whole: self.present.next }.write();
            self.record[..header.len()].copy_from_slice(&header);
            self.writing = Some(Writing { content: Content::Header, length: header.len(), written: 0 });
        } else if self.is_state_due {
            self.begin_state();
        } else {
            return self.read_on();
        }
        Ok(true)
    }

    fn has_work(&self) -> bool {
        self.sectors > 0 && (!self.is_free() || self.reader.is_wanted())
    }

    /// Whether a part can be put.
    fn is_free(&self) -> bool {
        self.writing.is_none() && !self.must_open && self.offset > 0 && !self.is_state_due
    }

    fn write_on(&mut self) -> Result<(), C::Error> {
        let Some(writing) = &mut self.writing else { return Ok(()) };
        let address = Self::address(self.newest, self.offset + writing.written);
        let in_page = (PAGE_BYTES - address % PAGE_BYTES) as usize;
        let count = (writing.length - writing.written).min(in_page).min(STEP_BYTES);
        if let Some(bytes) = self.record.get(writing.written..writing.written + count) {
            self.chip.write(address, bytes)?;
        }
        writing.written += count;
        if writing.written < writing.length {
            return Ok(());
        }
        let Writing { content, length, .. } = *writing;
        self.writing = None;
        self.offset += length;
        match content {
            Content::Header => {}
            Content::State => self.is_state_due = false,
            Content::Part { window, part } => {
                self.begun = window.saturating_add(1);
                if part == 0 {
                    // Windows that were acknowledged before they were kept are not missed.
                    self.present.next = window.saturating_add(1);
                }
                self.written = Some((window, part));
            }
        }
        Ok(())
    }

    fn begin_state(&mut self) {
        let first = self.earlier.first().unwrap_or(&self.present);
        self.state.done = Key { boot: first.boot, window: first.oldest };
        let mut buffer = [0; MAX_STATE_BYTES];
        let content = self.state.write(&mut buffer);
        if !self.has_room(content.len() + RECORD_OVERHEAD_BYTES) {
            self.must_open = true;
            return;
        }
        let header = RecordHeader {
            length: content.len() as u16,
            part: STATE,
            sequence: self.sequence,
            key: Key { boot: self.boot, window: self.begun },
        };
        if let Some(length) = header.write(content, &mut self.record) {
            self.writing = Some(Writing { content: Content::State, length, written: 0 });
        }
    }

    /// Goes on to the next sector, over whatever is there.
    fn open_next_sector(&mut self) -> Result<(), C::Error> {
        if self.used == self.sectors {
            // What is lost with the oldest sector shows in the header of the next.
            let next = self.sector(1);
            if let Some(header) = self.sector_header(next)? {
                self.forget_before(header.begins);
            }
            self.used -= 1;
            self.reader.begin_anew();
        }
        let next = (self.newest + 1) % self.sectors;
        self.chip.erase(Self::address(next, 0))?;
        (self.newest, self.sequence, self.offset) = (next, self.sequence.wrapping_add(1), 0);
        self.used += 1;
        (self.must_open, self.is_state_due) = (false, true);
        Ok(())
    }

    /// Drops windows from before a moment, and counts them.
    fn forget_before(&mut self, begins: Key) {
        let mut lost = 0;
        for held in self.earlier.iter_mut().chain([&mut self.present]) {
            let end = if is_earlier_boot(held.boot, begins.boot) {
                held.next
            } else if held.boot == begins.boot {
                begins.window.min(held.next)
            } else {
                held.oldest
            };
            lost += end.saturating_sub(held.oldest);
            held.oldest = held.oldest.max(end);
        }
        self.lost_windows = self.lost_windows.saturating_add(lost);
        self.has_news |= lost > 0 && !self.earlier.is_empty();
        self.earlier.retain(|held| held.oldest < held.next);
    }
}

impl<C: Chip> Keeper for Store<C> {
    fn put(&mut self, window: u32, part: u16, message: &[u8]) -> bool {
        if self.sectors == 0 || !self.is_free() || self.written.is_some() {
            return false;
        }
        if !self.has_room(message.len() + RECORD_OVERHEAD_BYTES) {
            self.must_open = true;
            return false;
        }
        let (sequence, key) = (self.sequence, Key { boot: self.boot, window });
        let header = RecordHeader { length: message.len() as u16, part, sequence, key };
        let length = header.write(message, &mut self.record);
        self.writing = length.map(|length| Writing { content: Content::Part { window, part }, length, written: 0 });
        self.writing.is_some()
    }

    fn keeps(&self) -> bool {
        self.sectors > 0
    }

    fn take_written(&mut self) -> Option<(u32, u16)> {
        self.written.take()
    }

    fn step(&mut self) -> bool {
        // A bus that fails may work the next time.
        self.try_step().unwrap_or(false)
    }

    fn kept(&self) -> Option<Kept> {
        if self.sectors == 0 {
            return None;
        }
        let none = Held { oldest: 0, next: 0, ..self.present };
        let Held { boot, oldest, next } = self.earlier.first().copied().unwrap_or(none);
        Some(Kept { last_time: self.last_time, boot, oldest_window: oldest, next_window: next })
    }

    fn oldest_window(&self) -> Option<u32> {
        (self.present.oldest < self.present.next).then_some(self.present.oldest)
    }

    fn lost_windows(&self) -> u32 {
        self.lost_windows
    }

    fn acknowledge(&mut self, boot: u32, below: u32) -> bool {
        let is_present = boot == self.boot;
        let held = if is_present { Some(&mut self.present) } else { self.earlier.first_mut() };
        let Some(held) = held.filter(|held| held.boot == boot) else { return true };
        if !is_present && below > held.next {
            return false;
        }
        if below > held.oldest {
            held.oldest = below;
            // Of the present boot, while windows of earlier ones wait, nothing would change in what is stored.
            self.is_state_due |= !is_present || self.earlier.is_empty();
            self.reader.is_had(Key { boot, window: below });
            let before = self.earlier.len();
            self.earlier.retain(|held| held.oldest < held.next);
            self.has_news |= self.earlier.len() < before;
        }
        true
    }

    fn want(&mut self, boot: u32, wanted: &Again) {
        let held = self.earlier.iter().chain([&self.present]).find(|held| held.boot == boot);
        let Some(held) = held else { return };
        let (first_window, last_window) =
            (wanted.first_window.max(held.oldest), wanted.last_window.min(held.next.saturating_sub(1)));
        if first_window <= last_window && first_window < held.next {
            self.reader.want(boot, Again { first_window, last_window, ..*wanted });
        }
    }

    fn is_loaded(&self) -> bool {
        self.reader.is_loaded()
    }

    fn take_loaded(&mut self) -> Option<&[u8]> {
        self.reader.take_loaded()
    }

    fn take_news(&mut self) -> bool {
        core::mem::take(&mut self.has_news)
    }

    fn configuration(&self) -> Option<Configuration> {
        self.state.configuration.clone()
    }

    fn set_configuration(&mut self, configuration: &Configuration) {
        if self.state.configuration.as_ref() != Some(configuration) {
            self.state.configuration = Some(configuration.clone());
            self.is_state_due = true;
        }
    }

    fn calibration(&self) -> Option<Calibration> {
        self.state.calibration.clone()
    }

    fn set_calibration(&mut self, calibration: &Calibration) {
        if self.state.calibration.as_ref() != Some(calibration) {
            self.state.calibration = Some(calibration.clone());
            self.is_state_due = true;
        }
    }

    fn set_time(&mut self, now: HostTime) {
        if self.state.time.is_none_or(|stored| now.0.saturating_sub(stored.0).saturating_abs() >= TIME_PERIOD_US) {
            self.state.time = Some(now);
            self.is_state_due = true;
        }
    }
}
