//! Steim's compression of miniSEED: frames of 64 bytes, sixteen words each, the first of which says how the others hold differences.
//!
//! As in the "SEED Reference Manual" 2.4, appendix B; words are big-endian here.

/// Which of the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Steim {
    One,
    Two,
}

const FRAME_BYTES: usize = 64;

/// Decodes `count` samples.
///
/// # Errors
/// A sentence, where frames end too early or the last sample is not the one that the first frame announces.
pub(super) fn decode(kind: Steim, frames: &[u8], count: usize) -> Result<Vec<f64>, String> {
    let mut differences: Vec<i32> = Vec::new();
    let mut ends: Option<[i32; 2]> = None;
    for frame in frames.chunks_exact(FRAME_BYTES) {
        let (words, _) = frame.as_chunks::<4>();
        let word = |place: usize| words.get(place).map_or(0, |word| u32::from_be_bytes(*word));
        let codes = word(0);
        // The first frame begins with the first and the last sample.
        let from = if ends.is_none() { 3 } else { 1 };
        ends.get_or_insert([word(1).cast_signed(), word(2).cast_signed()]);
        for place in from..words.len() {
            if differences.len() >= count {
                break;
            }
            let word = word(place);
            // How many differences, and of how many bits.
            let (number, bits) = match (kind, codes >> (30 - 2 * place) & 3, word >> 30) {
                (_, 0, _) => (0, 1),
                (_, 1, _) => (4, 8),
                (Steim::One, 2, _) => (2, 16),
                (Steim::One, _, _) => (1, 32),
                (Steim::Two, 2, 1) => (1, 30),
                (Steim::Two, 2, 2) => (2, 15),
                (Steim::Two, 2, 3) => (3, 10),
                (Steim::Two, 3, 0) => (5, 6),
                (Steim::Two, 3, 1) => (6, 5),
                (Steim::Two, 3, 2) => (7, 4),
                _ => return Err("a word of no known form".to_owned()),
            };
            for at in (0..number).rev() {
                let shifted = word >> (at * bits) << (32 - bits);
                differences.push(shifted.cast_signed() >> (32 - bits));
            }
        }
    }
    let Some([first, last]) = ends else { return Err("no frames".to_owned()) };
    if differences.len() < count {
        return Err(format!("{} samples where {count} are announced", differences.len()));
    }
    // The first difference is that to the record before.
    let mut samples = Vec::with_capacity(count);
    let mut sample = first;
    for (at, difference) in differences.iter().take(count).enumerate() {
        if at > 0 {
            sample = sample.wrapping_add(*difference);
        }
        samples.push(f64::from(sample));
    }
    if count > 0 && sample != last {
        return Err(format!("its last sample comes out as {sample}, and should be {last}: it is damaged"));
    }
    Ok(samples)
}
