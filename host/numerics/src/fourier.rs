//! Transforms of real samples: from N samples to N/2 + 1 lines and back, neither scaled.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};

/// From samples to lines, `X_k = sum_n x_n exp(-2 pi i k n / N)`.
pub type ForwardTransform = Arc<dyn RealToComplex<f64>>;
/// From lines to samples, N times those that the lines came from.
pub type InverseTransform = Arc<dyn ComplexToReal<f64>>;

/// The transform of `length` samples to `length / 2 + 1` lines.
pub fn forward_transform(length: usize) -> ForwardTransform {
    RealFftPlanner::new().plan_fft_forward(length)
}

/// The transform of `length / 2 + 1` lines to `length` samples.
pub fn inverse_transform(length: usize) -> InverseTransform {
    RealFftPlanner::new().plan_fft_inverse(length)
}
