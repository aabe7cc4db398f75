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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::DVector;

    use super::*;
    use crate::model::BeamTable;
    use crate::model::effect::Effect;
    use crate::model::structure::Structure;

    const LENGTH_M: f64 = 10.0;

    /// A tower of four panels, stiff in shear along X and Y, with effects.
    fn tower(words: &[&str]) -> Structure {
        let head = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_n,torsion_n_m2,mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2";
        let row = |panel: usize| {
            let z_m = LENGTH_M * panel as f64;
            format!("{z_m},{},1e11,3e11,20,5e9,2e10,1e5,1e5,1e5,5e5\n", z_m + LENGTH_M)
        };
        let table = format!("{head}\n{}", (0..4).map(row).collect::<String>());
        let beam = BeamTable::from_reader(table.as_bytes(), Path::new("beam.csv")).unwrap();
        let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
        Structure::with_effects(beam, &effects).unwrap()
    }

    /// With half of a panel's height, a moment at the top makes each panel sway by the rotation of its lower end: the kinematics of rigid
    /// braces that meet in the middle of the girder above.
    #[test]
    fn without_shear_force_a_panel_sways_as_its_lower_end_rotates() {
        let answer = |word: &str| {
            let stiffness = tower(&[word]).assemble().stiffness;
            let mut moment = DVector::zeros(stiffness.nrows());
            moment[3 * DOFS_A_NODE + 3] = 1e9;
            stiffness.cholesky().unwrap().solve(&moment)
        };
        let coupled = answer("coupled-shear=5");
        for panel in 1..4 {
            let at = |node: usize, dof: usize| coupled[node * DOFS_A_NODE + dof];
            let (sway, rotation) = (at(panel, 0) - at(panel - 1, 0), at(panel - 1, 3));
            assert!((sway / (LENGTH_M * rotation) - 1.0).abs() < 1e-9, "panel {panel}: {sway} m");
        }
        // Rotations are those of the beam, and so is what sways along the other axis.
        let plain = answer("coupled-shear=0");
        for row in (0..plain.len()).filter(|row| row % DOFS_A_NODE == 3) {
            assert!((coupled[row] / plain[row] - 1.0).abs() < 1e-9);
        }
        let along_y = answer("coupled-shear=distance_x=0,distance_y=5");
        let change = (along_y.clone() - &plain)
            .iter()
            .enumerate()
            .fold(0.0, |most: f64, (row, change)| if row % DOFS_A_NODE == 0 { most.max(change.abs()) } else { most });
        assert!(change < 1e-9 * plain.amax(), "{change}");
    }
}
