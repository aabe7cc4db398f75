//! `base-rotation`: the foundation rotates under moment, as on soil.

use super::base::BaseSprings;
use super::kind::{About, LookAlike};
use super::parameter::Parameter;
use crate::model::base::BaseFlexibility;

const ABOUT: About = About {
    name: "base-rotation",
    physics: "The foundation rotates under the overturning moment because soil and piles give way; the model is \
         clamped. One value applies to both axes. Over one soft leg or corner it turns about a diagonal. An embedded foundation, \
         or one on piles, turns about a point below the base, so that it sways as it rocks.",
    formula: "a rotational spring under the base: x_b = -(I + C K_bb)^-1 C K_bf x_f with C the flexibility; springs in \
         series add; about a point below the base C = flexibility [depth^2, depth; depth, 1] of translation and rotation",
    fingerprint: "the lowest modes are too low and move at the base; high modes hardly change",
    look_alikes: &[
        LookAlike {
            kind: "base-translation",
            separated_by: "a sensor at the base, or one just above it: turning grows with height, sliding does not",
        },
        LookAlike { kind: "p-delta", separated_by: "higher bending modes, which weight does not move" },
        LookAlike {
            kind: "connection-flexibility",
            separated_by: "sensors just above the base: a joint higher up leaves what is below it at rest",
        },
        LookAlike { kind: "stiffness-loss", separated_by: "sensors on both sides of the lowest segments" },
        LookAlike { kind: "stiffness-scale", separated_by: "the higher modes, which a base spring hardly moves" },
    ],
    source: "G. Gazetas (1991), Formulas and charts for impedances of surface and embedded foundations, J. Geotech. Eng. \
         117",
    examples: &[
        "base-rotation=7.2e-15",
        "base-rotation=flexibility_x=7e-15,flexibility_y=9e-15",
        "base-rotation=flexibility_x=7e-15,flexibility_y=9e-15,flexibility_diagonal=-4e-15",
        "base-rotation=flexibility=7e-15,depth=6",
    ],
};

/// The centre of rotation of piles and caissons is down to some ten metres below the base.
const DEPTH: Parameter = Parameter::ranged(
    "depth",
    "m",
    [-50.0, 50.0],
    5.0,
    "depth below the base of the point about which the foundation turns",
);

const FLEXIBILITY: Parameter = flexibility("flexibility", "rotation of the base under a unit moment about X or Y");
const ABOUT_X: Parameter = flexibility("flexibility_x", "the same about X (motion along Y)");
const ABOUT_Y: Parameter = flexibility("flexibility_y", "the same about Y (motion along X)");
const ABOUT_DIAGONAL: Parameter = Parameter {
    least: f64::NEG_INFINITY,
    ..flexibility("flexibility_diagonal", "the same about the diagonal of X and Y; negative: about that of X and -Y")
};

const fn flexibility(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "rad/(N m)", meaning)
}

/// See [`ABOUT`].
pub(super) const KIND: BaseSprings = BaseSprings {
    about: &ABOUT,
    parameter_sets: &[&[FLEXIBILITY], &[ABOUT_X, ABOUT_Y], &[ABOUT_X, ABOUT_Y, ABOUT_DIAGONAL], &[FLEXIBILITY, DEPTH]],
    base: |each, given| match given.value(ABOUT_DIAGONAL.name) {
        Some(diagonal) => BaseFlexibility::rocking_about_diagonal(each, diagonal),
        None => BaseFlexibility::rocking(each, given.or_zero(DEPTH.name)),
    },
};
