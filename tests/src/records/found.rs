//! A mode as `belfry identify` found it, and how like a true one its shape is.

use nalgebra::{Complex, DVector};
use serde_json::Value;

/// A mode as it was found.
pub(super) struct Found {
    pub(super) frequency_hz: f64,
    pub(super) frequency_std_hz: f64,
    pub(super) damping_ratio: f64,
    pub(super) damping_ratio_std: f64,
    /// By the structure's channel, counted from 0: value and standard deviation, NaN where that is null, as all deviations here.
    pub(super) shape: Vec<(usize, Complex<f64>, f64)>,
    /// How its errors are correlated.
    pub(super) scatter: Value,
    /// Whether it is told as one of a pair of which only the plane is known.
    pub(super) is_paired: bool,
}

impl Found {
    pub(super) fn of(mode: &Value) -> Self {
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let part = |part: &Value| {
            let channel = part["point"].as_str()?.parse::<usize>().ok()?.checked_sub(1)?;
            Some((channel, Complex::new(part["re"].as_f64()?, part["im"].as_f64()?), number(&part["std"])))
        };
        Self {
            frequency_hz: number(&mode["frequency_hz"]),
            frequency_std_hz: number(&mode["frequency_std_hz"]),
            damping_ratio: number(&mode["damping_ratio"]),
            damping_ratio_std: number(&mode["damping_ratio_std"]),
            shape: mode["shape"].as_array().into_iter().flatten().filter_map(part).collect(),
            scatter: mode["covariance_factor"].clone(),
            is_paired: !mode["pair_with"].is_null(),
        }
    }

    /// The true shape at the channels that were kept, of the length and phase of the estimate (least squares).
    pub(super) fn truth(&self, truth: &DVector<f64>) -> Vec<Complex<f64>> {
        let power: f64 = self.shape.iter().map(|(channel, _, _)| truth[*channel].powi(2)).sum();
        let along: Complex<f64> = self.shape.iter().map(|(channel, value, _)| value * truth[*channel]).sum();
        self.shape.iter().map(|(channel, _, _)| along / power * truth[*channel]).collect()
    }

    pub(super) fn mac(&self, truth: &DVector<f64>) -> f64 {
        let inside: f64 = self.truth(truth).iter().map(|value| value.norm_sqr()).sum();
        let whole: f64 = self.shape.iter().map(|(_, value, _)| value.norm_sqr()).sum();
        if whole > 0.0 { inside / whole } else { 0.0 }
    }

    /// The share of the shape that lies in the plane of two true ones.
    pub(super) fn in_plane(&self, one: &DVector<f64>, other: &DVector<f64>) -> f64 {
        let at_channels = |shape: &DVector<f64>| {
            DVector::from_iterator(self.shape.len(), self.shape.iter().map(|(channel, _, _)| shape[*channel]))
        };
        let (one, other) = (at_channels(one).normalize(), at_channels(other));
        let other = (&other - &one * one.dot(&other)).normalize();
        let along = |direction: &DVector<f64>| {
            self.shape.iter().zip(direction.iter()).map(|((_, value, _), part)| value * *part).sum::<Complex<f64>>()
        };
        let whole: f64 = self.shape.iter().map(|(_, value, _)| value.norm_sqr()).sum();
        if whole > 0.0 { (along(&one).norm_sqr() + along(&other).norm_sqr()) / whole } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// A mode with these components of its shape, by point counted from 1, turned by a phase of 90 degrees as a whole.
    fn found(parts: &[(usize, f64)]) -> Found {
        let part =
            |(point, value): &(usize, f64)| json!({"point": point.to_string(), "re": 0.0, "im": value, "std": 0.1});
        Found::of(&json!({"frequency_hz": 1.0, "shape": parts.iter().map(part).collect::<Vec<_>>()}))
    }

    fn shape(parts: &[f64]) -> DVector<f64> {
        DVector::from_column_slice(parts)
    }

    #[test]
    fn the_mac_is_the_squared_cosine_whatever_the_phase_and_the_order_of_points() {
        // Of (3, 4) to the first axis: 9 / 25.
        assert!((found(&[(1, 3.0), (2, 4.0)]).mac(&shape(&[2.0, 0.0])) - 0.36).abs() < 1e-12);
        // Point 2 was not kept, and point 3 comes first: (1, 2) against (1, 2).
        assert!((found(&[(3, 2.0), (1, 1.0)]).mac(&shape(&[-1.0, 7.0, -2.0])) - 1.0).abs() < 1e-12);
        assert_eq!(found(&[]).mac(&shape(&[1.0])), 0.0);
    }

    #[test]
    fn the_true_shape_gets_the_length_and_phase_of_the_estimate() {
        // The factor is i (3 · 2 + 4 · 1) / (4 + 1) = 2i.
        let truth = found(&[(1, 3.0), (2, 4.0)]).truth(&shape(&[2.0, 1.0]));
        let exact = [Complex::new(0.0, 4.0), Complex::new(0.0, 2.0)];
        assert!(truth.iter().zip(exact).all(|(truth, exact)| (truth - exact).norm() < 1e-12), "{truth:?}");
    }

    #[test]
    fn the_share_in_a_plane_needs_no_orthogonal_shapes() {
        let mode = found(&[(1, 1.0), (2, 2.0), (3, 2.0)]);
        // The plane of the first two axes holds 1 + 4 of 9.
        let (one, other) = (shape(&[1.0, 0.0, 0.0]), shape(&[5.0, 1.0, 0.0]));
        assert!((mode.in_plane(&one, &other) - 5.0 / 9.0).abs() < 1e-12);
        assert!((mode.in_plane(&other, &one) - 5.0 / 9.0).abs() < 1e-12);
        // A plane that the shape lies in.
        assert!((mode.in_plane(&shape(&[0.0, 1.0, 1.0]), &one) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_component_of_unknown_deviation_is_kept() {
        let part = |point: &str, std: Value| json!({"point": point, "re": 1.0, "im": 0.0, "std": std});
        let mode =
            Found::of(&json!({"frequency_std_hz": null, "shape": [part("1", json!(0.1)), part("2", Value::Null)]}));
        assert_eq!(mode.shape.len(), 2);
        assert!(mode.shape[1].2.is_nan() && mode.frequency_std_hz.is_nan());
        // (1, 1) against (1, 0); without the second component it would be 1.
        assert!((mode.mac(&shape(&[1.0, 0.0])) - 0.5).abs() < 1e-12);
    }
}
