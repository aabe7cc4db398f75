//! The search for a tuned mass damper, which no derivative at the present model leads to: it adds modes.
//!
//! Its frequency and mass are first guessed from modes that move like others near them, from pairs of modes that are further
//! apart than the model's, or from modes with far more damping than the rest; then they are fitted like those of any effect.

use std::collections::BTreeMap;

use nalgebra::DVector;
use rayon::prelude::*;

use super::criteria::STANDS_OUT;
use super::fit::Fit;
use super::found::{AtHeight, Found, HeightSpread, NEAR};
use super::knob::Knob;
use super::misfit::Loss;
use super::problem::{Problem, TWIN_WITHIN};
use super::state::State;
use crate::model::effect::{Effect, EffectKind, Where};

/// What the measured modes suggest about a damper.
#[derive(Debug, Clone, Copy)]
struct Clue {
    /// The paired mode that it acts on.
    mode: usize,
    frequency_hz: f64,
    /// Its mass over the mode's mass, at its place.
    mass_ratio: f64,
}

impl Clue {
    fn of_twins(mode: usize, mode_hz: f64, twin_hz: f64) -> Self {
        // Tuned to the mode it splits by the root of the mass ratio (Den Hartog 1956, section 3.3).
        let split = (mode_hz / twin_hz).ln();
        Self { mode, frequency_hz: (mode_hz * twin_hz).sqrt(), mass_ratio: split * split }
    }
}

/// A mode with this many times the damping of the median mode is worth a look.
const DAMPED: f64 = 2.5;
/// Dampers have about this share of a mode's mass.
const MASS_RATIO: f64 = 0.01;
/// Modes that lie this close together in the model (ln f) are a pair: round and square structures have them.
const PAIR: f64 = 0.1;
/// A pair that is further apart than the model's by this (ln f) may be a pair of twins, each seen in one direction.
const SPLIT: f64 = 0.03;
/// Clues closer than this (ln f) point to the same damper.
const SAME: f64 = 0.15;
const MOST_CLUES: usize = 2;
/// Factors on the clue's numbers from which fits may start, and the damping ratio.
const FREQUENCIES: [f64; 3] = [0.95, 1.0, 1.05];
const MASSES: [f64; 2] = [0.6, 1.6];
const DAMPING_RATIO: f64 = 0.05;
/// Starts that are fitted.
const FITTED: usize = 2;
/// A damper hangs where the mode moves by at least this share of its largest motion, squared.
const MOVES: f64 = 0.02;
/// Heights from which fits may start.
const HEIGHTS: usize = 8;
/// A damper is tuned to within this of what it acts on (ln f).
const TUNED: f64 = 0.2;
/// No damper has a larger share of a mode's mass, nor more damping than is best with such a share:
/// `sqrt(3 mu / 8 (1 + mu))` (Den Hartog 1956, section 3.3).
const MOST_MASS_RATIO: f64 = 0.33;
const MOST_DAMPING: f64 = 0.31;
/// With less damping it is a part of the structure that swings by itself.
const LEAST_DAMPING: f64 = 1e-4;
/// Within this share of its range a value is at the range's end.
const AT_A_BOUND: f64 = 1e-3;
/// The first step from height to height is this share of all.
const STEPS: usize = 4;
/// Evidence that differs by less than this is alike.
const ALIKE: f64 = 0.1;

