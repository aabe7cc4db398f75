//! Modes that lie on one line, or two, of the lines at hand: finer lines show them as peaks of their own.
//!
//! Where a mode is narrow for its lines, others like it, as those of a bridge's cables, may hide beside it. An identification flows in; its
//! narrow modes' surroundings are searched in lines several times as fine, and what is found there is fitted with the rest and judged as
//! all picks are. The identification flows out as it was where that leads to no more modes.

use std::ops::Range;

use super::Suggestion;
use super::finer::{ENOUGH_LINES, WANTED_LINES, bandwidth_hz, taken_of};
use super::fit::{self, Basis};
use super::matrices::{Matrices, Source};
use super::pick::{self, Pick, peaks};
use super::result::{Identification, Mode};
use super::setup::{MeasuredSetup, quantity};
use super::shape::filtered;
use super::singular::SingularValues;
use super::start::first_bell;
use super::tone;
use crate::spectra::{FinerSpectrum, LineGrid, around};
use crate::study::ModeChoice;

/// Long windows, at least, and no fewer than channels: with fewer, peaks of noise look like modes.
const LEAST_WINDOWS: usize = 16;
/// Lines to either side of a narrow mode in which others may be.
const REACH_LINES: usize = 8;
/// Modes that were found let others be looked for beside them, so often at most.
const MOST_ROUNDS: usize = 3;
/// How far from its peak a mode may be: in finer lines, and as a share of the frequency where setups follow each other and it changes.
const WITHIN_FINER_LINES: f64 = 2.0;
const CHANGE_BETWEEN_SETUPS: f64 = 3e-3;

/// The identification with the modes that finer lines show beside narrow ones.
pub(super) fn with_narrow_modes(
    measured: &[MeasuredSetup<'_>],
    grid: &LineGrid,
    choice: &ModeChoice,
    mut found: Identification,
) -> Identification {
    for _ in 0..MOST_ROUNDS {
        let Some(picks) = Finer::of(measured, grid, &found).and_then(|finer| finer.picks(choice)) else {
            break;
        };
        let again = fit::fit(measured, grid, Basis { picks, ..found.basis.clone() }, found.singular_values.clone());
        let is_still_there = |mode: &Mode| {
            mode.is_misfit() || again.modes.iter().any(|other| mode.covers(other.frequency_hz, grid.spacing_hz()))
        };
        if again.modes.len() <= found.modes.len() || !found.modes.iter().all(is_still_there) {
            break;
        }
        found = again;
    }
    found
}

/// An identification that has narrow modes, and the setups in finer lines.
struct Finer<'a> {
    measured: &'a [MeasuredSetup<'a>],
    grid: &'a LineGrid,
    found: &'a Identification,
    spectra: Vec<FinerSpectrum>,
    /// How many times finer.
    times: usize,
}

