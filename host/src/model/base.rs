//! The base of a beam on springs: flexibilities flow in, the condensed stiffness and the motion of the base flow out.
//!
//! The base node carries no mass, so its springs are condensed without approximation: with the flexibility C of the base DOFs
//! b, `x_b = -(I + C K_bb)⁻¹ C K_bf x_f` and `K = K_ff + K_fb x_b/x_f`. C = 0 is the clamped base, so a flexibility acts
//! smoothly from zero on and M stays positive definite. (I + C K_bb has eigenvalues of 1 and more for flexibilities of 0
//! and more, so it always has an inverse.)

use nalgebra::{DMatrix, SMatrix};

use super::DOFS_A_NODE;

/// Flexibilities of the springs under the base node, about and along the global axes; 0 is clamped.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BaseFlexibility {
    /// Along X and Y in m/N.
    pub translation_m_n: [f64; 2],
    /// About X and Y in rad/(N m).
    pub rotation_rad_n_m: [f64; 2],
    /// About Y by a unit moment about X, and the other way round, in rad/(N m): the axes of largest and least rotation are turned.
    pub skew_rad_n_m: f64,
    /// About Z in rad/(N m).
    pub torsion_rad_n_m: f64,
    /// Translation along X by a unit moment about Y, and along Y by one about X, in 1/N: sway and rocking are coupled.
    pub coupling_per_n: [f64; 2],
}

impl BaseFlexibility {
    /// Adds springs in series.
    pub(super) fn add(&mut self, more: &Self) {
        for axis in 0..2 {
            self.translation_m_n[axis] += more.translation_m_n[axis];
            self.rotation_rad_n_m[axis] += more.rotation_rad_n_m[axis];
            self.coupling_per_n[axis] += more.coupling_per_n[axis];
        }
        self.skew_rad_n_m += more.skew_rad_n_m;
        self.torsion_rad_n_m += more.torsion_rad_n_m;
    }

    /// A base that rotates about X and Y around a point `depth_m` below it, as a foundation does that is embedded or stands on
    /// piles (Gazetas 1991): where it turns by ry, the base moves by ux = depth ry.
    pub(super) fn rocking(rotation_rad_n_m: [f64; 2], depth_m: f64) -> Self {
        let [about_x, about_y] = rotation_rad_n_m;
        Self {
            rotation_rad_n_m,
            translation_m_n: [about_y, about_x].map(|flexibility| flexibility * depth_m * depth_m),
            coupling_per_n: [about_y * depth_m, -about_x * depth_m],
            ..Self::default()
        }
    }

    /// A base that rotates about X and Y, and besides about one diagonal between them: that of X and Y for a positive flexibility, that of X
    /// and -Y for a negative one.
    pub(super) fn rocking_about_diagonal(rotation_rad_n_m: [f64; 2], diagonal_rad_n_m: f64) -> Self {
        let half = 0.5 * diagonal_rad_n_m;
        let rotation_rad_n_m = rotation_rad_n_m.map(|flexibility| flexibility + half.abs());
        Self { rotation_rad_n_m, skew_rad_n_m: half, ..Self::default() }
    }

    /// All of it times a factor.
    pub(super) fn times(&self, factor: f64) -> Self {
        let both = |pair: [f64; 2]| pair.map(|value| value * factor);
        Self {
            translation_m_n: both(self.translation_m_n),
            rotation_rad_n_m: both(self.rotation_rad_n_m),
            skew_rad_n_m: self.skew_rad_n_m * factor,
            torsion_rad_n_m: self.torsion_rad_n_m * factor,
            coupling_per_n: both(self.coupling_per_n),
        }
    }

    /// C over `ux, uy, rx, ry, rz`.
    fn matrix(&self) -> SMatrix<f64, DOFS_A_NODE, DOFS_A_NODE> {
        let ([along_x, along_y], [about_x, about_y]) = (self.translation_m_n, self.rotation_rad_n_m);
        let mut matrix = SMatrix::from_diagonal(&[along_x, along_y, about_x, about_y, self.torsion_rad_n_m].into());
        let [of_x, of_y] = self.coupling_per_n;
        for (one, other, coupling) in [(0, 3, of_x), (1, 2, of_y), (2, 3, self.skew_rad_n_m)] {
            (matrix[(one, other)], matrix[(other, one)]) = (coupling, coupling);
        }
        matrix
    }

    /// Whether nothing gives.
    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Of a structure that is clamped, and moves as a whole by these motions of its base (DOFs x 5): what its K changes by where the base gives,
    /// and the motion of the base that follows from the DOFs. Flexibilities add: `K'^-1 = K^-1 + R C R^T`.
    pub(super) fn under(&self, stiffness: &DMatrix<f64>, rigid: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let flexibility = DMatrix::from_column_slice(DOFS_A_NODE, DOFS_A_NODE, self.matrix().as_slice());
        let reactions = rigid.tr_mul(stiffness);
        let soft = DMatrix::identity(DOFS_A_NODE, DOFS_A_NODE) + &flexibility * &reactions * rigid;
        let base_motion = soft.lu().solve(&(flexibility * &reactions))?;
        let change = -reactions.tr_mul(&base_motion);
        Some(((&change + change.transpose()) * 0.5, base_motion))
    }

    /// Motion of the base node that follows from the free DOFs, 5 x free; `whole` is K with the base's DOFs first.
    pub(super) fn motion(&self, whole: &DMatrix<f64>) -> DMatrix<f64> {
        let free = whole.nrows() - DOFS_A_NODE;
        let base_base: SMatrix<f64, DOFS_A_NODE, DOFS_A_NODE> =
            whole.fixed_view::<DOFS_A_NODE, DOFS_A_NODE>(0, 0).into();
        let flexibility = self.matrix();
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
