//! Whether the model's errors fall when an effect is added.
//!
//! What is probable and what helps can differ: the tolerance of a table lets segments scatter, and a scatter that stands against an effect
//! can hide that it does nothing for the model that the reader has. An effect and the present model flow in, each without any scatter; how
//! much of the present model's differences is left flows out.

use super::discrepancy::Discrepancy;
use super::fit::Fit;
use super::found::Found;
use super::misfit::Loss;
use super::problem::Problem;
use crate::model::effect::Effect;

impl Problem {
    /// What is left of the differences with an effect as it was found, as a share of those without it. `None` where one of the models
    /// cannot be solved.
    pub(super) fn left_with(&self, present: &Fit, found: &Found) -> Option<[f64; 5]> {
        let own = found.own();
        let differences = |effects: &[Effect], discrepancy: &Discrepancy| -> Option<[f64; 4]> {
            let state = self.with_discrepancy(*discrepancy).state_without_scatter(effects).ok()?;
            let frequencies: Vec<f64> = state.residual.blocks().map(|(_, block)| block.residual[0]).collect();
            let mean = frequencies.iter().map(|x| x.abs()).sum::<f64>() / frequencies.len() as f64;
            let squares: f64 = state.residual.blocks().map(|(first, _)| state.modes[first].powi(2)).sum();
            Some([state.misfit(Loss::Squares), state.misfit(Loss::Robust), mean, squares])
        };
        let (a, b) = (differences(own.effects(), &own.discrepancy)?, differences(present.effects(), &own.discrepancy)?);
        Some([a[0] / b[0], a[1] / b[1], 100.0 * b[2], 100.0 * a[2], a[3] / b[3]])
    }
}
