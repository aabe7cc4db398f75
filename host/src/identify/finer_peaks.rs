//! Modes that lie on one line, or two, of the lines at hand: finer lines show them as peaks of their own.
//!
//! Where a mode is narrow for its lines, others like it, as those of a bridge's cables, may hide beside it. An identification flows in; its
//! narrow modes' surroundings are searched in lines several times as fine, and what is found there is fitted with the rest and judged as
//! all picks are. The identification flows out as it was where that leads to no more modes.

use std::ops::Range;

use super::Suggestion;
use super::choice::drop_picks;
use super::finer::{ENOUGH_LINES, WANTED_LINES, bandwidth_hz};
use super::fit::{self, Basis};
use super::matrices::{Matrices, Source};
use super::pick::{self, Pick, peaks};
use super::result::Identification;
use super::setup::{MeasuredSetup, quantity};
use super::singular::SingularValues;
use super::start::first_bell;
use crate::spectra::{FinerSpectrum, LineGrid, around};
use crate::study::ModeChoice;

/// Long windows, at least: with fewer, peaks of noise look like modes.
const LEAST_WINDOWS: usize = 16;
/// Lines to either side of a narrow mode in which others may be.
const REACH_LINES: usize = 8;
/// Modes that were found let others be looked for beside them, so often at most.
const MOST_ROUNDS: usize = 3;
/// How far from its peak in finer lines a mode may be, in these.
const LEEWAY_LINES: f64 = 2.0;

/// The identification with the modes that finer lines show beside narrow ones.
pub(super) fn with_narrow_modes(
    measured: &[MeasuredSetup<'_>],
    grid: &LineGrid,
    choice: &ModeChoice,
    mut found: Identification,
) -> Identification {
    for _ in 0..MOST_ROUNDS {
        let Some(picks) = finer_picks(measured, grid, &found) else { break };
        let mut basis = Basis { picks, ..found.basis.clone() };
        drop_picks(grid, &mut basis.picks, choice, &mut Vec::new());
        let again = fit::fit(measured, grid, basis, found.singular_values.clone());
        if again.modes.len() <= found.modes.len() {
            break;
        }
        found = again;
    }
    found
}

/// The picks with those in their place, where these are more, that finer lines show where modes are narrow.
fn finer_picks(measured: &[MeasuredSetup<'_>], grid: &LineGrid, found: &Identification) -> Option<Vec<Pick>> {
    let spacing_hz = grid.spacing_hz();
    let is_narrow = |width_hz: f64| width_hz < ENOUGH_LINES * spacing_hz;
    let width_hz: Vec<f64> =
        found.modes.iter().map(|mode| bandwidth_hz(mode.frequency_hz, mode.damping_ratio)).collect();
    let narrowest_hz = width_hz.iter().copied().filter(|width| is_narrow(*width)).fold(f64::INFINITY, f64::min);
    let most = (WANTED_LINES * spacing_hz / narrowest_hz).ceil() as usize;
    let (finer, times) = in_finer_lines(measured, most)?;
    let sources: Vec<Source<'_>> = finer.iter().map(Source::Finer).collect();
    let finer_grid = sources.first()?.grid();
    let mut regions: Vec<Range<usize>> = Vec::new();
    for (mode, _) in found.modes.iter().zip(&width_hz).filter(|(_, width)| is_narrow(**width)) {
        let region = around(finer_grid.nearest_line(mode.frequency_hz), REACH_LINES * times, finer_grid.lines);
        match regions.last_mut() {
            Some(last) if region.start <= last.end => last.end = region.end.max(last.end),
            _ => regions.push(region),
        }
    }
    let is_free = |hz: f64| {
        let near_tone = found.harmonics.iter().any(|tone| (tone.frequency_hz - hz).abs() < ENOUGH_LINES * spacing_hz);
        let near_wide = found.modes.iter().zip(&width_hz).any(|(mode, &width_hz)| {
            !is_narrow(width_hz) && (mode.frequency_hz - hz).abs() < spacing_hz + 0.5 * width_hz
        });
        !near_tone && !near_wide
    };
    let found_there = |region: Range<usize>| {
        let singular: Vec<SingularValues> =
            sources.iter().map(|source| SingularValues::of_lines(source, region.clone())).collect();
        peaks(&sources, &singular, region)
    };
    let mut peaks: Vec<Pick> = regions.into_iter().flat_map(found_there).collect();
    peaks.retain(|peak| is_free(finer_grid.frequency_hz(peak.line)));
    // Each takes the place of a pick on its line.
    let mut left: Vec<Pick> = found.basis.picks.clone();
    let mut taken_place = 0;
    for peak in &peaks {
        let hz = finer_grid.frequency_hz(peak.line);
        let distance_hz = |pick: &Pick| (pick_hz(pick, grid) - hz).abs();
        let nearest = (0..left.len()).min_by(|&a, &b| distance_hz(&left[a]).total_cmp(&distance_hz(&left[b])));
        if let Some(nearest) = nearest.filter(|&pick| distance_hz(&left[pick]) < spacing_hz && !left[pick].by_user) {
            left.remove(nearest);
            taken_place += 1;
        }
    }
    if peaks.len() <= taken_place {
        return None;
    }
    let quantity = quantity(measured.first()?.setup);
    let matrices = Matrices::new(*sources.first()?, None, &[]);
    for peak in &peaks {
        let others = peaks.iter().map(|other| other.line.abs_diff(peak.line)).filter(|distance| *distance > 0);
        let apart = others.min().unwrap_or(REACH_LINES * times);
        let start = first_bell(&matrices, &peak.shapes[0], peak.line, apart, quantity).resonance;
        let suggestion = Suggestion {
            frequency_hz: start.frequency_hz,
            damping_ratio: start.damping_ratio,
            shapes: peak.shapes.clone(),
        };
        let within_lines = LEEWAY_LINES / times as f64;
        left.push(Pick { within_lines, ..pick::suggested(grid, measured, &suggestion) });
    }
    left.sort_by_key(|pick| pick.line);
    Some(left)
}

fn pick_hz(pick: &Pick, grid: &LineGrid) -> f64 {
    pick.suggested.map_or_else(|| grid.frequency_hz(pick.line), |(frequency_hz, _)| frequency_hz)
}

/// All setups in lines as many times as fine, `most` at most; `None` where one has too few windows for that.
fn in_finer_lines(measured: &[MeasuredSetup<'_>], most: usize) -> Option<(Vec<FinerSpectrum>, usize)> {
    let finest = |most: usize| -> Option<Vec<(FinerSpectrum, usize)>> {
        measured.iter().map(|m| m.spectrum.finer(most, LEAST_WINDOWS)).collect()
    };
    let least = finest(most)?.iter().map(|(_, times)| *times).min()?;
    Some((finest(least)?.into_iter().map(|(finer, _)| finer).collect(), least))
}
