//! Statistics that the studies share.

/// Root mean square of the finite ones; NaN where there are none.
pub(crate) fn rms(values: &[f64]) -> f64 {
    let finite = values.iter().filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (sum / f64::from(count)).sqrt()
}
