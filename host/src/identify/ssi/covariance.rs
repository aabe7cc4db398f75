//! Covariances of a sub-band, as functions of the lag, from averaged cross-spectral matrices.
//!
//! A setup's matrices flow in. A sub-band's lines, tapered towards its edges, are transformed to covariances of the complex
//! signal that the sub-band holds, critically sampled; these flow out, projected on the few directions of most energy, for the
//! whole record and for each group of windows that is left out.
//!
//! A taper W that is smooth over the sub-band multiplies each mode's covariance by a constant and leaves its decay and frequency as
//! they are. What the taper's edges, white noise and the smooth part of the spectrum add dies out within some lags; the
//! covariances are read beyond those.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, SymmetricEigen};
use num_complex::Complex64;

use crate::identify::resonance::hann_autocorrelation;
use crate::spectra::{CrossSpectrum, LineGrid};
use crate::statistics::largest_first;

/// Lines of the narrowest sub-bands, and how much wider those of the next level are.
const NARROWEST: usize = 64;
const WIDER: usize = 4;
/// With fewer references more lags make up for them.
const ENOUGH_REFERENCES: usize = 3;
/// Share of a sub-band that each flank takes where it borders on another, and lines where the grid ends.
const INNER_FLANK: f64 = 0.375;
const OUTER_FLANK_LINES: usize = 6;
/// Where modes count: this share of the sub-band away from its inner edges, so many lines from the grid's ends. Nearer to these the
/// taper's kernel is as long as all lags that are read, and frequency and damping come out wrong by some standard deviations.
const INNER_MARGIN: f64 = 0.25;
pub(in crate::identify) const OUTER_MARGIN_LINES: f64 = OUTER_FLANK_LINES as f64;
/// The first lag that is read: the taper's kernel has died out there.
const FIRST_LAG: usize = 2;
/// The last lag as a share of the segment: beyond, the window's autocorrelation at the segment's length less the lag, which the
/// transform of spectral lines adds, is more than 2 % of that at the lag.
const LAST_LAG: f64 = 0.3;
/// Lags that are read at most.
const MOST_LAGS: usize = 28;
/// Wide sub-bands are summed to about this many bins of lines: their lags are so short that a bin's lines turn almost alike.
const BINS: usize = 128;
/// Directions that are analysed, and those of them that serve as references (Peeters and De Roeck 1999).
const MOST_OUTPUTS: usize = 6;
const MOST_REFERENCES: usize = 4;

/// Consecutive lines that are analysed together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SubBand {
    /// The first line's index in the grid.
    pub(super) first: usize,
    /// How many lines.
    pub(super) lines: usize,
    /// Lines of the flanks at either end.
    flanks: [usize; 2],
    /// Frequencies at which its modes count, in Hz.
    pub(super) middle_hz: [f64; 2],
    /// Bandwidths that its lags can tell, in Hz.
    pub(super) bandwidths_hz: [f64; 2],
}

/// Covariances at consecutive lags.
#[derive(Debug, Clone)]
pub(super) struct Covariances {
    /// Between the outputs and the references.
    pub(super) outputs: Vec<DMatrix<Complex64>>,
    /// Between all channels and the references.
    pub(super) channels: Vec<DMatrix<Complex64>>,
}

/// What all covariances of a sub-band share.
#[derive(Debug, Clone)]
pub(super) struct Reading {
    band: SubBand,
    /// Orthonormal directions, most energy first; the outputs.
    directions: DMatrix<Complex64>,
    /// How many of them are references.
    pub(super) references: usize,
    lags: Vec<usize>,
    /// The frequency that turns to zero, in Hz.
    centre_hz: f64,
    /// Time between lags in s.
    pub(super) interval_s: f64,
}

/// The sub-bands of a grid: levels of ever wider ones, for modes of ever more bandwidth. Those of a level overlap by half, so that
/// every frequency is in the middle of one.
pub(super) fn sub_bands(grid: &LineGrid, channels: usize) -> Vec<SubBand> {
    let narrowest = if channels < ENOUGH_REFERENCES { 2 * NARROWEST } else { NARROWEST };
    let mut bands = Vec::new();
    let mut lines = narrowest;
    let mut least_hz = 0.0;
    loop {
        let is_last = 2 * lines > 3 * grid.lines / 2;
        let lines_here = if is_last { grid.lines } else { lines };
        // A mode whose covariance falls to a tenth within eight lags still decides about several.
        let most_hz = if is_last { f64::INFINITY } else { lines_here as f64 / 11.0 * grid.spacing_hz() };
        bands.extend(level(grid, lines_here, [least_hz, most_hz]));
        if is_last {
            return bands;
        }
        least_hz = 0.6 * most_hz;
        lines *= WIDER;
    }
}

