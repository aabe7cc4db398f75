//! `axis-rotation`: the principal axes of the structure point elsewhere.

use super::target::check_line;
use super::{About, EffectError, EffectKind, Given, LookAlike, Parameter};
use crate::model::Structure;

const ABOUT: About = About {
    name: "axis-rotation",
    physics: "The directions of largest and least stiffness are not where the drawings put them, as where walls were \
         moved. Shapes turn in plan and frequencies stay.",
    formula: "K becomes T^T K T, T turning X and Y at every node",
    fingerprint: "shapes turn by the same angle in all bending modes, frequencies stay",
    look_alikes: &[
        LookAlike {
            kind: "sensor-rotation",
            separated_by: "exact twin of all sensors turned: survey the azimuth of a few sensors",
        },
        LookAlike { kind: "mass-eccentricity", separated_by: "torsion: turned axes bring none into bending" },
    ],
    source: "A. K. Chopra (2012), Dynamics of Structures, section 9.5",
};

const ANGLE: Parameter =
    Parameter::ranged("angle", "deg", [-90.0, 90.0], 10.0, "how far the axes are turned anticlockwise");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct AxisRotation;

impl EffectKind for AxisRotation {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[ANGLE]]
    }

    fn apply(&self, given: &Given<'_>, structure: &mut Structure) -> Result<(), EffectError> {
        check_line(ABOUT.name, structure)?;
        structure.axis_turn_deg += given.or_zero(ANGLE.name);
        Ok(())
    }
}
