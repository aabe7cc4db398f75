//! Why one effect fits and others do not: the misfit beside what each candidate would do, by mode, and by mode and sensor.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Area, DrawResult, FRAME, MEASURED, PictureError, WITH_EFFECTS, picture};
use crate::colour;
use crate::diagnose::{CandidateFingerprint, Fingerprint, Fingerprints};

const HEADER: u32 = 82;
/// Above each panel: the name of the effect and what it explains.
const NAMES: u32 = 50;
const FREQUENCIES: u32 = 150;
/// Room for heights and scales left of the first panel, for the last panel's edge, and for the numbers of the modes.
const LEFT: u32 = 92;
const RIGHT: u32 = 12;
const BELOW: u32 = 40;
/// Widths of a mode's column and heights of a sensor's row.
const COLUMN: [u32; 2] = [10, 16];
const ROW: [u32; 2] = [9, 16];
const GAP: u32 = 14;
/// A panel that names an effect is at least this wide.
const LEAST_PANEL: u32 = 168;
/// Sensors that are drawn: of more, those where the misfit is greatest.
const MOST_SENSORS: usize = 60;
const MORE: RGBColor = colour::MORE.on_paper();
const LESS: RGBColor = colour::LESS.on_paper();
/// Candidates that are drawn, the most probable.
const MOST_CANDIDATES: usize = 4;
/// Changes below this many deviations are not drawn as dots.
const LEAST_DOT: f64 = 0.3;
/// The scale ends at the greatest number, but at no more than this many times what nine of ten stay below.
const BEYOND: f64 = 3.0;

/// Draws the fingerprints, all to one scale. Bars are the misfit of frequencies, and lie behind what each candidate would do to them.
///
/// # Errors
/// When drawing fails.
pub fn fingerprints(structure: &str, prints: &Fingerprints) -> Result<String, PictureError> {
    let layout = Layout::of(prints);
    picture("the fingerprints", layout.size(), |root| {
        let title = format!("{structure}: what the model misses, and what effects would do");
        root.draw(&Text::new(title, (12, 8), ("sans-serif", 16)))?;
        layout.legend(root, prints)?;
        let columns = std::iter::once(None).chain(drawn(prints).map(Some));
        for (index, candidate) in columns.enumerate() {
            let left = (LEFT + index as u32 * (layout.panel + GAP)) as i32;
            let bold = ("sans-serif", 13).into_font().style(FontStyle::Bold);
            let (name, about) = match candidate {
                None => ("measured - model".to_owned(), "no segment adjusted".to_owned()),
                Some(one) => {
                    let about = format!("{}, explains {:.0} %", probability(one.probability), 100.0 * one.explained);
                    (one.effect.clone(), about)
                }
            };
            let names = lines(&name, layout.panel);
            for (line, text) in names.iter().enumerate() {
                root.draw(&Text::new(text.clone(), (left, HEADER as i32 + 15 * line as i32), bold.clone()))?;
            }
            let below = HEADER as i32 + 15 * names.len() as i32;
            root.draw(&Text::new(about, (left, below), ("sans-serif", 11)))?;
            let change = candidate.map(|one| &one.fingerprint);
            layout.frequencies(root, left, &prints.measured, change)?;
            layout.shapes(root, left, change.unwrap_or(&prints.measured), prints)?;
            layout.numbers(root, left, prints)?;
        }
        layout.scales(root, prints)
    })
}

fn drawn(prints: &Fingerprints) -> impl Iterator<Item = &CandidateFingerprint> {
    prints.candidates.iter().take(MOST_CANDIDATES)
}

fn probability(probability: f64) -> String {
    if probability < 0.001 {
        "probability < 0.1 %".to_owned()
    } else {
        format!("probability {:.1} %", 100.0 * probability)
    }
}

/// `KIND@PLACE` in at most two lines.
fn lines(name: &str, width: u32) -> Vec<String> {
    const LETTER: u32 = 8;
    match name.split_once('@') {
        Some((kind, place)) if name.chars().count() as u32 * LETTER > width => {
            vec![kind.to_owned(), format!("@{place}")]
        }
        _ => vec![name.to_owned()],
    }
}

/// Where things are, in pixels, and the scale.
struct Layout {
    /// Width of a mode's column and height of a sensor's row.
    column: u32,
    row: u32,
    /// Width of a panel.
    panel: u32,
    panels: u32,
    /// Rows of sensors that are drawn, the lowest first.
    sensors: Vec<usize>,
    /// Deviations at the end of the scale of frequencies, and of a dot that fills its place.
    frequency: f64,
    shape: f64,
}

