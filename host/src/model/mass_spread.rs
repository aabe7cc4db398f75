//! Masses that are spread between the nodes where a beam table lumps them at the nodes.

use nalgebra::DMatrix;

use super::assembly::Assembly;
use super::contribution::Contribution;
use super::geometry::{Geometry, Line};

/// Share of each node's mass that is not lumped there but spread to the middles of the segments below and above, its centre
/// staying: 0 is the table as it is, 1 a structure that is as heavy between its nodes as at them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MassSpread(pub(super) f64);

impl Contribution for MassSpread {
    fn rearrange(&self, assembly: &mut Assembly) {
        if let (Geometry::Line(line), true) = (&assembly.geometry, self.0 != 0.0) {
            add_spread(line, self.0, &mut assembly.mass);
        }
    }
}

/// `sum m (mean of nᵀn over the spread - nᵀn at the node)`, n the motion along X and Y: what M gains where each node's mass
/// is spread evenly to the middle of the segment below and, with the share that leaves its centre where it is, of the
/// segment above. Zero where heights mean nothing.
pub(super) fn spread(assembly: &Assembly) -> DMatrix<f64> {
    let mut total = DMatrix::zeros(assembly.dofs(), assembly.dofs());
    if let Geometry::Line(line) = &assembly.geometry {
        add_spread(line, 1.0, &mut total);
    }
    total
}

/// Adds a share of that to a matrix over the DOFs.
fn add_spread(line: &Line, share: f64, total: &mut DMatrix<f64>) {
    // Two-point Gauss quadrature on (0, 1): exact for motion that is straight, 1e-3 for curved motion.
    const POINTS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];
    for pair in line.spans().windows(2) {
        let (z_m, mass_kg) = (pair[0].z_top_m, share * pair[0].mass_top_kg);
        let [below_m, above_m] = [0.5 * pair[0].length_m(), 0.5 * pair[1].length_m()];
        let share_below = above_m / (below_m + above_m);
        let mut add = |z_m: f64, mass_kg: f64| line.local_motion(z_m).add_square(total, 0, mass_kg);
        add(z_m, -mass_kg);
        for point in POINTS {
            add(z_m - point * below_m, 0.5 * mass_kg * share_below);
            add(z_m + point * above_m, 0.5 * mass_kg * (1.0 - share_below));
        }
    }
}
