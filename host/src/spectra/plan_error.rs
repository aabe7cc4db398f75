//! Why there is no plan, or one with too few averages.

use thiserror::Error;

use super::plan::LONGEST_OF_NODES;

/// Why there is no plan.
#[derive(Debug, Error, PartialEq)]
pub enum PlanError {
    /// No segment fits into the recording.
    #[error(
        "the recording of {seconds:.1} s is too short: a segment of {segment} points at {decimated_rate_hz} Hz and the filter need {needed_s:.1} s; record longer or choose a shorter segment in [analysis]"
    )]
    TooShort {
        /// Which of the setups.
        setup: usize,
        /// Duration of the shortest setup.
        seconds: f64,
        /// Points of the shortest segment possible.
        segment: usize,
        /// Decimated sampling rate.
        decimated_rate_hz: f64,
        /// Duration needed.
        needed_s: f64,
    },
    /// No segment fits into the blocks that a recording is joined of.
    #[error(
        "the blocks of {block_s:.1} s (block_s in [[setup]]) are too short: two segments of {segment} points at {decimated_rate_hz} Hz, half over each other, and the filter need {needed_s:.1} s; join longer blocks, or take block_s out if no time is missing between them"
    )]
    BlocksTooShort {
        /// Which of the setups.
        setup: usize,
        /// Duration of a block.
        block_s: f64,
        /// Points of the shortest segment possible.
        segment: usize,
        /// Decimated sampling rate.
        decimated_rate_hz: f64,
        /// Duration needed.
        needed_s: f64,
    },
    /// The band leaves no lines.
    #[error(
        "no spectral line lies in band_hz = [{low_hz}, {high_hz}] at a spacing of {spacing_hz:.4} Hz: widen the band or lengthen the segment in [analysis]"
    )]
    EmptyBand {
        /// Lower edge.
        low_hz: f64,
        /// Upper edge.
        high_hz: f64,
        /// Line spacing.
        spacing_hz: f64,
    },
    /// The segment is longer than what nodes transform.
    #[error(
        "segment = {0} in [analysis] is for recordings that the host transforms itself: nodes transform {LONGEST_OF_NODES} points at most; add --direct or choose a shorter segment"
    )]
    TooLongForNodes(usize),
    /// No decimation serves the band and all setups.
    #[error(
        "no decimation of {rates} Hz reaches decimated_rate_hz = {wanted}: it must divide every sampling rate by a product of at most three numbers from 2 to 10"
    )]
    NoDecimation {
        /// The setups' sampling rates.
        rates: String,
        /// The rate wanted, or the one that the band needs.
        wanted: String,
    },
    /// The band reaches too high.
    #[error(
        "band_hz ends at {high_hz} Hz, but at {rate_hz} Hz only {usable_hz:.3} Hz are free of aliases: lower the band or raise the rate in [analysis]"
    )]
    BandTooHigh {
        /// Upper edge.
        high_hz: f64,
        /// Sampling rate after decimation.
        rate_hz: f64,
        /// Highest usable frequency.
        usable_hz: f64,
    },
}

/// Too few averages for the number of channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FewAverages {
    /// Averages of all setups together.
    pub averages: usize,
    /// Averages wanted.
    pub wanted: usize,
    /// Channels of the largest setup.
    pub channels: usize,
    /// Minutes of recording that are missing at this line spacing.
    pub missing_min: f64,
}

impl std::fmt::Display for FewAverages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} averages for {} channels, {} are needed for modes to be told from noise with confidence: record {:.0} min more, or shorten the segment in [analysis]",
            self.averages,
            self.channels,
            self.wanted,
            self.missing_min.ceil()
        )
    }
}
