//! The difference of paired modes as one vector with its covariance, and what a chi-squared test says of it.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::Serialize;
use statrs::distribution::{ChiSquared as Distribution, ContinuousCDF};

use super::tolerance::Tolerance;
use super::{ModelView, Pair, frequency_deviation, scale, shape_deviations};
use crate::measured::{MeasuredMode, MeasuredShape};
use crate::model::derivatives;

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
/// sensitivities of y to every segment's stiffness and mass. `None` without pairs, or where that covariance is none.
pub fn chi_squared(
    view: &ModelView,
    measured: &[MeasuredMode],
    pairs: &[Pair],
    tolerance: Option<&Tolerance>,
) -> Option<ChiSquared> {
    let blocks: Vec<Block> =
        pairs.iter().filter_map(|pair| Block::of(view, measured.get(pair.measured)?, pair)).collect();
    let size = blocks.iter().map(Block::size).sum::<usize>();
    if size == 0 {
        return None;
    }
    let mut residual = DVector::zeros(size);
    let mut covariance = DMatrix::zeros(size, size);
    let mut first = 0;
    for block in &blocks {
        residual.rows_mut(first, block.size()).copy_from(&block.residual);
        covariance.view_mut((first, first), (block.size(), block.size())).copy_from(&block.covariance);
        first += block.size();
    }
    if let Some(tolerance) = tolerance {
        let sensitivities = sensitivities(view, &blocks, tolerance, size);
        covariance += &sensitivities * &tolerance.covariance * sensitivities.transpose();
    }
    let factor = Cholesky::new(covariance)?;
    let chi_squared = factor.l_dirty().solve_lower_triangular(&residual)?.norm_squared();
    let distribution = Distribution::new(size as f64).ok()?;
    Some(ChiSquared { chi_squared, degrees_of_freedom: size, p_value: distribution.sf(chi_squared) })
}

/// G, residual x changes.
fn sensitivities(view: &ModelView, blocks: &[Block], tolerance: &Tolerance, size: usize) -> DMatrix<f64> {
    let sensor_vectors = &view.sensor_rows * &view.basis.vectors;
    let modes: Vec<usize> = blocks.iter().map(|block| block.model).collect();
    let mut sensitivities = DMatrix::zeros(size, tolerance.changes.len());
    for (mut column, change) in sensitivities.column_iter_mut().zip(&tolerance.changes) {
        let mut first = 0;
        for (block, derivative) in blocks.iter().zip(derivatives(&view.basis, &sensor_vectors, &modes, change)) {
            column[first] = derivative.ln_frequency;
            if let Some(shape) = &block.shape {
                let there = derivative.shape.select_rows(&shape.sensors);
                column.rows_mut(first + 1, block.size() - 1).copy_from(&shape.slope(&there));
            }
            first += block.size();
        }
    }
    sensitivities
}

/// One pair's part of the residual.
struct Block {
    model: usize,
    residual: DVector<f64>,
    covariance: DMatrix<f64>,
    shape: Option<ShapeBlock>,
}

struct ShapeBlock {
    sensors: Vec<usize>,
    /// The model's shape there.
    model: DVector<f64>,
    /// The measured shape, of unit length.
    measured: DVector<f64>,
    /// Orthogonal complement of the measured shape, components x (components - 1).
    complement: DMatrix<f64>,
}

impl Block {
    fn of(view: &ModelView, mode: &MeasuredMode, pair: &Pair) -> Option<Self> {
        let difference = (view.modes.frequency_hz.get(pair.model)? / mode.frequency_hz).ln();
        let shape = mode.shape.as_ref().filter(|shape| shape.sensors.len() > 1);
        let shape = shape.and_then(|shape| Some((ShapeBlock::of(view.shape(pair.model), shape)?, shape)));
        let size = 1 + shape.as_ref().map_or(0, |(block, _)| block.complement.ncols());
        let mut residual = DVector::zeros(size);
        let mut covariance = DMatrix::zeros(size, size);
        residual[0] = difference;
        covariance[(0, 0)] = frequency_deviation(mode).powi(2);
        if let Some((block, shape)) = &shape {
            residual.rows_mut(1, size - 1).copy_from(&block.difference());
            let variances = DVector::from_iterator(
                shape.sensors.len(),
                shape_deviations(shape).into_iter().map(|deviation| deviation * deviation),
            );
            let projected = block.complement.transpose() * DMatrix::from_diagonal(&variances) * &block.complement;
            covariance.view_mut((1, 1), (size - 1, size - 1)).copy_from(&projected);
        }
        Some(Self { model: pair.model, residual, covariance, shape: shape.map(|(block, _)| block) })
    }

