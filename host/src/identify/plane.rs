//! A mode that was identified alone where the structure moves in two directions.
//!
//! Of two modes at one frequency, as of a round chimney, one may be all that is found. Its shape is then a direction in the plane of both,
//! and which one chance and their loads decide. A setup's modes and matrices flow in; those modes flow out with the other direction among
//! the errors of their shapes.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use super::matrices::Matrices;
use super::pick::{NOISE_FACTOR, PAIR_CHANNELS, PAIR_SHARE, domain_lines, projected};
use super::setup_mode::SetupMode;
use super::shape::Shape;
use super::singular::{leading, noise_edge};

/// The motion beside a mode's has its peak there too: it is so many times what it is so many bandwidths, or lines, away.
const PEAK: f64 = 3.0;
const AWAY_BANDWIDTHS: f64 = 3.0;
const AWAY_LINES: usize = 4;

/// Widens the shapes of modes that have none beside them, though the structure moves in two directions there.
pub(super) fn widen_lone(matrices: &Matrices<'_>, modes: &mut [SetupMode]) {
    let is_lone = |mode: &usize| {
        let here = modes[*mode].resonance;
        let is_beside = |other: &SetupMode| {
            let width_hz = here.bandwidth_hz().max(other.resonance.bandwidth_hz());
            (other.resonance.frequency_hz - here.frequency_hz).abs() < width_hz
        };
        // Itself is one.
        modes.iter().filter(|other| is_beside(other)).count() < 2
    };
    let lone: Vec<usize> = (0..modes.len()).filter(is_lone).collect();
    let found: Vec<(usize, DVector<f64>)> =
        lone.into_iter().filter_map(|mode| Some((mode, other_direction(matrices, modes, mode)?))).collect();
    for (mode, direction) in found {
        let mode = &mut modes[mode];
        // All of it is an error of the real parts, which compare with a model's.
        mode.shape_std.iter_mut().zip(direction.iter()).for_each(|(std, error)| *std = std.hypot(*error));
        mode.changes.beside = DMatrix::from_columns(&[direction]);
        mode.in_plane = true;
    }
}

/// The direction in which a mode's place moves beside the modes that are known; as long as the mode's shape may be off along it.
fn other_direction(matrices: &Matrices<'_>, modes: &[SetupMode], mode: usize) -> Option<DVector<f64>> {
    let grid = matrices.grid();
    let here = &modes[mode];
    if here.shape.len() < PAIR_CHANNELS || !here.found {
        return None;
    }
    let line = grid.nearest_line(here.resonance.frequency_hz);
    let reach_hz = 2.0 * domain_lines(grid, line) as f64 * grid.spacing_hz();
    let distance_hz = |other: &&SetupMode| (other.resonance.frequency_hz - here.resonance.frequency_hz).abs();
    let mut near: Vec<&SetupMode> = modes.iter().filter(|other| distance_hz(other) < reach_hz).collect();
    near.sort_by(|a, b| distance_hz(a).total_cmp(&distance_hz(b)));
    near.truncate(here.shape.len() / 2);
    let shapes: Vec<&Shape> = near.iter().map(|mode| &mode.shape).collect();
    let beside = |line: usize| leading(projected(matrices.at(line).clone(), &shapes));
    let is_free = |line: usize| matrices.free(line, line, 0) == [line];
    if !is_free(line) {
        return None;
    }
    let (whole, other) = (leading(matrices.at(line).clone()).value, beside(line));
    let edge = noise_edge(&other.values, shapes.len(), matrices.source.averages())?;
    if other.value < PAIR_SHARE * whole || other.value < NOISE_FACTOR * edge {
        return None;
    }
    let away = AWAY_LINES.max((AWAY_BANDWIDTHS * here.resonance.bandwidth_hz() / grid.spacing_hz()).round() as usize);
    let below = (0..=line.saturating_sub(away)).rev().find(|&line| is_free(line));
    let above = ((line + away).min(grid.lines - 1)..grid.lines).find(|&line| is_free(line));
    let sides: Vec<usize> = [below, above].into_iter().flatten().filter(|side| *side != line).collect();
    let is_peak = !sides.is_empty() && sides.into_iter().all(|side| other.value > PEAK * beside(side).value);
    // Two modes of like strength whose shapes are a small angle apart have their strongest direction half-way, and the square root of what
    // is left there is half the angle too.
    let turn = (other.value / whole).sqrt().min(1.0) * here.shape.norm();
    is_peak.then(|| most_real(&other.vector).map(|component| turn * component))
}

