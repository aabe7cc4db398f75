//! The few colours of moving pictures: pixels flow in, a byte a pixel and the colours that it stands for flow out.
//!
//! Pictures are drawn in four colours on white, so that their borders are blends of these. The nearest of a list of blends makes files a third
//! as large, and GIF has no more than 256 colours.

use std::collections::HashMap;

use plotters::style::{RGBColor, WHITE};

use super::canvas::{FRAME, INK, MEASURED, REJECTED};
use super::raster::Pixels;

/// Blends from one colour to another, both of them among so many.
const BLENDS: [(RGBColor, RGBColor, u32); 5] =
    [(WHITE, INK, 40), (WHITE, MEASURED, 60), (WHITE, REJECTED, 30), (WHITE, FRAME, 8), (FRAME, MEASURED, 24)];

/// The colours, and which is the nearest to those that were asked for.
pub(super) struct Palette {
    colours: Vec<[u8; 3]>,
    known: HashMap<[u8; 3], u8>,
}

impl Palette {
    pub(super) fn new() -> Self {
        let mut colours: Vec<[u8; 3]> = Vec::new();
        for (from, to, count) in BLENDS {
            for number in 0..count {
                let share = f64::from(number) / f64::from(count - 1);
                let blend =
                    |from: u8, to: u8| (f64::from(from) + share * (f64::from(to) - f64::from(from))).round() as u8;
                let colour = [blend(from.0, to.0), blend(from.1, to.1), blend(from.2, to.2)];
                if !colours.contains(&colour) {
                    colours.push(colour);
                }
            }
        }
        Self { colours, known: HashMap::new() }
    }

    /// Red, green and blue of one after the other.
    pub(super) fn bytes(&self) -> Vec<u8> {
        self.colours.concat()
    }

    /// A byte a pixel.
    pub(super) fn indexed(&mut self, picture: &Pixels) -> Vec<u8> {
        let mut before = ([255; 3], self.nearest([255; 3]));
        let mut of_pixel = |pixel: &[u8; 3]| {
            if *pixel != before.0 {
                before = (*pixel, self.nearest(*pixel));
            }
            before.1
        };
        picture.rgb.iter().map(&mut of_pixel).collect()
    }

    fn nearest(&mut self, colour: [u8; 3]) -> u8 {
        if let Some(known) = self.known.get(&colour) {
            return *known;
        }
        let distance =
            |other: &[u8; 3]| -> u32 { other.iter().zip(colour).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum() };
        let nearest =
            (0_u8..).zip(&self.colours).min_by_key(|(_, other)| distance(other)).map_or(0, |(index, _)| index);
        self.known.insert(colour, nearest);
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_colours_that_are_drawn_are_kept_and_their_blends_are_near() {
        let mut palette = Palette::new();
        assert!(palette.colours.len() <= 256, "{}", palette.colours.len());
        for RGBColor(red, green, blue) in [WHITE, INK, MEASURED, REJECTED, FRAME] {
            let index = palette.nearest([red, green, blue]);
            assert_eq!(palette.colours[usize::from(index)], [red, green, blue]);
        }
        // Half of the measured colour on white: no channel is off by more than a step of its blend.
        let half = [MEASURED.0, MEASURED.1, MEASURED.2].map(|part| part / 2 + 127);
        let index = palette.nearest(half);
        let near = palette.colours[usize::from(index)];
        assert!(near.iter().zip(half).all(|(a, b)| a.abs_diff(b) <= 5), "{near:?} {half:?}");
    }
}
