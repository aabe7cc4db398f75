//! How sections change their form in plan where a structure bends and twists.
//!
//! A beam's sections are rigid; those of shells and lattices are not. How the axis bends and turns flows in; what a sensor away from
//! the axis sees besides the motion of a rigid section flows out.

use std::ops::Add;

use nalgebra::{DMatrix, RowDVector};

use super::contribution::Contribution;

/// How far sections distort in their own plane. Displacements are those at the plan offset (x, y) from the axis, which bends by
/// `k = d²(ux, uy)/dz²` and turns by rz.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Distortion {
    /// Poisson's ratio ν of the section as a whole: it narrows where fibres stretch, by `ux = ν (kx (x² - y²)/2 + ky x y)` and
    /// `uy = ν (kx x y + ky (y² - x²)/2)` (Timoshenko and Goodier 1970, Theory of Elasticity, art. 102). Stiff floors make it none.
    pub narrowing: f64,
    /// The share c of its rotation by which a section racks, `ux = c y rz` and `uy = c x rz`: an oval shell and a lattice with unlike faces
    /// become oblique where inertia acts on their faces otherwise than shear flows in them.
    pub racking: f64,
}

impl Add for Distortion {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { narrowing: self.narrowing + other.narrowing, racking: self.racking + other.racking }
    }
}

impl Distortion {
    /// Whether sections keep their form.
    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Displacements along X and Y at a plan offset, over the DOFs; `bent` has the rows `kx`, `ky` and `rz`.
    pub(super) fn at(&self, [x, y]: [f64; 2], bent: &DMatrix<f64>) -> [RowDVector<f64>; 2] {
        let (kx, ky, rz) = (bent.row(0), bent.row(1), bent.row(2));
        let (half, product) = (0.5 * (x * x - y * y), x * y);
        [
            (kx * half + ky * product) * self.narrowing + rz * (self.racking * y),
            (kx * product - ky * half) * self.narrowing + rz * (self.racking * x),
        ]
    }
}

impl Contribution for Distortion {
    fn distortion(&self) -> Distortion {
        *self
    }
}
