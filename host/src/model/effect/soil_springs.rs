//! `soil-springs@z`: ground, fill or a podium along the foot holds the structure from its base up to a height.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "soil-springs",
    physics: "Soil along a pile or a buried shaft, fill around a foot, or a podium resists sway all the way from the base up to a \
         height. The model stands free above its base.",
    formula: "K += integral from the base to z of k (n_x^T n_x + n_y^T n_y) dz, n the motion of the axis, k the same over the height",
    fingerprint: "frequencies too high, those of higher modes most, shapes held back from the base up to z",
    look_alikes: &[
        LookAlike {
            kind: "lateral-support",
            separated_by: "sensors below z and just above it: soil bends the whole length, a support one point",
        },
        LookAlike { kind: "stiffness-scale", separated_by: "shapes near the base, and modes that hardly move there" },
        LookAlike { kind: "outrigger", separated_by: "which modes rise: soil holds those that move below z" },
    ],
    source: "M. Hetényi (1946), Beams on Elastic Foundation, chapter 1",
    examples: &["soil-springs@20m=4e6", "soil-springs@20m=stiffness_x=4e6,stiffness_y=2e6"],
};

const fn stiffness(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::positive(name, "N/m²", meaning)
}

const ALONG_BOTH: Parameter =
    stiffness("stiffness", "force to the ground for a unit displacement, on a metre of the height");
const ALONG_X: Parameter = stiffness("stiffness_x", "the same along X");
const ALONG_Y: Parameter = stiffness("stiffness_y", "the same along Y");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct SoilSprings;

impl EffectKind for SoilSprings {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Height
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[ALONG_BOTH], &[ALONG_X, ALONG_Y]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let z_m = given.height_m(self, structure)?;
        Ok(Arc::new(Bed { z_m, stiffness_n_m2: given.of_axes("stiffness", ["stiffness_x", "stiffness_y"]) }))
    }
}

/// An elastic bed from the base up to a height.
#[derive(Debug)]
struct Bed {
    z_m: f64,
    /// Along X and Y.
    stiffness_n_m2: [f64; 2],
}

/// Points and weights of Gauss's rule on 0 to 1, exact to the seventh degree: the motion of an element is cubic, its square of the sixth.
const GAUSS: [[f64; 2]; 4] = [
    [0.069_431_844_202_973_71, 0.173_927_422_568_726_93],
    [0.330_009_478_207_571_87, 0.326_072_577_431_273_07],
    [0.669_990_521_792_428_1, 0.326_072_577_431_273_07],
    [0.930_568_155_797_026_3, 0.173_927_422_568_726_93],
];

impl Contribution for Bed {
    fn attach(&self, assembly: &mut Assembly) {
        let mut bottom_m = assembly.z_base_m();
        for node_m in assembly.node_elevations_m() {
            let length_m = node_m.min(self.z_m) - bottom_m;
            if length_m <= 0.0 {
                break;
            }
            for [share, weight] in GAUSS {
                if let Some(motion) = assembly.local_motion(bottom_m + share * length_m) {
                    let springs = self.stiffness_n_m2.map(|stiffness| stiffness * weight * length_m);
                    motion.add_squares(&mut assembly.stiffness, 0, springs);
                }
            }
            bottom_m = node_m;
        }
    }
}
