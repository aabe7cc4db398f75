//! `connection-flexibility@z`: the structure kinks at a joint.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::contribution::Contribution;
use crate::model::joint::Element;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "connection-flexibility",
    physics: "A joint turns under moment where the model is continuous: the foot of an antenna mast, a bolted flange, a \
         transfer floor. Motion along the axis and torsion pass through it.",
    formula: "the segment at z: k becomes k - c v v^T/(1 + c k_tt), v the end forces of a unit kink",
    fingerprint: "modes of the part above, and those that bend there; shapes kink at z",
    look_alikes: &[
        LookAlike { kind: "added-mass", separated_by: "for a mast on top: sensors on the mast itself" },
        LookAlike {
            kind: "stiffness-loss",
            separated_by: "torsion, which a loss lowers and a rotational joint leaves alone",
        },
        LookAlike { kind: "base-rotation", separated_by: "for a joint near the base: a sensor between the two" },
    ],
    source: "M. A. Monforton, T. S. Wu (1963), Matrix analysis of semi-rigidly connected frames, J. Struct. Div. ASCE 89",
    examples: &[
        "connection-flexibility@443.6m=1e-12",
        "connection-flexibility@443.6m=flexibility_x=1e-12,flexibility_y=3e-12",
    ],
};

const fn flexibility(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "rad/(N m)", meaning)
}

const SETS: &[&[Parameter]] = &[
    &[flexibility("flexibility", "kink of the joint under a unit moment about X or Y")],
    &[
        flexibility("flexibility_x", "the same about X (motion along Y)"),
        flexibility("flexibility_y", "the same about Y (motion along X)"),
    ],
];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct ConnectionFlexibility;

impl EffectKind for ConnectionFlexibility {
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
        let z_m = given.height_m(self, structure)?;
        // Only a beam can be cut.
        given.check_beam(self, structure)?;
        let flexibility_rad_n_m = given.of_axes("flexibility", ["flexibility_x", "flexibility_y"]);
        Ok(Arc::new(Joint { z_m, flexibility_rad_n_m }))
    }
}

/// A rotational joint: the beam kinks there under moment.
#[derive(Debug)]
struct Joint {
    z_m: f64,
    /// About X and Y.
    flexibility_rad_n_m: [f64; 2],
}

impl Contribution for Joint {
    fn soften(&self, element: &mut Element) {
        element.hinge(self.z_m, self.flexibility_rad_n_m);
    }
}
