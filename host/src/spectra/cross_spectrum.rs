//! The averaged cross-spectral matrix of one setup, with what its uncertainty needs.
//!
//! Sums of outer products flow in from the accumulator; matrices line by line, with or without one group of windows, and the
//! kurtosis of each channel flow out.

use std::ops::Range;

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::finer::{FinerSpectrum, KeptWindows};
use super::grid::{LineGrid, around};
use super::sums::{BAND_HALVES, ChannelSubset, MOMENTS, Sums, Total, packed, triangle};

/// Averaged cross-spectral matrices of one setup.
#[derive(Debug, Clone)]
pub struct CrossSpectrum {
    pub(super) grid: LineGrid,
    /// The channels used, as indices in the setup's channel order.
    pub(super) kept: Vec<usize>,
    /// Sums of groups of consecutive windows.
    pub(super) groups: Vec<Sums<f32>>,
    pub(super) total: Total,
    /// The windows of all channels, sound or not, where they are not too many.
    pub(super) windows: Option<KeptWindows>,
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

    /// The same averages of some of the channels alone; `wanted` as in [`CrossSpectrum::channels`], others are ignored.
    pub fn restricted(self, wanted: &[usize]) -> Self {
        let kept: Vec<usize> = (0..self.kept.len()).filter(|&index| wanted.contains(&self.kept[index])).collect();
        let subset = ChannelSubset { count: self.kept.len(), wanted: kept };
        let lines = self.grid.lines;
        Self {
            grid: self.grid,
            kept: subset.wanted.iter().map(|&index| self.kept[index]).collect(),
            groups: self.groups.into_iter().map(|group| group.restricted(&subset, lines)).collect(),
            total: self.total.restricted(&subset, lines),
            windows: self.windows,
        }
    }

    /// The same channels in lines up to `most` times as fine: as fine as leaves `least_windows`; and how many times finer they are. `None`
    /// where that is no finer, or the record too long for its windows to be kept.
    pub(crate) fn finer(&self, most: usize, least_windows: usize) -> Option<(FinerSpectrum, usize)> {
        self.windows.as_ref()?.finest(&self.kept, most, least_windows)
    }

    /// The same averages without some of the channels.
    pub fn without_channels(self, unwanted: &[usize]) -> Self {
        let wanted: Vec<usize> = self.kept.iter().copied().filter(|channel| !unwanted.contains(channel)).collect();
        if wanted.len() == self.kept.len() { self } else { self.restricted(&wanted) }
    }

    /// Windows averaged.
    pub fn averages(&self) -> usize {
        self.total.sums.windows
    }

    /// Groups of consecutive windows.
    pub fn group_count(&self) -> usize {
        self.groups.len()
    }

    /// The matrix G of a line in (m/s²)²/Hz: `G[(i, j)]` = mean of `X_i X_j*`, Hermitian.
    pub fn matrix(&self, line: usize) -> DMatrix<Complex64> {
        self.unpack(line, self.averages(), |_| Complex64::ZERO)
    }

    /// The sum of the channels' densities at a line: the trace of [`CrossSpectrum::matrix`].
    pub fn power(&self, line: usize) -> f64 {
        (0..self.kept.len()).map(|channel| self.density(line, channel)).sum()
    }

    /// The matrix of a line without the windows of one group.
    pub fn matrix_without(&self, group: usize, line: usize) -> DMatrix<Complex64> {
        let group = &self.groups[group];
        let part = |place: usize| Complex64::new(f64::from(group.re[place]), f64::from(group.im[place]));
        self.unpack(line, (self.averages() - group.windows).max(1), part)
    }

