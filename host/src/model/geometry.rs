//! Where a model's degrees of freedom stand in space: heights and places flow in, motion there as a matrix over the DOFs
//! flows out.

use std::sync::Arc;

use nalgebra::{DMatrix, Matrix2, RowDVector, Vector2};

use super::DOFS_A_NODE;
use super::beam::Segment;
use super::element::interpolation;
use super::joint::{Kink, kinked};
use super::layout::{LayoutNode, is_line};

/// Where the DOFs stand.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Geometry {
    /// Not known: sensors name rows of the matrices.
    Unknown,
    /// Not known, but rows have names.
    Named(Arc<[String]>),
    /// Nodes above each other, joined by beam segments.
    Line(Line),
    /// Nodes anywhere; between them nothing is known.
    Space(Vec<LayoutNode>),
}

/// Nodes above each other, lowest first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Line {
    /// Matrix rows of `ux, uy, rx, ry, rz` of each node; `None` is fixed.
    rows: Vec<[Option<usize>; DOFS_A_NODE]>,
    /// The beam between a node and the next: one less than nodes.
    spans: Vec<Segment>,
    /// Joints in each span; empty where there are none anywhere.
    kinks: Vec<Vec<Kink>>,
    /// Motion of the lowest node where it follows from the DOFs, 5 x DOFs.
    base_motion: Option<DMatrix<f64>>,
    /// Matrix rows of `uz` of each node; empty where the model has none.
    vertical_rows: Vec<Option<usize>>,
    /// Whether the model has motions along X, Y and Z.
    moves: [bool; 3],
    /// Bottom and top of spans between which motion is a guess.
    guessed_m: Vec<[f64; 2]>,
}

/// `uz` among a layout node's rows.
const UZ: usize = 5;

/// In a span whose matrices show no rotations, displacements are straight: a shear stiffness this small against bending
/// (as 12 EI / (kGA L²)) makes them so.
const STRAIGHT: f64 = 1e9;

impl Geometry {
    /// From the layout of imported matrices.
    pub(super) fn of_nodes(nodes: &[LayoutNode], stiffness: &DMatrix<f64>) -> Self {
        if nodes.is_empty() {
            Self::Unknown
        } else if is_line(nodes) {
            Self::Line(Line::of_nodes(nodes, stiffness))
        } else {
            Self::Space(nodes.to_vec())
        }
    }
}

impl Line {
    /// A beam whose base node is left out of the matrices.
    pub(super) fn of_beam(segments: Vec<Segment>, kinks: Vec<Vec<Kink>>, base_motion: DMatrix<f64>) -> Self {
        let node = |index: usize| std::array::from_fn(|dof| Some(index * DOFS_A_NODE + dof));
        let rows = std::iter::once([None; DOFS_A_NODE]).chain((0..segments.len()).map(node));
        Self {
            rows: rows.collect(),
            spans: segments,
            kinks,
            base_motion: Some(base_motion),
            vertical_rows: Vec::new(),
            // Stiff along its axis, which is motion enough for a sensor that points up.
            moves: [true; 3],
            guessed_m: Vec::new(),
        }
    }

    /// Imported nodes. The shape functions between two of them need the share of shear in their deflection, which the
    /// stiffness between the two holds (see [`recovered`]); a span at a fixed node takes it from its neighbour.
    fn of_nodes(nodes: &[LayoutNode], stiffness: &DMatrix<f64>) -> Self {
        let rows: Vec<[Option<usize>; DOFS_A_NODE]> =
            nodes.iter().map(|node| std::array::from_fn(|dof| node.rows[dof])).collect();
        let heights = |pair: &[LayoutNode]| [pair[0].position_m[2], pair[1].position_m[2]];
        let found: Vec<Recovered> = nodes
            .windows(2)
            .zip(rows.windows(2))
            .map(|(pair, rows)| {
                let [z_bottom_m, z_top_m] = heights(pair);
                recovered(stiffness, rows[0], rows[1], z_top_m - z_bottom_m)
            })
            .collect();
        let mut above = ([0.0; 2], 0.0);
        let mut spans = Vec::new();
        for (found, pair) in found.iter().zip(nodes.windows(2)).rev() {
            let [z_bottom_m, z_top_m] = heights(pair);
            let (shear_ratios, axis_deg) = match *found {
                Recovered::Beam { shear_ratios, axis_deg } => (shear_ratios, axis_deg),
                Recovered::NoBeam => ([STRAIGHT; 2], 0.0),
                Recovered::AtSupport => above,
            };
            above = (shear_ratios, axis_deg);
            spans.push(span(z_bottom_m, z_top_m, axis_deg, shear_ratios));
        }
        spans.reverse();
        let guessed_m = found.iter().zip(nodes.windows(2)).filter(|(found, _)| matches!(found, Recovered::NoBeam));
        let there = |dof: usize| nodes.iter().any(|node| node.rows[dof].is_some() || node.fixed[dof]);
        Self {
            rows,
            spans,
            kinks: Vec::new(),
            base_motion: None,
            vertical_rows: nodes.iter().map(|node| node.rows[UZ]).collect(),
            moves: [there(0), there(1), there(UZ)],
            guessed_m: guessed_m.map(|(_, pair)| heights(pair)).collect(),
        }
    }

