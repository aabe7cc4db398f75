//! Real FFT in place: a complex FFT of half the length (decimation in time), then its lines are taken apart.
//!
//! Even samples are real parts and odd ones imaginary parts, where they lie. Values are put into bit-reversed order;
//! transforms of eight points, or four, are made of neighbours, and passes of radix 4 combine them. The three twiddle factors of
//! a butterfly lie together in one table, which shorter transforms stride through.

use bytemuck::cast_slice_mut;
use num_complex::Complex32;

use crate::tables::{HALF_ROW, QUARTER_SINE, TWIDDLES};
use crate::{LONGEST_SEGMENT, is_supported};

/// Replaces real samples by twice the first half of their discrete Fourier transform, `2 sum x_n exp(-2 pi i k n / N)`.
///
/// The line of the Nyquist frequency is in the imaginary part of line 0. Lengths are the powers of two from
/// [`SHORTEST_SEGMENT`](crate::SHORTEST_SEGMENT) to [`LONGEST_SEGMENT`]; for others there are no lines. Within 3e-7 of the largest line of a noisy
/// tone (f32 rounding).
#[inline(never)]
pub fn real_fft(samples: &mut [f32]) -> &mut [Complex32] {
    if !is_supported(samples.len()) {
        return &mut [];
    }
    let values: &mut [Complex32] = cast_slice_mut(samples);
    reverse_bits(values);
    // Passes that are longer than the transform find nothing to combine.
    if values.len().trailing_zeros().is_multiple_of(2) {
        values.as_chunks_mut().0.iter_mut().for_each(four_points);
        combine_short::<16>(values);
        combine_short::<64>(values);
        combine_long::<256>(values);
        combine_long::<1024>(values);
    } else {
        values.as_chunks_mut().0.iter_mut().for_each(eight_points);
        combine_short::<32>(values);
        combine_short::<128>(values);
        combine_long::<512>(values);
        combine_long::<2048>(values);
    }
    take_apart(values);
    values
}

/// Exchanges values whose indices are each other's bits in reverse.
#[inline(never)]
fn reverse_bits(values: &mut [Complex32]) {
    let (low, high) = values.split_at_mut(values.len() / 2);
    let (low, high) = (low.as_chunks_mut::<2>().0, high.as_chunks_mut::<2>().0);
    let pairs = low.len().min(high.len());
    let shift = pairs.leading_zeros() + 1;
    // An index is its highest bit (low or high), those between (here and there), and its lowest (which of a pair).
    for here in 0..pairs {
        let there = here.reverse_bits() >> shift;
        if there >= pairs {
            return;
        }
        core::mem::swap(&mut low[here][1], &mut high[there][0]);
        if here < there {
            (low[here][0], low[there][0]) = (low[there][0], low[here][0]);
            (high[here][1], high[there][1]) = (high[there][1], high[here][1]);
        }
    }
}

fn four_points(values: &mut [Complex32; 4]) {
    *values = quartet(*values);
}

/// The transform of four values in bit-reversed order.
#[inline(always)]
fn quartet([a, c, b, d]: [Complex32; 4]) -> [Complex32; 4] {
    let (even, odd) = (a + c, b + d);
    let (even_difference, odd_difference) = (a - c, turned(b - d));
    [even + odd, even_difference + odd_difference, even - odd, even_difference - odd_difference]
}

/// The transform of eight values in bit-reversed order.
fn eight_points(values: &mut [Complex32; 8]) {
    let [a, b, c, d, e, f, g, h] = *values;
    let [a, b, c, d] = quartet([a, b, c, d]);
    let [e, f, g, h] = quartet([e, f, g, h]);
    let root = core::f32::consts::FRAC_1_SQRT_2;
    let f = Complex32::new((f.re + f.im) * root, (f.im - f.re) * root);
    let g = turned(g);
    let h = Complex32::new((h.im - h.re) * root, (h.re + h.im) * -root);
    *values = [a + e, b + f, c + g, d + h, a - e, b - f, c - g, d - h];
}

/// `-i z`.
#[inline(always)]
fn turned(z: Complex32) -> Complex32 {
    Complex32::new(z.im, -z.re)
}

/// `z` turned back by an angle.
#[inline(always)]
fn turned_back(z: Complex32, cosine: f32, sine: f32) -> Complex32 {
    Complex32::new(z.re * cosine + z.im * sine, z.im * cosine - z.re * sine)
}

/// One line of each of four transforms, in bit-reversed order, made into four lines of one.
#[inline(always)]
fn butterfly([a, c, b, d]: [Complex32; 4], twiddles: &[f32; 6]) -> [Complex32; 4] {
    let [cosine, sine, cosine_2, sine_2, cosine_3, sine_3] = *twiddles;
    quartet([a, turned_back(c, cosine_2, sine_2), turned_back(b, cosine, sine), turned_back(d, cosine_3, sine_3)])
}

/// Combines transforms of a quarter of `LENGTH` points, which lie side by side, into transforms of `LENGTH` points.
///
/// For short transforms, of which there are many: twiddle factors are read once for all of them.
#[inline(never)]
fn combine_short<const LENGTH: usize>(values: &mut [Complex32]) {
    for (k, twiddles) in TWIDDLES.chunks_exact(TWIDDLES.len() * 4 / LENGTH).enumerate() {
        for group in values.as_chunks_mut::<LENGTH>().0 {
            let places = [k, k + LENGTH / 4, k + LENGTH / 2, k + LENGTH / 4 * 3];
            let lines = butterfly(places.map(|place| group[place]), &twiddles[0]);
            for (place, line) in places.into_iter().zip(lines) {
                group[place] = line;
            }
        }
    }
}

