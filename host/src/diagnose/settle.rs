//! What to measure next, where two effects explain the data alike.

use nalgebra::{DMatrix, DVector};

use super::fit::Fit;
use super::problem::Problem;
use crate::compare::ModelView;
use crate::model::effect::{Effect, EffectKind};
use crate::study::{Direction, Sensor};

/// The measurement that would tell two effects apart: what the catalogue says of the two, and where their fitted models
/// differ most, at a place without a sensor or in a mode that is not measured.
pub(super) fn next_measurement(
    problem: &Problem,
    one: (&dyn EffectKind, &Fit),
    other: (&dyn EffectKind, &Fit),
) -> String {
    let said = |a: &dyn EffectKind, b: &dyn EffectKind| {
        a.about().look_alikes.iter().find(|alike| alike.kind == b.name()).map(|alike| alike.separated_by)
    };
    let catalogue = said(one.0, other.0).or_else(|| said(other.0, one.0));
    let predicted = greatest_difference(problem, one.1, other.1);
    let between = format!("between {} and {}", last(one.1), last(other.1));
    match (catalogue, predicted) {
        (Some(catalogue), Some(predicted)) => format!("{between}: {catalogue}; {predicted}"),
        (Some(catalogue), None) => format!("{between}: {catalogue}"),
        (None, Some(predicted)) => format!("{between}: {predicted}"),
        (None, None) => format!(
            "{between}: no further vibration measurement; their models move alike everywhere. Inspect the structure, or its drawings"
        ),
    }
}

fn last(fit: &Fit) -> String {
    fit.effects().last().map_or_else(|| "the model as it is".to_owned(), Effect::to_string)
}

/// Shapes that differ by less than this share of their largest component are alike for any sensor.
const VISIBLE_SHAPE: f64 = 0.02;
/// Frequencies that differ by less than this share are alike for any record.
const VISIBLE_FREQUENCY: f64 = 0.005;
/// Modes above the measured ones that a wider band could show.
const MORE_MODES: usize = 6;

fn greatest_difference(problem: &Problem, one: &Fit, other: &Fit) -> Option<String> {
    let mut words = Vec::new();
    if let Some((z_m, direction, number, share)) = shape_difference(problem, one, other) {
        words.push(format!(
            "a sensor at {z_m:.1} m along {direction} would see measured mode {number} differ by {:.0} % of its largest motion",
            100.0 * share
        ));
    }
    if let Some((hz, other_hz)) = mode_difference(one, other) {
        words.push(format!(
            "a mode that is not measured yet stands near {hz:.3} Hz in one and near {other_hz:.3} Hz in the other"
        ));
    }
    (!words.is_empty()).then(|| words.join("; "))
}

/// Height, direction, measured mode and difference, in shares of the mode's largest component.
fn shape_difference(problem: &Problem, one: &Fit, other: &Fit) -> Option<(f64, char, usize, f64)> {
    let mut places = Vec::new();
    for z_m in problem.heights_m() {
        places.extend([(z_m, 'X', probe(z_m, 0.0)), (z_m, 'Y', probe(z_m, 90.0))]);
    }
    let probes: Vec<Sensor> = places.iter().map(|(_, _, probe)| probe.clone()).collect();
    let rows = |fit: &Fit| fit.state.model.assembly.sensor_rows(&probes).ok();
    let (rows, other_rows) = (rows(one)?, rows(other)?);
    let mut best: Option<(f64, char, usize, f64)> = None;
    for (index, mode) in problem.measured.iter().enumerate() {
        let (Some(a), Some(b)) = (motion(one, index, &rows), motion(other, index, &other_rows)) else { continue };
        for ((z_m, direction, _), difference) in places.iter().zip((a - b).abs().iter()) {
            if *difference > best.as_ref().map_or(VISIBLE_SHAPE, |best| best.3) {
                best = Some((*z_m, *direction, mode.number, *difference));
            }
        }
    }
    best
}

/// Motion of a fitted model's mode at sensors that are not there (`rows`, sensors x DOFs), the largest component at the sensors
/// that are being one.
fn motion(fit: &Fit, measured: usize, rows: &DMatrix<f64>) -> Option<DVector<f64>> {
    let state = &fit.state;
    let (_, block) = state.residual.block_of(measured)?;
    let shape = block.shape.as_ref().filter(|shape| shape.models.len() == 1)?;
    let largest = state.model.view.at_sensors.column(block.model).amax();
    Some(rows * state.model.view.modes.shapes.column(block.model) * (shape.combination[0].signum() / largest))
}

/// Frequencies of the mode above or between the measured ones that differs most.
fn mode_difference(one: &Fit, other: &Fit) -> Option<(f64, f64)> {
    let unmeasured = |fit: &Fit| -> Vec<f64> {
        let view: &ModelView = &fit.state.model.view;
        let used: Vec<usize> = fit.state.pairs.iter().map(|pair| pair.model).collect();
        let highest = used.iter().copied().max().unwrap_or(0);
        (0..(highest + 1 + MORE_MODES).min(view.modes.frequency_hz.len()))
            .filter(|model| !used.contains(model))
            .map(|model| view.modes.frequency_hz[model])
            .collect()
    };
    let pairs = unmeasured(one).into_iter().zip(unmeasured(other));
    let apart = |&(a, b): &(f64, f64)| (a / b).ln().abs();
    pairs.filter(|pair| apart(pair) > VISIBLE_FREQUENCY).max_by(|a, b| apart(a).total_cmp(&apart(b)))
}

fn probe(z_m: f64, azimuth_deg: f64) -> Sensor {
    let direction = Some(Direction::AzimuthDeg(azimuth_deg));
    Sensor { elevation_m: Some(z_m), direction, ..Sensor::new("", 0) }
}
