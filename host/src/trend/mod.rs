//! Trends: how modes change over the hours of a record, and with what.
//!
//! A study and the modes of its whole record flow in; the same modes for each interval flow out, with the response level
//! and the temperature of that interval, and for each mode whether it changes at all and what with.

mod regression;
mod temperature;

use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};
use thiserror::Error;

pub use regression::Slope;
pub use temperature::{TemperatureError, Temperatures};

use crate::identify::track::{Tracked, track};
use crate::identify::{MeasuredSetup, Mode};
use crate::measure::{Interval, MeasureError, Progress, Route, measure_intervals};
use crate::spectra::LineGrid;
use crate::study::{Analysis, Study};
use regression::slopes;

/// Averages an interval needs: its jackknife has as many groups at most, and twelve are the fewest to trust.
const LEAST_AVERAGES: usize = 12;

/// Why there is no trend.
#[derive(Debug, Error)]
pub enum TrendError {
    /// The recording cannot be measured in intervals.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The temperatures cannot be read.
    #[error(transparent)]
    Temperature(#[from] TemperatureError),
    /// An interval has too few averages.
    #[error(
        "an interval of {every_s} s gives {averages} averages, and fewer than {LEAST_AVERAGES} do not say how sure they are; take intervals of {needed_s:.0} s at least"
    )]
    TooShort {
        /// The interval.
        every_s: f64,
        /// Its averages.
        averages: usize,
        /// What would do.
        needed_s: f64,
    },
    /// There are no modes to follow.
    #[error("no mode was found in the whole record, so there is none to follow")]
    NoModes,
}

/// Modes over the intervals of a study's recordings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trend {
    /// Length of an interval in s.
    pub every_s: f64,
    /// Each mode over all intervals.
    pub modes: Vec<ModeTrend>,
    /// The intervals, in the order of time, setup after setup.
    pub intervals: Vec<TrendInterval>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// One interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrendInterval {
    /// The setup.
    pub setup: String,
    /// Start and end after the recording's first row, in s.
    pub start_s: f64,
    /// End, in s.
    pub end_s: f64,
    /// Segments averaged.
    pub averages: usize,
    /// Mean temperature in degrees Celsius, where the study has one.
    pub temperature_degc: Option<f64>,
    /// The modes that the interval shows.
    pub modes: Vec<IntervalMode>,
}

/// A mode in an interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalMode {
    /// The mode's number in the whole record.
    pub number: usize,
    /// Natural frequency in Hz.
    pub frequency_hz: f64,
    /// Its standard deviation.
    pub frequency_std_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Its standard deviation.
    pub damping_ratio_std: f64,
    /// MAC with the shape of the whole record.
    pub mac: f64,
    /// Root mean square of the mode's own response where it moves most, in m/s² (m/s where velocity was recorded).
    pub response_rms: f64,
}

/// A mode over all intervals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeTrend {
    /// The mode's number.
    pub number: usize,
    /// Intervals that show it.
    pub intervals: usize,
    /// Mean frequency in Hz, by inverse variance.
    pub frequency_hz: f64,
    /// Lowest and highest in Hz.
    pub lowest_hz: f64,
    /// Highest, in Hz.
    pub highest_hz: f64,
    /// Probability of as much scatter as this, were the frequency always the same; `None` with one interval.
    pub p_value_of_no_change: Option<f64>,
    /// Change of frequency with temperature in percent a kelvin (what goes with the level taken off).
    pub percent_per_kelvin: Option<Slope>,
    /// Change of frequency in percent for a tenfold response (what goes with temperature taken off).
    pub percent_per_decade: Option<Slope>,
}

/// Follows `modes` through all setups of a study in intervals of `every_s`; `grid` is that of the whole record, whose band
/// is kept.
///
/// # Errors
/// When there are no modes, intervals are too short, or recordings or temperatures cannot be read.
pub fn follow(
    study: &Study,
    modes: &[Mode],
    grid: &LineGrid,
    every_s: f64,
    route: Route,
    progress: Progress<'_>,
) -> Result<Trend, TrendError> {
    if modes.is_empty() {
        return Err(TrendError::NoModes);
    }
    // The same band; segments are chosen anew, as an interval has room for shorter ones only.
    let band_hz = [grid.frequency_hz(0), grid.frequency_hz(grid.lines.saturating_sub(1))];
    let analysis = Analysis { band_hz: Some(band_hz), segment: None, ..study.analysis.clone() };
    let (mut intervals, mut warnings) = (Vec::new(), Vec::new());
    for setup in &study.setups {
        let temperatures =
            setup.temperature.as_ref().map(|file| Temperatures::read(&study.folder.join(file))).transpose()?;
        let take = |interval: Interval| {
            let (start_s, end_s) = (interval.start_s, interval.end_s);
            let place = format!("setup \"{}\", {start_s:.0} to {end_s:.0} s", setup.name);
            warnings.extend(interval.warnings.iter().map(|warning| format!("{place}: {warning}")));
            match interval.spectrum {
                Ok(spectrum) => intervals.push(TrendInterval {
                    setup: setup.name.clone(),
                    start_s,
                    end_s,
                    averages: spectrum.averages(),
                    temperature_degc: temperatures.as_ref().and_then(|table| table.mean_degc(start_s, end_s)),
                    modes: tracked(&MeasuredSetup { setup, spectrum }, modes),
                }),
                Err(error) => warnings.push(format!("{place}: left out: {error}")),
            }
        };
        let plan = measure_intervals(study, setup, &analysis, every_s, route, progress, take)?;
        let averages = plan.windows.first().copied().unwrap_or(0);
        if averages < LEAST_AVERAGES {
            let needed_s = (LEAST_AVERAGES + 2) as f64 * 0.5 / plan.grid.spacing_hz();
            return Err(TrendError::TooShort { every_s, averages, needed_s });
        }
    }
    if study.setups.iter().any(|setup| setup.temperature.is_some())
        && intervals.iter().all(|interval| interval.temperature_degc.is_none())
    {
        warnings
            .push("no temperature lies within the recording's time: is time_s counted from its first row?".to_owned());
    }
    let modes = modes.iter().map(|mode| mode_trend(mode, &intervals)).collect();
    Ok(Trend { every_s, modes, intervals, warnings })
}

