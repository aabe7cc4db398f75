//! Moving pictures as files: frames of pixels flow in, an animated PNG (APNG) flows out, which browsers and office programs play.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;

/// Frames a second, and bits a channel of a pixel.
const FRAMES_A_SECOND: u16 = 20;
const BITS: u8 = 8;
/// Red, green and blue.
const RGB: u8 = 2;

/// A picture of pixels, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Pixels {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) rgb: Vec<[u8; 3]>,
}

/// The file, which is played again and again; frames are of one size.
///
/// # Errors
/// When frames do not compress, which they always do.
pub(super) fn animated(frames: &[Pixels]) -> io::Result<Vec<u8>> {
    let Some(first) = frames.first() else { return Ok(Vec::new()) };
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    let size = [first.width.to_be_bytes(), first.height.to_be_bytes()].concat();
    chunk(&mut file, b"IHDR", &[&size[..], &[BITS, RGB, 0, 0, 0]].concat());
    // Frames, and without end.
    chunk(&mut file, b"acTL", &[(frames.len() as u32).to_be_bytes(), 0_u32.to_be_bytes()].concat());
    let mut sequence: u32 = 0;
    let mut next = || {
        sequence += 1;
        (sequence - 1).to_be_bytes()
    };
    for (index, frame) in frames.iter().enumerate() {
        let whole =
            [&next()[..], &size, &[0; 8], &1_u16.to_be_bytes(), &FRAMES_A_SECOND.to_be_bytes(), &[0, 0]].concat();
        chunk(&mut file, b"fcTL", &whole);
        let data = compressed(frame)?;
        match index {
            0 => chunk(&mut file, b"IDAT", &data),
            _ => chunk(&mut file, b"fdAT", &[&next()[..], &data].concat()),
        }
    }
    chunk(&mut file, b"IEND", &[]);
    Ok(file)
}

/// Rows, each with the filter before it that leaves it as it is.
fn compressed(frame: &Pixels) -> io::Result<Vec<u8>> {
    const AS_IT_IS: u8 = 0;
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    for row in frame.rgb.chunks(frame.width.max(1) as usize) {
        encoder.write_all(&[AS_IT_IS])?;
        encoder.write_all(&row.concat())?;
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
