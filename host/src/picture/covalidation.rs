//! Left-out channels over time: what was measured, and what the model's shapes made of the others.

use plotters::prelude::*;

use super::PictureError;

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

const SIZE: (u32, u32) = (960, 260);
/// Seconds that are drawn: curves of thousands of seconds are a grey band.
const DRAWN_S: f64 = 200.0;
const MEASURED: RGBColor = RGBColor(40, 40, 40);
const COLORS: [RGBColor; 4] =
    [RGBColor(190, 40, 40), RGBColor(214, 124, 38), RGBColor(31, 87, 147), RGBColor(150, 150, 150)];

/// Draws the curves, a panel a channel; predictions as differences from the measured curve in the lower panel of each.
///
/// # Errors
/// When drawing fails.
pub fn covalidation(structure: &str, curves: &[Curves]) -> Result<String, PictureError> {
    let fail = |reason: &dyn std::fmt::Display| PictureError("the co-validation", reason.to_string());
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (SIZE.0, SIZE.1 * curves.len().max(1) as u32)).into_drawing_area();
        root.fill(&WHITE).map_err(|e| fail(&e))?;
        for (panel, curve) in root.split_evenly((curves.len().max(1), 1)).iter().zip(curves) {
            draw(panel, structure, curve).map_err(|e| fail(&e))?;
        }
        root.present().map_err(|e| fail(&e))?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(panel: &Area<'_>, structure: &str, curve: &Curves) -> Result<(), Box<dyn std::error::Error>> {
    let drawn = ((DRAWN_S * curve.rate_hz) as usize).min(curve.measured.len());
    let time = |sample: usize| curve.start_s + sample as f64 / curve.rate_hz;
    let largest = curve.measured.iter().take(drawn).filter(|v| v.is_finite()).fold(0.0, |m: f64, v| m.max(v.abs()));
    let largest = if largest > 0.0 { 1.15 * largest } else { 1.0 };
    let mut chart = ChartBuilder::on(panel)
        .caption(
            format!("{structure}, channel {}: left out, and predicted from the others", curve.channel),
            ("sans-serif", 15),
        )
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(64)
        .build_cartesian_2d(time(0)..time(drawn.max(1)), -largest..largest)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc("time s")
        .y_desc("motion in the band")
        .y_label_formatter(&|value| format!("{value:.1e}"))
        .draw()?;
    let line = |values: &[f64]| -> Vec<(f64, f64)> {
        values.iter().take(drawn).enumerate().filter(|(_, v)| v.is_finite()).map(|(i, &v)| (time(i), v)).collect()
    };
    chart
        .draw_series(LineSeries::new(line(&curve.measured), MEASURED.stroke_width(2)))?
        .label("measured")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], MEASURED.stroke_width(2)));
    for (prediction, color) in curve.predictions.iter().zip(COLORS) {
        chart
            .draw_series(LineSeries::new(line(&prediction.values), color.stroke_width(1)))?
            .label(prediction.label.replace('_', " "))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(1)));
    }
    chart.configure_series_labels().border_style(MEASURED.mix(0.3)).background_style(WHITE.mix(0.8)).draw()?;
    Ok(())
}
