//! Transforms: of real samples to N/2 + 1 lines and back, and of complex samples to as many lines; none is scaled.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

/// From samples to lines, `X_k = sum_n x_n exp(-2 pi i k n / N)`.
pub type ForwardTransform = Arc<dyn RealToComplex<f64>>;
/// From lines to samples, N times those that the lines came from.
pub type InverseTransform = Arc<dyn ComplexToReal<f64>>;

/// From complex samples to as many lines, or back, in place.
pub type ComplexTransform = Arc<dyn Fft<f64>>;

/// The transform of `length` samples to `length / 2 + 1` lines.
pub fn forward_transform(length: usize) -> ForwardTransform {
    RealFftPlanner::new().plan_fft_forward(length)
}

/// The transform of `length / 2 + 1` lines to `length` samples.
pub fn inverse_transform(length: usize) -> InverseTransform {
    RealFftPlanner::new().plan_fft_inverse(length)
}

/// The transform of `length` complex samples, `sum_n x_n exp(-2 pi i k n / N)`.
pub fn complex_transform(length: usize) -> ComplexTransform {
    FftPlanner::new().plan_fft_forward(length)
}

/// The transform of `length` lines to complex samples, N times those that the lines came from.
pub fn inverse_complex_transform(length: usize) -> ComplexTransform {
    FftPlanner::new().plan_fft_inverse(length)
}
