//! A measured mode in motion, as an animated PNG or GIF: a title, the structure at rest with its heights, and its sensors through a period.
//!
//! Sensors and complex shapes flow in, a file flows out. Points move along ellipses where a shape is complex. A tower is drawn by its sections
//! ([`super::tower`]), a structure with lines of its own on these, and others by lines between the sensors.

use std::io;

use num_complex::Complex64;

use super::canvas::{INK, REJECTED, fixed};
use super::gif::GifFrames;
use super::glyphs::{fitting, write};
use super::png::PngFrames;
use super::raster::Pixels;
use super::scene::{Heights, Moving, Scene};
use super::space::{Camera, Marked, length, marks};
use super::tower;
use crate::joints::{stands, step, structural_lines};
use crate::model::{Wireframe, longest_side_m};
use crate::study::Sensor;

/// Frames of a period.
const FRAMES: usize = 24;
/// Periods of each mode where several follow each other.
const PERIODS: usize = 2;
/// The longer and the shorter side, pixels.
const SIDES: [u32; 2] = [720, 480];
/// Largest drawn motion over the structure's longest side.
const TRAVEL: f64 = 0.12;
/// Where the lines of the title stand, and the steps of their letters' grid, pixels.
const TITLE: [f64; 2] = [16.0, 32.0];
const TITLE_STEP: f64 = 2.3;
const SUBTITLE: [f64; 2] = [16.0, 56.0];
const SUBTITLE_STEP: f64 = 1.6;

/// What moves.
#[derive(Clone, Copy)]
pub struct MovingStructure<'a> {
    /// What it is called.
    pub name: &'a str,
    /// Lines of its own, where it has some.
    pub frame: Option<&'a Wireframe>,
    /// Its sensors.
    pub sensors: &'a [Sensor],
}

/// How it moves.
#[derive(Clone, Copy)]
pub struct MovingMode<'a> {
    /// Its number, from 1.
    pub number: usize,
    /// Its frequency in Hz.
    pub frequency_hz: f64,
    /// Its damping ratio, where known.
    pub damping_ratio: Option<f64>,
    /// Components in the order of the sensors.
    pub shape: &'a [Option<Complex64>],
}

/// What a moving picture is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MovingFormat {
    /// Animated PNG.
    Png,
    /// Animated GIF.
    Gif,
}

