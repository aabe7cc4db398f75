//! Measured mode shapes over height on the model's curves, a panel a pair.

use std::collections::BTreeMap;

use plotters::prelude::*;

use super::PictureError;
use crate::compare::{Comparison, PairReport};
use crate::measured::{MeasuredMode, MeasuredShape};
use crate::model::{Assembly, Modes};
use crate::study::{Direction, Sensor};

const COLUMNS: usize = 7;
const PANEL: (u32, u32) = (138, 262);
const HEADER: u32 = 44;
/// Points of a model's curve.
const POINTS: usize = 80;
const COLORS: [RGBColor; 4] =
    [RGBColor(31, 87, 147), RGBColor(214, 124, 38), RGBColor(90, 150, 90), RGBColor(130, 90, 160)];
const FRAME: RGBColor = RGBColor(200, 200, 200);

/// Draws the pairs: dots with bars of two standard deviations are measured, curves are the model at the sensors' direction
/// and plan position. `None` where the model is no line, no pair has a shape, or no sensor a height.
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
    let fail = |reason: &dyn std::fmt::Display| PictureError("the comparison", reason.to_string());
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
    let curves = curves(assembly, modes, sensors, &verticals, [base_m, top_m]).map_err(|e| fail(&e))?;
    let rows = shapes.len().div_ceil(COLUMNS);
    let columns = shapes.len().min(COLUMNS);
    let mut svg = String::new();
    {
        let size = (PANEL.0 * columns.max(4) as u32, HEADER + PANEL.1 * rows as u32);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).map_err(|e| fail(&e))?;
        let (header, body) = root.split_vertically(HEADER);
        header
            .draw(&Text::new(
                format!("{structure}: model (curves) and measurement (dots)"),
                (10, 6),
                ("sans-serif", 15),
            ))
            .map_err(|e| fail(&e))?;
        for (index, (key, _)) in verticals.iter().enumerate() {
            let style = ("sans-serif", 12).into_font().color(&COLORS[index % COLORS.len()]);
            header.draw(&Text::new(key.clone(), (10 + 150 * index as i32, 26), style)).map_err(|e| fail(&e))?;
        }
        for (panel, (pair, shape)) in body.split_evenly((rows, columns.max(4))).iter().zip(&shapes) {
            draw(panel, pair, shape, sensors, &verticals, &curves, [base_m, top_m]).map_err(|e| fail(&e))?;
        }
        root.present().map_err(|e| fail(&e))?;
    }
    Ok(Some(svg))
}

/// Sensors of one direction, by its name.
type Verticals = BTreeMap<String, Vec<usize>>;

fn verticals(sensors: &[Sensor]) -> Verticals {
    let mut verticals = Verticals::new();
    for (index, sensor) in sensors.iter().enumerate() {
        if let (Some(_), Some(Direction::AzimuthDeg(azimuth_deg)), None) =
            (sensor.elevation_m, sensor.direction, sensor.dof)
        {
            verticals.entry(format!("{azimuth_deg}° from +X")).or_default().push(index);
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
        .values()
        .map(|indices| {
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
    panel: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    pair: &PairReport,
    shape: &MeasuredShape,
    sensors: &[Sensor],
    verticals: &Verticals,
    curves: &[Curve],
    [base_m, top_m]: [f64; 2],
) -> Result<(), Box<dyn std::error::Error>> {
    let mac = pair.mac.map_or(String::new(), |mac| format!(", MAC {:.2}", (mac * 100.0).floor() / 100.0));
    let caption = format!("{}: {:+.1} %{mac}", pair.measured, pair.frequency_error_percent);
    let mut chart = ChartBuilder::on(panel)
        .caption(caption, ("sans-serif", 12))
        .margin(4)
        .y_label_area_size(30)
        .build_cartesian_2d(-1.6..1.6, base_m..top_m)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .y_labels(5)
        .y_label_formatter(&|z| format!("{z:.0}"))
        .axis_style(FRAME)
        .draw()?;
    chart.draw_series(LineSeries::new([(0.0, base_m), (0.0, top_m)], FRAME.stroke_width(1)))?;
    let value_at = |sensor: usize| {
        let position = shape.sensors.iter().position(|&known| known == sensor)?;
        Some((shape.values[position], shape.stds.as_ref().map(|stds| stds[position])))
    };
    // The model's scale that fits the measured components best.
    let (mut product, mut square) = (0.0, 0.0);
    for (indices, curve) in verticals.values().zip(curves) {
        for &sensor in indices {
            if let (Some((value, _)), Some(z_m)) = (value_at(sensor), sensors[sensor].elevation_m) {
                let there = curve.at(z_m, pair.model - 1);
                product += there * value;
                square += there * there;
            }
        }
    }
    let scale = if square > 0.0 { product / square } else { 0.0 };
    for ((indices, curve), color) in verticals.values().zip(curves).zip(COLORS.iter().cycle()) {
        let model = curve.values.column(pair.model - 1);
        let line = curve.heights_m.iter().zip(model.iter()).map(|(&z, &value)| ((value * scale).clamp(-1.6, 1.6), z));
        chart.draw_series(LineSeries::new(line, color.stroke_width(1)))?;
        for &sensor in indices {
            let (Some((value, std)), Some(z_m)) = (value_at(sensor), sensors[sensor].elevation_m) else { continue };
            if let Some(std) = std.filter(|std| std.is_finite()) {
                let bar = [((value - 2.0 * std).max(-1.6), z_m), ((value + 2.0 * std).min(1.6), z_m)];
                chart.draw_series(LineSeries::new(bar, color.stroke_width(1)))?;
            }
            chart.draw_series(std::iter::once(Circle::new((value, z_m), 2, color.filled())))?;
        }
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
