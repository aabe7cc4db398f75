//! How much a difference costs: by its square, or less where identification may have got a mode wrong.
//!
//! Squared differences of the numbers of one mode flow in; twice the negative logarithm of their likelihood, and its slope,
//! flow out.
//!
//! What is robust here and elsewhere, with what was measured on 243 modes of 24 cases of the blind bench against their exact modes:
//!
//! | allowance | measurement |
//! |---|---|
//! | one mode in ten has deviations that are wrong by 5 (frequency) or 3 (shape) | 0.8 % of frequencies are off by more than 3 deviations, none by 4; 2 % of whole modes have more than twice the squares. The share is kept above that for records that are not simulated. |
//! | damping scatters by a factor of 1.65 (`evaluation`) | dampings of the bench are drawn from 0.5 to 2 %, 0.40 in the logarithm |
//! | phases at least 1.4 times as large as most sensors of the mode show (`problem`) | without the 1.4 squares have a mean of 0.29 where clocks are right, but a tower with a clock 0.1 s late fails |
//! | phases no surer than 0.2 % of the shape's length (`problem`) | without it the delay of a clock 0.1 s late is 5.6 deviations off |
//! | 2 % of a number's variance is its own (`compare`) | keeps covariances invertible; squares of whole modes have a mean of 0.77 |
//!
//! Gone are floors of 0.02 % and 0.2 % (squares 0.20 with them), 3 % of the bandwidth (frequencies are off by 0.91 deviations rms without),
//! and 11/9 for scattering variances.

use crate::modes::WRONG_BY;

/// Share of modes whose deviations are wrong.
const WRONG: f64 = 0.1;

/// Twice the logarithm of how much likelier a measured mode of its frequency, or of its shape, is where the model has such a
/// mode than where identification made it up: one in a hundred is made up, with a frequency anywhere within a third.
pub(super) const TWIN: f64 = 8.0;

/// How differences count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Loss {
    /// By their squares: far from the best values it leads there.
    Squares,
    /// As [`State::misfit`](super::state::State::misfit) says: near them it says what they are.
    Robust,
}

/// Numbers of one mode whose deviations may be wrong together.
pub(super) struct Group {
    pub(super) first: usize,
    pub(super) count: usize,
    /// By what factor their deviations are wrong, where they are.
    pub(super) wrong_by: f64,
    /// Of a twin, which may also be none.
    pub(super) is_twin: bool,
}

impl Group {
    /// A mode's damping.
    pub(super) fn of_damping() -> Self {
        Self { first: 0, count: 1, wrong_by: WRONG_BY[0], is_twin: false }
    }

    /// Twice the negative logarithm of the likelihood at zero, over that of deviations that are never wrong.
    pub(super) fn offset(&self) -> f64 {
        -2.0 * (1.0 - WRONG + WRONG * self.wrong_by.powi(-(self.count as i32))).ln()
    }

    /// Twice the negative logarithm of the likelihood of squared differences, zero at zero, and its derivative.
    pub(super) fn misfit(&self, square: f64) -> (f64, f64) {
        let variance = self.wrong_by * self.wrong_by;
        // Logarithms of the odds of being wrong, at zero and here.
        let odds = (WRONG / (1.0 - WRONG)).ln() - self.count as f64 * self.wrong_by.ln();
        let here = odds + 0.5 * square * (1.0 - 1.0 / variance);
        let softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
        let share = 1.0 / (1.0 + (-here).exp());
        let (misfit, slope) = (square - 2.0 * (softplus(here) - softplus(odds)), 1.0 - share + share / variance);
        if !self.is_twin {
            return (misfit, slope);
        }
        // exp(-misfit/2) + exp(-TWIN/2): far off it is taken for no mode.
        let none = 0.5 * (misfit - TWIN);
        (misfit - 2.0 * (softplus(none) - softplus(-0.5 * TWIN)), slope / (1.0 + none.exp()))
    }
}
