//! `stiffness-loss@z`: damage or a weaker section around a height.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use super::place::PlaceKind;
use crate::model::beam::Segment;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "stiffness-loss",
    physics: "A few neighbouring segments are softer than modelled: cracked concrete, openings, a change of section that \
         the model smeared. Bending, shear and torsion lose the same share.",
    formula: "EI, kGA and GJ of the segments around z times (1 - relative)",
    fingerprint: "modes with a large curvature at z too low; a kink in their curvature there",
    look_alikes: &[
        LookAlike {
            kind: "added-mass",
            separated_by: "more sensors around the height: a loss kinks the curvature, a mass does not",
        },
        LookAlike {
            kind: "connection-flexibility",
            separated_by: "torsion, which a rotational joint leaves alone; sensors close above and below",
        },
        LookAlike { kind: "base-rotation", separated_by: "for a loss at the very bottom: a sensor at the base" },
    ],
    source: "A. K. Pandey, M. Biswas, M. M. Samman (1991), Damage detection from changes in curvature mode shapes, J. \
         Sound Vib. 145",
    examples: &["stiffness-loss@150m=0.3", "stiffness-loss@150m=relative=0.3,length=20"],
};

/// A full loss would cut the structure in two, so the range ends short of it.
const RELATIVE: Parameter = Parameter::ranged("relative", "-", [0.0, 0.99], 0.3, "share of stiffness that is lost");
const LENGTH: Parameter = Parameter::given(
    "length",
    "m",
    [0.0, f64::INFINITY],
    "segments whose middle lies within half of it from z lose stiffness; without it the segment at z, or the two that meet there",
);

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct StiffnessLoss;

impl EffectKind for StiffnessLoss {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Height
    }

    fn may_be_anywhere(&self) -> bool {
        false
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[RELATIVE], &[RELATIVE, LENGTH]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        let z_m = given.height_m(self, structure)?;
        given.check_beam(self, structure)?;
        Ok(Arc::new(Loss { z_m, left: 1.0 - given.or_zero(RELATIVE.name), length_m: given.value(LENGTH.name) }))
    }
}

/// Segments around a height that keep a share of their stiffness.
#[derive(Debug)]
struct Loss {
    z_m: f64,
    left: f64,
    length_m: Option<f64>,
}

impl Contribution for Loss {
    fn change_segments(&self, segments: &mut [Segment]) {
        for segment in segments {
            let reaches = match self.length_m {
                Some(length_m) => (0.5 * (segment.z_bottom_m + segment.z_top_m) - self.z_m).abs() <= 0.5 * length_m,
                None => (segment.z_bottom_m..=segment.z_top_m).contains(&self.z_m),
            };
            if reaches {
                segment.scale_stiffness(self.left);
            }
        }
    }
}
