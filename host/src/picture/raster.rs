//! Pictures of pixels: lines and dots flow in, pixels whose border takes a part of the colour flow out.

use plotters::style::RGBColor;

/// A picture of pixels, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Pixels {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) rgb: Vec<[u8; 3]>,
}

impl Pixels {
    /// A white one.
    pub(super) fn blank([width, height]: [u32; 2]) -> Self {
        Self { width, height, rgb: vec![[255; 3]; width as usize * height as usize] }
    }
}

/// Draws a line with round ends, or a dot where it has no length.
pub(super) fn stroke(
    canvas: &mut Pixels,
    from: [f64; 2],
    to: [f64; 2],
    half_width: f64,
    RGBColor(red, green, blue): RGBColor,
) {
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
