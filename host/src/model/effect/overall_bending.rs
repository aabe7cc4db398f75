//! `overall-bending`: a frame bends as one besides, where a model of storeys only shears.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::contribution::{Contribution, Factors};
use crate::model::storeys::Storeys;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "overall-bending",
    physics: "A model of storeys lets each floor shear over the next below. A tall frame bends as one besides: columns on one side get \
         shorter, those on the other longer. Storey stiffnesses that were taken from the sway under a load have both in one: right for that \
         load, too soft for higher modes.",
    formula: "K becomes (K_s^-1 + c F)^-1: F sways of a cantilever of EI = 1, c = share u(top) / (F m z)(top) with u the sway of the storeys \
         under loads m z, and K_s storeys of shear / (drift - c bending's drift), which leaves u what it was until a storey is ten times as stiff, its limit",
    fingerprint: "frequencies of higher modes too low in the model, the more the higher, while the first is nearly right; upper storeys look \
         stiffer than drawn, lower ones softer",
    look_alikes: &[
        LookAlike {
            kind: "base-rotation",
            separated_by: "higher modes: a base that turns lowers the first and leaves them",
        },
        LookAlike { kind: "group", separated_by: "modes of a higher order: one storey does not move all of them" },
    ],
    source: "B. Stafford Smith, A. Coull (1991), Tall Building Structures, chapter 7 (drift by overall bending)",
    examples: &["overall-bending=0.2", "overall-bending=share_x=0.2,share_y=0.1"],
};

/// Shear keeps something of every storey's drift.
const LARGEST: f64 = 0.9;

const fn share(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "-", [0.0, LARGEST], 0.15, meaning)
}

const PARAMETER_SETS: &[&[Parameter]] = &[
    &[share("share", "of the top's sway under loads in proportion to mass and height, what is bending of the whole")],
    &[share("share_x", "the same of motion along X"), share("share_y", "the same of motion along Y")],
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

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_storeys(self, structure)?;
        Ok(Arc::new(Bending { shares: given.of_axes("share", ["share_x", "share_y"]) }))
    }
}

/// Shares of the sway along X and Y.
#[derive(Debug)]
struct Bending {
    shares: [f64; 2],
}

impl Contribution for Bending {
    fn reshape(&self, storeys: &[Option<Storeys>; 2], assembly: &mut Assembly, _factors: &Factors) {
        for (storeys, &share) in storeys.iter().zip(&self.shares).filter(|(_, share)| **share != 0.0) {
            if let Some(storeys) = storeys {
                storeys.bend(share, &mut assembly.stiffness);
            }
        }
    }

    fn reshapes(&self) -> bool {
        true
    }
}
