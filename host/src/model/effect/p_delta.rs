//! `p-delta`: the weight above bends the structure further.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::contribution::{Contribution, Factors, MassAbove};
use crate::model::element::Compression;
use crate::model::storeys::Storeys;
use crate::model::structure::{Body, Structure};
use crate::study::STANDARD_GRAVITY_M_S2;

const ABOUT: About = About {
    name: "p-delta",
    physics: "The weight above leans with the structure and bends it further, so that it is softer than its elastic \
         stiffness. A linear model leaves the geometric stiffness out.",
    formula: "K becomes K - factor N integral(w' w'^T), N the weight above each segment, w its deflections with shear: \
         N/(30 L) [36, 3L, -36, 3L; 3L, 4L^2, -3L, -L^2; ...] where it only bends, N/L [1, -1; -1, 1] where it only shears, as between storeys; in torsion \
         factor N r^2/L [1, -1; -1, 1], r the weight's radius of gyration",
    fingerprint: "the first modes are too low, the first most; no free parameter where masses are trusted: factor is 1",
    look_alikes: &[
        LookAlike { kind: "base-rotation", separated_by: "higher modes, and a factor that is not 1" },
        LookAlike { kind: "stiffness-scale", separated_by: "higher modes, which weight hardly moves" },
    ],
    source: "J. S. Przemieniecki (1968), Theory of Matrix Structural Analysis, eq. 15.19; with shear by the deflections of Friedman and \
         Kosmatka (1993); torsion: S. P. Timoshenko and J. M. Gere (1961), Theory of Elastic Stability, chapter 5",
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
        // Only segments and storeys carry the weight.
        if !matches!(structure.body, Body::Beam(_)) {
            given.check_storeys(self, structure)?;
        }
        Ok(Arc::new(Weight { share: given.or_zero(FACTOR.name) }))
    }
}

/// Weight of what is above.
#[derive(Debug)]
struct Weight {
    share: f64,
}

impl Weight {
    /// Of what is above. Gravity pulls as hard whatever the stiffness is multiplied with afterwards.
    fn n_per_kg(&self, factors: &Factors) -> f64 {
        self.share * factors.mass * STANDARD_GRAVITY_M_S2 / factors.stiffness
    }
}

impl Contribution for Weight {
    fn compression(&self, above: &MassAbove) -> Compression {
        let per_kg = self.n_per_kg(&above.factors);
        Compression { force_n: per_kg * above.mass_kg, polar_n_m2: per_kg * above.polar_kg_m2 }
    }

    fn reshape(&self, storeys: &[Option<Storeys>; 2], assembly: &mut Assembly, factors: &Factors) {
        for storeys in storeys.iter().flatten() {
            storeys.lean(self.n_per_kg(factors), &mut assembly.stiffness);
        }
    }

    fn reshapes(&self) -> bool {
        true
    }
}
