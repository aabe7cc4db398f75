//! From picks to modes: all are estimated, the one that is least likely to be a mode goes, and so on until all stand.
//!
//! Picks flow in; an identification flows out, and in it what the next fit may start from.

use super::choice::meant_hz;
use super::estimate;
use super::judge;
use super::merge;
use super::pick::Pick;
use super::result::{Identification, Mode, Rejected, RejectedBecause, SingularSpectrum};
use super::setup::{MeasuredSetup, quantity};
use super::setup_mode::{SetupMode, SetupModes};
use super::tone::{self, Tone};
use super::twins::Lone;
use crate::spectra::LineGrid;
use crate::statistics::median;
use crate::study::band_at;

/// What a fit stands on.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Basis {
    /// The picks, in the order of their lines.
    pub(super) picks: Vec<Pick>,
    /// Picks that are forced lines.
    pub(super) harmonics: Vec<Pick>,
    /// What was picked and is no mode.
    pub(super) rejected: Vec<Rejected>,
    /// What is to be said of the picks.
    pub(super) warnings: Vec<String>,
    /// Bands that the user has chosen for the modes in them.
    pub(super) bands_hz: Vec<[f64; 2]>,
    /// Picks that the fit leaves alone where the structure moves in two directions.
    pub(super) lone: Vec<Lone>,
}

