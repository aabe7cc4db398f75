//! Animated GIF, which every program that shows pictures plays: frames of pixels flow in one after the other, a file flows out.

use std::io;

use ::gif::{Encoder, EncodingError, Frame, Repeat};

use super::palette::Palette;
use super::png::FRAMES_A_SECOND;
use super::raster::Pixels;

/// A file that is being written.
pub(super) struct GifFrames {
    palette: Palette,
    size: [u16; 2],
    encoder: Encoder<Vec<u8>>,
}

impl GifFrames {
    /// A file whose frames have this width and height, which is played again and again.
    ///
    /// # Errors
    /// When the file's head cannot be written, which it always can.
    pub(super) fn new(size: [u32; 2]) -> io::Result<Self> {
        let palette = Palette::new();
        let size = size.map(|side| u16::try_from(side).unwrap_or(u16::MAX));
        let mut encoder = Encoder::new(Vec::new(), size[0], size[1], &palette.bytes()).map_err(as_io)?;
        encoder.set_repeat(Repeat::Infinite).map_err(as_io)?;
        Ok(Self { palette, size, encoder })
    }

    /// # Errors
    /// When a frame does not compress, which it always does.
    pub(super) fn push(&mut self, frame: &Pixels) -> io::Result<()> {
        let pixels = self.palette.indexed(frame);
        let mut frame = Frame::from_indexed_pixels(self.size[0], self.size[1], pixels, None);
        // In hundredths of a second.
        frame.delay = 100 / FRAMES_A_SECOND;
        self.encoder.write_frame(&frame).map_err(as_io)
    }

    /// # Errors
    /// When the file's end cannot be written, which it always can.
    pub(super) fn finish(self) -> io::Result<Vec<u8>> {
        self.encoder.into_inner().map_err(as_io)
    }
}

fn as_io(error: EncodingError) -> io::Error {
    io::Error::other(error)
}
