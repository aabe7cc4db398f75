//! What all pictures have in common: the canvas, its colours, and a panel over height.
//!
//! A size and a function that draws flow in; SVG text, or which picture could not be drawn and why, flows out.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use thiserror::Error;

/// The colour of modes.
pub(super) const MODE: RGBColor = RGBColor(190, 40, 40);
/// Of what stands beside the modes.
pub(super) const BESIDE: RGBColor = RGBColor(31, 87, 147);
/// Of axes.
pub(super) const FRAME: RGBColor = RGBColor(200, 200, 200);
/// One colour a direction, by azimuth.
pub(super) const DIRECTIONS: [RGBColor; 4] =
    [BESIDE, RGBColor(214, 124, 38), RGBColor(90, 150, 90), RGBColor(130, 90, 160)];

/// A picture could not be drawn.
#[derive(Debug, Error)]
#[error("the picture of {what} could not be drawn: {reason}")]
pub struct PictureError {
    pub(super) what: &'static str,
    pub(super) reason: String,
}

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
pub(super) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
pub(super) type DrawResult<T = ()> = Result<T, Box<dyn std::error::Error>>;

/// What `draw` makes of a white canvas.
pub(super) fn picture(
    what: &'static str,
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<String, PictureError> {
    let mut svg = String::new();
    let drawn = (|| {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root)?;
        Ok(root.present()?)
    })();
    drawn.map(|()| svg).map_err(|reason: Box<dyn std::error::Error>| PictureError { what, reason: reason.to_string() })
}

/// A small panel over height.
pub(super) fn panel_over_height<'a, 'b>(
    panel: &'a Area<'b>,
    caption: String,
    values: std::ops::Range<f64>,
    [base_m, top_m]: [f64; 2],
) -> DrawResult<Chart<'a, 'b>> {
    let mut chart = ChartBuilder::on(panel)
        .caption(caption, ("sans-serif", 12))
        .margin(4)
        .y_label_area_size(30)
        .build_cartesian_2d(values, base_m..top_m)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .y_labels(5)
        .y_label_formatter(&|z| format!("{z:.0}"))
        .axis_style(FRAME)
        .draw()?;
    Ok(chart)
}
