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

/// A MAC in words: four digits, never rounded up, so that only a perfect one reads 1.0000.
pub(crate) fn mac_words(mac: f64) -> String {
    format!("{:.4}", (mac * 1e4).floor() / 1e4)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mac_is_never_rounded_up() {
        assert_eq!([1.0, 0.999_99, 0.999_94, 0.5].map(mac_words), ["1.0000", "0.9999", "0.9999", "0.5000"]);
    }
}
