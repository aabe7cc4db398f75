//! A segment's samples before the FFT, and the power of its lines after it.

use num_complex::Complex32;

use crate::tables::QUARTER_SINE;
use crate::{LONGEST_SEGMENT, is_supported};

/// Pairs of samples summed in one piece.
const SUM_BLOCK: usize = 64;

/// A straight line through samples: its value in the middle, and its slope a sample.
#[derive(Debug, Clone, Copy)]
pub struct Line {
    /// Halfway between the first sample and the last.
    pub middle: f32,
    /// From one sample to the next.
    pub slope: f32,
}

/// The least-squares straight line through samples, a multiple of 128 of them.
///
/// Samples are taken in pairs that lie alike on both sides of the middle: a large mean then leaves the moment at once, and costs
/// it no digits.
#[inline(never)]
pub fn straight_line(samples: &[f32]) -> Line {
    let (early, late) = samples.split_at(samples.len() / 2);
    let count = samples.len() as f32;
    let (mut sum, mut moment) = (0.0, 0.0);
    let mut from_middle = 0.5 * (count - 1.0);
    // Summed in blocks: one long f32 sum would lose the digits in which a drift hides.
    for (early, late) in early.as_chunks::<SUM_BLOCK>().0.iter().zip(late.as_chunks::<SUM_BLOCK>().0.iter().rev()) {
        let (mut block_sum, mut block_moment) = (0.0, 0.0);
        for ([a, b, c, d], [w, x, y, z]) in early.as_chunks().0.iter().zip(late.as_chunks().0.iter().rev()) {
            block_sum += ((a + z) + (b + y)) + ((c + x) + (d + w));
            block_moment += (z - a) * from_middle
                + (y - b) * (from_middle - 1.0)
                + (x - c) * (from_middle - 2.0)
                + (w - d) * (from_middle - 3.0);
            from_middle -= 4.0;
        }
        sum += block_sum;
        moment += block_moment;
    }
    // Sum of (n - centre)^2 over n = 0..count.
    Line { middle: sum / count, slope: moment / (count * (count * count - 1.0) / 12.0) }
}

/// Takes the straight line out, and multiplies by the periodic Hann window and `scale`; for the lengths that
/// [`real_fft`](crate::real_fft) takes (others are left alone).
///
/// A cosine serves four samples: `n` after the start, `n` before and after the middle, `n` before the end. Only the first sample,
/// the middle one and those halfway between stand alone.
#[inline(never)]
pub fn apply_hann(samples: &mut [f32], line: Line, scale: f32) {
    if !is_supported(samples.len()) {
        return;
    }
    let (quarter, stride) = (samples.len() / 4, LONGEST_SEGMENT / samples.len());
    let (rising, falling) = samples.split_at_mut(2 * quarter);
    let ((rising_low, rising_high), (falling_high, falling_low)) =
        (rising.split_at_mut(quarter), falling.split_at_mut(quarter));
    let ([first, rising_low @ ..], [rising_half, rising_high @ ..]) = (rising_low, rising_high) else { return };
    let ([peak, falling_high @ ..], [falling_half, falling_low @ ..]) = (falling_high, falling_low) else { return };
    let mut window = Window {
        // The middle sample lies half a sample after the middle of the line.
        middle: line.middle + 0.5 * line.slope,
        slope: line.slope,
        rise_of_half: 2.0 * quarter as f32 * line.slope,
        half_scale: 0.5 * scale,
        from_middle: 2.0 * quarter as f32,
    };
    *first = 0.0;
    *peak = (*peak - window.middle) * scale;
    let rise = quarter as f32 * line.slope;
    *rising_half = (*rising_half - window.middle + rise) * window.half_scale;
    *falling_half = (*falling_half - window.middle - rise) * window.half_scale;
    let rising = rising_low.as_chunks_mut::<2>().0.iter_mut().zip(rising_high.rchunks_exact_mut(2));
    let falling = falling_high.as_chunks_mut::<2>().0.iter_mut().zip(falling_low.rchunks_exact_mut(2));
    let cosines = QUARTER_SINE[..LONGEST_SEGMENT / 4].rchunks_exact(2 * stride);
    for (((a, b), (c, d)), cosines) in rising.zip(falling).zip(cosines) {
        window.weigh([&mut a[0], &mut b[1], &mut c[0], &mut d[1]], cosines[stride]);
        window.weigh([&mut a[1], &mut b[0], &mut c[1], &mut d[0]], cosines[0]);
    }
    // Their number is odd.
    if let ([.., a], [b, ..], [.., c], [d, ..]) = (rising_low, rising_high, falling_high, falling_low) {
        window.weigh([a, b, c, d], QUARTER_SINE[stride]);
    }
}