    /// The weighted sum of the matrices of consecutive lines; without the windows of one group, where one is named.
    pub(crate) fn weighted_sum(&self, first: usize, weights: &[f64], without: Option<usize>) -> DMatrix<Complex64> {
        let count = self.kept.len();
        let size = triangle(count);
        let group = without.map(|group| &self.groups[group]);
        let windows = (self.averages() - group.map_or(0, |group| group.windows)).max(1) as f64;
        let total = &self.total.sums;
        let (mut re, mut im) = (vec![0.0; size], vec![0.0; size]);
        for (line, weight) in (first..).zip(weights) {
            let (places, weight) = (line * size..(line + 1) * size, weight / windows);
            add(&mut re, &total.re[places.clone()], weight);
            add(&mut im, &total.im[places.clone()], weight);
            if let Some(group) = group {
                add(&mut re, &group.re[places.clone()], -weight);
                add(&mut im, &group.im[places], -weight);
            }
        }
        hermitian(count, |place| Complex64::new(re[place], im[place]))
    }

    fn unpack(&self, line: usize, windows: usize, minus: impl Fn(usize) -> Complex64) -> DMatrix<Complex64> {
        let count = self.kept.len();
        let from = line * triangle(count);
        let sums = &self.total.sums;
        hermitian(count, |place| {
            (Complex64::new(sums.re[from + place], sums.im[from + place]) - minus(from + place)) / windows as f64
        })
    }

    /// A channel's density at a line.
    pub fn density(&self, line: usize, channel: usize) -> f64 {
        let count = self.kept.len();
        self.total.sums.re[line * triangle(count) + packed(count, channel, channel)] / self.averages() as f64
    }

    /// Windows of each group, one after another, and a channel's power in a band of lines in them.
    pub(crate) fn power_by_group(&self, band: Range<usize>, channel: usize) -> Vec<(usize, f64)> {
        let count = self.kept.len();
        let place = |line: usize| line * triangle(count) + packed(count, channel, channel);
        let power = |group: &Sums<f32>| band.clone().map(|line| f64::from(group.re[place(line)])).sum::<f64>();
        self.groups.iter().map(|group| (group.windows, power(group) / group.windows.max(1) as f64)).collect()
    }

    /// How much a channel's power in the band of `BAND_HALVES[width]` lines to either side of a line varies from window to window:
    /// its relative variance, and what noise of the same spectrum has at least.
    ///
    /// The lines of a band are the more correlated the narrower the peaks in it, and the least where it is flat, as the Hann window
    /// joins them. A mode has more than that, and a force of constant size, whose frequency may wander within the band, next
    /// to nothing.
    pub(crate) fn variation(&self, line: usize, channel: usize, width: usize) -> [f64; 2] {
        /// Correlation of lines of white noise under Hann's window, by their distance.
        const JOINED: [f64; 3] = [1.0, 2.0 / 3.0, 1.0 / 6.0];
        let band = around(line, BAND_HALVES[width], self.grid.lines);
        let densities: Vec<f64> = band.map(|line| self.density(line, channel)).collect();
        let power: f64 = densities.iter().sum();
        let mean_square =
            self.total.bands[width][channel * self.grid.lines + line] / (self.averages() as f64 * power * power);
        let of_noise: f64 = (0..densities.len())
            .flat_map(|a| (0..densities.len()).map(move |b| (a, b)))
            .filter_map(|(a, b)| Some(densities[a] * densities[b] * JOINED.get(a.abs_diff(b))?.powi(2)))
            .sum();
        [mean_square - 1.0, of_noise / (power * power)]
    }

    /// The envelope of a channel in a narrow band about a line, as it goes through the windows: <P^3> <P> / <P^2>^2 of its power P, and
    /// <P>^2 / <P^2>.
    ///
    /// Whatever is Gaussian, noise or the response of a mode, has an envelope with the distribution of Rayleigh, whose values are 3/2
    /// and 1/2; with loads that come and go the first is larger. A force that is either there or not has 1, and the second is the
    /// share of the time that it is there.
    pub(crate) fn envelope(&self, line: usize, channel: usize) -> [f64; 2] {
        let place = channel * self.grid.lines + line;
        let samples = (self.averages() * MOMENTS.len()) as f64;
        let [first, second, third] = [0, 1, 2].map(|order: usize| self.total.envelope[order][place] / samples);
        [third * first / (second * second), first * first / second]
    }

