//! From windows to the averaged cross-spectral matrix.
//!
//! Windows flow in, sums of outer products grow in groups of consecutive windows (for the delete-a-group jackknife); memory
//! does not grow with the record, beyond the windows of a short one. Channels may be silent in some windows: sums are kept by the set
//! of channels that are sound.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use num_complex::Complex32;
use thiserror::Error;

use super::cross_spectrum::CrossSpectrum;
use super::finer::KeptWindows;
use super::grid::{LineGrid, WindowLines};
use super::sums::{ChannelSubset, Sums, Total, add_outer_products, triangle};
use crate::processor::on_this_processor;

/// Groups are merged pairwise when there would be more; so there are 12 to 24 once there are as many windows.
pub(super) const MAX_GROUPS: usize = 24;
/// Windows that are added together at most.
const MAX_WAITING: usize = 8;
/// Sets of channels that sums are kept for; each costs as much memory as the whole average.
const MAX_SETS: usize = 4;
/// A channel that is sound in fewer windows than this share of the soundest channel's is left out.
const MIN_SOUND_SHARE: f64 = 0.5;

/// Why there is no cross-spectral matrix.
#[derive(Debug, Error, PartialEq)]
pub enum SpectraError {
    /// More channels than a set has places for.
    #[error("a setup can have 128 channels, this one has {0}")]
    TooManyChannels(usize),
    /// No window came.
    #[error("no complete window: the recording is shorter than one segment")]
    NoWindows,
    /// No window is sound on the channels that are sound at all.
    #[error("no window is sound on all live channels at once: every one has gaps, clipped or constant samples")]
    NoSoundWindows {
        /// Windows in which each channel is sound.
        sound: Vec<usize>,
        /// All windows.
        windows: usize,
    },
    /// A window does not fit the others.
    #[error("a window has {found} channels or lines where {expected} were expected")]
    Shape {
        /// What it has.
        found: usize,
        /// What it should have.
        expected: usize,
    },
}

/// What was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SpectraWarning {
    /// A channel is not used.
    ChannelLeftOut {
        /// Index in the setup's channel order.
        channel: usize,
        /// Windows in which it is sound.
        sound: usize,
        /// All windows.
        windows: usize,
    },
    /// Windows are not used, since a channel that is used is not sound in them.
    WindowsLeftOut {
        /// Windows not used.
        left_out: usize,
        /// All windows.
        windows: usize,
    },
}

/// Sums of a group of windows. Single precision: they are only taken off the total for the jackknife, and are most of the
/// memory.
type Group = BTreeMap<u128, Sums<f32>>;

/// What is summed of the windows in which the same channels are sound.
#[derive(Debug, Clone)]
struct Set {
    /// Its windows, and the rank of the set that it replaced.
    rank: usize,
    /// The sums of the group that windows are being added to; of no windows where the group has none of the set yet.
    open: Sums<f64>,
    /// Those of all closed groups, and what is kept of all windows.
    total: Total,
}

/// Sums cross spectra window by window.
#[derive(Debug, Clone)]
pub struct CrossSpectrumAccumulator {
    grid: LineGrid,
    channels: usize,
    windows: usize,
    /// Windows in which each channel is sound.
    sound: Vec<usize>,
    windows_a_group: usize,
    groups: Vec<Group>,
    /// Windows of the group that is not closed.
    open_windows: usize,
    /// Windows that wait to be added together: the sums are larger than a cache, the windows of one line are not.
    waiting: Vec<(u128, Vec<Vec<Complex32>>)>,
    /// By the channels that are sound.
    sets: BTreeMap<u128, Set>,
    /// All windows as they came, where it is known that they are not too many.
    kept: Option<KeptWindows>,
}

impl CrossSpectrumAccumulator {
    /// Nothing summed yet, for a setup of `channels` channels.
    ///
    /// # Errors
    /// More channels than a set has places for.
    pub fn new(grid: LineGrid, channels: usize) -> Result<Self, SpectraError> {
        Self::expecting(grid, channels, 0)
    }

    /// The same where it is known about how many windows will come, which saves memory on the way. Those of a short record are kept, so
    /// that finer lines can be made of them.
    ///
    /// # Errors
    /// As [`CrossSpectrumAccumulator::new`].
    pub fn expecting(grid: LineGrid, channels: usize, windows: usize) -> Result<Self, SpectraError> {
        if channels > 128 {
            return Err(SpectraError::TooManyChannels(channels));
        }
        Ok(Self {
            grid,
            channels,
            windows: 0,
            sound: vec![0; channels],
            windows_a_group: windows.div_ceil(MAX_GROUPS).max(1),
            groups: Vec::new(),
            open_windows: 0,
            waiting: Vec::new(),
            sets: BTreeMap::new(),
            kept: KeptWindows::expecting(grid, channels, windows),
        })
    }