/// The same for long transforms: two butterflies at a time.
#[inline(never)]
fn combine_long<const LENGTH: usize>(values: &mut [Complex32]) {
    let stride = TWIDDLES.len() * 8 / LENGTH;
    for group in values.as_chunks_mut::<LENGTH>().0 {
        let (even, odd) = group.split_at_mut(LENGTH / 2);
        let ((a, b), (c, d)) = (even.split_at_mut(LENGTH / 4), odd.split_at_mut(LENGTH / 4));
        let [a, b, c, d] = [a, b, c, d].map(|quarter| quarter.as_chunks_mut::<2>().0);
        for ((((a, b), c), d), twiddles) in a.iter_mut().zip(b).zip(c).zip(d).zip(TWIDDLES.chunks_exact(stride)) {
            let first = twiddles[0];
            let second = if stride > 1 { twiddles[stride / 2] } else { half_row_later(first) };
            [a[0], b[0], c[0], d[0]] = butterfly([a[0], b[0], c[0], d[0]], &first);
            [a[1], b[1], c[1], d[1]] = butterfly([a[1], b[1], c[1], d[1]], &second);
        }
    }
}

/// Twiddle factors halfway between a row of the table and the next: the longest transform's, for which a table would take
/// another 6 KB.
#[inline(always)]
fn half_row_later(mut twiddles: [f32; 6]) -> [f32; 6] {
    let steps = HALF_ROW.as_chunks().0;
    for ([cosine, sine], [step_cosine, step_sine]) in twiddles.as_chunks_mut().0.iter_mut().zip(steps) {
        (*cosine, *sine) = (*cosine * step_cosine - *sine * step_sine, *sine * step_cosine + *cosine * step_sine);
    }
    twiddles
}

/// Makes the lines of the real samples (twice them, which saves halving) from those of the complex values.
#[inline(never)]
fn take_apart(values: &mut [Complex32]) {
    let stride = LONGEST_SEGMENT / 2 / values.len();
    let (low, high) = values.split_at_mut(values.len() / 2);
    let ([first, low @ ..], [middle, high @ ..]) = (low, high) else { return };
    *first = Complex32::new(2.0 * (first.re + first.im), 2.0 * (first.re - first.im));
    *middle = Complex32::new(2.0 * middle.re, -2.0 * middle.im);
    let sines = QUARTER_SINE[stride..].chunks_exact(2 * stride);
    let cosines = QUARTER_SINE[..LONGEST_SEGMENT / 4].rchunks_exact(2 * stride);
    let pairs = low.as_chunks_mut::<2>().0.iter_mut().zip(high.rchunks_exact_mut(2));
    for (((low, high), cosines), sines) in pairs.zip(cosines).zip(sines) {
        (low[0], high[1]) = apart(low[0], high[1], cosines[stride], sines[0]);
        (low[1], high[0]) = apart(low[1], high[0], cosines[0], sines[stride]);
    }
    // Their number is odd.
    if let ([.., low], [high, ..]) = (low, high) {
        (*low, *high) = apart(*low, *high, QUARTER_SINE[stride], QUARTER_SINE[LONGEST_SEGMENT / 4 - stride]);
    }
}

/// Two lines that lie alike on both sides of the middle, from the complex values in their places.
#[inline(always)]
fn apart(low: Complex32, high: Complex32, cosine: f32, sine: f32) -> (Complex32, Complex32) {
    let (sum, difference) = (low + high, low - high);
    let re = cosine * sum.im - sine * difference.re;
    let im = sine * sum.im + cosine * difference.re;
    (Complex32::new(sum.re + re, difference.im - im), Complex32::new(sum.re - re, -difference.im - im))
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;
    use std::vec::Vec;

    #[test]
    fn lines_are_twice_those_of_the_definition_at_every_length() {
        for length in [256_usize, 512, 1024, 2048, 4096] {
            let mut state = 5_u32;
            let samples: Vec<f32> = (0..length)
                .map(|n| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (0.7 * n as f32).sin() + (state >> 8) as f32 / (1 << 24) as f32
                })
                .collect();
            // One pass over the samples a line; term by term, in f64.
            let expected = |k: usize| {
                let terms = samples.iter().enumerate().map(|(n, &x)| {
                    let phase = TAU * ((k * n) % length) as f64 / length as f64;
                    (f64::from(x) * phase.cos(), -f64::from(x) * phase.sin())
                });
                terms.fold((0.0, 0.0), |sum, term| (sum.0 + 2.0 * term.0, sum.1 + 2.0 * term.1))
            };
            let mut buffer = samples.clone();
            let lines = real_fft(&mut buffer);
            assert_eq!(lines.len(), length / 2);
            let largest = lines[1..].iter().fold(0.0_f64, |most, line| most.max(f64::from(line.norm_sqr()).sqrt()));
            let mut worst = (f64::from(lines[0].re) - expected(0).0).abs();
            worst = worst.max((f64::from(lines[0].im) - expected(length / 2).0).abs());
            for k in (1..length / 2).filter(|k| k % 3 == 0 || [1, length / 4, length / 2 - 1].contains(k)) {
                let (re, im) = expected(k);
                worst = worst.max((f64::from(lines[k].re) - re).hypot(f64::from(lines[k].im) - im));
            }
            assert!(worst < 3e-7 * largest, "{length}: {} of the largest line", worst / largest);
        }
    }

    #[test]
    fn lengths_that_are_not_supported_have_no_lines() {
        for length in [0, 1, 128, 255, 300, 8192] {
            assert!(real_fft(&mut std::vec![1.0; length]).is_empty());
        }
    }
}
