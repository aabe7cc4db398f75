//! The averaged cross-spectral matrix, with what its uncertainty needs.
//!
//! Windows flow in, sums of outer products grow in groups of consecutive windows (for the delete-a-group jackknife); memory
//! does not grow with the record. Channels may be silent in some windows: sums are kept by the set of channels that speak.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use num_complex::Complex64;
use thiserror::Error;

use super::{LineGrid, WindowLines};

/// Groups are merged pairwise when there would be more; so there are 12 to 24 once there are as many windows.
const MAX_GROUPS: usize = 24;
/// A channel that is sound in fewer than this share of the windows is left out.
const MIN_SOUND_SHARE: f64 = 0.5;

/// Why there is no cross-spectral matrix.
#[derive(Debug, Error, PartialEq)]
pub enum SpectraError {
    /// More channels than a set has places for.
    #[error("a setup can have 128 channels, this one has {0}")]
    TooManyChannels(usize),
    /// No window came.
    #[error("no window came: the recording is shorter than one segment")]
    NoWindows,
    /// No window is sound on the channels that are sound at all.
    #[error("no window is sound on all live channels at once: every one has gaps, clipped or constant samples")]
    NoSoundWindows,
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

/// Sums over windows in which the same channels are sound.
#[derive(Debug, Clone)]
struct Sums {
    windows: usize,
    /// Upper triangles of the outer products, line by line.
    products: Vec<Complex64>,
    /// Fourth powers of the magnitudes, line by line, channel by channel.
    fourths: Vec<f64>,
}

/// Sums cross spectra window by window.
#[derive(Debug, Clone)]
pub struct CrossSpectrumAccumulator {
    grid: LineGrid,
    channels: usize,
    windows: usize,
    windows_a_group: usize,
    groups: Vec<BTreeMap<u128, Sums>>,
}

impl CrossSpectrumAccumulator {
    /// Nothing summed yet, for a setup of `channels` channels.
    pub fn new(grid: LineGrid, channels: usize) -> Result<Self, SpectraError> {
        if channels > 128 {
            return Err(SpectraError::TooManyChannels(channels));
        }
        Ok(Self { grid, channels, windows: 0, windows_a_group: 1, groups: Vec::new() })
    }

    /// Adds a window.
    pub fn add(&mut self, window: &WindowLines) -> Result<(), SpectraError> {
        if window.channels.len() != self.channels {
            return Err(SpectraError::Shape { found: window.channels.len(), expected: self.channels });
        }
        let mut mask = 0_u128;
        let mut sound: Vec<&[num_complex::Complex32]> = Vec::with_capacity(self.channels);
        for (channel, lines) in window.channels.iter().enumerate() {
            if let Some(lines) = lines {
                if lines.len() != self.grid.lines {
                    return Err(SpectraError::Shape { found: lines.len(), expected: self.grid.lines });
                }
                mask |= 1 << channel;
                sound.push(lines);
            }
        }
        let mut group = self.windows / self.windows_a_group;
        if group == MAX_GROUPS {
            self.merge_pairs();
            group = self.windows / self.windows_a_group;
        }
        self.windows += 1;
        self.groups.resize_with(group + 1, BTreeMap::new);
        let count = sound.len();
        let sums = self.groups[group].entry(mask).or_insert_with(|| Sums {
            windows: 0,
            products: vec![Complex64::default(); self.grid.lines * triangle(count)],
            fourths: vec![0.0; self.grid.lines * count],
        });
        sums.windows += 1;
        let mut values = vec![Complex64::default(); count];
        for line in 0..self.grid.lines {
            for (value, lines) in values.iter_mut().zip(&sound) {
                *value = Complex64::new(f64::from(lines[line].re), f64::from(lines[line].im));
            }
            let fourths = &mut sums.fourths[line * count..(line + 1) * count];
            for (fourth, value) in fourths.iter_mut().zip(&values) {
                *fourth += value.norm_sqr().powi(2);
            }
            let mut products = sums.products[line * triangle(count)..(line + 1) * triangle(count)].iter_mut();
            for (row, a) in values.iter().enumerate() {
                for (b, product) in values[row..].iter().zip(products.by_ref()) {
                    *product += a * b.conj();
                }
            }
        }
        Ok(())
    }

