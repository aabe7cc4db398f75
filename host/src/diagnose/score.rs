//! What every candidate would explain, by one linear step from the present model.
//!
//! Candidates and a fit flow in; the gain in evidence of each, and the values it would have, flow out.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::candidates::{Candidate, Options};
use super::discrepancy::log_determinant;
use super::fit::{Fit, Marginal, prior_misfit};
use super::knob::{Knob, with_values};
use super::misfit::Loss;
use super::near::Near;
use super::problem::Problem;
use super::state::State;
use crate::model::effect::{EffectKind, Evidence, KINDS, Parameter};

/// A candidate and what it would explain, by one linear step from the present model.
pub(super) struct Scored {
    pub(super) candidate: Candidate,
    /// Gain in the logarithm of the evidence.
    pub(super) gain: f64,
    pub(super) knobs: Vec<Knob>,
    /// The values that the linear step gives.
    pub(super) values: Vec<f64>,
    /// Whether the linear step stays inside the bounds.
    pub(super) admissible: bool,
}

/// A candidate at a fit: the numbers of it that are fitted, and how the differences follow them (in units of their scale), before they
/// are weighed; `None` for one that is there or not.
struct Direction {
    candidate: Candidate,
    shown: Option<(Vec<Knob>, DMatrix<f64>)>,
}

/// Candidates at a fit, kind by kind. They can be scored with any discrepancy.
pub(super) struct Sighting<'a> {
    near: Near<'a>,
    kinds: Vec<Vec<Direction>>,
}

/// The candidates of one kind after the other, for a fit.
pub(super) type CandidatesOf<'a> = dyn Fn(&Fit) -> Vec<Vec<Candidate>> + Sync + 'a;

impl Problem {
    /// Every candidate that derivatives lead to.
    pub(super) fn all_candidates(&self, present: &Fit, options: &Options) -> Vec<Vec<Candidate>> {
        let kinds: Vec<&'static dyn EffectKind> =
            KINDS.iter().copied().filter(|kind| shows_by_derivative(*kind) && !options.leaves_out(*kind)).collect();
        kinds.par_iter().map(|kind| self.candidates(*kind, present)).collect()
    }

    /// Candidates at a fit, and at the model as it is `given` without scatter: where the background was bent far to make up for an
    /// effect, the effect may seem to have the wrong sign.
    pub(super) fn sightings<'a>(
        &self,
        present: &'a Fit,
        given: Option<&'a Fit>,
        candidates: &CandidatesOf<'_>,
    ) -> Vec<Sighting<'a>> {
        let mut sightings: Vec<Sighting<'a>> = vec![self.sighting(present, candidates(present), None)];
        if let Some(given) = given {
            sightings.push(self.sighting(given, candidates(given), sightings.first()));
        }
        sightings
    }

    /// Candidates at a fit; steps and scales are those that are `known` from another.
    fn sighting<'a>(
        &self,
        fit: &'a Fit,
        candidates: Vec<Vec<Candidate>>,
        known: Option<&Sighting<'_>>,
    ) -> Sighting<'a> {
        // Neighbours after each other.
        let of_kind = |(kind, candidates): (usize, Vec<Candidate>)| -> Vec<Direction> {
            let mut guesses: Vec<f64> = Vec::new();
            let known = known.and_then(|known| known.kinds.get(kind)).map_or(&[][..], Vec::as_slice);
            let direction = |candidate: Candidate| {
                self.tally.one();
                let known = known.iter().find(|known| known.candidate.is_same(&candidate));
                let knobs = known.and_then(|known| known.shown.as_ref()).map(|(knobs, _)| knobs.as_slice());
                let shown = match candidate.parameters.iter().any(Parameter::is_fitted) {
                    true => Some(self.columns_of(fit, &candidate, knobs, &mut guesses)?),
                    false => None,
                };
                Some(Direction { candidate, shown })
            };
            candidates.into_iter().filter_map(direction).collect()
        };
        self.tally.stage("effects at every place", candidates.iter().map(Vec::len).sum());
        let kinds = candidates.into_par_iter().enumerate().map(of_kind).collect();
        Sighting { near: Near::of(self, fit), kinds }
    }

    /// Scores every candidate by one linear step, `T = gᵀ P r` over `gᵀ P g` in several dimensions, with this problem's discrepancy. The
    /// better score of those from several fits counts.
    pub(super) fn scored(&self, sightings: &[Sighting<'_>]) -> Vec<Scored> {
        let mut scored = Vec::new();
        for sighting in sightings {
            merge(&mut scored, self.score(sighting));
        }
        scored
    }

    fn score(&self, sighting: &Sighting<'_>) -> Vec<Scored> {
        let (near, fit) = (&sighting.near, sighting.near.fit);
        let Some(marginal) = near.marginal(self) else { return Vec::new() };
        let Ok(here) = self.state_like(&fit.state, self.carried(fit)) else { return Vec::new() };
        let of_candidate = |direction: &Direction| match &direction.shown {
            Some((knobs, columns)) => {
                let mut columns = columns.clone();
                fit.state.whiten_by(&marginal.factors, &mut columns);
                score_one(&marginal, &direction.candidate, knobs, &columns)
            }
            None => self.score_discrete(&here, &direction.candidate),
        };
        sighting.kinds.par_iter().flatten().filter_map(of_candidate).collect()
    }

    /// The numbers of a candidate that are fitted (those that are `known`, or else found), and how the differences follow them at the
    /// present state, in units of their scale and before they are weighed. `guesses` are steps that served a neighbour; those that serve
    /// this candidate take their place.
    pub(super) fn columns_of(
        &self,
        present: &Fit,
        candidate: &Candidate,
        known: Option<&[Knob]>,
        guesses: &mut Vec<f64>,
    ) -> Option<(Vec<Knob>, DMatrix<f64>)> {
        let effect = candidate.effect(&candidate.neutral())?;
        let mut effects = present.state.effects.clone();
        effects.push(effect);
        let index = effects.len() - 1;
        // At its neutral values the effect changes nothing, so the present state serves.
        let knobs = match known {
            Some(knobs) => knobs.to_vec(),
            None => present.state.knobs(self, &effects, index, guesses)?,
        };
        let structure_at = |knob: &Knob, value: f64| {
            let effects = with_values(&effects, std::slice::from_ref(knob), &[value]);
            self.structure_with(&effects, &present.state.numbers)
        };
        let columns: Option<Vec<DVector<f64>>> = knobs
            .iter()
            .map(|knob| {
                let structure = structure_at(knob, knob.neutral + knob.step)?;
                Some(present.state.towards(self, &structure, knob.step)? * knob.scale)
            })
            .collect();
        *guesses = knobs.iter().map(|knob| knob.step).collect();
        Some((knobs, DMatrix::from_columns(&columns?)))
    }

    /// An effect that is there or not, at a state.
    fn score_discrete(&self, here: &State, candidate: &Candidate) -> Option<Scored> {
        let mut effects = here.effects.clone();
        effects.push(candidate.effect(&[])?);
        let there = self.state(effects, here.numbers.clone(), Some(here)).ok()?;
        let gain = 0.5 * (here.misfit(Loss::Robust) - there.misfit(Loss::Robust));
        Some(Scored { candidate: candidate.clone(), gain, knobs: Vec::new(), values: Vec::new(), admissible: true })
    }
}

