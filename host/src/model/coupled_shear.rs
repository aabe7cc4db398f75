//! Bending that makes a beam shear, as in panels whose bracing leads from the corners of one level to the middles of the next.
//!
//! Without shear force such a panel sways by its height times the rotation of its lower end, where a beam sways by that of its middle: a
//! change of rotation along the beam comes with shear, `u' = φ + V / GA - d φ'`, where d is half of the panel's height (of bracing the other
//! way up, minus that). As that term is a derivative along the beam, `u + d φ` is the sway of an ordinary beam: with T the motion of points
//! that are d above the nodes, K is `Tᵀ K T`.

use nalgebra::DMatrix;

use super::DOFS_A_NODE;
use super::assembly::Assembly;
use super::contribution::Contribution;

/// How far above the nodes the points are that move as those of an ordinary beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CoupledShear {
    /// For motion along X and along Y, in m.
    pub(super) d_m: [f64; 2],
}

/// Rows of a node's `ux, uy, rx, ry, rz`, where they are.
type Rows = [Option<usize>; DOFS_A_NODE];

impl Contribution for CoupledShear {
    fn coupled_shear_m(&self) -> [f64; 2] {
        self.d_m
    }

    fn rearrange(&self, assembly: &mut Assembly) {
        let nodes = assembly.node_rows().to_vec();
        raise(&mut assembly.stiffness, &nodes, self.d_m);
    }
}

/// What follows what: `ux` grows by d times `ry`, `uy` shrinks by d times `rx`; sway, rotation, and by how much.
fn arms(nodes: &[Rows], [along_x_m, along_y_m]: [f64; 2]) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
    let arms = move |rows: &Rows| [(rows[0], rows[3], along_x_m), (rows[1], rows[2], -along_y_m)];
    nodes.iter().flat_map(arms).filter_map(|(sway, rotation, arm_m)| Some((sway?, rotation?, arm_m)))
}

/// `Tᵀ K T`.
fn raise(stiffness: &mut DMatrix<f64>, nodes: &[Rows], d_m: [f64; 2]) {
    if d_m == [0.0; 2] {
        return;
    }
    for (sway, rotation, arm_m) in arms(nodes, d_m) {
        let moved = stiffness.column(sway) * arm_m;
        let mut column = stiffness.column_mut(rotation);
        column += moved;
    }
    for (sway, rotation, arm_m) in arms(nodes, d_m) {
        let moved = stiffness.row(sway) * arm_m;
        let mut row = stiffness.row_mut(rotation);
        row += moved;
    }
}

/// `Tᵀ K T` of the part of K of one node or more above each other, all of whose rows it has.
pub(super) fn raised(mut part: DMatrix<f64>, d_m: [f64; 2]) -> DMatrix<f64> {
    let rows = |node: usize| std::array::from_fn(|dof| Some(node * DOFS_A_NODE + dof));
    let nodes: Vec<Rows> = (0..part.nrows() / DOFS_A_NODE).map(rows).collect();
    raise(&mut part, &nodes, d_m);
    part
}
