//! What subspace identification says of modes that another method found.
//!
//! An identification and the setups it was made from flow in; the identification flows out with a second opinion on each of its
//! modes, the stable poles that are none of its modes, the diagrams, and warnings where the two differ.

use rayon::prelude::*;

use super::likeness::{NEAR_MAC, shape_in};
use super::modes::{add_unresolved, is_known};
use super::shapes::hold_difference;
use super::stabilisation::StablePole;
use super::{SecondOpinion, SetupPoles, SubspacePole, reach_hz};
use crate::identify::choice::{asked_for, meant_hz};
use crate::identify::cluster::CLOSE_BANDWIDTHS;
use crate::identify::fit::usual_damping;
use crate::identify::judge::UNUSUAL_DAMPING;
use crate::identify::merge::{combine, number};
use crate::identify::result::{Identification, Mode, Rejected, RejectedBecause, place};
use crate::identify::setup::MeasuredSetup;
use crate::identify::shape::mac;
use crate::identify::twins::with_twins;
use crate::identify::{IdentifyError, Suggestion, identify_again, same_lines};
use crate::spectra::LineGrid;
use crate::statistics::places;
use crate::study::ModeChoice;

/// The methods disagree where they differ by more than this many of their standard deviations together.
const DISAGREEMENT_SIGMAS: f64 = 3.0;
/// The fit tries poles so often at most: modes that were found beside them let others stand.
const MOST_TRIALS: usize = 3;
/// A mode that the subspace does not have must have a damping of this many of its standard deviations; and any mode of so many, where not
/// one that the subspace has is known so well.
const LEAST_DAMPING_SIGMAS: f64 = 2.0;
const SURE_DAMPING_SIGMAS: f64 = 4.0;
/// Of so many where it is unusually little beside the other modes': of thousands of lines of noise one is that high now and then.
const NARROW_DAMPING_SIGMAS: f64 = 3.0;
/// Two modes are twins within this share of the narrower one's bandwidth.
const TWIN_BANDWIDTHS: f64 = 0.3;
/// A damping that is hardly known counts where its deviation is this many times the lower bound: in a short record even a clear mode's is
/// not known better.
const UNUSUAL: f64 = 2.0;
/// Where the methods disagree the subspace is right if frequency and damping, each in units of its value, are known together this
/// many times better than by the fit, which may have taken two modes for one.
const MUCH_SURER: f64 = 3.0;
/// Decimal places in sentences, at most.
const MOST_PLACES: usize = 7;

