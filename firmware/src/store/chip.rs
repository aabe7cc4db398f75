//! What the store needs of a memory chip.

/// Bytes of a sector: what a chip erases at once.
pub const SECTOR_BYTES: u32 = 4096;
/// Most bytes that are read or written in one step: some 100 µs on a bus of 5 MHz.
pub const STEP_BYTES: usize = 32;

/// A memory chip that keeps its bytes without supply.
///
/// Calls take as long as their bytes take on the bus. What takes the chip longer (an erase of NOR flash, up to 0.4 s) goes on after the call,
/// and [`is_busy`](Self::is_busy) tells. The traits of `embedded-storage` return when all is done, which the node cannot wait for.
pub trait Chip {
    /// Why a transfer failed.
    type Error;

    /// Its size in bytes; 0 where none answers.
    fn size_bytes(&self) -> u32;

    /// Whether bytes can be written over others (FRAM), or only where all bits are set since an erase (NOR flash).
    fn is_overwritable(&self) -> bool;

    /// Whether it still erases or writes; it takes nothing else meanwhile.
    fn is_busy(&mut self) -> Result<bool, Self::Error>;

    /// Reads up to [`STEP_BYTES`].
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), Self::Error>;

    /// Writes up to [`STEP_BYTES`] that lie within 256 bytes of a multiple of 256.
    fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), Self::Error>;

    /// Erases the sector that begins at `address`, so that all its bits are set. Where bytes can be written over others, there is nothing to do.
    fn erase(&mut self, address: u32) -> Result<(), Self::Error>;
}
