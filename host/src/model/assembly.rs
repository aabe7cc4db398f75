//! From a structure (beam, base, added masses, global factors) to its mass and stiffness matrices.

use nalgebra::{DMatrix, SMatrix, SVector};

use super::beam::BeamTable;
use super::effect::{Effect, EffectError};
use super::eigen::{EigenError, Modes, eigenmodes};
use super::element::{interpolation, scatter, stiffness};
use super::{DOFS_A_NODE, Segment};

/// A beam and everything else that effects may change before it is assembled.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// The beam.
    pub beam: BeamTable,
    /// How far the base gives way; all zero is clamped.
    pub base: BaseFlexibility,
    /// Masses besides those of the table.
    pub added_masses: Vec<AddedMass>,
    /// Factor on the whole of K, base springs included (1 leaves it as it is).
    pub stiffness_factor: f64,
    /// Factor on the whole of M, added masses included.
    pub mass_factor: f64,
}

/// Flexibilities of the springs under the base node, about and along the global axes; 0 is clamped.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BaseFlexibility {
    /// Along X and Y in m/N.
    pub translation_m_n: [f64; 2],
    /// About X and Y in rad/(N m).
    pub rotation_rad_n_m: [f64; 2],
}

/// A mass without rotational inertia, fixed to the beam axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AddedMass {
    /// Its height in m, between base and top.
    pub z_m: f64,
    /// Its mass in kg.
    pub mass_kg: f64,
}

/// Mass and stiffness matrices with what places them in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Assembly {
    /// K, DOFs x DOFs, base left out, symmetric (N/m, N, N m).
    pub stiffness: DMatrix<f64>,
    /// M, DOFs x DOFs, symmetric (kg, kg m, kg m²).
    pub mass: DMatrix<f64>,
    /// Motion of the base node that follows from the DOFs, 5 x DOFs; zero where it is clamped.
    base_motion: DMatrix<f64>,
    /// The segments as assembled, for interpolation between nodes.
    segments: Vec<Segment>,
}

impl Structure {
    /// The beam as its table gives it, clamped at the base.
    pub fn new(beam: BeamTable) -> Self {
        let base = BaseFlexibility::default();
        Self { beam, base, added_masses: Vec::new(), stiffness_factor: 1.0, mass_factor: 1.0 }
    }

    /// A beam with effects, applied in their order, clamped at the base but for what they free.
    ///
    /// # Errors
    /// [`EffectError::OutsideBeam`] where an effect's height is not on this beam.
    pub fn with_effects(beam: BeamTable, effects: &[Effect]) -> Result<Self, EffectError> {
        let mut structure = Self::new(beam);
        for effect in effects {
            effect.apply(&mut structure)?;
        }
        Ok(structure)
    }