impl Problem {
    /// The damper that explains most, at its best place or at `height`; `None` where nothing hints at one, or no twin does where only
    /// those count.
    pub(super) fn search_damper(
        &self,
        present: &Fit,
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
        by_twins_only: bool,
    ) -> Option<Found> {
        let clues = self.clues(present, by_twins_only).into_iter();
        let found = clues.filter_map(|clue| Hanging::of(self, present, kind, clue, place)?.found());
        found.max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor))
    }

    /// Twins first, then pairs that are too far apart, then modes with much damping.
    fn clues(&self, present: &Fit, by_twins_only: bool) -> Vec<Clue> {
        let mut clues: Vec<Clue> = Vec::new();
        let mut add = |clue: Clue| {
            if clues.iter().all(|other| (clue.frequency_hz / other.frequency_hz).ln().abs() > SAME) {
                clues.push(clue);
            }
        };
        for twin in self.measured.iter().skip(self.paired) {
            let likeness = |mode: usize| {
                let (shape, other) = (twin.shape.as_ref()?, self.measured[mode].shape.as_ref()?);
                let cosine = shape.values.normalize().dot(&other.values.normalize());
                let apart = (twin.frequency_hz / self.measured[mode].frequency_hz).ln().abs();
                (shape.sensors == other.sensors).then_some((mode, cosine * cosine - apart))
            };
            let like = (0..self.paired).filter_map(likeness).max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((mode, _)) = like {
                add(Clue::of_twins(mode, self.measured[mode].frequency_hz, twin.frequency_hz));
            }
        }
        if by_twins_only {
            clues.truncate(MOST_CLUES);
            return clues;
        }
        // Identification may merge the two modes of a pair on either side of the split; then every mode has a partner. Segments that are bent
        // to stand in for the damper have moved the model's pair apart, so it is looked up without them.
        let unbent = self.state_without_scatter(present.effects()).ok();
        let unbent = unbent.as_ref().unwrap_or(&present.state);
        for mode in 0..self.paired {
            for other in 0..mode {
                let [mode_hz, other_hz] = [mode, other].map(|mode| self.measured[mode].frequency_hz);
                let [model_hz, other_model_hz] = [mode, other].map(|mode| unbent.frequency_of(mode));
                let (Some(model_hz), Some(other_model_hz)) = (model_hz, other_model_hz) else { continue };
                let (apart, in_model) = ((mode_hz / other_hz).ln().abs(), (model_hz / other_model_hz).ln().abs());
                if in_model < PAIR && apart > in_model + SPLIT && apart < TWIN_WITHIN {
                    add(Clue::of_twins(mode, mode_hz, other_hz));
                }
            }
        }
        // A damper moves modes as well as damping them: where all modes are where they should be, there is no damper.
        if present.passes() {
            clues.truncate(MOST_CLUES);
            return clues;
        }
        let ratio = |mode: usize| self.measured[mode].damping_ratio.unwrap_or(0.0);
        let mut by_damping: Vec<usize> = (0..self.paired).collect();
        by_damping.sort_by(|&a, &b| ratio(b).total_cmp(&ratio(a)));
        let middle = by_damping.get(self.paired / 2).map_or(0.0, |&mode| ratio(mode));
        for mode in by_damping.into_iter().take_while(|&mode| middle > 0.0 && ratio(mode) > DAMPED * middle) {
            add(Clue { mode, frequency_hz: self.measured[mode].frequency_hz, mass_ratio: MASS_RATIO });
        }
        clues.truncate(MOST_CLUES);
        clues
    }
}

/// The damper that a clue suggests, and where it could hang.
struct Hanging<'a> {
    problem: &'a Problem,
    present: &'a Fit,
    kind: &'static dyn EffectKind,
    clue: Clue,
    /// How many heights were considered.
    heights: usize,
    /// Those at which the mode moves, and its squared motion there: a mass of one over it is the mode's.
    places: Vec<(f64, f64)>,
}

impl<'a> Hanging<'a> {
    fn of(
        problem: &'a Problem,
        present: &'a Fit,
        kind: &'static dyn EffectKind,
        clue: Clue,
        place: Option<&Where>,
    ) -> Option<Self> {
        let state = &present.state;
        let shape = state.model.view.modes.shapes.column(state.pairs.get(clue.mode)?.model);
        let heights = match place {
            Some(Where::Height(z_m)) => vec![*z_m],
            _ => problem.heights_m(),
        };
        let motion = |&z_m: &f64| (z_m, (state.model.assembly.axis_motion(z_m).rows(0, 2) * shape).norm_squared());
        let mut places: Vec<(f64, f64)> = heights.iter().map(motion).collect();
        let most = places.iter().map(|place| place.1).fold(0.0, f64::max);
        places.retain(|place| place.1 > MOVES * most);
        Some(Self { problem, present, kind, clue, heights: heights.len(), places })
    }

    /// A structure with the damper besides the effects of a fit, its segments scattered by these numbers; `near` is one with such a damper
    /// elsewhere.
    fn state(
        &self,
        z_m: f64,
        values: &[f64],
        (like, numbers): (&Fit, &DVector<f64>),
        near: Option<&State>,
    ) -> Option<State> {
        let parameters = *self.kind.parameter_sets().iter().find(|set| set.len() == values.len())?;
        let damper = Effect::with_parameters(self.kind, Some(Where::Height(z_m)), parameters, values).ok()?;
        let mut effects = like.state.effects[..self.present.state.effects.len()].to_vec();
        effects.push(damper);
        self.problem.state(effects, numbers.clone(), near).ok()
    }

    fn motion(&self, z_m: f64) -> Option<f64> {
        self.places.iter().find(|place| place.0 == z_m).map(|place| place.1)
    }