    fn size(&self) -> usize {
        self.residual.len()
    }
}

impl ShapeBlock {
    fn of(model: &[f64], shape: &MeasuredShape) -> Option<Self> {
        let there: Option<Vec<f64>> = shape.sensors.iter().map(|&sensor| model.get(sensor).copied()).collect();
        let there = DVector::from_vec(there?);
        // A model mode that no sensor sees has no shape to compare.
        (there.norm_squared() > 0.0).then_some(())?;
        let measured = shape.values.normalize();
        let complement = complement(&measured);
        Some(Self { sensors: shape.sensors.clone(), model: there, measured, complement })
    }

    /// a = phiᵀ phihat / phiᵀ phi.
    fn factor(&self) -> f64 {
        self.model.dot(&self.measured) / self.model.norm_squared()
    }

    /// Qᵀ (a phi - phihat); Qᵀ phihat is zero.
    fn difference(&self) -> DVector<f64> {
        self.complement.tr_mul(&self.model) * self.factor()
    }

    /// Change of [`ShapeBlock::difference`] with a change of the model's shape, a moving along.
    fn slope(&self, change: &DVector<f64>) -> DVector<f64> {
        let square = self.model.norm_squared();
        let factor = self.factor();
        let factor_change = (change.dot(&self.measured) - 2.0 * factor * self.model.dot(change)) / square;
        self.complement.tr_mul(&(change * factor + &self.model * factor_change))
    }
}

/// An orthonormal basis of what is orthogonal to a unit vector: the last columns of a Householder reflection.
fn complement(unit: &DVector<f64>) -> DMatrix<f64> {
    let size = unit.len();
    let mut normal = unit.clone();
    // Away from cancellation.
    normal[0] += if normal[0] < 0.0 { -1.0 } else { 1.0 };
    let square = normal.norm_squared();
    let reflection = DMatrix::identity(size, size) - &normal * normal.transpose() * (2.0 / square);
    reflection.columns(1, size - 1).into_owned()
}

/// Root mean square over pairs, sensor by sensor, of `(a phi - phihat)` in shares of the RMS component of phihat; `None`
/// at sensors where no paired shape is known.
pub(super) fn misfit_by_sensor(
    view: &ModelView,
    measured: &[MeasuredMode],
    pairs: &[Pair],
    sensors: usize,
) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0usize); sensors];
    for pair in pairs {
        let Some(shape) = measured.get(pair.measured).and_then(|mode| mode.shape.as_ref()) else { continue };
        let model = view.shape(pair.model);
        let factor = scale(model, shape);
        let mean_square = shape.values.norm_squared() / shape.values.len() as f64;
        for (&sensor, &value) in shape.sensors.iter().zip(shape.values.iter()) {
            if let (Some(sum), Some(there)) = (sums.get_mut(sensor), model.get(sensor)) {
                sum.0 += (factor * there - value).powi(2) / mean_square;
                sum.1 += 1;
            }
        }
    }
    sums.into_iter().map(|(sum, count)| (count > 0).then(|| (sum / count as f64).sqrt())).collect()
}

/// Coordinate MAC of each sensor over the pairs (Lieven and Ewins 1988); model shapes are first brought to the scale of
/// the measured ones.
pub(super) fn comac(view: &ModelView, measured: &[MeasuredMode], pairs: &[Pair], sensors: usize) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0.0, 0.0); sensors];
    for pair in pairs {
        let Some(shape) = measured.get(pair.measured).and_then(|mode| mode.shape.as_ref()) else { continue };
        let model = view.shape(pair.model);
        let factor = scale(model, shape);
        let length = shape.values.norm();
        for (&sensor, &value) in shape.sensors.iter().zip(shape.values.iter()) {
            if let (Some(sum), Some(there)) = (sums.get_mut(sensor), model.get(sensor)) {
                let (there, value) = (factor * there / length, value / length);
                *sum = (sum.0 + (there * value).abs(), sum.1 + there * there, sum.2 + value * value);
            }
        }
    }
    let ratio = |(product, model, measured): (f64, f64, f64)| {
        (model * measured > 0.0).then(|| (product * product / (model * measured)).min(1.0))
    };
    sums.into_iter().map(ratio).collect()
}