/// The modes that an interval shows, if it has averages enough.
fn tracked(measured: &MeasuredSetup<'_>, modes: &[Mode]) -> Vec<IntervalMode> {
    if measured.spectrum.averages() < LEAST_AVERAGES {
        return Vec::new();
    }
    let of = |(mode, tracked): (&Mode, Option<Tracked>)| {
        let Tracked { frequency_hz, frequency_std_hz, damping_ratio, damping_ratio_std, mac, level } = tracked?;
        let number = mode.number;
        Some(IntervalMode {
            number,
            frequency_hz,
            frequency_std_hz,
            damping_ratio,
            damping_ratio_std,
            mac,
            response_rms: level,
        })
    };
    modes.iter().zip(track(measured, modes)).filter_map(of).collect()
}

fn mode_trend(mode: &Mode, intervals: &[TrendInterval]) -> ModeTrend {
    let seen: Vec<(&TrendInterval, &IntervalMode)> = intervals
        .iter()
        .filter_map(|interval| Some((interval, interval.modes.iter().find(|seen| seen.number == mode.number)?)))
        .filter(|(_, seen)| seen.frequency_std_hz.is_finite() && seen.frequency_std_hz > 0.0)
        .collect();
    let weight = |seen: &IntervalMode| seen.frequency_std_hz.powi(-2);
    let weights: f64 = seen.iter().map(|(_, seen)| weight(seen)).sum();
    let mean_hz = seen.iter().map(|(_, seen)| weight(seen) * seen.frequency_hz).sum::<f64>() / weights;
    let chi_squared: f64 = seen.iter().map(|(_, seen)| weight(seen) * (seen.frequency_hz - mean_hz).powi(2)).sum();
    let freedom = seen.len().saturating_sub(1);
    let distribution = (freedom > 0).then(|| ChiSquared::new(freedom as f64).ok()).flatten();
    let frequencies = || seen.iter().map(|(_, seen)| seen.frequency_hz);
    let [percent_per_kelvin, percent_per_decade] = dependences(&seen);
    ModeTrend {
        number: mode.number,
        intervals: seen.len(),
        frequency_hz: if seen.is_empty() { mode.frequency_hz } else { mean_hz },
        lowest_hz: frequencies().fold(f64::INFINITY, f64::min).min(mode.frequency_hz),
        highest_hz: frequencies().fold(0.0, f64::max).max(mode.frequency_hz),
        p_value_of_no_change: distribution.map(|chi| chi.sf(chi_squared)),
        percent_per_kelvin,
        percent_per_decade,
    }
}

/// Change with temperature and with the level: together where the study has temperatures for all intervals and both vary by
/// themselves, else with the level alone.
fn dependences(seen: &[(&TrendInterval, &IntervalMode)]) -> [Option<Slope>; 2] {
    let y: Vec<f64> = seen.iter().map(|(_, seen)| seen.frequency_hz.ln()).collect();
    let std: Vec<f64> = seen.iter().map(|(_, seen)| seen.frequency_std_hz / seen.frequency_hz).collect();
    let level: Vec<f64> = seen.iter().map(|(_, seen)| seen.response_rms.max(f64::MIN_POSITIVE).log10()).collect();
    let percent = |slope: Slope| Slope { value: 100.0 * slope.value, std: 100.0 * slope.std };
    let temperature: Option<Vec<f64>> = seen.iter().map(|(interval, _)| interval.temperature_degc).collect();
    if let Some(temperature) = temperature
        && let Some(found) = slopes(&y, &std, &[temperature, level.clone()])
    {
        return [Some(percent(found[0])), Some(percent(found[1]))];
    }
    [None, slopes(&y, &std, &[level]).map(|found| percent(found[0]))]
}

#[cfg(test)]
mod tests;
