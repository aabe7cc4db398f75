//! What all pictures have in common: the canvas, its colours, its axes.
//!
//! A size and a function that draws flow in; SVG text, or which picture could not be drawn and why, flows out.

use std::ops::Range;

use plotters::coord::ranged1d::Ranged;
use plotters::coord::types::RangedCoordf64;
use plotters::element::{Drawable, PointCollection};
use plotters::prelude::*;
use plotters_backend::DrawingErrorKind;
use thiserror::Error;

use crate::colour;

pub(super) use crate::numbers::{fixed, signed};

/// What things are drawn in: the colours that they have on the page.
pub(super) const MEASURED: RGBColor = colour::MEASURED.on_paper();
pub(super) const GIVEN: RGBColor = colour::GIVEN.on_paper();
pub(super) const WITH_EFFECTS: RGBColor = colour::EFFECTS.on_paper();
pub(super) const UPDATED: RGBColor = colour::UPDATED.on_paper();
pub(super) const FORCED: RGBColor = colour::FORCED.on_paper();
pub(super) const REJECTED: RGBColor = colour::REJECTED.on_paper();
pub(super) const BAD: RGBColor = colour::BAD.on_paper();
/// Of what has no colour of its own, and of text.
pub(super) const INK: RGBColor = colour::INK.on_paper();
/// Of axes and grids.
pub(super) const FRAME: RGBColor = colour::LINE.on_paper();

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
        .map(|()| with_minus_signs(&without_controls(finished(&svg))))
        .map_err(|reason: Box<dyn std::error::Error>| PictureError { what, reason: reason.to_string() })
}

/// Numbers below zero have a minus sign, not a hyphen, in what is written: lines that are no elements.
fn with_minus_signs(svg: &str) -> String {
    let mut signed = String::with_capacity(svg.len());
    for line in svg.split_inclusive('\n') {
        if line.starts_with('<') {
            signed += line;
            continue;
        }
        let mut before = ' ';
        let mut letters = line.chars().peekable();
        while let Some(letter) = letters.next() {
            let is_sign =
                letter == '-' && matches!(before, ' ' | '(') && letters.peek().is_some_and(char::is_ascii_digit);
            signed.push(if is_sign { '\u{2212}' } else { letter });
            before = letter;
        }
    }
    signed
}

// The library places everything on whole pixels, so that curves have steps. What is drawn finely has coordinates in hundredths of a pixel, and
// far out, where none of the library's are; `finished` makes numbers of pixels of them. A width that is far out names dashes as well.
const FAR: i32 = 10_000_000;
const FINE: f64 = 100.0;
const FAR_WIDTH: u32 = 1000;
/// Of curves in dashes, pixels.
const MOST_WIDTH: u32 = 4;

/// A curve is full, or in dashes of a length and the gap after it, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dashes {
    Full,
    Long,
    Short,
    Dots,
    Fine,
}

impl Dashes {
    /// One a direction of motion, in their order; a dash and its gap.
    pub(super) const ALL: [(Self, [u32; 2]); 5] = [
        (Self::Full, [0, 0]),
        (Self::Long, [10, 7]),
        (Self::Short, [5, 3]),
        (Self::Dots, [2, 4]),
        (Self::Fine, [1, 3]),
    ];
}

/// The shape of a mark, one a direction of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    Dot,
    Square,
    Triangle,
    Diamond,
}

impl Mark {
    /// Its corners about the middle, in units of its reach; none of a dot.
    fn corners(self) -> &'static [[f64; 2]] {
        match self {
            Self::Dot => &[],
            Self::Square => &[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
            Self::Triangle => &[[-1.1, 0.9], [0.0, -1.2], [1.1, 0.9]],
            Self::Diamond => &[[-1.3, 0.0], [0.0, -1.3], [1.3, 0.0], [0.0, 1.3]],
        }
    }
}

/// How a direction of motion is told from the others, whatever its colour says: dashes of its curve, and its marks.
pub(super) fn of_direction(index: usize) -> (Dashes, Mark) {
    [
        (Dashes::Full, Mark::Dot),
        (Dashes::Short, Mark::Square),
        (Dashes::Dots, Mark::Triangle),
        (Dashes::Long, Mark::Diamond),
    ][index % 4]
}

/// A chart's plane, on which curves are drawn between pixels, too.
pub(super) struct Plane<'b> {
    area: Area<'b>,
    x: Axis,
    y: Axis,
}

/// Where an axis begins, in values and in pixels, and pixels a value; values are logarithms where `is_log`.
struct Axis {
    first: f64,
    pixel: f64,
    pixels: f64,
    is_log: bool,
}

impl Axis {
    fn new(range: &Range<f64>, is_log: bool, [from, to]: [i32; 2]) -> Self {
        let value = |value: f64| if is_log { value.ln() } else { value };
        let (first, pixel) = (value(range.start), f64::from(from));
        Self { first, pixel, pixels: f64::from(to - from) / (value(range.end) - first), is_log }
    }

