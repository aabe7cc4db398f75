//! How modes follow a small change of K, M and C: exact first derivatives over all eigenvectors.
//!
//! A [`ModalBasis`], the modes of a structure with dashpots where it has any, and what sensors see flow in. What does not hang on the change is
//! made once; then each of many changes costs little.

use nalgebra::DMatrix;

use super::damped::{DampedModes, DampedResponse};
use super::eigen::ModalBasis;
use super::sensitivity::{Change, ModeDerivative, UndampedResponse};

/// How some modes follow forces at the DOFs.
#[derive(Debug, Clone)]
pub struct Responses(Vec<Response>);

#[derive(Debug, Clone)]
enum Response {
    Undamped(UndampedResponse),
    Damped(Box<DampedResponse>),
}

impl Responses {
    /// Of the modes `modes` (0-based, with mass). `rows` is what sensors see of each DOF, sensors x DOFs, to whose phase [`DampedModes::modes`]
    /// turned the shapes of damped modes.
    pub fn of(basis: &ModalBasis, damped: Option<&DampedModes>, rows: &DMatrix<f64>, modes: &[usize]) -> Self {
        let (sensor_vectors, transposed) = (&(rows * &basis.vectors), basis.vectors.transpose());
        let left_out = basis.left_out(rows, sensor_vectors, &transposed);
        let undamped =
            |mode| Response::Undamped(UndampedResponse::of(basis, sensor_vectors, &transposed, &left_out, mode));
        let Some(damped) = damped else {
            return Self(modes.iter().map(|&mode| undamped(mode)).collect());
        };
        let mixing = damped.mixing(basis, sensor_vectors);
        let of = |&mode: &usize| match damped.response(basis, sensor_vectors, &transposed, &mixing, mode) {
            Ok(response) => Response::Damped(Box::new(response)),
            Err(mode) => undamped(mode),
        };
        Self(modes.iter().map(of).collect())
    }

    /// The modes, where no dashpot moves one of them.
    pub(crate) fn undamped(&self) -> Option<Vec<&UndampedResponse>> {
        let responses = self.0.iter().map(|response| match response {
            Response::Undamped(response) => Some(response),
            Response::Damped(_) => None,
        });
        responses.collect()
    }

    /// Derivatives of the modes by a change.
    pub fn derivatives(&self, change: &Change) -> Vec<ModeDerivative> {
        let derivative = |response: &Response| match response {
            Response::Undamped(response) => response.derivative(change),
            Response::Damped(response) => response.derivative(change),
        };
        self.0.iter().map(derivative).collect()
    }
}
