//! A tower in motion: its axis and the outlines of its sections, as the report draws it.
//!
//! Sensors and a complex shape flow in; lines at rest, points with their motion and the side to look from flow out. At each height the sensors
//! say how the section moves and turns; its outline goes through the sensors, so that no line leads from one edge to another's next level.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use nalgebra::{Matrix3, Vector3};
use num_complex::Complex64;

use super::scene::{Heights, Moving, Scene};
use super::space::{Camera, Marked, dot, length};
use crate::joints::{ring, step};
use crate::study::Sensor;

/// Least drawn radius of a section over the height: 7 m on 600 m would not be seen.
const SECTION: f64 = 0.045;
/// Largest drawn travel of sensors over the height, and of rotation over the drawn radius.
const TRAVEL: f64 = 0.12;
const TURN: f64 = 0.6;
/// More sections hide each other.
const OUTLINES: usize = 12;
/// A direction with less of its length in plan says nothing of how the section moves there.
const LEVEL: f64 = 0.3;
/// From where it is seen: beside the direction of most of its motion, and above the horizontal, rad.
const BESIDE: f64 = 0.4;
const ABOVE: f64 = 0.3;

/// What a sensor says of its section.
struct Reading {
    offset_m: [f64; 2],
    along: [f64; 3],
    value: Complex64,
}

/// Sensors of one height.
#[derive(Default)]
struct Level {
    z_m: f64,
    offsets_m: Vec<[f64; 2]>,
    readings: Vec<Reading>,
    /// How the section moves along X and Y, and turns, rad.
    motion: Option<[Complex64; 3]>,
}

/// The tower of these sensors; `real` and `imaginary` are the parts of their motion by place. None where nothing moves.
pub(super) fn scene(
    sensors: &[Sensor],
    shape: &[Option<Complex64>],
    real: &[Marked],
    imaginary: &[Marked],
) -> Option<Scene> {
    let mut levels = levels(sensors, shape);
    let (lowest_m, high_m) = (levels.first()?.z_m, levels.last()?.z_m);
    // Where heights begin far from 0 nobody knows where the ground is.
    let ground_m =
        if lowest_m <= 0.0 || lowest_m <= 2.0 * (high_m - lowest_m) { Some(lowest_m.min(0.0)) } else { None };
    let low_m = ground_m.unwrap_or(lowest_m);
    let height_m = high_m - low_m;
    let radius_m = levels.iter().flat_map(|level| &level.offsets_m).map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max);
    let is_wide = radius_m > 1e-6;
    let arm_m = if is_wide { radius_m } else { SECTION * height_m };
    let plan = if is_wide { (SECTION * height_m / radius_m).max(1.0) } else { 1.0 };
    find_motion(&mut levels, ground_m, arm_m);
    let told = || levels.iter().filter_map(|level| level.motion);
    let travel = |[x, y, _]: [Complex64; 3]| (x.norm_sqr() + y.norm_sqr()).sqrt();
    let of_dots = real.iter().zip(imaginary).map(|(re, im)| length(re.measured).hypot(length(im.measured)));
    let largest = told().map(travel).chain(of_dots).fold(0.0, f64::max);
    let turn = told().map(|[_, _, turn]| turn.norm()).fold(0.0, f64::max);
    if !(largest > 0.0 && largest.is_finite() && height_m > 0.0) {
        return None;
    }
    let by_turn = if turn > 0.0 { TURN * plan / turn } else { f64::INFINITY };
    let amplitude = (TRAVEL * height_m / largest).min(by_turn);
    let towards = towards(told());
    let heights = Heights { low_m, high_m, ground_m, plan, is_wide };
    let mut scene = Scene::new(Camera::seen(towards - BESIDE, ABOVE), heights);
    scene.rest.push([[0.0, 0.0, low_m], [0.0, 0.0, high_m]]);
    let place = |[x, y]: [f64; 2], z: f64| [plan * x, plan * y, z];
    let every = levels.len().div_ceil(OUTLINES);
    let mut axis: Vec<usize> = Vec::new();
    let square = [[arm_m, 0.0], [0.0, arm_m], [-arm_m, 0.0], [0.0, -arm_m]];
    for (index, level) in levels.iter().enumerate() {
        let is_drawn = (levels.len() - 1 - index).is_multiple_of(every);
        let outline = if is_wide { outline(&level.offsets_m) } else { square.to_vec() };
        if is_drawn {
            let around = outline.iter().zip(outline.iter().cycle().skip(1));
            scene.rest.extend(around.map(|(a, b)| [place(*a, level.z_m), place(*b, level.z_m)]));
        }
        let moved = |[x, y]: [f64; 2]| {
            let [along_x, along_y, turn] = level.motion.unwrap_or_default();
            let motion = [along_x - turn * y, along_y + turn * x, Complex64::ZERO].map(|part| part * amplitude);
            Moving { place_m: place([x, y], level.z_m), re: motion.map(|part| part.re), im: motion.map(|part| part.im) }
        };
        let middle = level.motion.map(|_| scene.point(moved([0.0; 2])));
        axis.extend(middle);
        // A dot moves with its section, but along each direction that is measured there exactly as measured.
        let mut dots: BTreeMap<[i64; 2], usize> = BTreeMap::new();
        for Reading { offset_m, along, value } in &level.readings {
            let key = offset_m.map(step);
            let dot_at = *dots.entry(key).or_insert_with(|| scene.dot(moved(*offset_m)));
            let Some(point) = scene.points.get_mut(dot_at) else { continue };
            for (motion, value) in [(&mut point.re, amplitude * value.re), (&mut point.im, amplitude * value.im)] {
                let left = value - dot(*motion, *along);
                motion.iter_mut().zip(along).for_each(|(part, cosine)| *part += left * cosine);
            }
        }
        if is_drawn && level.motion.is_some() {
            let corners: Vec<usize> = outline
                .iter()
                .map(|at| dots.get(&at.map(step)).copied().unwrap_or_else(|| scene.point(moved(*at))))
                .collect();
            let around = corners.iter().zip(corners.iter().cycle().skip(1));
            scene.thin.extend(around.map(|(&a, &b)| [a, b]));
        } else if let Some(middle) = middle {
            // A spoke, so that no dot hangs in the air.
            scene.thin.extend(dots.values().map(|&dot| [middle, dot]));
        }
    }
    scene.lines.extend(axis.windows(2).map(|pair| [pair[0], pair[1]]));
    Some(scene)
}

