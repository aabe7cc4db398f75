//! Quantisation: spectra in few bits.
//!
//! *Complex lines* go in blocks of [`BLOCK_LINES`] lines that share a scale byte; every component is an integer of
//! `bits` bits. With full scale `F` and `q = 2^(bits-1) - 1`, a component is `integer * F / q`, so its error is at most
//! `F / (2 q)`; `F` is at most 2^(1/4) (19 %) above the block's largest component. The scale byte `s` means
//! `F = 2^((s - 192) / 4)`, from 3.6e-15 to 55 000 m/s²/√Hz; `s = 0` means that the whole block is zero.
//!
//! *Power spectral densities* go as one byte per line on a logarithmic scale: byte `c` means `2^(base + c / 8)`, an error of
//! at most 4.5 % (0.19 dB) over a range of 95 dB above the part's `base`; `c = 0` means "below that".

use num_complex::Complex32;
use thiserror::Error;

/// Lines that share a scale byte.
pub const BLOCK_LINES: usize = 16;
/// Fewest bits per component.
pub const MIN_BITS: u8 = 3;
/// Most bits per component.
pub const MAX_BITS: u8 = 16;
/// Scale byte of 0 dB (full scale 1).
const SCALE_OF_ONE: i32 = 192;
/// Scale steps per octave.
const SCALE_STEPS: i32 = 4;
/// 2^(step/4) for one octave.
const QUARTER_OCTAVES: [f32; SCALE_STEPS as usize] = [1.0, 1.189_207_1, core::f32::consts::SQRT_2, 1.681_792_8];
/// Steps per octave of the logarithmic density code.
const DENSITY_STEPS: f32 = 8.0;

/// Why lines or densities could not be coded or read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum QuantiseError {
    /// The bits per component are outside [`MIN_BITS`] to [`MAX_BITS`].
    #[error("{0} bits per component; possible are {MIN_BITS} to {MAX_BITS}")]
    Bits(u8),
    /// The output does not have the length that the code or the lines need.
    #[error("the buffer has {found} places, the data need {needed}")]
    Length {
        /// Places there are.
        found: usize,
        /// Places needed.
        needed: usize,
    },
    /// A value is not finite.
    #[error("a value is infinite or not a number")]
    NotFinite,
}

/// Bytes that `lines` complex lines take at `bits` bits per component.
pub const fn encoded_bytes(lines: usize, bits: u8) -> usize {
    lines.div_ceil(BLOCK_LINES) + (lines * 2 * bits as usize).div_ceil(8)
}

/// The most lines whose code fits into `bytes`.
pub const fn lines_that_fit(bytes: usize, bits: u8) -> usize {
    let mut lines = bytes * 8 / (2 * bits as usize);
    while encoded_bytes(lines, bits) > bytes {
        lines -= 1;
    }
    lines
}

/// Codes `lines` into `code`, whose length must be [`encoded_bytes`]: all scale bytes first, then the components (real,
/// imaginary) packed least significant bit first.
pub fn encode_lines(lines: &[Complex32], bits: u8, code: &mut [u8]) -> Result<(), QuantiseError> {
    let (scales, packed, steps) = layout(lines.len(), bits, code.len())?;
    debug_assert_eq!(scales + packed, code.len());
    let (scales, packed) = code.split_at_mut(scales);
    let mut writer = BitWriter { bytes: packed, accumulator: 0, held: 0, next: 0 };
    for (block, scale) in lines.chunks(BLOCK_LINES).zip(scales) {
        let mut largest = 0.0_f32;
        for line in block {
            if !(line.re.is_finite() && line.im.is_finite()) {
                return Err(QuantiseError::NotFinite);
            }
            largest = largest.max(line.re.abs()).max(line.im.abs());
        }
        *scale = scale_byte(largest);
        let full_scale = full_scale(*scale);
        let gain = if full_scale > 0.0 { steps / full_scale } else { 0.0 };
        for line in block {
            for component in [line.re, line.im] {
                let scaled = (component * gain).clamp(-steps, steps);
                let integer = libm::roundf(scaled) as i32;
                writer.push(integer as u32, bits);
            }
        }
    }
    writer.finish();
    Ok(())
}

