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
    /// Lines that a tone is in, in order.
    taken: &'a [usize],
    lines: Vec<OnceCell<DMatrix<Complex64>>>,
}

/// With fewer lines there is no fit.
pub(super) const LEAST_LINES: usize = 5;

impl<'a> Matrices<'a> {
    pub(super) fn new(spectrum: &'a CrossSpectrum, without: Option<usize>, taken: &'a [usize]) -> Self {
        Self { spectrum, without, taken, lines: vec![OnceCell::new(); spectrum.grid().lines] }
    }

    /// The lines from `first` to `last` that no tone is in; all of them where that leaves fewer than `least`.
    pub(super) fn free(&self, first: usize, last: usize, least: usize) -> Vec<usize> {
        let free: Vec<usize> = (first..=last).filter(|line| self.taken.binary_search(line).is_err()).collect();
        if free.len() < least { (first..=last).collect() } else { free }
    }

    pub(super) fn at(&self, line: usize) -> &DMatrix<Complex64> {
        self.lines[line].get_or_init(|| match self.without {
            Some(group) => self.spectrum.matrix_without(group, line),
            None => self.spectrum.matrix(line),
        })
    }
}

/// The filtered spectrum of some lines.
pub(super) fn bell(spectrum: &CrossSpectrum, matrices: &Matrices<'_>, filter: &Shape, lines: &[usize]) -> Bell {
    let grid = spectrum.grid();
    let density = |&line: &usize| filtered(filter, matrices.at(line)).max(f64::MIN_POSITIVE);
    Bell {
        frequency_hz: lines.iter().map(|&line| grid.frequency_hz(line)).collect(),
        density: lines.iter().map(density).collect(),
        duration_s: 1.0 / grid.spacing_hz(),
        mixed: None,
    }
}
