//! The difference of paired modes as one vector with its covariance, and its chi-squared test.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::Serialize;
use statrs::distribution::{ChiSquared as Distribution, ContinuousCDF};

use super::deviation::Errors;
use super::pairing::{Pair, RANK_TOLERANCE, close_models};
use super::tolerance::Tolerance;
use super::view::ModelView;
use crate::model::ModeDerivative;
use crate::modes::{MeasuredMode, MeasuredShape};

/// A chi-squared test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChiSquared {
    /// Squared length of the whitened residual.
    pub chi_squared: f64,
    /// Numbers compared.
    pub degrees_of_freedom: usize,
    /// Probability of so large a value, or a larger one, where only measurement and tolerance err.
    pub p_value: f64,
}

/// The residual `y = [ln f_model - ln f ; Qᵀ (a phi - phihat)]` of each pair, phihat of unit length, Q its orthogonal
/// complement, a least squares; held against the covariance of the measurement plus, with a tolerance, `G Q_b Gᵀ`, G the
/// sensitivities of y to every segment's stiffness and mass. `None` without pairs, or where that covariance is not positive definite.
///
/// Close modes turn within their span at the slightest change, so a shape among them is held to the span:
/// `Nᵀ (B c - phihat)` with B the close model shapes, c least squares, and N the orthogonal complement of B.
pub fn chi_squared(
    view: &ModelView,
    measured: &[MeasuredMode],
    pairs: &[Pair],
    tolerance: Option<&Tolerance>,
) -> Option<ChiSquared> {
    let residual = Residual::of(view, measured, pairs, &|pair| close_models(view, pairs, pair.model));
    let size = residual.size();
    if size == 0 {
        return None;
    }
    let mut covariance = DMatrix::zeros(size, size);
    for (first, block) in residual.blocks() {
        covariance.view_mut((first, first), (block.size(), block.size())).copy_from(&block.covariance);
        for (other_first, other) in residual.blocks().filter(|(other_first, _)| *other_first != first) {
            if block.group.is_some() && block.group == other.group && block.joint.ncols() == other.joint.ncols() {
                let between = &block.joint * other.joint.transpose();
                covariance.view_mut((first, other_first), (block.size(), other.size())).copy_from(&between);
            }
        }
    }
    if let Some(tolerance) = tolerance {
        let sensitivities = sensitivities(view, &residual, tolerance);
        covariance += &sensitivities * &tolerance.covariance * sensitivities.transpose();
    }
    let factor = Cholesky::new(covariance)?;
    let chi_squared = factor.l_dirty().solve_lower_triangular(&residual.vector())?.norm_squared();
    Some(ChiSquared::of(chi_squared, size))
}

impl ChiSquared {
    /// The test of a squared length.
    pub(crate) fn of(chi_squared: f64, degrees_of_freedom: usize) -> Self {
        Self { chi_squared, degrees_of_freedom, p_value: exceeding(chi_squared, degrees_of_freedom as f64) }
    }
}

/// Probability that a chi-squared number exceeds a value; 1 where no numbers were compared, which say nothing.
pub(crate) fn exceeding(chi_squared: f64, degrees_of_freedom: f64) -> f64 {
    Distribution::new(degrees_of_freedom).map_or(1.0, |distribution| distribution.sf(chi_squared))
}

/// G, residual x changes.
fn sensitivities(view: &ModelView, residual: &Residual, tolerance: &Tolerance) -> DMatrix<f64> {
    let models = residual.models();
    let responses = view.responses(&models);
    let mut sensitivities = DMatrix::zeros(residual.size(), tolerance.changes.len());
    for (mut column, change) in sensitivities.column_iter_mut().zip(&tolerance.changes) {
        column.copy_from(&residual.slope(&models, &view.derivatives(&responses, &models, change)));
    }
    sensitivities
}

/// The differences of paired modes, block by block.
pub(crate) struct Residual {
    blocks: Vec<Block>,
}

impl Residual {
    /// `partners` says which of the model's modes span a measured shape: the paired one, and those close to it.
    pub(crate) fn of(
        view: &ModelView,
        measured: &[MeasuredMode],
        pairs: &[Pair],
        partners: &dyn Fn(&Pair) -> Vec<usize>,
    ) -> Self {
        let block = |pair: &Pair| Block::of(view, measured.get(pair.measured)?, pair, partners(pair));
        Self { blocks: pairs.iter().filter_map(block).collect() }
    }

