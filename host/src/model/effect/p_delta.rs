//! `p-delta`: the weight above bends the structure further.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::contribution::{Contribution, MassAbove};
use crate::model::structure::Structure;
use crate::study::STANDARD_GRAVITY_M_S2;

const ABOUT: About = About {
    name: "p-delta",
    physics: "The weight above leans with the structure and bends it further, so that it is softer than its elastic \
         stiffness. A linear model leaves the geometric stiffness out.",
    formula: "K becomes K - factor N/(30 L) [36, 3L, -36, 3L; 3L, 4L^2, -3L, -L^2; ...], N the weight above each segment",
    fingerprint: "the first modes are too low, the first most; no free parameter where masses are trusted: factor is 1",
    look_alikes: &[
        LookAlike { kind: "base-rotation", separated_by: "higher modes, and a factor that is not 1" },
        LookAlike { kind: "stiffness-scale", separated_by: "higher modes, which weight hardly moves" },
    ],
    source: "J. S. Przemieniecki (1968), Theory of Matrix Structural Analysis, eq. 15.19",
    examples: &["p-delta=1"],
};

const FACTOR: Parameter =
    Parameter::ranged("factor", "-", [0.0, 1.5], 1.0, "share of the weight above; 1 is all of it");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct PDelta;

impl EffectKind for PDelta {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[FACTOR]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        // Only a beam has segments to carry the weight.
        given.check_beam(self, structure)?;
        Ok(Arc::new(Weight { share: given.or_zero(FACTOR.name) }))
    }
}

/// Weight of what is above.
#[derive(Debug)]
struct Weight {
    share: f64,
}

impl Contribution for Weight {
    fn compression_n(&self, above: &MassAbove) -> f64 {
        // Gravity pulls as hard whatever the stiffness is multiplied with afterwards.
        self.share * above.factors.mass * STANDARD_GRAVITY_M_S2 / above.factors.stiffness * above.mass_kg
    }
}