/// Fits the picks and takes out what is no mode.
pub(super) fn fit(
    measured: &[MeasuredSetup<'_>],
    grid: &LineGrid,
    mut basis: Basis,
    singular: Vec<SingularSpectrum>,
) -> Identification {
    let Basis { picks, harmonics, rejected, bands_hz, warnings, .. } = &mut basis;
    for pick in picks.iter_mut() {
        pick.band_hz = band_at(bands_hz, pick.frequency_hz(grid));
    }
    let mut setups = Vec::new();
    // Where the user asks for modes that would not stay otherwise.
    let mut doubted_hz: Vec<f64> = Vec::new();
    loop {
        tone::one_each(harmonics);
        let tones = tones(harmonics);
        // The sidebands of what goes on and off at random reach as far as a resonance does: they are fitted like one.
        let machines = harmonics.iter().filter(|pick| pick.kurtosis.is_at_times());
        let machines = machines.map(|pick| Pick { is_machine: true, ..pick.clone() });
        let fitted: Vec<Pick> = picks.iter().cloned().chain(machines).collect();
        let estimate = |(index, m): (usize, &MeasuredSetup<'_>)| {
            let taken = tone::lines(&m.spectrum, &tones);
            let mut setup = estimate::estimate(&m.spectrum, quantity(m.setup), index, &fitted, &taken);
            setup.modes.truncate(picks.len());
            setup
        };
        setups.splice(.., measured.iter().enumerate().map(estimate));
        let estimates = |pick: usize| setups.iter().filter_map(move |setup: &SetupModes| setup.modes.get(pick));
        let usual_damping =
            usual_damping((0..picks.len()).flat_map(estimates).map(|mode| mode.resonance.damping_ratio));
        let is_forced =
            |pick: &usize| judge::is_forced(&picks[*pick].kurtosis, usual_damping, grid.spacing_hz(), estimates(*pick));
        let may_go = |pick: usize| !picks[pick].by_user;
        // A pick that is no mode has bent its neighbours' estimates, so they are made anew without it.
        if let Some(pick) = (0..picks.len()).filter(|&pick| may_go(pick)).find(is_forced) {
            harmonics.push(Pick { band_hz: None, ..picks.remove(pick) });
            continue;
        }
        let mut worst =
            judge::worst(&setups, grid.spacing_hz(), may_go, |pick| picks[pick].unseen, |pick| picks[pick].is_twin);
        // Where nothing stands out, a fit goes elsewhere, is a wide one through what others leave, or a narrow one to a few lines of noise.
        let is_elsewhere = |pick: usize, asked_hz: f64| {
            estimates(pick).all(|SetupMode { resonance, damping_std, .. }| {
                (resonance.frequency_hz - asked_hz).abs() > meant_hz(grid.spacing_hz(), asked_hz)
                    || resonance.damping_ratio > judge::BRIDGING_DAMPING
                    || resonance.damping_ratio < judge::SHOWN_SIGMAS * damping_std
            })
        };
        // What is doubtful and no more stays where the user asks for it: there is a resonance, and it is there.
        let is_wanted = |&(pick, because): &(usize, RejectedBecause)| {
            because.can_be_added() && picks[pick].asked_hz.is_some_and(|asked_hz| !is_elsewhere(pick, asked_hz))
        };
        let wanted: Vec<usize> = worst.iter().filter(|one| is_wanted(one)).map(|(pick, _)| *pick).collect();
        if !wanted.is_empty() {
            for pick in wanted {
                picks[pick].by_user = true;
                doubted_hz.extend(picks[pick].asked_hz);
            }
            continue;
        }
        if worst.is_empty() {
            let is_nothing = |&pick: &usize| {
                may_go(pick) && picks[pick].asked_hz.is_some_and(|asked_hz| is_elsewhere(pick, asked_hz))
            };
            worst.extend((0..picks.len()).find(is_nothing).map(|pick| (pick, RejectedBecause::NotShown)));
        }
        if worst.is_empty() {
            break;
        }
        worst.sort_by_key(|(pick, _)| std::cmp::Reverse(*pick));
        for (pick, because) in worst {
            let pick = picks.remove(pick);
            let Some(asked_hz) = pick.asked_hz else {
                rejected.push(Rejected { frequency_hz: pick.frequency_hz(grid), because });
                continue;
            };
            // No peak: it is said in a warning, and is none of those that were rejected.
            let others = picks.iter().chain(harmonics.iter()).map(|other| other.frequency_hz(grid));
            warnings.push(none_is_added(asked_hz, others.chain(rejected.iter().map(|peak| peak.frequency_hz))));
        }
    }
    let mut warnings = basis.warnings.clone();
    basis.lone = Lone::all(&setups);
    let mut of_modes = Vec::new();
    let mut modes = merge::merge(grid, measured, &setups, &mut of_modes);
    hand_on_wishes(&mut basis.picks, &modes, grid);
    let unsure = basis.picks.iter().filter(|pick| !pick.by_user).filter_map(|pick| pick.asked_hz);
    for asked_hz in unsure.chain(doubted_hz) {
        warnings.push(format!(
            "no peak stands out at {asked_hz} Hz, where you asked for a mode: its values may come from noise or from neighbouring modes"
        ));
    }
    for (index, pick) in basis.picks.iter().enumerate() {
        if pick.by_user && judge::is_doubtful(&setups, grid.spacing_hz(), index) {
            let at_hz = setups.first().and_then(|setup| setup.modes.get(index)).map(|mode| mode.resonance.frequency_hz);
            warnings.push(format!(
                "the mode asked for near {:.4} Hz is hardly visible in the data: its fit is at {:.4} Hz, and its values are mostly noise",
                pick.asked_hz.unwrap_or_else(|| pick.frequency_hz(grid)),
                at_hz.unwrap_or(f64::NAN)
            ));
        }
    }
    warnings.append(&mut of_modes);
    for mode in &mut modes {
        let pick = mode.pick.and_then(|pick| basis.picks.get(pick));
        (mode.band_hz, mode.asked_hz) = pick.map_or((None, None), |pick| (pick.band_hz, pick.asked_hz));
    }
    let is_mode = |peak: &Rejected| modes.iter().any(|mode| mode.covers(peak.frequency_hz, grid.spacing_hz()));
    let mut rejected: Vec<Rejected> = basis.rejected.iter().copied().filter(|peak| !is_mode(peak)).collect();
    rejected.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let harmonic =
        |pick: &Pick| tone::harmonic(measured, grid, pick, tone::frequency_hz(grid, &singular, as_tone(pick)));
    Identification {
        modes,
        averages: measured.iter().map(|m| m.spectrum.averages()).sum(),
        record_s: measured.iter().map(|m| merge::duration_s(m, grid)).sum(),
        frequency_resolution_hz: grid.spacing_hz(),
        harmonics: basis.harmonics.iter().map(harmonic).collect(),
        rejected,
        warnings,
        other_poles: Vec::new(),
        stabilisation: Vec::new(),
        singular_values: singular,
        basis,
    }
}

/// A wish is for the mode that is nearest, which may have been found after another was taken for it.
fn hand_on_wishes(picks: &mut [Pick], modes: &[Mode], grid: &LineGrid) {
    for mode in modes {
        let wish = mode.pick.and_then(|own| Some((own, picks.get(own)?.asked_hz?)));
        let Some((own, asked_hz)) = wish else { continue };
        let off_hz = |other: &Mode| (other.frequency_hz - asked_hz).abs();
        let is_near = |other: &&Mode| off_hz(other) <= meant_hz(grid.spacing_hz(), asked_hz);
        let nearest = modes.iter().filter(is_near).min_by(|a, b| off_hz(a).total_cmp(&off_hz(b)));
        let other = nearest.and_then(|nearest| nearest.pick);
        if let Some(other) = other.filter(|&other| picks.get(other).is_some_and(|pick| pick.asked_hz.is_none())) {
            let by_user = std::mem::take(&mut picks[own].by_user);
            picks[own].asked_hz = None;
            (picks[other].by_user, picks[other].asked_hz) = (by_user, Some(asked_hz));
        }
    }
}

/// Says that there is no mode where the user asked for one, and where the nearest peak is.
fn none_is_added(asked_hz: f64, peaks_hz: impl Iterator<Item = f64>) -> String {
    let nearest = peaks_hz.min_by(|a, b| (a - asked_hz).abs().total_cmp(&(b - asked_hz).abs()));
    let nearest = nearest.map_or(String::new(), |hz| format!("; the nearest peak is at {hz:.4} Hz"));
    format!(
        "no peak stands out at {asked_hz} Hz, where you asked for a mode, and no resonance fits there, so none is added{nearest}"
    )
}

/// The median of damping ratios; 0 of none.
pub(super) fn usual_damping(all: impl Iterator<Item = f64>) -> f64 {
    median(&mut all.collect::<Vec<f64>>()).unwrap_or(0.0)
}

/// The tones of picks that are forced lines.
pub(super) fn tones(harmonics: &[Pick]) -> Vec<Tone> {
    harmonics.iter().map(as_tone).collect()
}

/// A force that goes on and off at random times has a line of its own, where it keeps its phase, and the sidebands of a resonance: the
/// spectrum of a random telegraph signal (Papoulis and Pillai 2002, "Probability, Random Variables, and Stochastic Processes", chapter 9),
/// whose half width is the sum of the rates at which it goes on and off, over two pi. The line is a tone, the sidebands are fitted.
fn as_tone(pick: &Pick) -> Tone {
    (pick.line, pick.kurtosis.frequency_lines())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::accuracy::tests::found;

    #[test]
    fn a_wish_is_for_the_nearest_mode_also_where_that_was_found_later() {
        let grid = LineGrid { sampling_rate_hz: 10.0, segment: 1000, first_line: 1, lines: 200 };
        let taken = Pick { by_user: true, asked_hz: Some(0.979), ..Pick::new(99, Vec::new()) };
        let mode = |frequency_hz: f64, pick: usize| Mode { frequency_hz, pick: Some(pick), ..found().modes.remove(0) };
        let wishes = |other_hz: f64| {
            let mut picks = [taken.clone(), Pick::new(97, Vec::new())];
            hand_on_wishes(&mut picks, &[mode(other_hz, 1), mode(0.998, 0)], &grid);
            picks.map(|pick| (pick.by_user, pick.asked_hz))
        };
        assert_eq!(wishes(0.98), [(false, None), (true, Some(0.979))]);
        // One that is no nearer, or further away than was meant, has nothing to do with it.
        for other_hz in [0.95, 1.2] {
            assert_eq!(wishes(other_hz), [(true, Some(0.979)), (false, None)]);
        }
    }
}
