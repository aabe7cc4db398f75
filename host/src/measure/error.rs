//! Why a study could not be measured.

use thiserror::Error;

use crate::archive::ArchiveError;
use crate::fleet::FleetError;
use crate::record::RecordError;
use crate::spectra::{PlanError, SpectraError};

/// Why a study could not be measured.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// The study has no setups.
    #[error("the study has no [[setup]] to measure: describe the recording and its sensors in study.toml")]
    NoSetups,
    /// A setup's recording cannot be read.
    #[error("setup \"{setup}\": {source}")]
    Record {
        /// The setup.
        setup: String,
        /// Why.
        source: Box<RecordError>,
    },
    /// A setup's archive cannot be read.
    #[error("setup \"{setup}\": {source}")]
    Archive {
        /// The setup.
        setup: String,
        /// Why.
        source: Box<ArchiveError>,
    },
    /// Nothing has been collected of a live setup.
    #[error(
        "setup \"{setup}\" is collected live, and no window has come yet: run `belfry collect` and wait for the first, which takes a segment's length"
    )]
    NothingCollected {
        /// The setup.
        setup: String,
    },
    /// Live setups were collected with different lines.
    #[error(
        "setup \"{setup}\" was collected with other lines than setup \"{first}\": they cannot be analysed together; collect it again with the same [analysis]"
    )]
    OtherLines {
        /// The setup.
        setup: String,
        /// The one whose lines count.
        first: String,
    },
    /// A setup's recording is too short for the others' analysis.
    #[error("setup \"{setup}\": {source}")]
    TooShort {
        /// The setup.
        setup: String,
        /// What it would need.
        source: PlanError,
    },
    /// An interval of a recording has too few averages.
    #[error(
        "an interval of {every_s} s gives {averages} averages, too few to say how sure they are; take intervals of {needed_s} s at least"
    )]
    IntervalTooShort {
        /// The interval.
        every_s: f64,
        /// Its averages.
        averages: usize,
        /// What would do.
        needed_s: f64,
    },
    /// There is no way to analyse the setups.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The simulated nodes failed.
    #[error("setup \"{setup}\": {source}")]
    Fleet {
        /// The setup.
        setup: String,
        /// Why.
        source: FleetError,
    },
    /// No spectrum came of a setup.
    #[error("setup \"{setup}\": {source}")]
    Spectra {
        /// The setup.
        setup: String,
        /// Why.
        source: SpectraError,
    },
    /// No window of a setup can be used.
    #[error(
        "setup \"{setup}\": none of {windows} windows of {segment} points is sound on all live channels at once. Sound are: {channels}{}",
        may_be_why(found)
    )]
    NoSound {
        /// The setup.
        setup: String,
        /// In how many windows each channel is sound.
        channels: String,
        /// All windows.
        windows: usize,
        /// Points of a window.
        segment: usize,
        /// What was found in the recording.
        found: Vec<String>,
    },
}

/// What was found in the recordings, after an error that it may explain.
pub(crate) fn may_be_why(warnings: &[String]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    format!(". What was found in the recordings may be why:\n- {}", warnings.join("\n- "))
}
