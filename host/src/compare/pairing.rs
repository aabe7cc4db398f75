//! Which model mode belongs to which measured mode: an assignment over MAC and frequency together.
//!
//! Not by order: a model that is wrong has modes in a wrong order. Not greedily: a good pair must not cost two others. A mode whose
//! partner the file of modes states is followed by the shape of that partner in the model as first given.

use nalgebra::DMatrix;

use super::shape::mac;
use super::view::ModelView;
use crate::assignment::{assigned, likeness};
use crate::modes::{MeasuredMode, MeasuredShape, StatedMode};

/// A measured mode and the model mode that belongs to it; both 0-based.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// Index into the measured modes.
    pub measured: usize,
    /// Index into the model's modes, lowest first.
    pub model: usize,
    /// Modal assurance criterion; `None` where no shape was measured.
    pub mac: Option<f64>,
    /// For one of several close modes: squared cosine of the measured shape and the span of the close model shapes. Close
    /// modes may turn within that span at the slightest change, so it is what a model of them can be held to.
    pub subspace_mac: Option<f64>,
}

/// Frequencies count as alike over this range (standard deviation of their logarithm): models are off by 10 to 20 %.
const LIKENESS: f64 = 0.25;
/// Least likeness of a pair: below it neither shape nor frequency supports the pair.
const LEAST_LIKENESS: f64 = 0.2;
/// What the shape counts for where none was measured.
const UNKNOWN_SHAPE: f64 = 0.5;
/// Model modes are close when neighbours differ by less than this share of their frequency.
const CLOSE: f64 = 0.03;
/// What is stated goes before all that is alike.
const STATED: f64 = 1e3;

/// Pairs measured with model modes so that the sum of `MAC exp(-(ln f ratio)²/(2 LIKENESS²))` is the largest; pairs that
/// resemble each other too little are left out. In the order of the measured modes.
pub fn pair(view: &ModelView, measured: &[MeasuredMode]) -> Vec<Pair> {
    pair_above(view, measured, LEAST_LIKENESS)
}

/// As [`pair`], with another least likeness.
pub(crate) fn pair_above(view: &ModelView, measured: &[MeasuredMode], least_likeness: f64) -> Vec<Pair> {
    let candidates = candidates(view, measured);
    if measured.is_empty() || candidates == 0 {
        return Vec::new();
    }
    let alike = |mode: &MeasuredMode, model: usize| {
        if let Some(stated) = &mode.stated {
            return STATED * stated.likeness(model, view.modes.shapes.column(model));
        }
        let ratio = view.modes.frequency_hz[model] / mode.frequency_hz;
        let shape = mode.shape.as_ref().map_or(UNKNOWN_SHAPE, |shape| mac(view.shape(model), shape));
        likeness(shape, ratio, LIKENESS, least_likeness)
    };
    let mut pairs: Vec<Pair> = assigned(measured.len(), candidates, &|index, model| alike(&measured[index], model))
        .into_iter()
        .map(|(index, model)| {
            let mac = measured[index].shape.as_ref().map(|shape| mac(view.shape(model), shape));
            Pair { measured: index, model, mac, subspace_mac: None }
        })
        .collect();
    for index in 0..pairs.len() {
        let group = close_models(view, &pairs, pairs[index].model);
        if group.len() > 1
            && let Some(shape) = &measured[pairs[index].measured].shape
        {
            pairs[index].subspace_mac = Some(share_in_span(&view.at_sensors.select_columns(&group), shape));
        }
    }
    pairs
}

/// How many of the model's modes, from the lowest, can be paired with measured ones.
pub(crate) fn candidates(view: &ModelView, measured: &[MeasuredMode]) -> usize {
    let stated_hz = |mode: &MeasuredMode| mode.stated.as_ref().and_then(StatedMode::frequency_hz).unwrap_or(0.0);
    let highest_hz = measured.iter().map(|mode| mode.frequency_hz.max(stated_hz(mode))).fold(0.0, f64::max);
    // Beyond four deviations nothing pairs.
    let reach = (4.0 * LIKENESS).exp();
    view.modes.frequency_hz.partition_point(|&frequency_hz| frequency_hz <= highest_hz * reach)
}

/// The paired model modes that stand close together with `model`, itself included.
pub(super) fn close_models(view: &ModelView, pairs: &[Pair], model: usize) -> Vec<usize> {
    let mut paired: Vec<usize> = pairs.iter().map(|pair| pair.model).collect();
    paired.sort_unstable();
    let near = |a: usize, b: usize| {
        let (a, b) = (view.modes.frequency_hz[a], view.modes.frequency_hz[b]);
        (a - b).abs() < CLOSE * a.max(b)
    };
    let position = paired.partition_point(|&other| other < model);
    let (mut first, mut last) = (position, position);
    while first > 0 && near(paired[first - 1], paired[first]) {
        first -= 1;
    }
    while last + 1 < paired.len() && near(paired[last], paired[last + 1]) {
        last += 1;
    }
    paired.get(first..=last).unwrap_or(&[]).to_vec()
}

/// |P phihat|² / |phihat|² with P the projector on the span of `shapes` (sensors x modes) at the measured sensors: the
/// highest MAC that any combination of the shapes can have.
pub(crate) fn share_in_span(shapes: &DMatrix<f64>, measured: &MeasuredShape) -> f64 {
    let there = shapes.select_rows(&measured.sensors);
    let total = measured.values.norm_squared();
    let left = there.svd(true, false);
    let (Some(directions), Some(greatest)) = (left.u, left.singular_values.iter().copied().reduce(f64::max)) else {
        return 0.0;
    };
    let kept = directions
        .column_iter()
        .zip(left.singular_values.iter())
        .filter(|&(_, &value)| value > RANK_TOLERANCE * greatest)
        .map(|(direction, _)| direction.dot(&measured.values).powi(2));
    (kept.sum::<f64>() / total).min(1.0)
}

/// Singular values below this share of the largest are rounding.
pub(crate) const RANK_TOLERANCE: f64 = 1e-10;
