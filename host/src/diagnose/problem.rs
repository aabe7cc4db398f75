//! What is diagnosed: a structure, the measured modes to compare it with, and how far it is trusted.
//!
//! A structure, its effects and measured modes flow in; modes that have a partner in the model, sorted by what they can tell,
//! flow out.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

use nalgebra::{DMatrix, DVector};

use super::background::Background;
use super::discrepancy::Discrepancy;
use super::error::DiagnoseError;
use super::families::families;
use super::fit::USUAL_TOLERANCE;
use super::prior::PriorOdds;
use super::smooth::smooth_covariance;
use super::state::State;
use crate::compare::{ModelView, Pair, ViewError, complement, correlation_length_m, pair, shape_deviations};
use crate::model::effect::Effect;
use crate::model::{Assembly, Body, Distortion, Structure};
use crate::modes::{CLOSE, MeasuredMode};
use crate::progress::Tally;
use crate::statistics::{MEDIAN_OF_ABSOLUTE, groups, median};
use crate::study::{Model, Sensor};

/// A structure without its effects, the modes that it is compared with, and how far it is trusted.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The structure as first given.
    pub(super) bare: Structure,
    /// The sensors that shapes stand at.
    pub(super) sensors: Vec<Sensor>,
    /// Measured modes that have a partner in the model; then those that could be twins of them.
    pub(super) measured: Vec<MeasuredMode>,
    /// How many of them have a partner.
    pub(super) paired: usize,
    /// Dampers of the structure in which they have.
    dampers: usize,
    /// For each of them, the modes too close to separate their shapes, itself included.
    pub(super) close: Vec<Vec<usize>>,
    /// Their damping ratios, where they are known.
    pub(super) damping: Vec<Option<f64>>,
    /// The damping ratio of the middle one.
    pub(super) ordinary_damping: f64,
    /// Imaginary parts of shapes, which only clocks explain.
    pub(super) phases: Vec<MeasuredPhases>,
    /// How far the model is trusted.
    pub(super) background: Background,
    /// The frequency of the middle one of the measured modes.
    pub(super) middle_hz: f64,
    /// The share of each of them in each family of modes.
    pub(super) families: DMatrix<f64>,
    /// What sections that rack as far as they turn would add to each measured mode's shape where all sensors are as the study says, sensors x
    /// measured modes.
    pub(super) racking: Arc<DMatrix<f64>>,
    /// How smooth errors of shapes go together, sensors x sensors.
    pub(super) smooth: Arc<DMatrix<f64>>,
    /// What is likely before anything is measured.
    pub(super) prior_odds: PriorOdds,
    /// Whether the study does not state how far it trusts the model.
    pub(super) lacks_tolerance: bool,
    /// What a segment's stiffness is uncertain by, as far as effects are weighed against what the table may have wrong.
    pub(super) stiffness_known_to: f64,
    /// What it misses for reasons that neither effects nor the background explain.
    pub(super) discrepancy: Discrepancy,
    /// What effects are weighed by; made when first asked for.
    pub(super) reference: Arc<OnceLock<Option<Reference>>>,
    /// Numbers of measured modes without a partner.
    pub(super) unpaired: Vec<usize>,
    /// Numbers of measured modes whose shapes are too complex for one mode of a structure.
    pub(super) complex: Vec<usize>,
    /// Hears how far fits and searches are.
    pub(super) tally: Tally,
}

/// The structure as first given, by which effects are weighed.
pub(super) struct Reference {
    pub(super) state: State,
    /// Of parameters so far.
    pub(super) typical: Mutex<HashMap<String, Option<Typical>>>,
}

/// How large a parameter typically is, and a step of it with the greatest shift of a frequency (ln f) that it makes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Typical {
    pub(super) size: f64,
    pub(super) step: f64,
    pub(super) shift: f64,
}

impl std::fmt::Debug for Reference {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Reference")
    }
}

/// The imaginary part of a measured shape, in shares of its length.
#[derive(Debug, Clone)]
pub(super) struct MeasuredPhases {
    /// Index of the measured mode.
    pub(super) mode: usize,
    /// The imaginary parts, sensor by sensor of the shape.
    pub(super) imaginary: DVector<f64>,
    /// Their standard deviations.
    pub(super) deviations: DVector<f64>,
}

/// What a segment's stiffness, or a group, is uncertain by.
fn stiffness_known_to(bare: &Structure, model: &Model) -> f64 {
    let squares: Vec<f64> = bare.groups().map(|(_, group)| group.std.powi(2)).collect();
    match bare.body {
        Body::Matrices(_) if !squares.is_empty() => (squares.iter().sum::<f64>() / squares.len() as f64).sqrt(),
        Body::Matrices(_) => USUAL_TOLERANCE,
        Body::Beam(_) => model.background_stiffness.unwrap_or(USUAL_TOLERANCE),
    }
}

