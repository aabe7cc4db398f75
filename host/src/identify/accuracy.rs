//! How long a record must be for a given accuracy.
//!
//! Deviations fall with the square root of the record's length, which is all that the answer rests on: the record at hand
//! shows what this structure and these sensors give in its length; Au's law (2014) is the lower bound of any method.

use serde::Serialize;

use super::result::{Identification, Mode};

/// The lower bounds of the standard deviations of frequency (Hz) and damping ratio on a record (Au 2014): coefficients of variation
/// sqrt(zeta / (2 pi N)) and 1 / sqrt(2 pi zeta N), N cycles in the record.
pub(crate) fn std_bounds(frequency_hz: f64, damping_ratio: f64, duration_s: f64) -> [f64; 2] {
    let cycles = frequency_hz * duration_s;
    [
        frequency_hz * (damping_ratio / (std::f64::consts::TAU * cycles)).sqrt(),
        damping_ratio / (std::f64::consts::TAU * damping_ratio * cycles).sqrt(),
    ]
}

/// A damping ratio is determined where its standard deviation is below this share of it.
const DETERMINED: f64 = 0.5;

/// Standard deviations to reach, relative to frequency and damping ratio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wish {
    /// Standard deviation over frequency.
    pub frequency: Option<f64>,
    /// Standard deviation over damping ratio.
    pub damping: Option<f64>,
}

impl Default for Wish {
    /// Damping within a tenth.
    fn default() -> Self {
        Self { frequency: None, damping: Some(0.1) }
    }
}

/// The record that a mode needs to reach them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordNeeded {
    /// The mode's number.
    pub mode: usize,
    /// Hours of record to reach the frequency's, as this record went; `None` where its deviation is not known or none is asked for.
    pub frequency_h: Option<f64>,
    /// The fewest hours that any method needs for it (Au 2014).
    pub frequency_best_h: Option<f64>,
    /// The same of the damping ratio; `None` as well where its deviation is half of it or more.
    pub damping_h: Option<f64>,
    /// The fewest hours for the damping ratio.
    pub damping_best_h: Option<f64>,
}

/// The record that each mode needs to reach these deviations.
pub fn record_needed(found: &Identification, wish: Wish) -> Vec<RecordNeeded> {
    let needed = |wish: Option<f64>, value: f64, std: f64| -> Option<f64> {
        let hours = found.record_s / 3600.0 * (std / value / wish?).powi(2);
        hours.is_finite().then_some(hours)
    };
    // Of a damping ratio that is nearly as uncertain as it is large, no record's length can be told.
    let is_determined = |mode: &Mode| mode.damping_ratio_std < DETERMINED * mode.damping_ratio;
    // A deviation is an estimate itself; where chance made it less than any method could have, the bound says more.
    let of = |mode: &Mode| RecordNeeded {
        mode: mode.number,
        frequency_h: needed(wish.frequency, mode.frequency_hz, mode.frequency_std_hz.max(mode.frequency_std_bound_hz)),
        frequency_best_h: needed(wish.frequency, mode.frequency_hz, mode.frequency_std_bound_hz),
        damping_h: needed(wish.damping, mode.damping_ratio, mode.damping_ratio_std.max(mode.damping_ratio_std_bound))
            .filter(|_| is_determined(mode)),
        damping_best_h: needed(wish.damping, mode.damping_ratio, mode.damping_ratio_std_bound),
    };
    found.modes.iter().map(of).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::identify::ModeMethod;
    use crate::identify::fit::Basis;

    /// One mode of an hour.
    pub(crate) fn found() -> Identification {
        // The tower's first mode after an hour (methods: 0.22 % on f, 22 % on damping by Au's law).
        let (frequency_hz, damping_ratio) = (0.094, 0.01);
        let cycles = frequency_hz * 3600.0;
        let mode = Mode {
            number: 1,
            frequency_hz,
            frequency_std_hz: 0.0044 * frequency_hz,
            damping_ratio,
            damping_ratio_std: f64::INFINITY,
            frequency_std_bound_hz: frequency_hz * (damping_ratio / (std::f64::consts::TAU * cycles)).sqrt(),
            damping_ratio_std_bound: damping_ratio / (std::f64::consts::TAU * damping_ratio * cycles).sqrt(),
            shape: Vec::new(),
            phase_collinearity: 1.0,
            phase_collinearity_as_measured: 1.0,
            lines_in_bandwidth: 0.2,
            misfit: None,
            fitted: Vec::new(),
            method: ModeMethod::Spectra,
            band_hz: None,
            asked_hz: None,
            pair_with: None,
            second_opinion: None,
            covariance_factor: None,
            pick: None,
        };
        Identification {
            modes: vec![mode],
            averages: 80,
            record_s: 3600.0,
            frequency_resolution_hz: 0.01,
            harmonics: Vec::new(),
            rejected: Vec::new(),
            warnings: Vec::new(),
            other_poles: Vec::new(),
            stabilisation: Vec::new(),
            singular_values: Vec::new(),
            basis: Basis::default(),
        }
    }

    #[test]
    fn a_tenth_of_the_deviation_takes_a_hundred_times_the_record() {
        let needed = record_needed(&found(), Wish { frequency: Some(0.00044), damping: Some(0.044) });
        assert!((needed[0].frequency_h.unwrap() - 100.0).abs() < 1e-9);
        // 22 % after an hour are 4.4 % after a day.
        assert!((needed[0].damping_best_h.unwrap() / 24.0 - 1.0).abs() < 0.06, "{needed:?}");
        assert_eq!(needed[0].damping_h, None, "a deviation that is not known says nothing");
        assert_eq!(record_needed(&found(), Wish { frequency: None, damping: None })[0].frequency_best_h, None);
    }
}