    /// Fits within the values that the suggested damper may have; `None` where values outside would fit better.
    fn fit(&self, state: &State) -> Option<Fit> {
        let bounds = self.bounds(state);
        let narrow = |knob: &mut Knob| {
            if let Some(bounds) = bounds.get(knob.parameter) {
                knob.bounds = *bounds;
            }
        };
        let fit = self.problem.fit_with_one_more(self.present, state, &narrow)?;
        let mut values = damper_values(&fit).into_iter().zip(bounds);
        let is_within = |(value, [least, greatest]): (f64, [f64; 2])| {
            let margin = AT_A_BOUND * (greatest - least);
            value > least + margin && value < greatest - margin
        };
        values.all(is_within).then_some(fit)
    }

    /// Of mass, frequency and damping ratio: with other numbers it is a mass and a spring that explain something else.
    fn bounds(&self, state: &State) -> [[f64; 2]; 3] {
        let motion = match state.effects.last().and_then(Effect::place) {
            Some(Where::Height(z_m)) => self.motion(*z_m),
            _ => None,
        };
        let most_kg = motion.map_or(f64::INFINITY, |motion| MOST_MASS_RATIO / motion);
        let frequency = [-TUNED, TUNED].map(|by| self.clue.frequency_hz * by.exp());
        [[0.0, most_kg], frequency, [LEAST_DAMPING, MOST_DAMPING]]
    }

    /// From several places and numbers.
    fn best_of_starts(&self) -> Option<Fit> {
        let mut grid = Vec::new();
        for (z_m, motion) in self.places.iter().rev().step_by(self.places.len().div_ceil(HEIGHTS).max(1)) {
            for frequency in FREQUENCIES {
                let mass_kg = |share: f64| share * self.clue.mass_ratio / motion;
                let frequency_hz = frequency * self.clue.frequency_hz;
                grid.extend(MASSES.map(|share| (*z_m, [mass_kg(share), frequency_hz, DAMPING_RATIO])));
            }
        }
        // Where the present model does not pass, its segments were bent to stand in for the damper.
        let bent = &self.present.state.numbers;
        let straight = bent.map(|_| 0.0);
        let mut starts: Vec<State> = Vec::new();
        for numbers in [bent, &straight].into_iter().take(if self.present.passes() { 1 } else { 2 }) {
            let start = |(z_m, values): &(f64, [f64; 3]), near: Option<&State>| {
                self.state(*z_m, values, (self.present, numbers), near)
            };
            let first = start(grid.first()?, None);
            starts.par_extend(grid[1..].par_iter().filter_map(|place| start(place, first.as_ref())));
            starts.extend(first);
        }
        starts.sort_by(|a, b| a.misfit(Loss::Robust).total_cmp(&b.misfit(Loss::Robust)));
        starts.truncate(FITTED);
        let both = better(starts.par_iter().filter_map(|state| self.fit(state)).collect())?;
        // It may move in one direction only.
        let (z_m, values) = (damper_height_m(&both)?, damper_values(&both));
        let one_way = [1.0, 2.0].par_iter().filter_map(|axis| {
            let values = [&values[..], &[*axis]].concat();
            self.fit(&self.state(z_m, &values, (&both, &both.state.numbers), None)?)
        });
        let mut fits: Vec<Fit> = one_way.collect();
        fits.push(both);
        better(fits)
    }

    /// A state elsewhere, with the mass that acts on the mode alike.
    fn moved(&self, fit: &Fit, (z_m, motion): (f64, f64)) -> Option<State> {
        let mut values = damper_values(fit);
        *values.first_mut()? *= self.motion(damper_height_m(fit)?)? / motion;
        self.state(z_m, &values, (fit, &fit.state.numbers), Some(&fit.state))
    }

    /// From height to height while the evidence rises, in steps that get shorter; the best fit, and all by index of the
    /// place.
    fn climb(&self, first: Fit) -> Option<(Fit, BTreeMap<usize, AtHeight>)> {
        let first_m = damper_height_m(&first)?;
        let mut at = self.places.iter().position(|place| place.0 == first_m)?;
        let mut best = first;
        let mut known = BTreeMap::from([(at, AtHeight::of(&best)?)]);
        let mut step = self.places.len().div_ceil(STEPS);
        loop {
            let beside = [at.saturating_sub(step), (at + step).min(self.places.len() - 1)];
            let next: Vec<usize> = beside.into_iter().filter(|index| !known.contains_key(index)).collect();
            let fits: Vec<(usize, Fit)> = next
                .par_iter()
                .filter_map(|&index| Some((index, self.fit(&self.moved(&best, self.places[index])?)?)))
                .collect();
            known.extend(fits.iter().filter_map(|(index, fit)| Some((*index, AtHeight::of(fit)?))));
            let higher = fits.into_iter().max_by(|a, b| a.1.log_evidence().total_cmp(&b.1.log_evidence()));
            let reached = best.log_evidence();
            match higher.filter(|(_, fit)| fit.log_evidence() > reached) {
                Some(higher) => (at, best) = higher,
                None => {
                    let is_alike =
                        |index: &usize| known.get(index).is_some_and(|known| reached - known.log_evidence < ALIKE);
                    if step == 1 || beside.iter().all(is_alike) {
                        return Some((best, known));
                    }
                    step = step.div_ceil(2);
                }
            }
        }
    }

