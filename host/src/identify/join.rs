//! Joining setups' shapes at the points that they share, and what that does to their errors.
//!
//! Points and the setups' shapes flow in; the shape at all points, and how uncertain it is, flow out to `merge`.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::setup_mode::SetupMode;
use super::shape::{Shape, align};

/// Rounds of scaling setups to the mean of the references, and the mean to the setups.
const ROUNDS: usize = 20;

/// A measurement point of the merged shape.
pub(super) struct Point {
    pub(super) channel: String,
    pub(super) point: String,
    /// (setup, place among its kept channels).
    pub(super) places: Vec<(usize, usize)>,
    pub(super) reference: bool,
}

impl Point {
    /// Whether it brings setups together.
    fn joins(&self) -> bool {
        self.reference && self.places.len() > 1
    }
}

/// Points that bring setups together.
pub(super) fn references(points: &[Point]) -> impl Iterator<Item = &Point> {
    points.iter().filter(|point| point.joins())
}

/// The shape at all points, from that of each setup.
pub(super) fn joined(points: &[Point], shapes: &[Shape]) -> Shape {
    let scales = scales(points, shapes);
    let at = |point: &Point| {
        let sum: Complex64 = point.places.iter().map(|&(setup, place)| scales[setup] * shapes[setup][place]).sum();
        sum / point.places.len() as f64
    };
    Shape::from_iterator(points.len(), points.iter().map(at))
}

/// Variances of the components of a joined `shape`. With several setups, what a deviation of each component does to all others
/// through the setups' scales; the length and phase of the whole are free.
pub(super) fn variances(points: &[Point], estimates: &[&SetupMode], shapes: &[Shape], shape: &Shape) -> Vec<f64> {
    // Small enough for changes to be as straight as they can be told.
    const STEP: f64 = 1e-4;
    if let [mode] = estimates {
        // The points are the setup's channels.
        return mode.shape_std.iter().map(|std| std * std).collect();
    }
    let mut variances = vec![0.0; points.len()];
    for (setup, mode) in estimates.iter().enumerate() {
        for (place, &std) in mode.shape_std.iter().enumerate() {
            if !std.is_finite() {
                let is_of_it = |point: &Point| point.places.contains(&(setup, place));
                // With a reference that nothing is known of, nothing is known of the whole setup's scale.
                let is_reference = points.iter().any(|point| is_of_it(point) && point.joins());
                let is_of_setup = |point: &Point| point.places.iter().any(|(other, _)| *other == setup);
                for (variance, point) in variances.iter_mut().zip(points) {
                    if is_of_it(point) || (is_reference && is_of_setup(point)) {
                        *variance = std * std;
                    }
                }
                continue;
            }
            let mut changed = shapes.to_vec();
            changed[setup][place] += Complex64::from(STEP * std);
            let mut there = joined(points, &changed);
            align(&mut there, shape);
            for (variance, (there, here)) in variances.iter_mut().zip(there.iter().zip(shape.iter())) {
                *variance += (there - here).norm_sqr() / (STEP * STEP);
            }
        }
    }
    variances
}

/// What changes `of` each setup's shape, as each group of its windows makes, change in the real parts of a joined shape (points x changes
/// of all setups); `shape` has the scale and phase of the result.
pub(super) fn changes(
    points: &[Point],
    estimates: &[&SetupMode],
    shapes: &[Shape],
    shape: &Shape,
    of: impl Fn(&SetupMode) -> &DMatrix<f64>,
) -> DMatrix<f64> {
    let groups: usize = estimates.iter().map(|mode| of(mode).ncols()).sum();
    let mut all = DMatrix::zeros(points.len(), groups);
    let mut columns = all.column_iter_mut();
    for (setup, mode) in estimates.iter().enumerate() {
        for (change, mut column) in of(mode).column_iter().zip(&mut columns) {
            let mut changed = shapes.to_vec();
            for (component, by) in changed[setup].iter_mut().zip(change.iter()) {
                *component += Complex64::from(*by);
            }
            let mut there = joined(points, &changed);
            align(&mut there, shape);
            column
                .iter_mut()
                .zip(there.iter().zip(shape.iter()))
                .for_each(|(to, (there, here))| *to = (there - here).re);
        }
    }
    all
}