fn score_one(marginal: &Marginal, candidate: &Candidate, knobs: &[Knob], columns: &DMatrix<f64>) -> Option<Scored> {
    let columns = marginal.weigh(columns);
    let projected = marginal.project(&columns);
    let information = columns.tr_mul(&projected);
    if !is_seen(&information, &columns) {
        return None;
    }
    let gradient = columns.tr_mul(&marginal.left);
    let (linear, gain) = LinearStep::of(information.clone())?.against(knobs, &gradient)?;
    let (units, steeper) = enlarged(candidate, knobs, &linear, information);
    if !units.iter().all(|units| units.is_finite()) {
        return None;
    }
    let gain = match steeper {
        Some(steeper) => {
            let with_prior = Cholesky::new(&steeper + DMatrix::identity(knobs.len(), knobs.len()))?;
            let prior: f64 = units.iter().map(|&units| prior_misfit(units)).sum();
            0.5 * (-gradient.dot(&linear) - log_determinant(&with_prior) - prior)
        }
        None => gain,
    };
    let admissible = is_admissible(knobs, &units);
    let values = knobs
        .iter()
        .zip(units.iter())
        .map(|(knob, units)| (knob.neutral + units * knob.scale, knob.bounds))
        .map(|(value, bounds)| if admissible { value.clamp(bounds[0], bounds[1]) } else { value });
    let mut all = candidate.neutral();
    for (knob, value) in knobs.iter().zip(values) {
        all[knob.parameter] = value;
    }
    Some(Scored { candidate: candidate.clone(), gain, knobs: knobs.to_vec(), values: all, admissible })
}

/// Where parameters act by a power of themselves: the values that a linear step stands for, and the information there. The step stands for
/// a slope that is zero where the effect is not there: so far does the same change take the value, and there the slope is as much steeper.
fn enlarged(
    candidate: &Candidate,
    knobs: &[Knob],
    linear: &DVector<f64>,
    mut information: DMatrix<f64>,
) -> (DVector<f64>, Option<DMatrix<f64>>) {
    let mut units = linear.clone();
    let mut is_enlarged = false;
    for (at, knob) in knobs.iter().enumerate().filter(|(_, knob)| candidate.parameters[knob.parameter].power > 1) {
        is_enlarged = true;
        let step = knob.step / knob.scale;
        let parameter = &candidate.parameters[knob.parameter];
        units[at] = units[at].signum() * parameter.enlarged(step, units[at] / step);
        let steeper = f64::from(parameter.power) * (units[at] / step).abs().powi(i32::from(parameter.power) - 1);
        information.row_mut(at).scale_mut(steeper);
        information.column_mut(at).scale_mut(steeper);
    }
    (units, is_enlarged.then_some(information))
}

