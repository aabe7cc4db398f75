//! A model's shape beside a measured one: how alike they are, and the factor between them.
//!
//! The shapes need not be of one scale; the measured one stands at some of the sensors.

use crate::modes::MeasuredShape;

/// Modal assurance criterion of a model's shape (at all sensors) and a measured one (at some): the squared cosine of their
/// angle, 0 where either vanishes (Allemang and Brown 1982).
pub fn mac(model: &[f64], measured: &MeasuredShape) -> f64 {
    let (mut product, mut model_square, mut measured_square) = (0.0, 0.0, 0.0);
    for (&sensor, &value) in measured.sensors.iter().zip(measured.values.iter()) {
        let there = model.get(sensor).copied().unwrap_or(0.0);
        product += there * value;
        model_square += there * there;
        measured_square += value * value;
    }
    let squares = model_square * measured_square;
    if squares > 0.0 { (product * product / squares).min(1.0) } else { 0.0 }
}

/// The factor that brings a model's shape nearest to a measured one: least squares over the measured components.
pub(crate) fn scale(model: &[f64], measured: &MeasuredShape) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for (&sensor, &value) in measured.sensors.iter().zip(measured.values.iter()) {
        let there = model.get(sensor).copied().unwrap_or(0.0);
        product += there * value;
        square += there * there;
    }
    if square > 0.0 { product / square } else { 0.0 }
}