    /// Each block with the place of its first number.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = (usize, &Block)> {
        self.blocks.iter().scan(0, |first, block| {
            let start = *first;
            *first += block.size();
            Some((start, block))
        })
    }

    /// The block of a measured mode, with the place of its first number.
    pub(crate) fn block_of(&self, measured: usize) -> Option<(usize, &Block)> {
        self.blocks().find(|(_, block)| block.measured == measured)
    }

    /// Adds to the differences of ln f, a number for each block.
    pub(crate) fn shift_frequencies(&mut self, by: &DVector<f64>) {
        for (block, by) in self.blocks.iter_mut().zip(by.iter()) {
            block.residual[0] += by;
        }
    }

    /// Notes what sections that rack as far as they turn would add to shapes of unit length, sensors x measured modes.
    pub(crate) fn note_racking(&mut self, racking: &DMatrix<f64>) {
        for block in &mut self.blocks {
            let along = |shape: &ShapeBlock| {
                let there = racking.column(block.measured).select_rows(&shape.sensors);
                (there.norm_squared() > 0.0).then(|| shape.directions.tr_mul(&there).insert_row(0, 0.0))
            };
            block.racked = block.shape.as_ref().and_then(along);
        }
    }

    /// Numbers compared.
    pub(crate) fn size(&self) -> usize {
        self.blocks.iter().map(Block::size).sum()
    }

    /// All differences.
    pub(crate) fn vector(&self) -> DVector<f64> {
        let mut vector = DVector::zeros(self.size());
        for (first, block) in self.blocks() {
            vector.rows_mut(first, block.size()).copy_from(&block.residual);
        }
        vector
    }

    /// The model's modes that the differences depend on, ascending.
    pub(crate) fn models(&self) -> Vec<usize> {
        let mut models: Vec<usize> = self.blocks.iter().flat_map(|block| block.models().iter().copied()).collect();
        models.sort_unstable();
        models.dedup();
        models
    }

    /// How the differences follow a change of the model's modes as they are recorded; `derivatives` belong to `models`.
    pub(crate) fn slope(&self, models: &[usize], derivatives: &[ModeDerivative]) -> DVector<f64> {
        let derivative = |model: &usize| models.binary_search(model).ok().and_then(|index| derivatives.get(index));
        let mut slope = DVector::zeros(self.size());
        for (first, block) in self.blocks() {
            slope[first] = derivative(&block.model).map_or(0.0, |derivative| derivative.ln_frequency);
            if let Some(shape) = &block.shape {
                let changes: Vec<&DVector<f64>> =
                    shape.models.iter().filter_map(derivative).map(|derivative| &derivative.shape).collect();
                let there = DMatrix::from_fn(shape.sensors.len(), changes.len(), |row, model| {
                    changes[model][shape.sensors[row]]
                });
                slope.rows_mut(first + 1, block.size() - 1).copy_from(&shape.slope(&there));
            }
        }
        slope
    }
}

/// One pair's part of the residual.
pub(crate) struct Block {
    /// The measured mode.
    pub(crate) measured: usize,
    /// The model's mode.
    pub(crate) model: usize,
    /// The difference of ln f, then those of the shape.
    pub(crate) residual: DVector<f64>,
    /// Its covariance by the measurement's deviations.
    pub(crate) covariance: DMatrix<f64>,
    /// Rows whose products with those of another block of the same group are the covariances with it.
    joint: DMatrix<f64>,
    group: Option<usize>,
    /// The shape, where it is compared.
    pub(crate) shape: Option<ShapeBlock>,
    /// What sections that rack as far as they turn would add to the difference, once that is noted; `None` where it is nothing.
    pub(crate) racked: Option<DVector<f64>>,
}

/// A measured shape against the model's, or against the span of several close ones.
pub(crate) struct ShapeBlock {
    /// Indices of its sensors.
    pub(crate) sensors: Vec<usize>,
    /// The model's modes, one but for close modes.
    pub(crate) models: Vec<usize>,
    /// Their shapes at the sensors, sensors x models.
    shapes: DMatrix<f64>,
    /// The combination of them that is nearest to the measured shape.
    pub(crate) combination: DVector<f64>,
    /// The measured shape, of unit length.
    measured: DVector<f64>,
    /// Orthonormal directions in which the difference counts, sensors x directions: the complement of the measured shape,
    /// or of the span of several shapes.
    pub(crate) directions: DMatrix<f64>,
}

impl Block {
    fn of(view: &ModelView, mode: &MeasuredMode, pair: &Pair, partners: Vec<usize>) -> Option<Self> {
        let difference = (view.modes.frequency_hz.get(pair.model)? / mode.frequency_hz).ln();
        let shape = mode.shape.as_ref();
        let shape = shape.and_then(|shape| Some((ShapeBlock::of(view, partners, shape)?, shape)));
        let size = 1 + shape.as_ref().map_or(0, |(block, _)| block.directions.ncols());
        let mut residual = DVector::zeros(size);
        residual[0] = difference;
        let errors = Errors::of(mode, shape.as_ref().map(|(_, shape)| *shape));
        // What is compared of frequency and shape: the frequency, and the shape's directions.
        let mut compared = DMatrix::zeros(size, errors.own.len());
        compared[(0, 0)] = 1.0;
        if let Some((block, _)) = &shape {
            residual.rows_mut(1, size - 1).copy_from(&block.difference());
            compared.view_mut((1, 1), (size - 1, errors.own.len() - 1)).copy_from(&block.directions.transpose());
        }
        let joint = &compared * &errors.joint;
        let own = &compared * DMatrix::from_diagonal(&errors.own) * compared.transpose();
        let group = mode.covariance_factor.as_ref().map(|factor| factor.group);
        let covariance = own + &joint * joint.transpose();
        let (measured, model) = (pair.measured, pair.model);
        Some(Self {
            measured,
            model,
            residual,
            covariance,
            joint,
            group,
            shape: shape.map(|(block, _)| block),
            racked: None,
        })
    }

