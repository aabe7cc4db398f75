//! Modes over the hours: every mode's frequency with its deviation, beside temperature and response level.

use plotters::prelude::*;

use super::canvas::{Area, Dashes, DrawResult, MEASURED, PictureError, REJECTED, axis_digits, fixed, prefixed};
use super::over_time::{self, stacked};
use super::units::motion_unit;
use crate::colour;
use crate::study::Setup;
use crate::trend::{IntervalMode, Trend, TrendInterval};

const PANEL: u32 = 104;
/// Bars reach so many standard deviations to either side: about 95 %.
const BAR: f64 = 2.0;
/// A response that varies by more than this is drawn on a logarithmic scale.
const LINEAR: f64 = 10.0;

/// Points further apart than so many intervals are not joined: what lies between was not measured.
const GAP: f64 = 1.5;
const TEMPERATURE: RGBColor = colour::SERIES[1].on_paper();

/// A point of a panel: time in hours, value, and its standard deviation.
type Point = (f64, f64, f64);

/// A panel's points.
struct Panel {
    name: String,
    points: Vec<Point>,
    color: RGBColor,
    /// Whether values are logarithms to base 10 of what the axis names.
    is_log: bool,
}

/// Draws a panel a mode, below one for the temperature (where there is one) and one for the response level; of the setup with
/// the most intervals where there are several. `None` where no interval shows a mode.
///
/// # Errors
/// When drawing fails.
pub fn trends(structure: &str, setups: &[Setup], trend: &Trend) -> Result<Option<String>, PictureError> {
    let intervals = longest(&trend.intervals);
    let shown = |setup: &&Setup| intervals.first().is_some_and(|one| one.setup == setup.name);
    let panels = panels(trend, &intervals, &motion_unit(setups.iter().filter(shown)));
    if panels.is_empty() {
        return Ok(None);
    }
    let hours = intervals.iter().map(|interval| interval.end_s / 3600.0).fold(0.0, f64::max);
    let every = humantime::format_duration(duration(trend.every_s));
    let of_setup = match intervals.first() {
        Some(one) if intervals.len() < trend.intervals.len() => format!(", {}", one.setup),
        _ => String::new(),
    };
    let title = format!("{structure}: modes over time, every {every}{of_setup}");
    let words = "Dots: one interval each. Bars: two standard deviations to either side, which is about 95 %.";
    stacked("the trends", [&title, words], (panels.len(), PANEL), |index, area, is_last| {
        draw(area, &panels[index], hours, trend.every_s / 3600.0, is_last)
    })
    .map(Some)
}

