//! `mass-eccentricity`: the centre of mass stands beside the beam axis.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::error::EffectError;
use super::kind::{About, EffectKind, Given, LookAlike};
use super::parameter::Parameter;
use crate::model::arms::{Arm, carry};
use crate::model::assembly::Assembly;
use crate::model::contribution::Contribution;
use crate::model::sensitivity::Change;
use crate::model::structure::Structure;

const ABOUT: About = About {
    name: "mass-eccentricity",
    physics: "Cores and plant stand to one side, so the centre of mass of the floors lies off the axis about which the \
         structure twists. Bending and torsion then couple.",
    formula: "M[uy,rz] += m x, M[ux,rz] -= m y, M[rz,rz] += m (x^2 + y^2) at all nodes below a mast",
    fingerprint: "torsion in the bending modes, bending in the torsional ones",
    look_alikes: &[
        LookAlike { kind: "axis-rotation", separated_by: "sensors at one level on opposite sides, which see torsion" },
        LookAlike { kind: "sensor-rotation", separated_by: "sensors at one level on opposite sides" },
    ],
    source: "A. K. Chopra (2012), Dynamics of Structures, section 9.6",
    examples: &["mass-eccentricity=x=0.8,y=-0.3"],
};

/// A centre of mass lies inside the plan: half of the widest towers' sides.
const FARTHEST_M: f64 = 30.0;
const X: Parameter =
    Parameter::ranged("x", "m", [-FARTHEST_M, FARTHEST_M], 1.0, "centre of mass from the beam axis along X");
const Y: Parameter =
    Parameter::ranged("y", "m", [-FARTHEST_M, FARTHEST_M], 1.0, "centre of mass from the beam axis along Y");

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

/// Where the radius of gyration falls to less than this share from one node to the next, and stays below, a mast begins.
const SLENDER: f64 = 0.5;

/// And what stands above has less than this share of the mass.
const LIGHT: f64 = 0.1;

/// The centre of mass of the nodes below a mast, off the axis.
#[derive(Debug)]
pub(in crate::model) struct Eccentricity {
    /// Along X and Y in m.
    pub(in crate::model) offset_m: [f64; 2],
}

impl Contribution for Eccentricity {
    /// `M[uy,rz] = m x`, `M[ux,rz] = -m y`, and `M[rz,rz] += m (x² + y²)` as the inertia stays what it is about the centre
    /// of mass.
    fn rearrange(&self, assembly: &mut Assembly) {
        if self.offset_m == [0.0; 2] {
            return;
        }
        let [x_m, y_m] = self.offset_m;
        // As the centres of mass move: rotation has its share in each node's ux and uy.
        let arms = |&[ux, uy, rotation]: &[usize; 3]| {
            [(ux, -y_m), (uy, x_m)].map(|(translation, length_m)| Arm { translation, rotation, length_m })
        };
        let arms: Vec<Arm> = body(assembly).iter().flat_map(arms).collect();
        carry(&mut assembly.mass, &arms);
    }
}

/// Rows of `ux, uy, rz` of the nodes below a mast.
///
/// A mast on top has its own axis: it stands on the highest node above which the radius of gyration about Z falls at once to less
/// than [`SLENDER`], and with it next to nothing of the mass. A waist, or a top that tapers, is as eccentric as the rest.
fn body(assembly: &Assembly) -> Vec<[usize; 3]> {
    let mut nodes: Vec<[usize; 3]> =
        assembly.node_rows().iter().filter_map(|rows| Some([rows[0]?, rows[1]?, rows[4]?])).collect();
    let mass = &assembly.mass;
    let gyration_square = |&[ux, _, rz]: &[usize; 3]| {
        if mass[(ux, ux)] > 0.0 { mass[(rz, rz)] / mass[(ux, ux)] } else { 0.0 }
    };
    let squares: Vec<f64> = nodes.iter().map(gyration_square).collect();
    let mass_kg = |nodes: &[[usize; 3]]| nodes.iter().map(|[ux, ..]| mass[(*ux, *ux)]).sum::<f64>();
    let is_foot = |at: &usize| {
        squares[at + 1..].iter().all(|above| *above < SLENDER * SLENDER * squares[*at])
            && mass_kg(&nodes[at + 1..]) < LIGHT * mass_kg(&nodes)
    };
    let foot = (0..nodes.len().saturating_sub(1)).find(is_foot);
    nodes.truncate(foot.map_or(nodes.len(), |foot| foot + 1));
    nodes
}

/// What a metre of eccentricity along X, and one along Y, does to M, by the slope at the masses as they are.
pub fn eccentricity_changes(assembly: &Assembly) -> [Change; 2] {
    let (body, mass) = (body(assembly), &assembly.mass);
    let none = DMatrix::zeros(mass.nrows(), mass.ncols());
    let along = |row: usize, sign: f64| {
        let mut moved = none.clone();
        for node in &body {
            let mut column = moved.column_mut(node[2]);
            column += mass.column(node[row]) * sign;
        }
        Change::of(&none, &(&moved + moved.transpose()), None)
    };
    [along(1, 1.0), along(0, -1.0)]
}
