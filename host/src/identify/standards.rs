//! What is listed as a mode must be one, and its deviations must be possible.
//!
//! An identification flows in when both methods have said what they have to; it flows out without modes whose fit never moved or whose
//! parts move at all phases, which stand among the rejected, and with deviations that are not far below what any method can reach, and wide
//! enough for what the second method found.

use super::choice::asked_for;
use super::fit::usual_damping;
use super::judge::{MIN_DAMPING, UNUSUAL_DAMPING};
use super::merge::number;
use super::result::{Identification, Mode, ModeMethod, Rejected, RejectedBecause, place};

/// A deviation below this share of the lower bound says that the fit ran into a wall: chance alone halves it now and then.
const LEAST_OF_BOUND: f64 = 0.1;
/// Deviations are estimates, which scatter by a quarter: chance makes one this share of what any method can reach. The bound holds for random
/// loads; a structure that is shaken otherwise may be known better.
const BELOW_BOUND: f64 = 0.5;
/// Below this collinearity the parts of a shape move at all phases, as noise does; below the second one a warning says so. Of a pair whose
/// directions are not known each may be any mixture.
const LEAST_COLLINEARITY: f64 = 0.2;
const COLLINEAR: f64 = 0.6;
/// Where the second method's value is so many of its own deviations away, chance does not explain the difference.
const DIFFERENT_SIGMAS: f64 = 2.0;

/// Takes out what is no mode, and widens deviations that are too small.
pub fn hold_to_standards(identification: &mut Identification) {
    let asked_for = asked_for(identification);
    let usual_damping = usual_damping(identification.modes.iter().map(|mode| mode.damping_ratio));
    let is_asked_for = |mode: &Mode| asked_for.contains(&mode.number);
    let mut kept = Vec::new();
    for mut mode in std::mem::take(&mut identification.modes) {
        match fault(&mode, usual_damping).filter(|_| !is_asked_for(&mode)) {
            Some(because) => {
                identification.rejected.push(Rejected { frequency_hz: mode.frequency_hz, because });
                identification.say_no_more_of(&mode);
            }
            None => {
                widen(&mut mode);
                kept.push(mode);
            }
        }
    }
    identification.modes = kept;
    number(&mut identification.modes);
    identification.rejected.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let of_no_line = |mode: &&Mode| mode.pair_with.is_none() && mode.phase_collinearity_as_measured < COLLINEAR;
    let warnings = identification.modes.iter().filter(of_no_line).map(|mode| {
        format!(
            "{}: its parts do not move in phase (phase collinearity {:.2} as measured, noise and all); it may be two modes, or sensors or a machine may bend it",
            place(mode.frequency_hz),
            mode.phase_collinearity_as_measured
        )
    });
    identification.warnings.extend(warnings.collect::<Vec<_>>());
}

/// Why a mode is none. `usual_damping` is the median of all modes'.
fn fault(mode: &Mode, usual_damping: f64) -> Option<RejectedBecause> {
    let is_stuck = mode.frequency_std_hz < LEAST_OF_BOUND * mode.frequency_std_bound_hz
        || mode.damping_ratio_std < LEAST_OF_BOUND * mode.damping_ratio_std_bound;
    let is_narrow =
        mode.lines_in_bandwidth < 1.0 && mode.damping_ratio < MIN_DAMPING.min(UNUSUAL_DAMPING * usual_damping);
    let has_no_shape = mode.phase_collinearity_as_measured < LEAST_COLLINEARITY && mode.pair_with.is_none();
    if is_stuck {
        Some(RejectedBecause::Stuck)
    } else if is_narrow {
        Some(RejectedBecause::Narrow)
    } else if has_no_shape {
        Some(RejectedBecause::Phases)
    } else {
        None
    }
}

