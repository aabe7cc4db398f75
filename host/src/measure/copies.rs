//! Channels that are copies of others: one column of a file under two names, or one input that was recorded twice.
//!
//! Rows flow in; which channels are copies, and of which, flows out. Two sensors have noise of their own, so that their samples are never equal
//! row for row.

/// Rows that must be alike: short pieces of few counts may be so by chance.
const LEAST_ROWS: u64 = 256;
/// Numbers are alike within this share: a factor to m/s² leaves so much.
const ALIKE: f64 = 1e-12;

/// Looks for channels that are copies.
#[derive(Debug)]
pub(super) struct CopyFinder {
    /// By channel, what makes a sample what was recorded, and whether it is the one of several that is to stay.
    factors: Vec<f64>,
    stay: Vec<bool>,
    rows: u64,
    /// Channels that were alike in every row so far, two and more at a time.
    groups: Vec<Vec<usize>>,
    /// By channel, its first sample, and whether others have differed from it.
    first: Vec<Option<f64>>,
    moves: Vec<bool>,
}

impl CopyFinder {
    /// For channels whose samples, each times its factor, are what was recorded. Of several that are alike, one of those stays that `stay`.
    pub(super) fn new(factors: Vec<f64>, stay: Vec<bool>) -> Self {
        let channels = factors.len();
        let groups = if channels > 1 { vec![(0..channels).collect()] } else { Vec::new() };
        Self { factors, stay, rows: 0, groups, first: vec![None; channels], moves: vec![false; channels] }
    }

    /// Takes rows, row-major, NaN where a sample is missing.
    pub(super) fn push(&mut self, rows: &[f64]) {
        let channels = self.factors.len();
        if channels == 0 {
            return;
        }
        for row in rows.chunks_exact(channels) {
            if self.groups.is_empty() {
                return;
            }
            // Rows in which nothing stands are alike in that.
            self.rows += u64::from(row.iter().any(|value| !value.is_nan()));
            let value = |channel: usize| row[channel] * self.factors[channel];
            let is_alike = |one: usize, other: usize| {
                let (one, other) = (value(one), value(other));
                one == other || (one.is_nan() && other.is_nan()) || (one - other).abs() <= ALIKE * one.abs()
            };
            for group in std::mem::take(&mut self.groups) {
                let mut parts: Vec<Vec<usize>> = Vec::new();
                for channel in group {
                    match parts.iter_mut().find(|part| is_alike(part[0], channel)) {
                        Some(part) => part.push(channel),
                        None => parts.push(vec![channel]),
                    }
                }
                self.groups.extend(parts.into_iter().filter(|part| part.len() > 1));
            }
            for &channel in self.groups.iter().filter_map(|group| group.first()) {
                let value = row[channel];
                if !value.is_nan() {
                    let first = *self.first[channel].get_or_insert(value);
                    self.moves[channel] |= value != first;
                }
            }
        }
    }

    /// Copies, each with the channel that it is one of. Channels that do not move are none.
    pub(super) fn finish(self) -> Vec<[usize; 2]> {
        if self.rows < LEAST_ROWS {
            return Vec::new();
        }
        let moving = self.groups.iter().filter(|group| self.moves[group[0]]);
        let of_group = |group: &Vec<usize>| {
            let stays = |channel: &&usize| self.stay.get(**channel).copied().unwrap_or_default();
            let kept = group.iter().find(stays).or(group.first()).copied().unwrap_or_default();
            group.iter().filter(|&&channel| channel != kept).map(|&copy| [copy, kept]).collect::<Vec<_>>()
        };
        let mut copies: Vec<[usize; 2]> = moving.flat_map(of_group).collect();
        copies.sort_unstable();
        copies
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    }

    /// Rows of four channels: two sensors, a copy of the first that was read with half of the sensitivity, and what `last` makes of a row.
    fn copies(rows: usize, reference: bool, last: impl Fn(usize, [f64; 2]) -> f64) -> Vec<[usize; 2]> {
        let mut state = 7;
        let mut finder = CopyFinder::new(vec![1.0, 1.0, 0.5, 1.0], vec![false, false, false, reference]);
        for row in 0..rows {
            let motion = (row as f64 * 0.2).sin();
            let sensors = [(); 2].map(|()| motion + 1e-6 * noise(&mut state));
            finder.push(&[sensors[0], sensors[1], sensors[0] / 0.5, last(row, sensors)]);
        }
        finder.finish()
    }

    #[test]
    fn a_copy_is_found_whatever_its_sensitivity_and_a_sensor_beside_another_is_none() {
        assert_eq!(copies(1000, false, |_, [_, second]| second + 1e-9), [[2, 0]]);
        assert_eq!(copies(1000, false, |_, [_, second]| second), [[2, 0], [3, 1]]);
        assert_eq!(copies(1000, false, |_, [first, _]| first), [[2, 0], [3, 0]]);
        // Where both miss a sample they are alike; where one does they are not.
        assert_eq!(copies(1000, false, |row, [_, second]| if row == 999 { f64::NAN } else { second }), [[2, 0]]);
        assert_eq!(copies(100, false, |_, [_, second]| second), <[[usize; 2]; 0]>::default(), "too short");
        // A reference stays.
        assert_eq!(copies(1000, true, |_, [first, _]| first), [[0, 3], [2, 3]]);
    }

    #[test]
    fn channels_that_do_not_move_are_copies_of_nothing() {
        let mut finder = CopyFinder::new(vec![1.0; 3], vec![false; 3]);
        (0..1000).for_each(|row| finder.push(&[0.0, 0.0, f64::from(row)]));
        assert!(finder.finish().is_empty());
        assert!(CopyFinder::new(Vec::new(), Vec::new()).finish().is_empty());
    }
}