/// Codes lines that have been decoded from such a code before, so that decoding gives the same numbers again, bit for bit; `false` where they
/// do not come of a code of so many bits, blocks from the first line on.
///
/// [`encode_lines`] may take the next smaller full scale where rounding has brought the largest component of a block down to it.
pub fn encode_decoded_lines(lines: &[Complex32], bits: u8, code: &mut [u8]) -> Result<bool, QuantiseError> {
    let (scales, packed, steps) = layout(lines.len(), bits, code.len())?;
    debug_assert_eq!(scales + packed, code.len());
    let (scales, packed) = code.split_at_mut(scales);
    let mut writer = BitWriter { bytes: packed, accumulator: 0, held: 0, next: 0 };
    for (block, scale) in lines.chunks(BLOCK_LINES).zip(scales) {
        let components = || block.iter().flat_map(|line| [line.re, line.im]);
        let integer = |component: f32, step: f32| if step > 0.0 { libm::roundf(component / step) as i32 } else { 0 };
        let is_same = |step: f32| {
            components().all(|component| {
                let integer = integer(component, step);
                integer.unsigned_abs() as f32 <= steps && (integer as f32 * step).to_bits() == component.to_bits()
            })
        };
        let least = scale_byte(components().map(f32::abs).fold(0.0, f32::max));
        let candidates = [least, least.saturating_add(1)];
        let Some(&found) = candidates.iter().find(|&&scale| is_same(full_scale(scale) / steps)) else {
            return Ok(false);
        };
        *scale = found;
        let step = full_scale(found) / steps;
        components().for_each(|component| writer.push(integer(component, step) as u32, bits));
    }
    writer.finish();
    Ok(true)
}

/// Reads the lines that [`encode_lines`] coded; `lines` gives their number.
pub fn decode_lines(code: &[u8], bits: u8, lines: &mut [Complex32]) -> Result<(), QuantiseError> {
    let (scales, _, steps) = layout(lines.len(), bits, code.len())?;
    let (scales, packed) = code.split_at(scales);
    let mut reader = BitReader { bytes: packed, accumulator: 0, held: 0 };
    for (block, &scale) in lines.chunks_mut(BLOCK_LINES).zip(scales) {
        let step = full_scale(scale) / steps;
        for line in block {
            let re = reader.pull(bits);
            let im = reader.pull(bits);
            *line = Complex32::new(re as f32 * step, im as f32 * step);
        }
    }
    Ok(())
}

/// Scale bytes, packed bytes and largest integer, checked against the length of the code.
fn layout(lines: usize, bits: u8, length: usize) -> Result<(usize, usize, f32), QuantiseError> {
    if !(MIN_BITS..=MAX_BITS).contains(&bits) {
        return Err(QuantiseError::Bits(bits));
    }
    let needed = encoded_bytes(lines, bits);
    if length != needed {
        return Err(QuantiseError::Length { found: length, needed });
    }
    let scales = lines.div_ceil(BLOCK_LINES);
    Ok((scales, needed - scales, ((1_i32 << (bits - 1)) - 1) as f32))
}

/// The smallest scale byte whose full scale holds `largest` (the largest byte where none does).
fn scale_byte(largest: f32) -> u8 {
    if largest <= 0.0 {
        return 0;
    }
    // The octave below from the exponent bits, then at most four quarter steps up.
    let octave = ((largest.to_bits() >> 23) & 0xFF) as i32 - 127;
    let first = (SCALE_OF_ONE + SCALE_STEPS * octave).clamp(1, 255);
    (first..=255).find(|&scale| full_scale(scale as u8) >= largest).unwrap_or(255) as u8
}

/// Full scale of a block from its scale byte.
fn full_scale(scale: u8) -> f32 {
    if scale == 0 {
        return 0.0;
    }
    let steps = i32::from(scale) - SCALE_OF_ONE;
    let octave = steps.div_euclid(SCALE_STEPS);
    let power = f32::from_bits(((octave + 127) as u32) << 23);
    QUARTER_OCTAVES[steps.rem_euclid(SCALE_STEPS) as usize] * power
}

struct BitWriter<'a> {
    bytes: &'a mut [u8],
    accumulator: u32,
    held: u32,
    next: usize,
}

impl BitWriter<'_> {
    fn push(&mut self, value: u32, bits: u8) {
        self.accumulator |= (value & ((1 << bits) - 1)) << self.held;
        self.held += u32::from(bits);
        while self.held >= 8 {
            self.put();
        }
    }

    fn put(&mut self) {
        if let Some(byte) = self.bytes.get_mut(self.next) {
            *byte = self.accumulator as u8;
        }
        self.next += 1;
        self.accumulator >>= 8;
        self.held = self.held.saturating_sub(8);
    }

    fn finish(mut self) {
        if self.held > 0 {
            self.put();
        }
    }
}