    fn merge_pairs(&mut self) {
        self.windows_a_group *= 2;
        let mut groups = std::mem::take(&mut self.groups).into_iter();
        while let Some(mut first) = groups.next() {
            for (mask, sums) in groups.next().unwrap_or_default() {
                match first.entry(mask) {
                    std::collections::btree_map::Entry::Vacant(place) => drop(place.insert(sums)),
                    std::collections::btree_map::Entry::Occupied(mut place) => place.get_mut().add(&sums),
                }
            }
            self.groups.push(first);
        }
    }

    /// Chooses the channels that are sound in at least half of the windows and averages the windows in which all are.
    pub fn finish(self) -> Result<(CrossSpectrum, Vec<SpectraWarning>), SpectraError> {
        let windows = self.windows;
        if windows == 0 {
            return Err(SpectraError::NoWindows);
        }
        let all = || self.groups.iter().flatten();
        let mut warnings = Vec::new();
        let mut kept = Vec::new();
        for channel in 0..self.channels {
            let sound = all().filter(|(mask, _)| *mask >> channel & 1 == 1).map(|(_, sums)| sums.windows).sum();
            if sound as f64 >= MIN_SOUND_SHARE * windows as f64 {
                kept.push(channel);
            } else {
                warnings.push(SpectraWarning::ChannelLeftOut { channel, sound, windows });
            }
        }
        let wanted: u128 = kept.iter().map(|&channel| 1_u128 << channel).sum();
        let mut groups = Vec::new();
        for group in &self.groups {
            let mut merged: Option<Sums> = None;
            for (&mask, sums) in group.iter().filter(|(mask, _)| **mask & wanted == wanted) {
                let sums = sums.restricted(mask, wanted, self.grid.lines);
                match &mut merged {
                    None => merged = Some(sums),
                    Some(merged) => merged.add(&sums),
                }
            }
            groups.extend(merged);
        }
        let used: usize = groups.iter().map(|group| group.windows).sum();
        if used == 0 || kept.is_empty() {
            return Err(SpectraError::NoSoundWindows);
        }
        if used < windows {
            warnings.push(SpectraWarning::WindowsLeftOut { left_out: windows - used, windows });
        }
        let mut total = groups[0].clone();
        for group in &groups[1..] {
            total.add(group);
        }
        Ok((CrossSpectrum { grid: self.grid, kept, groups, total }, warnings))
    }
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.windows += other.windows;
        for (sum, product) in self.products.iter_mut().zip(&other.products) {
            *sum += product;
        }
        for (sum, fourth) in self.fourths.iter_mut().zip(&other.fourths) {
            *sum += fourth;
        }
    }

    /// The sums of the channels in `wanted`, which all are in `mask`.
    fn restricted(&self, mask: u128, wanted: u128, lines: usize) -> Self {
        if mask == wanted {
            return self.clone();
        }
        let places: Vec<usize> = (0..128)
            .filter(|c| mask >> c & 1 == 1)
            .enumerate()
            .filter(|(_, c)| wanted >> c & 1 == 1)
            .map(|(p, _)| p)
            .collect();
        let count = mask.count_ones() as usize;
        let mut products = Vec::with_capacity(lines * triangle(places.len()));
        let mut fourths = Vec::with_capacity(lines * places.len());
        for line in 0..lines {
            for (i, &a) in places.iter().enumerate() {
                fourths.push(self.fourths[line * count + a]);
                products
                    .extend(places[i..].iter().map(|&b| self.products[line * triangle(count) + packed(count, a, b)]));
            }
        }
        Self { windows: self.windows, products, fourths }
    }
}

const fn triangle(count: usize) -> usize {
    count * (count + 1) / 2
}

/// Place of element (`row`, `column`), `row <= column`, in a packed upper triangle.
const fn packed(count: usize, row: usize, column: usize) -> usize {
    row * count - row * (row + 1) / 2 + column
}