impl Layout {
    fn of(prints: &Fingerprints) -> Self {
        let modes = prints.modes.len().max(1) as u32;
        let all = || std::iter::once(&prints.measured).chain(drawn(prints).map(|one| &one.fingerprint));
        let at = |sensor: usize| prints.measured.shape.iter().filter_map(move |row| row.get(sensor).copied().flatten());
        let mut sensors: Vec<usize> = (0..prints.sensors.len()).filter(|&sensor| at(sensor).next().is_some()).collect();
        if sensors.len() > MOST_SENSORS {
            let squares = |sensor: &usize| at(*sensor).map(|value| value * value).sum::<f64>();
            sensors.sort_by(|a, b| squares(b).total_cmp(&squares(a)));
            sensors.truncate(MOST_SENSORS);
            sensors.sort_unstable();
        }
        let column = (240 / modes).clamp(COLUMN[0], COLUMN[1]);
        let row = (360 / sensors.len().max(1) as u32).clamp(ROW[0], ROW[1]);
        let shapes = all().flat_map(|print| print.shape.iter().flatten().copied().flatten());
        Self {
            column,
            row,
            panel: (column * modes).max(LEAST_PANEL),
            panels: 1 + drawn(prints).count() as u32,
            sensors,
            frequency: end_of_scale(all().flat_map(|print| print.frequency.iter().copied())),
            shape: end_of_scale(shapes),
        }
    }

    fn size(&self) -> (u32, u32) {
        let width = LEFT + self.panels * (self.panel + GAP) + RIGHT;
        (width.max(760), self.below_shapes() as u32 + BELOW)
    }

    fn middle_of_frequencies(&self) -> i32 {
        (HEADER + NAMES + FREQUENCIES / 2) as i32
    }

    fn above_shapes(&self) -> i32 {
        (HEADER + NAMES + FREQUENCIES + 30) as i32
    }

    fn below_shapes(&self) -> i32 {
        self.above_shapes() + (self.row * self.sensors.len() as u32) as i32
    }

    /// The middle of a mode's column.
    fn x(&self, left: i32, mode: usize) -> i32 {
        left + (self.column as usize * mode) as i32 + self.column as i32 / 2
    }

    /// The middle of a sensor's row.
    fn y(&self, row: usize) -> i32 {
        self.below_shapes() - (self.row as usize * row) as i32 - self.row as i32 / 2
    }

    /// A number of deviations in pixels above the middle.
    fn rise(&self, deviations: f64) -> i32 {
        let share = (deviations / self.frequency).clamp(-1.0, 1.0);
        (share * f64::from(FREQUENCIES / 2)).round() as i32
    }

    /// What the units and the marks are.
    fn legend(&self, root: &Area<'_>, prints: &Fingerprints) -> DrawResult {
        let mut units = "In standard deviations by measurement, tolerance and discrepancy; what modes have in common, as segments could make it, counts little.".to_owned();
        if self.sensors.len() == MOST_SENSORS && prints.sensors.len() > MOST_SENSORS {
            units += &format!(" Shapes at the {MOST_SENSORS} sensors of the greatest misfit.");
        }
        let words = |x: i32, y: i32, text: String| Text::new(text, (x, y - 6), ("sans-serif", 12));
        root.draw(&words(12, 40, units))?;
        let (mut x, y) = (12, 62);
        root.draw(&Rectangle::new([(x, y - 6), (x + 10, y + 6)], MEASURED.mix(0.35).filled()))?;
        root.draw(&words(x + 16, y, "frequency: measured - model".to_owned()))?;
        x += 210;
        root.draw(&PathElement::new([(x + 3, y + 6), (x + 3, y - 3)], WITH_EFFECTS))?;
        root.draw(&Circle::new((x + 3, y - 3), 3, WITH_EFFECTS.filled()))?;
        root.draw(&words(x + 14, y, "what the effect would do".to_owned()))?;
        x += 190;
        for (value, text) in [(self.shape, "moves more"), (-self.shape, "moves less")] {
            if !self.sensors.is_empty() {
                self.dot(root, (x + 6, y), value)?;
                root.draw(&words(x + 20, y, format!("{text}, by {:.1}", self.shape)))?;
            }
            x += 150;
        }
        Ok(())
    }

