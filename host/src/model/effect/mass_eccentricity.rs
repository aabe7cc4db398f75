//! `mass-eccentricity`: the centre of mass stands beside the beam axis.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "mass-eccentricity",
    physics: "Cores and plant stand to one side, so the centre of mass of the floors lies off the axis about which the \
         structure twists. Bending and torsion then couple.",
    formula: "M[uy,rz] += m x, M[ux,rz] -= m y, M[rz,rz] += m (x^2 + y^2) at the nodes of the main body",
    fingerprint: "torsion in the bending modes, bending in the torsional ones",
    look_alikes: &[
        LookAlike { kind: "axis-rotation", separated_by: "sensors at one level on opposite sides, which see torsion" },
        LookAlike { kind: "sensor-rotation", separated_by: "sensors at one level on opposite sides" },
    ],
    source: "A. K. Chopra (2012), Dynamics of Structures, section 9.6",
    examples: &["mass-eccentricity=x=0.8,y=-0.3"],
};

const X: Parameter = Parameter::ranged("x", "m", [-1e3, 1e3], 1.0, "centre of mass from the beam axis along X");
const Y: Parameter = Parameter::ranged("y", "m", [-1e3, 1e3], 1.0, "centre of mass from the beam axis along Y");

/// See [`ABOUT`].
#[derive(Debug)]
pub(super) struct MassEccentricity;

impl EffectKind for MassEccentricity {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn parameter_sets(&self) -> &'static [&'static [Parameter]] {
        &[&[X, Y]]
    }

    fn contribution(&self, given: &Given<'_>, structure: &Structure) -> Result<Arc<dyn Contribution>, EffectError> {
        given.check_line(self, structure)?;
        Ok(Arc::new(Eccentricity { offset_m: [X, Y].map(|parameter| given.or_zero(parameter.name)) }))
    }
}

/// Nodes with less than this share of the largest radius of gyration belong to a mast, not to the main body.
const SLENDER: f64 = 0.5;

/// The centre of mass of the main body's nodes, off the axis.
#[derive(Debug)]
struct Eccentricity {
    offset_m: [f64; 2],
}

impl Contribution for Eccentricity {
    /// `M[uy,rz] = m x`, `M[ux,rz] = -m y`, and `M[rz,rz] += m (x² + y²)` as the inertia stays what it is about the centre
    /// of mass.
    ///
    /// The main body are the nodes whose radius of gyration about Z is at least [`SLENDER`] of the largest: a mast on top
    /// has its own axis.
    fn rearrange(&self, assembly: &mut Assembly) {
        if self.offset_m == [0.0; 2] {
            return;
        }
        let [x, y] = self.offset_m;
        let nodes: Vec<[usize; 3]> =
            assembly.node_rows().iter().filter_map(|rows| Some([rows[0]?, rows[1]?, rows[4]?])).collect();
        let mass = &mut assembly.mass;
        let gyration_square = |mass: &DMatrix<f64>, &[ux, _, rz]: &[usize; 3]| {
            if mass[(ux, ux)] > 0.0 { mass[(rz, rz)] / mass[(ux, ux)] } else { 0.0 }
        };
        let largest = nodes.iter().map(|node| gyration_square(mass, node)).fold(0.0, f64::max);
        let is_body = |node: &&[usize; 3]| gyration_square(mass, node) >= SLENDER * SLENDER * largest;
        let body: Vec<[usize; 3]> = nodes.iter().filter(is_body).copied().collect();
        // Motion of the centres of mass: M becomes Sᵀ M S, with S adding the rotation's share to each node's ux and uy.
        for &[ux, uy, rz] in &body {
            let moved = mass.column(ux) * -y + mass.column(uy) * x;
            let mut column = mass.column_mut(rz);
            column += moved;
        }
        for &[ux, uy, rz] in &body {
            let moved = mass.row(ux) * -y + mass.row(uy) * x;
            let mut row = mass.row_mut(rz);
            row += moved;
        }
    }
}
