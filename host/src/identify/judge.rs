//! Judging picks: an estimate that the data do not determine is no mode.
//!
//! A peak of noise passes the picking rules now and then; its estimate then depends on a few windows, which the jackknife
//! shows. Estimates of all setups flow in; the pick to drop next, and why, flows out.

use super::curve::Misfit;
use super::kurtosis::{AT_TIMES_SIGMAS, CHANGING_LINES, Kurtosis, SUSPECTED_SIGMAS};
use super::merge::{combine, own_deviation};
use super::result::RejectedBecause;
use super::setup_mode::{SetupMode, SetupModes};
use super::shape::mac;

/// Standard deviation of a shape over its length, at most.
const MAX_SHAPE_NOISE: f64 = 0.5;
/// No structure has more damping; and less only where its lines show that.
const MAX_DAMPING: f64 = 0.2;
pub(super) const MIN_DAMPING: f64 = 5e-4;
/// Less is believed, as of a cable, where the lines that a mode was fitted to show its width: so many lie in its bandwidth, and its damping
/// is so many of its standard deviations, and no less than of a taut string.
const SHOWN_LINES: f64 = 0.5;
pub(super) const SHOWN_SIGMAS: f64 = 2.0;
const MIN_SHOWN_DAMPING: f64 = 1e-4;
/// So little is not believed of a pick whose kurtosis is that of a forced line, and so many standard deviations below a mode's.
const FORCED_SIGMAS: f64 = 2.0;
/// Less evidence of a force that is there at times will do where the damping is this share of what the other picks have.
pub(super) const UNUSUAL_DAMPING: f64 = 0.1;
/// Picks this far from each other, as a share of the frequency and in lines, do not bend each other.
const FAR_SHARE: f64 = 0.1;
const FAR_LINES: f64 = 20.0;
/// A pick that another method does not have is this many times as doubtful.
const UNSEEN: f64 = 2.0;
/// Two estimates within this many lines and half a bandwidth of each other are one mode where their MAC is above the second value; or above
/// the first, and their shapes differ by less than so many standard deviations, which may be scatter. Two modes of a pair may be alike,
/// too, as they have any directions in its plane; but the plane is known, and so they differ by more.
const DOUBLE_LINES: f64 = 1.0;
const DOUBLE_MAC: [f64; 2] = [0.5, 0.9];
const DOUBLE_SIGMAS: f64 = 5.0;
/// Standard deviation of the frequency in lines, or in bandwidths where these are wider, at most.
const MAX_FREQUENCY_LINES: f64 = 1.0;
const MAX_FREQUENCY_BANDWIDTHS: f64 = 0.15;
/// The same in bandwidths of one that was fitted to finer lines, which show how wide it is: its damping is then as large as its own
/// deviation (Au 2014).
const MAX_FINER_BANDWIDTHS: f64 = 0.5;

/// A wide resonance that is so far from the measured spectrum, in units of its scatter, bridges several modes.
pub(super) const BRIDGING_DAMPING: f64 = 0.04;
const MAX_MISFIT: f64 = 5.0;

