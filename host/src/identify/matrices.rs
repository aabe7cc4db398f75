//! The matrices that a fit looks at, line by line.
//!
//! A setup's averages flow in, or the long windows that finer lines come from, whole or without a group of windows; matrices, and
//! spectra behind a filter, flow out.

use std::sync::OnceLock;

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::bell::Bell;
use super::shape::{Shape, filtered};
use crate::spectra::{CrossSpectrum, FinerSpectrum, LineGrid};

/// Where matrices come from.
#[derive(Clone, Copy)]
pub(super) enum Source<'a> {
    /// Averages, in groups of consecutive windows.
    Averages(&'a CrossSpectrum),
    /// Long windows, which are fewer.
    Finer(&'a FinerSpectrum),
}

impl Source<'_> {
    pub(super) fn grid(&self) -> &LineGrid {
        match self {
            Self::Averages(spectrum) => spectrum.grid(),
            Self::Finer(spectrum) => spectrum.grid(),
        }
    }

    pub(super) fn channels(&self) -> usize {
        match self {
            Self::Averages(spectrum) => spectrum.channels().len(),
            Self::Finer(spectrum) => spectrum.channels(),
        }
    }

    /// Windows at half overlap.
    pub(super) fn averages(&self) -> usize {
        match self {
            Self::Averages(spectrum) => spectrum.averages(),
            Self::Finer(spectrum) => spectrum.averages(),
        }
    }

    /// Groups for the jackknife; one is none.
    pub(super) fn groups(&self) -> usize {
        let count = match self {
            Self::Averages(spectrum) => spectrum.group_count(),
            Self::Finer(spectrum) => spectrum.groups(),
        };
        if count > 1 { count } else { 0 }
    }

    /// The matrix of a line; without one group of windows, where it is named.
    pub(super) fn matrix(&self, line: usize, without: Option<usize>) -> DMatrix<Complex64> {
        match (self, without) {
            (Self::Averages(spectrum), None) => spectrum.matrix(line),
            (Self::Averages(spectrum), Some(group)) => spectrum.matrix_without(group, line),
            (Self::Finer(spectrum), without) => spectrum.matrix(line, without),
        }
    }
}

/// Cross-spectral matrices by line, with or without one group of windows, made when they are asked for: modes need those
/// near them only.
pub(super) struct Matrices<'a> {
    pub(super) source: Source<'a>,
    without: Option<usize>,
    /// Lines that a tone is in, in order.
    taken: &'a [usize],
    lines: Vec<OnceLock<DMatrix<Complex64>>>,
}

/// With fewer lines there is no fit.
pub(super) const LEAST_LINES: usize = 5;

impl<'a> Matrices<'a> {
    pub(super) fn new(source: Source<'a>, without: Option<usize>, taken: &'a [usize]) -> Self {
        Self { source, without, taken, lines: vec![OnceLock::new(); source.grid().lines] }
    }

    pub(super) fn grid(&self) -> &LineGrid {
        self.source.grid()
    }

    /// Whether they are of all windows.
    pub(super) fn is_whole(&self) -> bool {
        self.without.is_none()
    }

    /// The lines from `first` to `last` that no tone is in; all of them where that leaves fewer than `least`.
    pub(super) fn free(&self, first: usize, last: usize, least: usize) -> Vec<usize> {
        let free: Vec<usize> = (first..=last).filter(|line| self.taken.binary_search(line).is_err()).collect();
        if free.len() < least { (first..=last).collect() } else { free }
    }

    pub(super) fn at(&self, line: usize) -> &DMatrix<Complex64> {
        self.lines[line].get_or_init(|| self.source.matrix(line, self.without))
    }
}

/// The filtered spectrum of some lines.
pub(super) fn bell(matrices: &Matrices<'_>, filter: &Shape, lines: &[usize]) -> Bell {
    let grid = matrices.grid();
    let density = |&line: &usize| filtered(filter, matrices.at(line)).max(f64::MIN_POSITIVE);
    Bell {
        frequency_hz: lines.iter().map(|&line| grid.frequency_hz(line)).collect(),
        density: lines.iter().map(density).collect(),
        duration_s: 1.0 / grid.spacing_hz(),
        mixed: None,
    }
}
