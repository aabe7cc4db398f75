//! Two measurements of one structure: which of its modes have changed, and how surely.
//!
//! The modes of both flow in; pairs, their differences with the deviations of both, a test whether anything has changed, and modes
//! that only one of the measurements has flow out. No model takes part; [`crate::diagnose`] says with one what has changed, and where.
//!
//! The errors of two measurements are independent, so their covariances add up. `pairing` says which mode is which, `difference`
//! makes numbers of a pair, `report` is what is printed and stored.

mod difference;
mod pairing;
mod report;
#[cfg(test)]
mod tests;

use crate::modes::MeasuredMode;
use crate::statistics::groups;
pub(crate) use difference::Difference;
use difference::is_close;
use pairing::pairs;
pub use report::{Changes, LonelyMode, ModeChange, Test};

/// The differences of modes that both measurements have, in the order of those of now.
pub(crate) fn differences(before: &[MeasuredMode], now: &[MeasuredMode]) -> Vec<Difference> {
    let pairs = pairs(before, now);
    let close = groups(pairs.len(), &|a, b| is_close(before, now, pairs[a], pairs[b]));
    let together = |group: &Vec<usize>| group.iter().map(|&member| pairs[member]).collect::<Vec<_>>();
    pairs.iter().zip(&close).map(|(pair, group)| Difference::of(before, now, *pair, &together(group))).collect()
}

/// What has changed between two measurements.
pub fn changes(before: &[MeasuredMode], now: &[MeasuredMode]) -> Changes {
    Changes::of(before, now, &differences(before, now))
}
