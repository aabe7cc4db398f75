//! What the subspace's shapes say of the deviations of the fit's.
//!
//! A mode and the pole that is its own flow in; where the two shapes differ by more than chance, the mode flows out with that difference
//! in its deviations, as those of frequencies and damping ratios hold it.

use super::likeness::{component_of_mut, shape_in};
use super::stabilisation::StablePole;
use crate::identify::result::Mode;
use crate::identify::setup::MeasuredSetup;

/// Shapes differ where the mean square of their differences, in the subspace's standard deviations, is more than this.
const DIFFERENT: f64 = 4.0;

/// Widens a mode's shape by how far it is from the shape of its pole in a setup.
pub(super) fn hold_difference(measured: &MeasuredSetup<'_>, mode: &mut Mode, pole: &StablePole) {
    let Some(shape) = shape_in(measured, mode) else { return };
    let scale = pole.shape.dotc(&shape) / pole.shape.norm_squared();
    // Of each component: how far it is off, squared, and how far chance takes it.
    let squares: Vec<[f64; 2]> = shape
        .iter()
        .zip(pole.shape.iter().zip(&pole.shape_std))
        .map(|(own, (other, std))| [(own - scale * other).re.powi(2), (scale.norm() * std).powi(2)])
        .collect();
    let ratios = || squares.iter().map(|[square, chance]| square / chance).filter(|ratio| ratio.is_finite());
    let mean = ratios().sum::<f64>() / ratios().count().max(1) as f64;
    if mean <= DIFFERENT {
        return;
    }
    for (&channel, [square, chance]) in measured.spectrum.channels().iter().zip(squares) {
        let sensor = measured.setup.sensors.get(channel);
        let component = sensor.and_then(|sensor| component_of_mut(&mut mode.shape, &measured.setup.name, sensor));
        if let Some(component) = component {
            component.std = component.std.hypot((square - chance).max(0.0).sqrt());
        }
    }
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;
    use crate::identify::identify;
    use crate::identify::plane::tests::{recorded, two_modes};
    use crate::identify::shape::Shape;
    use crate::simulate::modal::{points, setup};
    use crate::study::ModeChoice;

    #[test]
    fn a_shape_that_the_subspace_contradicts_is_uncertain_by_the_difference_where_they_differ() {
        let truth = two_modes(0.53);
        let setup = setup("one", &points(8), &[]);
        let measured = MeasuredSetup { setup: &setup, spectrum: recorded(&truth, 1) };
        let mode = identify(std::slice::from_ref(&measured), &ModeChoice::default()).unwrap().modes.remove(0);
        let shape = shape_in(&measured, &mode).unwrap();
        // Where it moves least, so that the scale takes next to nothing of the difference.
        let least = shape.map(|part| part.norm()).imin();
        let with = |off: f64, std: f64| {
            let mut theirs = shape.clone();
            theirs[least] += off;
            let pole = StablePole {
                order: 8,
                orders: vec![6, 8],
                frequency_hz: mode.frequency_hz,
                frequency_std_hz: 1e-4,
                damping_ratio: 0.01,
                damping_ratio_std: 1e-3,
                // In another phase, and of another size.
                shape: Shape::from_iterator(8, theirs.iter().map(|part| part * Complex64::new(0.0, -2.0))),
                shape_std: vec![2.0 * std; 8],
                power: 1.0,
                share: 1.0,
            };
            let mut held = mode.clone();
            hold_difference(&measured, &mut held, &pole);
            held.shape.iter().map(|part| part.std).collect::<Vec<f64>>()
        };
        let before: Vec<f64> = mode.shape.iter().map(|part| part.std).collect();
        assert_eq!(with(0.2, 0.1), before, "chance explains it");
        let after = with(0.2, 0.01);
        assert!((after[least] / before[least].hypot(0.2) - 1.0).abs() < 0.1, "{after:?} {before:?}");
        assert!((0..8).filter(|&at| at != least).all(|at| after[at] < 0.05), "{after:?}");
    }
}
