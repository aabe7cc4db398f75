//! Beam elements with rotational joints in them: a segment flows in, joints and weight soften it, its stiffness and the
//! shapes that it takes between its nodes flow out.

use nalgebra::{SMatrix, SVector};

use super::DOFS_A_NODE;
use super::arms::{carry, upright};
use super::beam::Segment;
use super::element::{Compression, DOFS_A_SEGMENT, geometric_stiffness, interpolation, stiffness};

/// The stiffness of one segment in global axes, while effects change it.
#[derive(Debug, Clone)]
pub struct Element {
    /// The segment.
    pub segment: Segment,
    /// 10 x 10 (bottom node, top node), N/m, N and N m.
    pub(super) stiffness: SMatrix<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT>,
    /// The kinks of its joints, in the order in which they were put in.
    pub(super) kinks: Vec<Kink>,
}

/// A joint's kink in one plane: an element's end motions are those of the element without it, and what the kink adds.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Kink {
    /// Where the joint is, in m.
    z_m: f64,
    /// The displacement that a unit kink gives what is above it by each m, and the rotation: DOFs of a node, and the
    /// rotation's sign.
    dofs: [usize; 2],
    sign: f64,
    /// The motion of the top node by a unit kink.
    motion: SVector<f64, DOFS_A_SEGMENT>,
    /// The angle from the end motions.
    angle: SMatrix<f64, 1, DOFS_A_SEGMENT>,
}

impl Element {
    /// A segment without joints.
    pub(super) fn of(segment: Segment) -> Self {
        Self { stiffness: stiffness(&segment), segment, kinks: Vec::new() }
    }

    /// Stands it so far above its nodes, for motion along X and Y in m.
    pub(super) fn raise(&mut self, above_m: [f64; 2]) {
        if above_m != [0.0; 2] {
            let rows = |first: usize| std::array::from_fn(|dof| Some(first + dof));
            carry(&mut self.stiffness, &upright(&[rows(0), rows(DOFS_A_NODE)], above_m));
        }
    }

    /// Puts a rotational joint in at `z_m` with its flexibilities about X and Y; leaves an element alone that does not reach
    /// there. A joint between two segments belongs to the upper one.
    ///
    /// It is eliminated without approximation: a kink of the unit angle with both ends held needs the end forces v = K u, u
    /// the motion that the kink gives the top node. With end motions d the angle is `c vᵀ d / (1 + c uᵀ K u)` for a
    /// flexibility c, and `K - c v vᵀ / (1 + c uᵀ K u)` is what is left.
    pub(super) fn hinge(&mut self, z_m: f64, [about_x, about_y]: [f64; 2]) {
        if !(self.segment.z_bottom_m..self.segment.z_top_m).contains(&z_m) {
            return;
        }
        let lever_m = self.segment.z_top_m - z_m;
        // Slopes along X and Y are ry and -rx.
        for (dofs, sign, flexibility_rad_n_m) in [([0, 3], 1.0, about_y), ([1, 2], -1.0, about_x)] {
            let mut motion = SVector::<f64, DOFS_A_SEGMENT>::zeros();
            motion[DOFS_A_NODE + dofs[0]] = lever_m;
            motion[DOFS_A_NODE + dofs[1]] = sign;
            let forces = self.stiffness * motion;
            let angle = forces.transpose() * (flexibility_rad_n_m / (1.0 + flexibility_rad_n_m * motion.dot(&forces)));
            self.stiffness -= forces * angle;
            self.kinks.push(Kink { z_m, dofs, sign, motion, angle });
        }
    }

    /// Puts springs between the sways of its ends, of what shears beside it, with this shear stiffness along X and Y in N.
    pub(super) fn stand_beside(&mut self, frames_n: [f64; 2]) {
        for (direction, frames_n) in frames_n.into_iter().enumerate() {
            let spring = frames_n / self.segment.length_m();
            for (row, column, sign) in [(0, 0, 1.0), (0, 1, -1.0), (1, 0, -1.0), (1, 1, 1.0)] {
                self.stiffness[(direction + row * DOFS_A_NODE, direction + column * DOFS_A_NODE)] += sign * spring;
            }
        }
    }

    /// Softens it by a compression.
    pub(super) fn compress(&mut self, compression: Compression) {
        if let Some(geometric) = geometric_stiffness(&self.segment, compression) {
            self.stiffness -= geometric;
        }
    }
}

/// As [`interpolation`], of a segment with joints, in the order in which they were put in.
pub(super) fn kinked(segment: &Segment, kinks: &[Kink], z_m: f64) -> SMatrix<f64, DOFS_A_NODE, DOFS_A_SEGMENT> {
    // End motions of the element without joints, from those with them.
    let mut ends = SMatrix::<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT>::identity();
    let mut above = SMatrix::<f64, DOFS_A_NODE, DOFS_A_SEGMENT>::zeros();
    for kink in kinks.iter().rev() {
        let angle = kink.angle * ends;
        ends -= kink.motion * angle;
        if z_m > kink.z_m {
            let [deflection, rotation] = kink.dofs;
            for column in 0..DOFS_A_SEGMENT {
                above[(deflection, column)] += (z_m - kink.z_m) * angle[column];
                above[(rotation, column)] += kink.sign * angle[column];
            }
        }
    }
    interpolation(segment, z_m) * ends + above
}
