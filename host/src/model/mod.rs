//! Finite element models: beam tables and the generalised eigenproblem.
//!
//! A [`BeamTable`] or [`ImportedMatrices`] flow in and become a [`Structure`]: a body and a list of [`Contribution`]s, one for
//! each [`effect`]. [`Structure::assemble`] turns it into the mass and stiffness matrices of an [`Assembly`];
//! [`Assembly::modes`] and [`Assembly::sensor_rows`] say what flows out: frequencies, mode shapes, and what a sensor sees of
//! them.
//!
//! Every node of a beam has five degrees of freedom in this order: `ux`, `uy`, `rx`, `ry`, `rz` (global axes, Z up, rotations
//! right-handed, so that a beam rigid in shear has `ry = dux/dz` and `rx = -duy/dz`). There is no axial one. The base
//! node is left out of the matrices.

mod arms;
mod assembly;
mod base;
mod beam;
mod bulk_data;
mod contribution;
mod custom;
mod damped;
mod distortion;
pub mod effect;
mod eigen;
mod element;
mod geometry;
mod grid_points;
#[cfg(test)]
mod import_tests;
mod joint;
mod layout;
mod load;
mod mass_spread;
mod matrices;
mod matrix_files;
mod node_files;
#[cfg(test)]
mod node_files_tests;
mod numbered_nodes;
mod numbering;
mod reduction;
#[cfg(test)]
mod reduction_tests;
mod response;
mod runs;
mod sensing;
mod sensitivity;
mod sensor;
mod size;
mod storeys;
#[cfg(test)]
mod storeys_tests;
mod structure;
#[cfg(test)]
pub(crate) mod tests;
mod universal_nodes;
mod wireframe;

pub use assembly::{Assembly, MassAtRow};
pub use base::BaseFlexibility;
pub use beam::{BeamError, BeamTable, Segment, Stiffness};
pub use contribution::{Contribution, Factors, MassAbove, PointMass};
pub use custom::{Custom, CustomError};
pub use damped::DampedModes;
pub use distortion::Distortion;
pub use effect::mass_eccentricity::eccentricity_changes;
pub use eigen::{EigenError, ModalBasis, Modes, eigenmodes};
pub use element::Compression;
pub use joint::Element;
pub use layout::{LayoutError, LayoutNode, dof_of_row, dofs_csv, node_and_direction};
pub(crate) use layout::{is_list_of_rows, longest_side_m, sides_m};
pub use load::{Freedoms, LoadedModel, ModelError, load, load_up_to, read_beam, section};
pub use matrices::{ImportedMatrices, MatrixError, WholeMatrices, matrix_market, npy, sparse_matrix_market};
pub(crate) use numbered_nodes::{is_numbered, read_numbered_positions};
pub use response::Responses;
pub(crate) use sensing::row_of;
pub use sensing::{Sensing, SensorChange, phases_rad};
pub use sensitivity::{Change, ModeDerivative, frequency_derivatives};
pub use sensor::{BesideNode, SensorError};
pub use size::{TooManyUnknowns, fits_in_full};
pub use structure::{Body, SegmentChange, Structure};
pub use wireframe::{Wireframe, WireframeError};

/// Degrees of freedom of a node: `ux`, `uy`, `rx`, `ry`, `rz`.
pub const DOFS_A_NODE: usize = 5;