fn level(grid: &LineGrid, lines: usize, bandwidths_hz: [f64; 2]) -> impl Iterator<Item = SubBand> {
    let rest = grid.lines - lines;
    let steps = rest.div_ceil((lines / 2).max(1));
    (0..=steps).map(move |step| {
        let first = (rest * step).checked_div(steps).unwrap_or(0);
        let (is_first, is_last) = (first == 0, first == rest);
        let outer = OUTER_FLANK_LINES.min(lines / 4);
        let inner = (INNER_FLANK * lines as f64) as usize;
        let margin = |is_outer: bool| if is_outer { OUTER_MARGIN_LINES } else { INNER_MARGIN * lines as f64 };
        let at_hz = |line: f64| (grid.first_line as f64 + first as f64 + line) * grid.spacing_hz();
        SubBand {
            first,
            lines,
            flanks: [if is_first { outer } else { inner }, if is_last { outer } else { inner }],
            middle_hz: [at_hz(margin(is_first)), at_hz(lines as f64 - 1.0 - margin(is_last))],
            bandwidths_hz,
        }
    })
}

/// What summing `bin` lines of `lines` does to the covariance at a lag (Dirichlet's kernel).
fn bin_kernel(lag: usize, bin: usize, lines: usize) -> f64 {
    let half_turn = std::f64::consts::PI * lag as f64 / lines as f64;
    (bin as f64 * half_turn).sin() / (bin as f64 * half_turn.sin())
}

impl Covariances {
    /// The covariances at the first lags.
    pub(super) fn first(&self, lags: usize) -> Self {
        let first = |all: &[DMatrix<Complex64>]| all[..lags.min(all.len())].to_vec();
        Self { outputs: first(&self.outputs), channels: first(&self.channels) }
    }

    /// How many lags.
    pub(super) fn lags(&self) -> usize {
        self.outputs.len()
    }
}

impl SubBand {
    /// The taper: flanks of a polynomial whose first three derivatives vanish at either end, so that the lags beyond its kernel
    /// hold next to nothing of what is smooth in frequency.
    fn taper(&self, line: usize) -> f64 {
        let flank = |distance: usize, flank: usize| {
            let x = ((distance + 1) as f64 / (flank + 1) as f64).min(1.0);
            x.powi(4) * (35.0 - 84.0 * x + 70.0 * x * x - 20.0 * x * x * x)
        };
        flank(line, self.flanks[0]) * flank(self.lines - 1 - line, self.flanks[1])
    }
}

impl Reading {
    /// Reads a sub-band: chooses its directions and returns its covariances over the whole record. `None` where it is too
    /// narrow, or holds nothing.
    pub(super) fn new(spectrum: &CrossSpectrum, band: SubBand) -> Option<(Self, Covariances)> {
        let grid = spectrum.grid();
        let last = ((LAST_LAG * band.lines as f64) as usize).min(FIRST_LAG + MOST_LAGS - 1);
        let lags: Vec<usize> = (FIRST_LAG..=last).collect();
        if lags.len() < 4 {
            return None;
        }
        let centre = band.first + band.lines / 2;
        let mut reading = Self {
            band,
            directions: DMatrix::zeros(0, 0),
            references: 0,
            lags,
            centre_hz: grid.frequency_hz(centre),
            interval_s: 1.0 / (grid.spacing_hz() * band.lines as f64),
        };
        let whole = reading.transformed(spectrum, None, |sum| sum);
        let channels = spectrum.channels().len();
        let mut energy: DMatrix<Complex64> = DMatrix::zeros(channels, channels);
        for covariance in &whole {
            energy += covariance * covariance.adjoint() + covariance.adjoint() * covariance;
        }
        if !energy.iter().all(|value| value.is_finite()) || energy.trace().re <= 0.0 {
            return None;
        }
        let eigen = SymmetricEigen::new(energy);
        let mut order = largest_first(eigen.eigenvalues.as_slice());
        order.truncate(MOST_OUTPUTS);
        reading.references = order.len().min(MOST_REFERENCES);
        reading.directions = eigen.eigenvectors.select_columns(&order);
        let references = reading.directions.columns(0, reading.references).into_owned();
        let of_channels = whole.iter().map(|covariance| covariance * &references).collect();
        let covariances = reading.projected(of_channels);
        Some((reading, covariances))
    }

