//! Days of a watch: every mode's frequency as it was seen and less what surroundings do, with the changes that were found.

use plotters::prelude::*;

use super::canvas::{Area, Dashes, DrawResult, MEASURED, PictureError, REJECTED, axis_digits, fixed};
use super::over_time::{self, stacked};
use crate::colour;
use crate::watch::{DAY_S, Judgement, State};

const PANEL: u32 = 112;
const ALARM: RGBColor = colour::BAD.on_paper();

/// Draws a panel a mode (number, and frequency in Hz now); `None` where there are no days.
///
/// # Errors
/// When drawing fails.
pub fn watch(structure: &str, modes: &[(usize, f64)], judgement: &Judgement) -> Result<Option<String>, PictureError> {
    let (Some(first), Some(last)) = (judgement.days_s.first(), judgement.days_s.last()) else { return Ok(None) };
    let in_days = |time_s: f64| (time_s - first) / DAY_S;
    let days: Vec<f64> = judgement.days_s.iter().map(|day_s| in_days(*day_s)).collect();
    let lasting = judgement.alarms.iter().filter(|alarm| alarm.state != State::Withdrawn);
    // A change lies before the first day after it.
    let changes: Vec<f64> = lasting.map(|alarm| in_days(alarm.first_day_s) - 0.5).collect();
    let span = in_days(*last).max(1.0);
    let title = format!("{structure}: modes day by day");
    let words = "Grey: as measured. Blue: less what temperature, vibration level and season do. Red line: a change. Days of frost are left out.";
    stacked("the watch", [&title, words], (modes.len(), PANEL), |index, area, is_last| {
        let (number, hz) = modes[index];
        let name = format!("mode {number}: frequency, in % off its mean ({hz:.4} Hz now)");
        let seen = judgement.seen_percent.get(index).into_iter().flatten();
        let seen: Vec<(f64, f64)> = days.iter().zip(seen).filter_map(|(day, value)| Some((*day, (*value)?))).collect();
        let cleaned = judgement.cleaned_percent.get(index).into_iter().flatten().copied();
        let cleaned: Vec<(f64, f64)> = days.iter().copied().zip(cleaned).collect();
        draw(area, &name, [&seen, &cleaned], &changes, (span, is_last))
    })
    .map(Some)
}

fn draw(
    area: &Area<'_>,
    name: &str,
    [seen, cleaned]: [&[(f64, f64)]; 2],
    changes: &[f64],
    (span, is_last): (f64, bool),
) -> DrawResult {
    let values = || seen.iter().chain(cleaned).map(|(_, value)| *value);
    let lowest = values().fold(f64::INFINITY, f64::min);
    let highest = values().fold(f64::NEG_INFINITY, f64::max);
    let room = if highest > lowest { 0.1 * (highest - lowest) } else { 0.01 };
    let range = if lowest.is_finite() { lowest - room..highest + room } else { -1.0..1.0 };
    let label = |value: &f64| fixed(*value, axis_digits(range.end - range.start));
    let below = is_last.then_some("days after the first");
    let plane = over_time::panel(area, name, span, range.clone(), &label, below)?;
    for point in seen {
        plane.dot(*point, 2, REJECTED.mix(0.45).filled())?;
    }
    for point in cleaned {
        plane.dot(*point, 2, MEASURED.filled())?;
    }
    for change in changes {
        plane.curve([(*change, range.start), (*change, range.end)], Dashes::Full, ALARM.into())?;
    }
    Ok(())
}
