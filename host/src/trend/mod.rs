//! Trends: how modes change over the hours of a record, and with what.
//!
//! A study and the modes of its whole record flow in; the same modes for each interval flow out, with the response level
//! and the temperature of that interval, and for each mode whether it changes at all and what with.

mod link;
mod temperature;

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use thiserror::Error;

pub use crate::regression::Slope;
pub use temperature::{TemperatureError, Temperatures};

use crate::identify::{Identification, MeasuredSetup, Mode};
use crate::measure::{Interval, Intervals, MeasureError, Progress, Route, measure_intervals};
use crate::regression::slopes;
use crate::spectra::LineGrid;
use crate::study::{Analysis, Study};
use crate::watch::{SeenInterval, SeenMode};
use link::Follower;

/// Why there is no trend.
#[derive(Debug, Error)]
pub enum TrendError {
    /// The recording cannot be measured in intervals.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The temperatures cannot be read.
    #[error(transparent)]
    Temperature(#[from] TemperatureError),
    /// The record has no whole interval.
    #[error("the record holds no interval of {every_s} s")]
    NoInterval {
        /// The interval.
        every_s: f64,
    },
    /// Modes of several setups look different in each.
    #[error("this study has {setups} setups; modes are watched in one, whose sensors stay where they are")]
    Setups {
        /// How many there are.
        setups: usize,
    },
    /// There are no modes to follow.
    #[error("no mode was found in the whole record, so there is nothing to follow")]
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
    /// Groups of the jackknife that the deviations come from.
    #[serde(skip)]
    pub groups: usize,
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
    /// Whether its frequency changes, by that probability: the same in the table, in the picture and on the page; `None` with one interval.
    pub changes: Option<bool>,
    /// Change of frequency with temperature in percent a kelvin (what goes with the level taken off).
    pub percent_per_kelvin: Option<Slope>,
    /// Change of frequency in percent for a tenfold response (what goes with temperature taken off).
    pub percent_per_decade: Option<Slope>,
}

/// Below this probability of chance, a mode is said to change.
pub const CHANGES: f64 = 1e-3;

/// Follows the modes of the whole record through all setups of a study in intervals of `every_s`; `grid` is that of the whole record, whose band
/// is kept.
///
/// # Errors
/// When there are no modes, intervals are too short, or recordings or temperatures cannot be read.
pub fn follow(
    study: &Study,
    whole: &Identification,
    grid: &LineGrid,
    every_s: f64,
    route: Route,
    progress: Progress<'_>,
) -> Result<Trend, TrendError> {
    let modes = &whole.modes;
    if modes.is_empty() {
        return Err(TrendError::NoModes);
    }
    // The same band; segments are chosen anew, as an interval has room for shorter ones only.
    let band_hz = [grid.frequency_hz(0), grid.frequency_hz(grid.lines.saturating_sub(1))];
    let analysis = Analysis { band_hz: Some(band_hz), segment: None, ..study.analysis.clone() };
    let read = |setup| Temperatures::of_setup(setup, &study.folder);
    let found = study.setups.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let (mut intervals, mut failure) = (Vec::new(), None);
    let mut warnings: Vec<String> = found.iter().flatten().filter_map(|(_, node)| node.map(of_node)).collect();
    let temperatures: Vec<_> = found.into_iter().map(|found| found.map(|(table, _)| table)).collect();
    // Of several setups none has all points, and the same mode would begin anew in each.
    let mut follower = Follower::new(whole, &study.analysis.modes, study.setups.len() == 1);
    for (setup, temperatures) in study.setups.iter().zip(&temperatures) {
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
                    groups: spectrum.group_count(),
                    temperature_degc: temperatures
                        .as_ref()
                        .and_then(|table| table.mean_degc(interval.origin_s + start_s, interval.origin_s + end_s)),
                    modes: follower.take(MeasuredSetup { setup, spectrum }),
                }),
                Err(error) => warnings.push(format!("{place}: left out: {error}")),
            }
        };
        // As for the whole record: one setup that fails among others is left out.
        let every = Intervals { every_s, from_s: None };
        if let Err(error) = measure_intervals(study, setup, &analysis, every, route, progress, take) {
            warnings.push(format!("setup \"{}\" is left out of the trends: {error}", setup.name));
            failure.get_or_insert(error);
        }
    }
    if intervals.is_empty() {
        return Err(failure.map_or(TrendError::NoInterval { every_s }, TrendError::Measure));
    }
    let without = intervals.iter().filter(|interval| interval.temperature_degc.is_none()).count();
    if without > 0 && without < intervals.len() {
        warnings.push(format!(
            "{without} of {} intervals have no temperature and are left out of what goes with it",
            intervals.len()
        ));
    }
    if study.setups.iter().any(|setup| setup.temperature.is_some())
        && intervals.iter().all(|interval| interval.temperature_degc.is_none())
    {
        warnings
            .push("no temperature lies within the recording's time: is time_s counted from its first row (in Unix time for a live setup)?".to_owned());
    }
    let new = follower.lasting(intervals.iter().map(|interval| interval.modes.as_slice()));
    for interval in &mut intervals {
        interval.modes.retain(|seen| modes.iter().chain(&new).any(|mode| mode.number == seen.number));
    }
    if !new.is_empty() {
        warnings.push(not_in_whole_record(&new));
    }
    let modes = modes.iter().chain(&new).map(|mode| mode_trend(mode, &intervals)).collect();
    Ok(Trend { every_s, modes, intervals, warnings })
}

