//! Mode shapes of a structure in space, drawn on its lines from one side: what was measured as dots at the sensors, and the model where there is one.

use plotters::prelude::*;

use super::canvas::{
    Area, Dashes, DrawResult, FRAME, GIVEN, INK, MEASURED, Mark, PictureError, Plane, WITH_EFFECTS, axis_digits, fixed,
    picture, sample, sample_mark, signed, width_of,
};
use crate::colour;
use crate::compare::{Comparison, GroupMisfit, HeightMisfit, ModelView, scale};
use crate::identify::{Identification, Mode};
use crate::model::{Assembly, Wireframe, longest_side_m};
use crate::modes::MeasuredMode;
use crate::numbers::mac_words;
use crate::study::Sensor;

const WIDTH: u32 = 990;
const HEADER: u32 = 74;
const CAPTION: u32 = 26;
/// Width of a panel over its height from where on so many stand beside each other, and how many.
const COLUMNS: [(f64, u32); 3] = [(2.2, 2), (1.1, 3), (0.0, 5)];
const HIGHEST: u32 = 300;
/// Largest drawn motion over the structure's longest side.
const TRAVEL: f64 = 0.1;
/// From where it is seen: beside the normal of its longest extent in plan, and above the horizontal, rad.
const BESIDE: f64 = 0.55;
const ABOVE: f64 = 0.32;
const MISFIT: RGBColor = colour::HIGH.on_paper();

/// A direction of view: to the right and up in the picture.
pub(super) struct Camera {
    right: [f64; 3],
    up: [f64; 3],
}

/// A mode in a panel.
struct Panel {
    caption: String,
    /// Motion of the frame's points, in m at the scale of the measured shape; none where no model is drawn.
    model: Option<Vec<[f64; 3]>>,
    marks: Vec<Marked>,
}

/// What the sensors of one place measure, and what the model does along the same directions.
pub(super) struct Marked {
    pub(super) place_m: [f64; 3],
    pub(super) measured: [f64; 3],
    model: Option<[f64; 3]>,
}

/// What is told of groups or heights in the last panel.
enum Bars<'a> {
    Groups(&'a [GroupMisfit]),
    Heights(&'a [HeightMisfit]),
}

/// Draws what was identified, at the sensors, on the lines of the structure. `None` where no sensor has a place and a direction, or there are no modes.
///
/// # Errors
/// When drawing fails.
pub fn shapes_in_space(
    structure: &str,
    frame: &Wireframe,
    sensors: &[Sensor],
    identification: &Identification,
) -> Result<Option<String>, PictureError> {
    let panel = |mode: &Mode| {
        let value = |index: usize| {
            let at_point = mode.shape.iter().find(|component| component.point == sensors[index].point);
            Some((at_point?.re, None))
        };
        let caption = format!("{}: {:.3} Hz", mode.number, mode.frequency_hz);
        Panel { caption, model: None, marks: marks(sensors, value) }
    };
    let panels: Vec<Panel> = identification.modes.iter().map(panel).collect();
    let title = format!("{structure}: mode shapes");
    draw_all("the mode shapes", &title, frame, &panels, None, None)
}

/// Draws the pairs of a comparison on the lines of the structure, and the misfit of its groups or heights in the last panel. The model has the
/// colour of one with effects where it has some. `None` where no pair has a shape, or no sensor a place and a direction.
///
/// # Errors
/// When drawing fails.
pub fn comparison_in_space(
    structure: &str,
    seen: &SeenInSpace<'_>,
    sensors: &[Sensor],
    measured: &[MeasuredMode],
    comparison: &Comparison,
    has_effects: bool,
) -> Result<Option<String>, PictureError> {
    let SeenInSpace { frame, assembly, view } = *seen;
    let motions = frame.motion(assembly, &view.modes.shapes);
    let of_pairs = comparison.pairs.iter().filter_map(|pair| {
        let shape = measured.iter().find(|mode| mode.number == pair.measured)?.shape.as_ref()?;
        let model = view.shape(pair.model - 1);
        let factor = scale(model, shape);
        let value = |index: usize| {
            let at = shape.sensors.iter().position(|&sensor| sensor == index)?;
            Some((shape.values[at], model.get(index).map(|there| factor * there)))
        };
        let motion = motions.column(pair.model - 1);
        let motion = motion.as_slice().chunks_exact(3).map(|of| [of[0], of[1], of[2]].map(|part| factor * part));
        let mac = pair.mac.map_or_else(String::new, |mac| format!(", MAC {}", mac_words(mac, 4)));
        let caption = format!("{}: {} %{mac}", pair.measured, signed(pair.frequency_error_percent, 1));
        Some(Panel { caption, model: Some(motion.collect()), marks: marks(sensors, value) })
    });
    let panels: Vec<Panel> = of_pairs.collect();
    let bars = match (&comparison.by_group[..], &comparison.by_height[..]) {
        ([], []) => None,
        ([], heights) => Some(Bars::Heights(heights)),
        (groups, _) => Some(Bars::Groups(groups)),
    };
    let title = format!("{structure}: the model's mode shapes against the measured ones");
    let model = if has_effects { WITH_EFFECTS } else { GIVEN };
    draw_all("the comparison", &title, frame, &panels, Some(model), bars)
}

/// A model that is drawn in space.
#[derive(Clone, Copy)]
pub struct SeenInSpace<'a> {
    /// Its lines.
    pub frame: &'a Wireframe,
    /// Its matrices.
    pub assembly: &'a Assembly,
    /// Its modes.
    pub view: &'a ModelView,
}

