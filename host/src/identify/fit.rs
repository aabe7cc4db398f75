//! From picks to modes: all are estimated, the one that is least likely to be a mode goes, and so on until all stand.
//!
//! Picks flow in; an identification flows out, and in it what the next fit may start from.

use super::estimate;
use super::judge;
use super::merge;
use super::pick::Pick;
use super::result::{Harmonic, Identification, Rejected, SingularSpectrum};
use super::setup::{MeasuredSetup, quantity};
use crate::spectra::LineGrid;

/// A rejected peak within so many lines and this share of a mode's bandwidth together is that mode after all.
const SAME_LINES: f64 = 1.0;
const SAME_OF_BANDWIDTH: f64 = 0.5;

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
}

/// Fits the picks and takes out what is no mode.
pub(super) fn fit(
    measured: &[MeasuredSetup<'_>],
    grid: &LineGrid,
    mut basis: Basis,
    singular: Vec<SingularSpectrum>,
) -> Identification {
    let Basis { picks, harmonics, rejected, .. } = &mut basis;
    let mut setups = Vec::new();
    loop {
        let estimate =
            |(index, m): (usize, &MeasuredSetup<'_>)| estimate::estimate(&m.spectrum, quantity(m.setup), index, picks);
        setups.splice(.., measured.iter().enumerate().map(estimate));
        let is_forced = |pick: &usize| picks[*pick].kurtosis.is_low() && judge::is_undamped(&setups, *pick);
        let may_go = |pick: usize| !picks[pick].by_user;
        // A pick that is no mode has bent its neighbours' estimates, so they are made anew without it.
        if let Some(pick) = (0..picks.len()).filter(|&pick| may_go(pick)).find(is_forced) {
            harmonics.push(picks.remove(pick));
            continue;
        }
        let mut worst = judge::worst(&setups, grid.spacing_hz(), may_go, |pick| picks[pick].unseen);
        if worst.is_empty() {
            break;
        }
        worst.sort_by_key(|(pick, _)| std::cmp::Reverse(*pick));
        for (pick, because) in worst {
            let frequency_hz = grid.frequency_hz(picks.remove(pick).line);
            rejected.push(Rejected { frequency_hz, because });
        }
    }
    harmonics.sort_by_key(|pick| pick.line);
    let mut warnings = basis.warnings.clone();
    for (index, pick) in basis.picks.iter().enumerate() {
        if pick.by_user && judge::is_doubtful(&setups, grid.spacing_hz(), index) {
            warnings.push(format!(
                "the mode asked for near {:.4} Hz is hardly visible in the data: its values are mostly noise",
                grid.frequency_hz(pick.line)
            ));
        }
    }
    let modes = merge::merge(grid, measured, &setups, &mut warnings);
    let is_mode = |peak: &Rejected| {
        modes.iter().any(|mode| {
            let reach_hz = SAME_LINES * grid.spacing_hz() + SAME_OF_BANDWIDTH * mode.bandwidth_hz();
            (mode.frequency_hz - peak.frequency_hz).abs() < reach_hz
        })
    };
    let mut rejected: Vec<Rejected> = basis.rejected.iter().copied().filter(|peak| !is_mode(peak)).collect();
    rejected.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let harmonic = |pick: &Pick| Harmonic {
        frequency_hz: tone_frequency_hz(grid, &singular, pick.line),
        kurtosis: pick.kurtosis.value,
    };
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

/// The frequency of a steady tone from the magnitudes of its two strongest lines, pooled over the setups: the Hann window
/// gives them the ratio r = (1 + d)/(2 - d) for a tone d lines from the strongest towards the other (Rife & Vincent 1970).
fn tone_frequency_hz(grid: &LineGrid, singular: &[SingularSpectrum], line: usize) -> f64 {
    let log_power = |line: usize| {
        let values = singular.iter().filter_map(|setup| setup.values.first()?.get(line));
        values.map(|value| value.max(f64::MIN_POSITIVE).ln()).sum::<f64>() / singular.len().max(1) as f64
    };
    let (left, right) = (log_power(line.saturating_sub(1)), log_power(line + 1));
    let (stronger, side) = if left > right { (left, -1.0) } else { (right, 1.0) };
    let ratio = ((stronger - log_power(line)) / 2.0).exp();
    let offset = ((2.0 * ratio - 1.0) / (1.0 + ratio)).clamp(0.0, 0.5);
    grid.frequency_hz(line) + side * offset * grid.spacing_hz()
}