    fn at(&self, value: f64) -> f64 {
        let value = if self.is_log { value.ln() } else { value };
        self.pixel + self.pixels * (value - self.first)
    }
}

impl<'b> Plane<'b> {
    /// That of a chart with these ranges; `is_log` where its upward axis is logarithmic.
    pub(super) fn of<X: Ranged<ValueType = f64>, Y: Ranged<ValueType = f64>>(
        chart: &ChartContext<'_, SVGBackend<'b>, Cartesian2d<X, Y>>,
        x: Range<f64>,
        y: Range<f64>,
        is_log: bool,
    ) -> Self {
        let area = chart.plotting_area();
        let [(left, bottom), (right, top)] =
            [(x.start, y.start), (x.end, y.end)].map(|corner| area.map_coordinate(&corner));
        let (x, y) = (Axis::new(&x, false, [left, right]), Axis::new(&y, is_log, [bottom, top]));
        Self { area: area.use_screen_coord(), x, y }
    }

    /// A place in pixels; none where a number is none.
    fn place(&self, (x, y): (f64, f64)) -> Option<[f64; 2]> {
        let place = [self.x.at(x), self.y.at(y)];
        place.iter().all(|pixel| pixel.abs() < 1e4).then_some(place)
    }

    /// Joins the points; where one is no number the curve breaks.
    pub(super) fn curve(
        &self,
        points: impl IntoIterator<Item = (f64, f64)>,
        dashes: Dashes,
        style: ShapeStyle,
    ) -> DrawResult {
        let places: Vec<Option<[f64; 2]>> = points.into_iter().map(|point| self.place(point)).collect();
        for part in places.split(Option::is_none) {
            let path: Vec<[f64; 2]> = part.iter().copied().flatten().collect();
            if !path.is_empty() {
                self.area.draw(&Fine { shape: Shape::Stroke { path, dashes }, style })?;
            }
        }
        Ok(())
    }

    /// A full mark, or an open one where the style is not filled; `reach` is half its size.
    pub(super) fn mark(&self, at: (f64, f64), mark: Mark, reach: u32, style: ShapeStyle) -> DrawResult {
        let Some(middle) = self.place(at) else { return Ok(()) };
        Ok(self.area.draw(&Fine { shape: Shape::Mark { middle, mark, reach }, style })?)
    }

    pub(super) fn dot(&self, at: (f64, f64), radius: u32, style: impl Into<ShapeStyle>) -> DrawResult {
        self.mark(at, Mark::Dot, radius, style.into())
    }
}

/// A piece of a curve for a legend: from a place in an area so far to the right.
pub(super) fn sample(
    area: &Area<'_>,
    (x, y): (i32, i32),
    length: i32,
    dashes: Dashes,
    style: ShapeStyle,
) -> DrawResult {
    let path = [x, x + length].map(|x| on_picture(area, (x, y))).to_vec();
    Ok(area.draw(&Fine { shape: Shape::Stroke { path, dashes }, style })?)
}

/// A mark for a legend.
pub(super) fn sample_mark(area: &Area<'_>, at: (i32, i32), mark: Mark, reach: u32, style: ShapeStyle) -> DrawResult {
    let shape = Shape::Mark { middle: on_picture(area, at), mark, reach };
    Ok(area.draw(&Fine { shape, style })?)
}

/// Where a place in an area is on the whole picture.
fn on_picture(area: &Area<'_>, (x, y): (i32, i32)) -> [f64; 2] {
    let (left, top) = area.get_base_pixel();
    [left + x, top + y].map(f64::from)
}

fn far_out([x, y]: [f64; 2]) -> (i32, i32) {
    ((x * FINE).round() as i32 + FAR, (y * FINE).round() as i32 + FAR)
}

/// What is drawn between pixels.
struct Fine {
    shape: Shape,
    style: ShapeStyle,
}

/// Its shape, in pixels.
enum Shape {
    Stroke { path: Vec<[f64; 2]>, dashes: Dashes },
    Mark { middle: [f64; 2], mark: Mark, reach: u32 },
}

/// A shape knows its places; the library asks for one.
const ANYWHERE: [(i32, i32); 1] = [(0, 0)];

impl<'a> PointCollection<'a, (i32, i32)> for &'a Fine {
    type Point = &'a (i32, i32);
    type IntoIter = std::slice::Iter<'a, (i32, i32)>;

    fn point_iter(self) -> Self::IntoIter {
        ANYWHERE.iter()
    }
}

type Drawn<'b> = Result<(), DrawingErrorKind<<SVGBackend<'b> as DrawingBackend>::ErrorType>>;

