//! `belfry identify --every`: what becomes of the modes over the hours.

use std::fmt::Write;
use std::time::Duration;

use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};

use super::Console;
use super::case::{results_folder, write_result};
use super::identify::align_right;
use crate::identify::Mode;
use crate::measure::Route;
use crate::picture;
use crate::spectra::LineGrid;
use crate::study::Study;
use crate::trend::{ModeTrend, Slope, Trend, follow};

/// Below this probability of chance, a mode is said to change.
const SIGNIFICANT: f64 = 1e-3;
/// A dependence is said to be one from this many standard deviations on.
const SIGMAS: f64 = 3.0;

/// Follows the modes, writes table and picture, and warns.
pub(super) fn follow_study(
    study: &Study,
    modes: &[Mode],
    grid: &LineGrid,
    every: Duration,
    route: Route,
    console: &Console,
) -> anyhow::Result<Trend> {
    let bar = console.progress(0, "intervals");
    let progress = &mut |done, total| {
        bar.set_length(total);
        bar.set_position(done);
    };
    let trend = follow(study, modes, grid, every.as_secs_f64(), route, progress);
    bar.finish_and_clear();
    let trend = trend?;
    for warning in &trend.warnings {
        console.warn(warning);
    }
    write_result(study, "trends.csv", csv(&trend).as_bytes())?;
    if let Some(picture) = picture::trends(&study.structure.name, &trend)? {
        write_result(study, "trends.svg", picture.as_bytes())?;
    }
    Ok(trend)
}

/// A row an interval and mode.
fn csv(trend: &Trend) -> String {
    let mut text = "setup,start_s,end_s,averages,temperature_degc,mode,frequency_hz,frequency_std_hz,damping_ratio,damping_ratio_std,mac,response_rms\n".to_owned();
    for interval in &trend.intervals {
        let temperature = interval.temperature_degc.map_or(String::new(), |degrees| format!("{degrees:.3}"));
        for mode in &interval.modes {
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "\"{}\",{},{},{},{temperature},{},{:.7},{:.7},{:.6},{:.6},{:.5},{:.5e}",
                interval.setup.replace('"', "\"\""),
                interval.start_s,
                interval.end_s,
                interval.averages,
                mode.number,
                mode.frequency_hz,
                mode.frequency_std_hz,
                mode.damping_ratio,
                mode.damping_ratio_std,
                mode.mac,
                mode.response_rms
            );
        }
    }
    text
}

/// What the trends say, for people.
pub(super) fn tell(study: &Study, trend: &Trend, console: &Console) {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "mode",
        "in intervals",
        "mean Hz",
        "lowest Hz",
        "highest Hz",
        "changes",
        "% a kelvin",
        "% for ten times the response",
    ]);
    for mode in &trend.modes {
        table.add_row([
            mode.number.to_string(),
            format!("{} of {}", mode.intervals, trend.intervals.len()),
            format!("{:.4}", mode.frequency_hz),
            format!("{:.4}", mode.lowest_hz),
            format!("{:.4}", mode.highest_hz),
            match mode.p_value_of_no_change {
                Some(p) if p < SIGNIFICANT => "yes".to_owned(),
                Some(_) => "no".to_owned(),
                None => String::new(),
            },
            slope(mode.percent_per_kelvin, 4),
            slope(mode.percent_per_decade, 3),
        ]);
    }
    align_right(&mut table, 8);
    console.say(format!("\n{table}"));
    for sentence in causes(trend) {
        console.say(sentence);
    }
    let folder = results_folder(study);
    console.say(format!(
        "\"changes\": more scatter from interval to interval than the deviations explain (chance below {SIGNIFICANT}). Each interval is in {}, a picture in {}.",
        folder.join("trends.csv").display(),
        folder.join("trends.svg").display()
    ));
}

fn slope(slope: Option<Slope>, digits: usize) -> String {
    slope.map_or(String::new(), |slope| format!("{:+.digits$} ± {:.digits$}", slope.value, slope.std))
}

/// What the changes go with, where several modes say the same.
fn causes(trend: &Trend) -> Vec<String> {
    let clear = |of: fn(&ModeTrend) -> Option<Slope>| -> Vec<f64> {
        let slopes = trend.modes.iter().filter_map(of);
        slopes.filter(|slope| slope.value.abs() > SIGMAS * slope.std).map(|slope| slope.value).collect()
    };
    let say = |values: Vec<f64>, what: &str, unit: &str, effect: &str| {
        // Of a dozen modes one in thirty goes by chance with anything.
        (values.len() >= 2).then(|| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            format!("{} modes change with the {what}, by {mean:+.3} % {unit} on average: a model that is to follow needs {effect}.", values.len())
        })
    };
    [
        say(clear(|mode| mode.percent_per_kelvin), "temperature", "a kelvin", "a stiffness that depends on it"),
        say(
            clear(|mode| mode.percent_per_decade),
            "response level",
            "for ten times the response",
            "a stiffness that depends on the amplitude",
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}
