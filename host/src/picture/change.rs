//! What has changed between two measurements: the change of each frequency with two deviations and what the named effect makes of it; beside
//! that, where the effect is on the structure.

use plotters::prelude::*;

use super::canvas::{
    Area, Chart, Dashes, DrawResult, FRAME, INK, MEASURED, PictureError, Plane, WITH_EFFECTS, picture, signed,
};
use crate::change::ModeChange;
use crate::diagnose::Predicted;
use crate::numbers::metres;

const WIDTH: u32 = 760;
const HEIGHT: u32 = 340;
const TITLE: u32 = 44;
const OF_PLACE: u32 = 190;
/// Room above the largest and below the least change, in shares of their distance.
const AROUND: f64 = 0.1;

/// A height with its deviation in m, and base and top of the structure.
type Place = ((f64, Option<f64>), [f64; 2]);

/// Draws the changes; `place` is where the named effect is.
///
/// # Errors
/// When drawing fails.
pub fn change(
    structure: &str,
    modes: &[ModeChange],
    predicted: &[Predicted],
    place: Option<Place>,
) -> Result<String, PictureError> {
    let width = WIDTH + if place.is_some() { OF_PLACE } else { 0 };
    picture("the change", (width, HEIGHT), |root| {
        let (header, body) = root.split_vertically(TITLE);
        let title = format!("{structure}: change of each frequency in %, bars of two deviations");
        header.draw(&Text::new(title, (10, 6), ("sans-serif", 15)))?;
        let style = |color: &RGBColor| ("sans-serif", 12).into_font().color(color);
        header.draw(&Text::new("measured", (10, 26), style(&MEASURED)))?;
        if predicted.iter().any(|one| one.predicted_percent.is_some()) {
            header.draw(&Text::new("with the named effect", (90, 26), style(&WITH_EFFECTS)))?;
        }
        let (of_modes, of_place) = body.split_horizontally(WIDTH);
        draw_modes(&of_modes, modes, predicted)?;
        place.map_or(Ok(()), |place| draw_place(&of_place, place))
    })
}

fn draw_modes(area: &Area<'_>, modes: &[ModeChange], predicted: &[Predicted]) -> DrawResult {
    let ends = |mode: &ModeChange| [-2.0, 2.0].map(|times| mode.change_percent + times * mode.change_percent_std);
    let values = modes.iter().flat_map(ends).chain(predicted.iter().filter_map(|one| one.predicted_percent));
    let (least, most) = values.fold((0.0f64, 0.0f64), |(least, most), value| (least.min(value), most.max(value)));
    let room = (AROUND * (most - least)).max(f64::MIN_POSITIVE);
    let count = modes.len() as f64;
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(50)
        .build_cartesian_2d(0.5..count + 0.5, least - room..most + room)?;
    let number = |place: &f64| {
        let mode = (place.round() - 1.0).max(0.0) as usize;
        let is_whole = (place - place.round()).abs() < 1e-6;
        modes.get(mode).filter(|_| is_whole).map_or_else(String::new, |mode| mode.now.to_string())
    };
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE)
        .axis_style(FRAME)
        .x_labels(modes.len().max(1) + 1)
        .x_label_formatter(&number)
        .x_desc("mode")
        .y_label_formatter(&|percent| signed(*percent, 2))
        .label_style(("sans-serif", 11))
        .draw()?;
    let plane = Plane::of(&chart, 0.5..count + 0.5, least - room..most + room, false);
    plane.curve([(0.5, 0.0), (count + 0.5, 0.0)], Dashes::Full, INK.stroke_width(1))?;
    for (mode, place) in modes.iter().zip(1..) {
        let place = f64::from(place);
        let [low, high] = ends(mode);
        plane.curve([(place, low), (place, high)], Dashes::Full, MEASURED.stroke_width(1))?;
        plane.dot((place, mode.change_percent), 3, MEASURED.filled())?;
        let effect = predicted.iter().find(|one| one.now == mode.now).and_then(|one| one.predicted_percent);
        if let Some(percent) = effect {
            let beside = [(place + 0.12, percent), (place + 0.42, percent)];
            plane.curve(beside, Dashes::Full, WITH_EFFECTS.stroke_width(3))?;
        }
    }
    Ok(())
}

/// A small panel over height.
fn over_height<'a, 'b>(
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

fn draw_place(area: &Area<'_>, ((z_m, std_m), [base_m, top_m]): Place) -> DrawResult {
    let caption = format!("where: {}", metres(z_m));
    let mut chart = over_height(area, caption, -1.0..1.0, [base_m, top_m])?;
    chart.draw_series(LineSeries::new([(0.0, base_m), (0.0, top_m)], FRAME.stroke_width(5)))?;
    if let Some(std_m) = std_m.filter(|std_m| std_m.is_finite()) {
        let bar = [(0.0, (z_m - 2.0 * std_m).max(base_m)), (0.0, (z_m + 2.0 * std_m).min(top_m))];
        chart.draw_series(LineSeries::new(bar, WITH_EFFECTS.stroke_width(5)))?;
    }
    chart.draw_series(std::iter::once(Circle::new((0.0, z_m), 6, WITH_EFFECTS.filled())))?;
    Ok(())
}
