//! Animated PNG (APNG), which browsers and office programs play: frames of pixels flow in one after the other, a file flows out.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::palette::Palette;
use super::raster::Pixels;

/// Frames a second, and bits a pixel.
pub(super) const FRAMES_A_SECOND: u16 = 20;
const BITS: u8 = 8;
/// A byte a pixel, which a palette gives its colour.
const INDEXED: u8 = 3;

/// A file that is being written.
pub(super) struct PngFrames {
    palette: Palette,
    size: [u32; 2],
    /// Chunks of frames.
    body: Vec<u8>,
    frames: u32,
    /// Number of the next chunk of those that are numbered.
    sequence: u32,
}

impl PngFrames {
    /// A file whose frames have this width and height.
    pub(super) fn new(size: [u32; 2]) -> Self {
        Self { palette: Palette::new(), size, body: Vec::new(), frames: 0, sequence: 0 }
    }

    /// # Errors
    /// When a frame does not compress, which it always does.
    pub(super) fn push(&mut self, frame: &Pixels) -> io::Result<()> {
        let data = compressed(&self.palette.indexed(frame), self.size[0] as usize)?;
        let place = [self.next(), self.size[0].to_be_bytes(), self.size[1].to_be_bytes(), [0; 4], [0; 4]].concat();
        let time = [1_u16.to_be_bytes(), FRAMES_A_SECOND.to_be_bytes(), [0; 2]].concat();
        chunk(&mut self.body, b"fcTL", &[place, time].concat());
        if self.frames == 0 {
            chunk(&mut self.body, b"IDAT", &data);
        } else {
            let numbered = [&self.next()[..], &data].concat();
            chunk(&mut self.body, b"fdAT", &numbered);
        }
        self.frames += 1;
        Ok(())
    }

    fn next(&mut self) -> [u8; 4] {
        self.sequence += 1;
        (self.sequence - 1).to_be_bytes()
    }

    /// The file, which is played again and again.
    pub(super) fn finish(self) -> Vec<u8> {
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        let size = self.size.map(u32::to_be_bytes).concat();
        chunk(&mut file, b"IHDR", &[&size[..], &[BITS, INDEXED, 0, 0, 0]].concat());
        // Frames, and without end.
        chunk(&mut file, b"acTL", &[self.frames.to_be_bytes(), 0_u32.to_be_bytes()].concat());
        chunk(&mut file, b"PLTE", &self.palette.bytes());
        file.extend(self.body);
        chunk(&mut file, b"IEND", &[]);
        file
    }
}

/// Rows, each with the filter before it that leaves it as it is.
fn compressed(pixels: &[u8], width: usize) -> io::Result<Vec<u8>> {
    const AS_IT_IS: u8 = 0;
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    for row in pixels.chunks(width.max(1)) {
        encoder.write_all(&[AS_IT_IS])?;
        encoder.write_all(row)?;
    }
    encoder.finish()
}

fn chunk(file: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    let mut checksum = flate2::Crc::new();
    checksum.update(kind);
    checksum.update(data);
    file.extend((data.len() as u32).to_be_bytes());
    file.extend(kind);
    file.extend(data);
    file.extend(checksum.sum().to_be_bytes());
}