/// The intervals of a study's one setup in which the modes of `reference` are looked for, those that were last seen at `last_hz` near there; and what
/// the reader should know. An interval of what nodes have sent that may still go on is left out, but where the study's range ends with it.
///
/// # Errors
/// As [`follow`], and where there are several setups: the same modes look different in each.
pub fn seen(
    study: &Study,
    reference: &Identification,
    last_hz: &[(usize, f64)],
    every: Intervals,
    route: Route,
    progress: Progress<'_>,
) -> Result<(Vec<SeenInterval>, Vec<String>), TrendError> {
    let [setup] = &study.setups[..] else { return Err(TrendError::Setups { setups: study.setups.len() }) };
    if reference.modes.is_empty() {
        return Err(TrendError::NoModes);
    }
    let (temperatures, node) = Temperatures::of_setup(setup, &study.folder)?.unzip();
    let mut follower = Follower::new(reference, &study.analysis.modes, false).last_seen(last_hz);
    let analysis = Analysis { segment: None, ..study.analysis.clone() };
    let mut intervals = Vec::new();
    let mut warnings: Vec<String> = node.flatten().into_iter().map(of_node).collect();
    let take = |interval: Interval| {
        let [start_s, end_s] = [interval.start_s, interval.end_s].map(|time_s| interval.origin_s + time_s);
        if setup.live && !interval.is_over && study.range.to_us.is_none() {
            return;
        }
        match interval.spectrum {
            Ok(spectrum) => {
                let of = |mode: IntervalMode| SeenMode {
                    number: mode.number,
                    frequency_hz: mode.frequency_hz,
                    frequency_std_hz: mode.frequency_std_hz,
                    response_rms: mode.response_rms,
                };
                let modes = follower.take(MeasuredSetup { setup, spectrum }).into_iter().map(of).collect();
                let temperature_degc = temperatures.as_ref().and_then(|table| table.mean_degc(start_s, end_s));
                intervals.push(SeenInterval { start_s, end_s, temperature_degc, modes });
            }
            Err(error) => warnings.push(format!("{start_s:.0} to {end_s:.0} s: left out: {error}")),
        }
    };
    measure_intervals(study, setup, &analysis, every, route, progress, take)?;
    Ok((intervals, warnings))
}

/// Says whose temperatures there are, where study.toml names no table.
fn of_node(node: u16) -> String {
    format!(
        "temperatures are those of node {node}'s sensor, as study.toml names no `temperature`: some kelvins above the air's, which no slope minds"
    )
}

/// Says which modes the intervals show alone.
fn not_in_whole_record(new: &[Mode]) -> String {
    let each: Vec<String> = new.iter().map(|mode| format!("{} ({:.4} Hz)", mode.number, mode.frequency_hz)).collect();
    format!(
        "the intervals show modes that the whole record does not: {}; where frequencies drift, the whole record smears them, and its modes are averages",
        each.join(", ")
    )
}

fn mode_trend(mode: &Mode, intervals: &[TrendInterval]) -> ModeTrend {
    let seen: Vec<(&TrendInterval, &IntervalMode)> = intervals
        .iter()
        .filter_map(|interval| Some((interval, interval.modes.iter().find(|seen| seen.number == mode.number)?)))
        .filter(|(_, seen)| seen.frequency_std_hz.is_finite() && seen.frequency_std_hz > 0.0)
        .collect();
    let frequencies = || seen.iter().map(|(_, seen)| seen.frequency_hz);
    let [percent_per_kelvin, percent_per_decade] = dependences(&seen);
    let p_value_of_no_change = p_value_of_no_change(&seen);
    ModeTrend {
        number: mode.number,
        intervals: seen.len(),
        frequency_hz: if seen.is_empty() { mode.frequency_hz } else { Mean::of(&seen).hz },
        lowest_hz: frequencies().reduce(f64::min).unwrap_or(mode.frequency_hz),
        highest_hz: frequencies().reduce(f64::max).unwrap_or(mode.frequency_hz),
        p_value_of_no_change,
        changes: p_value_of_no_change.map(|p_value| p_value < CHANGES),
        percent_per_kelvin,
        percent_per_decade,
    }
}