/// The real parts of a vector of the phase that makes them largest together.
fn most_real(vector: &Shape) -> DVector<f64> {
    let squares: Complex64 = vector.iter().map(|component| component * component).sum();
    let turn = Complex64::from_polar(1.0, -0.5 * squares.arg());
    vector.map(|component| (component * turn).re)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::identify::estimate::estimate;
    use crate::identify::matrices::Source;
    use crate::identify::pick::Pick;
    use crate::identify::resonance::Quantity;
    use crate::simulate::modal::{Recording, Truth};
    use crate::spectra::CrossSpectrum;

    /// A structure of eight channels that has two modes: at 0.5 Hz and at another frequency, the second at rest in channel 1.
    pub(in crate::identify) fn two_modes(other_hz: f64) -> Truth {
        let wave = |channel: usize, order: usize| (0.4 * (order * (channel + 1)) as f64).sin();
        // The two are alike by a half: loads that are correlated do the same to those that are not.
        let other = |channel: usize| if channel == 0 { 0.0 } else { 0.5 * wave(channel, 1) + 0.8 * wave(channel, 2) };
        let shapes = DMatrix::from_fn(8, 2, |channel, mode| if mode == 0 { wave(channel, 1) } else { other(channel) });
        Truth { frequencies_hz: vec![0.5, other_hz], damping_ratio: 0.01, shapes }
    }

    pub(in crate::identify) fn recorded(truth: &Truth, seed: u64) -> CrossSpectrum {
        truth.recorded(&Recording { band_hz: [0.3, 1.0], ..Recording::of(5.0, 4.0, seed) }).unwrap()
    }

    /// The modes picked at these frequencies, of a structure of two modes, and the first one's shape.
    fn modes(other_hz: f64, picked_hz: &[f64], taken_lines: usize, seed: u64) -> (Vec<SetupMode>, Shape) {
        let truth = two_modes(other_hz);
        let shape = truth.shapes.column(0).map(Complex64::from);
        let spectrum = recorded(&truth, seed);
        let source = Source::Averages(&spectrum);
        let pick = |&hz: &f64| {
            let line = source.grid().nearest_line(hz);
            Pick::new(line, vec![leading(source.matrix(line, None)).vector])
        };
        let picks: Vec<Pick> = picked_hz.iter().map(pick).collect();
        let line = source.grid().nearest_line(0.5);
        let taken: Vec<usize> = (line - taken_lines / 2..line + taken_lines.div_ceil(2)).collect();
        (estimate(&spectrum, Quantity::Acceleration, 0, &picks, &taken).modes, shape)
    }

    /// How far a mode's shape is from a true one, in its standard deviations, component by component.
    fn z(mode: &SetupMode, truth: &Shape) -> Vec<f64> {
        let along = truth.dotc(&mode.shape) / truth.norm_squared();
        let errors = mode.shape.iter().zip(truth.iter()).map(|(value, truth)| (value - along * truth).re);
        errors.zip(&mode.shape_std).map(|(error, std)| error / std).collect()
    }

    fn rms(values: &[f64]) -> f64 {
        (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn a_twin_that_is_not_found_makes_the_shape_as_uncertain_as_it_can_be() {
        let mut all = Vec::new();
        for seed in 0..10 {
            let (modes, truth) = modes(0.5, &[0.5], 0, seed);
            assert!(modes[0].in_plane);
            all.extend(z(&modes[0], &truth));
            let own: f64 = modes[0].changes.beside.column(0).norm_squared();
            let whole: f64 = modes[0].shape_std.iter().map(|std| std * std).sum();
            assert!((0.7..=1.0).contains(&(own / whole)), "the deviation is mostly the other direction's");
        }
        // How far the strongest direction is from the mode depends on loads and likeness, which are not known: it is a limit.
        assert!((0.3..1.3).contains(&rms(&all)), "{}", rms(&all));
    }

    #[test]
    fn other_modes_do_not_make_it_uncertain_whether_they_are_found_or_not() {
        // A mode is 0.01 Hz wide: the other is three bandwidths away, found, or not.
        for picked_hz in [&[0.5, 0.53][..], &[0.5]] {
            let (modes, _) = modes(0.53, picked_hz, 0, 3);
            assert!(!modes[0].in_plane && modes[0].changes.beside.ncols() == 0, "{picked_hz:?}");
        }
        let (both, _) = modes(0.504, &[0.5, 0.504], 0, 3);
        assert!(!both[0].in_plane && !both[1].in_plane, "a pair speaks for itself");
        let (beside_a_tone, _) = modes(0.5, &[0.5], 3, 3);
        assert!(!beside_a_tone[0].in_plane, "a tone's lines say nothing");
    }

    #[test]
    fn the_phase_that_a_direction_has_does_not_matter() {
        let direction = DVector::from_vec(vec![0.0, 0.6, -0.8]);
        let turned = direction.map(|component| Complex64::from_polar(component, 1.3));
        let found = most_real(&turned);
        assert!((found.dot(&direction).abs() - 1.0).abs() < 1e-12);
    }
}
