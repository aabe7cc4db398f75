//! One segment's spectrum: straight line out, Hann window, real FFT, scaled to m/s²/√Hz.
//!
//! Agrees with the same steps in f64 to within f32 rounding: 2e-6 of the largest line (checked in the tests).

use belfry_shared::message::Configuration;
use num_complex::Complex32;

use crate::tables::HALF_HANN;

/// The segments a node can transform.
pub const SUPPORTED_SEGMENTS: [u16; 5] = [256, 512, 1024, 2048, 4096];
/// Pairs of samples summed in one piece.
const SUM_BLOCK: usize = 64;
/// The longest of them.
pub(crate) const LONGEST_SEGMENT: usize = 4096;

/// Replaces the samples in `buffer` (a supported length, m/s²) by their lines and returns them.
///
/// Line `k` is `X_k sqrt(2 / (f_s sum w^2))` with the periodic Hann window `w`, so that its squared magnitude is the
/// one-sided power spectral density; the factor 2 is wrong for line 0, which also holds the Nyquist line (in its
/// imaginary part) and is never sent. For other lengths there are no lines.
pub(crate) fn transform(buffer: &mut [f32], sampling_rate_hz: f32) -> &mut [Complex32] {
    let line = straight_line(buffer);
    let length = buffer.len();
    // The sum over a periodic Hann window's squares is 3 N / 8 (Harris 1978, table 1).
    let scale = libm::sqrtf(2.0 / (sampling_rate_hz * 0.375 * length as f32));
    apply_hann(buffer, line, scale);
    match length {
        256 => buffer.try_into().map_or(&mut [], |b| microfft::real::rfft_256(b)),
        512 => buffer.try_into().map_or(&mut [], |b| microfft::real::rfft_512(b)),
        1024 => buffer.try_into().map_or(&mut [], |b| microfft::real::rfft_1024(b)),
        2048 => buffer.try_into().map_or(&mut [], |b| microfft::real::rfft_2048(b)),
        4096 => buffer.try_into().map_or(&mut [], |b| microfft::real::rfft_4096(b)),
        _ => &mut [],
    }
}

/// One segment's power, added to `sums` (a line each): what a node does with every segment of an averaged density. For counting
/// instructions, as others count theirs.
#[doc(hidden)]
pub fn welch_segment(samples: &mut [f32], sampling_rate_hz: f32, sums: &mut [f32]) {
    for (sum, line) in sums.iter_mut().zip(transform(samples, sampling_rate_hz)) {
        *sum += line.norm_sqr();
    }
}

/// A straight line through samples: its value in the middle, and its slope a sample.
#[derive(Debug, Clone, Copy)]
struct Line {
    middle: f32,
    slope: f32,
}

