//! Sums of outer products over windows, as packed upper triangles, and what of them some channels make.
//!
//! Windows of the same sound channels flow in; sums over them, in double precision for the average and in single precision for
//! the jackknife, flow out.

use std::f64::consts::TAU;
use std::ops::AddAssign;

use num_complex::{Complex32, Complex64};

use super::grid::around;

/// Sums over windows in which the same channels are sound: upper triangles of the outer products, line by line. Real and
/// imaginary parts lie apart, so that a row of a triangle is summed as one vector.
#[derive(Debug, Clone)]
pub(super) struct Sums<T> {
    pub(super) windows: usize,
    pub(super) re: Vec<T>,
    pub(super) im: Vec<T>,
}

/// Lines to either side of a line that belong to a band.
pub(crate) const BAND_HALVES: [usize; 3] = [2, 4, 8];

/// The same for the envelope in a band.
pub(crate) const ENVELOPE_HALF: usize = 4;
/// The moments of a window at which it is taken, as shares of its length: those of windows at half overlap follow each other.
pub(super) const MOMENTS: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.7];

/// The averages' own sums, and the fourth powers of the magnitudes, line by line, channel by channel.
#[derive(Debug, Clone)]
pub(super) struct Total {
    pub(super) sums: Sums<f64>,
    pub(super) fourths: Vec<f64>,
    /// The squares of the powers in bands about each line, by half-width as in [`BAND_HALVES`], line by line, channel by channel.
    pub(super) bands: [Vec<f64>; BAND_HALVES.len()],
    /// The first three moments of the power at some moments of a window, of the band of [`ENVELOPE_HALF`] lines to either side of
    /// each line, line by line, channel by channel; sums.
    pub(super) envelope: [Vec<f64>; 3],
    /// Windows of the set, and the rank of the set that it replaced.
    pub(super) rank: usize,
}

/// Adds the outer products of some windows (all of `count` channels) to `sums`, and their fourth powers to `fourths`.
#[inline(always)]
pub(super) fn add_outer_products(
    windows: &[(u128, Vec<Vec<Complex32>>)],
    count: usize,
    lines: usize,
    sums: &mut Sums<f64>,
    fourths: &mut [f64],
) {
    let (mut re, mut im) = (vec![0.0; count], vec![0.0; count]);
    for line in 0..lines {
        let triangles = line * triangle(count)..(line + 1) * triangle(count);
        let fourths = &mut fourths[line * count..(line + 1) * count];
        for (_, channels) in windows {
            for (channel, values) in channels.iter().enumerate() {
                (re[channel], im[channel]) = (f64::from(values[line].re), f64::from(values[line].im));
            }
            for (fourth, (re, im)) in fourths.iter_mut().zip(re.iter().zip(&im)) {
                let square = re * re + im * im;
                *fourth += square * square;
            }
            let (mut sums_re, mut sums_im) = (&mut sums.re[triangles.clone()], &mut sums.im[triangles.clone()]);
            for row in 0..count {
                let (row_re, rest_re) = sums_re.split_at_mut(count - row);
                let (row_im, rest_im) = sums_im.split_at_mut(count - row);
                let (a_re, a_im) = (re[row], im[row]);
                let others = re[row..].iter().zip(&im[row..]);
                for ((sum_re, sum_im), (b_re, b_im)) in row_re.iter_mut().zip(row_im).zip(others) {
                    *sum_re += a_re * b_re + a_im * b_im;
                    *sum_im += a_im * b_re - a_re * b_im;
                }
                (sums_re, sums_im) = (rest_re, rest_im);
            }
        }
    }
}

impl Total {
    pub(super) fn zero(lines: usize, count: usize, rank: usize) -> Self {
        Self {
            sums: Sums::zero(lines * triangle(count)),
            fourths: vec![0.0; lines * count],
            bands: std::array::from_fn(|_| vec![0.0; lines * count]),
            envelope: std::array::from_fn(|_| vec![0.0; lines * count]),
            rank,
        }
    }

    /// Adds the squares of some windows' powers in bands.
    pub(super) fn add_bands(&mut self, windows: &[(u128, Vec<Vec<Complex32>>)], count: usize, lines: usize) {
        // Of all lines below one.
        let mut below = vec![0.0; lines + 1];
        let mut squares = vec![[0.0; BAND_HALVES.len()]; lines];
        for channel in 0..count {
            squares.fill([0.0; BAND_HALVES.len()]);
            for (_, channels) in windows {
                for (line, value) in channels[channel].iter().enumerate() {
                    below[line + 1] = below[line] + f64::from(value.norm_sqr());
                }
                for (line, squares) in squares.iter_mut().enumerate() {
                    for (half, square) in BAND_HALVES.into_iter().zip(squares) {
                        let band = around(line, half, lines);
                        *square += (below[band.end] - below[band.start]).powi(2);
                    }
                }
            }
            add_channel(&mut self.bands, &squares, channel, count);
        }
    }

    /// Adds the moments of some windows' envelopes.
    pub(super) fn add_envelopes(&mut self, windows: &[(u128, Vec<Vec<Complex32>>)], count: usize, lines: usize) {
        // Lines that the band does not reach are zero.
        let mut values = vec![Complex64::ZERO; lines + 2 * ENVELOPE_HALF + 1];
        let mut moments = vec![[0.0; 3]; lines];
        for channel in 0..count {
            moments.fill([0.0; 3]);
            for (_, channels) in windows {
                for (value, line) in values[ENVELOPE_HALF..].iter_mut().zip(&channels[channel]) {
                    *value = Complex64::new(line.re.into(), line.im.into());
                }
                for moment in MOMENTS {
                    add_envelope(&values, moment, &mut moments);
                }
            }
            add_channel(&mut self.envelope, &moments, channel, count);
        }
    }

