//! `base-torsion`: the foundation twists under torque, as on soil or piles.

use super::base::BaseSprings;
use super::kind::{About, LookAlike};
use super::parameter::Parameter;
use crate::model::base::BaseFlexibility;

const ABOUT: About = About {
    name: "base-torsion",
    physics: "The foundation twists about the vertical axis because soil and piles give way under torque; the model is \
         clamped.",
    formula: "a torsional spring under the base, eliminated as for base-rotation; springs in series add",
    fingerprint: "torsional modes are too low, the lowest most, and twist at the base; bending stays",
    look_alikes: &[
        LookAlike {
            kind: "stiffness-loss",
            separated_by: "bending, which a loss lowers and a torsional spring under the base leaves alone",
        },
        LookAlike { kind: "mass-eccentricity", separated_by: "bending modes, which an eccentric mass makes twist" },
    ],
    source: "G. Gazetas (1991), Formulas and charts for impedances of surface and embedded foundations, J. Geotech. Eng. \
         117",
    examples: &["base-torsion=1e-14"],
};

/// See [`ABOUT`].
pub(super) const KIND: BaseSprings = BaseSprings {
    about: &ABOUT,
    parameter_sets: &[&[Parameter::positive(
        "flexibility",
        "rad/(N m)",
        "rotation of the base about Z under a unit torque",
    )]],
    base: |[torsion_rad_n_m, _], _| BaseFlexibility { torsion_rad_n_m, ..BaseFlexibility::default() },
};
