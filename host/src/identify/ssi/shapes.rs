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