    /// Matrix rows of `ux, uy, rx, ry, rz` of each node, the lowest first.
    pub(super) fn node_rows(&self) -> &[[Option<usize>; DOFS_A_NODE]] {
        &self.rows
    }

    /// The beam between each node and the next; of imported matrices without mass, and with a stiffness that only says how
    /// displacements run between the nodes.
    pub(super) fn spans(&self) -> &[Segment] {
        &self.spans
    }

    /// More DOFs that do not belong to the line.
    pub(super) fn widen(&mut self, dofs: usize) {
        self.base_motion = self.base_motion.take().map(|motion| motion.resize_horizontally(dofs, 0.0));
    }

    /// Whether the model has motions along X, Y and Z.
    pub(super) fn moves(&self) -> [bool; 3] {
        self.moves
    }

    /// The lowest node, where nothing else moves it, moves with the DOFs so (5 x DOFs).
    pub(super) fn let_base_move(&mut self, base_motion: DMatrix<f64>) {
        if self.rows.first().is_some_and(|rows| rows.iter().all(Option::is_none)) {
            self.base_motion = Some(base_motion);
        }
    }

    /// Bottom and top of spans whose stiffness is not that of a beam: motion between these nodes is a guess.
    pub(super) fn guessed_m(&self) -> &[[f64; 2]] {
        &self.guessed_m
    }

    /// Adds vertical motion of the axis at a height, times a factor: straight between the nodes.
    pub(super) fn add_vertical_motion(&self, row: &mut RowDVector<f64>, z_m: f64, factor: f64) {
        let last = self.spans.len().saturating_sub(1);
        let index = self.spans.iter().position(|span| z_m <= span.z_top_m).unwrap_or(last);
        let Some(span) = self.spans.get(index) else { return };
        let share = ((z_m - span.z_bottom_m) / span.length_m()).clamp(0.0, 1.0);
        for (node, share) in [(index, 1.0 - share), (index + 1, share)] {
            if let Some(dof) = self.vertical_rows.get(node).copied().flatten() {
                row[dof] += share * factor;
            }
        }
    }

    /// Height of the lowest node in m.
    pub(super) fn z_base_m(&self) -> f64 {
        self.spans.first().map_or(0.0, |span| span.z_bottom_m)
    }

    /// Height of the highest node in m.
    pub(super) fn z_top_m(&self) -> f64 {
        self.spans.last().map_or(0.0, |span| span.z_top_m)
    }

    /// Heights of the nodes above the lowest, in m.
    pub(super) fn node_elevations_m(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.spans.iter().map(|span| span.z_top_m)
    }

    /// Motion of the axis at a height, 5 x DOFs: rows `ux, uy, rx, ry, rz`. Between nodes the element's own shape
    /// functions (cubic, with the shear correction); heights outside count as the ends.
    pub(super) fn motion(&self, z_m: f64, dofs: usize) -> DMatrix<f64> {
        let mut motion = DMatrix::zeros(DOFS_A_NODE, dofs);
        let local = self.local_motion(z_m);
        for (column, &dof) in local.dofs.iter().enumerate() {
            motion.set_column(dof, &local.motion.column(column));
        }
        motion
    }

    /// Adds how the axis bends and turns at a height, each times a factor: `d²ux/dz²` and `d²uy/dz²` by the rotations of sections over the
    /// length of a span to both sides, and rz. The free top goes on mirrored, as nothing bends it; the clamped base with the opposite sign.
    pub(super) fn add_bent(&self, row: &mut RowDVector<f64>, z_m: f64, [kx, ky, rz]: [f64; 3]) {
        let (z_base_m, z_top_m) = (self.z_base_m(), self.z_top_m());
        let z_m = z_m.clamp(z_base_m, z_top_m);
        let span = self.spans.iter().find(|span| z_m <= span.z_top_m).or(self.spans.last());
        let Some(step_m) = span.map(Segment::length_m) else { return };
        // Slopes along X and Y are ry and -rx.
        let mut add_turned = |z_m: f64, sign: f64| {
            let by_length = sign / (2.0 * step_m);
            self.local_motion(z_m).add_to(row, [0.0, 0.0, -ky * by_length, kx * by_length, 0.0]);
        };
        match z_m - step_m {
            z_m if z_m < z_base_m => add_turned(2.0 * z_base_m - z_m, 1.0),
            z_m => add_turned(z_m, -1.0),
        }
        match z_m + step_m {
            z_m if z_m > z_top_m => add_turned(2.0 * z_top_m - z_m, 1.0),
            z_m => add_turned(z_m, 1.0),
        }
        self.local_motion(z_m).add_to(row, [0.0, 0.0, 0.0, 0.0, rz]);
    }

