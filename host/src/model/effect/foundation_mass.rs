//! `foundation-mass`: the foundation moves with the base, and the model gives it no mass.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "foundation-mass",
    physics: "On soil that gives way the foundation moves, and with it the soil that it carries along. Beam tables begin above \
         it and leave its mass out. Under a clamped base it does nothing.",
    formula: "M += m (n_x^T n_x + n_y^T n_y) + J (n_rx^T n_rx + n_ry^T n_ry), n the motion of the base that follows from the DOFs: \
         right below the frequency of the foundation on its own springs",
    fingerprint: "beside base-rotation or base-translation: modes that move at the base are too low, the higher the more",
    look_alikes: &[
        LookAlike {
            kind: "base-translation",
            separated_by: "the lowest modes, which a spring moves most and a mass at the base hardly",
        },
        LookAlike { kind: "added-mass", separated_by: "modes that move at the base and not above it" },
    ],
    source: "J. P. Wolf (1985), Dynamic Soil-Structure Interaction, section 3.3; condensed as R. J. Guyan (1965), AIAA J. 3, 380",
    examples: &["foundation-mass=5e6", "foundation-mass=mass=5e6,inertia=4e8"],
};

const MASS: Parameter = Parameter::positive("mass", "kg", "mass that moves with the base");
const INERTIA: Parameter = Parameter::positive("inertia", "kg m2", "its rotary inertia about X and Y");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct FoundationMass;

impl EffectKind for FoundationMass {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[MASS], &[MASS, INERTIA]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_beam(self, structure)?;
        Ok(Arc::new(Foundation { mass_kg: given.or_zero(MASS.name), inertia_kg_m2: given.or_zero(INERTIA.name) }))
    }
}

/// A rigid body at the base.
#[derive(Debug)]
struct Foundation {
    mass_kg: f64,
    inertia_kg_m2: f64,
}

impl Contribution for Foundation {
    fn attach(&self, assembly: &mut Assembly) {
        if let Some(motion) = assembly.local_motion(assembly.z_base_m()) {
            motion.add_square(&mut assembly.mass, 0, self.mass_kg);
            motion.add_square(&mut assembly.mass, 2, self.inertia_kg_m2);
        }
    }
}