fn duration(seconds: f64) -> std::time::Duration {
    std::time::Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

/// The intervals of the setup that has most of them.
fn longest(intervals: &[TrendInterval]) -> Vec<&TrendInterval> {
    let count = |setup: &str| intervals.iter().filter(|interval| interval.setup == setup).count();
    let setup = intervals.iter().map(|interval| interval.setup.as_str()).max_by_key(|setup| count(setup));
    intervals.iter().filter(|interval| Some(interval.setup.as_str()) == setup).collect()
}

fn panels(trend: &Trend, intervals: &[&TrendInterval], unit: &str) -> Vec<Panel> {
    let hour = |interval: &TrendInterval| 0.5 * (interval.start_s + interval.end_s) / 3600.0;
    let mut panels = Vec::new();
    let temperatures = intervals.iter().filter_map(|i| Some((hour(i), i.temperature_degc?, 0.0))).collect();
    panels.push(Panel {
        name: "temperature in °C".to_owned(),
        points: temperatures,
        color: TEMPERATURE,
        is_log: false,
    });
    let levels: Vec<(f64, f64)> = intervals
        .iter()
        .map(|i| (hour(i), i.modes.iter().map(|mode| mode.response_rms.powi(2)).sum::<f64>().sqrt()))
        .filter(|(_, level)| *level > 0.0 && level.is_finite())
        .collect();
    panels.push(of_response(&levels, unit));
    for mode in &trend.modes {
        let percent = |seen: &IntervalMode| {
            let scale = 100.0 / mode.frequency_hz;
            (scale * (seen.frequency_hz - mode.frequency_hz), scale * seen.frequency_std_hz)
        };
        let points = intervals
            .iter()
            .filter_map(|interval| {
                let (value, std) = percent(interval.modes.iter().find(|seen| seen.number == mode.number)?);
                Some((hour(interval), value, if std.is_finite() { std } else { 0.0 }))
            })
            .collect();
        let name = format!("mode {}: frequency, in % off {:.4} Hz", mode.number, mode.frequency_hz);
        panels.push(Panel { name, points, color: MEASURED, is_log: false });
    }
    panels.retain(|panel| !panel.points.is_empty());
    panels
}

/// The response of all modes together, over the hours.
fn of_response(levels: &[(f64, f64)], unit: &str) -> Panel {
    let (least, most) = levels.iter().fold((f64::INFINITY, 0.0), |(l, m): (f64, f64), (_, v)| (l.min(*v), m.max(*v)));
    let (factor, prefix) = prefixed(most);
    let is_log = most > LINEAR * least;
    let value = |level: f64| if is_log { (factor * level).log10() } else { factor * level };
    Panel {
        name: format!("response, RMS of all modes in {prefix}{unit}"),
        points: levels.iter().map(|&(hour, level)| (hour, value(level), 0.0)).collect(),
        color: REJECTED,
        is_log,
    }
}

fn draw(area: &Area<'_>, panel: &Panel, hours: f64, every: f64, is_last: bool) -> DrawResult {
    let lowest = panel.points.iter().map(|(_, value, std)| value - BAR * std).fold(f64::INFINITY, f64::min);
    let highest = panel.points.iter().map(|(_, value, std)| value + BAR * std).fold(f64::NEG_INFINITY, f64::max);
    // One interval alone has no span of its own.
    let room = (0.1 * (highest - lowest)).max(1e-3 * highest.abs()).max(1e-6);
    let (lowest, highest) = (lowest - room, highest + room);
    let label = |value: &f64| match 10f64.powf(*value) {
        level if panel.is_log => fixed(level, (1.0 - level.log10().floor()).clamp(0.0, 6.0) as usize),
        _ => fixed(*value, axis_digits(highest - lowest)),
    };
    let below = is_last.then_some("hours after the recording's first row");
    let plane = over_time::panel(area, &panel.name, hours, lowest..highest, &label, below)?;
    for run in panel.points.chunk_by(|a, b| b.0 - a.0 < GAP * every) {
        plane.curve(run.iter().map(|&(x, y, _)| (x, y)), Dashes::Full, panel.color.mix(0.35).into())?;
    }
    for &(x, y, std) in &panel.points {
        if std > 0.0 {
            plane.curve([(x, y - BAR * std), (x, y + BAR * std)], Dashes::Full, panel.color.into())?;
        }
        plane.dot((x, y), 2, panel.color.filled())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trend::ModeTrend;

    /// Six intervals of ten minutes: a mode whose frequency wanders by so much percent, a response that grows by `growth` each time.
    fn trend(percent: f64, growth: f64) -> Trend {
        let frequency_hz = 0.4;
        let interval = |index: i32| TrendInterval {
            setup: "first".to_owned(),
            start_s: 600.0 * f64::from(index),
            end_s: 600.0 * f64::from(index + 1),
            averages: 10,
            groups: 10,
            temperature_degc: None,
            modes: vec![IntervalMode {
                number: 1,
                frequency_hz: frequency_hz * (1.0 + 0.01 * percent * f64::from(index % 3 - 1)),
                frequency_std_hz: 1e-4,
                damping_ratio: 0.01,
                damping_ratio_std: 0.001,
                mac: 1.0,
                response_rms: 2e-4 * growth.powi(index),
            }],
        };
        Trend {
            every_s: 600.0,
            modes: vec![ModeTrend {
                number: 1,
                intervals: 6,
                frequency_hz,
                lowest_hz: frequency_hz,
                highest_hz: frequency_hz,
                p_value_of_no_change: None,
                changes: None,
                percent_per_kelvin: None,
                percent_per_decade: None,
            }],
            intervals: (0..6).map(interval).collect(),
            warnings: Vec::new(),
        }
    }

    /// The numbers at the axes.
    fn labels(svg: &str) -> Vec<String> {
        svg.lines().map(|line| line.trim().to_owned()).filter(|line| line.parse::<f64>().is_ok()).collect()
    }

    #[test]
    fn bars_are_explained_and_nothing_has_no_sign() {
        for percent in [0.0, 0.01, 0.3, 7.0] {
            let svg = trends("Tower", &[], &trend(percent, 1.0)).unwrap().unwrap();
            let labels = labels(&svg);
            assert!(labels.len() > 8, "{labels:?}");
            assert!(!labels.iter().any(|label| label.starts_with('-') && label.parse() == Ok(0.0)), "{labels:?}");
            assert!(svg.contains("Bars: two standard deviations"));
        }
    }

    /// Bars of two deviations: 0.05 % of the frequency where its deviation is 0.025 %.
    #[test]
    fn bars_reach_two_deviations() {
        let trend = trend(1.0, 1.0);
        let intervals = longest(&trend.intervals);
        let panels = panels(&trend, &intervals, "m/s²");
        let &(_, _, std) = panels.last().unwrap().points.first().unwrap();
        assert!((BAR * std - 0.05).abs() < 1e-12);
    }

    /// Of six intervals two in the middle are missing: the rest are two runs of two.
    #[test]
    fn what_was_not_measured_is_not_joined() {
        let mut trend = trend(1.0, 1.0);
        let runs = |trend: &Trend| {
            let svg = trends("Tower", &[], trend).unwrap().unwrap();
            let curves = svg.lines().filter(|line| line.starts_with("<polyline") && line.contains("opacity=\"0.35\""));
            curves.map(|line| line.matches(',').count()).collect::<Vec<_>>()
        };
        assert_eq!(runs(&trend), [6, 6], "the response, and the mode");
        trend.intervals.drain(2..4);
        assert_eq!(runs(&trend), [2, 2, 2, 2]);
    }

    #[test]
    fn the_response_is_in_units_that_are_read() {
        let svg = trends("Tower", &[], &trend(0.3, 1.1)).unwrap().unwrap();
        assert!(svg.contains("RMS of all modes in mm/s²"));
        let calm = of_response(&[(0.0, 2e-4), (1.0, 3e-4)], "m/s");
        assert!(calm.name.ends_with("in mm/s"), "{}", calm.name);
        assert!(!calm.is_log && (calm.points[0].1 - 0.2).abs() < 1e-12);
        let storm = of_response(&[(0.0, 2e-4), (1.0, 2e-2)], "m/s");
        assert!(storm.is_log && (storm.points[1].1 - 20f64.log10()).abs() < 1e-12);
    }
}