/// Makes deviations no smaller than half of the lower bound (Au 2014), and wide enough for what the second method found.
fn widen(mode: &mut Mode) {
    let bounds = [mode.frequency_std_bound_hz, mode.damping_ratio_std_bound];
    let other = mode.second_opinion.as_ref().filter(|_| mode.method == ModeMethod::Spectra);
    let other = other
        .map(|other| [(other.frequency_hz, other.frequency_std_hz), (other.damping_ratio, other.damping_ratio_std)]);
    let own = [(mode.frequency_hz, &mut mode.frequency_std_hz), (mode.damping_ratio, &mut mode.damping_ratio_std)];
    for (place, (value, std)) in own.into_iter().enumerate() {
        *std = std.max(BELOW_BOUND * bounds[place]);
        let Some((other, other_std)) = other.map(|other| other[place]) else { continue };
        let (difference, chance) = (value - other, other_std.max(bounds[place]));
        if difference.abs() > DIFFERENT_SIGMAS * chance {
            // Whatever makes the two differ by more than chance may be in either.
            *std = std.hypot((difference * difference - chance * chance).sqrt());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;
    use crate::identify::pick::Pick;
    use crate::identify::ssi::SecondOpinion;

    /// A mode at 2 Hz of 1 % damping, an hour of record: the bounds are 0.00094 Hz and 0.047 %.
    fn mode() -> Mode {
        Mode {
            frequency_hz: 2.0,
            frequency_std_hz: 1e-3,
            damping_ratio: 0.01,
            damping_ratio_std: 5e-4,
            frequency_std_bound_hz: 9.4e-4,
            damping_ratio_std_bound: 4.7e-4,
            phase_collinearity_as_measured: 0.99,
            lines_in_bandwidth: 8.0,
            ..found().modes.remove(0)
        }
    }

    /// A mode that the user asked for or not.
    fn held(mode: Mode, by_user: bool) -> Identification {
        let mut identification = Identification { modes: vec![Mode { pick: Some(0), ..mode }], ..found() };
        identification.basis.picks = vec![Pick { by_user, ..Pick::new(0, Vec::new()) }];
        hold_to_standards(&mut identification);
        identification
    }

    #[test]
    fn a_fit_that_never_moved_and_a_shape_of_all_phases_are_no_modes() {
        let stuck = Mode { damping_ratio_std: 1e-9, ..mode() };
        let phases = Mode { phase_collinearity_as_measured: 0.05, ..mode() };
        for (bad, because) in [(stuck.clone(), RejectedBecause::Stuck), (phases, RejectedBecause::Phases)] {
            let held = held(bad, false);
            assert!(held.modes.is_empty());
            assert_eq!(held.rejected, [Rejected { frequency_hz: 2.0, because }]);
        }
        assert_eq!(held(stuck, true).modes.len(), 1, "the user's word counts");
        let sharp = |mode: Mode| Mode { lines_in_bandwidth: 0.5, damping_ratio: 3e-4, ..mode };
        let mut beside = Identification { modes: vec![mode(), mode(), sharp(mode())], ..found() };
        hold_to_standards(&mut beside);
        assert_eq!(beside.rejected, [Rejected { frequency_hz: 2.0, because: RejectedBecause::Narrow }]);
        assert_eq!(held(sharp(mode()), false).modes.len(), 1, "where all modes are as sharp, as of cables");
        let of_a_pair = Mode { phase_collinearity_as_measured: 0.05, pair_with: Some(2), ..mode() };
        assert_eq!(held(of_a_pair, false).modes.len(), 1);
        assert_eq!(held(mode(), false).warnings, Vec::<String>::new());
        let doubtful = Mode { phase_collinearity_as_measured: 0.5, ..mode() };
        assert_eq!(held(doubtful, false).warnings.len(), 1);
    }

    #[test]
    fn deviations_are_not_far_below_the_bound_and_hold_what_the_second_method_found() {
        let kept = |mode: Mode| held(mode, false).modes.remove(0);
        assert_eq!(kept(mode()).frequency_std_hz, 1e-3);
        assert_eq!(kept(Mode { frequency_std_hz: 2e-4, ..mode() }).frequency_std_hz, 4.7e-4);
        assert_eq!(kept(Mode { frequency_std_hz: 6e-4, ..mode() }).frequency_std_hz, 6e-4);
        let with = |frequency_hz: f64| {
            let opinion = SecondOpinion {
                frequency_hz,
                frequency_std_hz: 2e-3,
                damping_ratio: 0.01,
                damping_ratio_std: 1e-3,
                mac: 1.0,
                agrees: true,
            };
            kept(Mode { second_opinion: Some(opinion), ..mode() })
        };
        assert_eq!(with(2.0035).frequency_std_hz, 1e-3, "within two deviations");
        let far = with(2.006);
        let expected = (1e-3_f64.powi(2) + 6e-3_f64.powi(2) - 2e-3_f64.powi(2)).sqrt();
        assert!((far.frequency_std_hz - expected).abs() < 1e-9);
        assert_eq!(far.damping_ratio_std, 5e-4);
    }
}
