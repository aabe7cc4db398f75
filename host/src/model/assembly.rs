//! From a structure (a body and what effects have changed about it) to its mass and stiffness matrices.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector};

use super::DOFS_A_NODE;
use super::beam::{BeamTable, Segment};
use super::damped::DampedModes;
use super::effect::{Custom, Effect, EffectError};
use super::eigen::{EigenError, ModalBasis, Modes};
use super::element::{DOFS_A_SEGMENT, Kink, geometric_stiffness, hinged, scatter, stiffness};
use super::geometry::{Geometry, Line};
use super::matrices::ImportedMatrices;
use super::sensing::Sensing;
use super::sensitivity::Change;
use crate::study::STANDARD_GRAVITY_M_S2;

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
    /// Rotational joints along a beam.
    pub joints: Vec<Joint>,
    /// Rotational springs between the beam axis and the ground.
    pub ground_springs: Vec<GroundSpring>,
    /// Tuned mass dampers.
    pub tuned_masses: Vec<TunedMass>,
    /// Share of the weight above that softens a beam (0 leaves it out, 1 is all of it).
    pub weight_share: f64,
    /// Centre of mass of the main body's nodes from the beam axis, along X and Y in m.
    pub mass_offset_m: [f64; 2],
    /// How far the principal axes are turned, degrees anticlockwise seen from above.
    pub axis_turn_deg: f64,
    /// Share of each node's mass that is not lumped there but spread to the middles of the segments below and above, its
    /// centre staying: 0 is the table's word, 1 a structure that is as heavy between its nodes as at them.
    pub mass_spread: f64,
    /// Changes of K and M by the user's own matrices.
    pub custom: Vec<MatrixChange>,
    /// Factor on the whole of K, base springs included (1 leaves it as it is).
    pub stiffness_factor: f64,
    /// Factor on the whole of M, added masses included.
    pub mass_factor: f64,
    /// What the sensors really are.
    pub sensing: Sensing,
    /// Frequencies in Hz at which something drives the structure: lines there are no modes.
    pub forced_hz: Vec<f64>,
    /// The user's own hypotheses, which effects may name.
    pub customs: Arc<[Custom]>,
}

/// A rotational joint: the beam kinks there under moment, alike in all directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Its height in m, between base and top.
    pub z_m: f64,
    /// Its flexibility in rad/(N m).
    pub flexibility_rad_n_m: f64,
}

/// A rotational spring to the ground, alike about X and Y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundSpring {
    /// Its height in m, between base and top.
    pub z_m: f64,
    /// Its stiffness in N m/rad.
    pub stiffness_n_m: f64,
}

/// A mass on a spring and a dashpot that moves sideways.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TunedMass {
    /// Its height in m, between base and top.
    pub z_m: f64,
    /// Its mass in kg.
    pub mass_kg: f64,
    /// Its own frequency on a fixed base in Hz.
    pub frequency_hz: f64,
    /// Its own damping ratio.
    pub damping_ratio: f64,
    /// Whether it moves along X and Y.
    pub moves: [bool; 2],
}

/// A change of K and M that the user gives as matrices; `amount` times is added.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixChange {
    /// Of K, DOFs x DOFs.
    pub stiffness: Option<Arc<DMatrix<f64>>>,
    /// Of M, DOFs x DOFs.
    pub mass: Option<Arc<DMatrix<f64>>>,
    /// How much of it.
    pub amount: f64,
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
    /// C of the dashpots, DOFs x DOFs, symmetric (N s/m); `None` where there are none.
    pub damping: Option<DMatrix<f64>>,
    /// Where the DOFs stand.
    pub(super) geometry: Geometry,
    /// What the sensors really are.
    pub sensing: Sensing,
}

impl From<BeamTable> for Body {
    fn from(beam: BeamTable) -> Self {
        Self::Beam(beam)
    }
}

impl Structure {
    /// The body as it is given; a beam is clamped at the base.
    pub fn new(body: impl Into<Body>) -> Self {
        Self {
            body: body.into(),
            base: BaseFlexibility::default(),
            added_masses: Vec::new(),
            joints: Vec::new(),
            ground_springs: Vec::new(),
            tuned_masses: Vec::new(),
            weight_share: 0.0,
            mass_offset_m: [0.0; 2],
            axis_turn_deg: 0.0,
            mass_spread: 0.0,
            custom: Vec::new(),
            stiffness_factor: 1.0,
            mass_factor: 1.0,
            sensing: Sensing::default(),
            forced_hz: Vec::new(),
            customs: Arc::new([]),
        }
    }

