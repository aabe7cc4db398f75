//! How much a setup's recording holds.
//!
//! Rows, rates and blocks flow in; the number of windows that they give flows out to the plan.

use belfry_shared::decimation::Stages;

/// What the plan needs to know of a setup.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetupExtent {
    /// Raw rows a second.
    pub sampling_rate_hz: f64,
    /// Rows in the recording.
    pub rows: u64,
    /// Channels.
    pub channels: usize,
    /// Rows of each of the blocks that its files are joined of, if they are.
    pub block_rows: Option<u64>,
}

impl SetupExtent {
    /// Windows that the recording gives. They do not begin anew in a block, so of those that reach into it one less is whole.
    pub(super) fn windows(&self, decimation: u32, segment: usize) -> usize {
        match self.block_rows {
            Some(block) if block < self.rows => {
                (self.rows / block) as usize * window_count(block, decimation, segment).saturating_sub(1)
            }
            _ => window_count(self.rows, decimation, segment),
        }
    }
}

/// Windows that `rows` rows give.
pub(super) fn window_count(rows: u64, decimation: u32, segment: usize) -> usize {
    let Some(stages) = Stages::of(decimation) else { return 0 };
    let last_full =
        (rows.max(1) - 1).checked_sub(u64::from(stages.reach_rows())).map(|row| row / u64::from(decimation));
    let samples = last_full.map_or(0, |last| (last + 1).saturating_sub(u64::from(stages.first_full_output())));
    let segment = segment as u64;
    if samples < segment { 0 } else { ((samples - segment) / (segment / 2)) as usize + 1 }
}

/// The rows that give `windows` windows, at least one; the inverse of [`window_count`].
pub(crate) fn rows_for(windows: usize, decimation: u32, segment: usize) -> u64 {
    let Some(stages) = Stages::of(decimation) else { return 0 };
    let samples = (segment + windows.saturating_sub(1) * (segment / 2)) as u64;
    let last_full = samples.saturating_sub(1) + u64::from(stages.first_full_output());
    last_full * u64::from(decimation) + u64::from(stages.reach_rows()) + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_for_windows_are_as_many_as_give_them_and_not_one_more() {
        for (decimation, segment, windows) in [(1, 256, 1), (10, 4096, 7), (8, 512, 86), (100, 1024, 300)] {
            let rows = rows_for(windows, decimation, segment);
            assert_eq!(window_count(rows, decimation, segment), windows);
            assert_eq!(window_count(rows - 1, decimation, segment), windows - 1);
        }
    }

    #[test]
    fn no_window_reaches_over_the_joint_of_two_blocks() {
        let whole = SetupExtent { sampling_rate_hz: 50.0, rows: 100_000, channels: 4, block_rows: None };
        let joined = SetupExtent { block_rows: Some(4096), ..whole };
        assert_eq!(joined.windows(1, 1024), 24 * 6);
        assert_eq!(joined.windows(1, 8192), 0);
        assert!(whole.windows(1, 1024) > 24 * 6 && whole.windows(1, 8192) > 0);
    }
}
