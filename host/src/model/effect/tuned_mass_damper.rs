//! `tuned-mass-damper@z`: a mass on a spring and a dashpot.

use std::f64::consts::TAU;
use std::sync::Arc;

use super::error::EffectError;
use super::kind::{About, EffectKind, Evidence, Given, LookAlike};
use super::parameter::{Parameter, Prior};
use super::place::PlaceKind;
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "tuned-mass-damper",
    physics: "A damper that the model does not know is tuned to a mode: a pendulum, a water tank, a mass on rubber. It \
         splits the peak of that mode into two with high damping and like shapes.",
    formula: "one more DOF for each direction: k = m (2 pi f)^2 and c = 4 pi f zeta m to the axis at z",
    fingerprint: "split peak: twins with a MAC near 1 and high damping",
    look_alikes: &[LookAlike { kind: "added-mass", separated_by: "the twin peak: a mass that is fixed has none" }],
    source: "J. P. Den Hartog (1956), Mechanical Vibrations, section 3.3",
    examples: &[
        "tuned-mass-damper@300m=mass=1e5,frequency=0.14,damping_ratio=0.05",
        "tuned-mass-damper@300m=mass=1e5,frequency=0.14,damping_ratio=0.05,axis=x",
    ],
};

const MASS: Parameter = Parameter { prior: Prior::Share(1.0), ..Parameter::positive("mass", "kg", "the moving mass") };
const FREQUENCY: Parameter = Parameter {
    prior: Prior::Share(0.1),
    ..Parameter::ranged("frequency", "Hz", [1e-4, 1e4], 1.0, "its own frequency")
};
// Above zero: without any damping C is empty, and the fit cannot see which way to go.
const DAMPING: Parameter = Parameter::ranged("damping_ratio", "-", [1e-4, 0.5], 0.05, "its own damping ratio");
const AXIS: Parameter =
    Parameter::given("axis", "x or y", [1.0, 2.0], "the direction in which it moves; both without it");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct TunedMassDamper;

impl EffectKind for TunedMassDamper {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn place(&self) -> PlaceKind {
        PlaceKind::Height
    }

    fn evidence(&self) -> Evidence {
        Evidence::TwinPeaks
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[MASS, FREQUENCY, DAMPING], &[MASS, FREQUENCY, DAMPING, AXIS]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        Ok(Arc::new(TunedMass {
            z_m: given.height_m(self, structure)?,
            mass_kg: given.or_zero(MASS.name),
            frequency_hz: given.or_zero(FREQUENCY.name),
            damping_ratio: given.or_zero(DAMPING.name),
            moves: match given.value(AXIS.name) {
                Some(axis) => [axis < 1.5, axis >= 1.5],
                None => [true; 2],
            },
        }))
    }
}

/// A mass on a spring and a dashpot that moves sideways.
#[derive(Debug, Clone, Copy)]
pub(in crate::model) struct TunedMass {
    /// Its height in m, between base and top.
    pub(in crate::model) z_m: f64,
    /// Its mass in kg.
    pub(in crate::model) mass_kg: f64,
    /// Its own frequency on a fixed base in Hz.
    pub(in crate::model) frequency_hz: f64,
    /// Its own damping ratio.
    pub(in crate::model) damping_ratio: f64,
    /// Whether it moves along X and Y.
    pub(in crate::model) moves: [bool; 2],
}

impl Contribution for TunedMass {
    /// One more DOF for each direction in which it moves.
    fn hang(&self, assembly: &mut Assembly) {
        let omega = TAU * self.frequency_hz;
        let (stiffness, damping) = (self.mass_kg * omega * omega, 2.0 * self.mass_kg * self.damping_ratio * omega);
        for axis in (0..2).filter(|&axis| self.moves[axis]) {
            let motion = assembly.axis_motion(self.z_m).row(axis).into_owned();
            let dof = assembly.add_dof();
            let mut stretch = motion.resize_horizontally(dof + 1, 0.0);
            stretch[dof] = -1.0;
            assembly.stiffness += stretch.tr_mul(&stretch) * stiffness;
            assembly.mass[(dof, dof)] = self.mass_kg;
            if damping > 0.0 {
                assembly.add_damping(&(stretch.tr_mul(&stretch) * damping));
            }
        }
    }

    fn is_damper(&self) -> bool {
        true
    }
}