fn levels(sensors: &[Sensor], shape: &[Option<Complex64>]) -> Vec<Level> {
    let mut levels: BTreeMap<i64, Level> = BTreeMap::new();
    for (sensor, value) in sensors.iter().zip(shape) {
        let Some(z_m) = sensor.elevation_m.filter(|_| sensor.is_of_a_point() && sensor.dof.is_none()) else { continue };
        let level = levels.entry(step(z_m)).or_insert_with(|| Level { z_m, ..Level::default() });
        level.offsets_m.push(sensor.offset_m);
        if let (Some(direction), Some(value)) = (sensor.direction, *value) {
            level.readings.push(Reading { offset_m: sensor.offset_m, along: direction.cosines(), value });
        }
    }
    levels.into_values().collect()
}

/// The outline through points in plan, and through the axis where there are fewer than three.
fn outline(offsets_m: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let distinct: BTreeMap<[i64; 2], [f64; 2]> = offsets_m.iter().map(|at| (at.map(step), *at)).collect();
    let mut points: Vec<[f64; 2]> = distinct.into_values().collect();
    if points.len() < 3 && points.iter().all(|at| at.map(step) != [0, 0]) {
        points.push([0.0; 2]);
    }
    ring(&points).into_iter().filter_map(|index| points.get(index).copied()).collect()
}

/// Finds how each section moves. Where its sensors leave some of it open it does that as the sections do that are not open, by height, so that
/// a level with two sensors does not sway where those around it turn.
fn find_motion(levels: &mut [Level], ground_m: Option<f64>, arm_m: f64) {
    let mut certain: Vec<(f64, [Complex64; 3])> = ground_m.map(|z_m| (z_m, Default::default())).into_iter().collect();
    let is_told = levels.iter().any(|level| section(&level.readings, Default::default(), arm_m).is_some_and(|it| it.1));
    for level in levels.iter() {
        certain.extend(
            section(&level.readings, Default::default(), arm_m)
                .filter(|it| it.1)
                .map(|(motion, _)| (level.z_m, motion)),
        );
    }
    for level in levels {
        let start = if is_told { at_height(&certain, level.z_m) } else { Default::default() };
        level.motion = section(&level.readings, start, arm_m).map(|(motion, _)| motion);
    }
}

/// Motion at a height, straight between those that are known and as the outermost beyond.
fn at_height(known: &[(f64, [Complex64; 3])], z_m: f64) -> [Complex64; 3] {
    let above = known.iter().position(|(other_m, _)| *other_m >= z_m);
    let motion_of = |at: usize| known.get(at).map(|(_, motion)| *motion).unwrap_or_default();
    match above {
        None => motion_of(known.len().saturating_sub(1)),
        Some(0) => motion_of(0),
        Some(above) => {
            let (from_m, to_m) = (known[above - 1].0, known[above].0);
            let share = (z_m - from_m) / (to_m - from_m).max(f64::MIN_POSITIVE);
            let (from, to) = (motion_of(above - 1), motion_of(above));
            std::array::from_fn(|part| from[part] + (to[part] - from[part]) * share)
        }
    }
}

/// How a section moves and turns, by least squares from what its sensors say and as near to `start` as they leave open; and whether they leave
/// nothing open. `arm_m` weighs rotation like translation.
fn section(readings: &[Reading], start: [Complex64; 3], arm_m: f64) -> Option<([Complex64; 3], bool)> {
    let start = [start[0], start[1], start[2] * arm_m];
    let mut normal = Matrix3::zeros();
    let (mut real, mut imaginary) = (Vector3::zeros(), Vector3::zeros());
    for Reading { offset_m: [x, y], along: [along_x, along_y, _], value } in readings {
        if along_x.hypot(*along_y) <= LEVEL {
            continue;
        }
        let row = Vector3::new(*along_x, *along_y, (along_y * x - along_x * y) / arm_m);
        let left = *value - start.iter().zip(row.iter()).map(|(motion, part)| motion * part).sum::<Complex64>();
        normal += row * row.transpose();
        real += row * left.re;
        imaginary += row * left.im;
    }
    let size = normal.trace() / 3.0;
    let is_certain = normal.determinant() > 1e-4 * size.powi(3);
    let inverse = (normal + Matrix3::identity() * (1e-6 * size)).cholesky()?;
    let (real, imaginary) = (inverse.solve(&real), inverse.solve(&imaginary));
    let part = |axis: usize| start[axis] + Complex64::new(real[axis], imaginary[axis]);
    Some(([part(0), part(1), part(2) / arm_m], is_certain))
}

/// Azimuth of most of the motion, rad.
fn towards(told: impl Iterator<Item = [Complex64; 3]>) -> f64 {
    let (mut across, mut along) = (0.0, 0.0);
    for [x, y, _] in told {
        across += 2.0 * (x * y.conj()).re;
        along += x.norm_sqr() - y.norm_sqr();
    }
    (0.5 * across.atan2(along) + PI) % PI
}