    /// The same without keeping windows.
    #[must_use]
    pub fn keeping_none(self) -> Self {
        Self { kept: None, ..self }
    }

    /// Adds a window.
    ///
    /// # Errors
    /// A window with other channels or lines than expected; it is then not added.
    pub fn add(&mut self, window: WindowLines) -> Result<(), SpectraError> {
        if window.channels.len() != self.channels {
            return Err(SpectraError::Shape { found: window.channels.len(), expected: self.channels });
        }
        if let Some(other) = window.channels.iter().flatten().find(|lines| lines.len() != self.grid.lines) {
            return Err(SpectraError::Shape { found: other.len(), expected: self.grid.lines });
        }
        self.kept = self.kept.take().and_then(|kept| kept.with(&window));
        let mut mask = 0_u128;
        let mut sound = Vec::with_capacity(self.channels);
        for (channel, lines) in window.channels.into_iter().enumerate() {
            if let Some(lines) = lines {
                mask |= 1 << channel;
                self.sound[channel] += 1;
                sound.push(lines);
            }
        }
        if self.groups.len() == MAX_GROUPS {
            self.merge_pairs();
        }
        self.windows += 1;
        self.open_windows += 1;
        self.waiting.push((mask, sound));
        if self.open_windows == self.windows_a_group {
            self.close_group();
        } else if self.waiting.len() == MAX_WAITING {
            self.add_waiting();
        }
        Ok(())
    }

    /// Adds the windows that wait to the open group.
    fn add_waiting(&mut self) {
        self.waiting.sort_by_key(|(mask, _)| *mask);
        for windows in self.waiting.chunk_by(|a, b| a.0 == b.0) {
            let (mask, count) = (windows[0].0, windows[0].1.len());
            let lines = self.grid.lines;
            // Where gaps come and go on every channel, every window has channels of its own. A new set takes the place of the
            // rarest and inherits its rank (Space-Saving; Metwally et al. 2005): memory does not grow with the record, and a
            // set that becomes common stays, however late it comes.
            let mut inherited = 0;
            if !self.sets.contains_key(&mask) && self.sets.len() >= MAX_SETS {
                let rarest = self.sets.iter().min_by_key(|(_, set)| set.rank).map(|(&rarest, _)| rarest);
                if let Some((rarest, set)) = rarest.and_then(|rarest| self.sets.remove_entry(&rarest)) {
                    inherited = set.rank;
                    self.groups.iter_mut().for_each(|group| drop(group.remove(&rarest)));
                }
            }
            let Set { rank, open, total } = self.sets.entry(mask).or_insert_with(|| Set {
                rank: inherited,
                open: Sums::zero(lines * triangle(count)),
                total: Total::zero(lines, count),
            });
            *rank += windows.len();
            open.windows += windows.len();
            on_this_processor(
                #[inline(always)]
                |arithmetic| {
                    add_outer_products(arithmetic, windows, count, lines, open, &mut total.fourths);
                    total.add_bands(windows, count, lines);
                    total.add_envelopes(arithmetic, windows, count, lines);
                },
            );
        }
        self.waiting.clear();
    }

    /// From the channels that are sound often enough, takes those out one by one that cost the others more windows than they are
    /// worth.
    fn worth_most(&self) -> Vec<usize> {
        let most = self.sound.iter().copied().max().unwrap_or(0);
        let is_sound =
            |channel: &usize| self.sound[*channel] > 0 && self.sound[*channel] as f64 >= MIN_SOUND_SHARE * most as f64;
        let mut kept: Vec<usize> = (0..self.channels).filter(is_sound).collect();
        let worth = |channels: &[usize]| {
            let wanted = set_of(channels);
            let sets = self.sets.iter().filter(|(mask, _)| *mask & wanted == wanted);
            sets.map(|(_, set)| set.total.sums.windows).sum::<usize>() * channels.len()
        };
        loop {
            let without = |out: usize| kept.iter().copied().filter(|&channel| channel != out).collect::<Vec<_>>();
            let best = kept.iter().map(|&out| without(out)).max_by_key(|rest| worth(rest));
            match best {
                Some(rest) if worth(&rest) > worth(&kept) => kept = rest,
                _ => return kept,
            }
        }
    }

