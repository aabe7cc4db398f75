//! Whether a mode and a pole move alike.
//!
//! A mode of all setups flows in; its shape at the channels of one flows out.

use crate::identify::result::{Mode, ShapeComponent};
use crate::identify::setup::MeasuredSetup;
use crate::identify::shape::Shape;
use crate::study::Sensor;

/// A pole near a mode may be its own with at least this MAC.
pub(super) const NEAR_MAC: f64 = 0.5;

/// A mode's shape at a setup's channels; `None` where it is not known at one of them.
pub(super) fn shape_in(measured: &MeasuredSetup<'_>, mode: &Mode) -> Option<Shape> {
    let components: Option<Vec<_>> = measured
        .spectrum
        .channels()
        .iter()
        .map(|&channel| {
            let component = component_of(&mode.shape, &measured.setup.name, measured.setup.sensors.get(channel)?)?;
            Some(component.value())
        })
        .collect();
    components.map(Shape::from_vec)
}

/// The component of a sensor: by the name that [`crate::identify::merge`] gives it; a reference goes by its point.
pub(in crate::identify) fn component_of<'a>(
    shape: &'a [ShapeComponent],
    setup: &str,
    sensor: &Sensor,
) -> Option<&'a ShapeComponent> {
    shape.get(place_of(shape, setup, sensor)?)
}

/// The same, to be changed.
pub(in crate::identify) fn component_of_mut<'a>(
    shape: &'a mut [ShapeComponent],
    setup: &str,
    sensor: &Sensor,
) -> Option<&'a mut ShapeComponent> {
    let place = place_of(shape, setup, sensor)?;
    shape.get_mut(place)
}

fn place_of(shape: &[ShapeComponent], setup: &str, sensor: &Sensor) -> Option<usize> {
    let own = format!("{setup}/{}", sensor.channel);
    let named = |name: &str| shape.iter().position(|component| component.channel == name);
    let at_point = || shape.iter().position(|component| component.point == sensor.point);
    if sensor.reference { at_point() } else { named(&own).or_else(|| named(&sensor.channel)) }
}
