//! Measured mode shapes over height on the model's curves, a panel a pair.

use plotters::prelude::*;

use super::canvas::{Area, DIRECTIONS, DrawResult, FRAME, PictureError, panel_over_height, picture};
use crate::compare::{Comparison, HeightMisfit, PairReport};
use crate::model::{Assembly, Modes};
use crate::modes::{MeasuredMode, MeasuredShape};
use crate::study::{Direction, Sensor};

const WHAT: &str = "the comparison";
const COLUMNS: usize = 7;
const PANEL: (u32, u32) = (138, 262);
const HEADER: u32 = 44;
/// Points of a model's curve.
const POINTS: usize = 160;
/// Motion at a panel's edge; the largest measured component is 1.
const EDGE: f64 = 1.6;
const MISFIT: RGBColor = RGBColor(190, 60, 60);

/// Draws the pairs: dots with bars of two standard deviations are measured, curves are the model at the sensors' direction
/// and plan position; the last panel is the misfit by height. `None` where the model is no line, no pair has a shape, or no sensor a height.
///
/// # Errors
/// When drawing fails.
pub fn comparison(
    structure: &str,
    assembly: &Assembly,
    modes: &Modes,
    sensors: &[Sensor],
    measured: &[MeasuredMode],
    comparison: &Comparison,
) -> Result<Option<String>, PictureError> {
    let verticals = verticals(sensors);
    let shapes: Vec<(&PairReport, &MeasuredShape)> = comparison
        .pairs
        .iter()
        .filter_map(|pair| {
            let mode = measured.iter().find(|mode| mode.number == pair.measured)?;
            Some((pair, mode.shape.as_ref()?))
        })
        .collect();
    let heights = assembly.node_elevations_m();
    let (Some(&top_m), false, false) = (heights.last(), verticals.is_empty(), shapes.is_empty()) else {
        return Ok(None);
    };
    let base_m = assembly.z_base_m();
    let range_m = [base_m, top_m];
    let curves = curves(assembly, modes, sensors, &verticals, range_m)
        .map_err(|error| PictureError { what: WHAT, reason: error.to_string() })?;
    let panels = shapes.len() + 1;
    let rows = panels.div_ceil(COLUMNS);
    let columns = panels.clamp(4, COLUMNS);
    let size = (PANEL.0 * columns as u32, HEADER + PANEL.1 * rows as u32);
    picture(WHAT, size, |root| {
        let (header, body) = root.split_vertically(HEADER);
        header.draw(&Text::new(
            format!("{structure}: model (curves) and measurement (dots, bars of two deviations), heights in m"),
            (10, 6),
            ("sans-serif", 15),
        ))?;
        for (index, (key, _)) in verticals.iter().enumerate() {
            let style = ("sans-serif", 12).into_font().color(&DIRECTIONS[index % DIRECTIONS.len()]);
            header.draw(&Text::new(key.clone(), (10 + 150 * index as i32, 26), style))?;
        }
        let panels = body.split_evenly((rows, columns));
        for (panel, (pair, shape)) in panels.iter().zip(&shapes) {
            draw(panel, pair, shape, sensors, &verticals, &curves, range_m)?;
        }
        panels.get(shapes.len()).map_or(Ok(()), |panel| draw_misfit(panel, &comparison.by_height, range_m))
    })
    .map(Some)
}

/// Sensors of one direction, by its name.
type Verticals = Vec<(String, Vec<usize>)>;

fn verticals(sensors: &[Sensor]) -> Verticals {
    // In the order in which the study names them, as the picture of the measured shapes has them.
    let mut verticals = Verticals::new();
    for (index, sensor) in sensors.iter().enumerate() {
        if let (Some(_), Some(Direction::AzimuthDeg(azimuth_deg)), None) =
            (sensor.elevation_m, sensor.direction, sensor.dof)
        {
            let name = format!("towards {azimuth_deg}°");
            match verticals.iter_mut().find(|(known, _)| *known == name) {
                Some((_, indices)) => indices.push(index),
                None => verticals.push((name, vec![index])),
            }
        }
    }
    verticals
}

/// A direction's curve of every mode: heights x modes.
struct Curve {
    heights_m: Vec<f64>,
    values: nalgebra::DMatrix<f64>,
}