/// A mode's mean frequency over intervals, by inverse variance.
struct Mean {
    hz: f64,
    weights: Vec<f64>,
    /// Sum of the weights.
    total: f64,
}

impl Mean {
    fn of(seen: &[(&TrendInterval, &IntervalMode)]) -> Self {
        let weights: Vec<f64> = seen.iter().map(|(_, mode)| mode.frequency_std_hz.powi(-2)).collect();
        let total: f64 = weights.iter().sum();
        let hz = seen.iter().zip(&weights).map(|((_, mode), weight)| weight * mode.frequency_hz).sum::<f64>() / total;
        Self { hz, weights, total }
    }
}

/// Welch's test (1951, eq. 14 ff.) of several means whose deviations are themselves estimates: their own degrees of freedom
/// are the groups of the jackknife less one. `None` with one interval.
fn p_value_of_no_change(seen: &[(&TrendInterval, &IntervalMode)]) -> Option<f64> {
    let count = seen.len() as f64;
    if seen.len() < 2 {
        return None;
    }
    let Mean { hz: mean_hz, weights, total } = Mean::of(seen);
    let between =
        seen.iter().zip(&weights).map(|((_, mode), w)| w * (mode.frequency_hz - mean_hz).powi(2)).sum::<f64>();
    let lambda: f64 = seen
        .iter()
        .zip(&weights)
        .map(|((interval, _), weight)| (1.0 - weight / total).powi(2) / interval.groups.saturating_sub(1).max(1) as f64)
        .sum();
    let squares = count * count - 1.0;
    let statistic = between / (count - 1.0) / (1.0 + 2.0 * (count - 2.0) / squares * lambda);
    let distribution = FisherSnedecor::new(count - 1.0, squares / (3.0 * lambda)).ok()?;
    Some(distribution.sf(statistic.max(0.0)))
}

/// Standard deviation of the level's logarithm over the intervals, in decades, from which on its effect is asked for: a sixth more or less.
const LEAST_SPREAD: f64 = 0.07;

/// Change with temperature and with the level, if that varies: together over the intervals that have a temperature, where both vary by
/// themselves, else with the level alone. Of several setups the one with the most intervals is used: in another the level is
/// that of other sensors.
fn dependences(seen: &[(&TrendInterval, &IntervalMode)]) -> [Option<Slope>; 2] {
    let count = |setup: &str| seen.iter().filter(|(interval, _)| interval.setup == setup).count();
    let setup = seen.iter().map(|(interval, _)| interval.setup.as_str()).max_by_key(|setup| count(setup));
    let of_setup: Vec<_> = seen.iter().filter(|(interval, _)| Some(interval.setup.as_str()) == setup).collect();
    let percent = |slope: Slope| Slope { value: 100.0 * slope.value, std: 100.0 * slope.std };
    let fit = |chosen: &[&&(&TrendInterval, &IntervalMode)], with_temperature: bool| -> Option<[Option<Slope>; 2]> {
        let column =
            |of: fn(&(&TrendInterval, &IntervalMode)) -> f64| chosen.iter().map(|seen| of(seen)).collect::<Vec<f64>>();
        let y = column(|(_, mode)| mode.frequency_hz.ln());
        let std = column(|(_, mode)| mode.frequency_std_hz / mode.frequency_hz);
        let level = column(|(_, mode)| mode.response_rms.max(f64::MIN_POSITIVE).log10());
        let temperature = column(|(interval, _)| interval.temperature_degc.unwrap_or(f64::NAN));
        // With a level that hardly varies everything would change that drifts.
        let with_level = spread(&level) > LEAST_SPREAD;
        let regressors = [(temperature, with_temperature), (level, with_level)];
        let regressors: Vec<Vec<f64>> =
            regressors.into_iter().filter(|(_, is_wanted)| *is_wanted).map(|(values, _)| values).collect();
        let mut found = slopes(&y, &std, &regressors)?.into_iter().map(percent);
        Some([with_temperature, with_level].map(|is_wanted| if is_wanted { found.next() } else { None }))
    };
    let all: Vec<&&(&TrendInterval, &IntervalMode)> = of_setup.iter().collect();
    let with_temperature: Vec<_> =
        all.iter().copied().filter(|(interval, _)| interval.temperature_degc.is_some()).collect();
    fit(&with_temperature, true).or_else(|| fit(&all, false)).unwrap_or_default()
}

/// Standard deviation of some numbers; 0 of none.
fn spread(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests;
