//! `added-mass@z`: a mass that the model does not know, such as plant or cladding.

use super::target::height;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter, Place};
use crate::model::{AddedMass, Structure};

const ABOUT: About = About {
    name: "added-mass",
    physics: "Something heavy stands at a height that the model does not know: plant, a water tank, antennas. It moves \
         sideways with the structure and has no rotational inertia of its own.",
    formula: "M += m (n_x^T n_x + n_y^T n_y), n the motion of the axis at z",
    fingerprint: "frequencies too low in proportion to m phi(z)^2, torsion untouched",
    look_alikes: &[
        LookAlike {
            kind: "stiffness-loss",
            separated_by: "more sensors around the height: a loss kinks the curvature, a mass does not",
        },
        LookAlike { kind: "mass-scale", separated_by: "modes that do not move at the height" },
        LookAlike { kind: "tuned-mass-damper", separated_by: "a mass on a spring has a twin peak of its own" },
        LookAlike {
            kind: "base-rotation",
            separated_by: "for a mass at the top and frequencies alone they are twins: shapes near the base",
        },
    ],
    source: "Lord Rayleigh (1894), The Theory of Sound, section 90",
};

const MASS: Parameter = Parameter::positive("mass", "kg", "a mass on the beam axis");

/// A point mass; between nodes it enters M through the element's shape functions.
#[derive(Debug)]
pub(super) struct AddedMassAt;

impl EffectKind for AddedMassAt {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> Place {
        Place::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[MASS]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        let z_m = height(ABOUT.name, given, structure)?;
        structure.added_masses.push(AddedMass { z_m, mass_kg: given.or_zero(MASS.name) });
        Ok(())
    }
}
