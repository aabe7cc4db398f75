//! Where a model's degrees of freedom stand in space: heights and places flow in, motion there as a matrix over the DOFs
//! flows out.

use nalgebra::{DMatrix, Matrix2};

use super::element::interpolation;
use super::layout::{LayoutNode, is_line};
use super::{DOFS_A_NODE, Segment};

/// Where the DOFs stand.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Geometry {
    /// Not known: sensors name rows of the matrices.
    Unknown,
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
    /// Motion of the lowest node where it follows from the DOFs, 5 x DOFs.
    base_motion: Option<DMatrix<f64>>,
}

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
    pub(super) fn of_beam(segments: &[Segment], base_motion: DMatrix<f64>) -> Self {
        let node = |index: usize| std::array::from_fn(|dof| Some(index * DOFS_A_NODE + dof));
        let rows = std::iter::once([None; DOFS_A_NODE]).chain((0..segments.len()).map(node));
        Self { rows: rows.collect(), spans: segments.to_vec(), base_motion: Some(base_motion) }
    }

    /// Imported nodes. The shape functions between two of them need the share of shear in their deflection, which the
    /// stiffness between the two holds (see [`recovered`]); a span at a fixed node takes it from its neighbour.
    fn of_nodes(nodes: &[LayoutNode], stiffness: &DMatrix<f64>) -> Self {
        let rows: Vec<[Option<usize>; DOFS_A_NODE]> =
            nodes.iter().map(|node| std::array::from_fn(|dof| node.rows[dof])).collect();
        let mut spans: Vec<Option<Segment>> = nodes
            .windows(2)
            .zip(rows.windows(2))
            .map(|(pair, rows)| {
                let (z_bottom_m, z_top_m) = (pair[0].position_m[2], pair[1].position_m[2]);
                let straight = || span(z_bottom_m, z_top_m, 0.0, [STRAIGHT; 2]);
                if rows.iter().all(|rows| rows[2].is_none() && rows[3].is_none()) {
                    return Some(straight());
                }
                let (shear_ratios, axis_deg) = recovered(stiffness, rows[0], rows[1], z_top_m - z_bottom_m)?;
                Some(span(z_bottom_m, z_top_m, axis_deg, shear_ratios))
            })
            .collect();
        for index in (0..spans.len().saturating_sub(1)).rev() {
            if spans[index].is_none()
                && let Some(above) = spans[index + 1].clone()
            {
                let (z_bottom_m, z_top_m) = (nodes[index].position_m[2], nodes[index + 1].position_m[2]);
                spans[index] = Some(Segment { z_bottom_m, z_top_m, ..above });
            }
        }
        let whole = |(span_of, pair): (Option<Segment>, &[LayoutNode])| {
            span_of.unwrap_or_else(|| span(pair[0].position_m[2], pair[1].position_m[2], 0.0, [0.0; 2]))
        };
        Self { rows, spans: spans.into_iter().zip(nodes.windows(2)).map(whole).collect(), base_motion: None }
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
        let last = self.spans.len().saturating_sub(1);
        let index = self.spans.iter().position(|span| z_m <= span.z_top_m).unwrap_or(last);
        let Some(span) = self.spans.get(index) else { return motion };
        let shape = interpolation(span, z_m);
        for (node, first_column) in [(index, 0), (index + 1, DOFS_A_NODE)] {
            let part = shape.columns(first_column, DOFS_A_NODE);
            for (dof, row) in self.rows[node].iter().enumerate() {
                if let Some(row) = *row {
                    // Added, as the base may move with the node above it.
                    motion.set_column(row, &(motion.column(row) + part.column(dof)));
                }
            }
            if node == 0
                && let Some(base_motion) = &self.base_motion
            {
                motion += part * base_motion;
            }
        }
        motion
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

/// The shear ratios phi = 12 EI / (kGA L²) of a span along its principal axes, and where axis 1 stands, from the block of
/// K that couples its two nodes (no other element has part in it).
///
/// With a = 12 EI/(L³(1+phi)) between the displacements and d = (2-phi) EI/(L(1+phi)) between the rotations
/// (Przemieniecki 1968, eq. 5.116): phi = 2 - 12 d/(a L²). `None` where a DOF is fixed or the block is not that of a beam.
fn recovered(
    stiffness: &DMatrix<f64>,
    lower: [Option<usize>; DOFS_A_NODE],
    upper: [Option<usize>; DOFS_A_NODE],
    length: f64,
) -> Option<([f64; 2], f64)> {
    let entry = |i: usize, j: usize| Some(stiffness[(lower[i]?, upper[j]?)]);
    let displacements = -Matrix2::new(entry(0, 0)?, entry(0, 1)?, entry(1, 0)?, entry(1, 1)?);
    // Slopes along X and Y are ry and -rx.
    let rotations = Matrix2::new(entry(3, 3)?, -entry(3, 2)?, -entry(2, 3)?, entry(2, 2)?);
    let eigen = ((displacements + displacements.transpose()) * 0.5).symmetric_eigen();
    let axis = eigen.eigenvectors.column(0);
    let ratio = |index: usize| {
        let direction = eigen.eigenvectors.column(index);
        let a = eigen.eigenvalues[index];
        let d = (direction.transpose() * rotations * direction)[(0, 0)];
        (a > 0.0).then(|| (2.0 - 12.0 * d / (a * length * length)).clamp(0.0, STRAIGHT))
    };
    Some(([ratio(0)?, ratio(1)?], axis[1].atan2(axis[0]).to_degrees()))
}
