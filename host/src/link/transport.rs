//! What a line to a node must be able to do.

use std::io;
use std::time::Duration;

/// A byte stream to a node that never blocks for long.
pub trait Transport {
    /// Takes bytes to send.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Fills `buffer` with bytes that have arrived and returns how many; 0 where there are none.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;

    /// Waits until bytes have come, or so long. A line whose time is simulated does not wait.
    ///
    /// # Errors
    /// Where the line fails.
    fn wait(&mut self, longest: Duration) -> io::Result<()> {
        let _ = longest;
        Ok(())
    }
}
