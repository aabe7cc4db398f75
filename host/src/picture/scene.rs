//! What a moving picture shows, in metres: lines at rest, points with their motion, and the view of them on a picture of pixels.

use std::f64::consts::TAU;

use super::canvas::{FRAME, INK, MEASURED, REJECTED};
use super::glyphs::{CAPITAL, width, write};
use super::raster::{Pixels, stroke};
use super::space::{Camera, moved};
use crate::numbers::fixed;

/// Rooms around the structure: for the title, heights and lengths.
const TOP: f64 = 84.0;
const LEFT: f64 = 78.0;
const RIGHT: f64 = 22.0;
const BOTTOM: f64 = 58.0;
/// Half the width of lines, and the radius of dots.
const LINE: f64 = 1.1;
const THIN: f64 = 0.7;
const DOT: f64 = 4.0;
/// Steps of the letters' grid, pixels.
const SMALL: f64 = 1.4;
/// Least distance of two labels of the heights, pixels, and how many there are about.
const LABELS_APART: f64 = 24.0;
const LABELS: f64 = 6.0;
/// About the length of the line that says how long a metre is, pixels.
const BAR: f64 = 70.0;

/// A point and its motion, as large as it is drawn.
pub(super) struct Moving {
    pub(super) place_m: [f64; 3],
    pub(super) re: [f64; 3],
    pub(super) im: [f64; 3],
}

/// What the scales beside a structure say.
pub(super) struct Heights {
    pub(super) low_m: f64,
    pub(super) high_m: f64,
    /// Where it is known.
    pub(super) ground_m: Option<f64>,
    /// How many times the plan is drawn larger than heights.
    pub(super) plan: f64,
    /// Whether lengths in plan are to be seen.
    pub(super) is_wide: bool,
}

/// Everything to draw of a mode.
pub(super) struct Scene {
    camera: Camera,
    heights: Heights,
    pub(super) rest: Vec<[[f64; 3]; 2]>,
    pub(super) points: Vec<Moving>,
    /// Between points.
    pub(super) lines: Vec<[usize; 2]>,
    pub(super) thin: Vec<[usize; 2]>,
    dots: Vec<usize>,
}

impl Scene {
    pub(super) fn new(camera: Camera, heights: Heights) -> Self {
        let (rest, points, lines, thin, dots) = (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { camera, heights, rest, points, lines, thin, dots }
    }

    /// Adds a point; its number.
    pub(super) fn point(&mut self, point: Moving) -> usize {
        self.points.push(point);
        self.points.len() - 1
    }

    /// Adds a point that is drawn.
    pub(super) fn dot(&mut self, point: Moving) -> usize {
        let number = self.point(point);
        self.dots.push(number);
        number
    }

    /// The scene in a picture of this size.
    pub(super) fn view(&self, size: [u32; 2]) -> View<'_> {
        let mut ends = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        let mut reach = |place_m: [f64; 3], [right, up]: [f64; 2]| {
            let (x, y) = self.camera.see(place_m);
            for (axis, (at, by)) in [(x, right), (y, up)].into_iter().enumerate() {
                ends[0][axis] = ends[0][axis].min(at - by);
                ends[1][axis] = ends[1][axis].max(at + by);
            }
        };
        self.rest.iter().flatten().for_each(|place_m| reach(*place_m, [0.0; 2]));
        for Moving { place_m, re, im } in &self.points {
            let (re, im) = (self.camera.see(*re), self.camera.see(*im));
            reach(*place_m, [re.0.hypot(im.0), re.1.hypot(im.1)]);
        }
        let [width, height] = size.map(f64::from);
        let room = [width - LEFT - RIGHT, height - TOP - BOTTOM];
        let sides = [0, 1].map(|axis| (ends[1][axis] - ends[0][axis]).max(f64::MIN_POSITIVE));
        let pixels_a_metre = (room[0] / sides[0]).min(room[1] / sides[1]);
        let middle = [0, 1].map(|axis| 0.5 * (ends[0][axis] + ends[1][axis]));
        let origin =
            [LEFT + 0.5 * room[0] - pixels_a_metre * middle[0], TOP + 0.5 * room[1] + pixels_a_metre * middle[1]];
        View { scene: self, size, pixels_a_metre, origin }
    }
}