/// Of the picks that may go, those that are no modes, and why: the least likely one, and with it those that are too far away to
/// have been bent by it. Those that another method was asked for and does not have are doubted more, and twins may be alike.
pub(super) fn worst(
    setups: &[SetupModes],
    spacing_hz: f64,
    may_go: impl Fn(usize) -> bool,
    is_unseen: impl Fn(usize) -> bool,
    is_twin: impl Fn(usize) -> bool,
) -> Vec<(usize, RejectedBecause)> {
    let picks = setups.iter().map(|setup| setup.modes.len()).min().unwrap_or(0);
    let estimates = |pick: usize| setups.iter().map(|setup| &setup.modes[pick]).collect::<Vec<_>>();
    let doubt_of = |pick: usize| {
        let here = estimates(pick);
        let is_double = |other: usize| {
            let are_twins = is_twin(pick) && is_twin(other);
            // What the user asked for stays, but where it is nothing it takes no mode's place.
            let is_anything = estimates(other).iter().any(|mode| mode.found);
            is_anything && is_double_of(&here, &estimates(other), spacing_hz, are_twins)
        };
        let doubled = (0..picks).any(|other| other != pick && is_double(other));
        let (doubt, because) =
            if doubled { (f64::INFINITY, RejectedBecause::Double) } else { doubt(&here, spacing_hz) };
        (if is_unseen(pick) { UNSEEN * doubt } else { doubt }, because)
    };
    let mut doubtful: Vec<(usize, (f64, RejectedBecause))> =
        (0..picks).filter(|&pick| may_go(pick)).map(|pick| (pick, doubt_of(pick))).collect();
    doubtful.retain(|(_, (doubt, _))| *doubt > 1.0);
    // What nobody else has goes first: without it the others may stand.
    doubtful.sort_by(|(a, (a_doubt, _)), (b, (b_doubt, _))| {
        is_unseen(*b).cmp(&is_unseen(*a)).then(b_doubt.total_cmp(a_doubt)).then(b.cmp(a))
    });
    let hz = |pick: usize| {
        let setup = setups.first().and_then(|setup| setup.modes.get(pick));
        setup.map_or(0.0, |mode| mode.resonance.frequency_hz)
    };
    let mut worst: Vec<(usize, RejectedBecause)> = Vec::new();
    for (pick, (_, because)) in doubtful {
        let far_hz = (FAR_SHARE * hz(pick)).max(FAR_LINES * spacing_hz);
        if worst.iter().all(|(other, _)| (hz(*other) - hz(pick)).abs() > far_hz) {
            worst.push((pick, because));
        }
    }
    worst
}

/// Whether the data do not determine a pick as a mode.
pub(super) fn is_doubtful(setups: &[SetupModes], spacing_hz: f64, pick: usize) -> bool {
    !worst(setups, spacing_hz, |other| other == pick, |_| false, |_| false).is_empty()
}

/// Whether what was estimated in every setup is a forced line: it has a forced line's kurtosis, and less damping than any structure, as its
/// spectrum is the window's own, or has the sidebands of a force that is there at times. `usual_damping` is the median of all picks', and
/// `spacing_hz` the distance of the lines that the kurtosis comes from.
pub(super) fn is_forced<'a>(
    kurtosis: &Kurtosis,
    usual_damping: f64,
    spacing_hz: f64,
    mut estimates: impl Iterator<Item = &'a SetupMode>,
) -> bool {
    let is_clear = kurtosis.sigmas_below > FORCED_SIGMAS;
    let is_undamped = |mode: &SetupMode| {
        let damping_ratio = mode.resonance.damping_ratio;
        if !kurtosis.is_at_times() {
            return has_no_width(mode) || (is_clear && damping_ratio < MIN_DAMPING);
        }
        // Chance has an envelope of few independent values, as of a cable, look like anything.
        let has_many_values = mode.resonance.bandwidth_hz() > CHANGING_LINES * spacing_hz;
        let is_unusual = damping_ratio < UNUSUAL_DAMPING * usual_damping;
        let least_sigmas = if is_unusual { SUSPECTED_SIGMAS } else { AT_TIMES_SIGMAS };
        damping_ratio < MIN_DAMPING && has_many_values && kurtosis.sigmas_below > least_sigmas
    };
    kurtosis.is_low() && estimates.all(is_undamped)
}

/// Whether a mode has less damping than any structure, unless its lines show that.
fn has_no_width(mode: &SetupMode) -> bool {
    let damping = mode.resonance.damping_ratio;
    let is_shown =
        damping > SHOWN_SIGMAS * mode.damping_std && mode.resonance.bandwidth_hz() > SHOWN_LINES * mode.spacing_hz;
    damping < if is_shown { MIN_SHOWN_DAMPING } else { MIN_DAMPING }
}

