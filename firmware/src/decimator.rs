//! The decimating filter, in transposed form: every input sample is added to the outputs it contributes to.
//!
//! A stage of ratio `r` has `26 r + 1` taps, yet only 27 accumulators of state, one for each output that is being summed;
//! the work is the same 26 multiply-adds an input sample as in direct form. The filter is `belfry_shared::decimation`'s.

use belfry_kernels::{ACCUMULATORS, accumulate, accumulate_and_shift};
use belfry_shared::decimation::{MAX_STAGES, Stages, TAPS_PER_RATIO};

use crate::tables::stage_taps;

/// Outputs that one input sample contributes to, at most.
const _: () = assert!(ACCUMULATORS == TAPS_PER_RATIO + 1);
/// Outputs to drop at the start: they are centred on samples before the first.
const WARM_UP: u8 = (TAPS_PER_RATIO / 2) as u8;

/// The state of one stage of one channel.
#[derive(Debug, Clone, Copy)]
struct Stage {
    accumulators: [f32; ACCUMULATORS],
    /// Position of the next input sample within an output period.
    phase: u8,
    warm_up: u8,
}

impl Stage {
    const START: Self = Self { accumulators: [0.0; ACCUMULATORS], phase: 0, warm_up: WARM_UP };

    fn push(&mut self, taps: &[[f32; ACCUMULATORS]], sample: f32) -> Option<f32> {
        let row = taps.get(usize::from(self.phase))?;
        let first_phase = self.phase == 0;
        self.phase = if usize::from(self.phase) + 1 == taps.len() { 0 } else { self.phase + 1 };
        if !first_phase {
            accumulate(&mut self.accumulators, row, sample);
            return None;
        }
        let output = accumulate_and_shift(&mut self.accumulators, row, sample);
        if self.warm_up > 0 {
            self.warm_up -= 1;
            return None;
        }
        Some(output)
    }
}

/// The state of one channel's filter cascade.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Decimator {
    stages: [Stage; MAX_STAGES],
}

impl Decimator {
    /// A filter that has seen nothing.
    pub(crate) const START: Self = Self { stages: [Stage::START; MAX_STAGES] };

    /// Takes a sample; returns a decimated one each time another is complete.
    ///
    /// The `m`-th decimated sample is centred on the `m * ratio`-th input and comes `reach_rows` inputs after it.
    pub(crate) fn push(&mut self, stages: &Stages, sample: f32) -> Option<f32> {
        let mut sample = sample;
        for (stage, &ratio) in self.stages.iter_mut().zip(stages.ratios()) {
            sample = stage.push(stage_taps(ratio), sample)?;
        }
        Some(sample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use belfry_shared::decimation::{fill_taps, tap_count};
    use std::{vec, vec::Vec};

    fn signal(n: usize) -> f64 {
        let t = n as f64;
        (0.013 * t).sin() + 0.4 * (0.21 * t + 1.0).cos() + 0.2 * (1.7 * t).sin()
    }

    /// The same cascade by its definition, in f64.
    fn reference(ratios: &[u8], input: &[f64]) -> Vec<f64> {
        ratios.iter().fold(input.to_vec(), |input, &ratio| {
            let mut taps = vec![0.0; tap_count(ratio)];
            fill_taps(ratio, &mut taps);
            let half = taps.len() / 2;
            let complete = (input.len() - 1).saturating_sub(half) / usize::from(ratio) + 1;
            (0..complete)
                .map(|m| {
                    let centre = m * usize::from(ratio);
                    let product =
                        |(j, tap): (usize, &f64)| (centre + j).checked_sub(half).map_or(0.0, |n| tap * input[n]);
                    taps.iter().enumerate().map(product).sum()
                })
                .collect()
        })
    }

    #[test]
    fn outputs_are_the_filters_at_every_ratio_with_sample_m_centred_on_row_m_times_ratio() {
        for ratio in [1, 2, 3, 5, 8, 10, 12, 60, 200] {
            let stages = Stages::of(ratio).unwrap();
            let input: Vec<f64> = (0..20_000).map(signal).collect();
            let expected = reference(stages.ratios(), &input);
            let mut decimator = Decimator::START;
            let mut output = Vec::new();
            for (row, &sample) in input.iter().enumerate() {
                if let Some(sample) = decimator.push(&stages, sample as f32) {
                    assert_eq!(row as u32, output.len() as u32 * ratio + stages.reach_rows());
                    output.push(sample);
                }
            }
            assert_eq!(output.len(), expected.len(), "ratio {ratio}");
            for (output, expected) in output.iter().zip(&expected) {
                // Three stages of 27 f32 products of values near one.
                assert!((f64::from(*output) - expected).abs() < 3e-6, "ratio {ratio}: {output} for {expected}");
            }
        }
    }
}
