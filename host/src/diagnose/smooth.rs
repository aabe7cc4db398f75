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

#[cfg(test)]
mod tests {
    use super::super::testing::study;
    use super::*;

    fn sensor(elevation_m: f64, azimuth_deg: f64, offset_m: [f64; 2]) -> Sensor {
        let any = study().2.remove(0);
        Sensor { elevation_m: Some(elevation_m), direction: Some(Direction::AzimuthDeg(azimuth_deg)), offset_m, ..any }
    }

    /// A ring moves, turns and becomes an oval: what opposite sensors on it have in common follows from that.
    #[test]
    fn sensors_of_a_ring_err_as_a_ring_moves() {
        // Along Y, at both ends of a diameter along X; one at the same place as the first; along X; and one correlation length above.
        let sensors = [
            sensor(100.0, 90.0, [5.0, 0.0]),
            sensor(100.0, 90.0, [-5.0, 0.0]),
            sensor(100.0, 90.0, [5.0, 0.0]),
            sensor(100.0, 0.0, [5.0, 0.0]),
            sensor(130.0, 90.0, [5.0, 0.0]),
        ];
        let covariance = smooth_covariance(&sensors, 30.0);
        // By moving, turning and distorting alike.
        assert!((covariance[(0, 0)] - 3.0).abs() < 1e-12 && (covariance[(0, 2)] - 3.0).abs() < 1e-12);
        // Opposite ends move together, and turn and distort against each other.
        assert!((covariance[(0, 1)] + 1.0).abs() < 1e-12, "{covariance}");
        // Along X, on the X axis, neither turning nor distortion shows.
        assert!((covariance[(3, 3)] - 1.0).abs() < 1e-12 && covariance[(0, 3)].abs() < 1e-12);
        assert!((covariance[(0, 4)] - 3.0 * (-0.5f64).exp()).abs() < 1e-12);
        assert!(covariance.symmetric_eigenvalues().min() > -1e-12);
    }

    #[test]
    fn vertical_sensors_have_no_part() {
        let vertical = Sensor { direction: Some(Direction::Up), ..sensor(100.0, 0.0, [0.0; 2]) };
        let covariance = smooth_covariance(&[sensor(100.0, 0.0, [0.0; 2]), vertical], 30.0);
        assert_eq!((covariance[(0, 0)], covariance[(1, 1)], covariance[(0, 1)]), (1.0, 0.0, 0.0));
    }
}