    /// Number of degrees of freedom of the body.
    pub fn dofs(&self) -> usize {
        match &self.body {
            Body::Beam(beam) => beam.segments().len() * DOFS_A_NODE,
            Body::Matrices(matrices) => matrices.stiffness.nrows(),
        }
    }

    /// A body with effects, applied in their order; a beam is clamped at the base but for what they free.
    ///
    /// # Errors
    /// [`EffectError`] where an effect's height is not on this structure, or it needs a beam table.
    pub fn with_effects(body: impl Into<Body>, effects: &[Effect]) -> Result<Self, EffectError> {
        Self::new(body).and(effects)
    }

    /// The structure with more effects, applied in their order.
    ///
    /// # Errors
    /// As [`Structure::with_effects`].
    pub fn and(mut self, effects: &[Effect]) -> Result<Self, EffectError> {
        for effect in effects {
            effect.apply(&mut self)?;
        }
        Ok(self)
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
                damping: None,
                geometry: Geometry::of_nodes(nodes, stiffness),
                sensing: Sensing::default(),
            },
        };
        if matches!(self.body, Body::Matrices(_)) && self.axis_turn_deg != 0.0 {
            assembly.turn(self.axis_turn_deg);
        }
        if self.mass_offset_m != [0.0; 2] {
            assembly.offset_masses(self.mass_offset_m);
        }
        for added in &self.added_masses {
            let motion = assembly.axis_motion(added.z_m);
            let horizontal = motion.rows(0, 2);
            assembly.mass += horizontal.tr_mul(&horizontal) * added.mass_kg;
        }
        for spring in &self.ground_springs {
            let motion = assembly.axis_motion(spring.z_m);
            let rotation = motion.rows(2, 2);
            assembly.stiffness += rotation.tr_mul(&rotation) * spring.stiffness_n_m;
        }
        for change in &self.custom {
            let add = |matrix: &mut DMatrix<f64>, change: &Option<Arc<DMatrix<f64>>>, amount: f64| {
                if let Some(change) = change {
                    *matrix += change.as_ref() * amount;
                }
            };
            add(&mut assembly.stiffness, &change.stiffness, change.amount);
            add(&mut assembly.mass, &change.mass, change.amount);
        }
        assembly.stiffness *= self.stiffness_factor;
        assembly.mass *= self.mass_factor;
        for tuned in &self.tuned_masses {
            assembly.attach(tuned);
        }
        assembly.sensing = self.sensing.clone();
        assembly
    }

    /// Stiffness of a segment in global axes with its joints and the weight `above_n` (in N) that it carries, and the joints'
    /// kinks.
    fn element(&self, segment: &Segment, above_n: f64) -> (SMatrix<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT>, Vec<Kink>) {
        let mut turned = segment.clone();
        turned.axis_deg += self.axis_turn_deg;
        let mut element = stiffness(&turned);
        let mut kinks = Vec::new();
        // A joint between two segments belongs to the upper one.
        let inside = |z_m: f64| (segment.z_bottom_m..segment.z_top_m).contains(&z_m);
        for joint in self.joints.iter().filter(|joint| inside(joint.z_m)) {
            let lever_m = segment.z_top_m - joint.z_m;
            let (softer, both) = hinged(&element, joint.z_m, lever_m, joint.flexibility_rad_n_m);
            element = softer;
            kinks.extend(both);
        }
        if above_n != 0.0 {
            element -= geometric_stiffness(segment.length_m(), above_n);
        }
        (element, kinks)
    }

    /// The weight in N that softens each segment: that of everything above its middle.
    fn weights_above_n(&self, segments: &[Segment]) -> Vec<f64> {
        let mut weights = vec![0.0; segments.len()];
        if self.weight_share == 0.0 {
            return weights;
        }
        let added_above = |z_m: f64| -> f64 {
            self.added_masses.iter().filter(|added| added.z_m > z_m).map(|added| added.mass_kg).sum()
        };
        // Gravity pulls as hard whatever the stiffness is multiplied with.
        let factor = self.weight_share * self.mass_factor * STANDARD_GRAVITY_M_S2 / self.stiffness_factor;
        let mut mass_kg = 0.0;
        for (weight, segment) in weights.iter_mut().zip(segments).rev() {
            mass_kg += segment.mass_top_kg;
            *weight = factor * (mass_kg + added_above(0.5 * (segment.z_bottom_m + segment.z_top_m)));
        }
        weights
    }

    fn assemble_beam(&self, beam: &BeamTable) -> Assembly {
        let mut assembly = self.assemble_lumped(beam);
        if self.mass_spread != 0.0 {
            assembly.mass += assembly.spread(beam.segments()) * self.mass_spread;
        }
        assembly
    }

    /// The beam with all masses at its nodes.
    fn assemble_lumped(&self, beam: &BeamTable) -> Assembly {
        let segments = beam.segments();
        let free = segments.len() * DOFS_A_NODE;
        let mut whole = DMatrix::zeros(free + DOFS_A_NODE, free + DOFS_A_NODE);
        let weights_n = self.weights_above_n(segments);
        let mut kinks = Vec::new();
        for (index, (segment, &above_n)) in segments.iter().zip(&weights_n).enumerate() {
            let (element, of_segment) = self.element(segment, above_n);
            scatter(&mut whole, &element, index);
            kinks.push(of_segment);
        }
        let base_motion = self.base_motion(&whole);
        let base_free = whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, free)).into_owned();
        let mut stiffness = whole.view((DOFS_A_NODE, DOFS_A_NODE), (free, free)).into_owned();
        // Only the first node is tied to the base.
        let near = DOFS_A_NODE.min(free);
        let condensed = base_free.columns(0, near).tr_mul(&base_motion.columns(0, near));
        // The two sums round differently above and below the diagonal.
        let condensed = (&condensed + condensed.transpose()) * 0.5;
        let mut corner = stiffness.view_mut((0, 0), (near, near));
        corner += condensed;

        let mut mass = DMatrix::zeros(free, free);
        for (index, segment) in segments.iter().enumerate() {
            let [inertia_x, inertia_y, inertia_z] = segment.inertia_kg_m2;
            let lumped = [segment.mass_top_kg, segment.mass_top_kg, inertia_x, inertia_y, inertia_z];
            for (dof, value) in lumped.into_iter().enumerate() {
                let row = index * DOFS_A_NODE + dof;
                mass[(row, row)] += value;
            }
        }
        let geometry = Geometry::Line(Line::of_beam(segments, self.axis_turn_deg, kinks, base_motion));
        Assembly { stiffness, mass, damping: None, geometry, sensing: Sensing::default() }
    }

    /// What spreading all masses adds to M; zero for matrices.
    pub fn spread_change(&self) -> Change {
        let Body::Beam(beam) = &self.body else { return Change::local(0, DMatrix::zeros(0, 0), false) };
        let spread = self.assemble_lumped(beam).spread(beam.segments());
        Change::of(&DMatrix::zeros(spread.nrows(), spread.ncols()), &(spread * self.mass_factor), None)
    }

    /// Motion of the base node that follows from the free DOFs, 5 x free; `whole` is K with the base's DOFs first.
    fn base_motion(&self, whole: &DMatrix<f64>) -> DMatrix<f64> {
        let free = whole.nrows() - DOFS_A_NODE;
        let base_base: SMatrix<f64, DOFS_A_NODE, DOFS_A_NODE> =
            whole.fixed_view::<DOFS_A_NODE, DOFS_A_NODE>(0, 0).into();
        let flexibility = SMatrix::from_diagonal(&self.base.diagonal());
        let soft = SMatrix::<f64, DOFS_A_NODE, DOFS_A_NODE>::identity() + flexibility * base_base;
        soft.lu().solve(&flexibility).map_or_else(
            || DMatrix::zeros(DOFS_A_NODE, free),
            |given_way| {
                DMatrix::from_column_slice(DOFS_A_NODE, DOFS_A_NODE, (-given_way).as_slice())
                    * whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, free))
            },
        )
    }

    /// What a relative change of each segment's stiffness (bending, shear and torsion together) does to K, and one of its
    /// mass to M, segment by segment; empty for matrices.
    ///
    /// Exact but for the weight of a segment's mass on those below (`weight_share` times a change of a change).
    pub fn segment_changes(&self) -> Vec<SegmentChange> {
        let Body::Beam(beam) = &self.body else { return Vec::new() };
        let segments = beam.segments();
        let weights_n = self.weights_above_n(segments);
        let element = |index: usize, factor: f64| {
            let mut segment = segments[index].clone();
            segment.scale_stiffness(factor);
            self.element(&segment, weights_n[index]).0
        };
        let slope = |index: usize| (element(index, 1.0 + STEP) - element(index, 1.0 - STEP)) / (2.0 * STEP);
        // The lowest segment acts through the base as well; condensed, its change is that of the corner of K.
        let corner = |factor: f64| {
            let mut whole = DMatrix::zeros(2 * DOFS_A_NODE, 2 * DOFS_A_NODE);
            scatter(&mut whole, &element(0, factor), 0);
            let motion = self.base_motion(&whole);
            let base_free = whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, DOFS_A_NODE)).into_owned();
            whole.view((DOFS_A_NODE, DOFS_A_NODE), (DOFS_A_NODE, DOFS_A_NODE)).into_owned() + base_free.tr_mul(&motion)
        };
        let mut changes = Vec::new();
        for (index, segment) in segments.iter().enumerate() {
            let (first_row, stiffness) = match index {
                0 => (0, (corner(1.0 + STEP) - corner(1.0 - STEP)) / (2.0 * STEP)),
                _ => {
                    let slope = slope(index);
                    let part = DMatrix::from_column_slice(DOFS_A_SEGMENT, DOFS_A_SEGMENT, slope.as_slice());
                    ((index - 1) * DOFS_A_NODE, part)
                }
            };
            let [inertia_x, inertia_y, inertia_z] = segment.inertia_kg_m2;
            let lumped = [segment.mass_top_kg, segment.mass_top_kg, inertia_x, inertia_y, inertia_z];
            let mass = DMatrix::from_diagonal(&DVector::from_column_slice(&lumped));
            changes.push(SegmentChange {
                stiffness: Change::local(first_row, stiffness * self.stiffness_factor, true),
                mass: Change::local(index * DOFS_A_NODE, mass * self.mass_factor, false),
            });
        }
        changes
    }
}