impl<'a> Finer<'a> {
    /// `None` where no mode is narrow, or a setup has too few windows.
    fn of(measured: &'a [MeasuredSetup<'a>], grid: &'a LineGrid, found: &'a Identification) -> Option<Self> {
        let narrow = found.modes.iter().filter(|mode| is_narrow(mode, grid));
        let narrowest_hz = narrow.map(width_hz).fold(f64::INFINITY, f64::min);
        let most = (WANTED_LINES * grid.spacing_hz() / narrowest_hz).ceil() as usize;
        let (spectra, times) = in_finer_lines(measured, most)?;
        Some(Self { measured, grid, found, spectra, times })
    }

    fn sources(&self) -> Vec<Source<'_>> {
        self.spectra.iter().map(Source::Finer).collect()
    }

    /// The identification's picks, with peaks of the finer lines in the place of those that they resolve. `None` where these show nothing
    /// that is new.
    fn picks(&self, choice: &ModeChoice) -> Option<Vec<Pick>> {
        let sources = self.sources();
        let finer_grid = sources.first()?.grid();
        let is_near = |hz: &f64, other_hz: f64| (hz - other_hz).abs() < self.grid.spacing_hz();
        let mut picks = self.found.basis.picks.clone();
        let mut is_new = false;
        for (peak, place) in matched(&picks, self.peaks(&sources), self.grid, finer_grid) {
            let peak_hz = finer_grid.frequency_hz(peak.line);
            let (by_user, asked_hz) =
                place.map_or((false, None), |place| (picks[place].by_user, picks[place].asked_hz));
            let Some(suggested) = self.suggested(&sources, finer_grid, &peak) else { continue };
            let suggested = Pick { by_user, asked_hz, ..suggested };
            match place {
                Some(place) => picks[place] = suggested,
                None if choice.drop_hz.iter().any(|hz| is_near(hz, peak_hz)) => {}
                // What was rejected may stand beside what was found since.
                None => {
                    is_new = true;
                    picks.push(suggested);
                }
            }
        }
        picks.sort_by_key(|pick| pick.line);
        is_new.then_some(picks)
    }

    /// Peaks that pass for modes near narrow ones, away from tones and wide modes.
    fn peaks(&self, sources: &[Source<'_>]) -> Vec<Pick> {
        let Some(finer_grid) = sources.first().map(Source::grid) else { return Vec::new() };
        let narrow = self.found.modes.iter().filter(|mode| is_narrow(mode, self.grid));
        let lines = narrow.map(|mode| finer_grid.nearest_line(mode.frequency_hz));
        let spacing_hz = self.grid.spacing_hz();
        let is_free = |peak: &Pick| {
            let hz = finer_grid.frequency_hz(peak.line);
            let mut tones = self.found.harmonics.iter();
            let mut wide = self.found.modes.iter().filter(|mode| !is_narrow(mode, self.grid) && !mode.is_misfit());
            !tones.any(|tone| tone.covers(hz, spacing_hz)) && !wide.any(|mode| mode.covers(hz, spacing_hz))
        };
        let found_there = |region: Range<usize>| {
            let of_region = |source| SingularValues::of_lines(source, region.clone());
            let singular: Vec<SingularValues> = sources.iter().map(of_region).collect();
            peaks(sources, &singular, region)
        };
        let regions = regions(lines, REACH_LINES * self.times, finer_grid.lines);
        regions.into_iter().flat_map(found_there).filter(is_free).collect()
    }

    /// The pick of a peak; `None` where it is a tone. Its fit starts from the setup that shows it best.
    fn suggested(&self, sources: &[Source<'_>], finer_grid: &LineGrid, peak: &Pick) -> Option<Pick> {
        let density = |setup: usize| filtered(&peak.shapes[setup], &sources[setup].matrix(peak.line, None));
        let best = (0..sources.len()).max_by(|&a, &b| density(a).total_cmp(&density(b)))?;
        let quantity = quantity(self.measured[best].setup);
        let tones = fit::tones(&self.found.basis.harmonics);
        let taken = taken_of(&tone::lines(&self.measured[best].spectrum, &tones), self.times, finer_grid.lines);
        let matrices = Matrices::new(sources[best], None, &taken);
        let start = first_bell(&matrices, &peak.shapes[best], peak.line, self.times, quantity).resonance;
        let peak_hz = finer_grid.frequency_hz(peak.line);
        let changes_hz = if sources.len() > 1 { CHANGE_BETWEEN_SETUPS * peak_hz } else { 0.0 };
        let within_hz = (WITHIN_FINER_LINES * finer_grid.spacing_hz()).max(changes_hz);
        let is_there = (start.frequency_hz - peak_hz).abs() < within_hz;
        let suggestion = Suggestion {
            frequency_hz: if is_there { start.frequency_hz } else { peak_hz },
            damping_ratio: start.damping_ratio,
            shapes: peak.shapes.clone(),
        };
        let pick = pick::suggested(self.grid, self.measured, &suggestion);
        let within_lines = within_hz / self.grid.spacing_hz();
        (!pick.is_harmonics()).then_some(Pick { within_lines, ..pick })
    }
}

fn width_hz(mode: &Mode) -> f64 {
    bandwidth_hz(mode.frequency_hz, mode.damping_ratio)
}

fn is_narrow(mode: &Mode, grid: &LineGrid) -> bool {
    width_hz(mode) < ENOUGH_LINES * grid.spacing_hz()
}

/// The lines about some (ascending), joined where they meet.
fn regions(lines: impl Iterator<Item = usize>, reach: usize, count: usize) -> Vec<Range<usize>> {
    let mut regions: Vec<Range<usize>> = Vec::new();
    for line in lines {
        let region = around(line, reach, count);
        match regions.last_mut() {
            Some(last) if region.start <= last.end => last.end = region.end.max(last.end),
            _ => regions.push(region),
        }
    }
    regions
}

/// Peaks with the picks whose place they take: each at most one that is less than a line away, the nearest first.
fn matched(picks: &[Pick], peaks: Vec<Pick>, grid: &LineGrid, finer_grid: &LineGrid) -> Vec<(Pick, Option<usize>)> {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (at, peak) in peaks.iter().enumerate() {
        for (place, pick) in picks.iter().enumerate() {
            let distance_hz = (pick.frequency_hz(grid) - finer_grid.frequency_hz(peak.line)).abs();
            if distance_hz < grid.spacing_hz() {
                pairs.push((distance_hz, at, place));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut places: Vec<Option<usize>> = vec![None; peaks.len()];
    for (_, at, place) in pairs {
        if places[at].is_none() && !places.contains(&Some(place)) {
            places[at] = Some(place);
        }
    }
    peaks.into_iter().zip(places).collect()
}

/// All setups in lines as many times as fine, `most` at most; `None` where one has too few windows for that.
fn in_finer_lines(measured: &[MeasuredSetup<'_>], most: usize) -> Option<(Vec<FinerSpectrum>, usize)> {
    let finest = |most: usize| -> Option<Vec<(FinerSpectrum, usize)>> {
        let finer = |m: &MeasuredSetup<'_>| m.spectrum.finer(most, LEAST_WINDOWS.max(m.spectrum.channels().len()));
        measured.iter().map(finer).collect()
    };
    let found = finest(most)?;
    let least = found.iter().map(|(_, times)| *times).min()?;
    let is_one = found.iter().all(|(_, times)| *times == least);
    let found = if is_one { found } else { finest(least)? };
    Some((found.into_iter().map(|(finer, _)| finer).collect(), least))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_that_meet_are_one_and_end_with_the_lines() {
        assert_eq!(regions([3, 20, 26, 98].into_iter(), 4, 100), [0..8, 16..31, 94..100]);
        assert!(regions(std::iter::empty(), 4, 100).is_empty());
    }

    #[test]
    fn peaks_take_the_place_of_the_nearest_pick_within_a_line_and_no_two_of_one() {
        let grid = LineGrid { sampling_rate_hz: 1.0, segment: 100, first_line: 10, lines: 20 };
        let finer_grid = LineGrid { segment: 400, first_line: 40, lines: 77, ..grid };
        let pick = |line| Pick::new(line, Vec::new());
        let picks = [pick(4), pick(6)];
        // In lines of the picks: 3.5, 4.25, 5.5 and 9.
        let peaks = [14, 17, 22, 36].map(pick).to_vec();
        let places: Vec<_> = matched(&picks, peaks, &grid, &finer_grid).into_iter().map(|(_, place)| place).collect();
        assert_eq!(places, [None, Some(0), Some(1), None]);
    }
}
