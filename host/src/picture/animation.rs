//! A measured mode in motion: the structure's lines at rest, and its sensors as they move through a period.
//!
//! Sensors and a complex shape flow in; an animated PNG flows out. Points move along ellipses where the shape is complex.

use std::f64::consts::TAU;
use std::io;

use num_complex::Complex64;
use plotters::style::RGBColor;

use super::canvas::{FRAME, MEASURED};
use super::png::{Pixels, animated};
use super::space::{Camera, Marked, length, marks, moved};
use crate::model::{Wireframe, longest_side_m};
use crate::spanning::shortest_lines;
use crate::study::Sensor;

/// Frames of a period.
const FRAMES: usize = 24;
/// The longest and the shortest side in pixels, and the room around.
const SIDE: f64 = 480.0;
const SHORT_SIDE: f64 = 160.0;
const ROOM: f64 = 16.0;
/// Largest drawn motion over the structure's longest side.
const TRAVEL: f64 = 0.12;
/// Half the width of lines, and the radius of dots.
const LINE: f64 = 0.9;
const DOT: f64 = 4.0;

/// Draws a mode, whose components stand in the order of the sensors. `None` where fewer than two sensors have a place and a direction, or
/// nothing moves.
///
/// # Errors
/// When frames do not compress.
pub fn animation(
    frame: Option<&Wireframe>,
    sensors: &[Sensor],
    shape: &[Option<Complex64>],
) -> io::Result<Option<Vec<u8>>> {
    let part =
        |of: fn(Complex64) -> f64| marks(sensors, |index| Some((of(shape.get(index).copied().flatten()?), None)));
    let (real, imaginary) = (part(|value| value.re), part(|value| value.im));
    let largest = real.iter().zip(&imaginary).map(|(re, im)| length(re.measured).hypot(length(im.measured)));
    let largest = largest.fold(0.0, f64::max);
    let places: Vec<[f64; 3]> = real.iter().map(|mark| mark.place_m).collect();
    if places.len() < 2 || largest <= 0.0 || !largest.is_finite() {
        return Ok(None);
    }
    let (at_rest, edges) = match frame {
        Some(frame) => (frame.places_m.clone(), frame.edges()),
        None => (Vec::new(), Vec::new()),
    };
    let lines = shortest_lines(&places);
    let all = || places.iter().chain(&at_rest).copied();
    let amplitude = TRAVEL * longest_side_m(all()) / largest;
    let window = Window::of(Camera::of(&all().collect::<Vec<_>>()), all(), amplitude * largest);
    // The structure at rest is behind every frame.
    let mut background = window.blank();
    let (rest_m, its_lines) = if edges.is_empty() { (&places, &lines) } else { (&at_rest, &edges) };
    for ends in its_lines {
        let [from, to] = ends.map(|end| window.at(rest_m.get(end).copied().unwrap_or_default()));
        stroke(&mut background, from, to, LINE, FRAME);
    }
    let mut frames = Vec::with_capacity(FRAMES);
    for number in 0..FRAMES {
        let (sin, cos) = (TAU * number as f64 / FRAMES as f64).sin_cos();
        // The real part of the component that turns.
        let place = |(re, im): (&Marked, &Marked)| {
            let motion = std::array::from_fn(|axis| re.measured[axis] * cos - im.measured[axis] * sin);
            window.at(moved(re.place_m, motion, amplitude))
        };
        let now: Vec<[f64; 2]> = real.iter().zip(&imaginary).map(place).collect();
        let mut canvas = background.clone();
        for [from, to] in &lines {
            if let (Some(from), Some(to)) = (now.get(*from), now.get(*to)) {
                stroke(&mut canvas, *from, *to, LINE, MEASURED);
            }
        }
        now.iter().for_each(|at| stroke(&mut canvas, *at, *at, DOT, MEASURED));
        frames.push(canvas);
    }
    animated(&frames).map(Some)
}

/// Which part of the view is drawn, and how large.
struct Window {
    camera: Camera,
    left: f64,
    top: f64,
    pixels_a_metre: f64,
    size: [u32; 2],
}

impl Window {
    fn of(camera: Camera, places_m: impl Iterator<Item = [f64; 3]>, travel_m: f64) -> Self {
        let mut ends = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        for place_m in places_m {
            let (x, y) = camera.see(place_m);
            for (axis, at) in [x, y].into_iter().enumerate() {
                ends[0][axis] = ends[0][axis].min(at - travel_m);
                ends[1][axis] = ends[1][axis].max(at + travel_m);
            }
        }
        let sides = [0, 1].map(|axis| (ends[1][axis] - ends[0][axis]).max(f64::MIN_POSITIVE));
        let pixels_a_metre = (SIDE - 2.0 * ROOM) / sides[0].max(sides[1]);
        let pixels = sides.map(|side| (side * pixels_a_metre + 2.0 * ROOM).clamp(SHORT_SIDE, SIDE).ceil());
        let room = [0, 1].map(|axis| 0.5 * (pixels[axis] / pixels_a_metre - sides[axis]));
        Self {
            camera,
            left: ends[0][0] - room[0],
            top: ends[1][1] + room[1],
            pixels_a_metre,
            size: pixels.map(|side| side as u32),
        }
    }

    fn at(&self, place_m: [f64; 3]) -> [f64; 2] {
        let (x, y) = self.camera.see(place_m);
        [(x - self.left) * self.pixels_a_metre, (self.top - y) * self.pixels_a_metre]
    }

    fn blank(&self) -> Pixels {
        let [width, height] = self.size;
        Pixels { width, height, rgb: vec![[255; 3]; (width * height) as usize] }
    }
}