/// Whether the estimates are a second, weaker sight of another pick's mode: at the same place and alike, or so alike that
/// the jackknife could not tell them apart (it then leaves both as they are, without any scatter). Of twins, whose plane was seen before
/// they were fitted, any two directions in it are an answer, and only scatter makes one of two.
fn is_double_of(estimates: &[&SetupMode], others: &[&SetupMode], spacing_hz: f64, are_twins: bool) -> bool {
    let count = estimates.len().max(1) as f64;
    let pairs = || estimates.iter().zip(others);
    let mean = |of: &dyn Fn(&SetupMode, &SetupMode) -> f64| pairs().map(|(a, b)| of(a, b)).sum::<f64>() / count;
    let distance_hz = mean(&|a, b| (a.resonance.frequency_hz - b.resonance.frequency_hz).abs());
    let width_hz = mean(&|a, b| a.resonance.bandwidth_hz().max(b.resonance.bandwidth_hz()));
    let alike = mean(&|a, b| mac(&a.shape, &b.shape));
    let stuck = estimates.iter().all(|mode| mode.is_stuck());
    let weaker = mean(&|a, b| (a.peak_density / b.peak_density).ln()) < 0.0;
    let line_hz = mean(&|a, b| a.spacing_hz.max(b.spacing_hz)).min(spacing_hz);
    let scatter = mean(&|a, b| a.shape_noise.hypot(b.shape_noise));
    let [may_be, is] = DOUBLE_MAC;
    let is_scatter = (1.0 - alike).sqrt() < DOUBLE_SIGMAS * scatter;
    let is_alike = if are_twins { is_scatter } else { alike > is || (alike > may_be && is_scatter) };
    weaker && distance_hz < DOUBLE_LINES * line_hz + 0.5 * width_hz && (is_alike || stuck)
}

