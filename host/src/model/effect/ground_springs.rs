//! What effects that hold a structure at a height by springs to the ground have in common: one stiffness for both axes, or one each.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

/// What springs resist, by the first of its two rows in the axis' motion at a height.
#[derive(Debug, Clone, Copy)]
pub(super) enum Motion {
    /// Sway along X and Y.
    Sway = 0,
    /// Rotation about X and Y.
    Rotation = 2,
}

/// A kind of springs to the ground. Its parameters are `stiffness`, or `stiffness_x` and `stiffness_y`, and `stiffness_z` of those that resist
/// twist as well.
#[derive(Debug)]
pub(super) struct GroundSprings {
    pub(super) about: &'static About,
    pub(super) parameter_sets: &'static [&'static [Parameter]],
    pub(super) resisted: Motion,
    /// See [`EffectKind::looked_for_above`].
    pub(super) looked_for_above: f64,
}

impl EffectKind for GroundSprings {
    fn about(&self) -> &'static About {
        self.about
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Height
    }

    fn looked_for_above(&self) -> f64 {
        self.looked_for_above
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        self.parameter_sets
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let z_m = given.height_m(self, structure)?;
        if matches!(self.resisted, Motion::Rotation) && !structure.has_rotations() {
            return Err(EffectError::NoRotations { kind: self.about.name });
        }
        let stiffness = given.of_axes("stiffness", ["stiffness_x", "stiffness_y"]);
        let twist_n_m = given.or_zero("stiffness_z");
        Ok(Arc::new(GroundSpring { z_m, resisted: self.resisted, stiffness, twist_n_m }))
    }
}

/// A spring to the ground.
#[derive(Debug)]
struct GroundSpring {
    z_m: f64,
    resisted: Motion,
    /// Along X and Y in N/m, or about X and Y in N m/rad.
    stiffness: [f64; 2],
    /// About Z in N m/rad.
    twist_n_m: f64,
}

impl Contribution for GroundSpring {
    fn attach(&self, assembly: &mut Assembly) {
        if let Some(motion) = assembly.local_motion(self.z_m) {
            motion.add_squares(&mut assembly.stiffness, self.resisted as usize, self.stiffness);
            motion.add_squares(&mut assembly.stiffness, 4, [self.twist_n_m]);
        }
    }
}
