//! Which of the model's modes a measured mode is, where its file says so.
//!
//! The file numbers the modes of the model as first given. Effects and fits may change their order, so each is followed by its shape.

use nalgebra::{DMatrix, DVector, DVectorView};

use super::error::MeasuredError;
use super::measured::{MeasuredMode, MeasuredModes};
use crate::model::Modes;

/// The mode of the model as first given that a measured mode is said to be.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedMode {
    /// Its number, from 1, lowest frequency first.
    pub number: usize,
    /// The line of the file that says so.
    pub line: u64,
    /// Its frequency and momentum, once the model is known.
    given: Option<GivenMode>,
}

#[derive(Debug, Clone, PartialEq)]
struct GivenMode {
    frequency_hz: f64,
    /// M φ: the product with another shape is how much of this mode is in it.
    momentum: DVector<f64>,
}

impl StatedMode {
    pub(super) fn new(number: usize, line: u64) -> Self {
        Self { number, line, given: None }
    }

    /// A mode (0-based) of this model; `None` where it has no such mode.
    pub(crate) fn in_model(mode: usize, mass: &DMatrix<f64>, modes: &Modes) -> Option<Self> {
        let frequency_hz = *modes.frequency_hz.get(mode)?;
        let given = GivenMode { frequency_hz, momentum: mass * modes.shapes.column(mode) };
        Some(Self { given: Some(given), ..Self::new(mode + 1, 0) })
    }

    /// Its frequency in the model as first given; `None` where that is not known.
    pub(crate) fn frequency_hz(&self) -> Option<f64> {
        self.given.as_ref().map(|given| given.frequency_hz)
    }

    /// How much of it is in a mode (0-based) of the model with other effects: the squared cosine of their angle in the mass of the model
    /// as first given, up to what effects add to that mass. By its number alone where the model is not known.
    pub(crate) fn likeness(&self, mode: usize, shape: DVectorView<'_, f64>) -> f64 {
        let Some(given) = &self.given else { return if mode + 1 == self.number { 1.0 } else { 0.0 } };
        // Degrees of freedom that effects add come last.
        let common = given.momentum.len().min(shape.len());
        given.momentum.rows(0, common).dot(&shape.rows(0, common)).powi(2)
    }
}

impl MeasuredModes {
    /// Whether any mode is stated to be one of the model's.
    pub fn has_stated(&self) -> bool {
        self.modes.iter().any(|mode| mode.stated.is_some())
    }

    /// Finds the stated modes in the model as first given, so that they can be followed.
    ///
    /// # Errors
    /// [`MeasuredError::NoSuchModelMode`].
    pub fn find_stated(&mut self, mass: &DMatrix<f64>, modes: &Modes) -> Result<(), MeasuredError> {
        for mode in &mut self.modes {
            let Some(stated) = &mut mode.stated else { continue };
            let index = stated.number.checked_sub(1);
            let found = index.and_then(|index| StatedMode::in_model(index, mass, modes));
            let found = found.ok_or_else(|| MeasuredError::NoSuchModelMode {
                file: self.file.clone(),
                line: stated.line,
                number: stated.number,
                modes: modes.frequency_hz.len(),
            })?;
            *stated = StatedMode { line: stated.line, ..found };
        }
        Ok(())
    }
}

/// Whether it is known which mode is which: by a shape, or because all of them are stated.
pub(crate) fn are_known(modes: &[MeasuredMode]) -> bool {
    modes.iter().any(|mode| mode.shape.is_some()) || modes.iter().all(|mode| mode.stated.is_some())
}
