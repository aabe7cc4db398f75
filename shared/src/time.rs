//! Time on the wire: the host's clock, a node's clock, and the grid on which all nodes start their windows.
//!
//! A node's crystal is off by up to some 20 ppm (1.7 s a day). The host measures offset and drift by two-way exchanges
//! ([`crate::message::ClockRequest`]), tells the node ([`ClockModel`]), and the node converts its own time to the host's.

use core::time::Duration;

use serde::{Deserialize, Serialize};

use crate::division::{quotient, quotient_towards_zero};

/// Host time in microseconds since the host's epoch (the Unix epoch on a live host, the recording's epoch when a
/// recording is replayed).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HostTime(pub i64);

/// A node's own time in microseconds since it started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NodeTime(pub u64);

impl HostTime {
    /// The time so long after the epoch; the latest there is where that is longer than microseconds reach.
    pub fn since_epoch(elapsed: Duration) -> Self {
        Self(i64::try_from(elapsed.as_micros()).unwrap_or(i64::MAX))
    }
}

impl NodeTime {
    /// Microseconds from `earlier` to `self`; negative if `earlier` is in fact later.
    pub fn since(self, earlier: Self) -> i64 {
        self.0.wrapping_sub(earlier.0) as i64
    }

    /// This time moved by `microseconds`.
    pub fn offset(self, microseconds: i64) -> Self {
        Self(self.0.saturating_add_signed(microseconds))
    }
}

/// How a node's clock relates to the host's: host = `host` + (node - `node`) (1 + `drift_ppb` 1e-9).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClockModel {
    /// A moment on the node's clock.
    pub node: NodeTime,
    /// The same moment on the host's clock.
    pub host: HostTime,
    /// How much faster the host's clock runs than the node's, in parts per billion (10⁹).
    pub drift_ppb: i32,
}

impl ClockModel {
    /// The host's time at a moment on the node's clock.
    pub fn host_time(&self, node: NodeTime) -> HostTime {
        let elapsed = node.since(self.node);
        let drift = quotient_towards_zero(i128::from(elapsed) * i128::from(self.drift_ppb), 1_000_000_000);
        HostTime(self.host.0.saturating_add(elapsed).saturating_add(drift as i64))
    }
}

/// The grid of host time on which windows start: start of window `index` = `index` x hop, counted from the epoch.
///
/// The hop is half a segment, `segment / 2 x decimation` sampling periods.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowGrid {
    /// Raw sampling rate in µHz.
    pub sampling_rate_uhz: u64,
    /// Raw samples per hop.
    pub hop_samples: u64,
}

impl WindowGrid {
    /// Start of a window in host time.
    pub fn start(&self, index: u64) -> HostTime {
        let samples = u128::from(index) * u128::from(self.hop_samples);
        let periods = samples.saturating_mul(1_000_000_000_000).saturating_add(u128::from(self.sampling_rate_uhz / 2));
        let microseconds = quotient(periods, u128::from(self.sampling_rate_uhz));
        HostTime(i64::try_from(microseconds).unwrap_or(i64::MAX))
    }

    /// The first window that starts at `time` or later.
    pub fn first_at_or_after(&self, time: HostTime) -> u64 {
        let Ok(microseconds) = u128::try_from(time.0) else { return 0 };
        let hop = u128::from(self.hop_samples) * 1_000_000_000_000;
        let below = quotient(microseconds * u128::from(self.sampling_rate_uhz), hop);
        let below = u64::try_from(below).unwrap_or(u64::MAX);
        // Starts are rounded to a microsecond, so the quotient can be one short of a start that equals `time`.
        if self.start(below) < time { below.saturating_add(1) } else { below }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_clock_twenty_ppm_slow_is_1_7_seconds_behind_after_a_day() {
        let model = ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 20_000 };
        assert_eq!(model.host_time(NodeTime(86_400_000_000)), HostTime(86_400_000_000 + 1_728_000));
    }

    #[test]
    fn moments_before_the_reference_convert_too() {
        let model = ClockModel { node: NodeTime(1_000_000), host: HostTime(5_000_000), drift_ppb: -1_000_000 };
        assert_eq!(model.host_time(NodeTime(0)), HostTime(4_001_000));
    }

    proptest! {
        #[test]
        fn the_grid_finds_the_window_it_started(index in 0_u64..1_000_000_000, hop in 1_u64..1_000_000, rate in 1_000_000_u64..4_000_000_000) {
            let grid = WindowGrid { sampling_rate_uhz: rate, hop_samples: hop };
            let start = grid.start(index);
            let found = grid.first_at_or_after(start);
            prop_assert_eq!(grid.start(found), start);
            prop_assert!(found <= index);
        }

        #[test]
        fn nothing_panics(time: i64, rate: u64, hop: u64, index: u64, node: u64, reference: u64, drift: i32) {
            let grid = WindowGrid { sampling_rate_uhz: rate, hop_samples: hop };
            let _ = grid.start(index);
            let _ = grid.first_at_or_after(HostTime(time));
            let model = ClockModel { node: NodeTime(reference), host: HostTime(time), drift_ppb: drift };
            let _ = model.host_time(NodeTime(node));
        }
    }
}
