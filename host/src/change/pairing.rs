//! Which mode of one measurement is which of another.

use crate::assignment::{assigned, likeness};
use crate::compare::mac;
use crate::modes::{MeasuredMode, MeasuredShape};

/// Frequencies of a mode may have changed by about this (standard deviation of their logarithm): a structure that has lost more than a
/// fifth of its stiffness is another one.
const LIKENESS: f64 = 0.1;
/// Least likeness of a pair.
const LEAST_LIKENESS: f64 = 0.2;
/// What the shape counts for where one of the measurements has none.
const UNKNOWN_SHAPE: f64 = 0.5;

/// Pairs of modes (indices, before and now) whose `MAC exp(-(ln f ratio)²/(2 LIKENESS²))` has the largest sum, in the order of now's.
pub(super) fn pairs(before: &[MeasuredMode], now: &[MeasuredMode]) -> Vec<(usize, usize)> {
    let alike = |row: usize, column: usize| {
        let (one, other) = (&now[row], &before[column]);
        let shape = mac_of(one, other).unwrap_or(UNKNOWN_SHAPE);
        likeness(shape, one.frequency_hz / other.frequency_hz, LIKENESS, LEAST_LIKENESS)
    };
    assigned(now.len(), before.len(), &alike).into_iter().map(|(now, before)| (before, now)).collect()
}

/// MAC of two measured shapes at the sensors that both have; `None` where these are fewer than two.
pub(super) fn mac_of(one: &MeasuredMode, other: &MeasuredMode) -> Option<f64> {
    let (one, other) = (one.shape.as_ref()?, other.shape.as_ref()?);
    let has = |shape: &MeasuredShape, sensor: &usize| shape.sensors.contains(sensor);
    let common: Vec<usize> = one.sensors.iter().copied().filter(|sensor| has(other, sensor)).collect();
    if common.len() < 2 {
        return None;
    }
    let highest = common.iter().copied().max().unwrap_or(0);
    let mut along = vec![0.0; highest + 1];
    for (&sensor, &value) in other.sensors.iter().zip(other.values.iter()) {
        if has(one, &sensor) {
            along[sensor] = value;
        }
    }
    let rows: Vec<usize> = (0..one.sensors.len()).filter(|&row| has(other, &one.sensors[row])).collect();
    let seen = MeasuredShape { sensors: common, values: one.values.select_rows(&rows), imaginary: None, stds: None };
    Some(mac(&along, &seen))
}
