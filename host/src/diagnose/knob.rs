//! Knobs: the numbers of effects that a fit turns.
//!
//! Effects and new values of some of their parameters flow in, effects with these values flow out; a knob also says in which
//! unit, between which bounds and with which step its number is fitted.

use crate::model::effect::Effect;

/// One fitted number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Knob {
    /// Index of its effect.
    pub(super) effect: usize,
    /// Index of the parameter.
    pub(super) parameter: usize,
    /// The value at which the effect is not there.
    pub(super) neutral: f64,
    /// Its prior scale: the unit of the fit.
    pub(super) scale: f64,
    /// The step of derivatives, in the parameter's unit.
    pub(super) step: f64,
    /// Bounds, in the parameter's unit.
    pub(super) bounds: [f64; 2],
}

impl Knob {
    /// Whether a value stands at a bound.
    pub(super) fn is_at(&self, value: f64, bound: f64) -> bool {
        bound.is_finite() && (value - bound).abs() <= 1e-9 * self.scale.max(bound.abs())
    }
}

/// Effects with some of their values changed.
pub(super) fn with_values(effects: &[Effect], knobs: &[Knob], values: &[f64]) -> Vec<Effect> {
    let mut effects = effects.to_vec();
    for (knob, value) in knobs.iter().zip(values) {
        if let Some(effect) = effects.get_mut(knob.effect) {
            let mut all: Vec<f64> = effect.parameters().map(|(_, value)| value).collect();
            if let Some(slot) = all.get_mut(knob.parameter) {
                *slot = *value;
            }
            *effect = effect.with_values(&all);
        }
    }
    effects
}
