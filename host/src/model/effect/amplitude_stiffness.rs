//! `amplitude-stiffness`: the structure is softer when it moves more.

use super::kind::{About, Evidence, LookAlike};
use super::parameter::Parameter;
use super::trend::Trend;

const ABOUT: About = About {
    name: "amplitude-stiffness",
    physics: "Cracks open, joints slip and soil yields as motion grows, so frequencies fall in strong wind. A linear model \
         has one frequency for all levels.",
    formula: "K becomes (1 + relative_per_level log10(response / mean response)) K",
    fingerprint: "frequencies follow the level of response over the hours",
    look_alikes: &[LookAlike {
        kind: "temperature-stiffness",
        separated_by: "hours of like temperature in different wind",
    }],
    source: "Y. Tamura, S.-y. Suganuma (1996), Evaluation of amplitude-dependent damping and natural frequency of \
         buildings, J. Wind Eng. Ind. Aerodyn. 59",
    examples: &["amplitude-stiffness=-0.02"],
};

const SLOPE: Parameter = Parameter::ranged(
    "relative_per_level",
    "1/decade",
    [-1.0, 1.0],
    0.02,
    "relative change of all stiffness for a tenfold response",
);

/// See [`ABOUT`].
pub(super) const KIND: Trend = Trend { about: &ABOUT, evidence: Evidence::LevelTrend, parameter_sets: &[&[SLOPE]] };
