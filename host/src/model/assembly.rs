//! From a structure (beam, base, added masses, global factors) to its mass and stiffness matrices.

use nalgebra::{DMatrix, SMatrix, SVector};

use super::DOFS_A_NODE;
use super::beam::BeamTable;
use super::effect::{Effect, EffectError};
use super::eigen::{EigenError, ModalBasis, Modes};
use super::element::{scatter, stiffness};
use super::geometry::{Geometry, Line};
use super::matrices::ImportedMatrices;

/// What a model is made of.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// A table of beam segments.
    Beam(BeamTable),
    /// Matrices from elsewhere.
    Matrices(ImportedMatrices),
}

/// A body and everything else that effects may change before it is assembled.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// What it is made of.
    pub body: Body,
    /// How far the base of a beam gives way; all zero is clamped.
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
    /// Where the DOFs stand.
    pub(super) geometry: Geometry,
}

impl From<BeamTable> for Body {
    fn from(beam: BeamTable) -> Self {
        Self::Beam(beam)
    }
}

impl Structure {
    /// The body as it is given; a beam is clamped at the base.
    pub fn new(body: impl Into<Body>) -> Self {
        let (body, base) = (body.into(), BaseFlexibility::default());
        Self { body, base, added_masses: Vec::new(), stiffness_factor: 1.0, mass_factor: 1.0 }
    }

    /// A body with effects, applied in their order; a beam is clamped at the base but for what they free.
    ///
    /// # Errors
    /// [`EffectError`] where an effect's height is not on this structure, or it needs a beam table.
    pub fn with_effects(body: impl Into<Body>, effects: &[Effect]) -> Result<Self, EffectError> {
        let mut structure = Self::new(body);
        for effect in effects {
            effect.apply(&mut structure)?;
        }
        Ok(structure)
    }

    /// Heights of base and top in m; `None` where the body is no line.
    pub fn z_range_m(&self) -> Option<[f64; 2]> {
        match &self.body {
            Body::Beam(beam) => Some([beam.z_base_m(), beam.z_top_m()]),
            Body::Matrices(matrices) => {
                matrices.is_line().then_some(())?;
                let (first, last) = (matrices.nodes.first()?, matrices.nodes.last()?);
                Some([first.position_m[2], last.position_m[2]])
            }
        }
    }

    /// K and M. A beam has five DOFs a node, base first and left out.
    ///
    /// The base node carries no mass, so its springs are condensed without approximation: with flexibilities C on the
    /// base DOFs b, `x_b = -(I + C K_bb)⁻¹ C K_bf x_f` and `K = K_ff + K_fb x_b/x_f`. C = 0 is the clamped base, so a
    /// flexibility acts smoothly from zero on and M stays positive definite. (I + C K_bb has eigenvalues of 1 and more
    /// for flexibilities of 0 and more, so it always has an inverse.)
    pub fn assemble(&self) -> Assembly {
        let mut assembly = match &self.body {
            Body::Beam(beam) => self.assemble_beam(beam),
            Body::Matrices(ImportedMatrices { stiffness, mass, nodes }) => Assembly {
                stiffness: stiffness.clone(),
                mass: mass.clone(),
                geometry: Geometry::of_nodes(nodes, stiffness),
            },
        };
        for added in &self.added_masses {
            let motion = assembly.axis_motion(added.z_m);
            let horizontal = motion.rows(0, 2);
            assembly.mass += horizontal.tr_mul(&horizontal) * added.mass_kg;
        }
        assembly.stiffness *= self.stiffness_factor;
        assembly.mass *= self.mass_factor;
        assembly
    }

    fn assemble_beam(&self, beam: &BeamTable) -> Assembly {
        let segments = beam.segments();
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
        stiffness = (&stiffness + stiffness.transpose()) * 0.5;

        let mut mass = DMatrix::zeros(free, free);
        for (index, segment) in segments.iter().enumerate() {
            let [inertia_x, inertia_y, inertia_z] = segment.inertia_kg_m2;
            let lumped = [segment.mass_top_kg, segment.mass_top_kg, inertia_x, inertia_y, inertia_z];
            for (dof, value) in lumped.into_iter().enumerate() {
                let row = index * DOFS_A_NODE + dof;
                mass[(row, row)] += value;
            }
        }
        Assembly { stiffness, mass, geometry: Geometry::Line(Line::of_beam(segments, base_motion)) }
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

    /// Whether heights mean something: nodes stand above each other.
    pub fn is_line(&self) -> bool {
        matches!(self.geometry, Geometry::Line(_))
    }

    /// Heights of the nodes in m, lowest first, the lowest left out (a beam's node i has the DOFs from 5 i on, one of
    /// imported matrices those of its layout). Empty where the nodes do not stand above each other.
    pub fn node_elevations_m(&self) -> Vec<f64> {
        match &self.geometry {
            Geometry::Line(line) => line.node_elevations_m().collect(),
            Geometry::Unknown | Geometry::Space(_) => Vec::new(),
        }
    }

    /// Height of the lowest node in m; 0 where heights mean nothing.
    pub fn z_base_m(&self) -> f64 {
        match &self.geometry {
            Geometry::Line(line) => line.z_base_m(),
            Geometry::Unknown | Geometry::Space(_) => 0.0,
        }
    }

    /// Bottom and top in m of spans of imported matrices that are not those of a beam: motion between these two nodes is
    /// taken to be straight.
    pub fn guessed_spans_m(&self) -> &[[f64; 2]] {
        match &self.geometry {
            Geometry::Line(line) => line.guessed_m(),
            Geometry::Unknown | Geometry::Space(_) => &[],
        }
    }

    /// The structure's modes, lowest frequency first.
    ///
    /// # Errors
    /// [`EigenError`] where the matrices are not those of a supported structure.
    pub fn modes(&self) -> Result<Modes, EigenError> {
        Ok(self.modal_basis()?.modes(usize::MAX))
    }

    /// All eigenvectors, those without mass included.
    ///
    /// # Errors
    /// As [`Assembly::modes`].
    pub fn modal_basis(&self) -> Result<ModalBasis, EigenError> {
        ModalBasis::of(&self.stiffness, &self.mass)
    }

    /// Motion of the axis at a height, 5 x DOFs: rows `ux, uy, rx, ry, rz`. Between nodes the element's own shape
    /// functions (cubic, with the shear correction); heights outside count as the ends. Zero where nodes do not stand above
    /// each other.
    pub fn axis_motion(&self, z_m: f64) -> DMatrix<f64> {
        match &self.geometry {
            Geometry::Line(line) => line.motion(z_m, self.dofs()),
            Geometry::Unknown | Geometry::Space(_) => DMatrix::zeros(DOFS_A_NODE, self.dofs()),
        }
    }
}