    pub(crate) fn size(&self) -> usize {
        self.residual.len()
    }

    /// Indices of the sensors that see the shape; none where it is not compared.
    pub(crate) fn sensors(&self) -> &[usize] {
        self.shape.as_ref().map_or(&[], |shape| &shape.sensors)
    }

    /// The model's modes that the block depends on.
    pub(crate) fn models(&self) -> &[usize] {
        self.shape.as_ref().map_or(std::slice::from_ref(&self.model), |shape| &shape.models)
    }
}

impl ShapeBlock {
    /// `None` where the model's shapes leave nothing to compare: no sensor sees them, or too few sensors separate them.
    fn of(view: &ModelView, models: Vec<usize>, shape: &MeasuredShape) -> Option<Self> {
        if shape.sensors.iter().any(|&sensor| sensor >= view.at_sensors.nrows()) {
            return None;
        }
        let shapes = view.at_sensors.select_rows(&shape.sensors).select_columns(&models);
        let measured = shape.values.normalize();
        let decomposition = shapes.clone().svd(true, true);
        let greatest = decomposition.singular_values.iter().copied().fold(0.0, f64::max);
        let told_apart = decomposition.singular_values.iter().all(|&value| value > RANK_TOLERANCE * greatest);
        (told_apart && models.len() < shape.sensors.len()).then_some(())?;
        let combination = decomposition.solve(&measured, 0.0).ok()?;
        let directions = match models.len() {
            1 => complement(&DMatrix::from_column_slice(measured.len(), 1, measured.as_slice()))?,
            _ => complement(&shapes)?,
        };
        Some(Self { sensors: shape.sensors.clone(), models, shapes, combination, measured, directions })
    }

    /// The model's shape at the sensors that is nearest to the measured one, which is of unit length.
    pub(crate) fn nearest(&self) -> DVector<f64> {
        &self.shapes * &self.combination
    }

    /// How much of the measured shape is in the span of the model's: the MAC of the two where that is a single mode.
    pub(crate) fn likeness(&self) -> f64 {
        self.nearest().norm_squared()
    }

    /// The largest component of the measured shape, which is of unit length.
    pub(crate) fn largest(&self) -> f64 {
        self.measured.amax()
    }

    fn difference(&self) -> DVector<f64> {
        self.directions.tr_mul(&(self.nearest() - &self.measured))
    }

    /// How the difference follows the shape of one of the model's modes at all sensors, directions x sensors.
    pub(super) fn by_shape(&self, index: usize, sensors: usize) -> DMatrix<f64> {
        let mut whole = DMatrix::zeros(self.directions.ncols(), sensors);
        for (at, &sensor) in self.sensors.iter().enumerate() {
            let mut change = DMatrix::zeros(self.sensors.len(), self.models.len());
            change[(at, index)] = 1.0;
            whole.set_column(sensor, &self.slope(&change));
        }
        whole
    }

    /// How the difference follows a change of the model's shapes at the sensors (sensors x models).
    fn slope(&self, change: &DMatrix<f64>) -> DVector<f64> {
        let moved = change * &self.combination;
        if self.models.len() > 1 {
            // N moves with the shapes so that Nᵀ B stays zero; what is left is Nᵀ dB c.
            return self.directions.tr_mul(&moved);
        }
        // a = phiᵀ phihat / phiᵀ phi
        let (model, factor) = (self.shapes.column(0), self.combination[0]);
        let change = change.column(0);
        let factor_change = (change.dot(&self.measured) - 2.0 * factor * model.dot(&change)) / model.norm_squared();
        self.directions.tr_mul(&(moved + model * factor_change))
    }
}

/// An orthonormal basis of what is orthogonal to independent columns; `None` where there are more of them than rows.
pub(crate) fn complement(columns: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (size, count) = columns.shape();
    let outside = size.checked_sub(count)?;
    // The last columns of a whole Q.
    let mut transposed = DMatrix::identity(size, size);
    columns.clone().qr().q_tr_mul(&mut transposed);
    Some(transposed.rows(count, outside).transpose())
}