    /// The covariances without one group of windows.
    pub(super) fn without(&self, spectrum: &CrossSpectrum, group: usize) -> Covariances {
        let references = self.directions.columns(0, self.references).into_owned();
        self.projected(self.transformed(spectrum, Some(group), |sum| sum * &references))
    }

    fn projected(&self, channels: Vec<DMatrix<Complex64>>) -> Covariances {
        let adjoint = self.directions.adjoint();
        Covariances { outputs: channels.iter().map(|covariance| &adjoint * covariance).collect(), channels }
    }

    /// Tapers matrices, sums them over bins of lines, applies `transformed` to the sums, transforms them to lags, and divides by
    /// the autocorrelation of the Hann window and the kernel of the bins.
    fn transformed(
        &self,
        spectrum: &CrossSpectrum,
        without: Option<usize>,
        transformed: impl Fn(DMatrix<Complex64>) -> DMatrix<Complex64>,
    ) -> Vec<DMatrix<Complex64>> {
        let lines = self.band.lines;
        let turns: Vec<Complex64> = (0..lines).map(|n| Complex64::cis(TAU * n as f64 / lines as f64)).collect();
        // Odd, so that a bin's centre is a line.
        let bin = (lines / BINS) / 2 * 2 + 1;
        let kernels: Vec<f64> = self.lags.iter().map(|&lag| bin_kernel(lag, bin, lines)).collect();
        let taper: Vec<f64> = (0..lines).map(|line| self.band.taper(line)).collect();
        let mut sums: Vec<DMatrix<Complex64>> = Vec::new();
        let mut first = 0;
        while first < lines {
            // What is left at the end of a number of lines that bins do not divide is taken line by line.
            let count = if first + bin <= lines { bin } else { 1 };
            let weights = &taper[first..first + count];
            let here = transformed(spectrum.weighted_sum(self.band.first + first, weights, without));
            sums.resize_with(self.lags.len(), || DMatrix::zeros(here.nrows(), here.ncols()));
            let offset = first + count / 2 + lines - lines / 2;
            for ((sum, &lag), kernel) in sums.iter_mut().zip(&self.lags).zip(&kernels) {
                let turn = turns[offset * lag % lines] * if count == bin { 1.0 } else { *kernel };
                for (sum, value) in sum.as_mut_slice().iter_mut().zip(here.as_slice()) {
                    *sum += turn * value;
                }
            }
            first += count;
        }
        for ((sum, &lag), kernel) in sums.iter_mut().zip(&self.lags).zip(&kernels) {
            *sum /= Complex64::from(kernel * hann_autocorrelation(lag as f64 / lines as f64));
        }
        sums
    }

    /// The pole in 1/s of one of the sampled signal. The frequency is that of the band's centre and the pole's turn.
    pub(super) fn pole(&self, sampled: Complex64) -> Complex64 {
        sampled.ln() / self.interval_s + Complex64::new(0.0, TAU * self.centre_hz)
    }

    /// How it moves when the sampled one does.
    pub(super) fn pole_change(&self, sampled: Complex64, change: Complex64) -> Complex64 {
        change / sampled / self.interval_s
    }

    /// The variance in (m/s²)² of a mode whose part of the first covariance this is.
    pub(super) fn variance(&self, first: Complex64, sampled: Complex64) -> f64 {
        let lines = self.band.lines;
        let line = (sampled.arg() / TAU * lines as f64).round() + (lines / 2) as f64;
        let weight = self.band.taper(line.clamp(0.0, (lines - 1) as f64) as usize);
        (first / sampled.powu(FIRST_LAG as u32)).re.max(0.0) / weight / (self.interval_s * lines as f64)
    }
}