    /// Changes of frequencies over their misfit.
    fn frequencies(
        &self,
        root: &Area<'_>,
        left: i32,
        missed: &Fingerprint,
        change: Option<&Fingerprint>,
    ) -> DrawResult {
        let middle = self.middle_of_frequencies();
        let width = self.x(left, missed.frequency.len()) - self.column as i32 / 2 - left;
        let half = (FREQUENCIES / 2) as i32;
        root.draw(&Rectangle::new([(left, middle - half), (left + width, middle + half)], FRAME))?;
        for (mode, value) in missed.frequency.iter().enumerate() {
            let (x, reach) = (self.x(left, mode), self.column as i32 / 2 - 2);
            let bar = [(x - reach, middle), (x + reach, middle - self.rise(*value))];
            root.draw(&Rectangle::new(bar, MEASURED.mix(if change.is_some() { 0.35 } else { 0.9 }).filled()))?;
            if value.abs() > self.frequency {
                cut(root, (x, middle - self.rise(*value)), *value, MEASURED)?;
            }
        }
        root.draw(&PathElement::new([(left, middle), (left + width, middle)], BLACK))?;
        for (mode, value) in change.iter().flat_map(|change| change.frequency.iter().enumerate()) {
            let at = (self.x(left, mode), middle - self.rise(*value));
            root.draw(&PathElement::new([(at.0, middle), at], WITH_EFFECTS.stroke_width(1)))?;
            root.draw(&Circle::new(at, 3, WITH_EFFECTS.filled()))?;
            if value.abs() > self.frequency {
                cut(root, at, *value, WITH_EFFECTS)?;
            }
        }
        Ok(())
    }

    /// Changes of shapes at sensors, a dot a number: full where the motion grows, a ring where it shrinks.
    fn shapes(&self, root: &Area<'_>, left: i32, print: &Fingerprint, prints: &Fingerprints) -> DrawResult {
        if self.sensors.is_empty() {
            return Ok(());
        }
        let width = self.x(left, prints.modes.len()) - self.column as i32 / 2 - left;
        // Sensors at one height stand together.
        let height = |row: usize| self.sensors.get(row).and_then(|&sensor| prints.sensors.get(sensor)?.elevation_m);
        for row in (1..self.sensors.len()).filter(|&row| height(row) != height(row - 1)) {
            let y = self.y(row) + self.row as i32 / 2;
            root.draw(&PathElement::new([(left, y), (left + width, y)], FRAME.mix(0.6)))?;
        }
        root.draw(&Rectangle::new([(left, self.above_shapes()), (left + width, self.below_shapes())], FRAME))?;
        for (mode, values) in print.shape.iter().enumerate() {
            for (row, &sensor) in self.sensors.iter().enumerate() {
                let Some(value) = values.get(sensor).copied().flatten() else { continue };
                self.dot(root, (self.x(left, mode), self.y(row)), value)?;
            }
        }
        Ok(())
    }

    /// Numbers of the modes.
    fn numbers(&self, root: &Area<'_>, left: i32, prints: &Fingerprints) -> DrawResult {
        let every = if self.column < 14 { 2 } else { 1 };
        for (mode, known) in prints.modes.iter().enumerate().filter(|(mode, _)| mode % every == 0) {
            let at = (self.x(left, mode), self.below_shapes() + 5);
            root.draw(&Text::new(known.measured.to_string(), at, centred(10)))?;
        }
        let middle = left + (self.column as usize * prints.modes.len()) as i32 / 2;
        root.draw(&Text::new("measured mode", (middle, self.below_shapes() + 19), centred(11)))?;
        Ok(())
    }

    fn dot(&self, root: &Area<'_>, at: (i32, i32), value: f64) -> DrawResult {
        if value.abs() < LEAST_DOT {
            return Ok(());
        }
        // Areas are as the changes.
        let share = (value.abs() / self.shape).min(1.0).sqrt();
        let radius = (share * 0.5 * f64::from(self.column.min(self.row))).max(1.0);
        let radius = radius.round() as i32;
        if value > 0.0 {
            root.draw(&Circle::new(at, radius, MORE.filled()))?;
        } else {
            root.draw(&Circle::new(at, radius, LESS.stroke_width(1)))?;
        }
        Ok(())
    }

