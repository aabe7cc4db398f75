//! The search for a tuned mass damper, which no derivative at the present model leads to: it adds modes.
//!
//! Modes that move like others near them, or that are damped far more than the rest, say where it is tuned to and how heavy it
//! is; from there its numbers are fitted like those of any effect.

use rayon::prelude::*;

use super::fit::Fit;
use super::problem::Problem;
use super::search::{Found, NEAR};
use super::state::{Loss, State};
use crate::model::effect::{Effect, EffectKind, Where};

/// What the measured modes say of a damper.
#[derive(Debug, Clone, Copy)]
struct Clue {
    /// The paired mode that it acts on.
    mode: usize,
    frequency_hz: f64,
    /// Its mass over the mode's mass, at its place.
    mass_ratio: f64,
}

/// A mode damped this many times as much as the middle one is worth a look.
const DAMPED: f64 = 2.5;
/// Dampers have about this share of a mode's mass.
const MASS_RATIO: f64 = 0.01;
/// Clues closer than this (ln f) are of one damper.
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
/// Another place that promises this much more evidence is fitted.
const WORTH_A_FIT: f64 = 1.0;

impl Problem {
    /// The damper that explains most, at its best place or at `place`; `None` where nothing hints at one.
    pub(super) fn search_damper(
        &self,
        present: &Fit,
        kind: &'static dyn EffectKind,
        place: Option<&Where>,
    ) -> Option<Found> {
        let found = self.clues().into_iter().filter_map(|clue| Hanging::of(self, present, kind, clue, place)?.found());
        found.max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor))
    }

    /// Twins first, then modes that are damped much.
    fn clues(&self) -> Vec<Clue> {
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
                let other_hz = self.measured[mode].frequency_hz;
                // Tuned to the mode it splits by the root of the mass ratio (Den Hartog 1956, section 3.3).
                let split = (twin.frequency_hz / other_hz).ln();
                add(Clue { mode, frequency_hz: (twin.frequency_hz * other_hz).sqrt(), mass_ratio: split * split });
            }
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

/// A damper that a clue speaks of, and where it could hang.
struct Hanging<'a> {
    problem: &'a Problem,
    present: &'a Fit,
    kind: &'static dyn EffectKind,
    clue: Clue,
    /// All heights that were asked about.
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
        let shape = state.view.modes.shapes.column(state.pairs.get(clue.mode)?.model);
        let heights = match place {
            Some(Where::Height(z_m)) => vec![*z_m],
            _ => problem.heights_m(),
        };
        let motion = |&z_m: &f64| (z_m, (state.assembly.axis_motion(z_m).rows(0, 2) * shape).norm_squared());
        let mut places: Vec<(f64, f64)> = heights.iter().map(motion).collect();
        let most = places.iter().map(|place| place.1).fold(0.0, f64::max);
        places.retain(|place| place.1 > MOVES * most);
        Some(Self { problem, present, kind, clue, heights: heights.len(), places })
    }

    /// A structure with the damper besides the effects and the scatter of a fit.
    fn state(&self, z_m: f64, values: &[f64], like: &Fit) -> Option<State> {
        let parameters = *self.kind.parameter_sets().iter().find(|set| set.len() == values.len())?;
        let damper = Effect::with_parameters(self.kind, Some(Where::Height(z_m)), parameters, values).ok()?;
        let mut effects = like.state.effects[..self.present.state.effects.len()].to_vec();
        effects.push(damper);
        self.problem.state(effects, like.state.numbers.clone(), None).ok()
    }

    fn motion(&self, z_m: f64) -> Option<f64> {
        self.places.iter().find(|place| place.0 == z_m).map(|place| place.1)
    }

    fn fit(&self, state: &State) -> Option<Fit> {
        self.problem.fit_with_one_more(self.present, state)
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
        let start = |(z_m, values): &(f64, [f64; 3])| self.state(*z_m, values, self.present);
        let mut starts: Vec<State> = grid.par_iter().filter_map(start).collect();
        starts.sort_by(|a, b| a.misfit(Loss::Robust).total_cmp(&b.misfit(Loss::Robust)));
        starts.truncate(FITTED);
        let both = better(starts.par_iter().filter_map(|state| self.fit(state)).collect())?;
        // It may move in one direction only.
        let (z_m, values) = (damper_height_m(&both)?, damper_values(&both));
        let one_way = [1.0, 2.0].par_iter().filter_map(|axis| {
            let values = [&values[..], &[*axis]].concat();
            self.fit(&self.state(z_m, &values, &both)?)
        });
        let mut fits: Vec<Fit> = one_way.collect();
        fits.push(both);
        better(fits)
    }

    /// A state elsewhere, with the mass that acts on the mode alike.
    fn moved(&self, fit: &Fit, (z_m, motion): (f64, f64)) -> Option<State> {
        let mut values = damper_values(fit);
        *values.first_mut()? *= self.motion(damper_height_m(fit)?)? / motion;
        self.state(z_m, &values, fit)
    }

    fn found(&self) -> Option<Found> {
        let mut best = self.best_of_starts()?;
        let first = damper_height_m(&best)?;
        let cost = |state: &State| 0.5 * (state.misfit(Loss::Robust) + state.numbers.norm_squared());
        let reference = cost(&best.state);
        // What evidence it has elsewhere, below that of the best: what the move costs stands for a fit.
        let mut below: Vec<(f64, f64)> = self
            .places
            .par_iter()
            .filter_map(|&place| match place.0 == first {
                true => Some((place.0, 0.0)),
                false => Some((place.0, cost(&self.moved(&best, place)?) - reference)),
            })
            .collect();
        let promising = below.iter().min_by(|a, b| a.1.total_cmp(&b.1)).filter(|place| place.1 < -WORTH_A_FIT);
        let place = promising.and_then(|promising| self.places.iter().find(|place| place.0 == promising.0));
        if let Some(fit) = place.and_then(|&place| self.fit(&self.moved(&best, place)?))
            && fit.log_evidence() > best.log_evidence()
        {
            let gain = fit.log_evidence() - best.log_evidence();
            below.iter_mut().for_each(|place| place.1 += gain);
            best = fit;
        }
        let best_m = damper_height_m(&best)?;
        let here = |z_m: f64| z_m == best_m;
        for place in &mut below {
            place.1 = if here(place.0) { 0.0 } else { place.1.max(0.0) };
        }
        let sum: f64 = below.iter().map(|(_, below)| (-below).exp()).sum();
        // The lowest and the highest place that do nearly as well say between which it hangs.
        let alike = |place: &&(f64, f64)| place.1 < NEAR;
        let ends = [below.iter().find(alike), below.iter().rev().find(alike)];
        let near = ends.into_iter().flatten().filter(|place| !here(place.0));
        let near = near.map(|&(z_m, below)| (Where::Height(z_m), below)).collect();
        let gain = best.log_evidence() - self.present.log_evidence();
        Some(Found {
            kind: self.kind,
            fit: best,
            log_bayes_factor: gain + (sum / self.heights as f64).ln(),
            near,
            place_std_m: None,
            known: Vec::new(),
        })
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