    /// Adds the sums of another part of the same channels.
    pub(super) fn add(&mut self, part: &Self) {
        let add = |sums: &mut [f64], parts: &[f64]| sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
        self.sums.add(&part.sums);
        add(&mut self.fourths, &part.fourths);
        self.bands.iter_mut().zip(&part.bands).for_each(|(bands, part)| add(bands, part));
        self.envelope.iter_mut().zip(&part.envelope).for_each(|(moments, part)| add(moments, part));
    }

    /// The same of the wanted channels alone.
    pub(super) fn restricted(self, subset: &ChannelSubset, lines: usize) -> Self {
        Self {
            sums: self.sums.restricted(subset, lines),
            fourths: subset.restricted_channels(self.fourths, lines),
            bands: self.bands.map(|band| subset.restricted_channels(band, lines)),
            envelope: self.envelope.map(|moments| subset.restricted_channels(moments, lines)),
            rank: self.rank,
        }
    }
}

/// Adds the moments of the envelope about each line at a moment of a window; `values` has [`ENVELOPE_HALF`] zeros before the first
/// line, and one more after the last.
fn add_envelope(values: &[Complex64], moment: f64, moments: &mut [[f64; 3]]) {
    let turns = |lines: f64| Complex64::cis(TAU * moment * lines);
    let (back, ahead, behind) = (turns(-1.0), turns(ENVELOPE_HALF as f64), turns(-(ENVELOPE_HALF as f64) - 1.0));
    // The window's own weight at this moment.
    let weight = (std::f64::consts::PI * moment).sin().powi(-4);
    // The sum over the band, each line turned by its distance from the band's middle; from line to line one comes and one goes.
    let first = values.iter().take(2 * ENVELOPE_HALF + 1).enumerate();
    let mut sum: Complex64 = first.map(|(line, value)| value * turns(line as f64 - ENVELOPE_HALF as f64)).sum();
    let moving = values.iter().zip(&values[2 * ENVELOPE_HALF + 1..]);
    for ([first, second, third], (gone, new)) in moments.iter_mut().zip(moving) {
        let power = weight * sum.norm_sqr();
        *first += power;
        *second += power * power;
        *third += power * power * power;
        sum = sum * back - gone * behind + new * ahead;
    }
}

/// Adds what a channel has at each line.
fn add_channel<const KINDS: usize>(
    sums: &mut [Vec<f64>; KINDS],
    values: &[[f64; KINDS]],
    channel: usize,
    count: usize,
) {
    for (line, values) in values.iter().enumerate() {
        for (sums, value) in sums.iter_mut().zip(values) {
            sums[line * count + channel] += value;
        }
    }
}

impl<T: Copy + Default + AddAssign> Sums<T> {
    pub(super) fn zero(length: usize) -> Self {
        Self { windows: 0, re: vec![T::default(); length], im: vec![T::default(); length] }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.windows += other.windows;
        self.re.iter_mut().zip(&other.re).for_each(|(sum, part)| *sum += *part);
        self.im.iter_mut().zip(&other.im).for_each(|(sum, part)| *sum += *part);
    }

    /// The sums of the wanted channels alone.
    pub(super) fn restricted(self, subset: &ChannelSubset, lines: usize) -> Self {
        if subset.are_all() {
            return self;
        }
        let mut some = Self { windows: self.windows, re: Vec::new(), im: Vec::new() };
        for line in 0..lines {
            let from = line * triangle(subset.count);
            for (i, &a) in subset.wanted.iter().enumerate() {
                for &b in &subset.wanted[i..] {
                    let place = from + packed(subset.count, a, b);
                    some.re.push(self.re[place]);
                    some.im.push(self.im[place]);
                }
            }
        }
        some
    }
}

impl Sums<f64> {
    pub(super) fn narrowed(&self) -> Sums<f32> {
        let narrow = |values: &[f64]| values.iter().map(|&value| value as f32).collect();
        Sums { windows: self.windows, re: narrow(&self.re), im: narrow(&self.im) }
    }
}

/// Some wanted channels among those of a set.
pub(super) struct ChannelSubset {
    /// Channels of the set.
    pub(super) count: usize,
    /// Indices of the wanted ones in the set, ascending.
    pub(super) wanted: Vec<usize>,
}

impl ChannelSubset {
    /// The `wanted` channels, which all are in `mask`.
    pub(super) fn new(mask: u128, wanted: u128) -> Self {
        let in_mask = (0..u128::BITS).filter(|channel| mask >> channel & 1 == 1);
        let wanted = in_mask.enumerate().filter(|(_, channel)| wanted >> channel & 1 == 1).map(|(place, _)| place);
        Self { count: mask.count_ones() as usize, wanted: wanted.collect() }
    }

    fn are_all(&self) -> bool {
        self.wanted.len() == self.count
    }

    pub(super) fn restricted_channels(&self, values: Vec<f64>, lines: usize) -> Vec<f64> {
        if self.are_all() {
            return values;
        }
        (0..lines)
            .flat_map(|line| self.wanted.iter().map(move |place| line * self.count + place))
            .map(|at| values[at])
            .collect()
    }
}

pub(super) const fn triangle(count: usize) -> usize {
    count * (count + 1) / 2
}

/// Place of element (`row`, `column`), `row <= column`, in a packed upper triangle.
pub(super) const fn packed(count: usize, row: usize, column: usize) -> usize {
    row * count - row * (row + 1) / 2 + column
}