/// Sensors by place: each measured and, where it is known, the model's motion along its direction; `value` has these by the sensor's index.
pub(super) fn marks(sensors: &[Sensor], value: impl Fn(usize) -> Option<(f64, Option<f64>)>) -> Vec<Marked> {
    let mut marks: Vec<Marked> = Vec::new();
    let of_points = sensors.iter().enumerate().filter(|(_, sensor)| sensor.is_of_a_point() && sensor.dof.is_none());
    for (index, sensor) in of_points {
        let (Some(z_m), Some(direction), Some((measured, model))) =
            (sensor.elevation_m, sensor.direction, value(index))
        else {
            continue;
        };
        let place_m = [sensor.offset_m[0], sensor.offset_m[1], z_m];
        let at = marks.iter().position(|mark| mark.place_m == place_m).unwrap_or_else(|| {
            let none = model.map(|_| [0.0; 3]);
            marks.push(Marked { place_m, measured: [0.0; 3], model: none });
            marks.len() - 1
        });
        let along = direction.cosines();
        bring(&mut marks[at].measured, along, measured);
        if let (Some(motion), Some(model)) = (&mut marks[at].model, model) {
            bring(motion, along, model);
        }
    }
    marks
}

/// Changes a motion so that it has this part along a direction.
fn bring(motion: &mut [f64; 3], along: [f64; 3], value: f64) {
    let left = value - dot(*motion, along);
    for (part, cosine) in motion.iter_mut().zip(along) {
        *part += left * cosine;
    }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Camera {
    /// Beside the normal of the longest extent in plan.
    pub(super) fn of(places_m: &[[f64; 3]]) -> Self {
        let count = places_m.len().max(1) as f64;
        let mean = [0, 1].map(|axis| places_m.iter().map(|place| place[axis]).sum::<f64>() / count);
        let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            places_m.iter().map(|place| f(place[0] - mean[0], place[1] - mean[1])).sum()
        };
        let along = 0.5 * (2.0 * sum(&|x, y| x * y)).atan2(sum(&|x, y| x * x - y * y));
        Self::seen(along - BESIDE, ABOVE)
    }

    /// With this azimuth to the right, and from so far above the horizontal, rad.
    pub(super) fn seen(azimuth: f64, above: f64) -> Self {
        let (sin, cos) = azimuth.sin_cos();
        let (above, level) = above.sin_cos();
        Self { right: [cos, sin, 0.0], up: [-sin * above, cos * above, level] }
    }

    pub(super) fn see(&self, place_m: [f64; 3]) -> (f64, f64) {
        (dot(place_m, self.right), dot(place_m, self.up))
    }
}

pub(super) fn moved(place_m: [f64; 3], motion: [f64; 3], amplitude: f64) -> [f64; 3] {
    std::array::from_fn(|axis| place_m[axis] + amplitude * motion[axis])
}

pub(super) fn length(motion: [f64; 3]) -> f64 {
    dot(motion, motion).sqrt()
}

