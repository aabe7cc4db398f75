//! How sections change their form in plan where a structure bends and twists.
//!
//! A beam's sections are rigid; those of shells and lattices are not. How the axis bends and turns flows in; what a sensor away from
//! the axis sees besides the motion of a rigid section flows out.

use std::ops::Add;

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

    /// What `kx`, `ky` and `rz` each add to the displacement at a plan offset along a direction, cosines with X and Y.
    pub(super) fn at(&self, [x, y]: [f64; 2], [cos, sin]: [f64; 2]) -> [f64; 3] {
        let (half, product) = (0.5 * (x * x - y * y), x * y);
        [
            self.narrowing * (half * cos + product * sin),
            self.narrowing * (product * cos - half * sin),
            self.racking * (y * cos + x * sin),
        ]
    }
}

impl Contribution for Distortion {
    fn distortion(&self) -> Distortion {
        *self
    }
}
