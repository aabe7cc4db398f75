//! From spectral lines to samples.

use belfry_numerics::inverse_transform;
use nalgebra::Complex;

/// Extra length, as a share of the record, that is simulated and cut off, because the inverse transform is periodic.
const CUT_OFF: f64 = 0.15;

/// The length that a record of so many rows is simulated in.
pub(crate) fn simulated_length(rows: usize) -> usize {
    smooth((rows as f64 * (1.0 + CUT_OFF)) as usize)
}

/// The middle rows of each column from its lines, of which there are `length / 2 + 1`.
pub(crate) fn columns_of(lines: &mut [Vec<Complex<f64>>], length: usize, rows: usize) -> Vec<Vec<f64>> {
    let transform = inverse_transform(length);
    let first = (length - rows) / 2;
    let column = |lines: &mut Vec<Complex<f64>>| {
        let mut samples = vec![0.0; length];
        // Lengths match, and the ends are real: nothing that it refuses.
        let _ = transform.process(lines, &mut samples);
        samples[first..first + rows].to_vec()
    };
    lines.iter_mut().map(column).collect()
}

/// The next even length with no prime factor above 5.
fn smooth(least: usize) -> usize {
    let is_smooth = |mut length: usize| {
        for factor in [2, 3, 5] {
            while length.is_multiple_of(factor) {
                length /= factor;
            }
        }
        length == 1
    };
    (least.max(2)..).find(|&length| length.is_multiple_of(2) && is_smooth(length)).unwrap_or(least)
}