/// Model modes that differ by less than this: their shapes in the model are arbitrary within the span.
const DEGENERATE: f64 = 0.005;

impl Problem {
    /// From a structure without effects, the effects that the study has, and what was measured.
    ///
    /// # Errors
    /// When sensors have no place, the structure has no modes, or no measured mode has a partner in it.
    pub fn new(
        bare: Structure,
        effects: &[Effect],
        model: &Model,
        sensors: &[Sensor],
        measured: &[MeasuredMode],
    ) -> Result<Self, DiagnoseError> {
        let structure = bare.clone().and(effects)?;
        let assembly = structure.assemble();
        let view = ModelView::of(&assembly, sensors)?;
        let is_free = |mode: &&MeasuredMode| structure.forced_hz().all(|forced_hz| !is_forced(mode, forced_hz));
        let measured: Vec<MeasuredMode> = measured.iter().filter(is_free).cloned().collect();
        let (measured, complex): (Vec<_>, Vec<_>) =
            measured.into_iter().partition(|mode| has_real_shape(mode, sensors));
        let pairs = without_strangers(pair(&view, &measured), &view, &measured);
        if pairs.is_empty() {
            return Err(DiagnoseError::NoPairs);
        }
        let unpaired = measured
            .iter()
            .enumerate()
            .filter(|(index, _)| pairs.iter().all(|pair| pair.measured != *index))
            .map(|(_, mode)| mode.number)
            .collect();
        let mut in_use: Vec<MeasuredMode> = pairs.iter().map(|pair| measured[pair.measured].clone()).collect();
        let paired = in_use.len();
        if structure.z_range_m().is_some() {
            let is_alone = |index: &usize| pairs.iter().all(|pair| pair.measured != *index);
            let alone = (0..measured.len()).filter(is_alone).map(|index| &measured[index]);
            let twins: Vec<MeasuredMode> = alone.filter(|mode| is_twin(mode, &in_use)).cloned().collect();
            in_use.extend(twins);
        }
        let is_close = |a: usize, b: usize| {
            let ratio = |a: f64, b: f64| (a / b).ln().abs();
            let model_hz = |index: usize| pairs.get(index).map(|pair| view.modes.frequency_hz[pair.model]);
            ratio(in_use[a].frequency_hz, in_use[b].frequency_hz) < CLOSE
                || matches!((model_hz(a), model_hz(b)), (Some(a), Some(b)) if ratio(a, b) < DEGENERATE)
        };
        let close = groups(in_use.len(), &is_close);
        let phases = (0..paired).filter(|&mode| close[mode].len() == 1).filter_map(|mode| phases(mode, &in_use));
        let damping: Vec<Option<f64>> =
            in_use.iter().map(|mode| mode.damping_ratio.filter(|ratio| *ratio > 0.0 && *ratio < 1.0)).collect();
        let mut frequencies_hz: Vec<f64> = in_use.iter().map(|mode| mode.frequency_hz).collect();
        let mut known: Vec<f64> = damping.iter().copied().flatten().collect();
        let families = families(&view, &assembly, &pairs, in_use.len());
        let racking = Arc::new(racking(&view, &assembly, &pairs, &in_use, sensors)?);
        let background = Background::of(&bare, model);
        Ok(Self {
            reference: Arc::default(),
            ordinary_damping: median(&mut known).unwrap_or(1.0),
            damping,
            phases: phases.collect(),
            complex: complex.iter().map(|mode| mode.number).collect(),
            close,
            lacks_tolerance: background.is_none(),
            background: background.with_families(families.ncols()),
            smooth: Arc::new(match bare.z_range_m() {
                Some(heights_m) => smooth_covariance(sensors, correlation_length_m(heights_m, model)),
                None => DMatrix::zeros(sensors.len(), sensors.len()),
            }),
            families,
            racking,
            middle_hz: median(&mut frequencies_hz).unwrap_or(1.0),
            discrepancy: Discrepancy::NONE,
            prior_odds: PriorOdds::of(&model.prior_odds),
            stiffness_known_to: stiffness_known_to(&bare, model),
            bare,
            sensors: sensors.to_vec(),
            measured: in_use,
            paired,
            dampers: structure.dampers(),
            unpaired,
            tally: Tally::default(),
        })
    }

    /// The same, which tells how far fits and searches of it are.
    #[must_use]
    pub fn told_to(self, tally: &Tally) -> Self {
        Self { tally: tally.clone(), ..self }
    }

    /// Measured modes that have a partner in the model.
    pub fn measured(&self) -> &[MeasuredMode] {
        &self.measured[..self.paired]
    }

