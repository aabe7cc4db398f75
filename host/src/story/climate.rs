//! Temperatures of two measurements, and frequencies brought to one of them.
//!
//! Frequencies fall where a structure gets warmer, often by more than damage lowers them. Where `belfry identify` has followed the modes of
//! a measurement with temperatures, it knows by how much; those modes are brought to the temperature of the other measurement.

use serde::{Deserialize, Serialize};

use crate::diagnose::Signals;
use crate::modes::{MeasuredMode, MeasuredModes};

/// Temperatures of two measurements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Climate {
    /// Mean temperature before, in degrees Celsius.
    pub before_degc: f64,
    /// And now.
    pub now_degc: f64,
    /// Numbers before of the modes whose frequencies were brought to the temperature of now.
    pub corrected_before: Vec<usize>,
    /// Numbers now of those that were brought to the temperature before.
    pub corrected_now: Vec<usize>,
}

/// What a file of modes knows of temperatures.
struct Known {
    mean_degc: f64,
    signals: Signals,
}

impl Known {
    /// `None` where the file states no temperatures.
    fn of(modes: &MeasuredModes) -> Option<Self> {
        #[derive(Deserialize)]
        struct File {
            trends: Option<Trends>,
        }
        #[derive(Deserialize)]
        struct Trends {
            intervals: Vec<Interval>,
        }
        #[derive(Deserialize)]
        struct Interval {
            temperature_degc: Option<f64>,
        }
        modes.file.extension().filter(|extension| *extension == "json")?;
        let text = std::fs::read_to_string(&modes.file).ok()?;
        let file: File = serde_json::from_str(&text).ok()?;
        let measured: Vec<f64> =
            file.trends?.intervals.iter().filter_map(|interval| interval.temperature_degc).collect();
        (!measured.is_empty()).then_some(())?;
        let mean_degc = measured.iter().sum::<f64>() / measured.len() as f64;
        Some(Self { mean_degc, signals: serde_json::from_str(&text).ok()? })
    }

    /// Brings modes to what they would be this much warmer; the numbers of those whose change with temperature is known.
    fn warm(&self, modes: &mut [MeasuredMode], by_kelvin: f64) -> Vec<usize> {
        let trends = self.signals.trends.iter().flat_map(|trends| &trends.modes);
        let mut corrected = Vec::new();
        for (trend, slope) in trends.filter_map(|trend| Some((trend, trend.percent_per_kelvin?))) {
            let Some(mode) = modes.iter_mut().find(|mode| mode.number == trend.number) else { continue };
            if let Some(std) =
                mode.frequency_std_hz.as_mut().filter(|_| slope.value.is_finite() && slope.std.is_finite())
            {
                *std = std.hypot(mode.frequency_hz * slope.std * by_kelvin / 100.0);
                mode.frequency_hz *= 1.0 + slope.value * by_kelvin / 100.0;
                corrected.push(mode.number);
            }
        }
        corrected
    }
}

/// Brings modes of two measurements to one temperature as far as that is known; `None` where one of them states none.
pub(super) fn at_one_temperature(before: &mut MeasuredModes, now: &mut MeasuredModes) -> Option<Climate> {
    let (known_before, known_now) = (Known::of(before)?, Known::of(now)?);
    let warmer = known_now.mean_degc - known_before.mean_degc;
    let corrected_before = known_before.warm(&mut before.modes, warmer);
    let corrected_now = if corrected_before.is_empty() { known_now.warm(&mut now.modes, -warmer) } else { Vec::new() };
    Some(Climate {
        before_degc: known_before.mean_degc,
        now_degc: known_now.mean_degc,
        corrected_before,
        corrected_now,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(folder: &std::path::Path, name: &str, degc: f64, slope: &str) -> MeasuredModes {
        let path = folder.join(name);
        let text = format!(
            "{{\"modes\": [{{\"number\": 1, \"frequency_hz\": 2.0, \"frequency_std_hz\": 0.001}}], \"trends\": {{\"intervals\": [{{\"temperature_degc\": {degc}}}, {{\"temperature_degc\": null}}], \"modes\": [{{\"number\": 1, \"percent_per_kelvin\": {slope}}}]}}}}"
        );
        std::fs::write(&path, text).unwrap();
        crate::modes::read(&path, &[]).unwrap()
    }

    /// 10 K warmer at -0.05 % a kelvin: 2 Hz before would have been 1.99 Hz.
    #[test]
    fn frequencies_are_brought_to_one_temperature_by_whichever_measurement_knows_how() {
        let folder = tempfile::tempdir().unwrap();
        let slope = "{\"value\": -0.05, \"std\": 0.01}";
        for (of_before, of_now, ratio) in [(slope, "null", 0.995), ("null", slope, 1.005)] {
            let mut before = file(folder.path(), "before.json", 5.0, of_before);
            let mut now = file(folder.path(), "now.json", 15.0, of_now);
            let climate = at_one_temperature(&mut before, &mut now).unwrap();
            assert_eq!((climate.before_degc, climate.now_degc), (5.0, 15.0));
            let (mode, other) = match of_now {
                "null" => (&before.modes[0], &now.modes[0]),
                _ => (&now.modes[0], &before.modes[0]),
            };
            assert!((mode.frequency_hz - 2.0 * ratio).abs() < 1e-12 && other.frequency_hz == 2.0);
            // The slope's deviation, 0.1 % here, adds to that of the mode.
            assert!((mode.frequency_std_hz.unwrap() - 0.001f64.hypot(0.002)).abs() < 1e-12);
        }
        // A file of another tool knows none.
        let path = folder.path().join("modes.csv");
        std::fs::write(&path, "mode,frequency_hz\n1,2.0\n").unwrap();
        let mut csv = crate::modes::read(&path, &[]).unwrap();
        let mut now = file(folder.path(), "now.json", 15.0, slope);
        assert_eq!(at_one_temperature(&mut csv, &mut now), None);
    }
}