/// Averaged cross-spectral matrices of one setup.
#[derive(Debug, Clone)]
pub struct CrossSpectrum {
    grid: LineGrid,
    kept: Vec<usize>,
    groups: Vec<Sums>,
    total: Sums,
}

impl CrossSpectrum {
    /// The lines.
    pub fn grid(&self) -> &LineGrid {
        &self.grid
    }

    /// The channels used, as indices in the setup's channel order; rows and columns of the matrices stand in this order.
    pub fn channels(&self) -> &[usize] {
        &self.kept
    }

    /// Windows averaged.
    pub fn averages(&self) -> usize {
        self.total.windows
    }

    /// Groups of consecutive windows.
    pub fn group_count(&self) -> usize {
        self.groups.len()
    }

    /// The matrix G of a line in (m/s²)²/Hz: `G[(i, j)]` = mean of `X_i X_j*`, Hermitian.
    pub fn matrix(&self, line: usize) -> DMatrix<Complex64> {
        self.unpack(line, &self.total, None)
    }

    /// The matrix of a line without the windows of one group.
    pub fn matrix_without(&self, group: usize, line: usize) -> DMatrix<Complex64> {
        self.unpack(line, &self.total, self.groups.get(group))
    }

    fn unpack(&self, line: usize, total: &Sums, without: Option<&Sums>) -> DMatrix<Complex64> {
        let count = self.kept.len();
        let windows = (total.windows - without.map_or(0, |sums| sums.windows)).max(1) as f64;
        let from = line * triangle(count);
        let value = |place: usize| {
            let minus = without.map_or(Complex64::default(), |sums| sums.products[from + place]);
            (total.products[from + place] - minus) / windows
        };
        DMatrix::from_fn(count, count, |row, column| {
            if row <= column { value(packed(count, row, column)) } else { value(packed(count, column, row)).conj() }
        })
    }

    /// Kurtosis of the band-passed response at a line, by channel: 3 for noise and modes, 1.5 for a steady harmonic.
    ///
    /// From the complex lines: 1.5 <|X|^4> / <|X|^2>^2 (spectral kurtosis; Antoni 2006, eq. 6, for the real signal).
    pub fn kurtosis(&self, line: usize) -> Vec<f64> {
        let count = self.kept.len();
        let windows = self.total.windows as f64;
        (0..count)
            .map(|channel| {
                let square = self.total.products[line * triangle(count) + packed(count, channel, channel)].re / windows;
                1.5 * self.total.fourths[line * count + channel] / windows / (square * square)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex32;

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
            accumulator.add(&window(number, 4, 3, |_| true)).unwrap();
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
                    assert!((part[(i, j)] - mean_product(&without_second, i, j, line)).norm() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_dead_channel_is_left_out_and_windows_with_a_gap_too() {
        let mut accumulator = CrossSpectrumAccumulator::new(grid(2), 4).unwrap();
        for number in 0..40 {
            accumulator
                .add(&window(number, 4, 2, |channel| channel != 1 && !(channel == 3 && number % 10 == 0)))
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
    fn nothing_sound_is_an_error_not_a_matrix_of_zeros() {
        let empty = CrossSpectrumAccumulator::new(grid(2), 2).unwrap();
        assert_eq!(empty.finish().unwrap_err(), SpectraError::NoWindows);
        let mut silent = CrossSpectrumAccumulator::new(grid(2), 2).unwrap();
        for number in 0..10 {
            silent.add(&window(number, 2, 2, |channel| channel == number % 2)).unwrap();
        }
        assert_eq!(silent.finish().unwrap_err(), SpectraError::NoSoundWindows);
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
            accumulator.add(&WindowLines { grid_index: number, channels }).unwrap();
        }
        let (spectrum, _) = accumulator.finish().unwrap();
        let kurtosis = spectrum.kurtosis(0);
        assert!((kurtosis[0] - 1.5).abs() < 1e-5);
        // Standard deviation of <|X|^4>/<|X|^2>^2 over 4000 draws is sqrt(4/4000) = 0.03, times 1.5.
        assert!((kurtosis[1] - 3.0).abs() < 0.2, "{kurtosis:?}");
    }
}