fn draw_all(
    what: &'static str,
    title: &str,
    frame: &Wireframe,
    panels: &[Panel],
    model: Option<RGBColor>,
    bars: Option<Bars<'_>>,
) -> Result<Option<String>, PictureError> {
    if panels.iter().all(|panel| panel.marks.is_empty()) {
        return Ok(None);
    }
    let camera = Camera::of(&frame.places_m);
    let all = || frame.places_m.iter().copied();
    let travel_m = TRAVEL * longest_side_m(all());
    let seen = all().chain(panels.iter().flat_map(|panel| panel.marks.iter().map(|mark| mark.place_m)));
    let (mut x, mut y) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
    for (right, up) in seen.map(|place_m| camera.see(place_m)) {
        x = (x.0.min(right), x.1.max(right));
        y = (y.0.min(up), y.1.max(up));
    }
    let (x, y) = (x.0 - 1.1 * travel_m..x.1 + 1.1 * travel_m, y.0 - 1.1 * travel_m..y.1 + 1.1 * travel_m);
    let aspect = (x.end - x.start) / (y.end - y.start);
    let columns = COLUMNS.iter().find(|(least, _)| aspect >= *least).map_or(3, |(_, columns)| *columns);
    let width = WIDTH / columns;
    let height = ((f64::from(width) / aspect) as u32).clamp(90, HIGHEST) + CAPTION;
    let rows = (panels.len() as u32 + u32::from(bars.is_some())).div_ceil(columns);
    let window = Window { camera, places_m: &frame.places_m, edges: frame.edges(), travel_m, x, y };
    let draw = |root: &Area<'_>| -> DrawResult {
        let (header, body) = root.split_vertically(HEADER);
        draw_header(&header, title, model)?;
        let areas = body.split_evenly((rows as usize, columns as usize));
        for (area, panel) in areas.iter().zip(panels) {
            window.draw(area, panel, model)?;
        }
        match (&bars, areas.get(panels.len())) {
            (Some(bars), Some(area)) => draw_bars(area, bars),
            _ => Ok(()),
        }
    };
    picture(what, (WIDTH, HEADER + rows * height), draw).map(Some)
}

fn draw_header(header: &Area<'_>, title: &str, model: Option<RGBColor>) -> DrawResult {
    header.draw(&Text::new(title.to_owned(), (12, 8), ("sans-serif", 18)))?;
    let mut x = 12;
    let label = |words: &str, at: &mut i32| -> DrawResult {
        header.draw(&Text::new(words.to_owned(), (*at + 32, 34), ("sans-serif", 13)))?;
        *at += 32 + width_of(words, 13) + 20;
        Ok(())
    };
    sample(header, (x, 41), 26, Dashes::Full, MEASURED.stroke_width(1))?;
    sample_mark(header, (x + 26, 41), Mark::Dot, 3, MEASURED.filled())?;
    label("measured, from where the sensor stands", &mut x)?;
    if let Some(colour) = model {
        sample(header, (x, 41), 26, Dashes::Full, colour.stroke_width(1))?;
        sample_mark(header, (x + 13, 41), Mark::Dot, 4, colour.stroke_width(1))?;
        label("the model, and along what the sensor measures", &mut x)?;
    }
    sample(header, (x, 41), 26, Dashes::Full, FRAME.stroke_width(1))?;
    label("at rest", &mut x)?;
    let words = if model.is_some() {
        "Above each panel: mode, the model's frequency against the measured, MAC. Where dots are inside of circles, model and measurement agree."
    } else {
        "Motion without unit: the largest of each mode is drawn alike."
    };
    header.draw(&Text::new(words, (12, 54), ("sans-serif", 13)))?;
    Ok(())
}

/// What a panel shows.
struct Window<'a> {
    camera: Camera,
    places_m: &'a [[f64; 3]],
    edges: Vec<[usize; 2]>,
    /// The largest drawn motion.
    travel_m: f64,
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
}

