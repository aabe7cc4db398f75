//! Left-out channels over time: what was measured, and what the model's shapes made of the others.

use plotters::prelude::*;

use super::canvas::{
    Area, Dashes, DrawResult, FRAME, GIVEN, INK, MEASURED, PictureError, Plane, UPDATED, WITH_EFFECTS, axis_digits,
    fixed, picture, prefixed, sample, width_of,
};

/// A left-out channel over time.
#[derive(Debug, Clone)]
pub struct Curves {
    /// Its name.
    pub channel: String,
    /// Time of the first sample, in s.
    pub start_s: f64,
    /// Samples a second.
    pub rate_hz: f64,
    /// The unit of its motion.
    pub unit: &'static str,
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
    /// E_d in percent, over all that was compared.
    pub error_percent: Option<f64>,
}

const WIDTH: u32 = 960;
/// Height of a channel's title and of what E_d means.
const TITLE: u32 = 52;
/// Height of a row of the legend.
const ROW: u32 = 19;
/// Height of the panels with the motion, and with what the predictions miss.
const UPPER: u32 = 240;
const LOWER: u32 = 200;
/// Samples that are drawn, about 50 periods of the highest frequency: more are a band of colour.
const DRAWN: usize = 200;

/// In which predictions are drawn.
const ORDER: [&str; 4] = ["model", "with_effects", "updated", "measured_shapes"];

/// Draws the curves, two panels a channel: the motion, and below it how far each prediction is off. Where a sample is not
/// sound the lines are broken.
///
/// # Errors
/// When drawing fails.
pub fn covalidation(structure: &str, curves: &[Curves]) -> Result<String, PictureError> {
    let channels: Vec<Channel<'_>> = curves.iter().map(Channel::of).collect();
    let heights: Vec<u32> = channels.iter().map(Channel::height).collect();
    let size = (WIDTH, heights.iter().sum::<u32>().max(TITLE));
    picture("the co-validation", size, |root| {
        let mut rest = root.clone();
        for (channel, height) in channels.iter().zip(heights) {
            let (panel, below) = rest.split_vertically(height);
            channel.draw(&panel, structure)?;
            rest = below;
        }
        Ok(())
    })
}

/// How a curve looks.
#[derive(Debug, Clone, Copy)]
struct Look {
    color: RGBAColor,
    width: u32,
    dashes: Dashes,
}

impl Look {
    /// Wide and pale, so that it shows beneath those that lie on it.
    fn measured() -> Self {
        Self { color: MEASURED.mix(0.35), width: 6, dashes: Dashes::Full }
    }

    /// Dashes in turn, so that curves on each other all show; the page has the same colours and dashes.
    fn of(label: &str) -> (Self, &'static str) {
        let look = |color: RGBColor, width, dashes| Self { color: color.to_rgba(), width, dashes };
        match label {
            "model" => (look(GIVEN, 2, Dashes::Full), "model as first given"),
            "with_effects" => (look(WITH_EFFECTS, 2, Dashes::Long), "model with its effects"),
            "updated" => (look(UPDATED, 2, Dashes::Dots), "after direct update"),
            _ => (look(INK, 1, Dashes::Fine), "by the measured shapes"),
        }
    }

    fn style(self) -> ShapeStyle {
        ShapeStyle { color: self.color, filled: false, stroke_width: self.width }
    }
}

/// A curve by its name and look.
struct Line {
    words: String,
    look: Look,
    /// The stretch that is drawn, in the unit of the panel.
    values: Vec<f64>,
}

/// What is drawn of a channel.
struct Channel<'a> {
    name: &'a str,
    start_s: f64,
    rate_hz: f64,
    /// The unit of the upper panel, and of the lower.
    units: [String; 2],
    motion: Vec<Line>,
    missed: Vec<Line>,
}

