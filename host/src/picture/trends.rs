//! Modes over the hours: every mode's frequency with its deviation, beside temperature and response level.

use plotters::prelude::*;

use super::canvas::{Area, BESIDE, DrawResult, MODE, PictureError, picture};
use crate::trend::{IntervalMode, Trend, TrendInterval};

const WIDTH: u32 = 960;
const PANEL: u32 = 120;
const TITLE: u32 = 34;
const AXIS: u32 = 36;

/// A point of a panel: time in hours, value, and its standard deviation.
type Point = (f64, f64, f64);

/// A panel's points.
struct Panel {
    name: String,
    points: Vec<Point>,
    color: RGBColor,
}

/// Draws a panel a mode, below one for the temperature (where there is one) and one for the response level; of the setup with
/// the most intervals where there are several. `None` where no interval shows a mode.
///
/// # Errors
/// When drawing fails.
pub fn trends(structure: &str, trend: &Trend) -> Result<Option<String>, PictureError> {
    let intervals = longest(&trend.intervals);
    let panels = panels(trend, &intervals);
    if panels.is_empty() {
        return Ok(None);
    }
    let hours = intervals.iter().map(|interval| interval.end_s / 3600.0).fold(0.0, f64::max);
    let size = (WIDTH, TITLE + AXIS + PANEL * panels.len() as u32);
    picture("the trends", size, |root| {
        let title = format!("{structure}: every {}", humantime::format_duration(duration(trend.every_s)));
        root.draw(&Text::new(title, (10, 9), ("sans-serif", 16)))?;
        let (_, mut rest) = root.split_vertically(TITLE);
        for (index, panel) in panels.iter().enumerate() {
            let is_last = index + 1 == panels.len();
            let (area, below) = rest.split_vertically(if is_last { PANEL + AXIS } else { PANEL });
            draw(&area, panel, hours, is_last)?;
            rest = below;
        }
        Ok(())
    })
    .map(Some)
}

fn duration(seconds: f64) -> std::time::Duration {
    std::time::Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

/// The intervals of the setup that has most of them.
fn longest(intervals: &[TrendInterval]) -> Vec<&TrendInterval> {
    let count = |setup: &str| intervals.iter().filter(|interval| interval.setup == setup).count();
    let setup = intervals.iter().map(|interval| interval.setup.as_str()).max_by_key(|setup| count(setup));
    intervals.iter().filter(|interval| Some(interval.setup.as_str()) == setup).collect()
}

fn panels(trend: &Trend, intervals: &[&TrendInterval]) -> Vec<Panel> {
    let hour = |interval: &TrendInterval| 0.5 * (interval.start_s + interval.end_s) / 3600.0;
    let mut panels = Vec::new();
    let temperatures = intervals.iter().filter_map(|i| Some((hour(i), i.temperature_degc?, 0.0))).collect();
    panels.push(Panel { name: "temperature in °C".to_owned(), points: temperatures, color: BESIDE });
    let strongest = |interval: &TrendInterval| {
        interval.modes.iter().map(|mode| mode.response_rms.powi(2)).sum::<f64>().sqrt().log10()
    };
    let levels = intervals.iter().filter(|i| !i.modes.is_empty()).map(|i| (hour(i), strongest(i), 0.0)).collect();
    panels.push(Panel {
        name: "response of all modes, log10 of its RMS in m/s² (m/s of a velocity)".to_owned(),
        points: levels,
        color: BESIDE,
    });
    for mode in &trend.modes {
        let percent = |seen: &IntervalMode| {
            let scale = 100.0 / mode.frequency_hz;
            (scale * (seen.frequency_hz - mode.frequency_hz), scale * seen.frequency_std_hz)
        };
        let points = intervals
            .iter()
            .filter_map(|interval| {
                let (value, std) = percent(interval.modes.iter().find(|seen| seen.number == mode.number)?);
                Some((hour(interval), value, if std.is_finite() { std } else { 0.0 }))
            })
            .collect();
        let name = format!("mode {}: frequency about {:.4} Hz, in % of it", mode.number, mode.frequency_hz);
        panels.push(Panel { name, points, color: MODE });
    }
    panels.retain(|panel| !panel.points.is_empty());
    panels
}

fn draw(area: &Area<'_>, panel: &Panel, hours: f64, is_last: bool) -> DrawResult {
    let lowest = panel.points.iter().map(|(_, value, std)| value - std).fold(f64::INFINITY, f64::min);
    let highest = panel.points.iter().map(|(_, value, std)| value + std).fold(f64::NEG_INFINITY, f64::max);
    let room = (0.1 * (highest - lowest)).max(1e-3);
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(12)
        .margin_top(18)
        .x_label_area_size(if is_last { AXIS } else { 0 })
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..hours, lowest - room..highest + room)?;
    let mut mesh = chart.configure_mesh();
    mesh.disable_x_mesh()
        .light_line_style(WHITE)
        .y_labels(5)
        .y_label_formatter(&|value| format!("{:.2}", value + 0.0))
        .label_style(("sans-serif", 11));
    if is_last {
        mesh.x_desc("hours after the recording's first row");
    }
    mesh.draw()?;
    area.draw(&Text::new(panel.name.clone(), (76, 3), ("sans-serif", 12)))?;
    chart.draw_series(LineSeries::new(panel.points.iter().map(|&(x, y, _)| (x, y)), panel.color.mix(0.35)))?;
    let bars = panel.points.iter().filter(|point| point.2 > 0.0);
    chart.draw_series(bars.map(|&(x, y, std)| PathElement::new([(x, y - std), (x, y + std)], panel.color)))?;
    chart.draw_series(panel.points.iter().map(|&(x, y, _)| Circle::new((x, y), 2, panel.color.filled())))?;
    Ok(())
}
