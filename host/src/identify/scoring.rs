//! Fisher scoring with damping: how all maximum-likelihood fits of modes climb.
//!
//! A start, what the likelihood's slopes are at any parameters, and how a step moves them flow in; the most likely parameters
//! flow out. Steps solve `(F + damping diag F) step = gradient`, F the Fisher information (the damping is that of Levenberg and
//! Marquardt), and count only where they raise the likelihood.

use nalgebra::{DMatrix, DVector};

/// The likelihood near some parameters.
pub(super) struct Slopes {
    /// Its negative logarithm.
    pub(super) objective: f64,
    /// The negative gradient of that.
    pub(super) gradient: DVector<f64>,
    /// The Fisher information.
    pub(super) fisher: DMatrix<f64>,
}

/// How steps are damped, and when they end.
pub(super) struct Schedule {
    /// Damping of the first step.
    pub(super) damping: f64,
    /// Its factor after a step that counts, and after one that does not.
    pub(super) factors: [f64; 2],
    /// Added to the diagonal of F, for parameters that the data do not see.
    pub(super) ridge: f64,
    /// Steps tried at most.
    pub(super) most_steps: usize,
    /// A step that gains less is the last.
    pub(super) least_gain: f64,
}

const LEAST_DAMPING: f64 = 1e-9;
const MOST_DAMPING: f64 = 1e8;

/// The most likely parameters that are reached from `start`; `None` where the start has no likelihood.
pub(super) fn fisher_scoring<P>(
    start: P,
    schedule: &Schedule,
    slopes_at: impl Fn(&P) -> Option<Slopes>,
    moved: impl Fn(&P, &DVector<f64>) -> P,
) -> Option<(P, f64)> {
    let mut here = start;
    let mut slopes = slopes_at(&here)?;
    let mut damping = schedule.damping;
    let [easier, harder] = schedule.factors;
    for _ in 0..schedule.most_steps {
        let mut fisher = slopes.fisher.clone();
        for index in 0..fisher.nrows() {
            fisher[(index, index)] *= 1.0 + damping;
            fisher[(index, index)] += schedule.ridge;
        }
        let Some(step) = fisher.cholesky().map(|factor| factor.solve(&slopes.gradient)) else { break };
        let trial = moved(&here, &step);
        match slopes_at(&trial) {
            Some(there) if there.objective <= slopes.objective => {
                let gain = slopes.objective - there.objective;
                (here, slopes) = (trial, there);
                damping = (damping * easier).max(LEAST_DAMPING);
                if gain < schedule.least_gain {
                    break;
                }
            }
            _ => {
                damping *= harder;
                if damping > MOST_DAMPING {
                    break;
                }
            }
        }
    }
    Some((here, slopes.objective))
}
