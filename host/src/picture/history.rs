//! How the error fell: a panel each for frequencies, for sensors left out, for chi-squared and for shapes, step by step.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Area, Dashes, DrawResult, FRAME, INK, PictureError, Plane, axis_digits, fixed, picture, width_of};
use crate::diagnose::steps::StepRecord;

/// Widths of a panel: what stands left of its steps, a step, and of all together.
const LABELS: u32 = 56;
const STEP: u32 = 105;
const LEAST_STEP: u32 = 76;
const LEAST_PANEL: u32 = 330;
const WIDEST: u32 = 990;
const PANEL: u32 = 178;
const TITLE: u32 = 36;
/// Height of a line of a step's name, and how many there are at most.
const NAME: u32 = 15;
const MOST_NAMES: usize = 6;
/// Room above the largest value for its number.
const ABOVE: f64 = 1.25;
/// Values so far apart in pixels have numbers of their own places.
const APART: i32 = 15;

/// A line of a panel: what it is, its values (none where a step has none), and whether they were left out of the fit: in dashes then, with rings.
struct Line {
    name: &'static str,
    values: Vec<Option<f64>>,
    is_left_out: bool,
}

/// Draws the steps, on scales from 0: what is left of an error is seen beside what was.
///
/// # Errors
/// When drawing fails.
pub fn history(structure: &str, steps: &[StepRecord]) -> Result<String, PictureError> {
    let line = |name, is_left_out, value: &dyn Fn(&StepRecord) -> Option<f64>| Line {
        name,
        values: steps.iter().map(value).collect(),
        is_left_out,
    };
    let panels = [
        vec![
            line("frequency error in %", false, &|step| Some(step.mean_abs_frequency_error_percent)),
            line("of modes left out", true, &|step| step.held_out_mode_error_percent),
        ],
        vec![line("motion of sensors left out, error in %", true, &|step| step.held_out_error_percent)],
        vec![line("chi-squared over numbers compared", false, &|step| {
            Some(step.chi_squared / step.degrees_of_freedom.max(1) as f64)
        })],
        vec![line("1 - MAC, in %", false, &|step| step.mean_mac.map(|mac| 100.0 * (1.0 - mac)))],
    ];
    let panels: Vec<&Vec<Line>> =
        panels.iter().filter(|lines| lines.iter().any(|line| line.values.iter().any(Option::is_some))).collect();
    let count = steps.len() as u32;
    let width = (LABELS + STEP * count).clamp(LEAST_PANEL, WIDEST).max(LABELS + LEAST_STEP * count);
    // Two beside each other where they find room.
    let columns = if 2 * width <= WIDEST && panels.len() > 1 { 2 } else { 1 };
    let rows = panels.len().div_ceil(columns);
    let names: Vec<Vec<String>> =
        steps.iter().map(|step| words(&step.action, (width - LABELS) / count.max(1))).collect();
    let below = 10 + NAME * names.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let size = (width * columns as u32, TITLE + (PANEL + below) * rows as u32);
    picture("the history", size, |root| {
        let title = format!("{structure}: how the error fell");
        root.draw(&Text::new(title, (10, 9), ("sans-serif", 16)))?;
        let (_, body) = root.split_vertically(TITLE);
        for (area, panel) in body.split_evenly((rows, columns)).iter().zip(panels) {
            draw(area, panel, &names, below)?;
        }
        Ok(())
    })
}