fn curves(
    assembly: &Assembly,
    modes: &Modes,
    sensors: &[Sensor],
    verticals: &Verticals,
    [base_m, top_m]: [f64; 2],
) -> Result<Vec<Curve>, crate::model::SensorError> {
    let heights_m: Vec<f64> = (0..POINTS).map(|i| base_m + (top_m - base_m) * i as f64 / (POINTS - 1) as f64).collect();
    verticals
        .iter()
        .map(|(_, indices)| {
            // The plan position that most sensors of the direction share; torsion looks different at the others.
            let sharing = |&index: &usize| {
                indices.iter().filter(|&&other| sensors[other].offset_m == sensors[index].offset_m).count()
            };
            let typical = indices.iter().rev().copied().max_by_key(sharing).unwrap_or(indices[0]);
            let along: Vec<Sensor> =
                heights_m.iter().map(|&z_m| Sensor { elevation_m: Some(z_m), ..sensors[typical].clone() }).collect();
            Ok(Curve { heights_m: heights_m.clone(), values: assembly.sensor_rows(&along)? * &modes.shapes })
        })
        .collect()
}

fn draw(
    panel: &Area<'_>,
    pair: &PairReport,
    shape: &MeasuredShape,
    sensors: &[Sensor],
    verticals: &Verticals,
    curves: &[Curve],
    [base_m, top_m]: [f64; 2],
) -> DrawResult {
    let mac = pair.mac.map_or(String::new(), |mac| format!(", MAC {:.3}", (mac * 1000.0).floor() / 1000.0));
    let caption = format!("{}: {:+.1} %{mac}", pair.measured, pair.frequency_error_percent);
    let mut chart = panel_over_height(panel, caption, -EDGE..EDGE, [base_m, top_m])?;
    chart.draw_series(LineSeries::new([(0.0, base_m), (0.0, top_m)], FRAME.stroke_width(1)))?;
    let value_at = |sensor: usize| {
        let position = shape.sensors.iter().position(|&known| known == sensor)?;
        Some((shape.values[position], shape.stds.as_ref().map(|stds| stds[position])))
    };
    // The model's scale that fits the measured components best.
    let (mut product, mut square) = (0.0, 0.0);
    for ((_, indices), curve) in verticals.iter().zip(curves) {
        for &sensor in indices {
            if let (Some((value, _)), Some(z_m)) = (value_at(sensor), sensors[sensor].elevation_m) {
                let there = curve.at(z_m, pair.model - 1);
                product += there * value;
                square += there * there;
            }
        }
    }
    let scale = if square > 0.0 { product / square } else { 0.0 };
    for (((_, indices), curve), color) in verticals.iter().zip(curves).zip(DIRECTIONS.iter().cycle()) {
        let model = curve.values.column(pair.model - 1);
        let line: Vec<(f64, f64)> =
            curve.heights_m.iter().zip(model.iter()).map(|(&z, &value)| (value * scale, z)).collect();
        // A mast may swing far beyond the sensors' motion: the curve ends at the panel's edge.
        let inside = |point: &(f64, f64)| point.0.abs() <= EDGE;
        for part in line.chunk_by(|a, b| inside(a) && inside(b)).filter(|part| part.len() > 1) {
            chart.draw_series(LineSeries::new(part.iter().copied(), color.stroke_width(1)))?;
        }
        for &sensor in indices {
            let (Some((value, std)), Some(z_m)) = (value_at(sensor), sensors[sensor].elevation_m) else { continue };
            if let Some(std) = std.filter(|std| std.is_finite()) {
                let bar = [((value - 2.0 * std).max(-EDGE), z_m), ((value + 2.0 * std).min(EDGE), z_m)];
                chart.draw_series(LineSeries::new(bar, color.stroke_width(1)))?;
            }
            chart.draw_series(std::iter::once(Circle::new((value, z_m), 2, color.filled())))?;
        }
    }
    Ok(())
}

/// The shapes' misfit by height.
fn draw_misfit(panel: &Area<'_>, levels: &[HeightMisfit], range_m: [f64; 2]) -> DrawResult {
    let largest = levels.iter().map(|level| level.misfit).fold(f64::MIN_POSITIVE, f64::max);
    let caption = format!("misfit, at most {:.0} %", 100.0 * largest);
    let mut chart = panel_over_height(panel, caption, 0.0..1.05 * largest, range_m)?;
    for level in levels {
        let bar = [(0.0, level.elevation_m), (level.misfit, level.elevation_m)];
        chart.draw_series(LineSeries::new(bar, MISFIT.stroke_width(5)))?;
    }
    Ok(())
}

impl Curve {
    /// Value at a height, between the curve's points.
    fn at(&self, z_m: f64, mode: usize) -> f64 {
        let above = self.heights_m.partition_point(|&height| height < z_m).clamp(1, self.heights_m.len() - 1);
        let (low, high) = (self.heights_m[above - 1], self.heights_m[above]);
        let share = ((z_m - low) / (high - low)).clamp(0.0, 1.0);
        self.values[(above - 1, mode)] * (1.0 - share) + self.values[(above, mode)] * share
    }
}
