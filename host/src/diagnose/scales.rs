//! The unit and the step with which each of an effect's values is fitted.
//!
//! A [`State`] and effects flow in; [`Knob`]s flow out. Where the catalogue gives a typical shift of frequency instead of a
//! typical value, the value is found that makes this shift.

use std::sync::Mutex;

use super::knob::{Knob, with_values};
use super::problem::{Problem, Reference, Typical};
use super::state::{Modelled, State};
use crate::model::effect::{Effect, Prior, Where};

/// A step moves frequencies by about this.
const SHIFT_OF_STEP: f64 = 1e-4;
const LEAST_SHIFT: f64 = 1e-6;
const GREATEST_SHIFT: f64 = 1e-3;
/// Where a tenth of a step moves more than this share of what the step moves, the step is too long.
const SATURATED: f64 = 0.11;
/// Steps of parameters of a known size, in shares of it.
const SHARE_OF_STEP: f64 = 1e-3;

impl State {
    /// The knobs of one of `effects`, with which the matrices must be those of this state: steps and scales, from `guesses`
    /// (one for each knob, for instance the steps that served a neighbour). `None` where one of them does nothing.
    pub(super) fn knobs(
        &self,
        problem: &Problem,
        effects: &[Effect],
        effect: usize,
        guesses: &[f64],
    ) -> Option<Vec<Knob>> {
        self.knobs_seen(problem, effects, effect, guesses).into_iter().collect()
    }

    /// The same, one for each parameter that is fitted; `None` for one that does nothing.
    pub(super) fn knobs_seen(
        &self,
        problem: &Problem,
        effects: &[Effect],
        effect: usize,
        guesses: &[f64],
    ) -> Vec<Option<Knob>> {
        let custom = match effects[effect].place() {
            Some(Where::Name(name)) => problem.bare.customs.iter().find(|custom| custom.name == *name),
            _ => None,
        };
        let mut knobs: Vec<Option<Knob>> = Vec::new();
        for (index, (parameter, value)) in effects[effect].parameters().enumerate() {
            let guess = guesses.get(knobs.len()).copied().unwrap_or(1.0);
            let mut knob = Knob {
                effect,
                parameter: index,
                neutral: parameter.neutral,
                scale: 1.0,
                step: guess,
                bounds: custom.map_or([parameter.least, parameter.greatest], |custom| custom.range),
            };
            match custom.map_or(parameter.prior, |custom| Prior::Value(custom.typical)) {
                Prior::Given => continue,
                Prior::Share(share) => {
                    (knob.neutral, knob.scale, knob.step) = (value, share * value, SHARE_OF_STEP * value);
                }
                Prior::Value(typical) => (knob.scale, knob.step) = (typical, SHARE_OF_STEP * typical),
                Prior::FrequencyShift(share) => {
                    let typical = problem.typical(&effects[effect], index, guess);
                    // Where an effect is the only one and not there yet, a step that serves the structure as first given serves here, too.
                    let served = typical.filter(|_| effects.len() == 1 && value == parameter.neutral);
                    knob.step = typical.map_or(guess, |typical| typical.step);
                    let found = match served {
                        Some(typical) => Some((typical.step, typical.shift)),
                        None => self.step_that_shifts(problem, effects, &knob, value),
                    };
                    let Some((step, shift)) = found else {
                        knobs.push(None);
                        continue;
                    };
                    let size = typical.map_or_else(|| parameter.enlarged(step, share / shift), |typical| typical.size);
                    (knob.scale, knob.step) = (size, step);
                }
            }
            knobs.push(Some(knob));
        }
        knobs
    }

    /// A step of a knob that moves some frequency by about [`SHIFT_OF_STEP`], and by how much it does.
    fn step_that_shifts(&self, problem: &Problem, effects: &[Effect], knob: &Knob, value: f64) -> Option<(f64, f64)> {
        let mut step = knob.step;
        let shift_at = |step: f64| {
            let effects = with_values(effects, std::slice::from_ref(knob), &[value + step]);
            problem.structure_with(&effects, &self.numbers).map_or(f64::INFINITY, |structure| {
                let Modelled { assembly, view, .. } = self.model.as_ref();
                let shifts = assembly
                    .change_to(&structure.assemble(), 1.0)
                    .map_or_else(Vec::new, |change| view.frequency_derivatives(&self.models, &change));
                shifts.iter().fold(0.0, |most: f64, shift| most.max(shift.abs()))
            })
        };
        for _ in 0..60 {
            let shift = shift_at(step);
            if (LEAST_SHIFT..=GREATEST_SHIFT).contains(&shift) {
                // A spring that is as good as a hinge already moves nothing by another step either.
                if shift_at(0.1 * step) < SATURATED * shift {
                    return Some((step, shift));
                }
                step *= 1e-3;
                continue;
            }
            let factor = SHIFT_OF_STEP / shift;
            step *= if factor.is_finite() { factor.clamp(1e-6, 1e4) } else { 1e4 };
            if !(1e-60..1e60).contains(&step) {
                return None;
            }
        }
        None
    }
}

impl Problem {
    /// The typical size of a parameter that depends on the structure: of the structure as first given, so that an effect weighs
    /// the same wherever a fit starts. `None` where it does nothing there. `guess` is a step that may serve.
    pub(super) fn typical(&self, effect: &Effect, parameter: usize, guess: f64) -> Option<Typical> {
        let known = effect.parameters().nth(parameter)?.0;
        let Prior::FrequencyShift(share) = known.prior else { return None };
        let reference = self.reference()?;
        let name = format!("{effect} {parameter} {}", effect.parameters().len());
        if let Some(typical) = reference.typical.lock().ok()?.get(&name) {
            return *typical;
        }
        let neutral: Vec<f64> = effect.parameters().map(|(parameter, _)| parameter.neutral).collect();
        let alone = [effect.with_values(&neutral)];
        let value = neutral[parameter];
        let bounds = [f64::NEG_INFINITY, f64::INFINITY];
        let knob = Knob { effect: 0, parameter, neutral: value, scale: 1.0, step: guess, bounds };
        let step = reference.state.step_that_shifts(self, &alone, &knob, value);
        let found = step.map(|(step, shift)| Typical { size: known.enlarged(step, share / shift), step, shift });
        reference.typical.lock().ok()?.insert(name, found);
        found
    }

    fn reference(&self) -> Option<&Reference> {
        let make = || {
            let state = self.state_without_scatter(&[]).ok()?;
            Some(Reference { state, typical: Mutex::default() })
        };
        self.reference.get_or_init(make).as_ref()
    }
}
