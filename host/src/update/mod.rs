//! The direct update of the stiffness matrix: paired modes flow in, K* = K + M Phi1 Psi Phi1ᵀ M flows out.
//!
//! After Lei, Wang, Shen (2012), eqs. 8 to 14. Psi is symmetric and acts inside the span of the model's own shapes Phi1
//! only, so all other eigenpairs stay as they are. The updated eigenpairs inside that span are those of the small matrix
//! `Lambda1 + Psi = V Lambda* Vᵀ`: with Lambda* and the orthogonal V as unknowns instead of the entries of Psi, the
//! paper's objective separates. Lambda* are the measured eigenvalues exactly, and only the MAC terms are left, over the
//! orthogonal group (`rotation` minimises them).

mod hints;
mod matrices;
mod problem;
mod rotation;
#[cfg(test)]
mod tests;

pub use hints::{Hints, OrthogonalityTest, SpanTest, hints};
pub use matrices::{Other, UpdatedMatrices, updated};
pub use problem::{Problem, Solution, UpdateError, Weights, solve};