    /// [`Line::motion`] at the few DOFs that take part in it.
    pub(super) fn local_motion(&self, z_m: f64) -> LocalMotion {
        let last = self.spans.len().saturating_sub(1);
        let index = self.spans.iter().position(|span| z_m <= span.z_top_m).unwrap_or(last);
        let Some(span) = self.spans.get(index) else {
            return LocalMotion { dofs: Vec::new(), motion: DMatrix::zeros(DOFS_A_NODE, 0) };
        };
        let shape = match self.kinks.get(index) {
            Some(kinks) if !kinks.is_empty() => kinked(span, kinks, z_m),
            _ => interpolation(span, z_m),
        };
        let base_motion = self.base_motion.as_ref().filter(|_| index == 0);
        // Both nodes free, one after the other, as in a beam but for its foot.
        let first_of_both = self.rows[index][0].filter(|first| {
            let all = self.rows[index].iter().chain(&self.rows[index + 1]);
            all.enumerate().all(|(dof, row)| *row == Some(first + dof))
        });
        if let (Some(first), None) = (first_of_both, base_motion) {
            let motion = DMatrix::from_column_slice(DOFS_A_NODE, shape.ncols(), shape.as_slice());
            return LocalMotion { dofs: (first..first + shape.ncols()).collect(), motion };
        }
        let mut dofs: Vec<usize> = self.rows[index].iter().chain(&self.rows[index + 1]).copied().flatten().collect();
        if let Some(base_motion) = base_motion {
            // The base may move with the node above it, whose DOFs are there already.
            dofs.extend(
                (0..base_motion.ncols()).filter(|&dof| base_motion.column(dof).iter().any(|&value| value != 0.0)),
            );
        }
        dofs.sort_unstable();
        dofs.dedup();
        let mut motion = DMatrix::zeros(DOFS_A_NODE, dofs.len());
        for (node, first_column) in [(index, 0), (index + 1, DOFS_A_NODE)] {
            let part = shape.columns(first_column, DOFS_A_NODE);
            for (dof, row) in self.rows[node].iter().enumerate() {
                if let Some(column) = row.and_then(|row| dofs.binary_search(&row).ok()) {
                    let mut sum = motion.column_mut(column);
                    sum += part.column(dof);
                }
            }
            if let Some(base_motion) = base_motion.filter(|_| node == 0) {
                motion += part * base_motion.select_columns(&dofs);
            }
        }
        LocalMotion { dofs, motion }
    }
}

/// Motion of the axis at a height by the DOFs next to it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LocalMotion {
    /// The DOFs, ascending.
    pub(super) dofs: Vec<usize>,
    /// Rows `ux, uy, rx, ry, rz`, 5 x `dofs`.
    pub(super) motion: DMatrix<f64>,
}

impl LocalMotion {
    /// Adds `ux, uy, rx, ry, rz`, each times a factor, to a row over all DOFs.
    pub(super) fn add_to(&self, row: &mut RowDVector<f64>, factors: [f64; DOFS_A_NODE]) {
        for (motion, &dof) in self.motion.column_iter().zip(&self.dofs) {
            row[dof] += motion.iter().zip(factors).map(|(motion, factor)| motion * factor).sum::<f64>();
        }
    }

    /// Adds `factor * sum nᵀ n` over two of the motion's rows, from `first_row` on, to a matrix over all DOFs: what a mass (or
    /// a spring) of that size, alike in both directions, adds to M (or K).
    pub(super) fn add_square(&self, total: &mut DMatrix<f64>, first_row: usize, factor: f64) {
        self.add_squares(total, first_row, [factor; 2]);
    }

    /// The same of as many rows as there are factors.
    pub(super) fn add_squares<const ROWS: usize>(
        &self,
        total: &mut DMatrix<f64>,
        first_row: usize,
        factors: [f64; ROWS],
    ) {
        let rows = self.motion.fixed_rows::<ROWS>(first_row);
        let motions: Vec<[f64; ROWS]> =
            rows.column_iter().map(|motion| std::array::from_fn(|row| motion[row])).collect();
        for (along, &column) in motions.iter().zip(&self.dofs) {
            let weighted: [f64; ROWS] = std::array::from_fn(|row| along[row] * factors[row]);
            if weighted == [0.0; ROWS] {
                continue;
            }
            let mut into = total.column_mut(column);
            for (other, &row) in motions.iter().zip(&self.dofs) {
                into[row] += other.iter().zip(weighted).map(|(other, weighted)| other * weighted).sum::<f64>();
            }
        }
    }
}