/// The window on its way from the segment's ends to the quarters.
struct Window {
    /// The line's value at the middle sample, and its rise a sample and half a segment.
    middle: f32,
    slope: f32,
    rise_of_half: f32,
    half_scale: f32,
    /// Distance in samples of the outermost of four samples from the middle one.
    from_middle: f32,
}

impl Window {
    /// Weighs the next four samples, in the order of time, by half of 1 -+ `cosine`.
    #[inline(always)]
    fn weigh(&mut self, [a, b, c, d]: [&mut f32; 4], cosine: f32) {
        self.from_middle -= 1.0;
        let cosine = self.half_scale * cosine;
        let (low, high) = (self.half_scale - cosine, self.half_scale + cosine);
        let far = self.from_middle * self.slope;
        let near = self.rise_of_half - far;
        *a = (*a - self.middle + far) * low;
        *b = (*b - self.middle + near) * high;
        *c = (*c - self.middle - near) * high;
        *d = (*d - self.middle - far) * low;
    }
}

/// Adds the power of every line, its squared magnitude, to `sums`.
#[inline(never)]
pub fn add_power(sums: &mut [f32], lines: &[Complex32]) {
    let (sums, last_sums) = sums.as_chunks_mut::<4>();
    let (lines, last_lines) = lines.as_chunks::<4>();
    for (sums, lines) in sums.iter_mut().zip(lines) {
        for (sum, line) in sums.iter_mut().zip(lines) {
            *sum = *sum + line.re * line.re + line.im * line.im;
        }
    }
    for (sum, line) in last_sums.iter_mut().zip(last_lines) {
        *sum = *sum + line.re * line.re + line.im * line.im;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn the_line_of_a_drift_about_a_large_mean_is_that_drift() {
        for length in [256_usize, 1024, 4096] {
            let samples: Vec<f32> = (0..length).map(|n| 9.8 + 1e-3 * n as f32).collect();
            let line = straight_line(&samples);
            assert!((line.middle - 9.8 - 0.5e-3 * (length - 1) as f32).abs() < 4e-6, "{length}: {line:?}");
            // Four steps of f32 there; as samples are rounded by half a step of 1e-6, the slope is to that over the length.
            assert!((line.slope - 1e-3).abs() < 1e-6 / length as f32, "{length}: {line:?}");
        }
    }

    #[test]
    fn a_constant_becomes_the_periodic_hann_window_and_a_line_nothing() {
        for length in [256_usize, 512, 1024, 2048, 4096] {
            let mut samples = std::vec![3.0; length];
            apply_hann(&mut samples, Line { middle: 1.0, slope: 0.0 }, 0.25);
            for (n, &sample) in samples.iter().enumerate() {
                let weight = (core::f64::consts::PI * n as f64 / length as f64).sin().powi(2);
                assert!((f64::from(sample) - 0.5 * weight).abs() < 5e-8, "{length}: {n}");
            }
            // Powers of two: exact.
            let mut samples: Vec<f32> = (0..length).map(|n| 0.25 * n as f32).collect();
            apply_hann(&mut samples, Line { middle: 0.125 * (length - 1) as f32, slope: 0.25 }, 1.0);
            assert!(samples.iter().all(|&sample| sample == 0.0), "{length}");
        }
    }

    #[test]
    fn powers_are_added_line_by_line_to_the_last() {
        let lines: Vec<Complex32> = (0..7).map(|k| Complex32::new(k as f32, 1.0)).collect();
        let mut sums = [10.0; 7];
        add_power(&mut sums, &lines);
        assert_eq!(sums, [11.0, 12.0, 15.0, 20.0, 27.0, 36.0, 47.0]);
        add_power(&mut sums[..6], &lines);
        assert_eq!(sums, [12.0, 14.0, 20.0, 30.0, 44.0, 62.0, 47.0]);
    }
}
