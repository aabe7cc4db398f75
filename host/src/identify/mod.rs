//! Identification: from cross-spectral matrices to modes.
//!
//! Per-setup cross-spectral matrices flow in; modes with frequency, damping, shape and the uncertainty of each flow out.
//! `pick` finds modes in the singular values and `kurtosis` tells forced lines from them, `fit` estimates and judges them until all stand, `shape` filters each mode from its
//! neighbours, [`bell`] reads frequency and damping from the filtered spectrum one by one; from there `cluster`, `joint` and
//! `joint_fit` fit close modes together by maximum likelihood (with the sums of `information`), and `finer` lines those that are narrow, which `finer_peaks` looks for
//! beside each other. The jackknife in `scatter` says how sure it all is, `judge` throws out what the data do not determine, and `merge`
//! joins the setups, their shapes by `join`; `covariance` says how errors are correlated. `choice` applies the user's choice of modes;
//! [`track`] follows known modes through parts of a record; [`accuracy`] tells how long a record must be for a given accuracy; `suspect`
//! finds channels that the shapes contradict, `phases` those that their phases do, `lean` reversed inclinometers. [`ssi`] identifies the same spectra by another method, as a second opinion.

pub mod accuracy;
pub mod bell;
mod choice;
mod cluster;
mod covariance;
mod crossing;
mod curve;
mod drifting;
mod estimate;
mod finer;
mod finer_peaks;
mod fit;
mod information;
mod join;
mod joint;
mod joint_fit;
mod judge;
mod kurtosis;
pub(crate) mod lean;
mod matrices;
mod merge;
pub(crate) mod phases;
mod pick;
mod plane;
mod residue;
pub mod resonance;
mod result;
mod scatter;
mod scoring;
mod setup;
mod setup_mode;
mod shape;
mod singular;
pub mod ssi;
mod standards;
mod start;
pub(crate) mod suspect;
mod tone;
pub mod track;
mod twins;

use thiserror::Error;

use crate::numbers::counted;
use crate::spectra::plan::{AVERAGES_A_CHANNEL, SHORTEST_SEGMENT};
use crate::spectra::{LineGrid, around};
use crate::statistics::median;
use crate::study::ModeChoice;
use fit::Basis;
use merge::covered_s;
use pick::Pick;
use shape::Shape;
use singular::SingularValues;

pub(crate) use choice::NEAR_SHARE;
pub use choice::note_idle_bands;
pub use covariance::CovarianceFactor;
pub(crate) use covariance::OWN_SHARE;
pub use drifting::{Drift, widen_drifting};
pub(crate) use pick::peaks_of;
pub use result::{
    FittedSpectrum, Harmonic, Identification, Mode, ModeMethod, OnInPart, Rejected, RejectedBecause, ShapeComponent,
    SingularSpectrum,
};
pub use setup::MeasuredSetup;
pub use shape::{mac, phase_collinearity};
pub use standards::hold_to_standards;

/// A peak that is sharper than its lines may hide a mode, or several, where it is so many times the median of the lines about it.
const FAR_OUT: f64 = 10.0;
const FAR_OUT_LINES: usize = 32;

/// Why there are no modes.
#[derive(Debug, Error, PartialEq)]
pub enum IdentifyError {
    /// No setup.
    #[error("there is no setup to identify modes from")]
    NoSetup,
    /// The average is rank-deficient.
    #[error(
        "setup \"{setup}\": {} for {channels} channels: a cross-spectral matrix averaged over fewer segments than channels cannot tell modes from noise; record {:.1} times as long, {needed_min:.0} min{}",
        counted(*averages as u64, "average"),
        needed_min / present_min,
        if *is_shortest { "" } else { ", or shorten the segment in [analysis]" }
    )]
    RankDeficient {
        /// The setup.
        setup: String,
        /// Its averages.
        averages: usize,
        /// Its channels.
        channels: usize,
        /// What the averages cover, in minutes.
        present_min: f64,
        /// The record that would do, in minutes.
        needed_min: f64,
        /// Whether segments are the shortest there are.
        is_shortest: bool,
    },
    /// Too few averages to tell modes from noise.
    #[error(
        "{averages} averages for {channels} channels; at least {wanted} are needed, or noise peaks may be taken for modes. Record at least {missing_min:.0} min more, shorten the segment in [analysis], or name the modes there yourself: modes_hz = [...]"
    )]
    TooFewAverages {
        /// Averages of all setups together.
        averages: usize,
        /// Channels of the largest setup.
        channels: usize,
        /// Averages wanted.
        wanted: usize,
        /// Minutes of recording that are missing at this line spacing.
        missing_min: f64,
    },
    /// The user names modes, none of them in the band.
    #[error("none of modes_hz in [analysis] lies in the band of {low_hz:.4} to {high_hz:.4} Hz")]
    NoneInBand {
        /// Lower edge of the band.
        low_hz: f64,
        /// Upper edge.
        high_hz: f64,
    },
    /// Setups have different lines.
    #[error(
        "setup \"{setup}\" has other spectral lines than the first; give decimated_rate_hz and segment in [analysis]"
    )]
    DifferentLines {
        /// The setup that differs.
        setup: String,
    },
}

