//! `overall-bending`: a frame bends as one besides, where a model of storeys only shears.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::contribution::{Contribution, Factors};
use crate::model::storeys::{Bending, Storeys};
use crate::model::structure::{Body, Structure};

const ABOUT: About = About {
    name: "overall-bending",
    physics: "A model of storeys lets each floor shear over the next below. A tall frame bends as one besides: columns on one side get \
         shorter, those on the other longer. Storey stiffnesses that were taken from the sway under a load have both in one: right for that \
         load, too soft for higher modes. Those of the columns as drawn, 12 EI / h^3, have none of it: too stiff, most of all for the first \
         mode. The model needs heights: dofs or nodes say where its floors are.",
    formula: "K becomes (K_s^-1 + c F)^-1: F sways of a cantilever of EI = 1, c = (share + added) u(top) / (F m z)(top) with u the sway of the storeys \
         under loads m z, and K_s storeys of shear / (drift - share's part of bending's drift), which leaves u what it was until a storey is ten \
         times as stiff, its limit",
    fingerprint: "share: frequencies of higher modes too low in the model, the more the higher, while the first is nearly right; upper storeys \
         look stiffer than drawn, lower ones softer. added: frequencies too high, the first most; upper storeys look softer",
    look_alikes: &[
        LookAlike {
            kind: "base-rotation",
            separated_by: "higher modes: a base that turns lowers the first and leaves them",
        },
        LookAlike { kind: "group", separated_by: "modes of a higher order: one storey does not move all of them" },
    ],
    source: "B. Stafford Smith, A. Coull (1991), Tall Building Structures, chapter 7 (drift by overall bending)",
    examples: &[
        "overall-bending=0.2",
        "overall-bending=share_x=0.2,share_y=0.1",
        "overall-bending=added=0.2",
        "overall-bending=added_x=0.2,added_y=0.1",
    ],
};

/// Shear keeps something of every storey's drift.
const LARGEST: f64 = 0.9;

const fn share(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "-", [0.0, LARGEST], 0.15, meaning).always_named()
}

/// A slender frame of stiff storeys bends more than it shears.
const MOST_ADDED: f64 = 5.0;

const fn added(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "-", [0.0, MOST_ADDED], 0.15, meaning).always_named()
}

const PARAMETER_SETS: &[&[Parameter]] = &[
    &[share("share", "of the top's sway under loads in proportion to mass and height, what is bending of the whole")],
    &[share("share_x", "the same of motion along X"), share("share_y", "the same of motion along Y")],
    &[added(
        "added",
        "sway of the top by bending of the whole beyond that of the storeys under such loads, as a share of theirs",
    )],
    &[added("added_x", "the same of motion along X"), added("added_y", "the same of motion along Y")],
];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct OverallBending;

impl EffectKind for OverallBending {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        PARAMETER_SETS
    }

    fn has_rival_sets(&self) -> bool {
        true
    }

    fn caution(&self, given: &Given<'_>, structure: &Structure) -> Option<String> {
        let Body::Matrices(matrices) = &structure.body else { return None };
        let assembly = Assembly::of_matrices(matrices);
        let within = shares(given);
        let limited_m = (0..2).flat_map(|direction| {
            let storeys = Storeys::along(direction, &assembly);
            storeys.map_or_else(Vec::new, |storeys| storeys.at_their_limit_m(within[direction]))
        });
        let lowest_m = limited_m.min_by(f64::total_cmp)?;
        Some(format!(
            "{}: storeys from the one below {lowest_m:.1} m above the ground are at their limit, ten times as stiff as the model has them; \
             so much of their sway is bending of the whole that the share may be more",
            ABOUT.name
        ))
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_storeys(self, structure)?;
        let within = shares(given);
        let added = given.of_axes("added", ["added_x", "added_y"]);
        let along = [0, 1].map(|axis| Bending { within: within[axis], added: added[axis] });
        Ok(Arc::new(BendsAsOne { along }))
    }
}

/// What the storeys' sway along X and Y has of bending.
fn shares(given: &Given<'_>) -> [f64; 2] {
    given.of_axes("share", ["share_x", "share_y"])
}

/// Bending in motion along X and Y.
#[derive(Debug)]
struct BendsAsOne {
    along: [Bending; 2],
}

impl Contribution for BendsAsOne {
    fn reshape(&self, storeys: &[Option<Storeys>; 2], assembly: &mut Assembly, _factors: &Factors) {
        let bending = storeys.iter().zip(&self.along).filter(|(_, bending)| **bending != Bending::default());
        for (storeys, &bending) in bending {
            if let Some(storeys) = storeys {
                storeys.bend(bending, &mut assembly.stiffness);
            }
        }
    }

    fn reshapes(&self) -> bool {
        true
    }
}
