//! Mode shapes: comparing them, filtering one mode from its neighbours, and normalising.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// A mode shape at a setup's channels.
pub(super) type Shape = DVector<Complex64>;

/// Modal assurance criterion of two shapes: |a^H b|² / (a^H a · b^H b), from 0 to 1 (Allemang & Brown 1982).
pub fn mac(a: &DVector<Complex64>, b: &DVector<Complex64>) -> f64 {
    let norms = a.norm_squared() * b.norm_squared();
    if norms > 0.0 { a.dotc(b).norm_sqr() / norms } else { 0.0 }
}

/// Modal phase collinearity: 1 where all components share a line in the complex plane (Pappa, Elliott, Schenk 1993).
pub fn phase_collinearity(shape: &[Complex64]) -> f64 {
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for component in shape {
        xx += component.re * component.re;
        yy += component.im * component.im;
        xy += component.re * component.im;
    }
    let total = xx + yy;
    if total > 0.0 { ((xx - yy).powi(2) + 4.0 * xy * xy) / (total * total) } else { 0.0 }
}

/// Turns a shape so that its components lie as close to the real axis as they can, and scales its largest to 1.
pub(super) fn normalise(shape: &mut Shape) {
    // The best common phase is half that of the sum of squares.
    let squares: Complex64 = shape.iter().map(|component| component * component).sum();
    let turn = Complex64::cis(-squares.arg() / 2.0);
    let largest = shape.iter().copied().max_by(|a, b| a.norm_sqr().total_cmp(&b.norm_sqr()));
    let Some(largest) = largest.filter(|largest| largest.norm() > 0.0) else { return };
    let sign = if (largest * turn).re < 0.0 { -1.0 } else { 1.0 };
    let scale = turn * sign / largest.norm();
    for component in shape.iter_mut() {
        *component *= scale;
    }
}

/// A shape of unit length, and the factor on the mode's level that goes with it; `None` of nothing.
pub(super) fn of_unit_length(shape: Shape) -> Option<(Shape, f64)> {
    let length = shape.norm();
    (length.is_finite() && length > 0.0).then(|| (shape / Complex64::from(length), length * length))
}

/// Scales `shape` by the complex factor that brings it closest to `reference`.
pub(super) fn align(shape: &mut Shape, reference: &Shape) {
    let norm = shape.norm_squared();
    if norm > 0.0 {
        let factor = shape.dotc(reference) / norm;
        for component in shape.iter_mut() {
            *component *= factor;
        }
    }
}

/// The modal filter of the first of `shapes`: w with w^H shapes\[0\] = 1 and w^H shapes\[j\] = 0 for the others, of least length
/// (a column of the pseudo-inverse). `None` where the shapes are not independent.
pub(super) fn modal_filter(shapes: &[&Shape]) -> Option<Shape> {
    let first = shapes.first()?;
    let phi = DMatrix::from_fn(first.len(), shapes.len(), |row, column| shapes[column][row]);
    let gram = phi.adjoint() * &phi;
    let mut unit = DVector::zeros(shapes.len());
    unit[0] = Complex64::ONE;
    let solution = gram.cholesky()?.solve(&unit);
    Some(phi * solution)
}

/// w^H G w, the density of the filtered response.
pub(super) fn filtered(filter: &Shape, matrix: &DMatrix<Complex64>) -> f64 {
    filter.dotc(&(matrix * filter)).re.max(0.0)
}

/// An imaginary part so many of its standard deviations from zero is no scatter.
const NO_SCATTER: f64 = 3.0;

/// Shrinks imaginary parts by the share of them that is scatter (James and Stein 1961): a structure of little damping has
/// shapes that are nearly real, so phases that the data do not determine are noise. What stands out by itself, as of a channel whose clock
/// is late, stays as it is: shrunk with the others, it would be late by less.
pub(super) fn drop_scatter(shape: &mut Shape, imaginary_std: &[f64]) {
    let mut ordinary: Vec<(&mut Complex64, f64)> = shape
        .iter_mut()
        .zip(imaginary_std.iter().copied())
        .filter(|(component, std)| component.im.abs() < NO_SCATTER * std)
        .collect();
    let power: f64 = ordinary.iter().map(|(component, _)| component.im * component.im).sum();
    let scatter: f64 = ordinary.iter().map(|(_, std)| std * std).sum();
    if power > 0.0 && scatter.is_finite() {
        let kept = (1.0 - scatter / power).max(0.0);
        ordinary.iter_mut().for_each(|(component, _)| component.im *= kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(parts: &[(f64, f64)]) -> Shape {
        DVector::from_iterator(parts.len(), parts.iter().map(|&(re, im)| Complex64::new(re, im)))
    }

    #[test]
    fn the_mac_ignores_scale_and_phase_and_vanishes_for_orthogonal_shapes() {
        let a = shape(&[(1.0, 0.0), (0.5, 0.2), (-0.3, 0.0)]);
        assert!((mac(&a, &(a.clone() * Complex64::new(0.0, -3.0))) - 1.0).abs() < 1e-14);
        assert!(mac(&shape(&[(1.0, 0.0), (1.0, 0.0)]), &shape(&[(1.0, 0.0), (-1.0, 0.0)])).abs() < 1e-14);
    }

    #[test]
    fn collinearity_is_one_for_a_real_shape_at_any_phase_and_zero_for_a_travelling_wave() {
        let real = shape(&[(1.0, 0.0), (-0.4, 0.0), (0.7, 0.0)]) * Complex64::cis(0.7);
        assert!((phase_collinearity(real.as_slice()) - 1.0).abs() < 1e-14);
        let wave: Vec<Complex64> = (0..8).map(|n| Complex64::cis(std::f64::consts::TAU * f64::from(n) / 8.0)).collect();
        assert!(phase_collinearity(&wave) < 1e-14);
    }

    #[test]
    fn a_normalised_shape_has_the_largest_component_one_and_is_as_real_as_it_can_be() {
        let mut turned = shape(&[(0.2, 0.0), (-2.0, 0.0), (1.0, 0.0)]) * Complex64::cis(1.1);
        normalise(&mut turned);
        for (component, expected) in turned.iter().zip([-0.1, 1.0, -0.5]) {
            assert!((component - Complex64::from(expected)).norm() < 1e-14);
        }
    }

    #[test]
    fn scatter_goes_from_imaginary_parts_and_a_late_channel_keeps_its_own() {
        let mut noisy = shape(&[(1.0, 0.01), (-0.5, -0.02), (0.8, 0.01)]);
        drop_scatter(&mut noisy, &[0.02; 3]);
        assert!(noisy.iter().all(|component| component.im == 0.0));
        let mut late = shape(&[(1.0, 0.01), (-0.5, -0.02), (0.8, 0.1)]);
        drop_scatter(&mut late, &[0.02; 3]);
        assert!(late[2].im == 0.1 && late[0].im == 0.0 && late[1].im == 0.0, "{late}");
    }

    #[test]
    fn the_filter_passes_its_mode_and_stops_the_others() {
        let shapes = [shape(&[(1.0, 0.0), (0.8, 0.1), (0.1, 0.0)]), shape(&[(0.9, 0.0), (1.0, 0.0), (0.3, 0.0)])];
        let filter = modal_filter(&[&shapes[0], &shapes[1]]).unwrap();
        assert!((filter.dotc(&shapes[0]) - Complex64::ONE).norm() < 1e-12);
        assert!(filter.dotc(&shapes[1]).norm() < 1e-12);
        assert!(modal_filter(&[&shapes[0], &shapes[0]]).is_none_or(|filter| filter.norm() > 1e5));
    }
}