/// Identifies the modes that all setups show, picked automatically but for what `choice` says.
///
/// # Errors
/// When there are fewer than two averages a channel (fewer than channels, where `choice` names all modes), or the setups'
/// lines differ.
pub fn identify(measured: &[MeasuredSetup<'_>], choice: &ModeChoice) -> Result<Identification, IdentifyError> {
    let grid = same_lines(measured)?;
    check_averages(measured, &grid, choice)?;
    let singular: Vec<SingularValues> = pick::sources(measured).iter().map(SingularValues::of).collect();
    let mut warnings = Vec::new();
    let picks = if choice.only_hz.is_some() { Vec::new() } else { pick::pick(&grid, measured, &singular) };
    let (harmonics, mut picks): (Vec<_>, Vec<_>) = picks.into_iter().partition(Pick::is_harmonics);
    choice::drop_picks(&grid, &mut picks, choice, &mut warnings);
    choice::add_picks(&grid, measured, &singular, &mut picks, choice, &mut warnings);
    if picks.is_empty() && choice.only_hz.is_some() {
        return Err(none_in_band(&grid));
    }
    let spectra = measured.iter().zip(&singular).map(|(m, singular)| singular.spectrum(&grid, &m.setup.name)).collect();
    let bands_hz = choice::usable_bands(&grid, &picks, choice, &mut warnings);
    let basis = Basis { picks, harmonics, warnings, bands_hz, ..Basis::default() };
    let found = fit::fit(measured, &grid, basis, spectra);
    if choice.only_hz.is_some() {
        return Ok(found);
    }
    let found = finer_peaks::with_narrow_modes(measured, &grid, choice, found);
    Ok(twins::with_twins(measured, &grid, found))
}

/// A mode that another method suggests, or finer lines.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Suggestion {
    frequency_hz: f64,
    damping_ratio: f64,
    /// Its shape in every setup.
    shapes: Vec<Shape>,
}

