//! What all pictures have in common: the canvas, its colours, its axes.
//!
//! A size and a function that draws flow in; SVG text, or which picture could not be drawn and why, flows out.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use thiserror::Error;

pub(super) use crate::numbers::{fixed, signed};

/// The colour of modes.
pub(super) const MODE: RGBColor = RGBColor(190, 40, 40);
/// Of what stands beside the modes.
pub(super) const BESIDE: RGBColor = RGBColor(31, 87, 147);
/// Of axes.
pub(super) const FRAME: RGBColor = RGBColor(200, 200, 200);
/// One colour a direction, by azimuth.
pub(super) const DIRECTIONS: [RGBColor; 4] =
    [BESIDE, RGBColor(214, 124, 38), RGBColor(90, 150, 90), RGBColor(130, 90, 160)];

/// What was measured, the versions of the model, and their shapes: the colours that host/page/style.css gives them (Okabe-Ito).
pub(super) const MEASURED: RGBColor = RGBColor(0, 114, 178);
pub(super) const GIVEN: RGBColor = RGBColor(213, 94, 0);
pub(super) const WITH_EFFECTS: RGBColor = RGBColor(0, 158, 115);
pub(super) const UPDATED: RGBColor = RGBColor(201, 116, 159);

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
    drawn
        .map(|()| without_controls(svg))
        .map_err(|reason: Box<dyn std::error::Error>| PictureError { what, reason: reason.to_string() })
}

/// Control characters of names are none of XML's, and no reader would show the picture.
fn without_controls(svg: String) -> String {
    let is_none = |letter: char| letter.is_control() && !matches!(letter, '\n' | '\r' | '\t');
    if svg.contains(is_none) { svg.replace(is_none, "\u{fffd}") } else { svg }
}

/// Bottom and top of a logarithmic axis for values between `low` and `high`, whatever they are: with a range that is empty or without end the
/// library would look for labels for ever.
pub(super) fn log_range(low: f64, high: f64) -> (f64, f64) {
    const LIMITS: (f64, f64) = (1e-200, 1e200);
    let (low, high) = (low.clamp(LIMITS.0, LIMITS.1), high.clamp(LIMITS.0, LIMITS.1));
    // Also where there are no values at all, and the least is infinite.
    if low < high { (low, high) } else { (1e-12, 1.0) }
}

/// Digits after the point that tell the labels of an axis of this length apart: their distance is 1, 2 or 5 of a decade and no less than an
/// eleventh of the length, so never of a lower decade than a sixth.
pub(super) fn axis_digits(length: f64) -> usize {
    let step = length / 6.0;
    if step > 0.0 && step.is_finite() { (-step.log10().floor()).clamp(0.0, 9.0) as usize } else { 0 }
}

/// A factor, and the prefix of the unit with it, with which a largest value is written with few zeros.
pub(super) fn prefixed(largest: f64) -> (f64, &'static str) {
    match largest.abs() {
        size if size >= 0.1 || size == 0.0 => (1.0, ""),
        size if size >= 1e-4 => (1e3, "m"),
        size if size >= 1e-7 => (1e6, "µ"),
        _ => (1e9, "n"),
    }
}

/// About the width of a text in pixels: an average letter is 0.56 of the font's size.
pub(super) fn width_of(text: &str, size: u32) -> i32 {
    (0.56 * f64::from(size) * text.chars().count() as f64).ceil() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_of_names_stay_out_of_pictures() {
        let drawn = picture("a name", (200, 100), |root| {
            root.draw(&Text::new("evil\u{1b}[31m\u{7}\0name\nbelow", (0, 0), ("sans-serif", 12)))?;
            Ok(())
        });
        let svg = drawn.unwrap();
        assert!(svg.contains("evil\u{fffd}[31m\u{fffd}\u{fffd}name"), "{svg}");
        assert!(svg.chars().all(|letter| !letter.is_control() || letter == '\n'));
    }

    /// Five labels between the ends of an axis differ.
    #[test]
    fn labels_of_an_axis_differ() {
        for length in [3e-4, 0.02, 0.7, 1.0, 9.0, 40.0, 5e3] {
            let labels: Vec<String> =
                (0..6).map(|label| fixed(length * f64::from(label) / 5.0, axis_digits(length))).collect();
            assert!(labels.windows(2).all(|pair| pair[0] != pair[1]), "{length}: {labels:?}");
        }
    }

    #[test]
    fn units_have_the_prefix_that_spares_zeros() {
        assert_eq!([2.0, 0.02, 2.8e-4, 1e-5, 3e-9].map(|largest| prefixed(largest).1), ["", "m", "m", "µ", "n"]);
    }
}
