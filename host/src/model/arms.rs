//! Points that stand off their nodes: a mass beside the axis, or a beam above the level that it belongs to.

use nalgebra::{Dim, Matrix, RawStorageMut};

use super::DOFS_A_NODE;

/// A point's motion along one DOF that is the node's own and, times the arm in m, that along another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arm {
    /// Row of the one.
    pub(super) translation: usize,
    /// Row of the other.
    pub(super) rotation: usize,
    /// What a unit of the rotation adds to the translation, in m.
    pub(super) length_m: f64,
}

/// Rows of a node's `ux, uy, rx, ry, rz`, where they are.
pub(super) type NodeRows = [Option<usize>; DOFS_A_NODE];

/// Arms of points so far above their nodes, for motion along X and Y in m.
pub(super) fn upright(nodes: &[NodeRows], [along_x_m, along_y_m]: [f64; 2]) -> Vec<Arm> {
    let arm = |(translation, rotation, length_m): (Option<usize>, Option<usize>, f64)| {
        Some(Arm { translation: translation?, rotation: rotation?, length_m })
    };
    let of_node = |rows: &NodeRows| [(rows[0], rows[3], along_x_m), (rows[1], rows[2], -along_y_m)];
    nodes.iter().flat_map(of_node).filter_map(arm).collect()
}

/// `Tᵀ A T`: a matrix of the points, symmetric, as one of their nodes; T gives points their motion. Arms of one rotation stand together.
pub(super) fn carry<R: Dim, C: Dim, S: RawStorageMut<f64, R, C>>(matrix: &mut Matrix<f64, R, C, S>, arms: &[Arm]) {
    for of_one in arms.chunk_by(|one, next| one.rotation == next.rotation) {
        for row in 0..matrix.nrows() {
            let moved: f64 = of_one.iter().map(|arm| arm.length_m * matrix[(row, arm.translation)]).sum();
            matrix[(row, of_one[0].rotation)] += moved;
        }
    }
    for of_one in arms.chunk_by(|one, next| one.rotation == next.rotation) {
        for column in 0..matrix.ncols() {
            let moved: f64 = of_one.iter().map(|arm| arm.length_m * matrix[(arm.translation, column)]).sum();
            matrix[(of_one[0].rotation, column)] += moved;
        }
    }
}