    /// K and M over five DOFs a node, base first and left out.
    ///
    /// The base node carries no mass, so its springs are condensed without approximation: with flexibilities C on the
    /// base DOFs b, `x_b = -(I + C K_bb)⁻¹ C K_bf x_f` and `K = K_ff + K_fb x_b/x_f`. C = 0 is the clamped base, so a
    /// flexibility acts smoothly from zero on and M stays positive definite. (I + C K_bb has eigenvalues of 1 and more
    /// for flexibilities of 0 and more, so it always has an inverse.)
    pub fn assemble(&self) -> Assembly {
        let segments = self.beam.segments();
        let free = segments.len() * DOFS_A_NODE;
        let mut whole = DMatrix::zeros(free + DOFS_A_NODE, free + DOFS_A_NODE);
        for (index, segment) in segments.iter().enumerate() {
            scatter(&mut whole, &stiffness(segment), index);
        }
        let base_base: SMatrix<f64, DOFS_A_NODE, DOFS_A_NODE> =
            whole.fixed_view::<DOFS_A_NODE, DOFS_A_NODE>(0, 0).into();
        let base_free = whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, free)).into_owned();
        let flexibility = SMatrix::from_diagonal(&self.base.diagonal());
        let soft = SMatrix::<f64, DOFS_A_NODE, DOFS_A_NODE>::identity() + flexibility * base_base;
        let base_motion = soft.lu().solve(&flexibility).map_or_else(
            || DMatrix::zeros(DOFS_A_NODE, free),
            |given_way| DMatrix::from_column_slice(DOFS_A_NODE, DOFS_A_NODE, (-given_way).as_slice()) * &base_free,
        );
        let mut stiffness = whole.view((DOFS_A_NODE, DOFS_A_NODE), (free, free)) + base_free.tr_mul(&base_motion);
        // The two sums round differently above and below the diagonal.
        stiffness = (&stiffness + stiffness.transpose()) * (0.5 * self.stiffness_factor);

        let mut assembly =
            Assembly { stiffness, mass: DMatrix::zeros(free, free), base_motion, segments: segments.to_vec() };
        let mut mass = DMatrix::zeros(free, free);
        for (index, segment) in segments.iter().enumerate() {
            let [inertia_x, inertia_y, inertia_z] = segment.inertia_kg_m2;
            let lumped = [segment.mass_top_kg, segment.mass_top_kg, inertia_x, inertia_y, inertia_z];
            for (dof, value) in lumped.into_iter().enumerate() {
                let row = index * DOFS_A_NODE + dof;
                mass[(row, row)] += value;
            }
        }
        for added in &self.added_masses {
            let motion = assembly.axis_motion(added.z_m);
            let horizontal = motion.rows(0, 2);
            mass += horizontal.tr_mul(&horizontal) * added.mass_kg;
        }
        assembly.mass = mass * self.mass_factor;
        assembly
    }
}

impl BaseFlexibility {
    fn diagonal(&self) -> SVector<f64, DOFS_A_NODE> {
        let ([along_x, along_y], [about_x, about_y]) = (self.translation_m_n, self.rotation_rad_n_m);
        SVector::from([along_x, along_y, about_x, about_y, 0.0])
    }
}

impl Assembly {
    /// Number of degrees of freedom.
    pub fn dofs(&self) -> usize {
        self.stiffness.nrows()
    }

    /// Heights of the nodes in m, lowest first, the base left out; node i has the DOFs from 5 i on.
    pub fn node_elevations_m(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.segments.iter().map(|segment| segment.z_top_m)
    }

    /// Height of the base in m.
    pub fn z_base_m(&self) -> f64 {
        self.segments.first().map_or(0.0, |segment| segment.z_bottom_m)
    }

    /// Height of the top in m.
    pub fn z_top_m(&self) -> f64 {
        self.segments.last().map_or(0.0, |segment| segment.z_top_m)
    }

    /// The structure's modes, lowest frequency first.
    ///
    /// # Errors
    /// [`EigenError`] where the matrices are not those of a supported structure.
    pub fn modes(&self) -> Result<Modes, EigenError> {
        eigenmodes(&self.stiffness, &self.mass)
    }

    /// Motion of the beam axis at a height, 5 x DOFs: rows `ux, uy, rx, ry, rz`. Between nodes the element's own shape
    /// functions (cubic, with the shear correction); heights outside the beam count as its ends.
    pub fn axis_motion(&self, z_m: f64) -> DMatrix<f64> {
        let mut motion = DMatrix::zeros(DOFS_A_NODE, self.dofs());
        let last = self.segments.len().saturating_sub(1);
        let index = self.segments.iter().position(|segment| z_m <= segment.z_top_m).unwrap_or(last);
        let Some(segment) = self.segments.get(index) else { return motion };
        let shape = interpolation(segment, z_m);
        let (bottom, top) = (shape.columns(0, DOFS_A_NODE), shape.columns(DOFS_A_NODE, DOFS_A_NODE));
        motion.columns_mut(index * DOFS_A_NODE, DOFS_A_NODE).copy_from(&top);
        match index.checked_sub(1) {
            Some(below) => motion.columns_mut(below * DOFS_A_NODE, DOFS_A_NODE).copy_from(&bottom),
            None => motion += bottom * &self.base_motion,
        }
        motion
    }
}
