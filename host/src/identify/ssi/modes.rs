//! Modes from subspace identification alone.
//!
//! Setups and the user's choice of modes flow in; modes as the first method gives them, with shapes of all setups merged, flow
//! out. A mode is a clear pole that every setup shows, or one that the user asked for.

use num_complex::Complex64;
use rayon::prelude::*;

use super::likeness::{NEAR_MAC, shape_in};
use super::rejected::rejected;
use super::stabilisation::StablePole;
use super::{SetupPoles, SubspacePole, reach_hz};
use crate::identify::accuracy::std_bounds;
use crate::identify::choice::meant_hz;
use crate::identify::curve::Curve;
use crate::identify::fit::{Basis, usual_damping};
use crate::identify::judge;
use crate::identify::merge::{duration_s, merge, number};
use crate::identify::pick::{Pick, sources, suggested};
use crate::identify::resonance::Resonance;
use crate::identify::result::{Harmonic, Identification, Mode, ModeMethod, Rejected};
use crate::identify::scatter::{GroupChanges, noise_share};
use crate::identify::setup::{MeasuredSetup, quantity};
use crate::identify::setup_mode::{SetupMode, SetupModes};
use crate::identify::shape::mac;
use crate::identify::singular::SingularValues;
use crate::identify::tone::harmonic;
use crate::identify::{IdentifyError, Suggestion, none_in_band, phase_collinearity, same_lines};
use crate::spectra::{LineGrid, around};
use crate::study::ModeChoice;

/// A pole in another setup may be this share of the frequency further away: structures change a little between setups.
const NEAR_OF_FREQUENCY: f64 = 0.003;

/// A frequency that is known within this share of the least that a mode's can be, of a peak narrower than a line, is a machine's.
const STEADY_SHARE: f64 = 0.6;

/// How much of a spectrum is shown about a pole, to either side.
const SHOWN_BANDWIDTHS: f64 = 3.0;
const SHOWN_LINES: f64 = 5.0;

/// A mode that the fit does not resolve counts where its damping is known within this share.
const ALONE_DAMPING_STD: f64 = 0.25;