impl<'b> Drawable<SVGBackend<'b>> for Fine {
    fn draw<I: Iterator<Item = (i32, i32)>>(&self, _: I, backend: &mut SVGBackend<'b>, _: (u32, u32)) -> Drawn<'b> {
        let style = self.style;
        match &self.shape {
            Shape::Stroke { path, dashes } => {
                let style = ShapeStyle { stroke_width: style.stroke_width + FAR_WIDTH * *dashes as u32, ..style };
                backend.draw_path(path.iter().map(|place| far_out(*place)), &style)
            }
            Shape::Mark { middle: [x, y], mark, reach } => {
                let far = f64::from(*reach);
                let corner = |[right, down]: &[f64; 2]| far_out([x + right * far, y + down * far]);
                let mut corners: Vec<(i32, i32)> = mark.corners().iter().map(corner).collect();
                match (corners.first().copied(), style.filled) {
                    (None, is_full) => backend.draw_circle(far_out([*x, *y]), *reach, &style, is_full),
                    (Some(_), true) => backend.fill_polygon(corners, &style),
                    (Some(first), false) => {
                        corners.push(first);
                        backend.draw_path(corners, &style)
                    }
                }
            }
        }
    }
}

/// Brings back what is far out, and gives black the colour of text.
fn finished(svg: &str) -> String {
    let mut finished = String::with_capacity(svg.len());
    let (mut rest, mut is_tag) = (svg, false);
    while let Some(letter) = rest.chars().next() {
        let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
        let far = rest[..digits].parse::<i32>().ok().filter(|number| is_tag && *number > FAR / 2);
        if let Some(number) = far {
            finished += format!("{:.2}", f64::from(number - FAR) / FINE).trim_end_matches('0').trim_end_matches('.');
        } else if digits > 0 {
            finished += &rest[..digits];
        } else {
            is_tag = if letter == '<' || letter == '>' { letter == '<' } else { is_tag };
            finished.push(letter);
        }
        rest = &rest[if digits > 0 { digits } else { letter.len_utf8() }..];
    }
    let RGBColor(red, green, blue) = INK;
    finished = finished.replace("#000000", &format!("#{red:02X}{green:02X}{blue:02X}"));
    for (dashes, [dash, gap]) in &Dashes::ALL[1..] {
        for width in 1..=MOST_WIDTH {
            let far = format!("stroke-width=\"{}\"", width + FAR_WIDTH * *dashes as u32);
            let near = format!("stroke-width=\"{width}\" stroke-dasharray=\"{dash} {gap}\"");
            finished = finished.replace(&far, &near);
        }
    }
    finished
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

    #[test]
    fn numbers_below_zero_have_a_minus_sign() {
        let svg = "<polyline points=\"-1,-2 3,-4\"/>\n-0.5\nfrom -2 to (-1), 1e-9, 2026-11-29, a-1 - 2\n</text>\n";
        let signed = "<polyline points=\"-1,-2 3,-4\"/>\n\u{2212}0.5\nfrom \u{2212}2 to (\u{2212}1), 1e-9, 2026-11-29, a-1 - 2\n</text>\n";
        assert_eq!(with_minus_signs(svg), signed);
    }

    /// A straight line that rises by a pixel over four has no steps, and a mark stands on it.
    #[test]
    fn curves_are_drawn_between_pixels() {
        let drawn = picture("a line", (210, 110), |root| {
            let chart = ChartBuilder::on(root).margin(5).build_cartesian_2d(0.0..200.0, 0.0..100.0)?;
            let plane = Plane::of(&chart, 0.0..200.0, 0.0..100.0, false);
            let line = (0..=4).map(|at| (f64::from(at), 0.25 * f64::from(at))).chain([
                (f64::NAN, 0.0),
                (5.0, 0.0),
                (6.0, 0.0),
            ]);
            plane.curve(line, Dashes::Short, BLACK.stroke_width(2))?;
            plane.mark((2.0, 0.5), Mark::Square, 2, MEASURED.filled())?;
            root.draw(&Text::new("20000000 kg", (0, 0), ("sans-serif", 12)))?;
            plane.dot((2.0, 0.5), 2, MEASURED.filled())
        });
        let svg = drawn.unwrap();
        assert_eq!(svg.matches("stroke-width=\"2\" stroke-dasharray=\"5 3\"").count(), 2, "the line breaks: {svg}");
        let points = svg.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        let heights: Vec<f64> =
            points.split_whitespace().map(|point| point.split_once(',').unwrap().1.parse().unwrap()).collect();
        let steps: Vec<f64> = heights.windows(2).map(|pair| pair[0] - pair[1]).collect();
        assert!(steps.len() == 4 && steps.iter().all(|step| (step - 0.25).abs() < 0.02), "{heights:?}");
        assert!(svg.contains(&format!("cy=\"{}\"", heights[2])) && svg.contains("<polygon"), "{svg}");
        assert!(svg.contains("20000000 kg") && !svg.contains("#000000"), "{svg}");
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
