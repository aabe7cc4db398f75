//! Judging picks: an estimate that the data do not determine is no mode.
//!
//! A peak of noise passes the picking rules now and then; its estimate then hangs on a few windows, and the jackknife shows it.

use super::estimate::{SetupMode, SetupModes};
use super::merge::combine;

/// Standard deviation of a shape over its length, at most.
const MAX_SHAPE_NOISE: f64 = 0.5;
/// Damping ratios beyond these are no structure's.
const MAX_DAMPING: f64 = 0.2;
const MIN_DAMPING: f64 = 5e-4;
/// Standard deviation of the frequency in lines, at most.
const MAX_FREQUENCY_LINES: f64 = 1.0;

/// The pick that is least likely to be a mode, if one is not.
pub(super) fn worst(setups: &[SetupModes], spacing_hz: f64) -> Option<usize> {
    let picks = setups.iter().map(|setup| setup.modes.len()).min().unwrap_or(0);
    let doubts = (0..picks).map(|pick| {
        let estimates: Vec<&SetupMode> = setups.iter().map(|setup| &setup.modes[pick]).collect();
        (doubt(&estimates, spacing_hz), pick)
    });
    doubts.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(doubt, _)| *doubt > 1.0).map(|(_, pick)| pick)
}

/// Whether a pick has no damping that a structure could have: a forced line's spectrum is the window's own.
pub(super) fn is_undamped(setups: &[SetupModes], pick: usize) -> bool {
    let estimates = setups.iter().filter_map(|setup| setup.modes.get(pick));
    estimates.clone().count() > 0 && estimates.clone().all(|mode| mode.resonance.damping_ratio < MIN_DAMPING)
}

/// How far the estimates are from being a mode's; above 1 they are none. Uncertainties that are not known raise no doubt.
fn doubt(estimates: &[&SetupMode], spacing_hz: f64) -> f64 {
    let found: Vec<&&SetupMode> = estimates.iter().filter(|mode| mode.found).collect();
    if 2 * found.len() < estimates.len() || found.is_empty() {
        return f64::INFINITY;
    }
    let shape_noise = |mode: &&SetupMode| {
        let variance: f64 = mode.shape_std.iter().map(|std| 2.0 * std * std).sum();
        (variance / mode.shape.norm_squared()).sqrt()
    };
    let shape_noise = estimates.iter().map(shape_noise).sum::<f64>() / estimates.len() as f64;
    let (_, frequency_std_hz) = combine(found.iter().map(|mode| (mode.resonance.frequency_hz, mode.frequency_std_hz)));
    let (damping, _) = combine(found.iter().map(|mode| (mode.resonance.damping_ratio, mode.damping_std)));
    [shape_noise / MAX_SHAPE_NOISE, frequency_std_hz / (MAX_FREQUENCY_LINES * spacing_hz), damping / MAX_DAMPING]
        .into_iter()
        .filter(|doubt| doubt.is_finite())
        .fold(0.0, f64::max)
}
