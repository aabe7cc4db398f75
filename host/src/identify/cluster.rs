//! Clusters of close modes: which belong together, and how channels and clusters see each other.
//!
//! Shapes and bells that were found one by one flow in; the modes of a cluster, fitted together, flow out. Within the span
//! of its shapes the joint fit says how they mix; what leaves that span follows from the regression of all channels on
//! the modal responses (a step of expectation and maximisation; Li and Au 2019).

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use super::bell::Resonance;
use super::joint::{JointFit, Seen};
use super::shape::Shape;

/// Modes nearer than this many bandwidths, or lines, to the next belong together.
const CLOSE_BANDWIDTHS: f64 = 5.0;
const CLOSE_LINES: f64 = 3.0;
/// Modes in one cluster, at most.
const LARGEST: usize = 4;
/// A channel's noise is not taken to be below this share of its power.
const LEAST_NOISE: f64 = 1e-7;

/// Groups modes (their places in the list) that are to be fitted together; `channels` limits how many can be told apart.
pub(super) fn clusters(resonances: &[Resonance], spacing_hz: f64, channels: usize) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..resonances.len()).collect();
    order.sort_by(|&a, &b| resonances[a].frequency_hz.total_cmp(&resonances[b].frequency_hz));
    let gap = |a: usize, b: usize| (resonances[b].frequency_hz - resonances[a].frequency_hz).abs();
    let mut clusters: Vec<Vec<usize>> = Vec::new();
    for mode in order {
        let reach = |other: usize| {
            let bandwidth_hz = resonances[mode].bandwidth_hz().max(resonances[other].bandwidth_hz());
            (CLOSE_BANDWIDTHS * bandwidth_hz).max(CLOSE_LINES * spacing_hz)
        };
        match clusters.last_mut() {
            Some(cluster) if cluster.last().is_some_and(|&last| gap(last, mode) < reach(last)) => cluster.push(mode),
            _ => clusters.push(vec![mode]),
        }
    }
    let most = LARGEST.min(channels / 2).max(1);
    let mut small = Vec::new();
    while let Some(mut cluster) = clusters.pop() {
        if cluster.len() <= most {
            small.push(cluster);
            continue;
        }
        // At its widest gap.
        let widest = (1..cluster.len())
            .max_by(|&a, &b| gap(cluster[a - 1], cluster[a]).total_cmp(&gap(cluster[b - 1], cluster[b])))
            .unwrap_or(1);
        let upper = cluster.split_off(widest);
        clusters.extend([cluster, upper]);
    }
    small
}

/// Filters of a cluster: what they make of the channels, and of the channels' noise.
pub(super) struct Filters {
    /// modes x channels: the modes' responses, the stopped ones' taken out.
    pub(super) rows: DMatrix<Complex64>,
    /// modes x modes: covariance of the channels' noise behind the filters.
    pub(super) noise: DMatrix<Complex64>,
}

impl Filters {
    /// The best linear filters for `own` shapes beside `stopped` ones in noise of the given variances (generalised least
    /// squares). `None` where the shapes are not independent.
    pub(super) fn new(own: &[&Shape], stopped: &[&Shape], variances: &[f64]) -> Option<Self> {
        let all: Vec<&Shape> = own.iter().chain(stopped).copied().collect();
        let channels = variances.len();
        let weighted = DMatrix::from_fn(channels, all.len(), |row, column| all[column][row] / variances[row]);
        let shapes = DMatrix::from_fn(channels, all.len(), |row, column| all[column][row]);
        let gram = shapes.adjoint() * &weighted;
        let inverse = gram.cholesky()?.inverse();
        let rows = (&inverse * weighted.adjoint()).rows(0, own.len()).into_owned();
        let noise = inverse.view((0, 0), (own.len(), own.len())).into_owned();
        (rows.iter().all(|value| value.is_finite())).then_some(Self { rows, noise })
    }
}

/// Noise of each channel: its power outside the span of the shapes, over some lines.
pub(super) fn noise_variances(shapes: &[&Shape], matrices: &[DMatrix<Complex64>]) -> Vec<f64> {
    let channels = matrices.first().map_or(0, DMatrix::nrows);
    let columns = DMatrix::from_fn(channels, shapes.len(), |row, column| shapes[column][row]);
    let directions = columns.qr().q();
    let outside = DMatrix::identity(channels, channels) - &directions * directions.adjoint();
    let mut left: DVector<f64> = DVector::zeros(channels);
    let mut power: DVector<f64> = DVector::zeros(channels);
    for matrix in matrices {
        let projected = &outside * matrix;
        for channel in 0..channels {
            // Diagonal of (outside matrix outside).
            let value: Complex64 = (0..channels).map(|k| projected[(channel, k)] * outside[(k, channel)]).sum();
            left[channel] += value.re;
            power[channel] += matrix[(channel, channel)].re;
        }
    }
    (0..channels)
        .map(|channel| {
            // Noise loses that part of itself to the span.
            let share = outside[(channel, channel)].re.max(0.05);
            (left[channel] / share).max(LEAST_NOISE * power[channel]).max(f64::MIN_POSITIVE)
                / matrices.len().max(1) as f64
        })
        .collect()
}

/// The cluster as its filters see it.
pub(super) fn seen(
    filters: &Filters,
    matrices: &[DMatrix<Complex64>],
    frequency_hz: Vec<f64>,
    duration_s: f64,
    averages: f64,
) -> Seen {
    let through = |matrix: &DMatrix<Complex64>| &filters.rows * matrix * filters.rows.adjoint();
    Seen {
        frequency_hz,
        matrices: matrices.iter().map(through).collect(),
        noise: filters.noise.clone(),
        duration_s,
        averages,
    }
}

/// Shapes from the regression of all channels on the modal responses that the fit sees, of unit length, and the factor on
/// the levels that goes with it; in the order of the cluster. `None` where it has no solution.
pub(super) fn regressed_shapes(
    fit: &JointFit,
    filters: &Filters,
    seen: &Seen,
    matrices: &[DMatrix<Complex64>],
) -> Option<Vec<(Shape, f64)>> {
    let size = fit.levels.len();
    let channels = filters.rows.ncols();
    let mut cross: DMatrix<Complex64> = DMatrix::zeros(channels, size);
    let mut power: DMatrix<Complex64> = DMatrix::zeros(size, size);
    let noise = DMatrix::from_fn(size, size, |i, j| seen.noise[(i, j)] * (fit.noise[i] * fit.noise[j]));
    for ((&frequency_hz, matrix), reduced) in seen.frequency_hz.iter().zip(matrices).zip(&seen.matrices) {
        let spectra = fit.modal_spectra(frequency_hz, seen.duration_s);
        let gain = &spectra * fit.mixture.adjoint();
        let expected = &fit.mixture * &gain + &noise;
        // eta = P Aᴴ S⁻¹ W y
        let estimate = &gain * expected.try_inverse()?;
        // Lines weigh as what noise leaves in them.
        cross += matrix * (&estimate * &filters.rows).adjoint();
        power += &spectra - &estimate * &fit.mixture * &spectra + &estimate * reduced * estimate.adjoint();
    }
    let shapes = cross * power.try_inverse()?;
    let column = |mode: usize| {
        let shape: Shape = shapes.column(mode).into_owned();
        let norm = shape.norm();
        (norm.is_finite() && norm > 0.0).then(|| (shape / Complex64::from(norm), norm * norm))
    };
    (0..size).map(column).collect()
}
