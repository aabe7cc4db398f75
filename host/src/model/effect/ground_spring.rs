//! A spring between the axis at a height and the ground: against sway, or against rotation about horizontal axes.

use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;

/// Rows of the axis' motion at a height: along X and Y, then about X and Y.
const SWAY: usize = 0;
const ROTATION: usize = 2;

/// A spring to the ground.
#[derive(Debug)]
pub(super) struct GroundSpring {
    z_m: f64,
    first_row: usize,
    stiffness: [f64; 2],
}

impl GroundSpring {
    /// Along X and Y, in N/m.
    pub(super) fn lateral(z_m: f64, stiffness: [f64; 2]) -> Self {
        Self { z_m, first_row: SWAY, stiffness }
    }

    /// About X and Y, in N m/rad.
    pub(super) fn rotational(z_m: f64, stiffness: [f64; 2]) -> Self {
        Self { z_m, first_row: ROTATION, stiffness }
    }
}

impl Contribution for GroundSpring {
    fn attach(&self, assembly: &mut Assembly) {
        if let Some(motion) = assembly.local_motion(self.z_m) {
            motion.add_squares(&mut assembly.stiffness, self.first_row, self.stiffness);
        }
    }
}