    /// Measured modes that a structure is compared with: one more damper makes twins.
    pub(super) fn seen_by(&self, structure: &Structure) -> &[MeasuredMode] {
        if structure.dampers() > self.dampers { &self.measured } else { self.measured() }
    }

    /// The structure without effects.
    pub fn bare(&self) -> &Structure {
        &self.bare
    }

    /// The same without a mode (index into [`Problem::measured`]); `None` for the last one.
    pub(super) fn without_mode(&self, mode: usize) -> Option<Self> {
        let mut other = self.clone();
        if self.paired < 2 || mode >= self.paired {
            return None;
        }
        other.measured.remove(mode);
        other.damping.remove(mode);
        other.families = other.families.remove_row(mode);
        other.racking = Arc::new(other.racking.as_ref().clone().remove_column(mode));
        other.paired -= 1;
        let renumber = |index: usize| if index > mode { index - 1 } else { index };
        other.close.remove(mode);
        for group in &mut other.close {
            group.retain(|&member| member != mode);
            group.iter_mut().for_each(|member| *member = renumber(*member));
        }
        other.phases.retain(|phases| phases.mode != mode);
        other.phases.iter_mut().for_each(|phases| phases.mode = renumber(phases.mode));
        Some(other)
    }

    /// The same without the modes that a forced line makes or moves; `None` where there are no such modes, or no others.
    pub(super) fn without_forced(&self, forced_hz: f64) -> Option<Self> {
        let spoilt = (0..self.paired).rev().filter(|&mode| is_forced(&self.measured[mode], forced_hz));
        spoilt.fold(None, |rest: Option<Self>, mode| rest.as_ref().unwrap_or(self).without_mode(mode))
    }

    /// The same without what certain sensors saw.
    pub(super) fn without_sensors(&self, sensors: &[usize]) -> Self {
        let mut other = self.clone();
        let is_kept = |sensor: usize| !sensors.contains(&sensor);
        for phases in &mut other.phases {
            if let Some(shape) = &self.measured[phases.mode].shape {
                let rows: Vec<usize> = (0..shape.sensors.len()).filter(|&row| is_kept(shape.sensors[row])).collect();
                phases.imaginary = phases.imaginary.select_rows(&rows);
                phases.deviations = phases.deviations.select_rows(&rows);
            }
        }
        other.measured.iter_mut().for_each(|mode| *mode = mode.at_sensors(&is_kept));
        other
    }
}

/// What sections that rack as far as they turn would add to each measured mode's shape at the sensors, sensors x measured modes, where the
/// partner in the model is of unit length at the mode's own sensors. None for modes without a partner.
fn racking(
    view: &ModelView,
    assembly: &Assembly,
    pairs: &[Pair],
    measured: &[MeasuredMode],
    sensors: &[Sensor],
) -> Result<DMatrix<f64>, DiagnoseError> {
    let as_far_as_they_turn = Distortion { racking: 1.0, ..Distortion::default() };
    let rows = assembly.with_perfect_sensors().distorted_rows(sensors, as_far_as_they_turn).map_err(ViewError::from)?;
    let mut racking = DMatrix::zeros(sensors.len(), measured.len());
    for ((mut column, pair), mode) in racking.column_iter_mut().zip(pairs).zip(measured) {
        let Some(shape) = &mode.shape else { continue };
        let length = view.at_sensors.column(pair.model).select_rows(&shape.sensors).norm();
        if length > 0.0 {
            column.copy_from(&(&rows * view.modes.shapes.column(pair.model) / length));
        }
    }
    Ok(racking)
}

/// A pair whose shapes have no more than this in common (a MAC), and whose frequencies differ by more (ln f), is none: a mode of walls, a ring
/// or a floor found the model's mode that nothing else had. Two of eleven pairs of a shell tube, MAC 0.3 and 0.5 and 18 and 31 % off, made
/// the model's error so large that the mass which was hidden in it did not show.
const UNLIKE: f64 = 0.6;
const FAR_OFF: f64 = 0.1;
/// At most one of so many pairs is none, the worst first; where more are so, the model is that wrong.
const PAIRS_TO_ONE_STRANGER: usize = 4;

