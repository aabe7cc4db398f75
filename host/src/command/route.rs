//! Options of commands that read recordings: through simulated nodes and their lines, or directly.

use std::ops::RangeInclusive;

use belfry_shared::message::Summary;
use clap::Args;

use crate::fleet::{FleetOptions, Pace};
use crate::link::memory::Faults;
use crate::measure::Route;

/// How spectra are made of recordings.
#[derive(Debug, Clone, Args)]
pub struct RouteArguments {
    /// Make spectra straight from the recording, without sensor nodes; long records get finer lines than nodes have
    #[arg(long)]
    pub direct: bool,
    /// Bits per component of the spectral lines that nodes send
    #[arg(long, value_name = "BITS", default_value_t = 10, value_parser = clap::value_parser!(u8).range(3..=16), conflicts_with = "direct")]
    pub bits: u8,
    /// Baud rate of the simulated serial lines
    #[arg(long, default_value_t = 115_200, value_parser = clap::value_parser!(u32).range(300..=10_000_000), conflicts_with = "direct")]
    pub baud: u32,
    /// Share of frames that the simulated lines damage, in percent
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = percent, conflicts_with = "direct")]
    pub damaged_frames: f64,
    /// Seed of the simulated nodes' clocks and of the damage
    #[arg(long, default_value_t = 1, conflicts_with = "direct")]
    pub seed: u64,
}

/// A number within a range.
pub(super) fn in_range(text: &str, range: RangeInclusive<f64>, expected: &str) -> Result<f64, String> {
    text.parse().ok().filter(|value| range.contains(value)).ok_or_else(|| format!("expected {expected}"))
}

pub(super) fn percent(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=50.0, "a number from 0 to 50")
}

impl RouteArguments {
    /// The route that is asked for.
    pub fn route(&self) -> Route {
        if self.direct {
            return Route::Direct;
        }
        Route::Nodes(FleetOptions {
            summary: Summary::Lines { bits: self.bits },
            baud: self.baud,
            faults: Faults::damaging(self.damaged_frames / 100.0),
            pace: Pace::Recording,
            seed: self.seed,
            has_keys: false,
        })
    }
}
