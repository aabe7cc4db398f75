//! Sums of outer products over windows, as packed upper triangles, and what of them some channels make.
//!
//! Windows of the same sound channels flow in; sums over them, in double precision for the average and in single precision for
//! the jackknife, flow out.

use std::f64::consts::TAU;
use std::ops::AddAssign;

use num_complex::Complex32;

use crate::processor::{Arithmetic, loaded, store};

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
    /// The squares of the powers in bands about each line, by half-width as in [`BAND_HALVES`], channel by channel, line by line.
    pub(super) bands: [Vec<f64>; BAND_HALVES.len()],
    /// The first three moments of the power at some moments of a window, of the band of [`ENVELOPE_HALF`] lines to either side of
    /// each line, channel by channel, line by line; sums.
    pub(super) envelope: [Vec<f64>; 3],
}

/// Lines or columns that are worked out at once.
const LANES: usize = 8;

/// Adds the outer products of some windows (all of `count` channels) to `sums`, and their fourth powers to `fourths`.
#[inline(always)]
pub(super) fn add_outer_products(
    arithmetic: Arithmetic,
    windows: &[(u128, Vec<Vec<Complex32>>)],
    count: usize,
    lines: usize,
    sums: &mut Sums<f64>,
    fourths: &mut [f64],
) {
    // A line's values, window by window, and its triangle, both with room for what the last lanes have too many.
    let wide = count + LANES;
    let (mut re, mut im) = (vec![0.0; windows.len() * wide], vec![0.0; windows.len() * wide]);
    let size = triangle(count);
    let (mut sum_re, mut sum_im) = (vec![0.0; size + LANES], vec![0.0; size + LANES]);
    for line in 0..lines {
        let fourths = &mut fourths[line * count..(line + 1) * count];
        for window in 0..windows.len() {
            for channel in 0..count {
                let value = windows[window].1[channel][line];
                let (value_re, value_im) = (f64::from(value.re), f64::from(value.im));
                let square = value_re * value_re + value_im * value_im;
                fourths[channel] += square * square;
                (re[window * wide + channel], im[window * wide + channel]) = (value_re, value_im);
            }
        }
        let mut first = 0;
        for row in 0..count {
            let mut column = row;
            while column < count {
                let (mut part_re, mut part_im) = ([0.0; LANES], [0.0; LANES]);
                for window in 0..windows.len() {
                    let (own, others) = (window * wide + row, window * wide + column);
                    let (a_re, a_im) = (re[own], im[own]);
                    let (b_re, b_im) = (loaded::<f64, LANES>(&re, others), loaded::<f64, LANES>(&im, others));
                    for lane in 0..LANES {
                        let more_re = arithmetic.multiply_add(a_re, b_re[lane], part_re[lane]);
                        part_re[lane] = arithmetic.multiply_add(a_im, b_im[lane], more_re);
                        let more_im = arithmetic.multiply_add(a_im, b_re[lane], part_im[lane]);
                        part_im[lane] = arithmetic.multiply_add(-a_re, b_im[lane], more_im);
                    }
                }
                // What the last lanes have too many the next row writes over.
                store(&mut sum_re, first + column - row, &part_re);
                store(&mut sum_im, first + column - row, &part_im);
                column += LANES;
            }
            first += count - row;
        }
        let (re, im) = (&mut sums.re[line * size..(line + 1) * size], &mut sums.im[line * size..(line + 1) * size]);
        for place in 0..size {
            re[place] += sum_re[place];
            im[place] += sum_im[place];
        }
    }
}

impl Total {
    pub(super) fn zero(lines: usize, count: usize) -> Self {
        Self {
            sums: Sums::zero(lines * triangle(count)),
            fourths: vec![0.0; lines * count],
            bands: std::array::from_fn(|_| vec![0.0; lines * count]),
            envelope: std::array::from_fn(|_| vec![0.0; lines * count]),
        }
    }