struct BitReader<'a> {
    bytes: &'a [u8],
    accumulator: u32,
    held: u32,
}

impl BitReader<'_> {
    /// The next integer of `bits` bits, sign extended; zeros past the end.
    fn pull(&mut self, bits: u8) -> i32 {
        let bits = u32::from(bits);
        while self.held < bits {
            let byte = self.bytes.split_off_first().copied().unwrap_or(0);
            self.accumulator |= u32::from(byte) << self.held;
            self.held += 8;
        }
        let value = self.accumulator << (32 - bits);
        self.accumulator >>= bits;
        self.held -= bits;
        (value as i32) >> (32 - bits)
    }
}

/// Codes densities (non-negative, in (m/s²)²/Hz) into bytes of the same number and returns the base exponent.
pub fn encode_densities(densities: &[f32], code: &mut [u8]) -> Result<i16, QuantiseError> {
    if code.len() != densities.len() {
        return Err(QuantiseError::Length { found: code.len(), needed: densities.len() });
    }
    let mut largest = 0.0_f32;
    for &density in densities {
        if !density.is_finite() {
            return Err(QuantiseError::NotFinite);
        }
        largest = largest.max(density);
    }
    // The largest density gets one of the top eight codes.
    let top = libm::ceilf(libm::log2f(largest.max(f32::MIN_POSITIVE))) as i16;
    let base = top - (255.0 / DENSITY_STEPS) as i16;
    for (byte, &density) in code.iter_mut().zip(densities) {
        let above = libm::log2f(density.max(f32::MIN_POSITIVE)) - f32::from(base);
        *byte = libm::roundf(above * DENSITY_STEPS).clamp(0.0, 255.0) as u8;
    }
    Ok(base)
}