    /// Ends the open group: into the total, and kept for the jackknife.
    fn close_group(&mut self) {
        self.add_waiting();
        if self.open_windows == 0 {
            return;
        }
        let mut group = Group::new();
        for (mask, Set { open, total, .. }) in self.sets.iter_mut().filter(|(_, set)| set.open.windows > 0) {
            group.insert(*mask, open.add_to(&mut total.sums));
        }
        self.groups.push(group);
        self.open_windows = 0;
    }

    fn merge_pairs(&mut self) {
        self.windows_a_group *= 2;
        let mut groups = std::mem::take(&mut self.groups).into_iter();
        while let Some(mut first) = groups.next() {
            for (mask, sums) in groups.next().unwrap_or_default() {
                match first.entry(mask) {
                    Entry::Vacant(place) => drop(place.insert(sums)),
                    Entry::Occupied(mut place) => place.get_mut().add(&sums),
                }
            }
            self.groups.push(first);
        }
    }

    /// Chooses the channels that together with their common windows give most (channels times windows in which all of them are
    /// sound), and averages those windows.
    ///
    /// # Errors
    /// When there is no window, or none is sound on these channels.
    pub fn finish(mut self) -> Result<(CrossSpectrum, Vec<SpectraWarning>), SpectraError> {
        self.close_group();
        let windows = self.windows;
        if windows == 0 {
            return Err(SpectraError::NoWindows);
        }
        let kept = self.worth_most();
        let left_out = (0..self.channels).filter(|channel| !kept.contains(channel));
        let mut warnings: Vec<SpectraWarning> = left_out
            .map(|channel| SpectraWarning::ChannelLeftOut { channel, sound: self.sound[channel], windows })
            .collect();
        let wanted = set_of(&kept);
        let lines = self.grid.lines;
        // The open sums are gone before any set is copied.
        let totals: Vec<(u128, Total)> = self.sets.into_iter().map(|(mask, set)| (mask, set.total)).collect();
        let (mut total, mut groups): (Option<Total>, Vec<Sums<f32>>) = (None, Vec::new());
        for (mask, part) in totals.into_iter().filter(|(mask, _)| mask & wanted == wanted) {
            let part = part.restricted(&ChannelSubset::new(mask, wanted), lines);
            match &mut total {
                None => total = Some(part),
                Some(total) => total.add(&part),
            }
        }
        for group in self.groups {
            let mut merged: Option<Sums<f32>> = None;
            for (mask, sums) in group.into_iter().filter(|(mask, _)| mask & wanted == wanted) {
                let sums = sums.restricted(&ChannelSubset::new(mask, wanted), lines);
                match &mut merged {
                    None => merged = Some(sums),
                    Some(merged) => merged.add(&sums),
                }
            }
            groups.extend(merged);
        }
        let Some(total) = total.filter(|total| total.sums.windows > 0 && !kept.is_empty()) else {
            return Err(SpectraError::NoSoundWindows { sound: self.sound, windows });
        };
        let used = total.sums.windows;
        if used < windows {
            warnings.push(SpectraWarning::WindowsLeftOut { left_out: windows - used, windows });
        }
        Ok((CrossSpectrum { grid: self.grid, kept, groups, total, windows: self.kept }, warnings))
    }
}

