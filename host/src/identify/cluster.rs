//! Clusters of close modes: which belong together, and how channels and clusters see each other.
//!
//! Shapes and bells that were found one by one flow in; the modes of a cluster, fitted together, flow out. Within the span
//! of its shapes the joint fit says how they mix; what leaves that span follows from the regression of all channels on
//! the modal responses (a step of expectation and maximisation; Li and Au 2019).

use belfry_numerics::complex_product;
use nalgebra::DMatrix;
use num_complex::Complex64;

use super::joint::{JointFit, Seen, SlopePrior};
use super::resonance::Resonance;
use super::shape::{Shape, of_unit_length};

/// Modes nearer than this many bandwidths, or lines, to the next belong together.
pub(super) const CLOSE_BANDWIDTHS: f64 = 5.0;
const CLOSE_LINES: f64 = 3.0;
/// Modes in one cluster, at most.
const LARGEST: usize = 4;
/// A shape is read from the lines within this many bandwidths of its mode: further away other modes weigh more.
const RESONANCE: f64 = 0.5;
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
    /// The same for the stopped modes.
    stopped: DMatrix<Complex64>,
    /// modes x modes: covariance of the channels' noise behind the filters.
    pub(super) noise: DMatrix<Complex64>,
}

impl Filters {
    /// Least-squares filters for `own` shapes beside `stopped` ones in noise of the given variance on every channel. `None`
    /// where the shapes are not independent.
    pub(super) fn new(own: &[&Shape], stopped: &[&Shape], variance: f64) -> Option<Self> {
        let all: Vec<&Shape> = own.iter().chain(stopped).copied().collect();
        let channels = all.first()?.len();
        let shapes = DMatrix::from_fn(channels, all.len(), |row, column| all[column][row]);
        let gram = shapes.adjoint() * &shapes;
        let inverse = gram.cholesky()?.inverse();
        let all = &inverse * shapes.adjoint();
        let rows = all.rows(0, own.len()).into_owned();
        let stopped = all.rows(own.len(), stopped.len()).into_owned();
        let noise = inverse.view((0, 0), (own.len(), own.len())) * Complex64::from(variance);
        (rows.iter().all(|value| value.is_finite())).then_some(Self { rows, stopped, noise })
    }
}

/// Noise of a channel: the mean power outside the span of the shapes, over some lines. One figure for all channels: what is
/// left is as much the motion of modes outside the band, which is not independent, as it is noise, so that weights by
/// channel would trust the channels that move least.
pub(super) fn noise_variance(shapes: &[&Shape], matrices: &[&DMatrix<Complex64>]) -> f64 {
    let channels = matrices.first().map_or(0, |matrix| matrix.nrows());
    let columns = DMatrix::from_fn(channels, shapes.len(), |row, column| shapes[column][row]);
    let directions = columns.qr().q();
    let mut mean = DMatrix::zeros(channels, channels);
    for &matrix in matrices {
        mean += matrix;
    }
    mean /= Complex64::from(matrices.len().max(1) as f64);
    let power = mean.trace().re;
    let inside = (directions.adjoint() * &mean * &directions).trace().re;
    let left = (power - inside) / channels.saturating_sub(shapes.len()).max(1) as f64;
    left.max(LEAST_NOISE * power).max(f64::MIN_POSITIVE)
}

/// The cluster as its filters see it.
pub(super) fn seen(
    filters: &Filters,
    matrices: &[&DMatrix<Complex64>],
    frequency_hz: Vec<f64>,
    duration_s: f64,
    averages: f64,
    slope: SlopePrior,
) -> Seen {
    let columns = filters.rows.adjoint();
    let through = |matrix: &DMatrix<Complex64>| complex_product(&complex_product(&filters.rows, matrix), &columns);
    Seen {
        frequency_hz,
        matrices: matrices.iter().copied().map(through).collect(),
        noise: filters.noise.clone(),
        duration_s,
        averages,
        slope,
    }
}

