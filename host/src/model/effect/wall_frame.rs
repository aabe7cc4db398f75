//! `wall-frame`: frames beside a wall carry shear in parallel, which one beam does not.

use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::beam::Segment;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "wall-frame",
    physics: "Floors tie a wall or core, which bends, to frames, which shear. The frames hold the wall back near the top and lean on it \
         near the base, so how they share the load depends on its shape. A table of one beam, from loads at the top, has them merged: \
         right for these loads, too stiff for the higher modes.",
    formula: "k = GA_f/L between the sways of successive nodes, GA_f = share / u(top), and EI becomes EI (1 - GA_f (u(top) - u)), with u \
         the sway under a unit moment at the top, which stays what it was",
    fingerprint: "frequencies too high in the model, the second and third of each direction two to four times as far as the first; torsion is \
         right",
    look_alikes: &[
        LookAlike {
            kind: "shear-flexibility",
            separated_by: "the first modes, and how the errors grow with the order",
        },
        LookAlike { kind: "stiffness-loss", separated_by: "modes of torsion, which it leaves where they are" },
    ],
    source: "A. C. Heidebrecht, B. Stafford Smith (1973), J. Struct. Div. ASCE 99, 169; B. Stafford Smith, A. Coull (1991), Tall Building \
         Structures, chapter 11",
    examples: &["wall-frame=0.15", "wall-frame=share_x=0.15,share_y=0.1"],
};

/// The wall carries something at every height.
const LARGEST: f64 = 0.9;

const fn share(name: &'static str, meaning: &'static str) -> Parameter {
    Parameter::ranged(name, "-", [0.0, LARGEST], 0.15, meaning)
}

const PARAMETER_SETS: &[&[Parameter]] = &[
    &[share("share", "of a moment at the top, what the frames have taken from the wall at the base")],
    &[share("share_x", "the same of motion along X"), share("share_y", "the same of motion along Y")],
];

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct WallFrame;

impl EffectKind for WallFrame {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        PARAMETER_SETS
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_beam(self, structure)?;
        let segments = structure.segments().unwrap_or_default();
        let shares = given.of_axes("share", ["share_x", "share_y"]);
        let sways_m = [0, 1].map(|direction| sways_m(&segments, direction));
        let of_top = |direction: usize| shares[direction] / sways_m[direction].last().copied().unwrap_or(1.0);
        let frames_n = [0, 1].map(of_top);
        let taken = |segment: usize| {
            [0, 1].map(|direction| {
                let (sways, top) = (&sways_m[direction], sways_m[direction].last().copied().unwrap_or_default());
                frames_n[direction] * (top - 0.5 * (sways[segment] + sways[segment + 1]))
            })
        };
        Ok(Arc::new(Merged { frames_n, taken: (0..segments.len()).map(taken).collect() }))
    }
}

/// Sway of base and nodes in m along X (0) or Y (1) under a moment of 1 N m at the top: of bending alone, for there is no shear force.
fn sways_m(segments: &[Segment], direction: usize) -> Vec<f64> {
    let (mut sway_m, mut rotation) = (0.0, 0.0);
    let above = segments.iter().map(|segment| {
        let shares = axes(segment)[direction];
        let bent = segment.length_m() * (shares[0] / segment.bending_n_m2[0] + shares[1] / segment.bending_n_m2[1]);
        sway_m += segment.length_m() * (rotation + 0.5 * bent);
        rotation += bent;
        sway_m
    });
    std::iter::once(0.0).chain(above).collect()
}

/// Squared cosines between X and Y (rows) and the segment's local axes.
fn axes(segment: &Segment) -> [[f64; 2]; 2] {
    let square = segment.axis_deg.to_radians().cos().powi(2);
    [[square, 1.0 - square], [1.0 - square, square]]
}

/// What the table has in one beam, taken apart.
#[derive(Debug)]
struct Merged {
    /// Shear stiffness of the frames along X and Y in N.
    frames_n: [f64; 2],
    /// Of a moment at the top, the share that the frames have taken in the middle of each segment.
    taken: Vec<[f64; 2]>,
}

impl Contribution for Merged {
    fn change_segments(&self, segments: &mut [Segment]) {
        for (segment, taken) in segments.iter_mut().zip(&self.taken) {
            let axes = axes(segment);
            for (axis, bending) in segment.bending_n_m2.iter_mut().enumerate() {
                *bending *= 1.0 - axes[0][axis] * taken[0] - axes[1][axis] * taken[1];
            }
        }
    }

    fn frames_n(&self) -> [f64; 2] {
        self.frames_n
    }
}
