//! One input sample of a transposed FIR filter: its products with a row of taps are added to the outputs being summed.

/// Outputs that one input sample contributes to, at most.
pub const ACCUMULATORS: usize = 27;

/// Adds a sample's products with `taps` to the accumulators.
#[inline(never)]
pub fn accumulate(accumulators: &mut [f32; ACCUMULATORS], taps: &[f32; ACCUMULATORS], sample: f32) {
    for (accumulator, tap) in accumulators.iter_mut().zip(taps) {
        *accumulator += sample * tap;
    }
}

/// The same; then takes the first output, which is complete, moves the others down, and begins another with zero.
#[inline(never)]
pub fn accumulate_and_shift(accumulators: &mut [f32; ACCUMULATORS], taps: &[f32; ACCUMULATORS], sample: f32) -> f32 {
    let output = accumulators[0] + sample * taps[0];
    for i in 1..ACCUMULATORS {
        accumulators[i - 1] = accumulators[i] + sample * taps[i];
    }
    accumulators[ACCUMULATORS - 1] = 0.0;
    output
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shift_takes_the_first_output_and_changes_no_bit_of_the_others() {
        let taps = core::array::from_fn(|i| 0.3 + 0.01 * i as f32);
        let mut added: [f32; ACCUMULATORS] = core::array::from_fn(|i| 1.0 / (1 + i) as f32);
        let mut shifted = added;
        accumulate(&mut added, &taps, 0.7);
        assert_eq!(accumulate_and_shift(&mut shifted, &taps, 0.7), added[0]);
        assert_eq!((&shifted[..ACCUMULATORS - 1], shifted[ACCUMULATORS - 1]), (&added[1..], 0.0));
    }
}