    fn found(&self) -> Option<Found> {
        let first = self.best_of_starts()?;
        if first.log_evidence() - self.present.log_evidence() < STANDS_OUT {
            return None;
        }
        let (best, known) = self.climb(first)?;
        let best_m = damper_height_m(&best)?;
        let reached = best.log_evidence();
        let below: Vec<(f64, f64)> = self
            .places
            .iter()
            .enumerate()
            .map(|(index, place)| (place.0, reached - between(&known, index, &|known| known.log_evidence)))
            .collect();
        let weights: Vec<f64> = below.iter().map(|(_, below)| (-below).exp()).collect();
        let sum: f64 = weights.iter().sum();
        // Within its step of the grid it may be anywhere.
        let step_m = match (self.places.first(), self.places.last()) {
            (Some(first), Some(last)) => (last.0 - first.0) / (self.places.len().max(2) - 1) as f64,
            _ => 0.0,
        };
        let mean_square = |at: &dyn Fn(usize) -> f64| -> f64 {
            weights.iter().enumerate().map(|(index, weight)| weight * at(index).powi(2)).sum::<f64>() / sum
        };
        let std_m = mean_square(&|index| self.places[index].0 - best_m).sqrt().hypot(step_m / 12.0_f64.sqrt());
        let best_values = damper_values(&best);
        let spread = |(parameter, here): (usize, &f64)| {
            let there = |known: &AtHeight| known.values.get(parameter).copied().unwrap_or(*here);
            mean_square(&|index| between(&known, index, &there) - here).sqrt()
        };
        let values = best_values.iter().enumerate().map(spread).collect();
        // The lowest and the highest place that do nearly as well say between which it hangs.
        let alike = |place: &&(f64, f64)| place.1 < NEAR;
        let ends = [below.iter().find(alike), below.iter().rev().find(alike)];
        let near = ends.into_iter().flatten().filter(|place| place.0 != best_m);
        let near = near.map(|&(z_m, below)| (Where::Height(z_m), below)).collect();
        Some(Found {
            kind: self.kind,
            fit: best,
            log_bayes_factor: reached - self.present.log_evidence() + (sum / self.heights as f64).ln(),
            hypotheses: self.heights,
            log_share: (sum / self.heights as f64).ln(),
            near,
            height: (self.places.len() > 1).then_some(HeightSpread { std_m, values }),
            known: Vec::new(),
            own: None,
            left: None,
            helps: true,
        })
    }
}

/// A value at an index, on the straight line between the nearest that are known; beyond them, the nearest.
fn between(known: &BTreeMap<usize, AtHeight>, index: usize, value: &dyn Fn(&AtHeight) -> f64) -> f64 {
    let (low, high) = (known.range(..=index).next_back(), known.range(index..).next());
    match (low, high) {
        (Some((low, at_low)), Some((high, at_high))) if low < high => {
            let share = (index - low) as f64 / (high - low) as f64;
            value(at_low) + share * (value(at_high) - value(at_low))
        }
        _ => low.or(high).map_or(0.0, |(_, at)| value(at)),
    }
}

fn better(fits: Vec<Fit>) -> Option<Fit> {
    fits.into_iter().max_by(|a, b| a.log_evidence().total_cmp(&b.log_evidence()))
}

/// Where the damper hangs that was fitted last.
fn damper_height_m(fit: &Fit) -> Option<f64> {
    match fit.state.effects.last()?.place() {
        Some(Where::Height(z_m)) => Some(*z_m),
        _ => None,
    }
}

/// The numbers of the damper that was fitted last.
fn damper_values(fit: &Fit) -> Vec<f64> {
    fit.state.effects.last().map_or_else(Vec::new, |damper| damper.parameters().map(|(_, value)| value).collect())
}