    /// Adds the squares of some windows' powers in bands.
    #[inline(always)]
    pub(super) fn add_bands(&mut self, windows: &[(u128, Vec<Vec<Complex32>>)], count: usize, lines: usize) {
        const WIDEST: usize = BAND_HALVES[BAND_HALVES.len() - 1];
        // Of all lines below one; beyond the ends nothing is added.
        let mut below = vec![0.0; lines + 1 + 2 * WIDEST];
        for channel in 0..count {
            for (_, channels) in windows {
                let values = &channels[channel][..lines];
                let mut sum = 0.0;
                for line in 0..lines {
                    sum += f64::from(values[line].norm_sqr());
                    below[WIDEST + line + 1] = sum;
                }
                below[WIDEST + lines + 1..].fill(sum);
                for (half, squares) in BAND_HALVES.into_iter().zip(&mut self.bands) {
                    let squares = &mut squares[channel * lines..(channel + 1) * lines];
                    let (from, to) = (&below[WIDEST - half..][..lines], &below[WIDEST + half + 1..][..lines]);
                    for line in 0..lines {
                        let power = to[line] - from[line];
                        squares[line] += power * power;
                    }
                }
            }
        }
    }

    /// Adds the moments of some windows' envelopes.
    #[inline(always)]
    pub(super) fn add_envelopes(
        &mut self,
        arithmetic: Arithmetic,
        windows: &[(u128, Vec<Vec<Complex32>>)],
        count: usize,
        lines: usize,
    ) {
        let turns = MOMENTS.map(EnvelopeTurns::at);
        // Lines that the band does not reach are zero.
        let wide = lines.next_multiple_of(LANES);
        let length = wide + 2 * ENVELOPE_HALF;
        let (mut re, mut im) = (vec![0.0; length], vec![0.0; length]);
        let mut moments: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; wide]);
        for channel in 0..count {
            moments.iter_mut().for_each(|moments| moments.fill(0.0));
            for (_, channels) in windows {
                let values = &channels[channel][..lines];
                for line in 0..lines {
                    re[ENVELOPE_HALF + line] = f64::from(values[line].re);
                    im[ENVELOPE_HALF + line] = f64::from(values[line].im);
                }
                let mut line = 0;
                while line < wide {
                    add_envelope(arithmetic, &re, &im, &turns, line, &mut moments);
                    line += LANES;
                }
            }
            for (sums, moments) in self.envelope.iter_mut().zip(&moments) {
                let sums = &mut sums[channel * lines..(channel + 1) * lines];
                sums.iter_mut().zip(moments).for_each(|(sum, moment)| *sum += moment);
            }
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
            bands: self.bands.map(|band| subset.restricted_rows(band, lines)),
            envelope: self.envelope.map(|moments| subset.restricted_rows(moments, lines)),
        }
    }
}

/// By how much the lines beside one turn, up to the moment of a window at which the envelope is taken.
#[derive(Clone, Copy)]
struct EnvelopeTurns {
    /// Cosine and sine for the lines 1, 2, ... above.
    turns: [[f64; 2]; ENVELOPE_HALF],
    /// What makes up for the window's own weight at this moment.
    weight: f64,
}

impl EnvelopeTurns {
    fn at(moment: f64) -> Self {
        let turn = |line: usize| {
            let (sine, cosine) = (TAU * moment * (line + 1) as f64).sin_cos();
            [cosine, sine]
        };
        Self { turns: std::array::from_fn(turn), weight: (std::f64::consts::PI * moment).sin().powi(-4) }
    }
}

