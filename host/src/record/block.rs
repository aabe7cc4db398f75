//! Blocks: a few thousand rows of a recording at a time, in a buffer that is used again and again.

/// Consecutive rows of a recording, row-major, `rows × channels`; a missing sample is NaN.
///
/// Values are in SI units of what each sensor measures, channels in the order of the setup's sensors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Block {
    channels: usize,
    values: Vec<f64>,
}

impl Block {
    /// An empty block; [`Recording::next_block`](super::Recording::next_block) gives it its channels and rows.
    pub fn new() -> Self {
        Self::default()
    }

    /// Channels a row.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Number of rows.
    pub fn row_count(&self) -> usize {
        self.values.len() / self.channels.max(1)
    }

    /// The rows in time order, each with one value a channel.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.channels.max(1))
    }

    /// The values of one channel in time order.
    pub(super) fn channel_mut(&mut self, channel: usize) -> impl Iterator<Item = &mut f64> {
        self.values.iter_mut().skip(channel).step_by(self.channels.max(1))
    }

    /// Subtracts each channel's own number from all its values.
    pub(super) fn subtract(&mut self, offsets: &[f64]) {
        for (channel, &offset) in offsets.iter().enumerate().filter(|(_, offset)| **offset != 0.0) {
            self.channel_mut(channel).for_each(|value| *value -= offset);
        }
    }

    /// All values, row after row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Puts missing rows between blocks of `length` rows, of which `before` rows are gone by, and before the first unless
    /// the recording starts with it; how many rows are gone by then.
    pub(super) fn part(&mut self, before: u64, length: u64, missing: usize, is_start: bool) -> u64 {
        let rows = self.row_count() as u64;
        let is_first = |row: u64| row.is_multiple_of(length) && !(is_start && row == 0);
        if (before..before + rows).any(is_first) {
            let mut parted = Vec::with_capacity(self.values.len());
            for (row, values) in (before..).zip(self.rows()) {
                if is_first(row) {
                    parted.extend(std::iter::repeat_n(f64::NAN, missing * self.channels));
                }
                parted.extend_from_slice(values);
            }
            self.values = parted;
        }
        before + rows
    }

    /// Empties the block for rows of `channels` values and hands out its buffer, which keeps its capacity.
    pub(super) fn start(&mut self, channels: usize) -> &mut Vec<f64> {
        self.channels = channels;
        self.values.clear();
        &mut self.values
    }
}