/// Channels as a set: a bit each.
fn set_of(channels: &[usize]) -> u128 {
    channels.iter().map(|&channel| 1_u128 << channel).sum()
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;

    fn grid(lines: usize) -> LineGrid {
        LineGrid { sampling_rate_hz: 5.0, segment: 256, first_line: 5, lines }
    }

    /// A deterministic complex number for a window, channel and line.
    fn value(window: usize, channel: usize, line: usize) -> Complex32 {
        let seed = (window * 7919 + channel * 104_729 + line * 1_299_709) as f32;
        Complex32::new((seed * 0.37).sin(), (seed * 0.73).cos())
    }

    fn window(number: usize, channels: usize, lines: usize, sound: impl Fn(usize) -> bool) -> WindowLines {
        let channels = (0..channels)
            .map(|channel| sound(channel).then(|| (0..lines).map(|line| value(number, channel, line)).collect()))
            .collect();
        WindowLines { grid_index: number as u64, channels }
    }

    fn mean_product(windows: &[usize], i: usize, j: usize, line: usize) -> Complex64 {
        let wide = |v: Complex32| Complex64::new(f64::from(v.re), f64::from(v.im));
        let sum: Complex64 = windows.iter().map(|&w| wide(value(w, i, line)) * wide(value(w, j, line)).conj()).sum();
        sum / windows.len() as f64
    }

    #[test]
    fn the_average_is_the_mean_of_outer_products_and_groups_take_consecutive_windows_out() {
        let mut accumulator = CrossSpectrumAccumulator::new(grid(3), 4).unwrap();
        for number in 0..100 {
            accumulator.add(window(number, 4, 3, |_| true)).unwrap();
        }
        let (spectrum, warnings) = accumulator.finish().unwrap();
        assert!(warnings.is_empty());
        assert_eq!((spectrum.averages(), spectrum.group_count()), (100, 13));
        let all: Vec<usize> = (0..100).collect();
        let without_second: Vec<usize> = all.iter().copied().filter(|w| !(8..16).contains(w)).collect();
        for line in 0..3 {
            let (full, part) = (spectrum.matrix(line), spectrum.matrix_without(1, line));
            for i in 0..4 {
                for j in 0..4 {
                    assert!((full[(i, j)] - mean_product(&all, i, j, line)).norm() < 1e-12);
                    // Groups are kept in single precision.
                    assert!((part[(i, j)] - mean_product(&without_second, i, j, line)).norm() < 1e-7);
                }
            }
        }
    }

    #[test]
    fn a_dead_channel_is_left_out_and_windows_with_a_gap_too() {
        let mut accumulator = CrossSpectrumAccumulator::new(grid(2), 4).unwrap();
        for number in 0..40 {
            accumulator
                .add(window(number, 4, 2, |channel| channel != 1 && !(channel == 3 && number % 10 == 0)))
                .unwrap();
        }
        let (spectrum, warnings) = accumulator.finish().unwrap();
        assert_eq!(spectrum.channels(), [0, 2, 3]);
        assert_eq!(
            warnings,
            [
                SpectraWarning::ChannelLeftOut { channel: 1, sound: 0, windows: 40 },
                SpectraWarning::WindowsLeftOut { left_out: 4, windows: 40 }
            ]
        );
        let used: Vec<usize> = (0..40).filter(|number| number % 10 != 0).collect();
        assert!((spectrum.matrix(1)[(0, 2)] - mean_product(&used, 0, 3, 1)).norm() < 1e-12);
        assert!((spectrum.matrix(1)[(1, 2)] - mean_product(&used, 2, 3, 1)).norm() < 1e-12);
    }

    #[test]
    fn gaps_that_come_and_go_on_every_channel_cost_no_memory_and_only_the_windows_they_touch() {
        let mut accumulator = CrossSpectrumAccumulator::expecting(grid(2), 12, 400).unwrap();
        // Every third window lacks some channels, each time others.
        let is_sound =
            |number: usize, channel: usize| !number.is_multiple_of(3) || ((number * 7919) >> (channel % 11)) & 3 != 0;
        for number in 0..400 {
            accumulator.add(window(number, 12, 2, |channel| is_sound(number, channel))).unwrap();
            assert!(accumulator.sets.len() <= MAX_SETS && accumulator.groups.len() <= MAX_GROUPS);
        }
        let (spectrum, warnings) = accumulator.finish().unwrap();
        let whole: Vec<usize> = (0..400).filter(|&n| (0..12).all(|channel| is_sound(n, channel))).collect();
        assert_eq!(spectrum.channels().len(), 12);
        assert_eq!(warnings, [SpectraWarning::WindowsLeftOut { left_out: 400 - whole.len(), windows: 400 }]);
        assert!((spectrum.matrix(1)[(2, 9)] - mean_product(&whole, 2, 9, 1)).norm() < 1e-12);
    }

    #[test]
    fn channels_that_come_online_one_by_one_do_not_cost_the_windows_that_follow() {
        let mut accumulator = CrossSpectrumAccumulator::expecting(grid(2), 12, 1000).unwrap();
        // A channel more every 12 windows.
        for number in 0..1000 {
            accumulator.add(window(number, 12, 2, |channel| number >= 12 * channel)).unwrap();
        }
        let (spectrum, _) = accumulator.finish().unwrap();
        assert_eq!(spectrum.channels().len(), 12);
        let whole: Vec<usize> = (132..1000).collect();
        assert_eq!(spectrum.averages(), whole.len());
        assert!((spectrum.matrix(0)[(3, 11)] - mean_product(&whole, 3, 11, 0)).norm() < 1e-12);
        // Some channels alone are the same averages.
        let some = spectrum.clone().restricted(&[11, 3, 40]);
        assert_eq!((some.channels(), some.averages()), (&[3, 11][..], whole.len()));
        assert_eq!(some.matrix(1)[(0, 1)], spectrum.matrix(1)[(3, 11)]);
        assert_eq!(some.matrix_without(2, 1)[(1, 0)], spectrum.matrix_without(2, 1)[(11, 3)]);
        assert_eq!(some.kurtosis(0)[1], spectrum.kurtosis(0)[11]);
    }

    #[test]
    fn nothing_sound_is_an_error_not_a_matrix_of_zeros() {
        let empty = CrossSpectrumAccumulator::new(grid(2), 2).unwrap();
        assert_eq!(empty.finish().unwrap_err(), SpectraError::NoWindows);
        let mut silent = CrossSpectrumAccumulator::new(grid(2), 2).unwrap();
        for number in 0..10 {
            silent.add(window(number, 2, 2, |_| false)).unwrap();
        }
        assert_eq!(silent.finish().unwrap_err(), SpectraError::NoSoundWindows { sound: vec![0, 0], windows: 10 });
    }

    #[test]
    fn a_channel_that_is_sound_half_of_the_time_does_not_cost_the_others_their_windows() {
        let mut accumulator = CrossSpectrumAccumulator::new(grid(2), 6).unwrap();
        for number in 0..60 {
            accumulator.add(window(number, 6, 2, |channel| channel != 4 || number % 5 < 3)).unwrap();
        }
        let (spectrum, warnings) = accumulator.finish().unwrap();
        assert_eq!((spectrum.channels(), spectrum.averages()), (&[0, 1, 2, 3, 5][..], 60));
        assert_eq!(warnings, [SpectraWarning::ChannelLeftOut { channel: 4, sound: 36, windows: 60 }]);
        // Of two channels it is worth as much as what it costs, and stays.
        let mut pair = CrossSpectrumAccumulator::new(grid(2), 2).unwrap();
        for number in 0..60 {
            pair.add(window(number, 2, 2, |channel| channel == 0 || number % 2 == 0)).unwrap();
        }
        let (spectrum, _) = pair.finish().unwrap();
        assert_eq!((spectrum.channels(), spectrum.averages()), (&[0, 1][..], 30));
    }

    #[test]
    fn kurtosis_is_one_and_a_half_for_a_steady_harmonic_and_three_for_noise() {
        use rand::{RngExt, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut accumulator = CrossSpectrumAccumulator::new(grid(1), 2).unwrap();
        for number in 0..4000 {
            let phase: f32 = random.random_range(0.0..std::f32::consts::TAU);
            // Rayleigh magnitude for the Gaussian channel.
            let magnitude = (-2.0 * (1.0 - random.random::<f32>()).ln()).sqrt();
            let channels = [1.0, magnitude].map(|m| Some(vec![Complex32::from_polar(m, phase)])).to_vec();
            accumulator.add(WindowLines { grid_index: number, channels }).unwrap();
        }
        let (spectrum, _) = accumulator.finish().unwrap();
        let kurtosis = spectrum.kurtosis(0);
        assert!((kurtosis[0] - 1.5).abs() < 1e-5);
        // Standard deviation of <|X|^4>/<|X|^2>^2 over 4000 draws is sqrt(4/4000) = 0.03, times 1.5.
        assert!((kurtosis[1] - 3.0).abs() < 0.2, "{kurtosis:?}");
    }

    #[test]
    fn a_set_that_gave_way_to_another_and_returns_begins_from_nothing() {
        let mut accumulator = CrossSpectrumAccumulator::expecting(grid(1), 6, 480).unwrap();
        // Each window lacks another channel than the last. All lines are 1, so that products and fourth powers count windows.
        for number in 0..480 {
            let channels = (0..6).map(|channel| (channel != number % 6).then(|| vec![Complex32::ONE])).collect();
            accumulator.add(WindowLines { grid_index: number, channels }).unwrap();
            for Set { open, total, .. } in accumulator.sets.values() {
                let windows = (open.windows + total.sums.windows) as f64;
                assert_eq!([total.fourths[0], total.sums.re[0] + open.re[0]], [windows; 2]);
            }
        }
    }
}
