//! `lateral-support@z`: guys, a tie to a neighbour or a floor that leans on one hold the structure at a height.

use std::sync::Arc;

use super::error::EffectError;
use super::ground_spring::GroundSpring;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "lateral-support",
    physics: "Guys, a tie to a neighbour, or a floor that leans on one resist sway at one height. The model leaves them out.",
    formula: "K += k (n_x^T n_x + n_y^T n_y), n the motion of the axis at z",
    fingerprint: "frequencies too high, most in modes that move most at z, and not in those with a node there; shapes held back at z",
    look_alikes: &[
        LookAlike { kind: "stiffness-scale", separated_by: "modes with a node at z, which a support leaves alone" },
        LookAlike { kind: "outrigger", separated_by: "which modes rise: an outrigger holds those that turn at z" },
    ],
    source: "H. M. Irvine (1981), Cable Structures, chapter 4",
    examples: &["lateral-support@60m=5e6", "lateral-support@60m=stiffness_x=5e6,stiffness_y=0"],
};

const fn stiffness(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "N/m", meaning)
}

const SETS: &[&[Parameter]] = &[
    &[stiffness("stiffness", "force to the ground for a unit displacement along X or Y")],
    &[stiffness("stiffness_x", "the same along X"), stiffness("stiffness_y", "the same along Y")],
];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct LateralSupport;

impl EffectKind for LateralSupport {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        SETS
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let stiffness = given.of_axes("stiffness", ["stiffness_x", "stiffness_y"]);
        Ok(Arc::new(GroundSpring::lateral(given.height_m(self, structure)?, stiffness)))
    }
}