fn draw(area: &Area<'_>, lines: &[Line], names: &[Vec<String>], below: u32) -> DrawResult {
    let values = lines.iter().flat_map(|line| line.values.iter().flatten()).copied();
    let highest = values.filter(|value| value.is_finite()).fold(0.0, f64::max);
    let highest = if highest > 0.0 { ABOVE * highest } else { 1.0 };
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(12)
        .margin_top(26)
        .x_label_area_size(below)
        .y_label_area_size(LABELS - 8)
        .build_cartesian_2d(-0.4..names.len() as f64 - 0.4, 0.0..highest)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_labels(0)
        .light_line_style(WHITE)
        .bold_line_style(FRAME.mix(0.6))
        .y_labels(5)
        .y_label_formatter(&|value| fixed(*value, axis_digits(highest)))
        .label_style(("sans-serif", 12))
        .draw()?;
    let mut name_at = LABELS as i32;
    let plane = Plane::of(&chart, -0.4..names.len() as f64 - 0.4, 0.0..highest, false);
    for line in lines {
        let points = line.points();
        let dashes = if line.is_left_out { Dashes::Long } else { Dashes::Full };
        plane.curve(points.iter().copied(), dashes, INK.stroke_width(2))?;
        for point in points {
            plane.dot(point, if line.is_left_out { 4 } else { 3 }, line.point_style())?;
        }
        if lines.len() > 1 {
            area.draw(&Circle::new((name_at + 4, 13), if line.is_left_out { 4 } else { 3 }, line.point_style()))?;
            name_at += 15;
        }
        area.draw(&Text::new(line.name, (name_at, 6), ("sans-serif", 13)))?;
        name_at += width_of(line.name, 13) + 24;
    }
    let (left, top) = area.get_base_pixel();
    let pixel = |at: (f64, f64)| {
        let (x, y) = chart.backend_coord(&at);
        (x - left, y - top)
    };
    for (step, name) in names.iter().enumerate() {
        let at = step as f64;
        let of_step = |line: &Line| line.values.get(step).copied().flatten();
        let mut here: Vec<f64> = lines.iter().filter_map(of_step).collect();
        here.sort_by(|a, b| b.total_cmp(a));
        here.dedup_by(|a, b| digits(*a) == digits(*b));
        // The largest number highest, each above its point and above the next. Lines mostly fall, so numbers stand right of the points, left where
        // one rises, and above the point of a valley.
        let is_rising = |step: usize| lines.iter().any(|line| line.rises_after(step));
        let is_falling = |step: usize| lines.iter().any(|line| line.falls_after(step));
        let (side, beside) = match (step > 0 && is_falling(step - 1), is_rising(step)) {
            (_, false) => (HPos::Left, 6),
            (false, true) => (HPos::Right, -6),
            (true, true) => (HPos::Center, 0),
        };
        let mut lowest = i32::MAX;
        for value in here.iter().rev() {
            let (x, y) = pixel((at, *value));
            let (x, y) = (x + beside, (y - 18).min(lowest.saturating_sub(APART)));
            lowest = y;
            let (number, size) = (digits(*value), 12);
            let width = width_of(&number, size);
            let left = match side {
                HPos::Left => x,
                HPos::Right => x - width,
                HPos::Center => x - width / 2,
            };
            // Paper behind the number, where a line passes all the same.
            area.draw(&Rectangle::new([(left, y), (left + width, y + 12)], WHITE.mix(0.8).filled()))?;
            let style = ("sans-serif", size).into_font().color(&INK).pos(Pos::new(side, VPos::Top));
            area.draw(&Text::new(number, (x, y), style))?;
        }
        let (x, y) = pixel((at, 0.0));
        for (row, word) in (0..).zip(name) {
            let style = ("sans-serif", 12).into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Top));
            area.draw(&Text::new(word.clone(), (x, y + 8 + NAME as i32 * row), style))?;
        }
    }
    Ok(())
}

impl Line {
    fn point_style(&self) -> ShapeStyle {
        if self.is_left_out { INK.stroke_width(2) } else { INK.filled() }
    }

    /// The value of a step and of the next.
    fn pair(&self, step: usize) -> Option<(f64, f64)> {
        let value = |step: usize| self.values.get(step).copied().flatten();
        value(step).zip(value(step + 1))
    }

    fn rises_after(&self, step: usize) -> bool {
        self.pair(step).is_some_and(|(here, next)| next > here)
    }

    fn falls_after(&self, step: usize) -> bool {
        self.pair(step).is_some_and(|(here, next)| next < here)
    }

    /// Step and value where a step has one.
    fn points(&self) -> Vec<(f64, f64)> {
        let known = self.values.iter().enumerate().filter_map(|(step, value)| Some((step as f64, (*value)?)));
        known.filter(|(_, value)| value.is_finite()).collect()
    }
}

/// Three digits.
fn digits(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    fixed(value, (2.0 - value.abs().log10().floor()).clamp(0.0, 4.0) as usize)
}