/// The density that a byte of [`encode_densities`] stands for, in (m/s²)²/Hz; 0 for "below the range".
pub fn decode_density(base: i16, code: u8) -> f32 {
    if code == 0 { 0.0 } else { libm::exp2f(f32::from(base) + f32::from(code) / DENSITY_STEPS) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::{vec, vec::Vec};

    fn round_trip(lines: &[Complex32], bits: u8) -> Vec<Complex32> {
        let mut code = vec![0; encoded_bytes(lines.len(), bits)];
        encode_lines(lines, bits, &mut code).unwrap();
        let mut back = vec![Complex32::default(); lines.len()];
        decode_lines(&code, bits, &mut back).unwrap();
        back
    }

    #[test]
    fn golden_lines() {
        // Full scale 1 (scale byte 192), seven steps at 4 bits: 1 -> 7, -1 -> -7, 1/7 -> 1, 0 -> 0.
        let lines = [Complex32::new(1.0, -1.0), Complex32::new(1.0 / 7.0, 0.0)];
        let mut code = [0; 3];
        encode_lines(&lines, 4, &mut code).unwrap();
        assert_eq!(code, [192, 0x97, 0x01]);
    }

    #[test]
    fn golden_densities() {
        let mut code = [0; 4];
        let base = encode_densities(&[1.0, 0.5, 0.25, 0.0], &mut code).unwrap();
        assert_eq!((base, code), (-31, [248, 240, 232, 0]));
    }

    #[test]
    fn six_bits_take_less_than_1_6_bytes_a_line() {
        assert_eq!(encoded_bytes(1600, 6), 2500);
        assert_eq!(lines_that_fit(2500, 6), 1600);
    }

    #[test]
    fn values_that_are_no_numbers_are_refused() {
        assert_eq!(encode_lines(&[Complex32::new(f32::NAN, 0.0)], 8, &mut [0; 3]), Err(QuantiseError::NotFinite));
        assert_eq!(encode_densities(&[f32::INFINITY], &mut [0]), Err(QuantiseError::NotFinite));
    }

    fn code_of(lines: usize, bits: u8) -> Vec<u8> {
        vec![0; encoded_bytes(lines, bits)]
    }

    fn component() -> impl Strategy<Value = f32> {
        prop_oneof![
            Just(0.0_f32),
            (-40_f32..15.0, any::<bool>()).prop_map(|(e, s)| if s { -e.exp2() } else { e.exp2() })
        ]
    }

    proptest! {
        #[test]
        fn every_component_is_within_half_a_step_of_its_blocks_full_scale(
            parts in prop::collection::vec((component(), component()), 0..100), bits in MIN_BITS..=MAX_BITS,
        ) {
            let lines: Vec<_> = parts.iter().map(|&(re, im)| Complex32::new(re, im)).collect();
            let back = round_trip(&lines, bits);
            for (block, back) in lines.chunks(BLOCK_LINES).zip(back.chunks(BLOCK_LINES)) {
                let largest = block.iter().fold(0.0_f32, |m, l| m.max(l.re.abs()).max(l.im.abs()));
                // 2^(1/4) above the largest component at most, half a step, and f32 rounding.
                let bound = 1.1893 * largest / (2.0 * ((1_u32 << (bits - 1)) - 1) as f32) * (1.0 + 1e-3);
                for (line, back) in block.iter().zip(back) {
                    prop_assert!((line.re - back.re).abs() <= bound && (line.im - back.im).abs() <= bound);
                }
            }
        }

        #[test]
        fn quantised_lines_are_a_fixed_point(parts in prop::collection::vec((component(), component()), 1..40), bits in MIN_BITS..=MAX_BITS) {
            let lines: Vec<_> = parts.iter().map(|&(re, im)| Complex32::new(re, im)).collect();
            let once = round_trip(&lines, bits);
            let twice = round_trip(&once, bits);
            for (a, b) in once.iter().zip(&twice) {
                // The scale may fall by a quarter octave, so the grid may shift; the value stays within a step of it.
                let scale = once.iter().fold(0.0_f32, |m, l| m.max(l.re.abs()).max(l.im.abs()));
                prop_assert!((a - b).norm() <= 1.2 * scale / ((1_u32 << (bits - 1)) - 1) as f32);
            }
        }

        #[test]
        fn decoded_lines_are_coded_again_without_any_change(parts in prop::collection::vec((component(), component()), 0..70), bits in MIN_BITS..=MAX_BITS) {
            let lines: Vec<_> = parts.iter().map(|&(re, im)| Complex32::new(re, im)).collect();
            let once = round_trip(&lines, bits);
            let mut code = code_of(once.len(), bits);
            prop_assert!(encode_decoded_lines(&once, bits, &mut code).unwrap());
            let mut twice = vec![Complex32::default(); once.len()];
            decode_lines(&code, bits, &mut twice).unwrap();
            prop_assert_eq!(once, twice);
            let other = [Complex32::new(1.0, f32::NAN), Complex32::new(0.3, 0.1)];
            prop_assert!(!encode_decoded_lines(&other, 5, &mut code_of(2, 5)).unwrap());
        }

        #[test]
        fn any_code_reads_without_panic(code in prop::collection::vec(any::<u8>(), 0..200), bits: u8, lines in 0_usize..200) {
            let mut back = vec![Complex32::default(); lines];
            if decode_lines(&code, bits, &mut back).is_ok() {
                prop_assert!(back.iter().all(|line| line.re.is_finite() && line.im.is_finite()));
            }
        }

        #[test]
        fn any_lines_code_without_panic(parts in prop::collection::vec((any::<f32>(), any::<f32>()), 0..40), bits: u8) {
            let lines: Vec<_> = parts.iter().map(|&(re, im)| Complex32::new(re, im)).collect();
            let mut code = vec![0; if bits == 0 { 0 } else { encoded_bytes(lines.len(), bits) }];
            let _ = encode_lines(&lines, bits, &mut code);
        }

        #[test]
        fn densities_come_back_within_half_a_code_step(exponents in prop::collection::vec(-30_f32..0.0, 1..50)) {
            let densities: Vec<f32> = exponents.iter().map(|e| 1e-6 * e.exp2()).collect();
            let mut code = vec![0; densities.len()];
            let base = encode_densities(&densities, &mut code).unwrap();
            for (&density, &code) in densities.iter().zip(&code) {
                let back = decode_density(base, code);
                // Half a step is 2^(1/16) - 1 = 4.4 %; the range below the largest is at least 30 octaves.
                prop_assert!((back / density - 1.0).abs() < 0.0445, "{density} came back as {back}");
            }
        }

        #[test]
        fn any_densities_code_and_read_without_panic(values in prop::collection::vec(any::<f32>(), 0..40), base: i16, byte: u8) {
            let mut code = vec![0; values.len()];
            let _ = encode_densities(&values, &mut code);
            let _ = decode_density(base, byte);
        }
    }
}
