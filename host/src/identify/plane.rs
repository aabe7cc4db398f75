//! A mode that stands alone where the structure moves in two directions.
//!
//! Of two modes at one frequency, as of a round chimney, one may be all that is found. Its shape is then a direction in the plane of both,
//! and which one chance and their loads decide. A setup's modes and matrices flow in; those modes flow out with the other direction among
//! the errors of their shapes.

use nalgebra::DMatrix;

use super::matrices::Matrices;
use super::pick::{PAIR_CHANNELS, PAIR_SHARE, domain_lines, projected};
use super::setup_mode::SetupMode;
use super::shape::Shape;
use super::singular::{Leading, leading, noise_edge};

/// The motion beside a mode's has its peak there too: it is so many times what it is so many bandwidths, or lines, away on both sides.
const PEAK: f64 = 3.0;
const AWAY_BANDWIDTHS: f64 = 3.0;
const AWAY_LINES: usize = 4;
/// It stands so far above what noise alone would have.
const NOISE_FACTOR: f64 = 2.0;

/// Widens the shapes of modes that have none beside them, though the structure moves in two directions there.
pub(super) fn widen_lone(matrices: &Matrices<'_>, modes: &mut [SetupMode]) {
    let is_lone = |mode: usize| {
        let distance_hz =
            |other: usize| (modes[other].resonance.frequency_hz - modes[mode].resonance.frequency_hz).abs();
        (0..modes.len()).all(|other| other == mode || distance_hz(other) > modes[mode].resonance.bandwidth_hz())
    };
    let lone: Vec<usize> = (0..modes.len()).filter(|&mode| is_lone(mode)).collect();
    let found: Vec<(usize, Shape)> =
        lone.into_iter().filter_map(|mode| Some((mode, other_direction(matrices, modes, mode)?))).collect();
    for (mode, direction) in found {
        let mode = &mut modes[mode];
        for (std, component) in mode.shape_std.iter_mut().zip(direction.iter()) {
            *std = std.hypot(component.norm());
        }
        let groups = mode.changes.groups();
        if groups > 0 {
            mode.changes.frequency_hz.push(0.0);
            mode.changes.damping_ratio.push(0.0);
            let real = DMatrix::from_iterator(direction.len(), 1, direction.iter().map(|component| component.re));
            let shape = std::mem::replace(&mut mode.changes.shape, DMatrix::zeros(0, 0));
            let mut wider = shape.insert_column(groups, 0.0);
            wider.set_column(groups, &real.column(0));
            mode.changes.shape = wider;
        }
        mode.in_plane = true;
    }
}

/// The direction in which a mode's place moves beside the modes that are known; as long as the mode's shape may be off along it.
fn other_direction(matrices: &Matrices<'_>, modes: &[SetupMode], mode: usize) -> Option<Shape> {
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
    let beside = |line: usize| -> Leading { leading(projected(matrices.at(line).clone(), &shapes)) };
    let (whole, other) = (leading(matrices.at(line).clone()).value, beside(line));
    let edge = noise_edge(&other.values, matrices.source.averages())?;
    if other.value < PAIR_SHARE * whole || other.value < NOISE_FACTOR * edge {
        return None;
    }
    let away = AWAY_LINES.max((AWAY_BANDWIDTHS * here.resonance.bandwidth_hz() / grid.spacing_hz()).round() as usize);
    let sides = [line.checked_sub(away), Some(line + away).filter(|&line| line < grid.lines)];
    let is_peak = sides.into_iter().flatten().all(|side| other.value > PEAK * beside(side).value);
    // Two modes of like strength whose shapes are a small angle apart have their strongest direction half-way, and the square root of what
    // is left there is half the angle too.
    let turn = (other.value / whole).sqrt().min(1.0) * here.shape.norm();
    is_peak.then(|| other.vector.scale(turn))
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;
    use crate::identify::estimate::estimate;
    use crate::identify::matrices::Source;
    use crate::identify::pick::Pick;
    use crate::identify::resonance::Quantity;
    use crate::simulate::modal::{Recording, Truth};

    /// The mode at 0.5 Hz alone, of a structure of eight channels with one at another frequency besides.
    fn lone_mode(other_hz: f64) -> (SetupMode, Shape) {
        let wave = |channel: usize, order: usize| (0.4 * (order * (channel + 1)) as f64).sin();
        let shapes =
            DMatrix::from_fn(8, 2, |channel, mode| if mode == 0 { wave(channel, 1) } else { 0.8 * wave(channel, 2) });
        let shape = shapes.column(0).map(num_complex::Complex64::from);
        let truth = Truth { frequencies_hz: vec![0.5, other_hz], damping_ratio: 0.01, shapes };
        let spectrum = truth.recorded(&Recording { band_hz: [0.3, 1.0], ..Recording::of(5.0, 4.0, 7) }).unwrap();
        let source = Source::Averages(&spectrum);
        let line = source.grid().nearest_line(0.5);
        let pick = Pick::new(line, vec![leading(source.matrix(line, None)).vector]);
        let mut modes = estimate(&spectrum, Quantity::Acceleration, 0, &[pick], &[]).modes;
        (modes.remove(0), shape)
    }

    /// How far a mode's shape is from a true one, in its standard deviations (rms).
    fn error_in_deviations(mode: &SetupMode, truth: &Shape) -> f64 {
        let along = truth.dotc(&mode.shape) / truth.norm_squared();
        let errors = mode.shape.iter().zip(truth.iter()).map(|(value, truth)| (value - along * truth).norm());
        let z: Vec<f64> = errors.zip(&mode.shape_std).map(|(error, std)| (error / std).powi(2)).collect();
        (z.iter().sum::<f64>() / z.len() as f64).sqrt()
    }

    #[test]
    fn a_twin_that_is_not_found_makes_the_shape_uncertain_in_its_direction() {
        let (mode, truth) = lone_mode(0.5);
        assert!(mode.in_plane);
        assert!(error_in_deviations(&mode, &truth) < 2.0, "{}", error_in_deviations(&mode, &truth));
        // What the covariance of its numbers is made of knows of it as well.
        assert_eq!(mode.changes.shape.ncols(), mode.changes.frequency_hz.len());
        let last = mode.changes.shape.column(mode.changes.shape.ncols() - 1);
        assert!(last.norm() > 0.2 * mode.shape.norm());
    }

    #[test]
    fn a_mode_far_away_that_is_not_found_does_not() {
        let (mode, truth) = lone_mode(0.8);
        assert!(!mode.in_plane);
        assert!(error_in_deviations(&mode, &truth) < 3.0, "{}", error_in_deviations(&mode, &truth));
    }
}
