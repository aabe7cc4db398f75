//! A simulated memory chip, which loses its supply at any byte of any write and in the middle of any erase.

use core::ops::DerefMut;

use super::chip::{Chip, SECTOR_BYTES};

/// Bytes that an erase sets at a time: it may be cut between them.
const ERASE_PIECE_BYTES: usize = 256;

/// What it is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Technology {
    /// Bytes are written over others, at once.
    Fram,
    /// A write only clears bits. Writes and erases take a while.
    Nor,
}

/// Why a transfer fails: it has no supply any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoSupply;

/// A memory chip with its bytes in `M`.
#[derive(Debug)]
pub struct SimulatedChip<M> {
    memory: M,
    technology: Technology,
    /// Bytes that can still be written, and pieces erased, before its supply fails; `None` for as many as one likes.
    left: Option<u64>,
    /// What the byte becomes during which it fails.
    noise: u8,
    done: u64,
    busy_looks: u32,
    overwritten_bytes: u64,
}

impl<M: DerefMut<Target = [u8]>> SimulatedChip<M> {
    /// A chip with bytes from before.
    pub fn new(memory: M, technology: Technology) -> Self {
        Self { memory, technology, left: None, noise: 0, done: 0, busy_looks: 0, overwritten_bytes: 0 }
    }

    /// Has its supply fail after so many bytes written or pieces erased; the next one is left as `noise` makes it.
    pub fn fail_after(&mut self, steps: u64, noise: u8) {
        (self.left, self.noise) = (Some(steps), noise);
    }

    /// Bytes written and pieces erased so far.
    pub fn done(&self) -> u64 {
        self.done
    }

    /// Whether its supply has failed.
    pub fn has_failed(&self) -> bool {
        self.left == Some(0)
    }

    /// Bytes that were written where a write could not set all bits as it should: an erase is missing.
    pub fn overwritten_bytes(&self) -> u64 {
        self.overwritten_bytes
    }

    /// Its bytes.
    pub fn release(self) -> M {
        self.memory
    }

    fn has_supply(&self) -> Result<(), NoSupply> {
        if self.left == Some(0) { Err(NoSupply) } else { Ok(()) }
    }

    /// Takes one step; whether it was not the one during which the supply fails.
    fn step(&mut self) -> bool {
        self.done += 1;
        match &mut self.left {
            None => true,
            Some(left) => {
                *left = left.saturating_sub(1);
                *left > 0
            }
        }
    }

    fn place(&mut self, address: u32, length: usize) -> &mut [u8] {
        self.memory.get_mut(address as usize..).and_then(|rest| rest.get_mut(..length)).unwrap_or(&mut [])
    }
}

impl<M: DerefMut<Target = [u8]>> Chip for SimulatedChip<M> {
    type Error = NoSupply;

    fn size_bytes(&self) -> u32 {
        self.memory.len() as u32
    }

    fn is_overwritable(&self) -> bool {
        self.technology == Technology::Fram
    }

    fn is_busy(&mut self) -> Result<bool, NoSupply> {
        self.has_supply()?;
        let is_busy = self.busy_looks > 0;
        self.busy_looks = self.busy_looks.saturating_sub(1);
        Ok(is_busy)
    }

    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), NoSupply> {
        self.has_supply()?;
        let length = bytes.len();
        bytes.iter_mut().zip(self.place(address, length)).for_each(|(byte, memory)| *byte = *memory);
        Ok(())
    }

    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), NoSupply> {
        self.has_supply()?;
        let (is_nor, noise) = (self.technology == Technology::Nor, self.noise);
        for (address, &byte) in (address..).zip(bytes) {
            let is_whole = self.step();
            let Some(memory) = self.place(address, 1).first_mut() else { continue };
            let before = *memory;
            // A write that is cut has cleared some of the bits that it should clear.
            let wanted = if is_whole { byte } else { byte | noise };
            *memory = match (is_nor, is_whole) {
                (true, _) => before & wanted,
                (false, true) => byte,
                (false, false) => noise,
            };
            self.overwritten_bytes += u64::from(is_nor && before & byte != byte);
            if !is_whole {
                return Err(NoSupply);
            }
        }
        self.busy_looks = u32::from(is_nor);
        Ok(())
    }

    fn erase(&mut self, address: u32) -> Result<(), NoSupply> {
        self.has_supply()?;
        if self.is_overwritable() {
            return Ok(());
        }
        for piece in (address..address + SECTOR_BYTES).step_by(ERASE_PIECE_BYTES) {
            let (is_whole, noise) = (self.step(), self.noise);
            let fill = |byte: &mut u8| *byte = if is_whole { u8::MAX } else { *byte | noise };
            self.place(piece, ERASE_PIECE_BYTES).iter_mut().for_each(fill);
            if !is_whole {
                return Err(NoSupply);
            }
        }
        self.busy_looks = 3;
        Ok(())
    }
}