/// Identifies the modes that all setups show by their subspaces.
///
/// # Errors
/// When there is no setup, the setups' lines differ, or `choice` names modes of which none is in the band.
pub fn identify_by_subspace(
    measured: &[MeasuredSetup<'_>],
    choice: &ModeChoice,
) -> Result<Identification, IdentifyError> {
    let grid = same_lines(measured)?;
    let setups: Vec<SetupPoles> = measured.par_iter().map(SetupPoles::of).collect();
    let mut warnings = Vec::new();
    let common = common(&setups, &grid);
    let chosen = chosen(&common, choice, &grid, &mut warnings);
    if chosen.is_empty() && choice.only_hz.is_some() {
        return Err(none_in_band(&grid));
    }
    let rejected = rejected(&setups, &common, &chosen, choice, grid.spacing_hz());
    if !choice.bands_hz.is_empty() {
        warnings.push(
            "mode_bands_hz: the subspace takes the whole band; the fit of spectra alone has bands of modes".to_owned(),
        );
    }
    let mut harmonics = Vec::new();
    let mut modes: Vec<Vec<&StablePole>> = Vec::new();
    let mut picks = Vec::new();
    let usual_damping = usual_damping(chosen.iter().flatten().map(|pole| pole.damping_ratio));
    let asked_for = poles_asked_for(&chosen, choice, grid.spacing_hz());
    for (number, poles) in chosen.into_iter().enumerate() {
        // What the user names is a mode whatever it looks like.
        match forced(measured, &poles, usual_damping, &grid).filter(|_| !asked_for.contains(&number)) {
            Some(harmonic) => harmonics.push(harmonic),
            None => {
                let shapes = poles.iter().map(|pole| pole.shape.clone()).collect();
                let pick = Pick::new(grid.nearest_line(mean_hz(&poles)), shapes);
                picks.push(Pick { by_user: asked_for.contains(&number), ..pick });
                modes.push(poles);
            }
        }
    }
    let other_poles = measured.iter().zip(&setups).flat_map(|(m, found)| {
        let is_mode = |pole: &StablePole| modes.iter().flatten().any(|mode| std::ptr::eq(*mode, pole));
        found.stable.iter().filter(|pole| !is_mode(pole)).map(|pole| pole.report(&m.setup.name)).collect::<Vec<_>>()
    });
    let other_poles = other_poles.collect();
    let singular: Vec<SingularValues> = sources(measured).iter().map(SingularValues::of).collect();
    Ok(Identification {
        modes: merged(&grid, measured, &modes, &mut warnings),
        averages: measured.iter().map(|m| m.spectrum.averages()).sum(),
        record_s: measured.iter().map(|m| duration_s(m, &grid)).sum(),
        frequency_resolution_hz: grid.spacing_hz(),
        harmonics,
        rejected,
        warnings,
        other_poles,
        stabilisation: measured.iter().zip(&setups).map(|(m, found)| found.diagram(&m.setup.name)).collect(),
        singular_values: measured.iter().zip(&singular).map(|(m, s)| s.spectrum(&grid, &m.setup.name)).collect(),
        basis: Basis { picks, ..Basis::default() },
    })
}

/// Modes of poles, one of each setup.
fn merged(
    grid: &LineGrid,
    measured: &[MeasuredSetup<'_>],
    modes: &[Vec<&StablePole>],
    warnings: &mut Vec<String>,
) -> Vec<Mode> {
    let of_setup = |(setup, m): (usize, &MeasuredSetup<'_>)| {
        let shown = |pole: &StablePole| SetupMode { curve: curve(m, pole), ..setup_mode(m, pole) };
        let modes = modes.iter().map(|poles| shown(poles[setup])).collect();
        SetupModes { modes }
    };
    let per_setup: Vec<SetupModes> = measured.iter().enumerate().map(of_setup).collect();
    let mut modes = merge(grid, measured, &per_setup, warnings);
    modes.iter_mut().for_each(|mode| mode.method = ModeMethod::Subspace);
    modes
}

/// Whether a pole may be a mode by itself.
pub(super) fn is_known(pole: &StablePole) -> bool {
    pole.is_clear() && pole.damping_ratio_std < ALONE_DAMPING_STD * pole.damping_ratio
}

/// Adds the modes that the subspaces show clearly and the fit does not resolve.
pub(super) fn add_unresolved(
    measured: &[MeasuredSetup<'_>],
    setups: &[SetupPoles],
    grid: &LineGrid,
    identification: &mut Identification,
) {
    let is_left =
        |pole: &StablePole| identification.other_poles.iter().any(|other| other.frequency_hz == pole.frequency_hz);
    let is_near = |mode: &Mode, m: &MeasuredSetup<'_>, pole: &StablePole| {
        let reach_hz = reach_hz(grid.spacing_hz(), mode.damping_ratio.max(pole.damping_ratio), mode.frequency_hz);
        let is_alike = shape_in(m, mode).is_some_and(|shape| mac(&shape, &pole.shape) > NEAR_MAC);
        (mode.frequency_hz - pole.frequency_hz).abs() < reach_hz && is_alike
    };
    // A wide mode may have more than one pole.
    let is_new = |poles: &Vec<&StablePole>| {
        let seen = |mode: &Mode| measured.iter().zip(poles).all(|(m, pole)| is_near(mode, m, pole));
        !identification.modes.iter().any(seen)
    };
    let is_mode = |poles: &Vec<&StablePole>| {
        2 * poles.iter().filter(|pole| is_known(pole)).count() > poles.len()
            && poles.iter().all(|pole| is_left(pole) && pole.is_inside(grid))
            && is_new(poles)
    };
    let mut unresolved: Vec<Vec<&StablePole>> = common(setups, grid).into_iter().filter(is_mode).collect();
    let listed: Vec<f64> = unresolved.iter().flatten().map(|pole| pole.frequency_hz).collect();
    let is_listed = |other: &SubspacePole| listed.contains(&other.frequency_hz);
    let mut machines = Vec::new();
    let usual_damping = usual_damping(identification.modes.iter().map(|mode| mode.damping_ratio));
    unresolved.retain(|poles| {
        let machine = forced(measured, poles, usual_damping, grid);
        let is_mode = machine.is_none();
        machines.extend(machine);
        is_mode
    });
    identification.other_poles.retain(|other| !is_listed(other));
    identification.harmonics.extend(machines);
    identification.harmonics.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    if unresolved.is_empty() {
        return;
    }
    let mut modes = merged(grid, measured, &unresolved, &mut identification.warnings);
    // Numbers of their own, until all are counted anew.
    let first = identification.modes.len();
    for mode in &mut modes {
        mode.pick = None;
        mode.number += first;
        mode.pair_with = mode.pair_with.map(|other| other + first);
    }
    let is_peak_of = |peak: &Rejected, mode: &Mode| {
        (peak.frequency_hz - mode.frequency_hz).abs()
            < reach_hz(grid.spacing_hz(), mode.damping_ratio, mode.frequency_hz)
    };
    identification.rejected.retain(|peak| !modes.iter().any(|mode| is_peak_of(peak, mode)));
    identification.modes.extend(modes);
    number(&mut identification.modes);
}

/// Poles that all setups show, lowest first: one of each setup. The surest pole of a mode brings the others together.
fn common<'a>(setups: &'a [SetupPoles], grid: &LineGrid) -> Vec<Vec<&'a StablePole>> {
    let mut anchors: Vec<(usize, usize)> = setups
        .iter()
        .enumerate()
        .flat_map(|(setup, found)| (0..found.stable.len()).map(move |pole| (setup, pole)))
        .collect();
    let pole = |(setup, pole): (usize, usize)| &setups[setup].stable[pole];
    anchors.sort_by(|&a, &b| pole(a).doubt().total_cmp(&pole(b).doubt()));
    let mut is_used: Vec<Vec<bool>> = setups.iter().map(|found| vec![false; found.stable.len()]).collect();
    let mut modes = Vec::new();
    for anchor in anchors {
        if is_used[anchor.0][anchor.1] {
            continue;
        }
        let here = pole(anchor);
        let members: Option<Vec<(usize, usize)>> = (0..setups.len())
            .map(|setup| {
                if setup == anchor.0 {
                    return Some(anchor);
                }
                let free = (0..setups[setup].stable.len()).filter(|&at| !is_used[setup][at]).map(|at| (setup, at));
                let distance = |at: (usize, usize)| (pole(at).frequency_hz - here.frequency_hz).abs();
                let nearest = free.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))?;
                let damping_ratio = here.damping_ratio.max(pole(nearest).damping_ratio);
                let leeway_hz = reach_hz(grid.spacing_hz(), damping_ratio, here.frequency_hz)
                    + NEAR_OF_FREQUENCY * here.frequency_hz;
                (distance(nearest) < leeway_hz).then_some(nearest)
            })
            .collect();
        if let Some(members) = members {
            for &(setup, at) in &members {
                is_used[setup][at] = true;
            }
            modes.push(members.into_iter().map(pole).collect::<Vec<_>>());
        }
    }
    modes.sort_by(|a, b| mean_hz(a).total_cmp(&mean_hz(b)));
    modes
}