/// Draws modes one after the other into one file; how many could be drawn. `None` where none could: fewer than two places have a sensor with a
/// direction, or nothing moves.
///
/// # Errors
/// When frames do not compress.
pub fn animation(
    structure: &MovingStructure<'_>,
    modes: &[MovingMode<'_>],
    format: MovingFormat,
) -> io::Result<Option<(Vec<u8>, usize)>> {
    let [long, short] = SIDES;
    let own = structure.frame.map(|frame| &frame.places_m).into_iter().flatten().copied();
    let size =
        if stands(&own.chain(places_m(structure.sensors)).collect::<Vec<_>>()) { [short, long] } else { [long, short] };
    let mut file = Writer::new(format, size)?;
    let periods = if modes.len() > 1 { PERIODS } else { 1 };
    let mut drawn = 0;
    for mode in modes {
        let Some(scene) = scene(structure, mode.shape) else { continue };
        let view = scene.view(size);
        // What stands still is behind every frame.
        let mut background = view.background();
        title(&mut background, structure.name, mode);
        let frames: Vec<Pixels> =
            (0..FRAMES).map(|number| view.frame(&background, number as f64 / FRAMES as f64)).collect();
        for frame in std::iter::repeat_n(&frames, periods).flatten() {
            file.push(frame)?;
        }
        drawn += 1;
    }
    if drawn == 0 { Ok(None) } else { Ok(Some((file.finish()?, drawn))) }
}

fn places_m(sensors: &[Sensor]) -> impl Iterator<Item = [f64; 3]> {
    let of_points = sensors.iter().filter(|sensor| sensor.is_of_a_point() && sensor.dof.is_none());
    of_points.filter_map(|sensor| Some([sensor.offset_m[0], sensor.offset_m[1], sensor.elevation_m?]))
}

/// Whether it is drawn by its sections: it has no lines of its own, and its sensors stand above each other.
fn is_tower(structure: &MovingStructure<'_>) -> bool {
    structure.frame.is_none() && stands(&places_m(structure.sensors).collect::<Vec<_>>())
}

fn scene(structure: &MovingStructure<'_>, shape: &[Option<Complex64>]) -> Option<Scene> {
    let part = |of: fn(Complex64) -> f64| {
        marks(structure.sensors, |index| Some((of(shape.get(index).copied().flatten()?), None)))
    };
    let (real, imaginary) = (part(|value| value.re), part(|value| value.im));
    if real.len() < 2 {
        return None;
    }
    if is_tower(structure) {
        return tower::scene(structure.sensors, shape, &real, &imaginary);
    }
    in_space(structure.frame, &real, &imaginary)
}

/// A structure that is drawn by lines in space, as the report has it.
fn in_space(frame: Option<&Wireframe>, real: &[Marked], imaginary: &[Marked]) -> Option<Scene> {
    let places: Vec<[f64; 3]> = real.iter().map(|mark| mark.place_m).collect();
    let largest = real.iter().zip(imaginary).map(|(re, im)| length(re.measured).hypot(length(im.measured)));
    let largest = largest.fold(0.0, f64::max);
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let at_rest: &[[f64; 3]] = frame.map_or(&[], |frame| &frame.places_m);
    let all: Vec<[f64; 3]> = places.iter().chain(at_rest).copied().collect();
    let low_m = all.iter().map(|place| place[2]).fold(f64::INFINITY, f64::min);
    let high_m = all.iter().map(|place| place[2]).fold(f64::NEG_INFINITY, f64::max);
    // What lies may be a deck, whose ground nobody names.
    let ground_m = Some(low_m).filter(|_| stands(&all));
    let heights = Heights { low_m, high_m, ground_m, plan: 1.0, is_wide: true };
    let camera = Camera::of(if at_rest.is_empty() { &places } else { at_rest });
    let mut scene = Scene::new(camera, heights);
    let amplitude = TRAVEL * longest_side_m(all.iter().copied()) / largest;
    for (re, im) in real.iter().zip(imaginary) {
        let scaled = |motion: [f64; 3]| motion.map(|part| amplitude * part);
        scene.dot(Moving { place_m: re.place_m, re: scaled(re.measured), im: scaled(im.measured) });
    }
    let edges = frame.map(Wireframe::edges).unwrap_or_default();
    let ends = |[a, b]: &[usize; 2], of: &[[f64; 3]]| Some([*of.get(*a)?, *of.get(*b)?]);
    // Lines of the structure that lead from one sensor to another; where there are none, such as would.
    let sensor_at = |place: [f64; 3]| places.iter().position(|other| other.map(step) == place.map(step));
    let between = |[from, to]: [[f64; 3]; 2]| Some([sensor_at(from)?, sensor_at(to)?]);
    scene.lines = edges.iter().filter_map(|edge| between(ends(edge, at_rest)?)).collect();
    if scene.lines.is_empty() {
        scene.lines = structural_lines(&places);
    }
    scene.rest = match frame {
        Some(_) => edges.iter().filter_map(|edge| ends(edge, at_rest)).collect(),
        None => scene.lines.iter().filter_map(|line| ends(line, &places)).collect(),
    };
    Some(scene)
}

fn title(canvas: &mut Pixels, name: &str, mode: &MovingMode<'_>) {
    let words = format!("Mode {}: {} Hz", mode.number, fixed(mode.frequency_hz, 4));
    let damping = mode.damping_ratio.map(|ratio| format!("damping {} %   ", fixed(100.0 * ratio, 2)));
    let room = f64::from(canvas.width) - 2.0 * TITLE[0];
    write(canvas, &fitting(&words, TITLE_STEP, room), TITLE, TITLE_STEP, INK);
    let below = format!("{}{name}", damping.unwrap_or_default());
    write(canvas, &fitting(&below, SUBTITLE_STEP, room), SUBTITLE, SUBTITLE_STEP, REJECTED);
}

/// A file that is being written.
enum Writer {
    Png(PngFrames),
    Gif(GifFrames),
}

impl Writer {
    fn new(format: MovingFormat, size: [u32; 2]) -> io::Result<Self> {
        Ok(match format {
            MovingFormat::Png => Self::Png(PngFrames::new(size)),
            MovingFormat::Gif => Self::Gif(GifFrames::new(size)?),
        })
    }

    fn push(&mut self, frame: &Pixels) -> io::Result<()> {
        match self {
            Self::Png(file) => file.push(frame),
            Self::Gif(file) => file.push(frame),
        }
    }

    fn finish(self) -> io::Result<Vec<u8>> {
        match self {
            Self::Png(file) => Ok(file.finish()),
            Self::Gif(file) => file.finish(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use plotters::style::RGBColor;

    use super::super::canvas::MEASURED;
    use super::*;
    use crate::study::{Direction, Study, template};

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

    /// A file of one mode of the mast.
    fn of_mast(sensors: &[Sensor], shape: &[Option<Complex64>], format: MovingFormat) -> Option<Vec<u8>> {
        let structure = MovingStructure { name: "Mast", frame: None, sensors };
        let mode = MovingMode { number: 2, frequency_hz: 0.4812, damping_ratio: Some(0.0053), shape };
        let file = animation(&structure, &[mode], format).unwrap();
        file.map(|(file, drawn)| {
            assert_eq!(drawn, 1);
            file
        })
    }

    /// The rightmost pixel of a frame that has the colour of what was measured; `index` is that colour's.
    fn rightmost(data: &[u8], width: usize, index: u8) -> usize {
        let mut rows = Vec::new();
        flate2::read::ZlibDecoder::new(data).read_to_end(&mut rows).unwrap();
        let of_row = |row: &[u8]| row[1..].iter().rposition(|pixel| *pixel == index);
        rows.chunks(1 + width).filter_map(of_row).max().unwrap()
    }

    #[test]
    fn a_period_begins_and_ends_at_one_side_and_is_at_the_other_between() {
        let shape = [0.3, 0.7, 1.0].map(|value| Some(Complex64::new(value, 0.0)));
        let file = of_mast(&mast(), &shape, MovingFormat::Png).unwrap();
        let chunks = chunks(&file);
        assert_eq!(chunks[1], ("acTL".to_owned(), [24_u32.to_be_bytes(), [0; 4]].concat()));
        assert_eq!(chunks[2].0, "PLTE");
        assert_eq!(chunks.last().unwrap().0, "IEND");
        let side = |at: usize| u32::from_be_bytes(chunks[0].1[at..at + 4].try_into().unwrap());
        assert_eq!([side(0), side(4)], [480, 720], "what stands is higher than it is wide");
        let RGBColor(red, green, blue) = MEASURED;
        let index = chunks[2].1.chunks(3).position(|colour| colour == [red, green, blue]).unwrap() as u8;
        let frames: Vec<&[u8]> = chunks
            .iter()
            .filter_map(|(kind, data)| match kind.as_str() {
                "IDAT" => Some(&data[..]),
                "fdAT" => Some(&data[4..]),
                _ => None,
            })
            .collect();
        assert_eq!(frames.len(), FRAMES);
        let right: Vec<usize> = frames.iter().map(|frame| rightmost(frame, 480, index)).collect();
        // Seen from beside, so that the axis of motion may point to either side.
        let reach = right[0].abs_diff(right[FRAMES / 2]);
        assert!(reach > 40, "{right:?}");
        // A cosine: frame n is as frame 24 - n, to a pixel.
        assert!((1..FRAMES / 2).all(|number| right[number].abs_diff(right[FRAMES - number]) <= 1), "{right:?}");
        // Frames are numbered in the order of their chunks.
        let numbers = chunks.iter().filter(|(kind, _)| kind == "fcTL" || kind == "fdAT");
        let numbers: Vec<u32> = numbers.map(|(_, data)| u32::from_be_bytes(data[..4].try_into().unwrap())).collect();
        assert!(numbers.iter().copied().eq(0..2 * FRAMES as u32 - 1));
    }

    #[test]
    fn nothing_that_moves_is_no_picture() {
        let none =
            |sensors: &[Sensor], shape: [Option<Complex64>; 3]| of_mast(sensors, &shape, MovingFormat::Png).is_none();
        assert!(none(&mast(), [None, None, None]));
        assert!(none(&mast(), [Some(Complex64::ZERO); 3]));
        let mut nowhere = mast();
        nowhere.iter_mut().for_each(|sensor| sensor.elevation_m = None);
        assert!(none(&nowhere, [Some(Complex64::ONE); 3]));
    }

    /// Modes follow each other in one GIF, each for two periods.
    #[test]
    fn a_gif_has_the_frames_of_all_modes() {
        let sensors = mast();
        let shape = [0.3, 0.7, 1.0].map(|value| Some(Complex64::new(value, 0.1 * value)));
        let mode =
            |number: usize| MovingMode { number, frequency_hz: number as f64, damping_ratio: None, shape: &shape };
        let structure = MovingStructure { name: "Mast", frame: None, sensors: &sensors };
        let (file, drawn) = animation(&structure, &[mode(1), mode(2)], MovingFormat::Gif).unwrap().unwrap();
        assert_eq!(drawn, 2);
        let mut decoder = ::gif::DecodeOptions::new().read_info(&file[..]).unwrap();
        assert_eq!((decoder.width(), decoder.height()), (480, 720));
        assert_eq!(decoder.repeat(), ::gif::Repeat::Infinite);
        let mut frames = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            assert_eq!(frame.delay, 5, "twenty a second");
            frames.push(frame.buffer.to_vec());
        }
        assert_eq!(frames.len(), 2 * PERIODS * FRAMES);
        assert_eq!(frames[3], frames[FRAMES + 3], "a period is as the one before");
        assert_ne!(frames[0], frames[PERIODS * FRAMES], "another mode has another title");
    }

    /// The tower of the Canton template, whose sensors stand at two edges and measure two directions: what its sensors say of each section is
    /// drawn, and lines lead along sections and the axis alone. With BELFRY_PICTURES the pictures are written into that folder.
    #[test]
    fn a_tower_is_drawn_by_its_sections_and_what_lies_from_beside() {
        let study = Study::from_text(template::CANTON_STUDY, std::path::Path::new("canton")).unwrap();
        let sensors = study.sensors();
        let bending = |sensor: &Sensor| {
            Some(Complex64::new(sensor.direction?.cosines()[0] * (sensor.elevation_m? / 446.8).powi(2), 0.0))
        };
        let torsion = |sensor: &Sensor| {
            let [along_x, along_y, _] = sensor.direction?.cosines();
            let turn = (sensor.offset_m[0] * along_y - sensor.offset_m[1] * along_x) * sensor.elevation_m? / 446.8;
            Some(Complex64::new(turn / 7.3, 0.0))
        };
        for (name, part) in [("bending", &bending as &dyn Fn(&Sensor) -> Option<Complex64>), ("torsion", &torsion)] {
            let shape: Vec<Option<Complex64>> = sensors.iter().map(part).collect();
            let structure = MovingStructure { name: &study.structure.name, frame: None, sensors: &sensors };
            let scene = scene(&structure, &shape).unwrap();
            // Either along a section at one height, or up the axis.
            let level = |point: usize| scene.points[point].place_m[2];
            assert!(scene.thin.iter().all(|[a, b]| level(*a) == level(*b)), "{name}");
            let is_on_axis = |point: usize| scene.points[point].place_m[..2] == [0.0, 0.0];
            assert!(scene.lines.iter().flatten().all(|point| is_on_axis(*point)), "{name}");
            // The axis bends, and stands still in torsion.
            let axis = scene.lines.iter().flatten().map(|point| length(scene.points[*point].re)).fold(0.0, f64::max);
            assert_eq!(axis > 20.0, name == "bending", "{name}: {axis} m");
            if name == "torsion" {
                // Also where two sensors at a height leave it open; 0.1 % of the drawn motion of the sensors.
                assert!(axis < 0.02, "{axis} m");
            }
            look(name, &structure, &shape);
        }
        let deck = [0.0, 10.0, 20.0, 30.0, 40.0].map(|x_m: f64| Sensor {
            elevation_m: Some(6.0),
            offset_m: [x_m, 0.5 * (x_m / 10.0 % 2.0)],
            direction: Some(Direction::Up),
            ..Sensor::new(x_m.to_string(), 1)
        });
        let shape = [0.0, 0.7, 1.0, 0.7, 0.0].map(|value| Some(Complex64::new(value, 0.0)));
        let file = look("deck", &MovingStructure { name: "Footbridge", frame: None, sensors: &deck }, &shape);
        let chunks = chunks(&file);
        assert_eq!(u32::from_be_bytes(chunks[0].1[..4].try_into().unwrap()), 720, "what lies is wider than it is high");
    }

    /// The file as PNG; both are written where someone wants to look at them.
    fn look(name: &str, structure: &MovingStructure<'_>, shape: &[Option<Complex64>]) -> Vec<u8> {
        let mode = MovingMode { number: 3, frequency_hz: 0.36588, damping_ratio: Some(0.0081), shape };
        let [png, gif] = [MovingFormat::Png, MovingFormat::Gif]
            .map(|format| animation(structure, &[mode], format).unwrap().unwrap().0);
        if let Some(folder) = std::env::var_os("BELFRY_PICTURES").map(std::path::PathBuf::from) {
            std::fs::write(folder.join(format!("{name}.png")), &png).unwrap();
            std::fs::write(folder.join(format!("{name}.gif")), &gif).unwrap();
        }
        png
    }
}