/// A scene on a picture.
pub(super) struct View<'a> {
    scene: &'a Scene,
    size: [u32; 2],
    pixels_a_metre: f64,
    /// Where the origin is, pixels.
    origin: [f64; 2],
}

impl View<'_> {
    fn at(&self, place_m: [f64; 3]) -> [f64; 2] {
        let (x, y) = self.scene.camera.see(place_m);
        [self.origin[0] + self.pixels_a_metre * x, self.origin[1] - self.pixels_a_metre * y]
    }

    /// What stands still: the structure at rest, the ground, heights and lengths.
    pub(super) fn background(&self) -> Pixels {
        let mut canvas = Pixels::blank(self.size);
        self.ground(&mut canvas);
        for [from, to] in &self.scene.rest {
            stroke(&mut canvas, self.at(*from), self.at(*to), LINE, FRAME);
        }
        self.heights(&mut canvas);
        self.lengths(&mut canvas);
        self.axes(&mut canvas);
        canvas
    }

    /// The structure at a share of a period, on what stands still.
    pub(super) fn frame(&self, background: &Pixels, share: f64) -> Pixels {
        let mut canvas = background.clone();
        let (sin, cos) = (TAU * share).sin_cos();
        // The real part of the motion that turns.
        let place = |point: &Moving| {
            let motion = std::array::from_fn(|axis| point.re[axis] * cos - point.im[axis] * sin);
            self.at(moved(point.place_m, motion, 1.0))
        };
        let now: Vec<[f64; 2]> = self.scene.points.iter().map(place).collect();
        for (lines, half_width) in [(&self.scene.thin, THIN), (&self.scene.lines, LINE)] {
            for [from, to] in lines {
                if let (Some(from), Some(to)) = (now.get(*from), now.get(*to)) {
                    stroke(&mut canvas, *from, *to, half_width, MEASURED);
                }
            }
        }
        for at in self.scene.dots.iter().filter_map(|dot| now.get(*dot)) {
            stroke(&mut canvas, *at, *at, DOT, MEASURED);
        }
        canvas
    }

    /// A line with hatches below, under the lowest that stands on it.
    fn ground(&self, canvas: &mut Pixels) {
        const HATCH: f64 = 9.0;
        let Some(ground_m) = self.scene.heights.ground_m else { return };
        let close_m = 0.01 * (self.scene.heights.high_m - self.scene.heights.low_m);
        let on_ground = self.scene.rest.iter().flatten().filter(|place| (place[2] - ground_m).abs() <= close_m);
        let Some(y) = on_ground.map(|place| self.at(*place)[1]).max_by(f64::total_cmp) else { return };
        let (left, right) = (LEFT, f64::from(self.size[0]) - RIGHT);
        stroke(canvas, [left, y], [right, y], 0.8, REJECTED);
        let count = ((right - left) / HATCH) as u32;
        for hatch in 1..=count {
            let x = left + HATCH * f64::from(hatch);
            stroke(canvas, [x, y], [x - 6.0, y + 6.0], 0.5, REJECTED);
        }
    }

    /// Heights in m at the left.
    fn heights(&self, canvas: &mut Pixels) {
        let Heights { low_m, high_m, .. } = self.scene.heights;
        let y = |z_m: f64| self.at([0.0, 0.0, z_m])[1];
        let pixels_a_metre = (y(0.0) - y(1.0)).max(f64::MIN_POSITIVE);
        let step_m = nice(((high_m - low_m) / LABELS).max(LABELS_APART / pixels_a_metre));
        let x = LEFT - 14.0;
        write(canvas, "height, m", [8.0, (y(high_m) - 16.0).max(TOP - 12.0)], SMALL, REJECTED);
        stroke(canvas, [x, y(low_m)], [x, y(high_m)], 0.5, REJECTED);
        let first = (low_m / step_m - 1e-9).ceil();
        let count = ((high_m / step_m + 1e-9).floor() - first).clamp(0.0, 50.0) as u32;
        for number in 0..=count {
            let z_m = step_m * (first + f64::from(number));
            let label = fixed(z_m, digits(step_m));
            stroke(canvas, [x - 5.0, y(z_m)], [x, y(z_m)], 0.5, REJECTED);
            let left = x - 9.0 - width(&label, SMALL);
            write(canvas, &label, [left, y(z_m) + 0.5 * CAPITAL * SMALL], SMALL, INK);
        }
    }

    /// A line as long as it says.
    fn lengths(&self, canvas: &mut Pixels) {
        let Heights { plan, is_wide, .. } = self.scene.heights;
        if !is_wide {
            return;
        }
        let a_metre = self.pixels_a_metre * plan;
        let length_m = nice(BAR / a_metre);
        let (left, y) = (LEFT + 4.0, f64::from(self.size[1]) - 16.0);
        let right = left + length_m * a_metre;
        for [from, to] in
            [[[left, y], [right, y]], [[left, y - 4.0], [left, y + 4.0]], [[right, y - 4.0], [right, y + 4.0]]]
        {
            stroke(canvas, from, to, 0.7, REJECTED);
        }
        let scale = if plan > 1.05 { format!(", plan \u{d7} {}", fixed(plan, 1)) } else { String::new() };
        let words = format!("{} m{scale}", fixed(length_m, digits(length_m)));
        write(canvas, &words, [right + 9.0, y + 0.5 * CAPITAL * SMALL], SMALL, INK);
    }

    /// Which way X, Y and Z point.
    fn axes(&self, canvas: &mut Pixels) {
        const LONG: f64 = 17.0;
        const LETTER: f64 = 27.0;
        let (x, y) = (30.0, f64::from(self.size[1]) - 26.0);
        let mut letters: Vec<[f64; 2]> = Vec::new();
        for (name, axis) in [("Z", [0.0, 0.0, 1.0]), ("X", [1.0, 0.0, 0.0]), ("Y", [0.0, 1.0, 0.0])] {
            let (right, up) = self.scene.camera.see(axis);
            // One that points to the viewer is a dot.
            if right.hypot(up) < 0.2 {
                continue;
            }
            stroke(canvas, [x, y], [x + LONG * right, y - LONG * up], 0.6, REJECTED);
            let at = |far: f64| [x + far * right, y - far * up];
            let is_free = |[a, b]: &[f64; 2]| letters.iter().all(|[c, d]| (a - c).hypot(b - d) > 10.0);
            let middle = [LETTER, LETTER + 10.0].map(at).into_iter().find(is_free).unwrap_or(at(LETTER + 20.0));
            letters.push(middle);
            let left = middle[0] - 0.5 * width(name, SMALL);
            write(canvas, name, [left, middle[1] + 0.5 * CAPITAL * SMALL], SMALL, INK);
        }
    }
}

/// The next 1, 2 or 5 of a decade.
fn nice(least: f64) -> f64 {
    if !(least > 0.0 && least.is_finite()) {
        return 1.0;
    }
    let decade = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0]
        .map(|step| step * decade)
        .into_iter()
        .find(|step| *step >= least * (1.0 - 1e-9))
        .unwrap_or(10.0 * decade)
}

/// Digits after the point of a step's multiples.
fn digits(step: f64) -> usize {
    (-step.log10().floor()).clamp(0.0, 6.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_1_2_or_5_of_a_decade() {
        assert_eq!([0.013, 0.2, 3.0, 7.0, 60.0].map(nice), [0.02, 0.2, 5.0, 10.0, 100.0]);
        assert_eq!([0.02, 0.5, 5.0, 100.0].map(digits), [2, 1, 0, 0]);
    }
}