/// Identifies once more, from the picks of the modes that were found, but those of the numbers in `without`, and those that another method
/// suggests: these are judged as all picks are. What was rejected stays out, so that it bends nothing.
fn identify_again(
    measured: &[MeasuredSetup<'_>],
    found: &Identification,
    without: &[usize],
    suggestions: &[Suggestion],
) -> Result<Identification, IdentifyError> {
    let grid = same_lines(measured)?;
    let mut basis = found.basis.clone();
    let kept = found.modes.iter().filter(|mode| !without.contains(&mode.number));
    let pick = |mode: &Mode| {
        let pick = found.basis.picks.get(mode.pick?)?;
        Some(Pick { unseen: mode.second_opinion.is_none(), ..pick.clone() })
    };
    basis.picks = kept.filter_map(pick).collect();
    let suggested = |suggestion| Pick { is_known: true, ..pick::suggested(&grid, measured, suggestion) };
    basis.picks.extend(suggestions.iter().map(suggested));
    basis.picks.sort_by_key(|pick| pick.line);
    Ok(fit::fit(measured, &grid, basis, found.singular_values.clone()))
}

/// Whether there are enough averages to tell modes from noise.
fn check_averages(measured: &[MeasuredSetup<'_>], grid: &LineGrid, choice: &ModeChoice) -> Result<(), IdentifyError> {
    let averages: usize = measured.iter().map(|m| m.spectrum.averages()).sum();
    let channels = measured.iter().map(|m| m.spectrum.channels().len()).max().unwrap_or(0);
    for m in measured {
        let (setup, averages, channels) = (m.setup.name.clone(), m.spectrum.averages(), m.spectrum.channels().len());
        if averages < channels {
            let covered_min = |averages: usize| covered_s(averages, grid) / 60.0;
            let (present_min, needed_min) = (covered_min(averages), covered_min(AVERAGES_A_CHANNEL * channels).ceil());
            let is_shortest = grid.segment <= SHORTEST_SEGMENT;
            return Err(IdentifyError::RankDeficient {
                setup,
                averages,
                channels,
                present_min,
                needed_min,
                is_shortest,
            });
        }
    }
    let wanted = AVERAGES_A_CHANNEL * channels;
    if averages < wanted && choice.only_hz.is_none() {
        let missing_min = ((wanted - averages) as f64 * 0.5 / grid.spacing_hz() / 60.0).ceil();
        return Err(IdentifyError::TooFewAverages { averages, channels, wanted, missing_min });
    }
    Ok(())
}

/// The lines of all setups.
///
/// # Errors
/// Where there is no setup, or one has other lines than the first.
fn same_lines(measured: &[MeasuredSetup<'_>]) -> Result<LineGrid, IdentifyError> {
    let first = measured.first().ok_or(IdentifyError::NoSetup)?;
    let grid = *first.spectrum.grid();
    match measured.iter().find(|m| *m.spectrum.grid() != grid) {
        Some(other) => Err(IdentifyError::DifferentLines { setup: other.setup.name.clone() }),
        None => Ok(grid),
    }
}

/// The user names modes, none of them among the lines.
fn none_in_band(grid: &LineGrid) -> IdentifyError {
    let last = grid.lines.saturating_sub(1);
    IdentifyError::NoneInBand { low_hz: grid.frequency_hz(0), high_hz: grid.frequency_hz(last) }
}

/// Frequencies in Hz, lowest first, of what may be a mode once there are finer lines or a second opinion: modes, and peaks that stand far
/// out, whatever these lines make of them. None where the setups' lines differ or there are fewer averages than channels.
pub fn mode_frequencies_hz(measured: &[MeasuredSetup<'_>]) -> Vec<f64> {
    let Ok(grid) = same_lines(measured) else { return Vec::new() };
    if !measured.iter().all(|m| m.spectrum.averages() >= m.spectrum.channels().len()) {
        return Vec::new();
    }
    let singular: Vec<SingularValues> = pick::sources(measured).iter().map(SingularValues::of).collect();
    let (harmonics, picks) = pick::pick(&grid, measured, &singular).into_iter().partition(Pick::is_harmonics);
    let found = fit::fit(measured, &grid, Basis { picks, harmonics, ..Basis::default() }, Vec::new());
    // Where many modes share a few lines, their shapes change from line to line, and nothing there passes for a mode.
    let stands_far_out = |&line: &usize| {
        singular.iter().any(|setup| {
            let value = |line: usize| setup.at(line).value;
            let is_peak = value(line) > value(line - 1) && value(line) >= value(line + 1);
            let about = || around(line, FAR_OUT_LINES, grid.lines).map(value).collect::<Vec<f64>>();
            is_peak && median(&mut about()).is_some_and(|median| value(line) > FAR_OUT * median)
        })
    };
    let is_told = |&hz: &f64| {
        found.harmonics.iter().any(|tone| tone.covers(hz, grid.spacing_hz()))
            || found.modes.iter().any(|mode| mode.covers(hz, grid.spacing_hz()))
    };
    let hidden = (1..grid.lines.saturating_sub(1)).filter(stands_far_out);
    let hidden = hidden.map(|line| grid.frequency_hz(line)).filter(|hz| !is_told(hz));
    let mut frequencies_hz: Vec<f64> = found.modes.iter().map(|mode| mode.frequency_hz).chain(hidden).collect();
    frequencies_hz.sort_by(f64::total_cmp);
    frequencies_hz
}

#[cfg(test)]
mod tests;
