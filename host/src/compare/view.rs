//! What sensors see of a model's modes.

use nalgebra::{DMatrix, DVector, RowDVector};

use crate::model::{Assembly, EigenError, ModalBasis, Modes, SensorError, phases_rad};
use crate::study::Sensor;

/// A model's modes and what the sensors see of them.
#[derive(Debug, Clone)]
pub struct ModelView {
    /// All eigenvectors.
    pub basis: ModalBasis,
    /// The modes that have mass, lowest first.
    pub modes: Modes,
    /// Their shapes as the sensors record them, sensors x modes, in the sensors' positive directions; where clocks are off,
    /// the real part at the phase at which it is the largest.
    pub at_sensors: DMatrix<f64>,
    /// Where clocks are off: the phase in rad at which each sensor records each mode, sensors x modes.
    pub phases_rad: Option<DMatrix<f64>>,
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
        Ok(Self::of_basis(assembly.modal_basis()?, sensor_rows, assembly.sensing.delays_s(sensors)))
    }

    /// From eigenvectors, motion at the sensors (sensors x DOFs) and by how much each is late.
    pub(crate) fn of_basis(basis: ModalBasis, sensor_rows: DMatrix<f64>, delays_s: Option<RowDVector<f64>>) -> Self {
        let modes = basis.modes(usize::MAX);
        let mut at_sensors = &sensor_rows * &modes.shapes;
        let phases_rad = delays_s.map(|delays_s| {
            let mut phases = DMatrix::zeros(at_sensors.nrows(), at_sensors.ncols());
            for (mode, frequency_hz) in modes.frequency_hz.iter().enumerate() {
                let shape: Vec<f64> = at_sensors.column(mode).iter().copied().collect();
                phases.column_mut(mode).copy_from_slice(&phases_rad(&shape, &delays_s, *frequency_hz));
            }
            at_sensors.zip_apply(&phases, |value, phase: f64| *value *= phase.cos());
            phases
        });
        Self { basis, modes, at_sensors, phases_rad, sensor_rows }
    }

    /// Turns a change of a mode's motion at the sensors into a change of what they record.
    pub(crate) fn record(&self, mode: usize, change: &mut DVector<f64>) {
        if let Some(phases) = &self.phases_rad {
            change.zip_apply(&phases.column(mode), |value, phase: f64| *value *= phase.cos());
        }
    }

    /// The imaginary part of what sensors record of a mode; `None` where all clocks are right.
    pub(crate) fn imaginary(&self, mode: usize) -> Option<DVector<f64>> {
        let phases = self.phases_rad.as_ref()?;
        let mut motion = &self.sensor_rows * self.modes.shapes.column(mode);
        motion.zip_apply(&phases.column(mode), |value, phase: f64| *value *= phase.sin());
        Some(motion)
    }

    /// A mode's shape at the sensors.
    pub fn shape(&self, mode: usize) -> &[f64] {
        let sensors = self.at_sensors.nrows();
        // nalgebra stores column after column.
        self.at_sensors.as_slice().get(mode * sensors..(mode + 1) * sensors).unwrap_or(&[])
    }
}
