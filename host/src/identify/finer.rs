//! Modes that are narrow for the lines at hand, from finer ones.
//!
//! A cross-spectral matrix of all channels wants four averages a channel, or two at least, and so leaves short segments and coarse lines. A
//! mode that is found already wants far fewer: behind its filter there is a matrix of one or a few modes, whose likelihood takes any number
//! of averages (Au 2017, chapter 12, with a single one). A setup's windows and what is known of its modes flow in; the same modes from windows several
//! times as long flow out.

use super::bell::BellFit;
use super::cluster::CLOSE_BANDWIDTHS;
use super::curve::Curve;
use super::estimate::{JOINT_CHANNELS, ROUNDS, State};
use super::matrices::{Matrices, Source};
use super::setup_mode::SetupMode;
use crate::spectra::{CrossSpectrum, LineGrid};

/// Modes with as many lines in their bandwidth are as well known from these lines as from finer ones.
pub(super) const ENOUGH_LINES: f64 = 2.0;
/// A mode of more lines than these is left to them, and so is a narrow one within its bell, with which it is fitted.
const WIDE_LINES: f64 = 8.0;
/// At the band's ends, over so many lines, the sum of windows lacks what lies outside of the band.
const END_LINES: f64 = 2.0;
/// Lines in the narrowest mode's bandwidth that finer ones aim at.
pub(super) const WANTED_LINES: f64 = 4.0;
/// The damping of a mode that finer lines aim at, at least.
const LEAST_DAMPING: f64 = 2e-4;
/// Long windows, at least: the jackknife leaves out one after the other, and the record's ends are lost to all of them.
const LEAST_WINDOWS: usize = 10;

/// A setup's modes, those that are narrow for its lines from finer ones; as they are where the windows are not at hand or too few.
///
/// Shapes come from cross spectra at resonance, which many short windows know better than a few long ones, unless another mode lies on the
/// same line.
pub(super) fn refined(
    mut modes: Vec<SetupMode>,
    spectrum: &CrossSpectrum,
    state: &State,
    taken: &[usize],
) -> Vec<SetupMode> {
    let hz: Vec<f64> = modes.iter().map(|mode| mode.resonance.frequency_hz).collect();
    let spacing_hz = spectrum.grid().spacing_hz();
    let has_own_line =
        |mode: usize| (0..hz.len()).all(|other| other == mode || (hz[other] - hz[mode]).abs() > spacing_hz);
    for (mode, finer) in estimated(spectrum, state, taken) {
        // Modes are held against each other by their densities at lines of one width.
        let finer = SetupMode { peak_density: modes[mode].peak_density, ..finer };
        modes[mode] = if has_own_line(mode) { finer.with_shape_of(modes[mode].clone()) } else { finer };
    }
    modes
}

/// The modes that are narrow for a setup's lines, with their places among all of them, from finer lines; without those whose fit comes to
/// no end there.
fn estimated(spectrum: &CrossSpectrum, state: &State, taken: &[usize]) -> Vec<(usize, SetupMode)> {
    let lines = |fit: &BellFit| {
        bandwidth_hz(fit.resonance.frequency_hz, fit.resonance.damping_ratio) / spectrum.grid().spacing_hz()
    };
    let lines: Vec<f64> = state.fits.iter().map(lines).collect();
    let mut state = state.clone();
    state.wanted = wanted(spectrum.grid(), &state, &lines);
    let narrowest = lines.iter().zip(&state.wanted).filter(|(_, is_wanted)| **is_wanted);
    let narrowest = narrowest.map(|(lines, _)| *lines).fold(f64::INFINITY, f64::min);
    let most = (WANTED_LINES / narrowest).ceil().min(spectrum.averages() as f64) as usize;
    let Some((finer, times)) = spectrum.finer(most, LEAST_WINDOWS) else { return Vec::new() };
    let taken = taken_of(taken, times, finer.grid().lines);
    let source = Source::Finer(&finer);
    let matrices = Matrices::new(source, None, &taken);
    // Those that cannot be fitted to these lines have none.
    state.curves.fill(Curve::default());
    state.fits.iter_mut().for_each(|fit| fit.certainty = None);
    if source.channels() < JOINT_CHANNELS {
        for _ in 0..ROUNDS {
            state.improve(&matrices);
        }
    }
    state.fit_clusters(&matrices);
    let modes = state.concluded(source, &taken).into_iter().enumerate();
    modes.filter(|(mode, finer)| state.wanted[*mode] && finer.is_sound()).collect()
}

/// The bandwidth that counts of a mode: what seems to have next to no damping is no reason for lines as fine as that.
pub(super) fn bandwidth_hz(frequency_hz: f64, damping_ratio: f64) -> f64 {
    2.0 * damping_ratio.max(LEAST_DAMPING) * frequency_hz
}

/// Which modes, of so many `lines` each, are to be fitted to finer ones.
fn wanted(grid: &LineGrid, state: &State, lines: &[f64]) -> Vec<bool> {
    let spacing_hz = grid.spacing_hz();
    let hz = |mode: usize| state.fits[mode].resonance.frequency_hz;
    let modes = 0..lines.len();
    let is_beside_wide = |mode: usize| {
        modes.clone().any(|other| {
            let reach_hz = CLOSE_BANDWIDTHS * state.fits[other].resonance.bandwidth_hz();
            lines[other] > WIDE_LINES && (hz(other) - hz(mode)).abs() < reach_hz
        })
    };
    let end_hz = END_LINES * spacing_hz;
    let inside_hz = grid.frequency_hz(0) + end_hz..grid.frequency_hz(grid.lines.saturating_sub(1)) - end_hz;
    let is_narrow =
        |mode: &usize| lines[*mode] < ENOUGH_LINES && inside_hz.contains(&hz(*mode)) && !is_beside_wide(*mode);
    let narrow: Vec<usize> = modes.clone().filter(|&mode| !state.is_machine[mode]).filter(is_narrow).collect();
    // Modes on one line are refined together.
    let is_with_narrow = |mode: usize| narrow.iter().any(|&other| (hz(other) - hz(mode)).abs() < spacing_hz);
    modes.clone().map(|mode| is_with_narrow(mode) && !is_beside_wide(mode)).collect()
}

/// Finer lines within the cells of those that tones have taken.
pub(super) fn taken_of(taken: &[usize], times: usize, lines: usize) -> Vec<usize> {
    let cell = |&line: &usize| (line * times).saturating_sub(times / 2)..(line * times + times.div_ceil(2)).min(lines);
    let mut finer: Vec<usize> = taken.iter().flat_map(cell).collect();
    finer.dedup();
    finer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_a_tone_has_taken_are_taken_in_finer_ones() {
        assert_eq!(taken_of(&[0, 3, 4], 3, 13), [0, 1, 8, 9, 10, 11, 12]);
        assert_eq!(taken_of(&[2], 4, 100), [6, 7, 8, 9]);
    }
}
