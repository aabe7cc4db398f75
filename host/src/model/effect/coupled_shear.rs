//! `coupled-shear`: bending makes the structure shear, as K bracing and tapering legs do.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "coupled-shear",
    physics: "A panel of K bracing, whose braces meet in the middle of the girder above, sways by the rotation of its lower end, \
         not by that of its middle; where legs taper, braces carry a part of the moment. So bending comes with shear, which a \
         beam does not have.",
    formula: "K of the beam becomes T^T K T at all nodes, T[ux,ry] = d, T[uy,rx] = -d: u' = phi + V/GA - d phi'",
    fingerprint: "frequencies too low in the model, most of the lowest modes; shapes off by some percent in mid-height",
    look_alikes: &[
        LookAlike { kind: "stiffness-scale", separated_by: "modes of torsion, which it leaves where they are" },
        LookAlike { kind: "lateral-support", separated_by: "a support acts at one height, this at all of them" },
    ],
    source: "A. K. Noor, M. S. Anderson, W. H. Greene (1978), AIAA J. 16, 1219",
    examples: &["coupled-shear=4", "coupled-shear=distance_x=4,distance_y=0"],
};

/// Half of the height of the tallest panels, and as much again by the taper of the legs.
const FARTHEST_M: f64 = 30.0;
/// Unit loads on lattice towers of X bracing, 60 to 120 m high, find 0.4 to 0.7 m, and their measured modes up to 1.4 m; with K bracing both
/// are 5 to 9 m.
const USUAL_M: f64 = 1.5;

const fn distance(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "m", [0.0, FARTHEST_M], 5.0, meaning).usually_within(USUAL_M)
}

const PARAMETER_SETS: &[&[Parameter]] = &[
    &[distance("distance", "d, shear per curvature of the beam; with K bracing half of the panels' height or more")],
    &[distance("distance_x", "the same of motion along X"), distance("distance_y", "the same of motion along Y")],
];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct CoupledShear;

impl EffectKind for CoupledShear {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        PARAMETER_SETS
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_line(self, structure)?;
        Ok(Arc::new(Raised { above_m: given.of_axes("distance", ["distance_x", "distance_y"]) }))
    }
}

/// The beam stands so far above its nodes, for motion along X and Y in m.
#[derive(Debug)]
struct Raised {
    above_m: [f64; 2],
}

impl Contribution for Raised {
    fn coupled_shear_m(&self) -> [f64; 2] {
        self.above_m
    }
}