/// Adds the moments of the envelope about each of [`LANES`] lines from `first` on; `re` and `im` have [`ENVELOPE_HALF`] zeros before
/// the first line and after the last.
#[inline(always)]
fn add_envelope(
    arithmetic: Arithmetic,
    re: &[f64],
    im: &[f64],
    turns: &[EnvelopeTurns; MOMENTS.len()],
    first: usize,
    moments: &mut [Vec<f64>; 3],
) {
    // Of the lines as far above as below a line, the sum turns as the cosine, and the difference as the sine.
    let middle = first + ENVELOPE_HALF;
    let (here_re, here_im) = (loaded::<f64, LANES>(re, middle), loaded::<f64, LANES>(im, middle));
    let mut sums = [[[0.0; LANES]; 2]; ENVELOPE_HALF];
    let mut differences = [[[0.0; LANES]; 2]; ENVELOPE_HALF];
    for apart in 0..ENVELOPE_HALF {
        let (above, below) = (middle + apart + 1, middle - apart - 1);
        let (above_re, above_im) = (loaded::<f64, LANES>(re, above), loaded::<f64, LANES>(im, above));
        let (below_re, below_im) = (loaded::<f64, LANES>(re, below), loaded::<f64, LANES>(im, below));
        for lane in 0..LANES {
            sums[apart][0][lane] = above_re[lane] + below_re[lane];
            sums[apart][1][lane] = above_im[lane] + below_im[lane];
            differences[apart][0][lane] = above_re[lane] - below_re[lane];
            differences[apart][1][lane] = above_im[lane] - below_im[lane];
        }
    }
    let mut powers = [[0.0; LANES]; 3];
    for moment in 0..MOMENTS.len() {
        let EnvelopeTurns { turns, weight } = turns[moment];
        let (mut sum_re, mut sum_im) = (here_re, here_im);
        for apart in 0..ENVELOPE_HALF {
            let [cosine, sine] = turns[apart];
            for lane in 0..LANES {
                let more_re = arithmetic.multiply_add(cosine, sums[apart][0][lane], sum_re[lane]);
                sum_re[lane] = arithmetic.multiply_add(-sine, differences[apart][1][lane], more_re);
                let more_im = arithmetic.multiply_add(cosine, sums[apart][1][lane], sum_im[lane]);
                sum_im[lane] = arithmetic.multiply_add(sine, differences[apart][0][lane], more_im);
            }
        }
        for lane in 0..LANES {
            let power = weight * (sum_re[lane] * sum_re[lane] + sum_im[lane] * sum_im[lane]);
            powers[0][lane] += power;
            powers[1][lane] += power * power;
            powers[2][lane] += power * power * power;
        }
    }
    for order in 0..3 {
        let mut sums = loaded::<f64, LANES>(&moments[order], first);
        for lane in 0..LANES {
            sums[lane] += powers[order][lane];
        }
        store(&mut moments[order], first, &sums);
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
    /// Adds the sums to those of more windows, and begins anew from nothing, in the same place: what has just been allocated has to be
    /// mapped, page by page. Returns what they were.
    pub(super) fn add_to(&mut self, more: &mut Self) -> Sums<f32> {
        more.windows += self.windows;
        let were = |values: &mut [f64], more: &mut [f64]| {
            let each = values.iter_mut().zip(more);
            each.map(|(value, more)| {
                *more += *value;
                std::mem::take(value) as f32
            })
            .collect()
        };
        let windows = std::mem::take(&mut self.windows);
        Sums { windows, re: were(&mut self.re, &mut more.re), im: were(&mut self.im, &mut more.im) }
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

    /// Of values line by line, channel by channel.
    fn restricted_channels(&self, values: Vec<f64>, lines: usize) -> Vec<f64> {
        if self.are_all() {
            return values;
        }
        (0..lines)
            .flat_map(|line| self.wanted.iter().map(move |place| line * self.count + place))
            .map(|at| values[at])
            .collect()
    }

    /// Of values channel by channel, line by line.
    fn restricted_rows(&self, values: Vec<f64>, lines: usize) -> Vec<f64> {
        if self.are_all() {
            return values;
        }
        self.wanted.iter().flat_map(|place| &values[place * lines..(place + 1) * lines]).copied().collect()
    }
}

pub(super) const fn triangle(count: usize) -> usize {
    count * (count + 1) / 2
}

/// Place of element (`row`, `column`), `row <= column`, in a packed upper triangle.
pub(super) const fn packed(count: usize, row: usize, column: usize) -> usize {
    row * count - row * (row + 1) / 2 + column
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use num_complex::Complex64;

    use super::*;
    use crate::processor::on_this_processor;
    use crate::spectra::grid::around;

    const WINDOWS: usize = 7;
    const LINES: usize = 13;

    /// A number for a window, channel and line that is not rounded; of another size in each channel.
    fn value(window: usize, channel: usize, line: usize) -> Complex32 {
        let seed = window * 7919 + channel * 104_729 + line * 1_299_709;
        let part = |most: usize| (seed * seed % most) as f32 / 128.0 - 0.75;
        Complex32::new(part(199), part(211)) * (1 + channel) as f32
    }

    /// The sums of some channels.
    fn summed(channels: &[usize]) -> Total {
        let of = |window: usize| {
            let lines = |&channel: &usize| (0..LINES).map(|line| value(window, channel, line)).collect();
            (0, channels.iter().map(lines).collect())
        };
        let windows: Vec<(u128, Vec<Vec<Complex32>>)> = (0..WINDOWS).map(of).collect();
        let mut total = Total::zero(LINES, channels.len());
        on_this_processor(
            #[inline(always)]
            |arithmetic| {
                let count = channels.len();
                add_outer_products(arithmetic, &windows, count, LINES, &mut total.sums, &mut total.fourths);
                total.add_bands(&windows, count, LINES);
                total.add_envelopes(arithmetic, &windows, count, LINES);
            },
        );
        total
    }

    #[test]
    fn sums_of_several_channels_are_those_of_their_definitions() {
        for count in [1, 3, 11] {
            let total = summed(&(0..count).collect::<Vec<_>>());
            for (channel, line) in (0..count).flat_map(|channel| (0..LINES).map(move |line| (channel, line))) {
                let value = |window: usize, channel: usize, line: usize| {
                    let value = value(window, channel, line);
                    Complex64::new(f64::from(value.re), f64::from(value.im))
                };
                let check = |found: f64, plain: f64| {
                    assert!(
                        (found - plain).abs() < 1e-9 * plain.abs().max(1.0),
                        "channel {channel}, line {line}: {found} {plain}"
                    );
                };
                for other in channel..count {
                    let product = |window| value(window, channel, line) * value(window, other, line).conj();
                    let plain: Complex64 = (0..WINDOWS).map(product).sum();
                    let place = line * triangle(count) + packed(count, channel, other);
                    check(total.sums.re[place], plain.re);
                    check(total.sums.im[place], plain.im);
                }
                let fourths = (0..WINDOWS).map(|window| value(window, channel, line).norm_sqr().powi(2)).sum();
                check(total.fourths[line * count + channel], fourths);
                let place = channel * LINES + line;
                for (half, bands) in BAND_HALVES.into_iter().zip(&total.bands) {
                    let power =
                        |window| around(line, half, LINES).map(|line| value(window, channel, line).norm_sqr()).sum();
                    check(bands[place], (0..WINDOWS).map(power).map(|power: f64| power * power).sum());
                }
                // The window's lines back in time, over Hann's weight there.
                let power = |window: usize, moment: f64| {
                    let part = |at: usize| {
                        let angle = TAU * moment * (at as f64 - line as f64);
                        value(window, channel, at) * Complex64::from_polar(1.0, angle)
                    };
                    let sum: Complex64 = around(line, ENVELOPE_HALF, LINES).map(part).sum();
                    sum.norm_sqr() / (PI * moment).sin().powi(4)
                };
                for (order, sums) in (1..).zip(&total.envelope) {
                    let of =
                        |window: usize| MOMENTS.map(|moment| power(window, moment).powi(order)).iter().sum::<f64>();
                    check(sums[place], (0..WINDOWS).map(of).sum());
                }
            }
        }
    }

    #[test]
    fn some_channels_of_a_set_have_the_sums_that_they_have_alone() {
        // Of the channels 1, 2 and 4, the first and the last.
        let subset = ChannelSubset::new(0b10110, 0b10010);
        assert_eq!((subset.count, &subset.wanted[..]), (3, &[0, 2][..]));
        let (some, alone) = (summed(&[1, 2, 4]).restricted(&subset, LINES), summed(&[1, 4]));
        assert_eq!((some.sums.re, some.sums.im), (alone.sums.re, alone.sums.im));
        assert_eq!((some.fourths, some.bands, some.envelope), (alone.fourths, alone.bands, alone.envelope));
        let all = summed(&[1, 4]).restricted(&ChannelSubset::new(0b10010, 0b10010), LINES);
        assert_eq!(all.bands, summed(&[1, 4]).bands);
    }
}
