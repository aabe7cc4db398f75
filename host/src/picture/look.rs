//! Recordings at one glance: the range of every channel over time, a band a channel, with what is suspect named beside.

use plotters::prelude::*;

use super::canvas::{Area, BAD, DrawResult, FRAME, INK, MEASURED, PictureError, axis_digits, fixed, width_of};
use super::over_time::parts;
use crate::measure::{ChannelLook, SetupLook};
use crate::numbers::short;
use crate::story::LookReport;

/// Heights of a setup's heading, of a channel's band, and of the axis of time.
const HEADING: u32 = 26;
const BAND: u32 = 34;
const AXIS: u32 = 40;
/// Where bands begin and end; names stand before, levels behind.
const LEFT: i32 = 150;
const RIGHT: i32 = 700;
/// Channels of a setup that are drawn: more would be no picture any more.
const MOST: usize = 64;
/// Letters of a name that fit.
const NAME: usize = 20;
const SMALL: u32 = 12;

/// Draws a band a channel, setup by setup. A band's height is the channel's own range, but for spikes no wider than its samples are.
///
/// # Errors
/// When drawing fails.
pub fn look(title: &str, report: &LookReport) -> Result<String, PictureError> {
    let shown = |seen: &SetupLook| seen.channels.len().min(MOST) as u32;
    let heights: Vec<u32> = report.setups.iter().map(|seen| HEADING + BAND * shown(seen) + AXIS).collect();
    let title = format!("{title}: what was recorded");
    let words =
        "Band: from the smallest to the largest sample at each time, about the mean. White: missing. Red: suspect.";
    parts("the look", [&title, words], &heights, |index, area| draw(area, &report.setups[index], report))
}

fn draw(area: &Area<'_>, seen: &SetupLook, report: &LookReport) -> DrawResult {
    let when = seen.start_utc.as_ref().map(|start| format!(", from {start}")).unwrap_or_default();
    let more = match seen.channels.len() {
        all if all > MOST => format!(", the first {MOST} of {all} channels"),
        _ => String::new(),
    };
    let heading = format!("{}: {} Hz{when}{more}", seen.setup, seen.sampling_rate_hz);
    area.draw(&Text::new(heading, (12, 6), ("sans-serif", 14)))?;
    for (index, channel) in seen.channels.iter().take(MOST).enumerate() {
        let suspect = report.suspect_of(&seen.setup, &channel.channel);
        let top = (HEADING + BAND * index as u32) as i32;
        band(area, seen, (index, channel), top, &suspect)?;
    }
    let bottom = (HEADING + BAND * seen.channels.len().min(MOST) as u32) as i32;
    axis(area, seen.duration_s, bottom)
}

/// A channel's name, its range over time, its level, and what is suspect.
fn band(
    area: &Area<'_>,
    seen: &SetupLook,
    (index, channel): (usize, &ChannelLook),
    top: i32,
    suspect: &[String],
) -> DrawResult {
    let color = if suspect.is_empty() { MEASURED } else { BAD };
    let name: String = match channel.channel.chars().count() {
        // The last letters tell channels of one group apart.
        letters if letters > NAME => "…".chars().chain(channel.channel.chars().skip(letters - NAME + 1)).collect(),
        _ => channel.channel.clone(),
    };
    area.draw(&Text::new(name, (12, top + 9), ("sans-serif", SMALL as i32).into_font().color(&color)))?;
    let (middle, reach) = (top + BAND as i32 / 2, f64::from(BAND) / 2.0 - 2.0);
    area.draw(&PathElement::new(vec![(LEFT, middle), (RIGHT, middle)], FRAME))?;
    let mean = channel.mean.unwrap_or(0.0);
    let ends = [channel.smallest.unwrap_or(0.0), channel.largest.unwrap_or(0.0)];
    let largest = ends.iter().map(|end| (end - mean).abs()).fold(0.0, f64::max);
    let bins = seen.rows.div_ceil(seen.ranges.rows_a_bin().max(1)).max(1) as f64;
    let x = |bin: usize| LEFT + (f64::from(RIGHT - LEFT) * (bin as f64 / bins).min(1.0)).round() as i32;
    for (bin, [low, high]) in seen.ranges.of(index).enumerate().filter(|(_, [low, _])| !low.is_nan()) {
        let y = |value: f64| {
            if largest > 0.0 { middle - (reach * (value - mean) / largest).round() as i32 } else { middle }
        };
        // A level stands on the line.
        let low = if seen.live { mean } else { low };
        let corners = [(x(bin), y(high)), (x(bin + 1).max(x(bin) + 1), y(low) + 1)];
        area.draw(&Rectangle::new(corners, color.filled()))?;
    }
    let level =
        channel.rms.map_or_else(|| "no sample".to_owned(), |rms| format!("{} {} RMS", short(rms), channel.unit));
    area.draw(&Text::new(level, (RIGHT + 12, top + 2), ("sans-serif", SMALL as i32)))?;
    let missing = (channel.missing > 0).then(|| format!("{} % missing", fixed(channel.missing_percent, 1)));
    let words: Vec<String> = missing.into_iter().chain(suspect.iter().cloned()).collect();
    let style = ("sans-serif", SMALL as i32).into_font().color(&color);
    Ok(area.draw(&Text::new(words.join(", "), (RIGHT + 12, top + 17), style))?)
}

/// The axis of time, in s, min or h.
fn axis(area: &Area<'_>, duration_s: f64, top: i32) -> DrawResult {
    const HOUR_S: f64 = 3600.0;
    let (unit, unit_s) = match duration_s {
        long if long >= 2.0 * HOUR_S => ("h", HOUR_S),
        some if some >= 300.0 => ("min", 60.0),
        _ => ("s", 1.0),
    };
    let span = duration_s / unit_s;
    area.draw(&PathElement::new(vec![(LEFT, top + 4), (RIGHT, top + 4)], INK))?;
    if !(span > 0.0 && span.is_finite()) {
        return Ok(());
    }
    let decade = 10f64.powf((span / 5.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|times| times * decade).find(|step| span / step <= 6.0);
    let step = step.unwrap_or(span);
    let digits = axis_digits(span);
    for number in 0..=(span / step) as u32 {
        let at = f64::from(number) * step;
        let x = LEFT + (f64::from(RIGHT - LEFT) * at / span).round() as i32;
        area.draw(&PathElement::new(vec![(x, top + 4), (x, top + 8)], INK))?;
        let label = fixed(at, digits);
        let x = x - width_of(&label, SMALL) / 2;
        area.draw(&Text::new(label, (x, top + 10), ("sans-serif", SMALL as i32)))?;
    }
    let words = format!("time in {unit}");
    Ok(area.draw(&Text::new(words, (RIGHT + 12, top), ("sans-serif", SMALL as i32)))?)
}