/// A segment that only interpolates: its stiffness is 1 but for the ratio of bending to shear.
fn span(z_bottom_m: f64, z_top_m: f64, axis_deg: f64, shear_ratios: [f64; 2]) -> Segment {
    let length = z_top_m - z_bottom_m;
    let shear_n = shear_ratios.map(|phi| (phi > 0.0).then(|| 12.0 / (phi * length * length)));
    Segment {
        z_bottom_m,
        z_top_m,
        bending_n_m2: [1.0; 2],
        axis_deg,
        shear_n,
        torsion_n_m2: 1.0,
        mass_top_kg: 0.0,
        inertia_kg_m2: [0.0; 3],
    }
}

/// What the matrices say of the beam between two nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Recovered {
    /// Shear ratios along the principal axes, and where axis 1 stands.
    Beam { shear_ratios: [f64; 2], axis_deg: f64 },
    /// A DOF is fixed, so nothing is left of the stiffness between the nodes.
    AtSupport,
    /// Not a beam: moments do not oppose forces, for instance where the matrices count rotations in the opposite sense.
    NoBeam,
}

/// Displacement, rotation and its sign (slopes along X and Y are ry and -rx) of bending along X and along Y.
const PLANES: [(usize, usize, f64); 2] = [(0, 3, 1.0), (1, 2, -1.0)];

/// The shear ratios phi = 12 EI / (kGA L²) of a span from the block of K that couples its two nodes (no other element has
/// part in it).
///
/// With a = 12 EI/(L³(1+phi)) between the displacements and d = (2-phi) EI/(L(1+phi)) between the rotations
/// (Przemieniecki 1968, eq. 5.116): phi = 2 - 12 d/(a L²), which for a span of varying section is a mean. A model of one
/// plane has one of the two; displacements without rotations are straight.
fn recovered(
    stiffness: &DMatrix<f64>,
    lower: [Option<usize>; DOFS_A_NODE],
    upper: [Option<usize>; DOFS_A_NODE],
    length: f64,
) -> Recovered {
    let whole = |(u, r, _): (usize, usize, f64)| [lower[u], lower[r], upper[u], upper[r]].iter().all(Option::is_some);
    // Rows of one kind of DOF below against columns of another above, in a plane each.
    let block = |below: fn((usize, usize, f64)) -> (usize, f64), above: fn((usize, usize, f64)) -> (usize, f64)| {
        Matrix2::from_fn(|i, j| {
            let ((row, sign), (column, other_sign)) = (below(PLANES[i]), above(PLANES[j]));
            let entry = lower[row].zip(upper[column]).map_or(0.0, |place| stiffness[place]);
            sign * other_sign * entry
        })
    };
    let (displacement, slope) = (|(u, _, _)| (u, 1.0), |(_, r, sign)| (r, sign));
    let displacements = -block(displacement, displacement);
    let slopes = block(slope, slope);
    let (shears, moments) = (block(displacement, slope), block(slope, displacement));
    let ratio = |direction: Vector2<f64>| {
        let along = |matrix: &Matrix2<f64>| direction.dot(&(matrix * direction));
        let a = along(&displacements);
        // In balance this is a L, for any variation of the section; heights of nodes that are given roughly make it differ,
        // but not change its sign.
        let moment = along(&shears) - along(&moments);
        (a > 0.0 && moment > 0.0).then(|| (2.0 - 12.0 * along(&slopes) / (a * length * length)).clamp(0.0, STRAIGHT))
    };
    if PLANES.iter().all(|&plane| whole(plane)) {
        let eigen = ((displacements + displacements.transpose()) * 0.5).symmetric_eigen();
        let axes = [eigen.eigenvectors.column(0).into_owned(), eigen.eigenvectors.column(1).into_owned()];
        return match (ratio(axes[0]), ratio(axes[1])) {
            (Some(first), Some(second)) => {
                Recovered::Beam { shear_ratios: [first, second], axis_deg: axes[0][1].atan2(axes[0][0]).to_degrees() }
            }
            _ => Recovered::NoBeam,
        };
    }
    let mut shear_ratios = [0.0; 2];
    for ((shear_ratio, plane), direction) in shear_ratios.iter_mut().zip(PLANES).zip([Vector2::x(), Vector2::y()]) {
        let (u, r, _) = plane;
        *shear_ratio = if whole(plane) {
            let Some(ratio) = ratio(direction) else { return Recovered::NoBeam };
            ratio
        } else if lower[r].is_none() && upper[r].is_none() {
            STRAIGHT
        } else if lower[u].is_none() || lower[r].is_none() {
            return Recovered::AtSupport;
        } else {
            return Recovered::NoBeam;
        };
    }
    Recovered::Beam { shear_ratios, axis_deg: 0.0 }
}
