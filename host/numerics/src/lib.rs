//! The host's inner numerics: Fourier transforms and eigenproblems, dense ones, those with few entries and those of a few dashpots, as plain
//! functions on `f64` and `Complex<f64>`.
//!
//! Generic libraries are compiled where their types become known. Here is that place, once, at full optimisation; the host and
//! its tests, which change every day, only call.

mod dashpots;
mod eigen;
mod fourier;
mod lowest;
mod sets;
mod sparse;

pub use dashpots::dashpot_modes;
pub use eigen::{
    CholeskyFactor, EigenPairs, SingularTriplets, complex_product, general_eigen, general_eigen_complex,
    singular_triplets, symmetric_pairs,
};
pub use fourier::{
    ComplexTransform, ForwardTransform, InverseTransform, complex_transform, forward_transform,
    inverse_complex_transform, inverse_transform,
};
pub use lowest::{Envelope, EnvelopeFactor, lowest_modes};
pub use sets::sets_apart;
pub use sparse::{SparseFactor, count_below, factor_entries, lowest_sparse_modes};