pub(super) fn mean_hz(poles: &[&StablePole]) -> f64 {
    poles.iter().map(|pole| pole.frequency_hz).sum::<f64>() / poles.len().max(1) as f64
}

/// The poles that are clear in most setups, less those that the user drops, and those that the user asks for.
fn chosen<'a>(
    poles: &[Vec<&'a StablePole>],
    choice: &ModeChoice,
    grid: &LineGrid,
    warnings: &mut Vec<String>,
) -> Vec<Vec<&'a StablePole>> {
    let mut nearest = |asked_hz: f64, key: &str, then: &str| {
        let distance_hz = |at: &usize| (mean_hz(&poles[*at]) - asked_hz).abs();
        let leeway_hz = meant_hz(grid.spacing_hz(), asked_hz);
        let found = (0..poles.len()).min_by(|a, b| distance_hz(a).total_cmp(&distance_hz(b)));
        let found = found.filter(|at| distance_hz(at) <= leeway_hz);
        if found.is_none() {
            warnings.push(format!(
                "{key}: the subspaces have no stable pole within {leeway_hz:.4} Hz of {asked_hz} Hz, so {then}"
            ));
        }
        found
    };
    let dropped: Vec<usize> =
        choice.drop_hz.iter().filter_map(|&hz| nearest(hz, "drop_modes_hz", "none is dropped")).collect();
    let added: Vec<usize> =
        choice.add_hz.iter().filter_map(|&hz| nearest(hz, "add_modes_hz", "none is added")).collect();
    let only: Option<Vec<usize>> = choice
        .only_hz
        .as_ref()
        .map(|only| only.iter().filter_map(|&hz| nearest(hz, "modes_hz", "there is no such mode")).collect());
    let is_clear = |at: &usize| 2 * poles[*at].iter().filter(|pole| pole.is_clear()).count() > poles[*at].len();
    let is_chosen = |at: &usize| match &only {
        Some(only) => only.contains(at) || added.contains(at),
        None => !dropped.contains(at) && (is_clear(at) || added.contains(at)),
    };
    (0..poles.len()).filter(is_chosen).map(|at| poles[at].clone()).collect()
}

