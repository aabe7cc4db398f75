//! Finite element models: beam tables and the generalised eigenproblem.
//!
//! A [`BeamTable`] or [`ImportedMatrices`] flow in, [`effect`]s change the [`Structure`] made of it,
//! [`Structure::assemble`] turns it into the mass and stiffness matrices of an [`Assembly`]; [`Assembly::modes`] and [`Assembly::sensor_rows`] say what flows
//! out: frequencies, mode shapes, and what a sensor sees of them.
//!
//! Every node of a beam has five degrees of freedom in this order: `ux`, `uy`, `rx`, `ry`, `rz` (global axes, Z up, rotations
//! right-handed, so that a beam rigid in shear has `ry = dux/dz` and `rx = -duy/dz`). There is no axial one. The base
//! node is left out of the matrices.

mod assembly;
mod beam;
mod damped;
pub mod effect;
mod eigen;
mod element;
mod geometry;
#[cfg(test)]
mod import_tests;
mod layout;
mod load;
mod matrices;
mod sensing;
mod sensitivity;
mod sensor;
#[cfg(test)]
pub(crate) mod tests;

pub use assembly::{
    AddedMass, Assembly, BaseFlexibility, Body, GroundSpring, Joint, MatrixChange, SegmentChange, Structure, TunedMass,
};
pub use beam::{BeamError, BeamTable, Segment};
pub use damped::DampedModes;
pub use eigen::{EigenError, ModalBasis, Modes, eigenmodes};
pub use layout::{LayoutError, LayoutNode};
pub use load::{LoadedModel, ModelError, load};
pub use matrices::{ImportedMatrices, MatrixError};
pub use sensing::{Sensing, SensorChange, phases_rad};
pub use sensitivity::{Change, ModeDerivative, derivatives, frequency_derivatives};
pub use sensor::SensorError;

/// Degrees of freedom of a node: `ux`, `uy`, `rx`, `ry`, `rz`.
pub const DOFS_A_NODE: usize = 5;