/// What a relative change of one segment does to K and M.
#[derive(Debug, Clone)]
pub struct SegmentChange {
    /// Its stiffness.
    pub stiffness: Change,
    /// Its mass.
    pub mass: Change,
}

/// K is linear in a segment's stiffness, but for a flexible base or a joint, where it is smooth.
const STEP: f64 = 1e-3;

/// Nodes with less than this share of the largest radius of gyration belong to a mast, not to the main body.
const SLENDER: f64 = 0.5;

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

    /// Turns the principal axes of imported matrices: K becomes Tᵀ K T, T turning each node's X and Y.
    fn turn(&mut self, angle_deg: f64) {
        let Geometry::Line(line) = &self.geometry else { return };
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let mut turn = DMatrix::identity(self.dofs(), self.dofs());
        for rows in line.node_rows() {
            for (x, y) in [(rows[0], rows[1]), (rows[2], rows[3])] {
                if let (Some(x), Some(y)) = (x, y) {
                    let part = Matrix2::new(cos, sin, -sin, cos);
                    for (i, row) in [x, y].into_iter().enumerate() {
                        for (j, column) in [x, y].into_iter().enumerate() {
                            turn[(row, column)] = part[(i, j)];
                        }
                    }
                }
            }
        }
        let turned = turn.tr_mul(&(&self.stiffness * &turn));
        self.stiffness = (&turned + turned.transpose()) * 0.5;
    }

    /// `sum m (mean of nᵀn over the spread - nᵀn at the node)`, n the motion along X and Y: what M gains where each node's
    /// mass is spread evenly to the middle of the segment below and, with the share that leaves its centre where it is, of
    /// the segment above.
    fn spread(&self, segments: &[Segment]) -> DMatrix<f64> {
        // Two-point Gauss quadrature on (0, 1): exact for motion that is straight, 1e-3 for curved motion.
        const POINTS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];
        let mut total = DMatrix::zeros(self.dofs(), self.dofs());
        for pair in segments.windows(2) {
            let (z_m, mass_kg) = (pair[0].z_top_m, pair[0].mass_top_kg);
            let [below_m, above_m] = [0.5 * pair[0].length_m(), 0.5 * pair[1].length_m()];
            let share_below = above_m / (below_m + above_m);
            let mut add = |z_m: f64, mass_kg: f64| {
                let motion = self.axis_motion(z_m);
                let moving: Vec<usize> = (0..motion.ncols()).filter(|&dof| motion.column(dof).amax() > 0.0).collect();
                let horizontal = motion.rows(0, 2).select_columns(&moving);
                let part = horizontal.tr_mul(&horizontal) * mass_kg;
                for (i, &row) in moving.iter().enumerate() {
                    for (j, &column) in moving.iter().enumerate() {
                        total[(row, column)] += part[(i, j)];
                    }
                }
            };
            add(z_m, -mass_kg);
            for point in POINTS {
                add(z_m - point * below_m, 0.5 * mass_kg * share_below);
                add(z_m + point * above_m, 0.5 * mass_kg * (1.0 - share_below));
            }
        }
        total
    }

    /// Moves the centre of mass of the main body's nodes off the axis: `M[uy,rz] = m x`, `M[ux,rz] = -m y`, and
    /// `M[rz,rz] += m (x² + y²)` as the inertia stays what it is about the centre of mass.
    ///
    /// The main body are the nodes whose radius of gyration about Z is at least [`SLENDER`] of the largest: a mast on top
    /// has its own axis.
    fn offset_masses(&mut self, [x, y]: [f64; 2]) {
        let Geometry::Line(line) = &self.geometry else { return };
        let nodes: Vec<[usize; 3]> =
            line.node_rows().iter().filter_map(|rows| Some([rows[0]?, rows[1]?, rows[4]?])).collect();
        let gyration_square = |&[ux, _, rz]: &[usize; 3]| {
            let mass = self.mass[(ux, ux)];
            if mass > 0.0 { self.mass[(rz, rz)] / mass } else { 0.0 }
        };
        let largest = nodes.iter().map(gyration_square).fold(0.0, f64::max);
        let body: Vec<[usize; 3]> =
            nodes.iter().filter(|node| gyration_square(node) >= SLENDER * SLENDER * largest).copied().collect();
        // Motion of the centres of mass: M becomes Sᵀ M S, with S adding the rotation's share to each node's ux and uy.
        for &[ux, uy, rz] in &body {
            let moved = self.mass.column(ux) * -y + self.mass.column(uy) * x;
            let mut column = self.mass.column_mut(rz);
            column += moved;
        }
        for &[ux, uy, rz] in &body {
            let moved = self.mass.row(ux) * -y + self.mass.row(uy) * x;
            let mut row = self.mass.row_mut(rz);
            row += moved;
        }
    }

    /// Hangs a tuned mass onto the structure: one more DOF for each direction in which it moves.
    fn attach(&mut self, tuned: &TunedMass) {
        let omega = TAU * tuned.frequency_hz;
        let (stiffness, damping) = (tuned.mass_kg * omega * omega, 2.0 * tuned.mass_kg * tuned.damping_ratio * omega);
        for axis in (0..2).filter(|&axis| tuned.moves[axis]) {
            let dofs = self.dofs();
            let mut stretch = self.axis_motion(tuned.z_m).row(axis).into_owned().resize_horizontally(dofs + 1, 0.0);
            stretch[dofs] = -1.0;
            let matrix = |whole: &DMatrix<f64>| whole.clone().resize(dofs + 1, dofs + 1, 0.0);
            self.stiffness = matrix(&self.stiffness) + stretch.tr_mul(&stretch) * stiffness;
            self.mass = matrix(&self.mass);
            self.mass[(dofs, dofs)] = tuned.mass_kg;
            if damping > 0.0 || self.damping.is_some() {
                let before = self.damping.as_ref().map_or_else(|| DMatrix::zeros(dofs + 1, dofs + 1), matrix);
                self.damping = Some(before + stretch.tr_mul(&stretch) * damping);
            }
            if let Geometry::Line(line) = &mut self.geometry {
                line.widen(dofs + 1);
            }
        }
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

    /// The structure's modes without its dashpots, lowest frequency first.
    ///
    /// # Errors
    /// [`EigenError`] where the matrices are not those of a supported structure.
    pub fn modes(&self) -> Result<Modes, EigenError> {
        Ok(self.modal_basis()?.modes(usize::MAX))
    }

    /// All eigenvectors of K and M, those without mass included.
    ///
    /// # Errors
    /// As [`Assembly::modes`].
    pub fn modal_basis(&self) -> Result<ModalBasis, EigenError> {
        ModalBasis::of(&self.stiffness, &self.mass)
    }

    /// Its damped modes, where dashpots hang on it; `basis` is that of K and M.
    ///
    /// # Errors
    /// As [`Assembly::modes`].
    pub fn damped_modes(&self, basis: &ModalBasis) -> Result<Option<DampedModes>, EigenError> {
        self.damping.as_ref().map(|damping| DampedModes::of(basis, damping)).transpose()
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
