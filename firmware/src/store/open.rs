//! Opening: what a start finds on the chip.

use heapless::Vec;

use super::chip::{Chip, SECTOR_BYTES, STEP_BYTES};
use super::reader::Reader;
use super::record::{
    Key, MAX_RECORD_BYTES, RECORD_HEADER_BYTES, RecordHeader, SECTOR_HEADER_BYTES, STATE, SectorHeader, State, content,
    is_earlier_boot, is_sealed,
};
use super::{Held, LEAST_SECTORS, Store};

/// How often to look whether the chip is ready: it takes some 5 µs each time, and an erase that a reset has left to it 0.4 s.
const MOST_LOOKS: u32 = 200_000;

impl<C: Chip> Store<C> {
    /// Opens the store on a chip, and stores that this start has been: so no boot id comes twice. `random` is the boot id of the first start, and
    /// of every start without a chip. It takes up to half a second, so it is for before the node samples.
    pub fn open(chip: C, random: u32) -> Self {
        let present = Held { boot: random, oldest: 0, next: 0 };
        let mut store = Self {
            sectors: chip.size_bytes() / SECTOR_BYTES,
            chip,
            boot: random,
            newest: 0,
            sequence: 0,
            offset: SECTOR_BYTES as usize,
            used: 0,
            must_open: false,
            begun: 0,
            present,
            earlier: Vec::new(),
            lost_windows: 0,
            state: State::new(random),
            is_state_due: true,
            last_time: None,
            has_news: false,
            writing: None,
            written: None,
            record: [0; MAX_RECORD_BYTES],
            reader: Reader::new(),
        };
        if store.sectors < LEAST_SECTORS || store.look().and_then(|()| store.note_start()).is_err() {
            store.sectors = 0;
            store.boot = random;
            store.state = State::new(random);
            store.earlier.clear();
        }
        store
    }

    fn wait(&mut self) -> Result<(), ()> {
        for _ in 0..MOST_LOOKS {
            if !self.chip.is_busy().map_err(drop)? {
                return Ok(());
            }
        }
        Err(())
    }

    /// Stores the boot id.
    fn note_start(&mut self) -> Result<(), ()> {
        self.present.boot = self.boot;
        for _ in 0..MOST_LOOKS {
            if !self.has_work() {
                return Ok(());
            }
            self.try_step().map_err(drop)?;
        }
        Err(())
    }

    /// Finds the newest and the oldest sector, and what lies in between.
    fn look(&mut self) -> Result<(), ()> {
        self.wait()?;
        let mut newest: Option<(u32, SectorHeader)> = None;
        for sector in 0..self.sectors {
            let header = self.sector_header(sector).map_err(drop)?;
            if let Some(header) = header
                && newest.is_none_or(|(_, newest)| header.sequence > newest.sequence)
            {
                newest = Some((sector, header));
            }
        }
        let Some((sector, header)) = newest else {
            self.newest = self.sectors - 1;
            return Ok(());
        };
        (self.newest, self.sequence, self.used) = (sector, header.sequence, 1);
        for used in (2..=self.sectors).rev() {
            let sector = (sector + self.sectors + 1 - used) % self.sectors;
            let found = self.sector_header(sector).map_err(drop)?;
            if found.is_some_and(|found| found.sequence == header.sequence.wrapping_sub(used - 1)) {
                self.used = used;
                break;
            }
        }
        self.boot = header.begins.boot;
        let mut next = self.sector_header(self.sector(0)).map_err(drop)?;
        for behind_oldest in 0..self.used {
            let header = next;
            let is_newest = behind_oldest + 1 == self.used;
            next = if is_newest { None } else { self.sector_header(self.sector(behind_oldest + 1)).map_err(drop)? };
            let Some(header) = header else { continue };
            let held = Held { boot: header.begins.boot, oldest: header.begins.window, next: header.whole };
            self.hold(held);
            // Where the next sector was begun by the same boot, its header says what this one has; and the last two have the state.
            let has_more = next.is_none_or(|next| next.begins.boot != header.begins.boot);
            if has_more || behind_oldest + 2 >= self.used {
                self.offset = self.walk(self.sector(behind_oldest), header.sequence)?;
            }
        }
        if !self.is_clear()? {
            self.offset = SECTOR_BYTES as usize;
        }
        let Key { boot, window } = self.state.done;
        self.earlier.iter_mut().filter(|held| held.boot == boot).for_each(|held| held.oldest = held.oldest.max(window));
        self.earlier.retain(|held| held.oldest < held.next && !is_earlier_boot(held.boot, boot));
        self.last_time = self.state.time;
        self.boot = self.boot.wrapping_add(1);
        Ok(())
    }

    /// Looks at the records of a sector; where the last one ends.
    fn walk(&mut self, sector: u32, sequence: u32) -> Result<usize, ()> {
        let mut offset = SECTOR_HEADER_BYTES;
        while offset + RECORD_HEADER_BYTES <= SECTOR_BYTES as usize {
            let mut bytes = [0; RECORD_HEADER_BYTES];
            self.chip.read(Self::address(sector, offset), &mut bytes).map_err(drop)?;
            let header = RecordHeader::read(&bytes, sequence)
                .filter(|header| offset + header.record_bytes() <= SECTOR_BYTES as usize);
            let Some(header) = header else { break };
            let Some(record) = self.record.get_mut(..header.record_bytes()) else { break };
            for (index, piece) in record.chunks_mut(STEP_BYTES).enumerate() {
                let address = Self::address(sector, offset + index * STEP_BYTES);
                self.chip.read(address, piece).map_err(drop)?;
            }
            if !is_sealed(record) {
                break;
            }
            self.boot = header.key.boot;
            if header.part == STATE {
                if let Some(state) = State::read(content(record)) {
                    self.state = state;
                }
            } else {
                let window = header.key.window;
                let next = if header.part == 0 { window.saturating_add(1) } else { 0 };
                self.hold(Held { boot: header.key.boot, oldest: window, next });
            }
            offset += header.record_bytes();
        }
        Ok(offset)
    }

    /// Takes note of windows of an earlier boot. They come in their order.
    fn hold(&mut self, found: Held) {
        if let Some(held) = self.earlier.last_mut().filter(|held| held.boot == found.boot) {
            held.next = held.next.max(found.next);
            return;
        }
        // A boot that has no whole window needs no place.
        if self.earlier.last().is_some_and(|held| held.oldest >= held.next) {
            self.earlier.pop();
        }
        if self.earlier.is_full() {
            let lost = self.earlier.remove(0);
            self.lost_windows = self.lost_windows.saturating_add(lost.next - lost.oldest);
        }
        let _ = self.earlier.push(found);
    }

    /// Whether bytes can be written behind the last record.
    fn is_clear(&mut self) -> Result<bool, ()> {
        if self.chip.is_overwritable() {
            return Ok(true);
        }
        let mut offset = self.offset;
        while offset < SECTOR_BYTES as usize {
            let mut bytes = [u8::MAX; STEP_BYTES];
            let count = STEP_BYTES.min(SECTOR_BYTES as usize - offset);
            if let Some(place) = bytes.get_mut(..count) {
                self.chip.read(Self::address(self.newest, offset), place).map_err(drop)?;
            }
            if bytes.iter().any(|&byte| byte != u8::MAX) {
                return Ok(false);
            }
            offset += count;
        }
        Ok(true)
    }
}
