//! The user's choice of modes: some added, some dropped, or all of them named.
//!
//! Automatic picks flow in; the picks that the user wants, with warnings, flow out.

use super::kurtosis::kurtosis;
use super::pick::{Pick, peak_near};
use super::result::{Identification, Mode};
use super::setup::MeasuredSetup;
use super::singular::SingularValues;
use crate::spectra::LineGrid;
use crate::study::ModeChoice;

/// How far from a pick, in lines and as a share of the frequency (whichever is more), it is still the one that was meant.
const NEAR_LINES: f64 = 2.0;
pub(crate) const NEAR_SHARE: f64 = 0.01;

/// A band of a mode needs as many lines as the narrowest that is chosen from the data.
const BAND_LINES: usize = 7;

/// A pick this near is the one that was meant, whatever else is there.
const SAME_LINES: f64 = 0.5;

/// How far from `frequency_hz` the user may have meant.
pub(super) fn meant_hz(spacing_hz: f64, frequency_hz: f64) -> f64 {
    (NEAR_LINES * spacing_hz).max(NEAR_SHARE * frequency_hz)
}

/// Takes out the automatic picks that the user drops; says where there was none.
pub(super) fn drop_picks(grid: &LineGrid, picks: &mut Vec<Pick>, choice: &ModeChoice, warnings: &mut Vec<String>) {
    for &frequency_hz in &choice.drop_hz {
        let distance_hz = |pick: &Pick| (pick.frequency_hz(grid) - frequency_hz).abs();
        let nearest = (0..picks.len()).min_by(|&a, &b| distance_hz(&picks[a]).total_cmp(&distance_hz(&picks[b])));
        match nearest.filter(|&pick| distance_hz(&picks[pick]) <= meant_hz(grid.spacing_hz(), frequency_hz)) {
            Some(pick) => drop(picks.remove(pick)),
            None => {
                let nearest = nearest.map_or(String::new(), |pick| {
                    format!("; the nearest is at {:.4} Hz", picks[pick].frequency_hz(grid))
                });
                warnings.push(format!(
                    "drop_modes_hz: no mode was picked within {:.4} Hz of {frequency_hz} Hz, so none is dropped{nearest}",
                    meant_hz(grid.spacing_hz(), frequency_hz)
                ));
            }
        }
    }
}

/// Adds the modes that the user names: at the highest point near by of what the other picks leave. One stays whatever the data say where a
/// peak stands out; elsewhere it stays where the fit finds a resonance.
pub(super) fn add_picks(
    grid: &LineGrid,
    measured: &[MeasuredSetup<'_>],
    singular: &[SingularValues],
    picks: &mut Vec<Pick>,
    choice: &ModeChoice,
    warnings: &mut Vec<String>,
) {
    let half_line_hz = 0.5 * grid.spacing_hz();
    let band_hz = grid.frequency_hz(0) - half_line_hz..=grid.frequency_hz(grid.lines.saturating_sub(1)) + half_line_hz;
    for frequency_hz in choice.wanted_hz() {
        if !band_hz.contains(&frequency_hz) {
            warnings.push(format!(
                "the mode asked for at {frequency_hz} Hz lies outside the band of {:.4} to {:.4} Hz and is not looked for",
                band_hz.start(),
                band_hz.end()
            ));
            continue;
        }
        let (mut pick, stands_out) =
            peak_near(grid, measured, singular, picks, frequency_hz, meant_hz(grid.spacing_hz(), frequency_hz));
        pick.asked_hz = Some(frequency_hz);
        pick.kurtosis = kurtosis(measured, &pick);
        if pick.kurtosis.is_harmonics() {
            warnings.push(format!(
                "the mode asked for at {frequency_hz} Hz has the kurtosis {:.2} of a forced line (a mode has 3)",
                pick.kurtosis.value
            ));
        }
        let distance_hz = |other: &Pick| (grid.frequency_hz(other.line) - frequency_hz).abs();
        // An automatic pick that is very near, or as near as was meant where nothing else is. Two that the user names are two.
        let is_near = |other: &Pick| {
            let reach_hz =
                if stands_out { SAME_LINES * grid.spacing_hz() } else { meant_hz(grid.spacing_hz(), frequency_hz) };
            !other.by_user && distance_hz(other) <= reach_hz
        };
        let nearest = picks.iter_mut().min_by(|a, b| distance_hz(a).total_cmp(&distance_hz(b)));
        if let Some(already) = nearest.filter(|other| is_near(other)) {
            // It is picked already; a second pick here would fit the first one's remains.
            (already.by_user, already.asked_hz) = (true, Some(frequency_hz));
            continue;
        }
        pick.by_user = stands_out;
        picks.push(pick);
    }
    picks.sort_by_key(|pick| pick.line);
}

/// The bands of single modes that a fit can be made from; says which are too narrow, or hold several modes.
pub(super) fn usable_bands(
    grid: &LineGrid,
    picks: &[Pick],
    choice: &ModeChoice,
    warnings: &mut Vec<String>,
) -> Vec<[f64; 2]> {
    let mut wide = choice.bands_hz.clone();
    wide.retain(|&[from, to]| {
        let lines = (0..grid.lines).filter(|&line| (from..=to).contains(&grid.frequency_hz(line))).count();
        if lines < BAND_LINES {
            warnings.push(format!(
                "mode_bands_hz: {from} to {to} Hz holds {lines} spectral lines, and a fit needs {BAND_LINES} ({:.4} Hz), so Belfry chooses the lines itself",
                (BAND_LINES - 1) as f64 * grid.spacing_hz()
            ));
        }
        let inside = picks.iter().filter(|pick| (from..=to).contains(&pick.frequency_hz(grid))).count();
        if inside > 1 {
            warnings.push(format!(
                "mode_bands_hz: {inside} modes were picked between {from} and {to} Hz, and each is fitted by itself to all of these lines; bands that part them are better"
            ));
        }
        lines >= BAND_LINES
    });
    wide
}

/// Says in which bands no mode was found; once all methods have been asked.
pub fn note_idle_bands(found: &mut Identification) {
    for &[from, to] in &found.basis.bands_hz {
        if !found.modes.iter().any(|mode| mode.band_hz == Some([from, to])) {
            found.warnings.push(format!("mode_bands_hz: no mode was found between {from} and {to} Hz"));
        }
    }
}

/// Numbers of the modes that the user asked for.
pub(super) fn asked_for(identification: &Identification) -> Vec<usize> {
    let is_asked_for = |mode: &&Mode| {
        let pick = mode.pick.and_then(|pick| identification.basis.picks.get(pick));
        pick.is_some_and(|pick| pick.by_user || pick.asked_hz.is_some())
    };
    identification.modes.iter().filter(is_asked_for).map(|mode| mode.number).collect()
}
