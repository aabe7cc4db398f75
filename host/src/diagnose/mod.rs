//! Diagnosis: which physical effect a model lacks.
//!
//! A [`Problem`] (a structure, measured modes with their covariance, how far the model is trusted) flows in; a
//! [`Diagnosis`] flows out: every effect of the catalogue, at every place, scored by what it explains, the best refitted,
//! weighed by evidence, and a verdict with the measurement that would settle what the data leave open. [`steps`] adds and
//! drops effects until nothing is gained; [`held_out`] says how well a model predicts what it was not fitted to.
//! What a model misses for reasons that no effect explains is its `discrepancy`.
//!
//! From the ground up: `background` turns the model's tolerance into a few independent numbers; `evaluation` makes a `state` of
//! effects and background, and `derivatives` and `scales` say how it follows them; `fit` finds the most probable values and
//! `goodness` tests them. `candidates` lists what could be missing, `score` weighs each by one linear step, `search` refits the
//! best (with `far`, `damper` and `height`), `verdict` weighs what was `found`, `report` is what it says, `settle` says what to
//! measure next; `prior` and `posterior` say how probable each hypothesis is, `elsewise` what the verdict would be with another
//! tolerance. Where no effect explains all, `partial` looks for a small set that explains most, and `partial_report` tells of it.
//! Effects that show elsewhere than in modes are in `signals`. `since` says what has changed since an earlier measurement.
//! `outlook` predicts verdicts before anything is measured. `profile` says what a fit has learned of the model's segments, `joint` how
//! the values of effects go together, `fingerprint` what each effect would do to every number measured.
//!
//! The statistics: with r the whitened differences of model and measurement, the fit minimises `|r|² + |b|²` over the
//! effects' values and the background b, whose prior is standard normal (joint maximum a posteriori, so that the tolerance
//! is linearised where the structure is, not where the drawing was). The evidence of a set of effects is Laplace's
//! approximation of its marginal likelihood (MacKay 2003, Information Theory, Inference, and Learning Algorithms,
//! section 28.1).

mod background;
mod candidates;
mod criteria;
mod damper;
mod derivatives;
mod discrepancy;
#[cfg(test)]
mod discrepancy_tests;
mod elsewise;
mod error;
mod evaluation;
mod families;
mod far;
mod fingerprint;
mod fit;
mod found;
mod goodness;
#[cfg(test)]
mod goodness_tests;
#[cfg(test)]
mod group_tests;
mod height;
pub mod held_out;
mod joint;
mod knob;
mod misfit;
mod near;
mod outlook;
mod own_channels;
mod partial;
mod partial_report;
mod posterior;
mod prior;
mod problem;
mod profile;
#[cfg(test)]
mod profile_tests;
mod relief;
mod report;
mod scales;
mod score;
mod search;
mod settle;
mod signals;
mod since;
#[cfg(test)]
mod since_tests;
mod smooth;
mod state;
pub mod steps;
#[cfg(test)]
mod storeys_tests;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod uncounted;
mod verdict;

pub use candidates::Options;
pub use criteria::{FAILS, STANDS_OUT};
pub use discrepancy::Discrepancy;
pub use elsewise::Elsewise;
pub use error::{DiagnoseError, NoneFound};
pub use fingerprint::{CandidateFingerprint, Fingerprint, FingerprintMode, FingerprintSensor, Fingerprints};
pub use fit::{Estimate, Fit};
pub use goodness::{Part, fit_as_given};
pub use joint::{Joint, JointValue};
pub(crate) use outlook::{Draw, Outlook, Rival, Weighed};
pub use partial_report::{Instead, PartialAnswer, PartialEffect};
pub use posterior::Probabilities;
pub use problem::Problem;
pub use profile::{Masses, Profile, ProfileGroup, ProfileSegment, Quantity, QuantityProfile, Sections};
pub use relief::Left;
pub use report::{
    CandidateReport, Diagnosis, Explained, GoodnessOfFit, GroupSquare, HeightMisfit, ModeMisfit, NearPlace,
    SensorMisfit, Unexplained, Verdict,
};
pub use signals::{Signals, shown_effects};
pub use since::{ChangeDiagnosis, ChangeProbabilities, ChangeVerdict, Direction, Predicted, diagnose_change};
pub use verdict::diagnose;