/// The factor by which each setup's shape is multiplied.
fn scales(points: &[Point], shapes: &[Shape]) -> Vec<Complex64> {
    let mut scales = vec![Complex64::ONE; shapes.len()];
    if shapes.len() == 1 {
        return scales;
    }
    let references: Vec<&Point> = references(points).collect();
    // Alternating least squares: references from the scaled setups, each setup's scale from the references.
    let mut values: Vec<Complex64> = references
        .iter()
        .map(|point| point.places.first().map_or(Complex64::ZERO, |&(setup, place)| shapes[setup][place]))
        .collect();
    for _ in 0..ROUNDS {
        for (setup, shape) in shapes.iter().enumerate() {
            let (mut product, mut norm) = (Complex64::ZERO, 0.0);
            for (point, value) in references.iter().zip(&values) {
                for &(_, place) in point.places.iter().filter(|(s, _)| *s == setup) {
                    product += shape[place].conj() * value;
                    norm += shape[place].norm_sqr();
                }
            }
            if norm > 0.0 {
                scales[setup] = product / norm;
            }
        }
        for (value, point) in values.iter_mut().zip(&references) {
            let sum: Complex64 = point.places.iter().map(|&(setup, place)| scales[setup] * shapes[setup][place]).sum();
            *value = sum / point.places.len() as f64;
        }
        // The common scale is free; without this it would shrink from round to round.
        let largest = values.iter().map(|value| value.norm()).fold(0.0, f64::max);
        if largest > 0.0 {
            values.iter_mut().for_each(|value| *value /= largest);
        }
    }
    scales
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::identify::curve::Curve;
    use crate::identify::resonance::{Quantity, Resonance};
    use crate::identify::scatter::GroupChanges;

    fn estimate(shape: Shape, shape_std: Vec<f64>) -> SetupMode {
        let resonance = Resonance { frequency_hz: 1.0, damping_ratio: 0.01, quantity: Quantity::Acceleration };
        let (frequency_std_hz, damping_std, peak_density, level) = (0.01, 0.001, 1.0, 1.0);
        SetupMode {
            resonance,
            shape,
            frequency_std_hz,
            damping_std,
            shape_std,
            peak_density,
            level,
            found: true,
            curve: Curve::default(),
            misfit: None,
            changes: GroupChanges::unknown(3),
            collinearity: 1.0,
            in_plane: false,
            shape_noise: 0.0,
            spacing_hz: 0.01,
        }
    }

    /// Two setups of three points each and a reference that hardly moves: the scatter of merged shapes is what is stated.
    #[test]
    fn a_weak_reference_makes_every_point_of_its_setup_uncertain() {
        let point = |name: &str, places: &[(usize, usize)]| Point {
            channel: name.to_owned(),
            point: name.to_owned(),
            places: places.to_vec(),
            reference: places.len() > 1,
        };
        let points = [
            point("reference", &[(0, 0), (1, 0)]),
            point("a", &[(0, 1)]),
            point("b", &[(0, 2)]),
            point("c", &[(1, 1)]),
            point("d", &[(1, 2)]),
        ];
        let truth = [vec![0.2, 1.0, -0.7], vec![0.2, 0.8, 0.5]];
        let std = 0.004;
        let shape = |values: &[f64]| Shape::from_iterator(3, values.iter().map(|&value| Complex64::from(value)));
        let exact = truth.each_ref().map(|values| shape(values));
        let whole = joined(&points, &exact);
        let estimates = exact.each_ref().map(|shape| estimate(shape.clone(), vec![std; 3]));
        let stated = variances(&points, &estimates.each_ref(), &exact, &whole);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut squares = [0.0; 5];
        const DRAWS: usize = 4000;
        for _ in 0..DRAWS {
            let drawn = truth.each_ref().map(|values| {
                let noisy = values.iter().map(|value| {
                    let noise: f64 = StandardNormal.sample(&mut random);
                    value + std * noise
                });
                shape(&noisy.collect::<Vec<_>>())
            });
            let mut there = joined(&points, &drawn);
            align(&mut there, &whole);
            for (square, (there, here)) in squares.iter_mut().zip(there.iter().zip(whole.iter())) {
                *square += (there - here).norm_sqr() / DRAWS as f64;
            }
        }
        for (stated, square) in stated.iter().zip(squares) {
            let ratio = (stated / square).sqrt();
            assert!((0.9..1.1).contains(&ratio), "{stated} stated, {square} drawn");
        }
        // The scale is uncertain by 3 %, so the setups' large components are.
        assert!(stated[1].sqrt() > 1.5 * std, "{}", stated[1].sqrt());
    }
}
