//! The matrices that a fit looks at, line by line.
//!
//! A setup's averages flow in, whole or without a group of windows; matrices, and spectra behind a filter, flow out.

use std::cell::OnceCell;

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::bell::Bell;
use super::shape::{Shape, filtered};
use crate::spectra::CrossSpectrum;

/// Cross-spectral matrices by line, with or without one group of windows, unpacked when they are asked for: modes need those
/// near them only.
pub(super) struct Matrices<'a> {
    spectrum: &'a CrossSpectrum,
    without: Option<usize>,
    lines: Vec<OnceCell<DMatrix<Complex64>>>,
}

impl<'a> Matrices<'a> {
    pub(super) fn new(spectrum: &'a CrossSpectrum, without: Option<usize>) -> Self {
        Self { spectrum, without, lines: vec![OnceCell::new(); spectrum.grid().lines] }
    }

    pub(super) fn at(&self, line: usize) -> &DMatrix<Complex64> {
        self.lines[line].get_or_init(|| match self.without {
            Some(group) => self.spectrum.matrix_without(group, line),
            None => self.spectrum.matrix(line),
        })
    }
}

/// The filtered spectrum of consecutive lines.
pub(super) fn bell(
    spectrum: &CrossSpectrum,
    matrices: &Matrices<'_>,
    filter: &Shape,
    first: usize,
    last: usize,
) -> Bell {
    let grid = spectrum.grid();
    Bell {
        frequency_hz: (first..=last).map(|line| grid.frequency_hz(line)).collect(),
        density: (first..=last).map(|line| filtered(filter, matrices.at(line)).max(f64::MIN_POSITIVE)).collect(),
        duration_s: 1.0 / grid.spacing_hz(),
        mixed: None,
    }
}
