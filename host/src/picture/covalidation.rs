//! Left-out channels over time: what was measured, and what the model's shapes made of the others.

use plotters::prelude::*;

use super::canvas::{Area, DrawResult, PictureError, picture};

/// A left-out channel over time.
#[derive(Debug, Clone)]
pub struct Curves {
    /// Its name.
    pub channel: String,
    /// Time of the first sample, in s.
    pub start_s: f64,
    /// Samples a second.
    pub rate_hz: f64,
    /// What was measured; NaN where not sound.
    pub measured: Vec<f64>,
    /// What was predicted.
    pub predictions: Vec<Prediction>,
}

/// A predicted curve.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Whose shapes it comes from.
    pub label: &'static str,
    /// Samples as of the measured curve.
    pub values: Vec<f64>,
}

const SIZE: (u32, u32) = (960, 420);
/// Height of a channel's title and legend.
const HEADER: u32 = 42;
/// Height of its upper panel.
const UPPER: u32 = 225;
/// Seconds that are drawn: curves of thousands of seconds are a grey band.
const DRAWN_S: f64 = 100.0;
const MEASURED: RGBColor = RGBColor(40, 40, 40);
const COLORS: [RGBColor; 4] =
    [RGBColor(244, 170, 160), RGBColor(200, 50, 40), RGBColor(60, 140, 70), RGBColor(31, 87, 147)];

/// Draws the curves, two panels a channel: the motion, and below it how far each prediction is off. Where a sample is not
/// sound the lines are broken.
///
/// # Errors
/// When drawing fails.
pub fn covalidation(structure: &str, curves: &[Curves]) -> Result<String, PictureError> {
    picture("the co-validation", (SIZE.0, SIZE.1 * curves.len().max(1) as u32), |root| {
        for (panel, curve) in root.split_evenly((curves.len().max(1), 1)).iter().zip(curves) {
            draw(panel, structure, curve)?;
        }
        Ok(())
    })
}

/// A curve by the name and colour it is drawn with.
struct Line<'a> {
    label: String,
    values: &'a [f64],
    color: RGBColor,
    width: u32,
}

fn draw(panel: &Area<'_>, structure: &str, curve: &Curves) -> DrawResult {
    let (header, body) = panel.split_vertically(HEADER);
    let (upper, lower) = body.split_vertically(UPPER);
    let measured = Line { label: "measured".to_owned(), values: &curve.measured, color: MEASURED, width: 2 };
    // The first is wider, so that it shows beneath one that lies on it.
    let looks = COLORS.iter().cycle().zip(std::iter::once(3).chain(std::iter::repeat(1)));
    let predicted = curve.predictions.iter().zip(looks).map(|(prediction, (&color, width))| Line {
        label: prediction.label.replace('_', " "),
        values: &prediction.values,
        color,
        width,
    });
    let lines: Vec<Line<'_>> = std::iter::once(measured).chain(predicted).collect();
    let title = format!("{structure}, channel {}: left out, and predicted from the others", curve.channel);
    header.draw(&Text::new(title, (10, 6), ("sans-serif", 15)))?;
    for (index, line) in lines.iter().enumerate() {
        let x = 72 + 150 * index as i32;
        header.draw(&PathElement::new([(x, 33), (x + 18, 33)], line.color.stroke_width(line.width)))?;
        header.draw(&Text::new(line.label.clone(), (x + 24, 26), ("sans-serif", 12)))?;
    }
    axes(&upper, curve, "m/s² in the band", &lines)?;
    let differences: Vec<Vec<f64>> = lines
        .iter()
        .skip(1)
        .map(|line| line.values.iter().zip(&curve.measured).map(|(value, measured)| value - measured).collect())
        .collect();
    let differences: Vec<Line<'_>> = lines
        .iter()
        .skip(1)
        .zip(&differences)
        .map(|(line, values)| Line { label: String::new(), values, color: line.color, width: line.width })
        .collect();
    axes(&lower, curve, "prediction - measured", &differences)
}

fn axes(panel: &Area<'_>, curve: &Curves, y_name: &str, lines: &[Line<'_>]) -> DrawResult {
    let drawn = ((DRAWN_S * curve.rate_hz) as usize).min(curve.measured.len());
    let time = |sample: usize| curve.start_s + sample as f64 / curve.rate_hz;
    let drawn_values = lines.iter().flat_map(|line| line.values.iter().take(drawn));
    let largest = drawn_values.filter(|value| value.is_finite()).fold(0.0, |m: f64, value| m.max(value.abs()));
    let largest = if largest > 0.0 { 1.15 * largest } else { 1.0 };
    let mut chart = ChartBuilder::on(panel)
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(64)
        .build_cartesian_2d(time(0)..time(drawn.max(1)), -largest..largest)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .y_labels(5)
        .x_desc("time s")
        .y_desc(y_name)
        .y_label_formatter(&|value| if value.abs() < 1e-6 * largest { "0".to_owned() } else { format!("{value:.1e}") })
        .draw()?;
    for line in lines {
        let style = line.color.stroke_width(line.width);
        let points: Vec<(f64, f64)> =
            line.values.iter().take(drawn).enumerate().map(|(sample, &value)| (time(sample), value)).collect();
        for sound in points.chunk_by(|a, b| a.1.is_finite() && b.1.is_finite()).filter(|part| part[0].1.is_finite()) {
            chart.draw_series(LineSeries::new(sound.iter().copied(), style))?;
        }
    }
    Ok(())
}
