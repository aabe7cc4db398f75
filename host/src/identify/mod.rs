//! Identification: from cross-spectral matrices to modes.
//!
//! Per-setup cross-spectral matrices flow in; modes with frequency, damping, shape and the uncertainty of each flow out.
//! `pick` finds modes in the singular values, `shape` filters each mode from its neighbours, [`bell`] reads frequency and
//! damping from the filtered spectrum one by one; from there `cluster` and `joint` fit close modes together by maximum
//! likelihood. The jackknife in `estimate` says how sure it all is, `judge` throws out what the data do not determine, and
//! `merge` joins the setups.

pub mod bell;
mod cluster;
mod estimate;
mod joint;
mod judge;
mod merge;
mod pick;
mod result;
mod shape;
mod singular;

use thiserror::Error;

use crate::spectra::{CrossSpectrum, LineGrid};
use crate::study::{Setup, Unit};
use bell::Quantity;
use singular::SingularValues;

pub use result::{Harmonic, Identification, Mode, ShapeComponent, SingularSpectrum};
pub use shape::{mac, phase_collinearity};

/// A setup with its averaged cross spectra.
#[derive(Debug, Clone)]
pub struct MeasuredSetup<'a> {
    /// What stands where.
    pub setup: &'a Setup,
    /// Its cross-spectral matrices.
    pub spectrum: CrossSpectrum,
}

/// Why there are no modes.
#[derive(Debug, Error, PartialEq)]
pub enum IdentifyError {
    /// No setup.
    #[error("there is no setup to identify modes from")]
    NoSetup,
    /// The average is rank-deficient.
    #[error(
        "{averages} averages for {channels} channels: a cross-spectral matrix averaged over fewer segments than channels cannot tell modes from noise; record {} times as long, or shorten the segment in [analysis]",
        channels.div_ceil(*averages.max(&1)) * 4
    )]
    RankDeficient {
        /// Averages of all setups together.
        averages: usize,
        /// Channels of the largest setup.
        channels: usize,
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

/// Identifies the modes that all setups show.
///
/// # Errors
/// When there are fewer averages than channels, or the setups' lines differ.
pub fn identify(measured: &[MeasuredSetup<'_>]) -> Result<Identification, IdentifyError> {
    let first = measured.first().ok_or(IdentifyError::NoSetup)?;
    let grid = *first.spectrum.grid();
    if let Some(other) = measured.iter().find(|m| *m.spectrum.grid() != grid) {
        return Err(IdentifyError::DifferentLines { setup: other.setup.name.clone() });
    }
    let averages: usize = measured.iter().map(|m| m.spectrum.averages()).sum();
    let channels = measured.iter().map(|m| m.spectrum.channels().len()).max().unwrap_or(0);
    if averages < channels {
        return Err(IdentifyError::RankDeficient { averages, channels });
    }
    let singular: Vec<SingularValues> = measured.iter().map(|m| SingularValues::of(&m.spectrum)).collect();
    let picks = pick::pick(&grid, measured, &singular);
    let (mut harmonics, mut picks): (Vec<_>, Vec<_>) = picks.into_iter().partition(|pick| pick.kurtosis.is_harmonics());
    let mut per_setup = Vec::new();
    loop {
        let estimate = |(index, m): (usize, &MeasuredSetup<'_>)| {
            let quantity =
                if m.setup.unit == Unit::MetrePerSecond { Quantity::Velocity } else { Quantity::Acceleration };
            estimate::estimate(&m.spectrum, quantity, index, &picks)
        };
        per_setup.splice(.., measured.iter().enumerate().map(estimate));
        // A pick that is no mode has bent its neighbours' estimates, so they are made anew without it.
        if let Some(pick) =
            (0..picks.len()).find(|&pick| picks[pick].kurtosis.is_low() && judge::is_undamped(&per_setup, pick))
        {
            harmonics.push(picks.remove(pick));
        } else if let Some(pick) = judge::worst(&per_setup, grid.spacing_hz()) {
            picks.remove(pick);
        } else {
            break;
        }
    }
    harmonics.sort_by_key(|pick| pick.line);
    let mut warnings = Vec::new();
    let modes = merge::merge(&grid, measured, &per_setup, &mut warnings);
    Ok(Identification {
        modes,
        averages,
        frequency_resolution_hz: grid.spacing_hz(),
        harmonics: harmonics
            .iter()
            .map(|pick| Harmonic {
                frequency_hz: tone_frequency_hz(&grid, &singular, pick.line),
                kurtosis: pick.kurtosis.value,
            })
            .collect(),
        warnings,
        singular_values: measured
            .iter()
            .zip(&singular)
            .map(|(m, singular)| singular.spectrum(&grid, &m.setup.name))
            .collect(),
    })
}

/// The frequency of a steady tone from the magnitudes of its two strongest lines, pooled over the setups: the Hann window
/// gives them the ratio r = (1 + d)/(2 - d) for a tone d lines from the strongest towards the other (Rife & Vincent 1970).
fn tone_frequency_hz(grid: &LineGrid, singular: &[SingularValues], line: usize) -> f64 {
    let log_power = |line: usize| {
        let values = singular.iter().filter_map(|setup| setup.lines.get(line));
        values.map(|line| line.value.max(f64::MIN_POSITIVE).ln()).sum::<f64>() / singular.len().max(1) as f64
    };
    let (left, right) = (log_power(line.saturating_sub(1)), log_power(line + 1));
    let (stronger, side) = if left > right { (left, -1.0) } else { (right, 1.0) };
    let ratio = ((stronger - log_power(line)) / 2.0).exp();
    let offset = ((2.0 * ratio - 1.0) / (1.0 + ratio)).clamp(0.0, 0.5);
    grid.frequency_hz(line) + side * offset * grid.spacing_hz()
}

#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