/// Shapes from the regression of all channels on the modal responses that the fit sees, of unit length, and the factor on
/// the levels that goes with it; in the order of the cluster. `None` where it has no solution.
///
/// The stopped modes' responses take part: forces on different modes are correlated, and without them a weak mode's shape
/// would take up what a strong neighbour does at the same time.
pub(super) fn regressed_shapes(
    fit: &JointFit,
    filters: &Filters,
    seen: &Seen,
    matrices: &[&DMatrix<Complex64>],
) -> Option<Vec<(Shape, f64)>> {
    let size = fit.levels.len();
    let channels = filters.rows.ncols();
    let whole = size + filters.stopped.nrows();
    let mut rows = DMatrix::zeros(whole, channels);
    rows.rows_mut(size, whole - size).copy_from(&filters.stopped);
    let mut shapes = Vec::new();
    for (mode, resonance) in fit.resonances.iter().enumerate() {
        let mut cross: DMatrix<Complex64> = DMatrix::zeros(channels, whole);
        let mut power: DMatrix<Complex64> = DMatrix::zeros(whole, whole);
        let reach_hz = (RESONANCE * resonance.bandwidth_hz()).max(1.5 / seen.duration_s);
        let near = |hz: f64| (hz - resonance.frequency_hz).abs() <= reach_hz;
        let (near_hz, matrices): (Vec<f64>, Vec<&DMatrix<Complex64>>) =
            seen.frequency_hz.iter().zip(matrices).filter(|(hz, _)| near(**hz)).unzip();
        let spectra = fit.modal_spectra(&near_hz, seen.duration_s);
        for ((&frequency_hz, matrix), spectra) in near_hz.iter().zip(matrices).zip(spectra) {
            let gain = &spectra * fit.mixture.adjoint();
            let expected = &fit.mixture * &gain + fit.noise_seen(seen, frequency_hz);
            // eta = P Aᴴ S⁻¹ W y
            let estimate = &gain * expected.try_inverse()?;
            rows.rows_mut(0, size).copy_from(&(&estimate * &filters.rows));
            let seen_with = matrix * rows.adjoint();
            power += &rows * &seen_with;
            cross += seen_with;
            // What the responses themselves are uncertain by.
            let mut own = power.view_mut((0, 0), (size, size));
            own += &spectra - &estimate * &fit.mixture * &spectra;
        }
        let mut unit = nalgebra::DVector::zeros(whole);
        unit[mode] = Complex64::ONE;
        let shape: Shape = cross * power.lu().solve(&unit)?;
        shapes.push(of_unit_length(shape)?);
    }
    Some(shapes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::resonance::Quantity;

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
    fn filters_pass_their_own_modes_and_stop_the_others() {
        let shape = |values: [f64; 4]| Shape::from_iterator(4, values.map(Complex64::from));
        let (own, other) = (shape([1.0, 0.5, 0.2, 0.9]), shape([0.1, -0.7, 1.0, 0.3]));
        let filters = Filters::new(&[&own], &[&other], 1e-3).unwrap();
        assert!(((&filters.rows * &own)[0] - Complex64::ONE).norm() < 1e-12);
        assert!((&filters.rows * &other)[0].norm() < 1e-12);
        // Independent noise of 1e-3 on every channel.
        assert!((filters.noise[(0, 0)].re / (1e-3 * filters.rows.norm_squared()) - 1.0).abs() < 1e-9);
        assert!(Filters::new(&[&own], &[&own], 1.0).is_none_or(|filters| filters.noise[(0, 0)].re > 1e6));
    }

    #[test]
    fn what_no_shape_explains_is_noise() {
        let shape = Shape::from_iterator(5, (1..6).map(|k| Complex64::from(f64::from(k))));
        let matrix = &shape * shape.adjoint() * Complex64::from(7.0) + DMatrix::identity(5, 5) * Complex64::from(0.3);
        assert!((noise_variance(&[&shape], &[&matrix, &matrix]) - 0.3).abs() < 1e-9);
    }
}
