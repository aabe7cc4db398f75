//! How the differences of paired modes follow a small change of the model's matrices.
//!
//! A residual and the responses of the model's modes flow in. What does not hang on the change is projected onto the directions that count
//! once; then each of many changes costs a few products.

use nalgebra::{DMatrix, DVector};

use super::residual::Residual;
use super::view::ModelView;
use crate::model::{Change, Responses};

/// How the differences follow changes, where no dashpot moves a mode.
pub(crate) struct Following {
    size: usize,
    /// Mass-normalised shapes of the model's modes, DOFs x modes, and their 1/lambda.
    shapes: DMatrix<f64>,
    mu: Vec<f64>,
    /// One for each mode of the model that a shape is held against.
    parts: Vec<Part>,
    /// For each block: the place of its frequency, and which of the modes it belongs to.
    frequencies: Vec<(usize, usize)>,
}

/// What one of the model's modes adds to the difference of one shape.
struct Part {
    /// The place of the first of the shape's numbers.
    first: usize,
    /// Which of the modes.
    mode: usize,
    /// The differences by forces at the DOFs, directions x DOFs.
    by_force: DMatrix<f64>,
    /// The differences by the length of the mode's shape.
    by_length: DVector<f64>,
}

impl Following {
    /// Of differences from `models` (0-based, ascending), whose responses are given; `None` where dashpots move one of these.
    pub(crate) fn of(view: &ModelView, residual: &Residual, responses: &Responses, models: &[usize]) -> Option<Self> {
        let responses = responses.undamped()?;
        let mut parts = Vec::new();
        let mut frequencies = Vec::new();
        for (first, block) in residual.blocks() {
            frequencies.push((first, models.binary_search(&block.model).ok()?));
            let Some(shape) = &block.shape else { continue };
            for (index, model) in shape.models.iter().enumerate() {
                let mode = models.binary_search(model).ok()?;
                let mut by_shape = shape.by_shape(index, view.at_sensors.nrows());
                if let Some(recorded) = view.recorded(*model) {
                    by_shape.column_iter_mut().zip(recorded.iter()).for_each(|(mut column, share)| column *= *share);
                }
                let response = responses[mode];
                let (by_force, by_length) = (&by_shape * response.by_force(), &by_shape * response.seen());
                parts.push(Part { first: first + 1, mode, by_force, by_length });
            }
        }
        let shapes = responses.iter().map(|response| response.shape().column(0)).collect::<Vec<_>>();
        let shapes = if shapes.is_empty() { DMatrix::zeros(0, 0) } else { DMatrix::from_columns(&shapes) };
        let mu = responses.iter().map(|response| response.mu()).collect();
        Some(Self { size: residual.size(), shapes, mu, parts, frequencies })
    }

    /// The derivative of the differences by a change.
    pub(crate) fn along(&self, change: &Change) -> DVector<f64> {
        let loads = change.loads(&self.shapes, &self.mu);
        let mut slope = DVector::zeros(self.size);
        for &(at, mode) in &self.frequencies {
            slope[at] = loads.ln_frequency[mode];
        }
        for part in &self.parts {
            let mut own = slope.rows_mut(part.first, part.by_length.len());
            own.axpy(loads.stretch[part.mode], &part.by_length, 1.0);
            for (&row, force) in change.rows().iter().zip(loads.forces.column(part.mode).iter()) {
                own.axpy(*force, &part.by_force.column(row), 1.0);
            }
        }
        slope
    }
}