/// Draws a line with round ends, or a dot where it has no length; pixels at its border take a part of the colour.
fn stroke(canvas: &mut Pixels, from: [f64; 2], to: [f64; 2], half_width: f64, RGBColor(red, green, blue): RGBColor) {
    let reach = half_width + 1.0;
    let span = |axis: usize, most: u32| {
        let (low, high) = (from[axis].min(to[axis]) - reach, from[axis].max(to[axis]) + reach);
        // A float out of range saturates.
        (low.max(0.0) as u32)..(high.ceil().max(0.0) as u32).min(most)
    };
    let (columns, rows) = (span(0, canvas.width), span(1, canvas.height));
    let along = [to[0] - from[0], to[1] - from[1]];
    let square = along[0] * along[0] + along[1] * along[1];
    for row in rows {
        for column in columns.clone() {
            let to_pixel = [f64::from(column) + 0.5 - from[0], f64::from(row) + 0.5 - from[1]];
            let share = (to_pixel[0] * along[0] + to_pixel[1] * along[1]) / square;
            let share = if square > 0.0 { share.clamp(0.0, 1.0) } else { 0.0 };
            let off = (to_pixel[0] - share * along[0]).hypot(to_pixel[1] - share * along[1]);
            let cover = (half_width + 0.5 - off).clamp(0.0, 1.0);
            let index = (row * canvas.width + column) as usize;
            let Some(pixel) = canvas.rgb.get_mut(index).filter(|_| cover > 0.0) else { continue };
            for (old, new) in pixel.iter_mut().zip([red, green, blue]) {
                *old = (f64::from(*old) + cover * (f64::from(new) - f64::from(*old))).round() as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;
    use crate::study::Direction;

    fn mast() -> Vec<Sensor> {
        let sensor = |z_m: f64| Sensor {
            elevation_m: Some(z_m),
            direction: Some(Direction::AzimuthDeg(0.0)),
            ..Sensor::new(z_m.to_string(), 1)
        };
        [10.0, 20.0, 30.0].map(sensor).to_vec()
    }

    /// Kinds and contents of a PNG's chunks, whose checksums are those of the standard's polynomial.
    fn chunks(file: &[u8]) -> Vec<(String, Vec<u8>)> {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let mut rest = file.strip_prefix(b"\x89PNG\r\n\x1a\n").unwrap();
        let mut chunks = Vec::new();
        while !rest.is_empty() {
            let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
            let (body, sum) = (&rest[4..8 + length], &rest[8 + length..12 + length]);
            assert_eq!(crc.checksum(body).to_be_bytes(), sum);
            chunks.push((String::from_utf8(body[..4].to_vec()).unwrap(), body[4..].to_vec()));
            rest = &rest[12 + length..];
        }
        chunks
    }

    /// The rightmost pixel of a frame that has the colour of what was measured.
    fn rightmost(data: &[u8], width: usize) -> usize {
        let mut rows = Vec::new();
        flate2::read::ZlibDecoder::new(data).read_to_end(&mut rows).unwrap();
        let RGBColor(red, green, blue) = MEASURED;
        let of_row = |row: &[u8]| row[1..].chunks(3).rposition(|pixel| pixel == [red, green, blue]);
        rows.chunks(1 + 3 * width).filter_map(of_row).max().unwrap()
    }

    #[test]
    fn a_period_begins_and_ends_at_one_side_and_is_at_the_other_between() {
        let shape = [0.3, 0.7, 1.0].map(|value| Some(Complex64::new(value, 0.0)));
        let file = animation(None, &mast(), &shape).unwrap().unwrap();
        let chunks = chunks(&file);
        assert_eq!(chunks[1], ("acTL".to_owned(), [24_u32.to_be_bytes(), [0; 4]].concat()));
        assert_eq!(chunks.last().unwrap().0, "IEND");
        let width = u32::from_be_bytes(chunks[0].1[..4].try_into().unwrap()) as usize;
        let frames: Vec<&[u8]> = chunks
            .iter()
            .filter_map(|(kind, data)| match kind.as_str() {
                "IDAT" => Some(&data[..]),
                "fdAT" => Some(&data[4..]),
                _ => None,
            })
            .collect();
        assert_eq!(frames.len(), FRAMES);
        let right: Vec<usize> = frames.iter().map(|frame| rightmost(frame, width)).collect();
        // Seen from beside, so that the axis of motion may point to either side.
        let reach = right[0].abs_diff(right[FRAMES / 2]);
        assert!(reach > 10, "{right:?}");
        // A cosine: frame n is as frame 24 - n, to a pixel.
        assert!((1..FRAMES / 2).all(|number| right[number].abs_diff(right[FRAMES - number]) <= 1), "{right:?}");
        // Frames are numbered in the order of their chunks.
        let numbers = chunks.iter().filter(|(kind, _)| kind == "fcTL" || kind == "fdAT");
        let numbers: Vec<u32> = numbers.map(|(_, data)| u32::from_be_bytes(data[..4].try_into().unwrap())).collect();
        assert!(numbers.iter().copied().eq(0..2 * FRAMES as u32 - 1));
    }

    #[test]
    fn nothing_that_moves_is_no_picture() {
        assert_eq!(animation(None, &mast(), &[None, None, None]).unwrap(), None);
        let still = [Some(Complex64::ZERO); 3];
        assert_eq!(animation(None, &mast(), &still).unwrap(), None);
        let mut nowhere = mast();
        nowhere.iter_mut().for_each(|sensor| sensor.elevation_m = None);
        assert_eq!(animation(None, &nowhere, &[Some(Complex64::ONE); 3]).unwrap(), None);
    }
}