impl Window<'_> {
    fn draw(&self, area: &Area<'_>, panel: &Panel, model: Option<RGBColor>) -> DrawResult {
        let (caption, body) = area.split_vertically(CAPTION);
        caption.draw(&Text::new(panel.caption.clone(), (12, 9), ("sans-serif", 13)))?;
        // One scale along both axes, in the middle of the panel.
        let (wide, high) = body.dim_in_pixel();
        let by_width = (self.x.end - self.x.start) / f64::from(wide);
        let scale = by_width.max((self.y.end - self.y.start) / f64::from(high));
        let around = |range: &std::ops::Range<f64>, pixels: u32| {
            let (middle, half) = (0.5 * (range.start + range.end), 0.5 * scale * f64::from(pixels));
            middle - half..middle + half
        };
        let (x, y) = (around(&self.x, wide), around(&self.y, high));
        let chart = ChartBuilder::on(&body).build_cartesian_2d(x.clone(), y.clone())?;
        let plane = Plane::of(&chart, x, y, false);
        let largest = panel
            .marks
            .iter()
            .flat_map(|mark| [mark.measured, mark.model.unwrap_or_default()])
            .chain(panel.model.iter().flatten().copied())
            .map(length)
            .fold(0.0, f64::max);
        let amplitude = if largest > 0.0 { self.travel_m / largest } else { 0.0 };
        let line = |ends: &[usize; 2], motion: Option<&[[f64; 3]]>| {
            ends.map(|end| {
                let place_m = self.places_m[end];
                let motion = motion.and_then(|motion| motion.get(end)).copied().unwrap_or_default();
                self.camera.see(moved(place_m, motion, amplitude))
            })
        };
        for ends in &self.edges {
            plane.curve(line(ends, None), Dashes::Full, FRAME.stroke_width(1))?;
        }
        if let (Some(motion), Some(colour)) = (&panel.model, model) {
            for ends in &self.edges {
                plane.curve(line(ends, Some(motion)), Dashes::Full, colour.stroke_width(1))?;
            }
        }
        for mark in &panel.marks {
            let at = |motion: [f64; 3]| self.camera.see(moved(mark.place_m, motion, amplitude));
            plane.curve([at([0.0; 3]), at(mark.measured)], Dashes::Full, MEASURED.stroke_width(1))?;
            plane.mark(at(mark.measured), Mark::Dot, 3, MEASURED.filled())?;
            if let (Some(motion), Some(colour)) = (mark.model, model) {
                plane.mark(at(motion), Mark::Dot, 5, colour.stroke_width(1))?;
            }
        }
        Ok(())
    }
}

/// Misfits as bars from the left, with what each is of.
fn draw_bars(area: &Area<'_>, bars: &Bars<'_>) -> DrawResult {
    let (title, mut rows): (&str, Vec<(String, f64)>) = match bars {
        Bars::Groups(groups) => {
            ("misfit by group", groups.iter().map(|group| (group.group.clone(), group.misfit)).collect())
        }
        Bars::Heights(levels) => {
            let of = |level: &HeightMisfit| (format!("{} m", fixed(level.elevation_m, 1)), level.misfit);
            ("misfit by height", levels.iter().rev().map(of).collect())
        }
    };
    area.draw(&Text::new(title, (12, 9), ("sans-serif", 13)))?;
    let (wide, high) = area.dim_in_pixel();
    let step = 17;
    let fits = ((high.saturating_sub(CAPTION) as usize) / step).max(1);
    if rows.len() > fits {
        // Those that miss most, in their order.
        let mut sizes: Vec<f64> = rows.iter().map(|(_, misfit)| *misfit).collect();
        sizes.sort_by(|a, b| b.total_cmp(a));
        let least = sizes[fits - 1];
        rows.retain(|(_, misfit)| *misfit >= least);
    }
    let largest = rows.iter().map(|(_, misfit)| *misfit).fold(f64::MIN_POSITIVE, f64::max);
    let label = rows.iter().map(|(name, _)| width_of(name, 12)).max().unwrap_or(0).min(wide as i32 / 2);
    let longest = f64::from((wide as i32 - label - 84).max(20));
    for (index, (name, misfit)) in rows.iter().take(fits).enumerate() {
        let y = CAPTION as i32 + (index * step) as i32;
        area.draw(&Text::new(name.clone(), (12, y), ("sans-serif", 12)))?;
        let (from, to) = (label + 22, label + 22 + (longest * misfit / largest).round() as i32);
        area.draw(&Rectangle::new([(from, y + 2), (to, y + 11)], MISFIT.filled()))?;
        let words = fixed(*misfit, axis_digits(largest).max(2));
        area.draw(&Text::new(words, (to + 6, y), TextStyle::from(("sans-serif", 12)).color(&INK)))?;
    }
    Ok(())
}
