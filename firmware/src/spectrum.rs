//! One segment's spectrum: straight line out, Hann window, real FFT, scaled to m/s²/√Hz.
//!
//! Agrees with the same steps in f64 to within f32 rounding: 2e-6 of the largest line (checked in the tests).

use belfry_kernels::{SHORTEST_SEGMENT, add_power, apply_hann, real_fft, straight_line};
use belfry_shared::message::Configuration;
use num_complex::Complex32;

pub(crate) use belfry_kernels::LONGEST_SEGMENT;

/// The segments a node can transform.
pub const SUPPORTED_SEGMENTS: [u16; 5] = [256, 512, 1024, 2048, 4096];
const _: () =
    assert!(SUPPORTED_SEGMENTS[0] as usize == SHORTEST_SEGMENT && SUPPORTED_SEGMENTS[4] as usize == LONGEST_SEGMENT);

/// Replaces the samples in `buffer` (a supported length, m/s²) by their lines and returns them.
///
/// Line `k` is `X_k sqrt(2 / (f_s sum w^2))` with the periodic Hann window `w`, so that its squared magnitude is the
/// one-sided power spectral density; the factor 2 is wrong for line 0, which also holds the Nyquist line (in its
/// imaginary part) and is never sent. Other lengths give no lines.
pub(crate) fn transform(buffer: &mut [f32], sampling_rate_hz: f32) -> &mut [Complex32] {
    let line = straight_line(buffer);
    // The sum over a periodic Hann window's squares is 3 N / 8 (Harris 1978, table 1); `real_fft` gives twice the lines.
    let scale = 0.5 * libm::sqrtf(2.0 / (sampling_rate_hz * 0.375 * buffer.len() as f32));
    apply_hann(buffer, line, scale);
    real_fft(buffer)
}

/// Adds one segment's power to `sums`, line by line: what a node does with every segment of an averaged density. It is public so
/// that its instructions can be counted and compared with those of other libraries.
#[doc(hidden)]
pub fn welch_segment(samples: &mut [f32], sampling_rate_hz: f32, sums: &mut [f32]) {
    add_power(sums, transform(samples, sampling_rate_hz));
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
