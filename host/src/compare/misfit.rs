//! Where shapes differ, sensor by sensor.

use super::pairing::Pair;
use super::shape::scale;
use super::view::ModelView;
use crate::modes::MeasuredMode;

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
