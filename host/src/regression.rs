//! What a number depends on: weighted least squares on several others at once.

use nalgebra::{DMatrix, DVector};

/// A dependence with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Slope {
    /// The slope.
    pub value: f64,
    /// Its standard deviation; with the scatter of the points about the line where that is more than they state.
    pub std: f64,
}

/// Least-squares slopes of `y` (with standard deviations) on centred regressors, all together; `None` where there are fewer
/// than two points more than unknowns, or the regressors do not vary independently.
pub(crate) fn slopes(y: &[f64], std: &[f64], regressors: &[Vec<f64>]) -> Option<Vec<Slope>> {
    let (points, unknowns) = (y.len(), regressors.len() + 1);
    if points < unknowns + 2 || std.iter().any(|std| !(std.is_finite() && *std > 0.0)) {
        return None;
    }
    let design = DMatrix::from_fn(points, unknowns, |row, column| {
        let value = if column == 0 {
            1.0
        } else {
            let all = &regressors[column - 1];
            all[row] - all.iter().sum::<f64>() / points as f64
        };
        value / std[row]
    });
    let whitened = DVector::from_fn(points, |row, _| y[row] / std[row]);
    let svd = design.clone().svd(true, true);
    let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
    // Scaled by each column's own length, so that units do not count.
    let lengths: Vec<f64> = (0..unknowns).map(|column| design.column(column).norm()).collect();
    if lengths.iter().any(|length| *length <= 0.0) || !(largest.is_finite() && smallest > 0.0) {
        return None;
    }
    let scaled = DMatrix::from_fn(points, unknowns, |row, column| design[(row, column)] / lengths[column]);
    let singular = scaled.singular_values();
    if singular.min() < 1e-3 * singular.max() {
        return None;
    }
    let solution = svd.solve(&whitened, 0.0).ok()?;
    let residual = (&design * &solution - whitened).norm_squared() / (points - unknowns) as f64;
    let covariance = (design.transpose() * &design).try_inverse()? * residual.max(1.0);
    let slope = |column: usize| Slope { value: solution[column], std: covariance[(column, column)].sqrt() };
    Some((1..unknowns).map(slope).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_dependences_are_told_apart_and_their_deviations_cover_the_scatter() {
        let temperature: Vec<f64> = (0..24).map(|hour| 15.0 + 5.0 * (0.26 * f64::from(hour)).sin()).collect();
        let level: Vec<f64> = (0..24).map(|hour| 0.3 * (1.7 * f64::from(hour)).cos()).collect();
        let noise = |hour: usize| 2e-4 * (12.9898 * hour as f64 * hour as f64).sin();
        let y: Vec<f64> = (0..24).map(|h| -2.0 - 3e-4 * temperature[h] - 4e-3 * level[h] + noise(h)).collect();
        let found = slopes(&y, &[1e-4; 24], &[temperature.clone(), level]).unwrap();
        assert!((found[0].value + 3e-4).abs() < 3.0 * found[0].std && found[0].std < 3e-5, "{found:?}");
        assert!((found[1].value + 4e-3).abs() < 3.0 * found[1].std && found[1].std < 5e-4, "{found:?}");
        // The points scatter more than they state.
        assert!(slopes(&y, &[1e-6; 24], std::slice::from_ref(&temperature)).unwrap()[0].std > 1e-6);
    }

    #[test]
    fn what_cannot_be_told_is_not_said() {
        let line: Vec<f64> = (0..10).map(f64::from).collect();
        assert_eq!(slopes(&line, &[1.0; 10], &[line.clone(), line.clone()]), None, "twins");
        assert_eq!(slopes(&line, &[1.0; 10], &[vec![3.0; 10]]), None, "no variation");
        assert_eq!(slopes(&line[..3], &[1.0; 3], &[line[..3].to_vec()]), None, "too few points");
        assert_eq!(slopes(&line, &[f64::INFINITY; 10], std::slice::from_ref(&line)), None);
    }
}
