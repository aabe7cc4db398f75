//! `belfry identify --every`: what becomes of the modes over the hours.

use super::Console;
use super::text::Columns;
use crate::results::Results;
use crate::trend::{CHANGES, ModeTrend, Slope, Trend};

/// A dependence is said to be one from this many standard deviations on.
const SIGMAS: f64 = 3.0;

/// What the trends say, for people.
pub(super) fn tell(results: &Results, trend: &Trend, console: &Console) {
    let mut table = Columns::new([
        "mode",
        "in intervals",
        "mean Hz",
        "lowest Hz",
        "highest Hz",
        "changes",
        "% a kelvin",
        "% for ten times the response",
    ])
    .expendable(&[1, 4, 3]);
    for mode in &trend.modes {
        table.row([
            mode.number.to_string(),
            format!("{} of {}", mode.intervals, trend.intervals.len()),
            format!("{:.4}", mode.frequency_hz),
            format!("{:.4}", mode.lowest_hz),
            format!("{:.4}", mode.highest_hz),
            mode.changes.map_or("", |changes| if changes { "yes" } else { "no" }).to_owned(),
            slope(mode.percent_per_kelvin, 4),
            slope(mode.percent_per_decade, 3),
        ]);
    }
    console.say(format!("\n{table}"));
    for sentence in causes(trend) {
        console.say(sentence);
    }
    console.say(format!(
        "A mode \"changes\" when it scatters more from interval to interval than its deviations explain (chance below {CHANGES}). Every interval is in {}, a picture in {}.",
        results.path("trends.csv").display(),
        results.path("trends.svg").display()
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
            format!("{} modes change with the {what}, by {mean:+.3} % {unit} on average; a model that is to follow them needs {effect}.", values.len())
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
