//! How the error fell: a panel each for frequencies, for sensors left out, for chi-squared and for shapes, step by step.

use plotters::prelude::*;

use super::canvas::{Area, BESIDE, DrawResult, MODE, PictureError, picture};
use crate::diagnose::steps::StepRecord;

const WIDTH: u32 = 960;
const PANEL: u32 = 165;
const TITLE: u32 = 34;
const NAMES: u32 = 90;
const THIRD: RGBColor = RGBColor(110, 110, 110);

/// A line of a panel: what it is, its values (none where a step has none), its colour.
struct Line {
    name: &'static str,
    values: Vec<Option<f64>>,
    color: RGBColor,
}

/// Draws the steps; on logarithmic scales, as an error that matters falls by factors.
///
/// # Errors
/// When drawing fails.
pub fn history(structure: &str, steps: &[StepRecord]) -> Result<String, PictureError> {
    let line = |name, color, value: &dyn Fn(&StepRecord) -> Option<f64>| Line {
        name,
        values: steps.iter().map(value).collect(),
        color,
    };
    let panels = [
        vec![
            line("frequency error %", MODE, &|step| Some(step.mean_abs_frequency_error_percent)),
            line("of modes left out", BESIDE, &|step| step.held_out_mode_error_percent),
        ],
        vec![line("motion of sensors left out, error %", BESIDE, &|step| step.held_out_error_percent)],
        vec![line("chi-squared over numbers compared", MODE, &|step| {
            Some(step.chi_squared / step.degrees_of_freedom.max(1) as f64)
        })],
        vec![line("1 - MAC, %", THIRD, &|step| step.mean_mac.map(|mac| 100.0 * (1.0 - mac)))],
    ];
    let panels: Vec<&Vec<Line>> =
        panels.iter().filter(|lines| lines.iter().any(|line| line.values.iter().any(Option::is_some))).collect();
    let size = (WIDTH, TITLE + NAMES + PANEL * panels.len() as u32);
    picture("the history", size, |root| {
        let title = format!("{structure}: how the error fell");
        root.draw(&Text::new(title, (10, 9), ("sans-serif", 16)))?;
        let (_, mut rest) = root.split_vertically(TITLE);
        for (index, panel) in panels.iter().enumerate() {
            let is_last = index + 1 == panels.len();
            let (area, below) = rest.split_vertically(if is_last { PANEL + NAMES } else { PANEL });
            draw(&area, panel, steps, is_last)?;
            rest = below;
        }
        Ok(())
    })
}

fn draw(area: &Area<'_>, lines: &[Line], steps: &[StepRecord], is_last: bool) -> DrawResult {
    let values = || lines.iter().flat_map(|line| line.values.iter().flatten()).copied().filter(|value| *value > 0.0);
    let (lowest, highest) = (values().fold(f64::INFINITY, f64::min), values().fold(1e-6, f64::max));
    let last = steps.len() as f64 - 0.5;
    // Whole powers of ten, so that the scale has its numbers; values stay off the frame.
    let floor = 10f64.powf((0.8 * lowest.min(highest)).log10().floor());
    let ceiling = 10f64.powf((1.25 * highest).log10().ceil());
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(12)
        .margin_top(22)
        .x_label_area_size(if is_last { NAMES } else { 0 })
        .y_label_area_size(64)
        .build_cartesian_2d(-0.5..last, (floor..ceiling).log_scale())?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .light_line_style(WHITE)
        .y_labels(6)
        .y_label_formatter(&|value| digits(*value))
        .label_style(("sans-serif", 11))
        .draw()?;
    for (index, line) in lines.iter().enumerate() {
        let points: Vec<(f64, f64)> = line
            .values
            .iter()
            .enumerate()
            .filter_map(|(step, value)| Some((step as f64, value.filter(|value| *value > 0.0)?)))
            .collect();
        chart.draw_series(LineSeries::new(points.iter().copied(), line.color.stroke_width(2)))?;
        chart.draw_series(points.iter().map(|point| Circle::new(*point, 3, line.color.filled())))?;
        let beside = |point: &(f64, f64)| {
            let (x, y) = chart.backend_coord(point);
            let (left, top) = area.get_base_pixel();
            // The larger of two values is written above its point, the smaller below.
            let mut others = lines.iter().filter_map(|line| *line.values.get(point.0 as usize)?);
            let is_largest = others.all(|other| other <= point.1);
            (x - left + 7, y - top + if is_largest { -14 } else { 4 })
        };
        for point in &points {
            area.draw(&Text::new(digits(point.1), beside(point), ("sans-serif", 11).into_font().color(&line.color)))?;
        }
        let at = (76 + 300 * index as i32, 5);
        area.draw(&Rectangle::new([(at.0, at.1 + 3), (at.0 + 10, at.1 + 9)], line.color.filled()))?;
        area.draw(&Text::new(line.name, (at.0 + 16, at.1), ("sans-serif", 12)))?;
    }
    if is_last {
        for (index, step) in steps.iter().enumerate() {
            let (x, y) = chart.backend_coord(&(index as f64, floor));
            let (left, top) = area.get_base_pixel();
            for (row, word) in step.action.split(", ").flat_map(words).take(5).enumerate() {
                let style = ("sans-serif", 11).into_font().color(&BLACK);
                let style = style.pos(plotters::style::text_anchor::Pos::new(
                    plotters::style::text_anchor::HPos::Center,
                    plotters::style::text_anchor::VPos::Top,
                ));
                area.draw(&Text::new(word, (x - left, y - top + 6 + 14 * row as i32), style))?;
            }
        }
    }
    Ok(())
}

/// Three digits.
fn digits(value: f64) -> String {
    format!("{value:.*}", (2.0 - value.abs().log10().floor()).clamp(0.0, 4.0) as usize)
}

/// `add NAME@PLACE` in lines that fit below a step.
fn words(action: &str) -> Vec<String> {
    action.replacen('@', " @", 2).split(' ').map(str::to_owned).collect()
}
