//! The decimating filter that nodes and host share, so that both see the same frequency response.
//!
//! A decimation by `ratio` runs through at most [`MAX_STAGES`] stages of 2 to [`MAX_STAGE_RATIO`] each. Every stage is a
//! linear-phase FIR low pass, a sinc under a Kaiser window (Kaiser 1974; Oppenheim & Schafer, Discrete-Time Signal
//! Processing, 7.5.3): flat within 0.001 dB up to [`USABLE_FRACTION`] of the stage's output rate, below -80 dB from
//! one minus that fraction on, so that nothing above -80 dB aliases into the usable band.
//!
//! Output sample `m` is centred on input row `m * ratio` (the filter's delay is taken out by counting, not by phase).

use core::f64::consts::PI;

/// Taps a stage has for each unit of its ratio; a stage of ratio `r` has `26 r + 1` taps.
pub const TAPS_PER_RATIO: usize = 26;
/// The largest ratio of one stage.
pub const MAX_STAGE_RATIO: u8 = 10;
/// How many stages a decimation can have.
pub const MAX_STAGES: usize = 3;
/// Share of the decimated sampling rate up to which the response is flat and free of aliases.
pub const USABLE_FRACTION: f64 = 0.4;
/// Stopband attenuation the Kaiser window is designed for, in dB.
const ATTENUATION_DB: f64 = 80.0;

/// The number of taps of a stage.
pub const fn tap_count(ratio: u8) -> usize {
    TAPS_PER_RATIO * ratio as usize + 1
}

/// A decimation split into stages, largest first (the first stage sees the most samples).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stages {
    ratios: [u8; MAX_STAGES],
    count: usize,
}

impl Stages {
    /// Splits `ratio`; `None` where it has no factors between 2 and [`MAX_STAGE_RATIO`] that fit into
    /// [`MAX_STAGES`] stages, or is 0. A ratio of 1 has no stage.
    pub fn of(ratio: u32) -> Option<Self> {
        fn split(ratio: u32, stages: usize, out: &mut [u8; MAX_STAGES], depth: usize) -> bool {
            if ratio <= u32::from(MAX_STAGE_RATIO) {
                out[depth] = ratio as u8;
                return stages == 1;
            }
            stages > 1
                && (2..=MAX_STAGE_RATIO).rev().any(|factor| {
                    out[depth] = factor;
                    ratio.is_multiple_of(u32::from(factor))
                        && split(ratio / u32::from(factor), stages - 1, out, depth + 1)
                })
        }
        if ratio == 1 {
            return Some(Self { ratios: [0; MAX_STAGES], count: 0 });
        }
        if ratio == 0 {
            return None;
        }
        (1..=MAX_STAGES).find_map(|count| {
            let mut ratios = [0; MAX_STAGES];
            split(ratio, count, &mut ratios, 0).then_some(Self { ratios, count })
        })
    }

    /// The stages' ratios in the order the samples pass them.
    pub fn ratios(&self) -> &[u8] {
        &self.ratios[..self.count]
    }

    /// The whole ratio.
    pub fn ratio(&self) -> u32 {
        self.ratios().iter().map(|&ratio| u32::from(ratio)).product()
    }

    /// Input rows that the filter reaches to either side of an output sample's centre.
    pub fn reach_rows(&self) -> u32 {
        let mut spacing = 1;
        let mut reach = 0;
        for &ratio in self.ratios() {
            spacing *= u32::from(ratio);
            reach += (TAPS_PER_RATIO as u32 / 2) * spacing;
        }
        reach
    }

    /// The first output sample whose filter support lies wholly inside the recording.
    pub fn first_full_output(&self) -> u32 {
        self.reach_rows().div_ceil(self.ratio())
    }
}

/// Fills `taps` (length [`tap_count`]) with a stage's impulse response, first tap first, unit gain at 0 Hz.
pub fn fill_taps(ratio: u8, taps: &mut [f64]) {
    let beta = 0.1102 * (ATTENUATION_DB - 8.7);
    let half = (tap_count(ratio) - 1) as f64 / 2.0;
    let mut sum = 0.0;
    for (index, tap) in taps.iter_mut().enumerate() {
        let offset = index as f64 - half;
        let phase = PI * offset / f64::from(ratio);
        let sinc = if offset == 0.0 { 1.0 } else { libm::sin(phase) / phase };
        let position = offset / half;
        *tap = sinc * bessel_i0(beta * libm::sqrt(1.0 - position * position));
        sum += *tap;
    }
    for tap in taps.iter_mut() {
        *tap /= sum;
    }
}

/// Modified Bessel function of the first kind, order 0, by its power series (relative error below 1e-15 for the
/// arguments a Kaiser window has, up to about 10).
fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let mut term = 1.0;
    let mut sum = 1.0;
    for k in 1..60 {
        term *= quarter / (f64::from(k) * f64::from(k));
        sum += term;
    }
    sum
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec;

    /// Amplitude response of a stage at `frequency` (in units of its output rate).
    fn response(ratio: u8, frequency: f64) -> f64 {
        let mut taps = vec![0.0; tap_count(ratio)];
        fill_taps(ratio, &mut taps);
        let centre = (taps.len() - 1) as f64 / 2.0;
        taps.iter()
            .enumerate()
            .map(|(i, tap)| tap * (2.0 * PI * frequency / f64::from(ratio) * (i as f64 - centre)).cos())
            .sum()
    }

    #[test]
    fn every_stage_is_flat_in_the_usable_band_and_closed_where_it_would_alias_into_it() {
        for ratio in 2..=MAX_STAGE_RATIO {
            for step in 0..=40 {
                let passed = response(ratio, USABLE_FRACTION * f64::from(step) / 40.0);
                assert!((passed - 1.0).abs() < 1.2e-4, "ratio {ratio}, step {step}: {passed}");
            }
            let nyquist_in = f64::from(ratio) / 2.0;
            for step in 0..=200 {
                let stop = 1.0 - USABLE_FRACTION;
                let frequency = stop + (nyquist_in - stop).max(0.0) * f64::from(step) / 200.0;
                assert!(response(ratio, frequency).abs() < 1.1e-4, "ratio {ratio} at {frequency}");
            }
        }
    }

    #[test]
    fn ratios_split_into_stages_of_at_most_ten() {
        assert_eq!(Stages::of(1).unwrap().ratios(), &[] as &[u8]);
        assert_eq!(Stages::of(10).unwrap().ratios(), &[10]);
        assert_eq!(Stages::of(12).unwrap().ratios(), &[6, 2]);
        assert_eq!(Stages::of(200).unwrap().ratios(), &[10, 10, 2]);
        assert_eq!(Stages::of(13), None);
        assert_eq!(Stages::of(0), None);
        for ratio in 1..=1000 {
            if let Some(stages) = Stages::of(ratio) {
                assert_eq!(stages.ratio(), ratio);
                assert!(stages.ratios().iter().all(|r| (2..=MAX_STAGE_RATIO).contains(r)));
            }
        }
    }

    #[test]
    fn the_reach_of_a_cascade_is_the_sum_of_its_stages_half_lengths_in_input_rows() {
        let stages = Stages::of(12).unwrap();
        assert_eq!(stages.reach_rows(), 13 * 6 + 13 * 12);
        assert_eq!(stages.first_full_output(), 20);
    }
}
