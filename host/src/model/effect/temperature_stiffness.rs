//! `temperature-stiffness`: the structure is softer when it is warm.

use super::kind::{About, Evidence, LookAlike};
use super::parameter::Parameter;
use super::trend::Trend;

const ABOUT: About = About {
    name: "temperature-stiffness",
    physics: "Concrete, asphalt and soil lose stiffness as they warm, so frequencies follow the weather. A model without \
         this is right on one day only.",
    formula: "K becomes (1 + relative_per_kelvin (T - T_mean)) K",
    fingerprint: "frequencies follow temperature over the day, all alike",
    look_alikes: &[
        LookAlike { kind: "amplitude-stiffness", separated_by: "hours of like wind at different temperatures" },
        LookAlike { kind: "stiffness-scale", separated_by: "days at another temperature" },
    ],
    source: "B. Peeters, G. De Roeck (2001), One-year monitoring of the Z24-Bridge, Earthq. Eng. Struct. Dyn. 30",
    examples: &["temperature-stiffness=-0.002"],
};

const SLOPE: Parameter = Parameter::ranged(
    "relative_per_kelvin",
    "1/K",
    [-0.1, 0.1],
    0.002,
    "relative change of all stiffness for one kelvin",
);

/// See [`ABOUT`].
pub(super) const KIND: Trend =
    Trend { about: &ABOUT, evidence: Evidence::TemperatureTrend, parameter_sets: &[&[SLOPE]] };