impl<'a> Channel<'a> {
    fn of(curve: &'a Curves) -> Self {
        let first = curve.measured.iter().position(|value| value.is_finite()).unwrap_or(0);
        let stretch = first..(first + DRAWN).min(curve.measured.len());
        let measured = &curve.measured[stretch.clone()];
        let predicted = |prediction: &'a Prediction| {
            &prediction.values[stretch.start.min(prediction.values.len())..stretch.end.min(prediction.values.len())]
        };
        let missed_by = |prediction| -> Vec<f64> {
            predicted(prediction).iter().zip(measured).map(|(value, measured)| value - measured).collect()
        };
        let largest = |values: &mut dyn Iterator<Item = f64>| {
            values.filter(|value| value.is_finite()).fold(0.0, |most: f64, value| most.max(value.abs()))
        };
        let (factor, prefix) = prefixed(largest(&mut measured.iter().copied()));
        let (of_missed, prefix_of_missed) = prefixed(largest(&mut curve.predictions.iter().flat_map(missed_by)));
        let scaled = |values: &[f64], factor: f64| values.iter().map(|value| value * factor).collect();
        let (mut motion, mut missed) = (Vec::new(), Vec::new());
        motion.push(Line { words: "measured".to_owned(), look: Look::measured(), values: scaled(measured, factor) });
        // In the order of the page: dashes of one lie on the line of another.
        let mut predictions: Vec<&Prediction> = curve.predictions.iter().collect();
        predictions.sort_by_key(|prediction| ORDER.iter().position(|label| *label == prediction.label));
        for prediction in predictions {
            let (look, name) = Look::of(prediction.label);
            let error =
                prediction.error_percent.map_or_else(String::new, |percent| format!(", E_d = {} %", fixed(percent, 2)));
            let words = format!("{name}{error}");
            missed.push(Line { words: words.clone(), look, values: scaled(&missed_by(prediction), of_missed) });
            motion.push(Line { words, look, values: scaled(predicted(prediction), factor) });
        }
        Self {
            name: &curve.channel,
            start_s: curve.start_s + first as f64 / curve.rate_hz,
            rate_hz: curve.rate_hz,
            units: [prefix, prefix_of_missed].map(|prefix| format!("{prefix}{}", curve.unit)),
            motion,
            missed,
        }
    }

    /// Where each line's entry of the legend begins: from the left, and its row.
    fn legend(&self) -> Vec<(i32, u32)> {
        let (mut x, mut row) = (12, 0);
        let place = |line: &Line| {
            let width = 36 + width_of(&line.words, 13) + 20;
            if x > 12 && x + width > WIDTH as i32 {
                (x, row) = (12, row + 1);
            }
            x += width;
            (x - width, row)
        };
        self.motion.iter().map(place).collect()
    }

    fn header(&self) -> u32 {
        TITLE + ROW * (1 + self.legend().last().map_or(0, |&(_, row)| row)) + 4
    }

    fn height(&self) -> u32 {
        self.header() + UPPER + LOWER
    }

    fn draw(&self, panel: &Area<'_>, structure: &str) -> DrawResult {
        let title = format!("{structure}, channel {}: left out, and predicted from the others", self.name);
        panel.draw(&Text::new(title, (12, 7), ("sans-serif", 16)))?;
        let words = "E_d: what a prediction misses over all that was compared, in percent of the motion (RMS). Below: what it misses in this stretch.";
        panel.draw(&Text::new(words, (12, 30), ("sans-serif", 13)))?;
        for (line, (x, row)) in self.motion.iter().zip(self.legend()) {
            let y = (TITLE + ROW * row) as i32;
            sample(panel, (x, y + 8), 28, line.look.dashes, line.look.style())?;
            panel.draw(&Text::new(line.words.clone(), (x + 36, y), ("sans-serif", 13)))?;
        }
        let (_, body) = panel.split_vertically(self.header());
        let (upper, lower) = body.split_vertically(UPPER);
        self.axes(&upper, &format!("motion in {}", self.units[0]), &self.motion)?;
        self.axes(&lower, &format!("missed, in {}", self.units[1]), &self.missed)
    }

    fn axes(&self, panel: &Area<'_>, y_name: &str, lines: &[Line]) -> DrawResult {
        let samples = self.motion.iter().map(|line| line.values.len()).max().unwrap_or(0);
        let time = |sample: usize| self.start_s + sample as f64 / self.rate_hz;
        let finite = lines.iter().flat_map(|line| &line.values).filter(|value| value.is_finite());
        let largest = finite.fold(0.0, |most: f64, value| most.max(value.abs()));
        let largest = if largest > 0.0 { 1.1 * largest } else { 1.0 };
        let mut chart = ChartBuilder::on(panel)
            .margin(8)
            .margin_right(16)
            .x_label_area_size(38)
            .y_label_area_size(68)
            .build_cartesian_2d(time(0)..time(samples.max(1)), -largest..largest)?;
        let seconds = axis_digits(samples as f64 / self.rate_hz);
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(WHITE)
            .bold_line_style(FRAME.mix(0.6))
            .y_labels(5)
            .x_desc("time in s")
            .y_desc(y_name)
            .x_label_formatter(&|at| fixed(*at, seconds))
            .y_label_formatter(&|value| fixed(*value, axis_digits(2.0 * largest)))
            .label_style(("sans-serif", 12))
            .axis_desc_style(("sans-serif", 13))
            .draw()?;
        let plane = Plane::of(&chart, time(0)..time(samples.max(1)), -largest..largest, false);
        for line in lines {
            let points = line.values.iter().enumerate().map(|(sample, &value)| (time(sample), value));
            plane.curve(points, line.look.dashes, line.look.style())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curves(channel: &str) -> Curves {
        let rate_hz = 6.25;
        let wave =
            |amplitude: f64| (0..400).map(|sample| amplitude * (0.7 * f64::from(sample)).sin()).collect::<Vec<f64>>();
        let prediction = |label, amplitude, error_percent| Prediction { label, values: wave(amplitude), error_percent };
        let mut measured = wave(2e-4);
        // A gap at the beginning, and one within.
        measured[..20].fill(f64::NAN);
        measured[100..110].fill(f64::NAN);
        let predictions = vec![
            prediction("model", 2.1e-4, Some(5.126)),
            prediction("updated", 2.1e-4, Some(5.126)),
            prediction("with_effects", 2.02e-4, Some(1.0)),
            prediction("measured_shapes", 2.01e-4, None),
        ];
        Curves { channel: channel.to_owned(), start_s: 40.0, rate_hz, unit: "m/s", measured, predictions }
    }

    #[test]
    fn the_legend_says_how_far_each_prediction_is_off() {
        let svg = covalidation("Tower", &[curves("09"), curves("12")]).unwrap();
        for words in [
            "model as first given, E_d = 5.13 %",
            "after direct update, E_d = 5.13 %",
            "model with its effects, E_d = 1.00 %",
        ] {
            assert_eq!(svg.matches(words).count(), 2, "{words}");
        }
        // What has no E_d is there without one.
        assert_eq!(svg.matches("by the measured shapes").count(), 2);
        assert!(
            svg.contains("motion in mm/s")
                && !svg.contains("mm/s²")
                && svg.contains("missed, in µm/s")
                && svg.contains("time in s")
        );
        assert!(svg.contains("\n\u{2212}"), "an axis about zero");
        assert!(!["\n\u{2212}0.0\n", "\n\u{2212}0.00\n", "\n-", "NaN"].iter().any(|wrong| svg.contains(wrong)));
    }

    #[test]
    fn the_stretch_begins_where_samples_are_sound() {
        let curves = curves("09");
        let channel = Channel::of(&curves);
        assert!((channel.start_s - (40.0 + 20.0 / 6.25)).abs() < 1e-12);
        assert!(channel.motion.iter().all(|line| line.values.len() == DRAWN));
        // The entries of the legend end before the picture does.
        for (line, (x, _)) in channel.motion.iter().zip(channel.legend()) {
            assert!(x + 36 + width_of(&line.words, 13) < WIDTH as i32);
        }
    }
}