/// What one linear step along some directions gains.
pub(super) struct LinearStep {
    information: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    /// Of the information with that of the prior.
    log_determinant: f64,
}

impl LinearStep {
    /// Along directions with this information, in units of their scales; `None` where they are not independent.
    pub(super) fn of(information: DMatrix<f64>) -> Option<Self> {
        let size = information.nrows();
        let with_prior = Cholesky::new(&information + DMatrix::identity(size, size))?;
        let factor = Cholesky::new(information.clone())?;
        Some(Self { log_determinant: log_determinant(&with_prior), information, factor })
    }

    /// Covariance of the values, in units of their scales, without their prior.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        self.factor.inverse()
    }

    /// The values that the step leads to, and the gain in the logarithm of the evidence, where the misfit has this gradient.
    ///
    /// Of several values, those that it would take below where the effect is not there stay there, and the others lead: guys along one
    /// direction are no guys of the wrong sign along the other. Where none is left to lead, the values are those of the step as it is.
    pub(super) fn against(&self, knobs: &[Knob], gradient: &DVector<f64>) -> Option<(DVector<f64>, f64)> {
        let mut units = self.factor.solve(&-gradient);
        let is_below =
            |at: &usize, units: &DVector<f64>| units[*at] < 0.0 && knobs[*at].bounds[0] >= knobs[*at].neutral;
        let mut free: Vec<usize> = (0..knobs.len()).collect();
        while free.iter().any(|at| is_below(at, &units)) {
            free.retain(|at| !is_below(at, &units));
            if free.is_empty() {
                units = self.factor.solve(&-gradient);
                break;
            }
            let part = Cholesky::new(self.information.select_rows(&free).select_columns(&free))?;
            let leading = part.solve(&-gradient.select_rows(&free));
            units.fill(0.0);
            for (&at, value) in free.iter().zip(leading.iter()) {
                units[at] = *value;
            }
        }
        let prior: f64 = units.iter().map(|&units| prior_misfit(units)).sum();
        let gain = 0.5 * (-gradient.dot(&units) - self.log_determinant - prior);
        Some((units, gain))
    }
}

/// Whether the data see a candidate of this information behind background and other effects; `columns` by weight are what it does.
pub(super) fn is_seen(information: &DMatrix<f64>, columns: &DMatrix<f64>) -> bool {
    (0..columns.ncols()).all(|at| information[(at, at)] >= SEPARATE * columns.column(at).norm_squared())
}

/// Whether values (in units of their scales) are not below their bounds.
pub(super) fn is_admissible(knobs: &[Knob], units: &DVector<f64>) -> bool {
    knobs.iter().zip(units.iter()).all(|(knob, units)| knob.neutral + units * knob.scale >= knob.bounds[0])
}

/// Keeps the better score of each candidate.
fn merge(scored: &mut Vec<Scored>, others: Vec<Scored>) {
    if scored.is_empty() {
        *scored = others;
        return;
    }
    for other in others {
        match scored.iter_mut().find(|one| one.candidate.is_same(&other.candidate)) {
            Some(one) if (one.admissible, one.gain) >= (other.admissible, other.gain) => {}
            Some(one) => *one = other,
            None => scored.push(other),
        }
    }
}

/// Where background and other effects explain all but this share of what a candidate does, the data cannot see it.
const SEPARATE: f64 = 1e-6;

/// Whether the derivative at the model without it leads to an effect.
pub(super) fn shows_by_derivative(kind: &dyn EffectKind) -> bool {
    matches!(kind.evidence(), Evidence::Modes | Evidence::Phases)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn knob(parameter: usize) -> Knob {
        Knob { effect: 0, parameter, neutral: 0.0, scale: 1.0, step: 0.1, bounds: [0.0, f64::INFINITY] }
    }

    /// Least squares of two columns that have a part in common, with values of zero or more.
    #[test]
    fn of_two_values_one_of_the_wrong_sign_stays_at_zero_and_the_other_leads() {
        let information = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 2.0]);
        let knobs = [knob(0), knob(1)];
        let against = |x: f64, y: f64| {
            let step = LinearStep::of(information.clone()).unwrap();
            step.against(&knobs, &-(&information * DVector::from_column_slice(&[x, y]))).unwrap()
        };
        let (units, both) = against(0.7, 3.0);
        assert!((units[0] - 0.7).abs() < 1e-12 && (units[1] - 3.0).abs() < 1e-12);
        // With the first at zero the gradient along the second is 1 * 0.7 less: 2 y = 2 * 3 - 0.7.
        let (units, one) = against(-0.7, 3.0);
        assert!(units[0] == 0.0 && (units[1] - 2.65).abs() < 1e-12, "{units}");
        assert!(is_admissible(&knobs, &units) && one > 0.0 && one < both);
        // Where none has the right sign, the step is told as it is, and refused.
        let (units, _) = against(-0.7, -3.0);
        assert!((units[0] + 0.7).abs() < 1e-12 && (units[1] + 3.0).abs() < 1e-12);
        assert!(!is_admissible(&knobs, &units));
    }
}
