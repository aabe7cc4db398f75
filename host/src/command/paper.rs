//! The paper's tables beside ours: Lei, Wang, Shen (2012), Tables 1 and 2, on the real tower.

use serde::Deserialize;

use super::text::{Columns, mac_text};
use crate::story::{CovalidationReport, UpdateReport};
use crate::study::template;

#[derive(Debug, Deserialize)]
struct PaperMode {
    mode: usize,
    measured_hz: f64,
    model_hz: f64,
    updated_hz: f64,
    mac_model: Option<f64>,
    mac_updated: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct PaperSensor {
    channel: String,
    error_model_percent: f64,
    error_updated_percent: f64,
}

/// A pair belongs to a mode of the paper when its measured frequency is this near (relative).
const NEAR: f64 = 0.02;

fn rows<T: for<'de> Deserialize<'de>>(text: &str) -> Result<Vec<T>, csv::Error> {
    csv::Reader::from_reader(text.as_bytes()).deserialize().collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// Table 1 of the paper beside an update, Table 2 beside a co-validation, as text.
///
/// # Errors
/// When the built-in tables cannot be read.
pub fn tables(update: &UpdateReport, covalidation: &CovalidationReport) -> anyhow::Result<String> {
    let paper: Vec<PaperMode> = rows(template::PAPER_TABLE_1)?;
    let number = |value: f64, digits: usize| format!("{value:.digits$}");
    let optional = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| number(value, 2));
    let mut table = Columns::new([
        "mode",
        "measured",
        "model",
        "updated",
        "MAC",
        "updated",
        "ours: measured",
        "model",
        "updated",
        "MAC",
        "updated",
    ])
    .expendable(&[4, 5, 9, 10]);
    for mode in &paper {
        let ours = update.pairs.iter().find(|pair| (pair.measured_hz / mode.measured_hz - 1.0).abs() < NEAR);
        let mut row = vec![
            mode.mode.to_string(),
            number(mode.measured_hz, 3),
            number(mode.model_hz, 3),
            number(mode.updated_hz, 3),
            optional(mode.mac_model),
            optional(mode.mac_updated),
        ];
        match ours {
            Some(pair) => row.extend([
                number(pair.measured_hz, 4),
                number(pair.before.model_hz, 4),
                number(pair.after.model_hz, 4),
                mac_text(pair.before.mac, 2),
                mac_text(pair.after.mac, 2),
            ]),
            None => row.extend(std::iter::repeat_n("-".to_owned(), 5)),
        }
        table.row(row);
    }
    let error =
        |hz: fn(&PaperMode) -> f64| mean(paper.iter().map(|mode| 100.0 * (hz(mode) / mode.measured_hz - 1.0).abs()));
    let errors = update.mean_abs_frequency_error_percent;
    let mut text = format!(
        "Table 1 of the paper (the real tower) beside ours (Hz)\n{table}\nMean frequency error: paper {:.1} -> {:.1} %, ours {:.1} -> {:.1} %. Mean MAC: paper {:.2} -> {:.2}",
        error(|mode| mode.model_hz),
        error(|mode| mode.updated_hz),
        errors.before,
        errors.after,
        mean(paper.iter().filter_map(|mode| mode.mac_model)),
        mean(paper.iter().filter_map(|mode| mode.mac_updated)),
    );
    if let Some(mac) = update.mean_mac {
        text += &format!(", ours {:.2} -> {:.2}", mac.before, mac.after);
    }
    text += " (the paper's without torsion).\n\nTable 2 of the paper beside ours: error at sensors left out, in %\n";
    let mut table = Columns::new(["sensor", "paper: model", "updated", "ours: model", "updated", "measured shapes"]);
    for sensor in rows::<PaperSensor>(template::PAPER_TABLE_2)? {
        let ours = covalidation.channels.iter().find(|channel| channel.channel == sensor.channel);
        let errors = ours.map(|channel| channel.error_percent).unwrap_or_default();
        table.row([
            sensor.channel,
            number(sensor.error_model_percent, 1),
            number(sensor.error_updated_percent, 1),
            optional(errors.model),
            optional(errors.updated),
            optional(errors.measured_shapes),
        ]);
    }
    Ok(text
        + &format!(
            "{table}\nThe paper's errors fall with its update. By its own eq. 16 they cannot: the updated shapes span what the model's shapes span, and the prediction depends on nothing else."
        ))
}