/// The least-squares straight line.
///
/// Samples are taken in pairs that lie alike on both sides of the middle: a large mean then leaves the moment at once, and costs
/// it no digits.
fn straight_line(samples: &[f32]) -> Line {
    let (early, late) = samples.split_at(samples.len() / 2);
    let count = samples.len() as f32;
    let (mut sum, mut moment) = (0.0, 0.0);
    let mut from_middle = 0.5 * (count - 1.0);
    // Summed in blocks: one long f32 sum would lose the digits in which a drift hides.
    for (early, late) in early.chunks_exact(SUM_BLOCK).zip(late.rchunks_exact(SUM_BLOCK)) {
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

/// Takes the straight line out, and multiplies by the periodic Hann window and `scale`.
///
/// A weight serves two samples, as many before the middle as after it; only the first (weight 0) and the middle one stand alone.
fn apply_hann(samples: &mut [f32], line: Line, scale: f32) {
    let half = samples.len() / 2;
    let stride = LONGEST_SEGMENT / samples.len().max(1);
    // The middle sample lies half a sample after the middle of the line.
    let middle = line.middle + 0.5 * line.slope;
    let (rising, falling) = samples.split_at_mut(half);
    let [first, rising @ ..] = rising else { return };
    let [peak, falling @ ..] = falling else { return };
    *first = 0.0;
    *peak = (*peak - middle) * scale;
    let mut from_middle = half as f32;
    let weights = HALF_HANN.get(stride..).unwrap_or(&[]).iter().step_by(stride.max(1));
    for ((early, late), weight) in rising.iter_mut().zip(falling.iter_mut().rev()).zip(weights) {
        from_middle -= 1.0;
        let (rise, weight) = (from_middle * line.slope, weight * scale);
        *early = (*early - (middle - rise)) * weight;
        *late = (*late - (middle + rise)) * weight;
    }
}

/// The decimated sampling rate in Hz.
pub(crate) fn decimated_rate_hz(configuration: &Configuration) -> f32 {
    configuration.sampling_rate_uhz as f32 * 1e-6 / configuration.decimation as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use std::vec::Vec;

    /// The definition, term by term, in f64.
    fn reference(samples: &[f32], rate: f64, line: usize) -> (f64, f64) {
        let count = samples.len() as f64;
        let centre = (count - 1.0) / 2.0;
        let mean = samples.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
        let moment: f64 = samples.iter().enumerate().map(|(n, &x)| (n as f64 - centre) * f64::from(x)).sum();
        let slope = moment / (0..samples.len()).map(|n| (n as f64 - centre).powi(2)).sum::<f64>();
        let (mut re, mut im, mut power) = (0.0, 0.0, 0.0);
        for (n, &x) in samples.iter().enumerate() {
            let weight = 0.5 - 0.5 * (2.0 * PI * n as f64 / count).cos();
            let value = weight * (f64::from(x) - mean - slope * (n as f64 - centre));
            let phase = -2.0 * PI * ((line * n) % samples.len()) as f64 / count;
            re += value * phase.cos();
            im += value * phase.sin();
            power += weight * weight;
        }
        let scale = (2.0 / (rate * power)).sqrt();
        (re * scale, im * scale)
    }

    #[test]
    fn lines_are_those_of_the_definition_for_every_segment_length() {
        for length in SUPPORTED_SEGMENTS {
            // Two tones, noise and a strong drift; deterministic pseudo-random numbers.
            let mut state = 1_u32;
            let samples: Vec<f32> = (0..length)
                .map(|n| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
                    let t = f64::from(n);
                    ((0.3 * t).sin() + 0.01 * (1.1 * t).cos() + 0.1 * noise + 0.002 * t + 3.0) as f32
                })
                .collect();
            let mut buffer = samples.clone();
            let lines = transform(&mut buffer, 5.0);
            assert_eq!(lines.len(), usize::from(length) / 2);
            let expected: Vec<_> = (1..lines.len()).step_by(7).map(|k| (k, reference(&samples, 5.0, k))).collect();
            let largest = lines[1..].iter().fold(0.0_f64, |m, line| m.max(f64::from(line.norm())));
            let mut worst = 0.0_f64;
            for (k, (re, im)) in expected {
                let error = (f64::from(lines[k].re) - re).hypot(f64::from(lines[k].im) - im);
                worst = worst.max(error / largest);
            }
            assert!(worst < 2e-6, "segment {length}: off by {worst} of the largest line");
        }
    }

    #[test]
    fn white_noise_of_variance_v_has_density_2v_over_the_sampling_rate() {
        let (mut sum, mut lines_summed, rate) = (0.0_f64, 0, 5.0);
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32 - 0.5
        };
        for _ in 0..200 {
            let mut buffer: Vec<f32> = (0..256).map(|_| uniform()).collect();
            for line in &transform(&mut buffer, rate)[3..] {
                sum += f64::from(line.norm_sqr());
                lines_summed += 1;
            }
        }
        let expected = 2.0 * (1.0 / 12.0) / f64::from(rate);
        // 25 000 lines, correlated over three neighbours: one standard deviation is 1 %.
        assert!((sum / f64::from(lines_summed) / expected - 1.0).abs() < 0.03);
    }
}
