//! A diagnosis as it is printed and stored.
//!
//! `verdict` fills it from fits; the commands print it as text or JSON.

use serde::Serialize;

use super::criteria::STANDS_OUT;
use super::discrepancy::Discrepancy;
use super::elsewise::Elsewise;
use super::fingerprint::Fingerprints;
use super::fit::Estimate;
use super::goodness::{Part, Tests};
use super::joint::Joint;
use super::partial_report::PartialAnswer;
use super::posterior::Probabilities;
use super::relief::Left;
use crate::compare::ChiSquared;

/// How model and data agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// It fits, and no effect gains.
    Adequate,
    /// One effect stands out.
    Effect,
    /// Several effects explain the data alike.
    Ambiguous,
    /// None of the known effects explains the data.
    Unknown,
}

/// A diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// How model and data agree.
    pub verdict: Verdict,
    /// Kinds that explain something, each at its best place, best first.
    pub candidates: Vec<CandidateReport>,
    /// The name of the effect that explains the data best; empty where none does.
    pub best: Vec<String>,
    /// Sets of names that the data cannot tell apart.
    pub ambiguous: Vec<Vec<String>>,
    /// The measurement that would settle what is open.
    pub next_measurement: Option<String>,
    /// Of the model with the best effect, where one is named; else of the present model.
    pub goodness_of_fit: GoodnessOfFit,
    /// Of the model with its effects as they are written: the same test as that of a comparison and of the history.
    pub present: GoodnessOfFit,
    /// Of the model as it is, if it may miss no more than with the best effect; null where none is named.
    pub present_beside_best: Option<GoodnessOfFit>,
    /// What the same misses for reasons that neither an effect nor the tolerance explains, as standard deviations.
    pub discrepancy: Discrepancy,
    /// What the best fit leaves.
    pub unexplained: Unexplained,
    /// What the best effect explains, mode by mode; the present model's misfit where no effect is named.
    pub explained: Vec<Explained>,
    /// How probable it is that the model lacks nothing, or something that is no candidate. With the candidates' they sum to one.
    pub probabilities: Probabilities,
    /// Where half or double of the stated tolerance leads to another verdict.
    pub elsewise: Vec<Elsewise>,
    /// Where the verdict is `unknown`: the small set of effects that explains most.
    pub partial: Option<PartialAnswer>,
    /// Effects that the model has, refitted.
    pub effects: Vec<CandidateReport>,
    /// Their values, and those of the effect that leads, with their joint covariance; null where there are none.
    pub joint: Option<Joint>,
    /// The misfit of the present model beside what each of the first candidates would do; in a file of its own.
    #[serde(skip)]
    pub fingerprints: Option<Fingerprints>,
    /// What shows the best effect, where that is not in the modes.
    pub reason: Option<String>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// An effect with what it would explain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CandidateReport {
    /// The kind.
    pub effect: String,
    /// The part after the @.
    pub r#where: Option<String>,
    /// Its values.
    pub parameters: Vec<Estimate>,
    /// Natural logarithm of the evidence over that of the present model; null for effects in the model.
    pub log_bayes_factor: Option<f64>,
    /// Odds of its kind before anything was measured, against 20 for a model that lacks nothing; null for effects in the model.
    pub prior_odds: Option<f64>,
    /// Probability that it is what the model lacks; null for effects in the model.
    pub probability: Option<f64>,
    /// Squared deviations of what is left.
    pub chi_squared: f64,
    /// Probability of as much, were the effect all that is missing.
    pub p_value: f64,
    /// What it leaves of the model's differences, no segment adjusted; null where that was not asked.
    pub errors_left: Option<Left>,
    /// Whether its values are inside their bounds.
    pub admissible: bool,
    /// Standard deviation of its height in m, where that was fitted.
    pub where_std_m: Option<f64>,
    /// Other places that do nearly as well.
    pub near: Vec<NearPlace>,
}

/// A place that does nearly as well.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NearPlace {
    /// The part after the @.
    pub r#where: String,
    /// Natural logarithm of the best place's evidence over this one's.
    pub log_evidence_below_best: f64,
}

/// Whether a fit is as good as measurement and tolerance allow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GoodnessOfFit {
    /// Squared deviations.
    pub chi_squared: f64,
    /// Numbers compared less values fitted.
    pub degrees_of_freedom: usize,
    /// Probability of so large a misfit, or a larger one, of a right model: the least of several tests, corrected for how
    /// many they are.
    pub p_value: f64,
    /// What that test looks at.
    pub worst: Part,
}

/// What a fit leaves unexplained, in mean squared deviations: 1 is what measurement and tolerance allow.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unexplained {
    /// By measured mode.
    pub by_mode: Vec<ModeMisfit>,
    /// By sensor.
    pub by_sensor: Vec<SensorMisfit>,
    /// By height, lowest first.
    pub by_height: Vec<HeightMisfit>,
    /// Of a structure that is no tower, instead: by group with sensors at its nodes.
    pub by_group: Vec<GroupSquare>,
}

/// What is left at a group of the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupSquare {
    /// The group's name.
    pub group: String,
    /// Mean square of what its sensors leave.
    pub mean_square: f64,
}

/// What is left of a mode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeMisfit {
    /// Number of the measured mode.
    pub measured: usize,
    /// Its frequency.
    pub measured_hz: f64,
    /// The fitted model's frequency against it.
    pub frequency_error_percent: f64,
    /// Mean squared deviation of its numbers.
    pub mean_square: f64,
}

/// What is left at a sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorMisfit {
    /// The channel.
    pub channel: String,
    /// Mean squared deviation over the modes.
    pub mean_square: f64,
}

/// What is left at a height.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeightMisfit {
    /// The height.
    pub elevation_m: f64,
    /// Mean of its sensors.
    pub mean_square: f64,
}

/// What an effect explains of a mode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explained {
    /// Number of the measured mode.
    pub measured: usize,
    /// Its frequency.
    pub measured_hz: f64,
    /// The present model's frequency error; null where it has no such mode.
    pub before_percent: Option<f64>,
    /// With the best effect.
    pub after_percent: Option<f64>,
    /// Squared deviations of the mode's numbers before.
    pub chi_squared_before: f64,
    /// With the best effect.
    pub chi_squared_after: f64,
    /// The channel at which the shape gains most.
    pub channel: Option<String>,
}

impl From<Tests> for GoodnessOfFit {
    fn from(tests: Tests) -> Self {
        let Tests { all: ChiSquared { chi_squared, degrees_of_freedom, .. }, worst, p_value } = tests;
        Self { chi_squared, degrees_of_freedom, p_value, worst }
    }
}

impl CandidateReport {
    /// Whether it gains 20 to 1 with a value that it can have, and counts: one with which the model's errors do not fall has no probability.
    pub fn stands_out(&self) -> bool {
        let counts = self.probability.is_none_or(|probability| probability > 0.0);
        self.admissible && counts && self.log_bayes_factor.is_some_and(|gain| gain > STANDS_OUT)
    }

    /// `kind` or `kind@where`.
    pub fn name(&self) -> String {
        name(&self.effect, self.r#where.as_deref())
    }
}

/// `kind` or `kind@where`.
pub(super) fn name(kind: &str, place: Option<&str>) -> String {
    place.map_or_else(|| kind.to_owned(), |place| format!("{kind}@{place}"))
}
