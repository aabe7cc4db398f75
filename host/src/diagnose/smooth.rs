//! How errors of a shape at neighbouring sensors go together: floors and rings move, turn and distort as their neighbours do.
//!
//! Sensors flow in; the covariance of a smooth error of a shape, of unit size, flows out.

use nalgebra::DMatrix;

use crate::study::{Direction, Sensor};

/// How a section can move otherwise than a model says: along X, along Y, by turning, and by distorting in its plane, as a ring that
/// becomes an oval does.
const MOTIONS: usize = 4;

/// Covariance between sensors, sensors x sensors, of motions of sections that are independent of each other, each a Gaussian process over
/// the height with this correlation length. Turning and distorting move the sensors that are furthest out by one. Vertical sensors and those
/// without a height have none.
pub(super) fn smooth_covariance(sensors: &[Sensor], length_m: f64) -> DMatrix<f64> {
    let reach_m = |sensor: &Sensor| sensor.offset_m[0].hypot(sensor.offset_m[1]);
    let furthest_m = sensors.iter().map(reach_m).fold(0.0, f64::max);
    let motions = |sensor: &Sensor| -> Option<[f64; MOTIONS]> {
        let Some(Direction::AzimuthDeg(azimuth_deg)) = sensor.direction else { return None };
        let (sin, cos) = azimuth_deg.to_radians().sin_cos();
        let [x, y] = sensor.offset_m.map(|offset_m| if furthest_m > 0.0 { offset_m / furthest_m } else { 0.0 });
        Some([cos, sin, x * sin - y * cos, x * sin + y * cos])
    };
    let placed: Vec<Option<(f64, [f64; MOTIONS])>> =
        sensors.iter().map(|sensor| sensor.elevation_m.zip(motions(sensor))).collect();
    DMatrix::from_fn(sensors.len(), sensors.len(), |one, other| match (&placed[one], &placed[other]) {
        (Some((z_m, here)), Some((other_m, there))) => {
            let distance = (z_m - other_m) / length_m;
            let alike: f64 = here.iter().zip(there).map(|(here, there)| here * there).sum();
            alike * (-0.5 * distance * distance).exp()
        }
        _ => 0.0,
    })
}
