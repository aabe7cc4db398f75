//! Panels over one axis of time, one above the other, as pictures of trends and of a watch have them.

use std::ops::Range;

use plotters::prelude::*;

use super::canvas::{Area, DrawResult, FRAME, PictureError, Plane, axis_digits, fixed, picture};

const WIDTH: u32 = 960;
const TITLE: u32 = 56;
const AXIS: u32 = 40;

/// A picture of parts of these heights in pixels, one below the other; `draw` gets the area of each.
pub(super) fn parts(
    what: &'static str,
    [title, words]: [&str; 2],
    heights: &[u32],
    draw: impl Fn(usize, &Area<'_>) -> DrawResult,
) -> Result<String, PictureError> {
    picture(what, (WIDTH, TITLE + heights.iter().sum::<u32>()), |root| {
        root.draw(&Text::new(title.to_owned(), (12, 8), ("sans-serif", 16)))?;
        root.draw(&Text::new(words.to_owned(), (12, 32), ("sans-serif", 13)))?;
        let (_, mut rest) = root.split_vertically(TITLE);
        for (index, height) in heights.iter().enumerate() {
            let (area, below) = rest.split_vertically(*height);
            draw(index, &area)?;
            rest = below;
        }
        Ok(())
    })
}

/// A picture of so many panels of a height in pixels; `draw` gets the area of each and whether it is the last, which has the axis of time.
pub(super) fn stacked(
    what: &'static str,
    words: [&str; 2],
    (panels, height): (usize, u32),
    draw: impl Fn(usize, &Area<'_>, bool) -> DrawResult,
) -> Result<String, PictureError> {
    let heights: Vec<u32> = (1..=panels).map(|number| if number == panels { height + AXIS } else { height }).collect();
    parts(what, words, &heights, |index, area| draw(index, area, index + 1 == panels))
}

/// The frame of a panel from time 0 to `span`, with its name, and `below` the words of the axis of time where it has one.
pub(super) fn panel<'b>(
    area: &Area<'b>,
    name: &str,
    span: f64,
    values: Range<f64>,
    label: &dyn Fn(&f64) -> String,
    below: Option<&str>,
) -> DrawResult<Plane<'b>> {
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(14)
        .margin_top(20)
        .x_label_area_size(if below.is_some() { AXIS } else { 0 })
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..span, values.clone())?;
    let time = |time: &f64| fixed(*time, axis_digits(span));
    let mut mesh = chart.configure_mesh();
    mesh.disable_x_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FRAME.mix(0.6))
        .y_labels(5)
        .x_label_formatter(&time)
        .y_label_formatter(label)
        .label_style(("sans-serif", 12))
        .axis_desc_style(("sans-serif", 13));
    if let Some(below) = below {
        mesh.x_desc(below);
    }
    mesh.draw()?;
    area.draw(&Text::new(name.to_owned(), (76, 4), ("sans-serif", 13)))?;
    Ok(Plane::of(&chart, 0.0..span, values, false))
}
