//! Mode shapes over height, a panel a mode, with standard deviations; beside the truth where it is known.

use std::collections::BTreeMap;

use plotters::prelude::*;

use super::canvas::{Area, Chart, DIRECTIONS, DrawResult, FRAME, MODE, PictureError, picture};
use crate::identify::{Identification, Mode};
use crate::study::{Direction, Sensor, Setup};

const COLUMNS: usize = 7;
const PANEL: (u32, u32) = (138, 250);
const HEADER: u32 = 64;

/// The true shape that belongs to a measured mode: motion by point name, largest 1.
pub type TrueShape = BTreeMap<String, f64>;

/// A measurement point: one direction at one height.
struct MeasuredPoint<'a> {
    sensor: &'a Sensor,
    elevation_m: f64,
    color: RGBColor,
}

/// Draws the shapes of all modes; dots with bars of two standard deviations are measured, thin lines join the points of
/// one vertical and direction, open circles are the truth (one entry a mode, in the modes' order). `None` where no sensor
/// has a height and a direction that is not upwards.
///
/// # Errors
/// When drawing fails.
pub fn mode_shapes(
    structure: &str,
    setups: &[Setup],
    identification: &Identification,
    truth: &[Option<TrueShape>],
) -> Result<Option<String>, PictureError> {
    let points_by_name = points_by_name(setups);
    let Some(top_m) = points_by_name.values().map(|point| point.elevation_m).max_by(f64::total_cmp) else {
        return Ok(None);
    };
    if identification.modes.is_empty() {
        return Ok(None);
    }
    let bottom_m = points_by_name.values().map(|point| point.elevation_m).fold(0.0, f64::min);
    let rows = identification.modes.len().div_ceil(COLUMNS);
    let size = (PANEL.0 * COLUMNS as u32, HEADER + PANEL.1 * rows as u32);
    picture("the mode shapes", size, |root| {
        let (header, body) = root.split_vertically(HEADER);
        draw_header(&header, structure, &points_by_name, truth.iter().any(Option::is_some))?;
        for (index, (panel, mode)) in body.split_evenly((rows, COLUMNS)).iter().zip(&identification.modes).enumerate() {
            let label = format!("{}: {:.3} Hz", mode.number, mode.frequency_hz);
            let mut chart = ChartBuilder::on(panel)
                .caption(label, ("sans-serif", 14).into_font().color(&MODE))
                .margin(6)
                .x_label_area_size(4)
                .y_label_area_size(if index % COLUMNS == 0 { 34 } else { 6 })
                .build_cartesian_2d(-1.3..1.3, bottom_m..top_m * 1.05)?;
            let labels = if index % COLUMNS == 0 { 5 } else { 0 };
            chart
                .configure_mesh()
                .disable_x_mesh()
                .disable_y_mesh()
                .x_labels(0)
                .y_labels(labels)
                .axis_style(FRAME)
                .y_label_formatter(&|m| format!("{m:.0} m"))
                .draw()?;
            let axis = LineSeries::new([(0.0, bottom_m), (0.0, top_m * 1.05)], FRAME);
            chart.draw_series(axis)?;
            draw_mode(&mut chart, mode, &points_by_name, truth.get(index).and_then(Option::as_ref))?;
        }
        Ok(())
    })
    .map(Some)
}

fn points_by_name(setups: &[Setup]) -> BTreeMap<&str, MeasuredPoint<'_>> {
    let mut directions: Vec<Direction> = Vec::new();
    let mut points_by_name = BTreeMap::new();
    for sensor in setups.iter().flat_map(|setup| &setup.sensors) {
        let (Some(elevation_m), Some(direction)) = (sensor.elevation_m, sensor.direction) else { continue };
        if !sensor.is_of_a_point() || direction == Direction::Up {
            continue;
        }
        let index = directions.iter().position(|other| *other == direction).unwrap_or_else(|| {
            directions.push(direction);
            directions.len() - 1
        });
        let color = DIRECTIONS[index % DIRECTIONS.len()];
        points_by_name.insert(sensor.point.as_str(), MeasuredPoint { sensor, elevation_m, color });
    }
    points_by_name
}

fn draw_header(
    header: &Area<'_>,
    structure: &str,
    points_by_name: &BTreeMap<&str, MeasuredPoint<'_>>,
    truth: bool,
) -> DrawResult {
    let text = |words: &str, x: i32, y: i32, size: i32, color: &RGBColor| {
        Text::new(words.to_owned(), (x, y), ("sans-serif", size).into_font().color(color))
    };
    let black = RGBColor(0, 0, 0);
    header.draw(&text(&format!("{structure}: mode shapes"), 12, 10, 20, &black))?;
    let mut legend: Vec<(String, RGBColor)> = Vec::new();
    for point in points_by_name.values() {
        let label = match point.sensor.direction {
            Some(Direction::AzimuthDeg(azimuth)) => Some(format!("● towards {azimuth}°")),
            Some(Direction::Inclined { azimuth_deg, inclination_deg }) => {
                Some(format!("● towards {azimuth_deg}°, {inclination_deg}° up"))
            }
            Some(Direction::Up) | None => None,
        };
        if let Some(label) = label.filter(|label| !legend.iter().any(|(other, _)| other == label)) {
            legend.push((label, point.color));
        }
    }
    let mut x = 14;
    for (label, color) in &legend {
        header.draw(&text(label, x, 40, 13, color))?;
        x += if label.contains(',') { 190 } else { 130 };
    }
    let rest = if truth { "bars: two standard deviations; circles: truth" } else { "bars: two standard deviations" };
    header.draw(&text(rest, x, 40, 13, &black))?;
    Ok(())
}

fn draw_mode(
    chart: &mut Chart<'_, '_>,
    mode: &Mode,
    points_by_name: &BTreeMap<&str, MeasuredPoint<'_>>,
    truth: Option<&TrueShape>,
) -> DrawResult {
    // One line for each vertical: the points of one direction and plan position.
    let mut verticals: BTreeMap<String, Vec<(f64, f64, RGBColor)>> = BTreeMap::new();
    for component in &mode.shape {
        let Some(point) = points_by_name.get(component.point.as_str()) else { continue };
        let key = format!("{:?} {:?}", point.sensor.direction, point.sensor.offset_m);
        verticals.entry(key).or_default().push((component.re, point.elevation_m, point.color));
    }
    // Two points make no curve.
    for points in verticals.values_mut().filter(|points| points.len() > 2) {
        points.sort_by(|a, b| a.1.total_cmp(&b.1));
        let color = points.first().map_or(FRAME, |point| point.2);
        chart.draw_series(LineSeries::new(points.iter().map(|&(x, y, _)| (x, y)), color.mix(0.5).stroke_width(1)))?;
    }
    for component in &mode.shape {
        let Some(point) = points_by_name.get(component.point.as_str()) else { continue };
        let (x, y) = (component.re, point.elevation_m);
        if component.std.is_finite() {
            let bar = [((x - 2.0 * component.std).max(-1.3), y), ((x + 2.0 * component.std).min(1.3), y)];
            chart.draw_series(LineSeries::new(bar, point.color.stroke_width(1)))?;
        }
        chart.draw_series(std::iter::once(Circle::new((x, y), 2, point.color.filled())))?;
        if let Some(&true_x) = truth.and_then(|truth| truth.get(&component.point)) {
            chart.draw_series(std::iter::once(Circle::new((true_x, y), 4, point.color.stroke_width(1))))?;
        }
    }
    Ok(())
}
