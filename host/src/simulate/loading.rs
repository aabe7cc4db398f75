//! The load: white noise at every node, as strong as its mass.
//!
//! The force on a node of mass m has the one-sided spectral density `level² m m_total`, in X and in Y, independent of all
//! others. The forces' sum then has `level² m_total²`: the whole mass moving rigidly would have an acceleration density of
//! `level²`, and a finer mesh of the same structure is loaded alike. All translational modes get (all but for rotary
//! inertia) the same modal force, `level² m_total` for mass-normalised shapes. Torsional moments get the density that
//! belongs to the node's polar inertia, less by [`TORSION_SHARE`] in amplitude.

use nalgebra::DMatrix;

use crate::model::{Assembly, DOFS_A_NODE};

/// Torsional moments relative to those that would drive torsion as hard as bending: wind drives it less.
const TORSION_SHARE: f64 = 0.3;

/// Independent loads on the degrees of freedom.
pub(super) struct Loading {
    /// Loaded DOF and the standard deviation of its force a sample, in N or N m.
    loads: Vec<(usize, f64)>,
}

impl Loading {
    /// Loads at `level` in m/s²/√Hz, held for one sample each.
    pub(super) fn new(assembly: &Assembly, level: f64, sampling_rate_hz: f64) -> Self {
        let inertia = assembly.mass.diagonal();
        let along = |dof: usize| inertia.iter().copied().enumerate().skip(dof).step_by(DOFS_A_NODE);
        let total_mass_kg: f64 = along(0).map(|(_, mass)| mass).sum();
        // White noise of one-sided density G has the variance G fs / 2 in each sample.
        let std = |inertia: f64| level * (inertia * total_mass_kg * sampling_rate_hz / 2.0).max(0.0).sqrt();
        let forces = along(0).chain(along(1)).map(|(dof, mass)| (dof, std(mass)));
        let moments = along(4).map(|(dof, polar)| (dof, TORSION_SHARE * std(polar)));
        Self { loads: forces.chain(moments).filter(|&(_, std)| std > 0.0).collect() }
    }

    /// Modal forces from unit normals, modes x loads.
    pub(super) fn on_modes(&self, shapes: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(shapes.ncols(), self.loads.len(), |mode, load| {
            let (dof, std) = self.loads[load];
            shapes[(dof, mode)] * std
        })
    }
}
