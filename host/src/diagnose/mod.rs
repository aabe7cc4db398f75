//! Diagnosis: which physical effect a model lacks.
//!
//! A [`Problem`] (a structure, measured modes with their covariance, how far the model is trusted) flows in; a
//! [`Diagnosis`] flows out: every effect of the catalogue, at every place, scored by what it explains, the best refitted,
//! weighed by evidence, and a verdict with the measurement that would settle what the data leave open. [`steps`] adds and
//! drops effects until nothing is gained; [`held_out`] says how well a model predicts what it was not fitted to.
//!
//! `background` turns the model's tolerance into few independent numbers, `state` evaluates a model with given effects and
//! background and its derivatives, `fit` finds the most probable values, `candidates` lists what could be missing, `search` goes through it, `verdict` weighs
//! what it finds, `report` is what it says, `settle` says what to measure next. Effects that show elsewhere than in modes are in `signals`.
//!
//! The statistics: with r the whitened differences of model and measurement, the fit minimises `|r|² + |b|²` over the
//! effects' values and the background b, whose prior is standard normal (joint maximum a posteriori, so that the tolerance
//! is linearised where the structure is, not where the drawing was). The evidence of a set of effects is Laplace's
//! approximation of its marginal likelihood (MacKay 2003, Information Theory, Inference, and Learning Algorithms,
//! section 28.1).

mod background;
mod candidates;
mod damper;
mod far;
mod fit;
mod goodness;
pub mod held_out;
mod place;
mod problem;
mod report;
mod score;
mod search;
mod settle;
mod signals;
mod state;
pub mod steps;
#[cfg(test)]
mod tests;
mod verdict;

pub use fit::{Estimate, Fit};
pub use goodness::Part;
pub use problem::{DiagnoseError, Problem};
pub use report::{
    CandidateReport, Diagnosis, Explained, GoodnessOfFit, HeightMisfit, ModeMisfit, NearPlace, SensorMisfit,
    Unexplained, Verdict,
};
pub use search::{NoneFound, Options};
pub use signals::{Signals, shown_effects};
pub use verdict::{FAILS, STANDS_OUT, diagnose};
