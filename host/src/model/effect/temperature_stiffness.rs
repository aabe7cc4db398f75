//! `temperature-stiffness`: the structure is softer when it is warm.

use super::{About, EffectError, EffectKind, Evidence, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "temperature-stiffness",
    physics: "Concrete, asphalt and soil lose stiffness as they warm, so frequencies follow the weather. A model without \
         it is right on one day only.",
    formula: "K becomes (1 + relative_per_kelvin (T - T_mean)) K",
    fingerprint: "frequencies go with temperature over the day, all alike",
    look_alikes: &[
        LookAlike { kind: "amplitude-stiffness", separated_by: "hours of like wind at different temperatures" },
        LookAlike { kind: "stiffness-scale", separated_by: "days at another temperature" },
    ],
    source: "B. Peeters, G. De Roeck (2001), One-year monitoring of the Z24-Bridge, Earthq. Eng. Struct. Dyn. 30",
};

const SLOPE: Parameter = Parameter::ranged(
    "relative_per_kelvin",
    "1/K",
    [-0.1, 0.1],
    0.002,
    "relative change of all stiffness for one kelvin",
);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct TemperatureStiffness;

impl EffectKind for TemperatureStiffness {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn evidence(&self) -> Evidence {
        Evidence::TemperatureTrend
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[SLOPE]]
    }

    fn apply(&self, _given: &Given<'_>, _structure: &mut Structure) -> Result<(), EffectError> {
        // The model is that of the record's mean; the effect says how the structure moves about it.
        Ok(())
    }
}
