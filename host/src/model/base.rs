//! The base of a beam on springs: flexibilities flow in, the condensed stiffness and the motion of the base flow out.
//!
//! The base node carries no mass, so its springs are condensed without approximation: with flexibilities C on the base DOFs
//! b, `x_b = -(I + C K_bb)⁻¹ C K_bf x_f` and `K = K_ff + K_fb x_b/x_f`. C = 0 is the clamped base, so a flexibility acts
//! smoothly from zero on and M stays positive definite. (I + C K_bb has eigenvalues of 1 and more for flexibilities of 0
//! and more, so it always has an inverse.)

use nalgebra::{DMatrix, SMatrix, SVector};

use super::DOFS_A_NODE;

/// Flexibilities of the springs under the base node, about and along the global axes; 0 is clamped.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BaseFlexibility {
    /// Along X and Y in m/N.
    pub translation_m_n: [f64; 2],
    /// About X and Y in rad/(N m).
    pub rotation_rad_n_m: [f64; 2],
}

impl BaseFlexibility {
    /// Adds springs in series.
    pub(super) fn add(&mut self, more: &Self) {
        for axis in 0..2 {
            self.translation_m_n[axis] += more.translation_m_n[axis];
            self.rotation_rad_n_m[axis] += more.rotation_rad_n_m[axis];
        }
    }

    fn diagonal(&self) -> SVector<f64, DOFS_A_NODE> {
        let ([along_x, along_y], [about_x, about_y]) = (self.translation_m_n, self.rotation_rad_n_m);
        SVector::from([along_x, along_y, about_x, about_y, 0.0])
    }

    /// Motion of the base node that follows from the free DOFs, 5 x free; `whole` is K with the base's DOFs first.
    pub(super) fn motion(&self, whole: &DMatrix<f64>) -> DMatrix<f64> {
        let free = whole.nrows() - DOFS_A_NODE;
        let base_base: SMatrix<f64, DOFS_A_NODE, DOFS_A_NODE> =
            whole.fixed_view::<DOFS_A_NODE, DOFS_A_NODE>(0, 0).into();
        let flexibility = SMatrix::from_diagonal(&self.diagonal());
        let soft = SMatrix::<f64, DOFS_A_NODE, DOFS_A_NODE>::identity() + flexibility * base_base;
        soft.lu().solve(&flexibility).map_or_else(
            || DMatrix::zeros(DOFS_A_NODE, free),
            |given_way| {
                DMatrix::from_column_slice(DOFS_A_NODE, DOFS_A_NODE, (-given_way).as_slice())
                    * whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, free))
            },
        )
    }

    /// K of the free DOFs, and the motion of the base that follows from them; `whole` is K with the base's DOFs first.
    pub(super) fn condense(&self, whole: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
        let free = whole.nrows() - DOFS_A_NODE;
        let base_motion = self.motion(whole);
        // Column by column: this is where the model is copied most often.
        let mut entries = Vec::with_capacity(free * free);
        for column in whole.as_slice().chunks_exact(free + DOFS_A_NODE).skip(DOFS_A_NODE) {
            entries.extend_from_slice(&column[DOFS_A_NODE..]);
        }
        let mut stiffness = DMatrix::from_vec(free, free, entries);
        // Only the first node is tied to the base.
        let near = DOFS_A_NODE.min(free);
        let base_near = whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, near)).into_owned();
        let condensed = base_near.tr_mul(&base_motion.columns(0, near));
        // The two sums round differently above and below the diagonal.
        let condensed = (&condensed + condensed.transpose()) * 0.5;
        let mut corner = stiffness.view_mut((0, 0), (near, near));
        corner += condensed;
        (stiffness, base_motion)
    }
}