/// `add NAME@PLACE, remove NAME` in lines that fit below a step of this width.
fn words(action: &str, width: u32) -> Vec<String> {
    let is_wide = |text: &str| width_of(text, 12) > width as i32;
    let mut lines = Vec::new();
    for word in action.split(", ").flat_map(|part| part.split(' ')) {
        let (name, place) = word.split_once('@').map_or((word, None), |(name, place)| (name, Some(place)));
        let mut line = String::new();
        for piece in name.split_inclusive('-') {
            if !line.is_empty() && is_wide(&format!("{line}{piece}")) {
                lines.push(std::mem::take(&mut line));
            }
            line += piece;
        }
        lines.push(line);
        lines.extend(place.map(|place| format!("@{place}")));
    }
    if lines.len() > MOST_NAMES {
        lines.truncate(MOST_NAMES - 1);
        lines.push("...".to_owned());
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(action: &str, percent: f64, chi_squared: f64) -> StepRecord {
        StepRecord {
            step: 0,
            action: action.to_owned(),
            effects: Vec::new(),
            chi_squared,
            degrees_of_freedom: 100,
            p_value: 0.5,
            mean_abs_frequency_error_percent: percent,
            mean_mac: Some(1.0),
            mean_abs_frequency_error_percent_with_background: percent,
            mean_mac_with_background: None,
            held_out_error_percent: Some(6.0 * percent),
            held_out_mode_error_percent: Some(0.9 * percent),
            modes: 5,
            log_bayes_factor: None,
            joint: None,
            data: String::new(),
        }
    }

    /// Height of each circle over the lowest tick of its panel, as a share of the largest in it.
    fn heights(svg: &str, color: &str) -> Vec<f64> {
        let of = |line: &str, name: &str| -> f64 {
            line.split_once(&format!(" {name}=\"")).unwrap().1.split('"').next().unwrap().parse().unwrap()
        };
        let circles = svg.lines().filter(|line| line.starts_with("<circle") && line.contains(color));
        circles.map(|line| of(line, "cy")).collect()
    }

    /// An error that falls to a half stands at half the height: the scale is linear and begins at 0.
    #[test]
    fn scales_begin_at_nothing() {
        let steps = [step("start", 2.0, 400.0), step("add a", 1.0, 200.0), step("add b", 0.0, 0.0)];
        let svg = history("Tower", &steps).unwrap();
        let full = heights(&svg, "fill=\"#16191D\"");
        // After the first panel's comes one in the legend.
        assert_eq!(full.len(), 3 + 1 + 3 + 3, "frequencies, chi-squared, shapes");
        for panel in [&full[..3], &full[4..7]] {
            assert!((2.0 * (panel[2] - panel[1]) - (panel[2] - panel[0])).abs() <= 2.0, "{panel:?}");
        }
        assert!(!svg.contains("\u{2212}0") && !svg.contains("\n-"));
    }

    #[test]
    fn the_picture_is_as_large_as_its_content() {
        let width = |steps: usize| {
            let steps: Vec<StepRecord> = (0..steps).map(|_| step("add added-mass@443.6m", 1.0, 100.0)).collect();
            let svg = history("Tower", &steps).unwrap();
            svg.split_once("width=\"").unwrap().1.split('"').next().unwrap().parse::<u32>().unwrap()
        };
        let widths = [1, 3, 4, 8, 12].map(width);
        assert!(widths[0] <= 2 * LEAST_PANEL && widths.iter().all(|width| *width <= WIDEST), "{widths:?}");
        // Panels of many steps stand below each other, and each takes the whole width.
        assert!(widths[3] < WIDEST && widths[4] == WIDEST, "{widths:?}");
    }

    #[test]
    fn names_of_steps_are_broken_where_words_end() {
        assert_eq!(words("add added-mass@443.6m", STEP), ["add", "added-mass", "@443.6m"]);
        assert_eq!(words("add connection-flexibility@-5m", STEP), ["add", "connection-", "flexibility", "@-5m"]);
        assert_eq!(words("add a, add b@1m, remove c, remove d", STEP).len(), MOST_NAMES);
        assert_eq!([0.0, 0.1401, 12.04, 1.0].map(digits), ["0", "0.140", "12.0", "1.00"]);
    }
}