/// Adds a second opinion on every mode. Where the subspace has a pole and the fit no mode, the fit tries once more with that
/// pole among its picks: picking is blind where modes lie close and move alike.
///
/// # Errors
/// As of [`crate::identify::identify`].
pub fn add_second_opinion(
    measured: &[MeasuredSetup<'_>],
    choice: &ModeChoice,
    identification: &mut Identification,
) -> Result<(), IdentifyError> {
    let setups: Vec<SetupPoles> = measured.par_iter().map(SetupPoles::of).collect();
    add_opinions(measured, &setups, choice, identification);
    if choice.only_hz.is_none() {
        let grid = same_lines(measured)?;
        try_poles(measured, &setups, choice, &grid, identification)?;
        let given_up = give_up_contradicted(measured, &setups, identification);
        add_unresolved(measured, &setups, &grid, identification);
        settle(given_up, identification);
    }
    for (m, found) in measured.iter().zip(&setups) {
        for (mode, pole, _) in pairs(m, &identification.modes, &found.stable, identification.frequency_resolution_hz) {
            hold_difference(m, &mut identification.modes[mode], &found.stable[pole]);
        }
    }
    let missing = missing(identification, measured.len());
    identification.warnings.extend(missing);
    Ok(())
}

/// Fits once more with the poles that are no modes among the picks, while the two methods agree on more modes then: more modes
/// are no gain where they agree on fewer.
fn try_poles(
    measured: &[MeasuredSetup<'_>],
    setups: &[SetupPoles],
    choice: &ModeChoice,
    grid: &LineGrid,
    identification: &mut Identification,
) -> Result<(), IdentifyError> {
    let agreed = |identification: &Identification| {
        let opinions = identification.modes.iter().filter_map(|mode| mode.second_opinion);
        opinions.filter(|opinion| opinion.agrees).count()
    };
    for _ in 0..MOST_TRIALS {
        let left = suggestions(setups, identification, grid, &[]);
        if left.is_empty() {
            break;
        }
        let tried = |without: &[usize], suggestions: &[Suggestion]| -> Result<Option<Identification>, IdentifyError> {
            let mut again = with_twins(measured, grid, identify_again(measured, identification, without, suggestions)?);
            add_opinions(measured, setups, choice, &mut again);
            Ok(Some(again).filter(|again| agreed(again) > agreed(identification)))
        };
        let instead = |numbers: &[usize]| {
            let theirs_hz = poles_of(measured, setups, identification, numbers);
            suggestions(setups, identification, grid, &theirs_hz)
        };
        // Beside the modes that stand; or else in the place of those that are doubtful, which may be two in one.
        let mut better = tried(&[], &left)?;
        let doubtful = doubtful(identification);
        if better.is_none() && !doubtful.is_empty() {
            better = tried(&doubtful, &instead(&doubtful))?;
        }
        // Or else from the poles of all modes beside: what was fitted without a neighbour may start from a shape that is two in one.
        let beside = beside(identification, &left, grid.spacing_hz());
        if better.is_none() && !beside.iter().all(|mode| doubtful.contains(mode)) {
            better = tried(&beside, &instead(&beside))?;
        }
        let Some(better) = better else { break };
        *identification = better;
    }
    Ok(())
}

/// The numbers of the modes that the subspaces do not confirm, or beside which something else lies, but those that the user asked for.
fn doubtful(identification: &Identification) -> Vec<usize> {
    let asked_for = asked_for(identification);
    let is_doubtful = |mode: &&Mode| {
        let is_confirmed = mode.second_opinion.is_some_and(|opinion| opinion.agrees);
        (!is_confirmed || mode.is_misfit()) && !asked_for.contains(&mode.number)
    };
    identification.modes.iter().filter(is_doubtful).map(|mode| mode.number).collect()
}

/// The numbers of the modes that have a pole and lie so near to what is suggested that one bends the other's fit, from one to the next,
/// but those that the user asked for.
fn beside(identification: &Identification, suggestions: &[Suggestion], spacing_hz: f64) -> Vec<usize> {
    let asked_for = asked_for(identification);
    let mut places: Vec<(f64, f64)> =
        suggestions.iter().map(|pole| (pole.frequency_hz, 2.0 * pole.damping_ratio * pole.frequency_hz)).collect();
    let mut left: Vec<&Mode> = identification
        .modes
        .iter()
        .filter(|mode| mode.second_opinion.is_some() && !asked_for.contains(&mode.number))
        .collect();
    let mut numbers = Vec::new();
    loop {
        let is_near = |mode: &&Mode| {
            places.iter().any(|&(hz, bandwidth_hz)| {
                let reach_hz = (CLOSE_BANDWIDTHS * mode.bandwidth_hz().max(bandwidth_hz)).max(spacing_hz);
                (mode.frequency_hz - hz).abs() < reach_hz
            })
        };
        let (near, others): (Vec<&Mode>, Vec<&Mode>) = left.into_iter().partition(is_near);
        if near.is_empty() {
            return numbers;
        }
        numbers.extend(near.iter().map(|mode| mode.number));
        places.extend(near.iter().map(|mode| (mode.frequency_hz, mode.bandwidth_hz())));
        left = others;
    }
}

/// Frequencies in Hz of the poles that are those of the modes of these numbers, in any setup.
fn poles_of(
    measured: &[MeasuredSetup<'_>],
    setups: &[SetupPoles],
    identification: &Identification,
    numbers: &[usize],
) -> Vec<f64> {
    let of_setup = |(m, found): (&MeasuredSetup<'_>, &SetupPoles)| {
        let pairs = pairs(m, &identification.modes, &found.stable, identification.frequency_resolution_hz);
        let theirs = pairs.into_iter().filter(|(mode, _, _)| numbers.contains(&identification.modes[*mode].number));
        theirs.map(|(_, pole, _)| found.stable[pole].frequency_hz).collect::<Vec<f64>>()
    };
    measured.iter().zip(setups).flat_map(of_setup).collect()
}

/// A mode that was taken out for what the subspaces show instead.
struct GivenUp {
    mode: Mode,
    opinion: SecondOpinion,
    poles: Vec<SubspacePole>,
}

/// Takes out modes that the subspaces contradict and know much better, but those that the user asked for; [`add_unresolved`] then
/// lists them by their poles.
fn give_up_contradicted(
    measured: &[MeasuredSetup<'_>],
    setups: &[SetupPoles],
    identification: &mut Identification,
) -> Vec<GivenUp> {
    let spacing_hz = identification.frequency_resolution_hz;
    let asked_for = asked_for(identification);
    let modes = std::mem::take(&mut identification.modes);
    let mut poles: Vec<Vec<SubspacePole>> = vec![Vec::new(); modes.len()];
    for (m, found) in measured.iter().zip(setups) {
        for (mode, pole, _) in pairs(m, &modes, &found.stable, spacing_hz) {
            let pole = &found.stable[pole];
            poles[mode].extend(is_known(pole).then(|| pole.report(&m.setup.name)));
        }
    }
    let mut given_up = Vec::new();
    for (mode, poles) in modes.into_iter().zip(poles) {
        let surer = mode.second_opinion.filter(|opinion| !opinion.agrees && is_much_surer(opinion, &mode));
        match surer.filter(|_| poles.len() == setups.len() && !asked_for.contains(&mode.number)) {
            Some(opinion) => {
                identification.other_poles.extend(poles.iter().cloned());
                given_up.push(GivenUp { mode: Mode { pair_with: None, ..mode }, opinion, poles });
            }
            None => identification.modes.push(mode),
        }
    }
    number(&mut identification.modes);
    given_up
}

/// Says what became of modes that were given up; those whose poles are not listed come back.
fn settle(given_up: Vec<GivenUp>, identification: &mut Identification) {
    for GivenUp { mode, opinion, poles } in given_up {
        let is_left = |other: &SubspacePole| poles.iter().any(|pole| pole.frequency_hz == other.frequency_hz);
        if identification.other_poles.iter().any(is_left) {
            identification.other_poles.retain(|other| !is_left(other));
            // A number that no other mode has, until all are counted anew.
            let number = identification.modes.iter().map(|mode| mode.number).max().unwrap_or(0) + 1;
            identification.modes.push(Mode { number, ..mode });
            continue;
        }
        identification.say_no_more_of(&mode);
        identification.warnings.push(format!(
            "the two methods disagree near {:.4} Hz. {}, and is much surer: its values are listed",
            opinion.frequency_hz,
            both(&mode, &opinion)
        ));
    }
    number(&mut identification.modes);
}

/// Whether frequency and damping of the subspace are known so much better that the fit is wrong.
fn is_much_surer(opinion: &SecondOpinion, mode: &Mode) -> bool {
    // A stated deviation below the lower bound is chance.
    let bounds = [mode.frequency_std_bound_hz, mode.damping_ratio_std_bound];
    let doubt = |frequency_std_hz: f64, damping_std: f64, damping_ratio: f64| {
        frequency_std_hz.max(bounds[0]) * damping_std.max(bounds[1]) / damping_ratio
    };
    doubt(mode.frequency_std_hz, mode.damping_ratio_std, mode.damping_ratio)
        > MUCH_SURER * doubt(opinion.frequency_std_hz, opinion.damping_ratio_std, opinion.damping_ratio)
}

/// Takes out modes whose damping is hardly known and that the subspace does not have: a peak that chance makes of noise now and
/// then is a line or two wide. Where not one mode stands beyond doubt, the subspace is no witness of such a peak: it sees the same noise.
fn reject_unseen(identification: &mut Identification) {
    let asked_for = asked_for(identification);
    let is_asked_for = |mode: &Mode| asked_for.contains(&mode.number);
    let spacing_hz = identification.frequency_resolution_hz;
    let is_seen = |mode: &Mode| mode.second_opinion.is_some();
    let is_any_seen = identification.modes.iter().any(is_seen);
    let is_any_sure = identification.modes.iter().any(|mode| is_seen(mode) && !is_sharp(mode, SURE_DAMPING_SIGMAS));
    let usual_damping = usual_damping(identification.modes.iter().map(|mode| mode.damping_ratio));
    let is_unseen = |mode: &Mode| {
        let is_narrow = mode.damping_ratio < UNUSUAL_DAMPING * usual_damping && is_sharp(mode, NARROW_DAMPING_SIGMAS);
        // Where nothing at all is confirmed, finer lines may have given a width to a peak of noise.
        let is_lone_line = !is_any_seen && mode.bandwidth_hz() < spacing_hz;
        // Noise that is not white has wide bumps.
        let is_weak =
            is_sharp(mode, LEAST_DAMPING_SIGMAS) || is_narrow || is_lone_line || mode.frequency_std_hz > spacing_hz;
        (!is_seen(mode) && is_weak) || (!is_any_sure && is_sharp(mode, SURE_DAMPING_SIGMAS))
    };
    // Of two modes at one frequency a subspace may have one pole, or none that lasts: beside one that stands the other does too.
    let standing: Vec<(f64, f64)> = identification
        .modes
        .iter()
        .filter(|mode| !is_unseen(mode))
        .map(|mode| (mode.frequency_hz, mode.bandwidth_hz()))
        .collect();
    let is_twin = |mode: &Mode| {
        let overlaps = |&(hz, bandwidth_hz): &(f64, f64)| {
            (hz - mode.frequency_hz).abs() < TWIN_BANDWIDTHS * bandwidth_hz.min(mode.bandwidth_hz())
        };
        mode.damping_ratio > mode.damping_ratio_std && standing.iter().any(overlaps)
    };
    let (unseen, seen): (Vec<Mode>, Vec<Mode>) =
        std::mem::take(&mut identification.modes).into_iter().partition(|mode| {
            mode.damping_ratio_std.is_finite() && is_unseen(mode) && !is_twin(mode) && !is_asked_for(mode)
        });
    identification.modes = seen;
    for mode in unseen {
        let because = if is_seen(&mode) { RejectedBecause::Uncertain } else { RejectedBecause::Unseen };
        identification.rejected.push(Rejected { frequency_hz: mode.frequency_hz, because });
        identification.say_no_more_of(&mode);
    }
    number(&mut identification.modes);
    identification.rejected.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
}

/// Whether a mode's damping is less than so many of its standard deviations, though the record would do.
fn is_sharp(mode: &Mode, sigmas: f64) -> bool {
    mode.damping_ratio < sigmas * mode.damping_ratio_std
        && mode.damping_ratio_std > UNUSUAL * mode.damping_ratio_std_bound
}

/// Poles worth a trial that all setups show and that are none of the modes, or are at these frequencies.
fn suggestions(
    setups: &[SetupPoles],
    identification: &Identification,
    grid: &LineGrid,
    and_hz: &[f64],
) -> Vec<Suggestion> {
    let Some((first, others)) = setups.split_first() else { return Vec::new() };
    let spacing_hz = identification.frequency_resolution_hz;
    let is_other = |pole: &&StablePole| {
        let own = |other: &SubspacePole| other.frequency_hz == pole.frequency_hz;
        // Between several setups poles are brought together by little more than their frequency.
        let is_wanted = if others.is_empty() { pole.is_tried() } else { pole.is_clear() };
        let is_free = identification.other_poles.iter().any(own) || and_hz.contains(&pole.frequency_hz);
        is_wanted && pole.is_inside(grid) && is_free
    };
    let in_all = |pole: &StablePole| -> Option<Suggestion> {
        let mut shapes = vec![pole.shape.clone()];
        for setup in others {
            let distance_hz = |other: &StablePole| (other.frequency_hz - pole.frequency_hz).abs();
            let reach_hz = reach_hz(spacing_hz, pole.damping_ratio, pole.frequency_hz);
            let near = setup.stable.iter().filter(|other| distance_hz(other) < reach_hz);
            let nearest = near.min_by(|a, b| distance_hz(a).total_cmp(&distance_hz(b)))?;
            shapes.push(nearest.shape.clone());
        }
        Some(Suggestion { frequency_hz: pole.frequency_hz, damping_ratio: pole.damping_ratio, shapes })
    };
    first.stable.iter().filter(is_other).filter_map(in_all).collect()
}

/// Adds a second opinion on every mode.
pub(super) fn add_opinions(
    measured: &[MeasuredSetup<'_>],
    setups: &[SetupPoles],
    choice: &ModeChoice,
    identification: &mut Identification,
) {
    let spacing_hz = identification.frequency_resolution_hz;
    let mut opinions: Vec<Vec<(&StablePole, f64)>> = vec![Vec::new(); identification.modes.len()];
    for (m, found) in measured.iter().zip(setups) {
        let mut is_used = vec![false; found.stable.len()];
        for (mode, pole, alike) in pairs(m, &identification.modes, &found.stable, spacing_hz) {
            opinions[mode].push((&found.stable[pole], alike));
            is_used[pole] = true;
        }
        let is_forced = |pole: &StablePole| {
            identification.harmonics.iter().any(|forced| forced.covers(pole.frequency_hz, spacing_hz))
        };
        let is_unwanted = |pole: &StablePole| {
            choice.drop_hz.iter().any(|hz| (hz - pole.frequency_hz).abs() < meant_hz(spacing_hz, *hz))
        };
        let others = found.stable.iter().zip(&is_used);
        let others = others.filter(|(pole, used)| !**used && !is_forced(pole) && !is_unwanted(pole));
        identification.other_poles.extend(others.map(|(pole, _)| pole.report(&m.setup.name)));
    }
    for (mode, opinions) in identification.modes.iter_mut().zip(&opinions) {
        mode.second_opinion = pooled(mode, opinions);
    }
    // A subspace that shows nothing at all is no witness.
    if choice.only_hz.is_none() && setups.iter().any(|setup| !setup.dots.is_empty()) {
        reject_unseen(identification);
    }
    let disagreements = identification.modes.iter().filter_map(disagreement);
    identification.warnings.extend(disagreements);
    identification.stabilisation = measured.iter().zip(setups).map(|(m, found)| found.diagram(&m.setup.name)).collect();
}

/// Modes and the poles of a setup that are theirs (mode, pole, MAC), each once, the most alike first.
fn pairs(
    measured: &MeasuredSetup<'_>,
    modes: &[Mode],
    poles: &[StablePole],
    spacing_hz: f64,
) -> Vec<(usize, usize, f64)> {
    let mut all: Vec<(f64, (usize, usize, f64))> = Vec::new();
    for (index, mode) in modes.iter().enumerate() {
        let Some(shape) = shape_in(measured, mode) else { continue };
        for (at, pole) in poles.iter().enumerate() {
            let reach_hz = reach_hz(spacing_hz, mode.damping_ratio.max(pole.damping_ratio), mode.frequency_hz);
            let distance = (mode.frequency_hz - pole.frequency_hz).abs() / reach_hz;
            let alike = mac(&shape, &pole.shape);
            if distance < 1.0 && alike > NEAR_MAC {
                all.push((alike - distance * distance, (index, at, alike)));
            }
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut pairs: Vec<(usize, usize, f64)> = Vec::new();
    for (_, pair) in all {
        if pairs.iter().all(|other| other.0 != pair.0 && other.1 != pair.1) {
            pairs.push(pair);
        }
    }
    pairs
}

/// The opinions of all setups in one, by inverse variance; `None` where no setup has any.
fn pooled(mode: &Mode, opinions: &[(&StablePole, f64)]) -> Option<SecondOpinion> {
    if opinions.is_empty() {
        return None;
    }
    let pole = || opinions.iter().map(|(pole, _)| pole);
    let (frequency_hz, frequency_std_hz) = combine(pole().map(|pole| (pole.frequency_hz, pole.frequency_std_hz)));
    let (damping_ratio, damping_ratio_std) = combine(pole().map(|pole| (pole.damping_ratio, pole.damping_ratio_std)));
    // A stated deviation below the lower bound is chance.
    let agree = |a: f64, b: f64, stds: [f64; 2], bound: f64| {
        (a - b).abs() <= DISAGREEMENT_SIGMAS * stds[0].max(bound).hypot(stds[1].max(bound))
    };
    let frequency_stds = [mode.frequency_std_hz, frequency_std_hz];
    let damping_stds = [mode.damping_ratio_std, damping_ratio_std];
    Some(SecondOpinion {
        frequency_hz,
        frequency_std_hz,
        damping_ratio,
        damping_ratio_std,
        mac: opinions.iter().map(|(_, alike)| alike).sum::<f64>() / opinions.len() as f64,
        agrees: agree(mode.frequency_hz, frequency_hz, frequency_stds, mode.frequency_std_bound_hz)
            && agree(mode.damping_ratio, damping_ratio, damping_stds, mode.damping_ratio_std_bound),
    })
}

/// Says where the methods differ on a mode.
fn disagreement(mode: &Mode) -> Option<String> {
    let other = mode.second_opinion.filter(|opinion| !opinion.agrees)?;
    Some(format!(
        "{}: the two methods disagree. {}: trust neither further than their difference",
        place(mode.frequency_hz),
        both(mode, &other)
    ))
}

/// What either method has.
fn both(mode: &Mode, other: &SecondOpinion) -> String {
    format!(
        "The fit of spectra has {}, the subspace has {}",
        in_words(mode.frequency_hz, mode.frequency_std_hz, mode.damping_ratio, mode.damping_ratio_std),
        in_words(other.frequency_hz, other.frequency_std_hz, other.damping_ratio, other.damping_ratio_std)
    )
}

/// A frequency and a damping ratio with their deviations, each to two figures of the deviation.
fn in_words(frequency_hz: f64, frequency_std_hz: f64, damping_ratio: f64, damping_ratio_std: f64) -> String {
    let (percent, percent_std) = (100.0 * damping_ratio, 100.0 * damping_ratio_std);
    let (of_frequency, of_damping) =
        (places(&[frequency_std_hz], 3, MOST_PLACES), places(&[percent_std], 2, MOST_PLACES));
    format!(
        "{frequency_hz:.of_frequency$} ± {frequency_std_hz:.of_frequency$} Hz and {percent:.of_damping$} ± {percent_std:.of_damping$} % damping"
    )
}

/// Says which clear poles are no modes of the first method: those that more than half of the setups show.
fn missing(identification: &Identification, setups: usize) -> Vec<String> {
    let clear: Vec<_> = identification.other_poles.iter().filter(|pole| pole.is_clear).collect();
    let mut said: Vec<f64> = Vec::new();
    let mut warnings = Vec::new();
    for pole in &clear {
        let reach_hz = reach_hz(identification.frequency_resolution_hz, pole.damping_ratio, pole.frequency_hz);
        let is_near = |hz: f64| (hz - pole.frequency_hz).abs() < reach_hz;
        if said.iter().any(|&hz| is_near(hz)) {
            continue;
        }
        said.push(pole.frequency_hz);
        let shown = clear.iter().filter(|other| is_near(other.frequency_hz)).count();
        if 2 * shown > setups {
            let nearest = identification
                .modes
                .iter()
                .map(|mode| mode.frequency_hz)
                .min_by(|a, b| (a - pole.frequency_hz).abs().total_cmp(&(b - pole.frequency_hz).abs()));
            let nearest = nearest.map_or(String::new(), |hz| format!("; its nearest mode is at {hz:.5} Hz"));
            warnings.push(format!(
                "the subspace has a stable pole at {} where the fit of spectra has no mode{nearest}. If it is a mode, add it with add_modes_hz in [analysis]",
                in_words(pole.frequency_hz, pole.frequency_std_hz, pole.damping_ratio, pole.damping_ratio_std)
            ));
        }
    }
    warnings
}