    /// Names of the scales, left of the first panel.
    fn scales(&self, root: &Area<'_>, prints: &Fingerprints) -> DrawResult {
        let right = ("sans-serif", 10).into_font().color(&BLACK).pos(Pos::new(HPos::Right, VPos::Center));
        let middle = self.middle_of_frequencies();
        for share in [-1.0, -0.5, 0.0, 0.5, 1.0] {
            let deviations = share * self.frequency;
            let y = middle - self.rise(deviations);
            root.draw(&PathElement::new([(LEFT as i32 - 4, y), (LEFT as i32, y)], BLACK))?;
            let text = if share == 0.0 { "0".to_owned() } else { format!("{deviations:+.1}") };
            root.draw(&Text::new(text, (LEFT as i32 - 7, y), right.clone()))?;
        }
        let title = |text: &str, y: i32| Text::new(text.to_owned(), (12, y), ("sans-serif", 11));
        root.draw(&title("frequency", middle - (FREQUENCIES / 2) as i32 + 4))?;
        if self.sensors.is_empty() {
            return Ok(());
        }
        root.draw(&title("shape, at", self.above_shapes() - 14))?;
        let mut last = None;
        for (row, &sensor) in self.sensors.iter().enumerate() {
            let sensor = &prints.sensors[sensor];
            let text = match sensor.elevation_m {
                Some(z_m) if last == Some(z_m) => continue,
                Some(z_m) => format!("{z_m:.1} m"),
                None => sensor.channel.clone(),
            };
            last = sensor.elevation_m;
            root.draw(&Text::new(text, (LEFT as i32 - 7, self.y(row)), right.clone()))?;
        }
        Ok(())
    }
}

/// A number that the scale does not reach, written at its end.
fn cut(root: &Area<'_>, at: (i32, i32), value: f64, color: RGBColor) -> DrawResult {
    let style = ("sans-serif", 9).into_font().color(&color);
    let below = if value > 0.0 { VPos::Bottom } else { VPos::Top };
    root.draw(&Text::new(format!("{value:+.0}"), at, style.pos(Pos::new(HPos::Center, below))))?;
    Ok(())
}

fn centred(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Top))
}

/// The end of a scale on which most numbers are well seen.
fn end_of_scale(values: impl Iterator<Item = f64>) -> f64 {
    let mut sizes: Vec<f64> = values.map(f64::abs).filter(|size| size.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let greatest = sizes.last().copied().unwrap_or(0.0);
    let most = sizes.get(sizes.len() * 9 / 10).copied().unwrap_or(0.0);
    greatest.min(BEYOND * most).max(2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::{FingerprintMode, FingerprintSensor};

    fn prints(shape: &[Vec<Option<f64>>]) -> Fingerprints {
        let print = |frequency: [f64; 2]| Fingerprint { frequency: frequency.to_vec(), shape: shape.to_vec() };
        let sensor = |channel: &str, z_m: f64| FingerprintSensor {
            channel: channel.to_owned(),
            elevation_m: Some(z_m),
            azimuth_deg: Some(0.0),
        };
        Fingerprints {
            modes: [1, 2].map(|measured| FingerprintMode { measured, measured_hz: 0.1 * measured as f64 }).to_vec(),
            sensors: vec![sensor("low", 10.0), sensor("high", 55.5)],
            measured: print([-3.0, 1.0]),
            candidates: vec![CandidateFingerprint {
                effect: "connection-flexibility@443.6m".to_owned(),
                probability: 0.95,
                explained: 0.84,
                fingerprint: print([-2.5, 0.5]),
            }],
        }
    }

    /// A dot a number that matters, full or a ring by its sign, in both panels; marks of frequencies in the candidate's alone.
    #[test]
    fn every_number_has_its_mark() {
        let svg = fingerprints("Mast", &prints(&[vec![Some(2.0), Some(-1.0)], vec![Some(0.1), None]])).unwrap();
        let full = format!("fill=\"{}\"", "#01665E");
        let circles =
            |what: &str| svg.lines().filter(|line| line.starts_with("<circle") && line.contains(what)).count();
        // Two panels and the legend; then the legend's and two frequencies' marks of the candidate.
        assert_eq!((circles(&full), circles("#8C510A"), circles("#009873")), (2 + 1, 2 + 1, 1 + 2));
        for text in
            ["connection-flexibility", "@443.6m", "probability 95.0 %, explains 84 %", "55.5 m", "measured mode"]
        {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn frequencies_alone_are_drawn_too() {
        let none = vec![vec![None, None], vec![None, None]];
        let svg = fingerprints("Mast", &prints(&none)).unwrap();
        assert!(svg.contains("measured mode") && !svg.contains("shape, at") && !svg.contains("NaN"));
    }

    /// One number that is far off does not make all others small.
    #[test]
    fn a_number_far_off_is_cut() {
        let mut values: Vec<f64> = (0..40).map(|at| f64::from(at) / 10.0).collect();
        values.push(80.0);
        let end = end_of_scale(values.into_iter());
        assert!((8.0..13.0).contains(&end), "{end}");
    }
}