/// Pairs but for those of modes that the model does not have.
fn without_strangers(mut pairs: Vec<Pair>, view: &ModelView, measured: &[MeasuredMode]) -> Vec<Pair> {
    let likeness = |pair: &Pair| pair.subspace_mac.or(pair.mac);
    let off = |pair: &Pair| (view.modes.frequency_hz[pair.model] / measured[pair.measured].frequency_hz).ln().abs();
    let is_stranger = |pair: &Pair| {
        let is_stated = measured[pair.measured].stated.is_some();
        !is_stated && likeness(pair).is_some_and(|mac| mac < UNLIKE) && off(pair) > FAR_OFF
    };
    let badness = |pair: &&Pair| off(pair) * (1.0 - likeness(pair).unwrap_or(1.0));
    let mut strangers: Vec<&Pair> = pairs.iter().filter(|pair| is_stranger(pair)).collect();
    strangers.sort_by(|a, b| badness(b).total_cmp(&badness(a)));
    let strangers: Vec<usize> =
        strangers.into_iter().take(pairs.len() / PAIRS_TO_ONE_STRANGER).map(|pair| pair.measured).collect();
    pairs.retain(|pair| !strangers.contains(&pair.measured));
    pairs
}

/// The imaginary part of a shape may be this share of the whole, without the node where it is largest: one late clock is an
/// effect; more means two modes, or noise, taken for one mode.
const COMPLEX: f64 = 0.2;

fn has_real_shape(mode: &MeasuredMode, sensors: &[Sensor]) -> bool {
    let Some((shape, imaginary)) = mode.shape.as_ref().and_then(|shape| Some((shape, shape.imaginary.as_ref()?)))
    else {
        return true;
    };
    let whole = shape.values.norm_squared() + imaginary.norm_squared();
    let of_node = |node: Option<u16>| -> f64 {
        let squares = shape.sensors.iter().zip(imaginary.iter());
        let there = squares.filter(|(sensor, _)| {
            node.is_none_or(|node| sensors.get(**sensor).is_some_and(|sensor| sensor.node == node))
        });
        there.map(|(_, imaginary)| imaginary * imaginary).sum()
    };
    let worst = sensors.iter().map(|sensor| of_node(Some(sensor.node))).fold(0.0, f64::max);
    of_node(None) - worst < COMPLEX * whole
}

/// A twin's frequency differs by less than this (ln f), as a damper of a fifth of the mode's mass makes it.
pub(super) const TWIN_WITHIN: f64 = 0.45;
/// This share of a twin's shape is that of modes that have a partner.
const LIKE_A_TWIN: f64 = 0.8;

/// Whether a mode moves as others near it do, so that a damper could have made two of one.
fn is_twin(mode: &MeasuredMode, paired: &[MeasuredMode]) -> bool {
    let Some(shape) = &mode.shape else { return false };
    let near = |other: &&MeasuredMode| (mode.frequency_hz / other.frequency_hz).ln().abs() < TWIN_WITHIN;
    let shapes: Vec<DVector<f64>> = paired
        .iter()
        .filter(near)
        .filter_map(|other| other.shape.as_ref())
        .filter(|other| other.sensors == shape.sensors)
        .map(|other| other.values.normalize())
        .collect();
    if shapes.is_empty() || shapes.len() >= shape.sensors.len() {
        return false;
    }
    let across = complement(&DMatrix::from_columns(&shapes));
    across.is_some_and(|across| {
        across.tr_mul(&shape.values).norm_squared() < (1.0 - LIKE_A_TWIN) * shape.values.norm_squared()
    })
}

/// A mode within this share of a driving frequency is not a mode, or the line in its peak moves it.
const FORCED: f64 = 0.05;

fn is_forced(mode: &MeasuredMode, forced_hz: f64) -> bool {
    (mode.frequency_hz / forced_hz - 1.0).abs() < FORCED
}

/// Phases scatter with longer tails than their median tells, where a late clock takes the lines of a node from other moments: with it in
/// the model, a tower of the blind bench whose node is 0.1 s late has p = 0.017 with this allowance, and fails without.
const LONG_TAILS: f64 = std::f64::consts::SQRT_2;
/// Least deviation of an imaginary part, in shares of the shape's length: without it the delay of a clock that is 0.1 s late is 5.6
/// stated deviations off.
const PHASE_FLOOR: f64 = 2e-3;

/// The imaginary part of a shape. Damping that is not spread as mass and stiffness are makes shapes a little complex
/// everywhere, so deviations are raised to what most sensors of the mode show; a clock that is off stands out at few.
fn phases(mode: usize, measured: &[MeasuredMode]) -> Option<MeasuredPhases> {
    let shape = measured[mode].shape.as_ref()?;
    let length = shape.values.norm();
    let imaginary = shape.imaginary.as_ref()? / length;
    let deviations = DVector::from_vec(shape_deviations(shape)).map(|deviation| deviation.max(PHASE_FLOOR));
    let mut ratios: Vec<f64> = imaginary.iter().zip(deviations.iter()).map(|(im, std)| im.abs() / std).collect();
    let typical = median(&mut ratios)? / MEDIAN_OF_ABSOLUTE;
    Some(MeasuredPhases { mode, imaginary, deviations: deviations * (typical.max(1.0) * LONG_TAILS) })
}
