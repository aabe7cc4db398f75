//! What sensors see of a model's modes.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, RowDVector};

use crate::model::{
    Assembly, Change, DampedModes, EigenError, ModalBasis, ModeDerivative, Modes, Responses, SensorError,
    frequency_derivatives, phases_rad,
};
use crate::study::Sensor;

/// A model's modes and what the sensors see of them.
#[derive(Debug, Clone)]
pub struct ModelView {
    /// Eigenvectors of the structure without its dashpots: all of them, or the lowest ones.
    pub basis: Arc<ModalBasis>,
    /// Where dashpots hang on it: its damped modes, which are those of `modes`.
    pub damped: Option<DampedModes>,
    /// The modes that have mass, lowest first.
    pub modes: Arc<Modes>,
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
        Self::of_assembly(assembly.modal_basis()?, assembly, sensors)
    }

    /// The same of a structure near this one: its `count` lowest modes, the `sharp` lowest as exact as all would be; all, where they are
    /// sooner found.
    ///
    /// # Errors
    /// As [`ModelView::of`].
    pub(crate) fn near(
        &self,
        assembly: &Assembly,
        sensors: &[Sensor],
        sharp: usize,
        count: usize,
    ) -> Result<Self, ViewError> {
        Self::of_assembly(assembly.modal_basis_near(&self.basis, sharp, count)?, assembly, sensors)
    }

    /// From a model and its eigenvectors.
    fn of_assembly(basis: ModalBasis, assembly: &Assembly, sensors: &[Sensor]) -> Result<Self, ViewError> {
        let sensor_rows = assembly.sensor_rows(sensors)?;
        let damped = assembly.damped_modes(&basis)?;
        Ok(Self::of_basis(Arc::new(basis), damped, sensor_rows, assembly.sensing.delays_s(sensors)))
    }

    /// From eigenvectors, motion at the sensors (sensors x DOFs) and by how much each is late.
    pub(crate) fn of_basis(
        basis: Arc<ModalBasis>,
        damped: Option<DampedModes>,
        sensor_rows: DMatrix<f64>,
        delays_s: Option<RowDVector<f64>>,
    ) -> Self {
        let modes = match &damped {
            Some(damped) => damped.modes(&basis, &sensor_rows),
            None => basis.modes(usize::MAX),
        };
        Self::of_modes(basis, damped, Arc::new(modes), sensor_rows, delays_s)
    }

    /// The same structure, as it is seen by sensors with other rows (motion at them, sensors x DOFs) and delays.
    pub(crate) fn seen_by(&self, sensor_rows: DMatrix<f64>, delays_s: Option<RowDVector<f64>>) -> Self {
        let (basis, damped) = (self.basis.clone(), self.damped.clone());
        // Shapes of damped modes are turned to the phase that the sensors see.
        match damped {
            Some(damped) => Self::of_basis(basis, Some(damped), sensor_rows, delays_s),
            None => Self::of_modes(basis, None, self.modes.clone(), sensor_rows, delays_s),
        }
    }

    fn of_modes(
        basis: Arc<ModalBasis>,
        damped: Option<DampedModes>,
        modes: Arc<Modes>,
        sensor_rows: DMatrix<f64>,
        delays_s: Option<RowDVector<f64>>,
    ) -> Self {
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
        Self { basis, damped, modes, at_sensors, phases_rad, sensor_rows }
    }

    /// The damping ratio that dashpots give a mode.
    pub(crate) fn damping_ratio(&self, mode: usize) -> f64 {
        self.damped.as_ref().map_or(0.0, |damped| damped.damping_ratio(mode))
    }

    /// How `modes` (0-based), as the sensors see them, follow forces at the DOFs.
    pub(crate) fn responses(&self, modes: &[usize]) -> Responses {
        Responses::of(&self.basis, self.damped.as_ref(), &self.sensor_rows, modes)
    }

    /// Derivatives of `modes` (0-based), whose responses are given, as the sensors record them, by a change.
    pub(crate) fn derivatives(&self, responses: &Responses, modes: &[usize], change: &Change) -> Vec<ModeDerivative> {
        let mut derivatives = responses.derivatives(change);
        for (derivative, &mode) in derivatives.iter_mut().zip(modes) {
            self.record(&mut derivative.shape, mode);
        }
        derivatives
    }

    /// Derivatives of `modes` (0-based), as the sensors record them, by what sensors see of each DOF: `rows` more, sensors x DOFs, and
    /// nothing else.
    pub(crate) fn derivatives_by_rows(&self, rows: &DMatrix<f64>, modes: &[usize]) -> Vec<ModeDerivative> {
        let of = |&mode: &usize| {
            let mut shape = rows * self.modes.shapes.column(mode);
            self.record(&mut shape, mode);
            ModeDerivative { ln_frequency: 0.0, shape, damping_ratio: 0.0 }
        };
        modes.iter().map(of).collect()
    }

    /// What motion at each sensor in a mode counts for in what is recorded of it, where clocks are off.
    pub(super) fn recorded(&self, mode: usize) -> Option<DVector<f64>> {
        self.phases_rad.as_ref().map(|phases| phases.column(mode).map(f64::cos))
    }

    /// Turns motion at the sensors in a mode into what they record of it, where clocks are off.
    fn record(&self, motion: &mut DVector<f64>, mode: usize) {
        if let Some(recorded) = self.recorded(mode) {
            motion.component_mul_assign(&recorded);
        }
    }

    /// Derivatives of ln f of `modes` (0-based) by a change.
    pub(crate) fn frequency_derivatives(&self, modes: &[usize], change: &Change) -> Vec<f64> {
        match &self.damped {
            Some(damped) => damped.frequency_derivatives(&self.basis, modes, change),
            None => frequency_derivatives(&self.basis, modes, change),
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
