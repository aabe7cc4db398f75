//! What sensors see of a model's modes.

use nalgebra::DMatrix;

use crate::model::{Assembly, EigenError, ModalBasis, Modes, SensorError};
use crate::study::Sensor;

/// A model's modes and what the sensors see of them.
#[derive(Debug, Clone)]
pub struct ModelView {
    /// All eigenvectors.
    pub basis: ModalBasis,
    /// The modes that have mass, lowest first.
    pub modes: Modes,
    /// Their shapes at the sensors, sensors x modes, in the sensors' positive directions.
    pub at_sensors: DMatrix<f64>,
    /// What the sensors see of each DOF, sensors x DOFs.
    pub sensor_rows: DMatrix<f64>,
}

/// Why a model cannot be seen by the sensors.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// A sensor has no place in the model.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// The model has no modes.
    #[error("the model: {0}")]
    Eigen(#[from] EigenError),
}

impl ModelView {
    /// Modes of an assembled model at the sensors.
    ///
    /// # Errors
    /// [`ViewError`] names the channel, or what is wrong with the matrices.
    pub fn of(assembly: &Assembly, sensors: &[Sensor]) -> Result<Self, ViewError> {
        let sensor_rows = assembly.sensor_rows(sensors)?;
        let basis = assembly.modal_basis()?;
        let modes = basis.modes(usize::MAX);
        Ok(Self { at_sensors: &sensor_rows * &modes.shapes, basis, modes, sensor_rows })
    }

    /// A mode's shape at the sensors.
    pub fn shape(&self, mode: usize) -> &[f64] {
        let sensors = self.at_sensors.nrows();
        // nalgebra stores column after column.
        self.at_sensors.as_slice().get(mode * sensors..(mode + 1) * sensors).unwrap_or(&[])
    }
}