    /// Kurtosis of the band-passed response at a line, by channel: 3 for noise and modes, 1.5 for a steady harmonic.
    ///
    /// From the complex lines: 1.5 <|X|^4> / <|X|^2>^2 (spectral kurtosis; Antoni 2006, eq. 6, for the real signal).
    pub fn kurtosis(&self, line: usize) -> Vec<f64> {
        let count = self.kept.len();
        let windows = self.averages() as f64;
        (0..count)
            .map(|channel| {
                let power = self.density(line, channel);
                1.5 * self.total.fourths[line * count + channel] / windows / (power * power)
            })
            .collect()
    }
}

fn add<T: Copy + Into<f64>>(sums: &mut [f64], parts: &[T], weight: f64) {
    sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += weight * (*part).into());
}

/// The Hermitian matrix of a packed upper triangle.
pub(super) fn hermitian(count: usize, value: impl Fn(usize) -> Complex64) -> DMatrix<Complex64> {
    let mut matrix = DMatrix::zeros(count, count);
    let mut place = 0;
    for row in 0..count {
        for column in row..count {
            let value = value(place);
            matrix[(row, column)] = value;
            matrix[(column, row)] = value.conj();
            place += 1;
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::spectra::CrossSpectrumAccumulator;
    use crate::spectra::direct::Welch;

    const GRID: LineGrid = LineGrid { sampling_rate_hz: 1.0, segment: 256, first_line: 10, lines: 100 };
    /// A line of `GRID`, in cycles a sample.
    const LINE_HZ: f64 = 60.0 / 256.0;

    /// The spectrum of a channel that `sample` makes of noise, row by row.
    fn spectrum(mut sample: impl FnMut(usize, f64) -> f64) -> CrossSpectrum {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut welch = Welch::new(GRID, 1, 1).unwrap();
        let mut accumulator = CrossSpectrumAccumulator::new(GRID, 1).unwrap();
        for row in 0..30_000 {
            let noise: f64 = (0..6).map(|_| random.random_range(-1.0..1.0)).sum();
            welch.push(&[sample(row, noise)], &mut |window| accumulator.add(window).unwrap());
        }
        accumulator.finish().unwrap().0
    }

    /// Noise and a tone at line 50: its frequency off by what `wanders` says of each sample, there where `is_on`.
    fn noise_and_tone(size: f64, wanders: impl Fn(usize) -> f64, is_on: impl Fn(usize) -> bool) -> CrossSpectrum {
        let mut phase = 0.0;
        spectrum(|row, noise| {
            phase += TAU * (LINE_HZ + wanders(row));
            noise + if is_on(row) { size * phase.sin() } else { 0.0 }
        })
    }

    #[test]
    fn the_power_of_noise_in_a_band_varies_by_no_less_than_its_least_and_that_of_a_wandering_tone_hardly() {
        let noise = noise_and_tone(0.0, |_| 0.0, |_| true);
        for (width, half) in BAND_HALVES.into_iter().enumerate() {
            let [variation, least] = noise.variation(50, 0, width);
            assert!((0.7..1.5).contains(&(variation / least)), "{width}: {variation} {least}");
            // Independent lines would have one over their number.
            assert!(least > 1.5 / (2 * half + 1) as f64);
        }
        let wanders = |row: usize| 2.5 / 256.0 * (row as f64 / 700.0).sin();
        let tone = noise_and_tone(5.0, wanders, |_| true);
        let [variation, least] = tone.variation(50, 0, 1);
        assert!(variation < 0.3 * least, "{variation} {least}");
        assert!(tone.kurtosis(50)[0] > 2.2, "a line alone does not show it: {:?}", tone.kurtosis(50));
    }

    #[test]
    fn the_envelope_of_noise_is_that_of_rayleigh_and_a_tones_that_goes_on_and_off_is_flat() {
        let noise = noise_and_tone(0.0, |_| 0.0, |_| true);
        let [flat, share] = noise.envelope(50, 0);
        assert!((flat - 1.5).abs() < 0.1 && (share - 0.5).abs() < 0.05, "{flat} {share}");
        let [flat, share] = noise_and_tone(5.0, |_| 0.0, |_| true).envelope(50, 0);
        assert!((flat - 1.0).abs() < 0.05 && (share - 1.0).abs() < 0.1, "{flat} {share}");
        let [flat, share] = noise_and_tone(5.0, |_| 0.0, |row| row % 1500 < 500).envelope(50, 0);
        assert!(flat < 1.15 && (share - 1.0 / 3.0).abs() < 0.05, "{flat} {share}");
        // Loads that come and go are no tone.
        let gusts = spectrum(|row, noise| if row % 1500 < 500 { 3.0 * noise } else { noise });
        let [flat, _] = gusts.envelope(50, 0);
        assert!(flat > 1.4, "{flat}");
    }

    /// The spectrum of some of three channels about the tones' line.
    fn spectrum_of(channels: &[usize], rows: &[[f64; 3]]) -> CrossSpectrum {
        let grid = LineGrid { first_line: 54, lines: 13, ..GRID };
        let mut welch = Welch::new(grid, 1, channels.len()).unwrap();
        let mut accumulator = CrossSpectrumAccumulator::new(grid, channels.len()).unwrap();
        for row in rows {
            let values: Vec<f64> = channels.iter().map(|&channel| row[channel]).collect();
            welch.push(&values, &mut |window| accumulator.add(window).unwrap());
        }
        accumulator.finish().unwrap().0
    }

    /// Compares each channel with a spectrum of its own.
    fn compare_with_channels_alone(spectrum: &CrossSpectrum, rows: &[[f64; 3]]) {
        for (place, &channel) in spectrum.channels().iter().enumerate() {
            let alone = spectrum_of(&[channel], rows);
            assert_eq!(spectrum.averages(), alone.averages());
            for line in 0..spectrum.grid().lines {
                let mut pairs = vec![
                    [spectrum.envelope(line, place), alone.envelope(line, 0)],
                    [[spectrum.kurtosis(line)[place], 0.0], [alone.kurtosis(line)[0], 0.0]],
                    [[spectrum.density(line, place), 0.0], [alone.density(line, 0), 0.0]],
                ];
                pairs.extend(
                    (0..3).map(|width| [spectrum.variation(line, place, width), alone.variation(line, 0, width)]),
                );
                for [[a, b], [c, d]] in pairs {
                    assert!((a - c).abs() < 1e-9 * (1.0 + c.abs()), "line {line}, channel {channel}: {a} {c}");
                    assert!((b - d).abs() < 1e-9 * (1.0 + d.abs()), "line {line}, channel {channel}: {b} {d}");
                }
            }
        }
    }

    #[test]
    fn a_channel_among_others_has_the_variation_and_envelope_that_it_has_alone() {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        // A steady tone at the middle line, one that wanders, and one two lines higher that goes on and off.
        let mut rows: Vec<[f64; 3]> = (0..20_000)
            .map(|row| {
                let time = row as f64;
                let steady = 5.0 * (TAU * LINE_HZ * time).sin();
                let wandering = 2.0 * (TAU * LINE_HZ * time + 7.0 * (time / 700.0).sin()).sin();
                let on_and_off = if row % 1500 < 500 { (TAU * (LINE_HZ + 2.0 / 256.0) * time).sin() } else { 0.0 };
                [steady, wandering, 3.0 * on_and_off].map(|tone| tone + random.random_range(-1.0..1.0))
            })
            .collect();
        let whole = spectrum_of(&[0, 1, 2], &rows);
        assert_eq!(whole.channels(), [0, 1, 2]);
        assert!((whole.envelope(6, 0)[1] - whole.envelope(6, 2)[1]).abs() > 0.2);
        compare_with_channels_alone(&whole, &rows);
        let some = whole.restricted(&[2, 0]);
        assert_eq!(some.channels(), [0, 2]);
        compare_with_channels_alone(&some, &rows);
        // A channel that comes late is left out: of some windows there are sums with it, of others without.
        rows[..12_000].iter_mut().for_each(|row| row[1] = f64::NAN);
        let late = spectrum_of(&[0, 1, 2], &rows);
        assert_eq!(late.channels(), [0, 2]);
        compare_with_channels_alone(&late, &rows);
    }
}