/// How doubtful it is that the estimates are of a mode, and what raises the doubt; above 1 they are not. Unknown uncertainties
/// raise no doubt.
fn doubt(estimates: &[&SetupMode], spacing_hz: f64) -> (f64, RejectedBecause) {
    let found: Vec<&&SetupMode> = estimates.iter().filter(|mode| mode.found).collect();
    if 2 * found.len() < estimates.len() || found.is_empty() {
        return (f64::INFINITY, RejectedBecause::NotShown);
    }
    // A setup that does not show the mode says nothing of it.
    let shape_noise = found.iter().map(|mode| mode.shape_noise).sum::<f64>() / found.len() as f64;
    let (frequency_hz, _) = combine(found.iter().map(|mode| (mode.resonance.frequency_hz, mode.frequency_std_hz)));
    // How sure each setup is: a structure that changed between setups has the mode all the same.
    let frequency_std_hz = own_deviation(found.iter().map(|mode| mode.frequency_std_hz));
    let (damping, _) = combine(found.iter().map(|mode| (mode.resonance.damping_ratio, mode.damping_std)));
    // No structure has so little damping: the fit took a line of noise for a resonance.
    let without_width = found.iter().filter(|mode| has_no_width(mode)).count();
    if damping < MIN_DAMPING && 2 * without_width >= found.len() {
        return (f64::INFINITY, RejectedBecause::Undamped);
    }
    let misfit = found.iter().filter_map(|mode| mode.misfit.filter(Misfit::is_significant)).map(|misfit| misfit.ratio);
    let bridged = if damping > BRIDGING_DAMPING { misfit.fold(0.0, f64::max) / MAX_MISFIT } else { 0.0 };
    let bandwidth_hz = 2.0 * damping * frequency_hz;
    let most_hz = if found.iter().all(|mode| mode.spacing_hz < spacing_hz) {
        MAX_FINER_BANDWIDTHS * bandwidth_hz
    } else {
        (MAX_FREQUENCY_LINES * spacing_hz).max(MAX_FREQUENCY_BANDWIDTHS * bandwidth_hz)
    };
    [
        (shape_noise / MAX_SHAPE_NOISE, RejectedBecause::Shape),
        (frequency_std_hz / most_hz, RejectedBecause::Frequency),
        (damping / MAX_DAMPING, RejectedBecause::Overdamped),
        (bridged, RejectedBecause::Bridge),
    ]
    .into_iter()
    .filter(|(doubt, _)| doubt.is_finite())
    .fold((0.0, RejectedBecause::Shape), |most, here| if here.0 > most.0 { here } else { most })
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;
    use crate::identify::curve::Curve;
    use crate::identify::resonance::{Quantity, Resonance};
    use crate::identify::scatter::GroupChanges;
    use crate::identify::shape::Shape;

    const SPACING_HZ: f64 = 0.01;

    /// A sound mode at a frequency; modes of odd numbers move unlike those of even ones.
    fn mode(frequency_hz: f64, number: usize) -> SetupMode {
        let component = |channel: usize| if (channel * number).is_multiple_of(2) { 1.0 } else { -1.0 };
        SetupMode {
            resonance: Resonance { frequency_hz, damping_ratio: 0.01, quantity: Quantity::Acceleration },
            shape: Shape::from_fn(4, |channel, _| Complex64::from(component(channel))),
            frequency_std_hz: 0.001,
            damping_std: 0.001,
            shape_std: vec![0.05; 4],
            shape_noise: 0.07,
            peak_density: 1.0,
            level: 1.0,
            found: true,
            curve: Curve::default(),
            misfit: None,
            changes: GroupChanges::unknown(4),
            collinearity: 1.0,
            in_plane: false,
            spacing_hz: SPACING_HZ,
        }
    }

    #[test]
    fn a_frequency_known_within_a_line_but_not_within_its_bandwidth_is_no_modes() {
        let wide = |mode: &mut SetupMode| {
            mode.frequency_std_hz = 0.009;
            mode.resonance.damping_ratio = 0.001;
        };
        assert!(judged(wide).is_empty(), "within a line");
        let finer = |mode: &mut SetupMode| {
            wide(mode);
            mode.spacing_hz = 0.1 * SPACING_HZ;
        };
        assert!(matches!(judged(finer).as_slice(), [(1, RejectedBecause::Frequency)]));
    }

    #[test]
    fn next_to_no_damping_is_believed_where_lines_show_it() {
        let cable = |spacing_hz: f64, damping_std: f64| {
            move |mode: &mut SetupMode| {
                mode.resonance.damping_ratio = 3e-4;
                mode.damping_std = damping_std;
                mode.frequency_std_hz = 1e-4;
                mode.spacing_hz = spacing_hz;
            }
        };
        // Its bandwidth is 0.0012 Hz.
        assert_eq!(judged(cable(0.001, 1e-4)), []);
        assert_eq!(judged(cable(0.005, 1e-4)), [(1, RejectedBecause::Undamped)], "less than half a line");
        assert_eq!(judged(cable(0.001, 2e-4)), [(1, RejectedBecause::Undamped)], "hardly known");
        let string = |mode: &mut SetupMode| {
            cable(1e-5, 1e-6)(mode);
            mode.resonance.damping_ratio = 5e-5;
            mode.frequency_std_hz = 1e-5;
        };
        assert_eq!(judged(string), [(1, RejectedBecause::Undamped)]);
    }

    /// Three sound modes, the second changed, and what is said of them.
    fn judged(change: impl Fn(&mut SetupMode)) -> Vec<(usize, RejectedBecause)> {
        judged_with(change, |_| false)
    }

    fn judged_with(
        change: impl Fn(&mut SetupMode),
        is_unseen: impl Fn(usize) -> bool,
    ) -> Vec<(usize, RejectedBecause)> {
        let mut modes = vec![mode(1.0, 0), mode(2.0, 1), mode(4.0, 0)];
        change(&mut modes[1]);
        worst(&[SetupModes { modes }], SPACING_HZ, |_| true, is_unseen, |_| false)
    }

    #[test]
    fn every_reason_is_told_from_the_others() {
        assert_eq!(judged(|_| {}), []);
        assert_eq!(judged(|mode| mode.found = false), [(1, RejectedBecause::NotShown)]);
        assert_eq!(judged(|mode| mode.resonance.damping_ratio = 1e-4), [(1, RejectedBecause::Undamped)]);
        assert_eq!(judged(|mode| mode.resonance.damping_ratio = 0.25), [(1, RejectedBecause::Overdamped)]);
        assert_eq!(judged(|mode| mode.shape_noise = 0.6), [(1, RejectedBecause::Shape)]);
        let bridge = |mode: &mut SetupMode| {
            mode.resonance.damping_ratio = 0.08;
            mode.misfit = Some(Misfit::of_ratio(11.0));
        };
        assert_eq!(judged(bridge), [(1, RejectedBecause::Bridge)]);
        // A line and a half of a mode that is four lines wide.
        assert_eq!(judged(|mode| mode.frequency_std_hz = 0.015), [(1, RejectedBecause::Frequency)]);
        let double = |mode: &mut SetupMode| {
            mode.resonance.frequency_hz = 1.005;
            mode.shape = Shape::from_element(4, Complex64::ONE);
            mode.peak_density = 0.5;
        };
        assert_eq!(judged(double), [(1, RejectedBecause::Double)]);
        // With the first mode's shape it has a MAC of 0.75.
        let of_a_pair = |mode: &mut SetupMode| {
            double(mode);
            mode.shape[3] = Complex64::ZERO;
        };
        assert_eq!(judged(of_a_pair), []);
        let scattered = |mode: &mut SetupMode| {
            of_a_pair(mode);
            mode.shape_noise = 0.1;
        };
        assert_eq!(judged(scattered), [(1, RejectedBecause::Double)]);
    }

    #[test]
    fn a_wide_mode_may_be_uncertain_by_a_share_of_its_bandwidth() {
        let wide = |mode: &mut SetupMode| {
            mode.resonance.damping_ratio = 0.05;
            mode.frequency_std_hz = 0.015;
        };
        assert_eq!(judged(wide), []);
        // What another method does not have is doubted twice as much: 0.015 of 0.03 Hz is the limit then.
        let wider = |mode: &mut SetupMode| {
            wide(mode);
            mode.frequency_std_hz = 0.016;
        };
        assert_eq!(judged(wider), []);
        assert_eq!(judged_with(wider, |pick| pick == 1), [(1, RejectedBecause::Frequency)]);
    }

    #[test]
    fn a_forced_line_is_told_by_its_kurtosis_and_its_width() {
        let of = |damping_ratio: f64| {
            let mut mode = mode(2.0, 0);
            mode.resonance.damping_ratio = damping_ratio;
            (mode.damping_std, mode.spacing_hz) = (0.2 * damping_ratio, 1e-4);
            mode
        };
        let kurtosis = |value: f64, sigmas_below: f64| Kurtosis { value, sigmas_below, ..Kurtosis::OF_A_MODE };
        let is_forced = |kurtosis: Kurtosis, damping: &[f64]| {
            let modes: Vec<SetupMode> = damping.iter().copied().map(of).collect();
            super::is_forced(&kurtosis, 1e-3, SPACING_HZ, modes.iter())
        };
        assert!(is_forced(kurtosis(1.6, 1.0), &[1e-5, 1e-5]));
        assert!(!is_forced(kurtosis(1.6, 1.0), &[1e-5, 3e-4]), "wide in one setup, and the kurtosis may be chance");
        assert!(is_forced(kurtosis(1.6, 2.5), &[1e-5, 3e-4]));
        assert!(!is_forced(kurtosis(1.6, 2.5), &[1e-5, 1e-3]));
        assert!(!is_forced(kurtosis(2.9, 0.3), &[1e-5, 1e-5]));
    }

    #[test]
    fn a_force_that_is_there_at_times_is_told_from_a_lightly_damped_mode() {
        let kurtosis = |sigmas_below: f64| Kurtosis { value: 3.0, sigmas_below, on_share: 0.5, ..Kurtosis::OF_A_MODE };
        let is_forced = |sigmas_below: f64, damping_ratio: f64, usual_damping: f64, spacing_hz: f64| {
            let mut mode = mode(2.0, 0);
            mode.resonance.damping_ratio = damping_ratio;
            super::is_forced(&kurtosis(sigmas_below), usual_damping, spacing_hz, [mode].iter())
        };
        // Its bandwidth is 0.0012 Hz.
        assert!(is_forced(2.5, 3e-4, 3e-4, 0.002) && !is_forced(2.2, 3e-4, 3e-4, 0.002));
        assert!(is_forced(2.2, 3e-4, 0.01, 0.002), "where all else is damped by 1 %, less evidence does");
        assert!(!is_forced(1.5, 3e-4, 0.01, 0.002) && !is_forced(2.2, 2e-3, 0.01, 0.002));
        assert!(!is_forced(3.0, 3e-4, 0.01, 0.01), "its envelope hardly changes during the record");
    }

    #[test]
    fn what_nobody_else_has_goes_first_and_far_ones_go_with_it() {
        let lost = |frequency_hz| SetupMode { found: false, ..mode(frequency_hz, 0) };
        let modes = vec![lost(1.0), lost(1.1), lost(2.0), mode(4.0, 0)];
        let went = worst(&[SetupModes { modes }], SPACING_HZ, |_| true, |pick| pick == 1, |_| false);
        // The first is within twenty lines of the second and waits.
        assert_eq!(went.iter().map(|(pick, _)| *pick).collect::<Vec<_>>(), [1, 2]);
    }
}
