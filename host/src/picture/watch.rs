//! Days of a watch: every mode's frequency as it was seen and less what surroundings do, with the changes that were found.

use plotters::prelude::*;

use super::canvas::{
    Area, Dashes, DrawResult, FRAME, MEASURED, PictureError, Plane, REJECTED, axis_digits, fixed, picture,
};
use crate::colour;
use crate::watch::{Judgement, State};

const WIDTH: u32 = 960;
const PANEL: u32 = 112;
const TITLE: u32 = 56;
const AXIS: u32 = 40;
const DAY_S: f64 = 86_400.0;
const ALARM: RGBColor = colour::BAD.on_paper();

/// Draws a panel a mode; `None` where there are no days.
///
/// # Errors
/// When drawing fails.
pub fn watch(structure: &str, modes: &[(usize, f64)], judgement: &Judgement) -> Result<Option<String>, PictureError> {
    let (Some(first), Some(last)) = (judgement.days_s.first(), judgement.days_s.last()) else { return Ok(None) };
    let days: Vec<f64> = judgement.days_s.iter().map(|day_s| (day_s - first) / DAY_S).collect();
    let span = ((last - first) / DAY_S).max(1.0);
    let size = (WIDTH, TITLE + AXIS + PANEL * modes.len() as u32);
    picture("the watch", size, |root| {
        root.draw(&Text::new(format!("{structure}: modes day by day"), (12, 8), ("sans-serif", 16)))?;
        let words = "Grey: as measured. Blue: less what temperature, vibration level and season do. Red line: a change. Days of frost are left out.";
        root.draw(&Text::new(words, (12, 32), ("sans-serif", 13)))?;
        let (_, mut rest) = root.split_vertically(TITLE);
        for (index, (number, hz)) in modes.iter().enumerate() {
            let is_last = index + 1 == modes.len();
            let (area, below) = rest.split_vertically(if is_last { PANEL + AXIS } else { PANEL });
            let points = |values: &[Option<f64>]| -> Vec<(f64, f64)> {
                days.iter().zip(values).filter_map(|(day, value)| Some((*day, (*value)?))).collect()
            };
            let seen = judgement.seen_percent.get(index).map_or_else(Vec::new, |values| points(values));
            let cleaned: Vec<(f64, f64)> = judgement
                .cleaned_percent
                .get(index)
                .map_or_else(Vec::new, |values| days.iter().copied().zip(values.iter().copied()).collect());
            let changes: Vec<f64> = judgement
                .alarms
                .iter()
                .filter(|alarm| alarm.state != State::Withdrawn)
                .map(|alarm| (alarm.first_day_s - first) / DAY_S - 0.5)
                .collect();
            draw(&area, &format!("mode {number}: frequency, in % off its mean ({hz:.4} Hz now)"), [&seen, &cleaned], &changes, span, is_last)?;
            rest = below;
        }
        Ok(())
    })
    .map(Some)
}

fn draw(
    area: &Area<'_>,
    name: &str,
    [seen, cleaned]: [&[(f64, f64)]; 2],
    changes: &[f64],
    span: f64,
    is_last: bool,
) -> DrawResult {
    let values = || seen.iter().chain(cleaned).map(|(_, value)| *value);
    let lowest = values().fold(f64::INFINITY, f64::min);
    let highest = values().fold(f64::NEG_INFINITY, f64::max);
    let room = if highest > lowest { 0.1 * (highest - lowest) } else { 0.01 };
    let range = if lowest.is_finite() { lowest - room..highest + room } else { -1.0..1.0 };
    let height = range.end - range.start;
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(14)
        .margin_top(20)
        .x_label_area_size(if is_last { AXIS } else { 0 })
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..span, range.clone())?;
    let day = |day: &f64| fixed(*day, axis_digits(span));
    let label = |value: &f64| fixed(*value, axis_digits(height));
    let mut mesh = chart.configure_mesh();
    mesh.disable_x_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FRAME.mix(0.6))
        .y_labels(5)
        .x_label_formatter(&day)
        .y_label_formatter(&label)
        .label_style(("sans-serif", 12))
        .axis_desc_style(("sans-serif", 13));
    if is_last {
        mesh.x_desc("days after the first");
    }
    mesh.draw()?;
    area.draw(&Text::new(name.to_owned(), (76, 4), ("sans-serif", 13)))?;
    let plane = Plane::of(&chart, 0.0..span, range.clone(), false);
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
