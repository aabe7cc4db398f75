//! Clusters of close modes: which belong together, and how channels and clusters see each other.
//!
//! Shapes and bells that were found one by one flow in; the modes of a cluster, fitted together, flow out. Within the span
//! of its shapes the joint fit says how they mix; what leaves that span follows from the regression of all channels on
//! the modal responses (a step of expectation and maximisation; Li and Au 2019).

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::bell::Resonance;
use super::joint::{JointFit, Seen, SlopePrior};
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

/// Noise of each channel: its mean power outside the span of the shapes, over some lines.
pub(super) fn noise_variances(shapes: &[&Shape], matrices: &[DMatrix<Complex64>]) -> Vec<f64> {
    let channels = matrices.first().map_or(0, DMatrix::nrows);
    let columns = DMatrix::from_fn(channels, shapes.len(), |row, column| shapes[column][row]);
    let directions = columns.qr().q();
    let outside = DMatrix::identity(channels, channels) - &directions * directions.adjoint();
    let mut mean = DMatrix::zeros(channels, channels);
    for matrix in matrices {
        mean += matrix;
    }
    mean /= Complex64::from(matrices.len().max(1) as f64);
    let left = (&outside * &mean * &outside).diagonal().map(|power| power.re);
    // Independent noise N leaves sum_k |outside_ck|² N_k at channel c.
    let solved = outside.map(|value| value.norm_sqr()).lu().solve(&left);
    (0..channels)
        .map(|channel| {
            let plain = left[channel] / outside[(channel, channel)].re.max(0.05);
            let least = (0.1 * plain).max(LEAST_NOISE * mean[(channel, channel)].re).max(f64::MIN_POSITIVE);
            solved.as_ref().map_or(plain, |noise| noise[channel].min(10.0 * plain)).max(least)
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
    slope: SlopePrior,
) -> Seen {
    let through = |matrix: &DMatrix<Complex64>| &filters.rows * matrix * filters.rows.adjoint();
    Seen {
        frequency_hz,
        matrices: matrices.iter().map(through).collect(),
        noise: filters.noise.clone(),
        duration_s,
        averages,
        slope,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::bell::Quantity;

    #[test]
    fn close_modes_belong_together_and_large_groups_part_at_their_widest_gap() {
        let at = |frequencies: &[f64]| -> Vec<Resonance> {
            let one =
                |&frequency_hz: &f64| Resonance { frequency_hz, damping_ratio: 0.01, quantity: Quantity::Acceleration };
            frequencies.iter().map(one).collect()
        };
        let sorted = |frequencies: &[f64], channels: usize| {
            let mut clusters = clusters(&at(frequencies), 0.001, channels);
            clusters.sort();
            clusters
        };
        assert_eq!(sorted(&[1.02, 2.0, 1.0], 20), [vec![1], vec![2, 0]]);
        assert_eq!(sorted(&[1.0, 1.02, 1.06, 1.08, 1.1], 20), [vec![0, 1], vec![2, 3, 4]]);
        assert_eq!(sorted(&[1.0, 1.02], 3), [vec![0], vec![1]]);
        assert!(sorted(&[], 20).is_empty());
    }

    #[test]
    fn filters_pass_their_own_modes_stop_the_others_and_trust_quiet_channels() {
        let shape = |values: [f64; 4]| Shape::from_iterator(4, values.map(Complex64::from));
        let (own, other) = (shape([1.0, 0.5, 0.2, 0.9]), shape([0.1, -0.7, 1.0, 0.3]));
        let filters = Filters::new(&[&own], &[&other], &[1e-3, 1e-3, 1e-3, 10.0]).unwrap();
        assert!(((&filters.rows * &own)[0] - Complex64::ONE).norm() < 1e-12);
        assert!((&filters.rows * &other)[0].norm() < 1e-12);
        assert!(filters.rows[(0, 3)].norm() < 1e-3 * filters.rows[(0, 0)].norm());
        assert!(filters.noise[(0, 0)].re > 0.0);
        assert!(Filters::new(&[&own], &[&own], &[1.0; 4]).is_none_or(|filters| filters.noise[(0, 0)].re > 1e6));
    }

    #[test]
    fn what_no_shape_explains_is_noise() {
        let shape = Shape::from_iterator(5, (1..6).map(|k| Complex64::from(f64::from(k))));
        let variances = [0.1, 0.2, 0.1, 0.3, 0.05];
        let noise = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&variances)).map(Complex64::from);
        let matrix = &shape * shape.adjoint() * Complex64::from(7.0) + noise;
        for (found, made) in noise_variances(&[&shape], &[matrix.clone(), matrix]).into_iter().zip(variances) {
            assert!((found / made - 1.0).abs() < 1e-9, "{found} {made}");
        }
    }
}
