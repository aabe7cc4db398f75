//! `added-mass@z`: a mass that the model does not know, such as plant or cladding.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::assembly::Assembly;
use crate::model::contribution::{Contribution, PointMass};
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "added-mass",
    physics: "Something heavy stands at a height that the model does not know: plant, a water tank, antennas. It moves \
         sideways with the structure; a ring or a wide floor turns with it as well, with half of its polar inertia about X and Y.",
    formula: "M += m (n_x^T n_x + n_y^T n_y) + J (n_rz^T n_rz + (n_rx^T n_rx + n_ry^T n_ry) / 2), n the motion of the axis at z",
    fingerprint: "frequencies too low in proportion to m phi(z)^2; torsion lower with a ring, else unchanged",
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
    examples: &["added-mass@443.6m=2e5", "added-mass@443.6m=mass=2e5,polar_inertia=7e6"],
};

const MASS: Parameter = Parameter::positive("mass", "kg", "a mass on the beam axis");
const INERTIA: Parameter = Parameter::positive(
    "polar_inertia",
    "kg m2",
    "its moment of inertia about Z; a ring of radius r has mass times r²",
);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct AddedMass;

impl EffectKind for AddedMass {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[MASS], &[MASS, INERTIA]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let z_m = given.height_m(self, structure)?;
        let mass = PointMass { z_m, mass_kg: given.or_zero(MASS.name) };
        Ok(Arc::new(Plant { mass, polar_kg_m2: given.or_zero(INERTIA.name) }))
    }
}

/// A mass with its moment of inertia about Z.
#[derive(Debug)]
struct Plant {
    mass: PointMass,
    polar_kg_m2: f64,
}

/// Between nodes it enters M through the element's shape functions.
impl Contribution for Plant {
    fn attach(&self, assembly: &mut Assembly) {
        if let Some(motion) = assembly.local_motion(self.mass.z_m) {
            motion.add_square(&mut assembly.mass, 0, self.mass.mass_kg);
            let rotary = 0.5 * self.polar_kg_m2;
            motion.add_squares(&mut assembly.mass, 2, [rotary, rotary, self.polar_kg_m2]);
        }
    }

    fn attached_mass(&self) -> Option<PointMass> {
        Some(self.mass)
    }
}
