//! Judging picks: an estimate that the data do not determine is no mode.
//!
//! A peak of noise passes the picking rules now and then; its estimate then depends on a few windows, which the jackknife
//! shows. Estimates of all setups flow in; the pick to drop next, and why, flows out.

use super::merge::combine;
use super::result::RejectedBecause;
use super::scatter::noise_share;
use super::setup_mode::{SetupMode, SetupModes};
use super::shape::mac;

/// Standard deviation of a shape over its length, at most.
const MAX_SHAPE_NOISE: f64 = 0.5;
/// No structure has damping ratios beyond these.
const MAX_DAMPING: f64 = 0.2;
pub(super) const MIN_DAMPING: f64 = 5e-4;
/// A pick that another method does not have is this many times as doubtful.
const UNSEEN: f64 = 2.0;
/// Two estimates within this many lines and half a bandwidth, with a MAC above this, are one mode.
const DOUBLE_LINES: f64 = 1.0;
const DOUBLE_MAC: f64 = 0.5;
/// Standard deviation of the frequency in lines, or in bandwidths where these are wider, at most.
const MAX_FREQUENCY_LINES: f64 = 1.0;
const MAX_FREQUENCY_BANDWIDTHS: f64 = 0.15;

/// Of the picks that may go, the one that is least likely to be a mode, if one is not, and why. Those that another method was
/// asked for and does not have are doubted more.
pub(super) fn worst(
    setups: &[SetupModes],
    spacing_hz: f64,
    may_go: impl Fn(usize) -> bool,
    is_unseen: impl Fn(usize) -> bool,
) -> Option<(usize, RejectedBecause)> {
    let picks = setups.iter().map(|setup| setup.modes.len()).min().unwrap_or(0);
    let estimates = |pick: usize| setups.iter().map(|setup| &setup.modes[pick]).collect::<Vec<_>>();
    let doubts = (0..picks).map(|pick| {
        let here = estimates(pick);
        let doubled = (0..picks).any(|other| other != pick && is_double_of(&here, &estimates(other), spacing_hz));
        let (doubt, because) =
            if doubled { (f64::INFINITY, RejectedBecause::Double) } else { doubt(&here, spacing_hz) };
        let doubt = (if is_unseen(pick) { UNSEEN * doubt } else { doubt }, because);
        (doubt, pick)
    });
    let doubts = doubts.filter(|((doubt, _), pick)| may_go(*pick) && *doubt > 1.0);
    // What nobody else has goes first: without it the others may stand.
    let order = |((doubt, _), pick): &((f64, RejectedBecause), usize)| (is_unseen(*pick), *doubt);
    let worst = doubts.max_by(|a, b| {
        let ((a_unseen, a_doubt), (b_unseen, b_doubt)) = (order(a), order(b));
        a_unseen.cmp(&b_unseen).then(a_doubt.total_cmp(&b_doubt))
    });
    worst.map(|((_, reason), pick)| (pick, reason))
}

/// Whether the data do not determine a pick as a mode.
pub(super) fn is_doubtful(setups: &[SetupModes], spacing_hz: f64, pick: usize) -> bool {
    worst(setups, spacing_hz, |other| other == pick, |_| false).is_some()
}

/// Whether a pick has less damping than any structure: the spectrum of a forced line is the window's own.
pub(super) fn is_undamped(setups: &[SetupModes], pick: usize) -> bool {
    let estimates = setups.iter().filter_map(|setup| setup.modes.get(pick));
    estimates.clone().count() > 0 && estimates.clone().all(|mode| mode.resonance.damping_ratio < MIN_DAMPING)
}

/// Whether the estimates are a second, weaker sight of another pick's mode: at the same place and alike, or so alike that
/// the jackknife could not tell them apart (it then leaves both as they are, without any scatter).
fn is_double_of(estimates: &[&SetupMode], others: &[&SetupMode], spacing_hz: f64) -> bool {
    let count = estimates.len().max(1) as f64;
    let pairs = || estimates.iter().zip(others);
    let mean = |of: &dyn Fn(&SetupMode, &SetupMode) -> f64| pairs().map(|(a, b)| of(a, b)).sum::<f64>() / count;
    let distance_hz = mean(&|a, b| (a.resonance.frequency_hz - b.resonance.frequency_hz).abs());
    let width_hz = mean(&|a, b| a.resonance.bandwidth_hz().max(b.resonance.bandwidth_hz()));
    let alike = mean(&|a, b| mac(&a.shape, &b.shape));
    let stuck = mean(&|a, _| a.frequency_std_hz) == 0.0;
    let weaker = mean(&|a, b| (a.peak_density / b.peak_density).ln()) < 0.0;
    weaker && distance_hz < DOUBLE_LINES * spacing_hz + 0.5 * width_hz && (alike > DOUBLE_MAC || stuck)
}

/// How doubtful it is that the estimates are of a mode, and what raises the doubt; above 1 they are not. Unknown uncertainties
/// raise no doubt.
fn doubt(estimates: &[&SetupMode], spacing_hz: f64) -> (f64, RejectedBecause) {
    let found: Vec<&&SetupMode> = estimates.iter().filter(|mode| mode.found).collect();
    if 2 * found.len() < estimates.len() || found.is_empty() {
        return (f64::INFINITY, RejectedBecause::NotShown);
    }
    let shape_noise = estimates.iter().map(|mode| noise_share(&mode.shape, &mode.shape_std)).sum::<f64>();
    let shape_noise = shape_noise / estimates.len() as f64;
    let (frequency_hz, frequency_std_hz) =
        combine(found.iter().map(|mode| (mode.resonance.frequency_hz, mode.frequency_std_hz)));
    let (damping, _) = combine(found.iter().map(|mode| (mode.resonance.damping_ratio, mode.damping_std)));
    // No structure has so little damping: the fit took a line of noise for a resonance.
    if damping < MIN_DAMPING {
        return (f64::INFINITY, RejectedBecause::Undamped);
    }
    // A fit that does not move at all from replicate to replicate has run into a wall.
    if frequency_std_hz == 0.0 {
        return (f64::INFINITY, RejectedBecause::Frequency);
    }
    let bandwidth_hz = 2.0 * damping * frequency_hz;
    let most_hz = (MAX_FREQUENCY_LINES * spacing_hz).max(MAX_FREQUENCY_BANDWIDTHS * bandwidth_hz);
    [
        (shape_noise / MAX_SHAPE_NOISE, RejectedBecause::Shape),
        (frequency_std_hz / most_hz, RejectedBecause::Frequency),
        (damping / MAX_DAMPING, RejectedBecause::Overdamped),
    ]
    .into_iter()
    .filter(|(doubt, _)| doubt.is_finite())
    .fold((0.0, RejectedBecause::Shape), |most, here| if here.0 > most.0 { here } else { most })
}
