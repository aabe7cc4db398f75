//! The last rows of a recording.

use crate::processor::whole_rows;

/// Rows that are kept, by their number in the recording.
pub(super) struct Rows {
    channels: usize,
    kept: usize,
    values: Vec<f64>,
    /// Number of the first row in `values`.
    first: u64,
}

impl Rows {
    /// Keeps at least so many rows.
    pub(super) fn new(channels: usize, kept: usize) -> Self {
        Self { channels, kept, values: Vec::with_capacity(2 * kept * channels), first: 0 }
    }

    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// Takes rows, row-major, behind those that are kept.
    pub(super) fn push(&mut self, rows: &[f64]) {
        // Twice as many rows are held before any go, so that single old ones need not go one by one.
        let kept = self.kept * self.channels;
        if self.values.len() >= 2 * kept {
            let gone = self.values.len() - kept;
            self.values.drain(..gone);
            self.first += (gone / self.channels.max(1)) as u64;
        }
        self.values.extend_from_slice(whole_rows(rows, self.channels));
    }

    /// Number of the first row that is kept, and of the one after the last.
    pub(super) fn start(&self) -> u64 {
        self.first
    }

    pub(super) fn end(&self) -> u64 {
        self.first + (self.values.len() / self.channels.max(1)) as u64
    }

    /// The rows from one on, row-major; all that are kept where it is gone.
    pub(super) fn from(&self, row: u64) -> &[f64] {
        let gone = (row.saturating_sub(self.first) as usize * self.channels).min(self.values.len());
        &self.values[gone..]
    }
}