/// The places of the poles that the user names.
fn poles_asked_for(chosen: &[Vec<&StablePole>], choice: &ModeChoice, spacing_hz: f64) -> Vec<usize> {
    let nearest = |&asked_hz: &f64| {
        let distance_hz = |at: &usize| (mean_hz(&chosen[*at]) - asked_hz).abs();
        let nearest = (0..chosen.len()).min_by(|a, b| distance_hz(a).total_cmp(&distance_hz(b)));
        nearest.filter(|at| distance_hz(at) <= meant_hz(spacing_hz, asked_hz))
    };
    choice.only_hz.iter().flatten().chain(&choice.add_hz).filter_map(nearest).collect()
}

/// The forced line that poles are of, where they have next to no damping and the response has the kurtosis of one.
fn forced(
    measured: &[MeasuredSetup<'_>],
    poles: &[&StablePole],
    usual_damping: f64,
    grid: &LineGrid,
) -> Option<Harmonic> {
    let frequency_hz = mean_hz(poles);
    let shapes = poles.iter().map(|pole| pole.shape.clone()).collect();
    let damping_ratio = poles.iter().map(|pole| pole.damping_ratio).sum::<f64>() / poles.len().max(1) as f64;
    let pick = suggested(grid, measured, &Suggestion { frequency_hz, damping_ratio, shapes });
    let kurtosis = pick.kurtosis;
    // Of a mode that random loads drive the frequency is never known better than Au's bound (2014). A machine that goes on and off
    // has a peak as wide as one of little damping, but keeps its frequency.
    let duration_s: f64 = measured.iter().map(|m| duration_s(m, grid)).sum();
    let [bound_hz, _] = std_bounds(frequency_hz, damping_ratio, duration_s);
    let known: f64 = poles.iter().map(|pole| pole.frequency_std_hz.powi(-2)).sum();
    let is_steady =
        known.powf(-0.5) < STEADY_SHARE * bound_hz && 2.0 * damping_ratio * frequency_hz < grid.spacing_hz();
    let modes: Vec<SetupMode> = measured.iter().zip(poles).map(|(m, pole)| setup_mode(m, pole)).collect();
    let is_forced = kurtosis.is_harmonics()
        || judge::is_forced(&kurtosis, usual_damping, grid.spacing_hz(), modes.iter())
        || is_steady;
    is_forced.then(|| harmonic(measured, grid, &pick, frequency_hz))
}

fn resonance(measured: &MeasuredSetup<'_>, pole: &StablePole) -> Resonance {
    let quantity = quantity(measured.setup);
    Resonance { frequency_hz: pole.frequency_hz, damping_ratio: pole.damping_ratio, quantity }
}

/// What a pole looks like in a setup's spectrum.
fn curve(measured: &MeasuredSetup<'_>, pole: &StablePole) -> Curve {
    let (grid, resonance) = (measured.spectrum.grid(), resonance(measured, pole));
    let reach = (SHOWN_BANDWIDTHS * resonance.bandwidth_hz() / grid.spacing_hz()).max(SHOWN_LINES) as usize;
    let lines = around(grid.nearest_line(pole.frequency_hz), reach, grid.lines);
    let unit = &pole.shape / Complex64::from(pole.shape.norm());
    Curve::of_pole(&measured.spectrum, &unit, &resonance, pole.power, lines)
}

/// A pole as the first method would give it, but for what it looks like.
fn setup_mode(measured: &MeasuredSetup<'_>, pole: &StablePole) -> SetupMode {
    let resonance = resonance(measured, pole);
    // The shape's largest component is 1.
    let largest = pole.power / pole.shape.norm_squared();
    SetupMode {
        resonance,
        shape: pole.shape.clone(),
        frequency_std_hz: pole.frequency_std_hz,
        damping_std: pole.damping_ratio_std,
        shape_std: pole.shape_std.clone(),
        shape_noise: noise_share(&pole.shape, &pole.shape_std),
        peak_density: pole.power * resonance.peak_density(1.0 / measured.spectrum.grid().spacing_hz()),
        level: largest.sqrt(),
        found: true,
        curve: Curve::default(),
        misfit: None,
        changes: GroupChanges::unknown(pole.shape.len()),
        collinearity: phase_collinearity(pole.shape.as_slice()),
        in_plane: false,
        spacing_hz: measured.spectrum.grid().spacing_hz(),
    }
}
