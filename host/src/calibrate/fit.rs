//! Gains, offsets and cross-axis sensitivities of the three axes, by least squares against gravity.
//!
//! An axis that points up or down reads its sensitivity times gravity, times the cosine of the angle at which the face lies. The angle is not known,
//! only that faces lie level to within a degree or so; half a degree makes 0.004 % of gravity. It shows in what the other two axes read, mixed with
//! how far their directions are off (cross-axis sensitivity): the same tilt pulls them one way on both faces of an axis, their directions pull
//! opposite ways. So half of the tilt is measured and corrected for, and the other half is in the deviations.

use nalgebra::{DMatrix, DVector, Matrix4, Vector4};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::CalibrationError;
use super::gravity::Gravity;
use super::still::{Face, LEAST_S, Still, faces_of};

/// Names of the axes.
pub const AXES: [&str; 3] = ["X", "Y", "Z"];

/// What is known of an axis: an acceleration is (reading - offset) × gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// What readings are to be multiplied by.
    pub gain: f64,
    /// Its standard deviation, without that of gravity, which all gains share.
    pub gain_std: f64,
    /// What the axis reads without acceleration, in m/s².
    pub offset_m_s2: f64,
    /// Its standard deviation.
    pub offset_std_m_s2: f64,
    /// What it reads of accelerations along X, Y and Z, relative to its own direction: 1 there.
    pub cross: [f64; 3],
    /// Standard deviations of those: how far from level the faces lie hides most of it.
    pub cross_std: [f64; 3],
}

/// What a tumble has found.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    /// X, Y and Z.
    pub axes: [Axis; 3],
    /// Gravity, as it was taken.
    pub gravity: Gravity,
    /// Standard deviation of a face's angle in each direction, in degrees, as it was taken.
    pub level_deg: f64,
    /// How far the faces were from level, as far as that shows, in degrees (RMS in a direction).
    pub seen_level_deg: f64,
    /// Probability of as much, had they lain as level as was said.
    pub p_value: f64,
}

/// Gains, and offsets a sensor's data sheet allows; beyond that it is a mistake.
const GAINS: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// Cross-axis sensitivity of a sensor, as a standard deviation (ADXL355 data sheet, "Specifications": 1 %).
const CROSS_AXIS: f64 = 0.01;
/// Rounds until the cosines are settled: each changes them by a thousandth of the one before.
const ROUNDS: usize = 4;

/// What stood still, solved for one axis: its sensitivities to accelerations along X, Y and Z, its offset, and their covariance.
struct Solved {
    parameters: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl Solved {
    fn sensitivity_to(&self, axis: usize) -> f64 {
        self.parameters[axis]
    }

    fn offset(&self) -> f64 {
        self.parameters[3]
    }
}

/// What the axes are to be multiplied by, and what they read without acceleration. Faces lie level to `level_deg` in each direction (a standard
/// deviation).
///
/// # Errors
/// Where a face is missing, or the readings are not gravity's.
pub fn fit(still: &[Still], gravity: Gravity, level_deg: f64) -> Result<Calibrated, CalibrationError> {
    let times = faces_of(still);
    let missing: Vec<String> = Face::ALL
        .into_iter()
        .zip(times)
        .filter(|(_, seconds)| *seconds < LEAST_S)
        .map(|(face, _)| face.to_string())
        .collect();
    if !missing.is_empty() {
        return Err(CalibrationError::MissingFaces { faces: missing.join(", "), least_s: LEAST_S });
    }
    let tilt_std = level_deg.to_radians();
    let mut cosines = vec![1.0; still.len()];
    let mut solved = [0, 1, 2].map(|axis| solve(still, &cosines, axis, gravity, tilt_std));
    for _ in 0..ROUNDS {
        for (one, cosine) in still.iter().zip(&mut cosines) {
            let lateral = (0..3).filter(|axis| *axis != one.face.axis);
            let squares: f64 = lateral.map(|axis| tilt_square(one, &solved[axis], axis, gravity)).sum();
            *cosine = (1.0 - squares).max(0.0).sqrt();
        }
        // Tilts are seen through the axes' own sensitivities.
        let seen_std = |axis: usize| tilt_std * solved[axis].sensitivity_to(axis);
        solved = [0, 1, 2].map(|axis| solve(still, &cosines, axis, gravity, seen_std(axis)));
    }
    let mut axes = Vec::with_capacity(3);
    for (axis, of_axis) in solved.iter().enumerate() {
        let own = of_axis.sensitivity_to(axis);
        let gain = own.recip();
        if !GAINS.contains(&gain) {
            return Err(CalibrationError::Gain { axis: AXES[axis], gain });
        }
        let (tilt_of_gain, tilt_of_offset) = errors_by_tilts(still, &solved, axis, gravity);
        let noise = |place: usize| of_axis.covariance[(place, place)];
        let cross_of = |other: usize| if other == axis { 1.0 } else { of_axis.sensitivity_to(other) * gain };
        axes.push(Axis {
            gain,
            gain_std: gain * (noise(axis) * gain * gain + tilt_of_gain * tilt_of_gain).sqrt(),
            offset_m_s2: of_axis.offset(),
            offset_std_m_s2: (noise(3) + tilt_of_offset * tilt_of_offset).sqrt(),
            cross: std::array::from_fn(cross_of),
            cross_std: std::array::from_fn(|other| if other == axis { 0.0 } else { noise(other).sqrt() * gain }),
        });
    }
    let (squares, freedom) = lateral_misfit(still, &solved, gravity);
    let p_value = ChiSquared::new(freedom).map_or(1.0, |law| law.sf(squares / (tilt_std * tilt_std)));
    let seen_level_deg = (squares / freedom).sqrt().to_degrees();
    let axes = std::array::from_fn(|axis| axes[axis]);
    Ok(Calibrated { axes, gravity, level_deg, seen_level_deg, p_value })
}

/// Least squares for one axis. Where it points up or down its readings are as good as their noise; elsewhere the tilt is in them as well.
fn solve(still: &[Still], cosines: &[f64], axis: usize, gravity: Gravity, tilt_std: f64) -> Solved {
    let g = gravity.value_m_s2;
    let mut design = DMatrix::zeros(still.len(), 4);
    let mut readings = DVector::zeros(still.len());
    for (row, (one, cosine)) in still.iter().zip(cosines).enumerate() {
        let tilt = if one.face.axis == axis { 0.0 } else { g * tilt_std };
        let weight = one.std_m_s2[axis].hypot(tilt).recip();
        design[(row, one.face.axis)] = weight * one.face.sign() * g * cosine;
        design[(row, 3)] = weight;
        readings[row] = weight * one.mean_m_s2[axis];
    }
    let normal: Matrix4<f64> = Matrix4::from_fn(|row, column| design.column(row).dot(&design.column(column)));
    let right = Vector4::from_fn(|row, _| design.column(row).dot(&readings));
    // All six faces are there, so it has an inverse.
    let covariance = normal.try_inverse().unwrap_or_else(|| Matrix4::from_element(f64::INFINITY));
    Solved { parameters: covariance * right, covariance }
}

/// The tilt along a lateral axis as far as it shows: what it reads there beyond its offset and its cross-axis sensitivity.
fn seen_tilt(one: &Still, solved: &Solved, axis: usize, gravity: Gravity) -> f64 {
    let g = gravity.value_m_s2;
    let beyond = one.mean_m_s2[axis] - solved.offset() - one.face.sign() * g * solved.sensitivity_to(one.face.axis);
    beyond / (g * solved.sensitivity_to(axis))
}

/// The expected square of the tilt along a lateral axis: what shows of it, and what hides behind the cross-axis sensitivity.
fn tilt_square(one: &Still, solved: &Solved, axis: usize, gravity: Gravity) -> f64 {
    seen_tilt(one, solved, axis, gravity).powi(2) + hidden_square(solved, axis, one.face.axis)
}

/// The variance of the tilt along a lateral axis that hides behind its cross-axis sensitivity to the axis that points up.
fn hidden_square(solved: &Solved, lateral: usize, up: usize) -> f64 {
    solved.covariance[(up, up)] / solved.sensitivity_to(lateral).powi(2)
}

/// What the hidden part of the tilt leaves in an axis' sensitivity (relative) and offset (m/s²), as standard deviations.
///
/// A hidden tilt d along a lateral axis has the variance v of that axis' cross-axis sensitivity. The cosine is off by (d² - v) / 2, which scatters by
/// v / √2. Where the table is what tilts, all faces share the size of its tilt and their errors add up instead of averaging: √2 more, which is
/// taken, as nobody knows. Between an axis up and the same down the cosines differ by 2 d times the tilt that shows. Besides, the axis itself reads
/// [`CROSS_AXIS`] of what the tilt puts along the lateral axis: of its hidden part that is in the sensitivity, of what shows in the offset.
fn errors_by_tilts(still: &[Still], solved: &[Solved; 3], axis: usize, gravity: Gravity) -> (f64, f64) {
    let (mut of_gain, mut of_offset) = (0.0, 0.0);
    for (lateral, of_lateral) in solved.iter().enumerate().filter(|(lateral, _)| *lateral != axis) {
        let hidden = hidden_square(of_lateral, lateral, axis);
        let on_axis: Vec<f64> = still
            .iter()
            .filter(|one| one.face.axis == axis)
            .map(|one| seen_tilt(one, of_lateral, lateral, gravity).powi(2))
            .collect();
        let seen = on_axis.iter().sum::<f64>() / on_axis.len().max(1) as f64;
        of_gain += hidden * (hidden + CROSS_AXIS * CROSS_AXIS);
        of_offset += seen * (hidden + CROSS_AXIS * CROSS_AXIS);
    }
    (of_gain.sqrt(), gravity.value_m_s2 * of_offset.sqrt())
}

/// Sum of the squares of the tilts that show, and how many of them are free.
fn lateral_misfit(still: &[Still], solved: &[Solved; 3], gravity: Gravity) -> (f64, f64) {
    let mut squares = 0.0;
    for (axis, of_axis) in solved.iter().enumerate() {
        for one in still.iter().filter(|one| one.face.axis != axis) {
            squares += seen_tilt(one, of_axis, axis, gravity).powi(2);
        }
    }
    // Two of each still time, of which there are six at least; each axis has two cross-axis sensitivities.
    (squares, (2 * still.len() - 6) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::simulated::{Tilts, Tumbled};
    use crate::calibrate::still;

    const GRAVITY_M_S2: f64 = 9.8128;

    fn calibrated(seed: u64, level_deg: f64, tilts: Tilts) -> (Tumbled, Calibrated) {
        let mut sensor = Tumbled::new(seed, GRAVITY_M_S2, level_deg, tilts);
        let found = still(&sensor.tumble(), GRAVITY_M_S2);
        let calibrated = fit(&found, Gravity::measured(GRAVITY_M_S2), level_deg.max(1e-3)).unwrap();
        (sensor, calibrated)
    }

    #[test]
    fn on_a_level_table_gains_and_offsets_are_as_exact_as_the_noise() {
        for seed in 0..20 {
            let (sensor, found) = calibrated(seed, 0.0, Tilts::OfEachFace);
            for (axis, of_axis) in found.axes.iter().enumerate() {
                // Ten seconds of 22.5 µg/√Hz on two faces: 3.5 µg.
                let error = of_axis.gain * sensor.sensitivity[axis][axis] - 1.0;
                assert!(error.abs() < 2e-5, "{seed}: {error}");
                let error = of_axis.offset_m_s2 - sensor.offset[axis];
                assert!(error.abs() < 2e-4 && of_axis.offset_std_m_s2 < 2e-4, "{seed}: {error}");
            }
        }
    }

    /// The share of true values within 1.96 standard deviations: gains, offsets and cross-axis sensitivities.
    fn coverage(tilts: Tilts, seeds: u64) -> [f64; 3] {
        let mut inside = [0_u32; 3];
        let mut of = [0_u32; 3];
        for seed in 0..seeds {
            let (sensor, found) = calibrated(seed, 1.0, tilts);
            for (axis, of_axis) in found.axes.iter().enumerate() {
                let own = sensor.sensitivity[axis][axis];
                let mut count = |kind: usize, error: f64, std: f64| {
                    inside[kind] += u32::from(error.abs() <= 1.96 * std);
                    of[kind] += 1;
                };
                count(0, of_axis.gain - own.recip(), of_axis.gain_std);
                count(1, of_axis.offset_m_s2 - sensor.offset[axis], of_axis.offset_std_m_s2);
                for other in (0..3).filter(|other| *other != axis) {
                    let error = of_axis.cross[other] - sensor.sensitivity[axis][other] / own;
                    count(2, error, of_axis.cross_std[other]);
                }
            }
        }
        std::array::from_fn(|kind| f64::from(inside[kind]) / f64::from(of[kind]))
    }

    #[test]
    fn intervals_of_95_percent_have_the_truth_as_often_on_faces_that_lie_a_degree_off() {
        for tilts in [Tilts::OfTheTable, Tilts::OfEachFace] {
            let [gains, offsets, cross] = coverage(tilts, 2000);
            println!("{tilts:?}: gains {gains:.3}, offsets {offsets:.3}, cross-axis {cross:.3}");
            // 2000 tables scatter by 0.5 %. Squares of tilts, and tilts of one table, have longer tails than the normal law; where faces are independent
            // the deviation of a table is more than is needed.
            assert!((0.935..=0.99).contains(&gains), "{gains}");
            // Between faces of one table, whose tilts are equally large, there is no difference of cosines, and the deviation has one.
            let most = if tilts == Tilts::OfTheTable { 1.0 } else { 0.985 };
            assert!((0.93..=most).contains(&offsets), "{offsets}");
            assert!((0.92..=0.965).contains(&cross), "{cross}");
        }
    }

    #[test]
    fn a_degree_off_level_costs_a_tenth_of_what_a_shape_may_be_off() {
        let (_, found) = calibrated(1, 1.0, Tilts::OfEachFace);
        // τ²/√2 of 0.0175, and τ times 0.01 of cross-axis sensitivity: 2.1e-4 and 1.7e-4, times gains.
        assert!(found.axes.iter().all(|axis| (2.4e-4..3.1e-4).contains(&axis.gain_std)), "{found:?}");
        assert!(found.p_value > 1e-3, "{found:?}");
    }

    #[test]
    fn faces_that_lie_less_level_than_is_said_are_found_out() {
        let mut sensor = Tumbled::new(3, GRAVITY_M_S2, 5.0, Tilts::OfEachFace);
        let found = still(&sensor.tumble(), GRAVITY_M_S2);
        let calibrated = fit(&found, Gravity::measured(GRAVITY_M_S2), 0.5).unwrap();
        assert!(calibrated.p_value < 1e-6 && calibrated.seen_level_deg > 2.0, "{calibrated:?}");
    }

    #[test]
    fn missing_faces_and_readings_in_g_are_told() {
        let mut sensor = Tumbled::new(1, GRAVITY_M_S2, 1.0, Tilts::OfEachFace);
        let cells = sensor.tumble();
        let few = still(&cells[..5 * 14], GRAVITY_M_S2);
        let error = fit(&few, Gravity::standard(), 1.0).unwrap_err().to_string();
        assert!(error.contains("-Z up") && !error.contains("+Z"), "{error}");
        let mut wrong = still(&cells, GRAVITY_M_S2);
        for one in &mut wrong {
            one.mean_m_s2[1] *= 0.5;
        }
        let error = fit(&wrong, Gravity::standard(), 1.0).unwrap_err().to_string();
        assert!(error.contains("Y would need a gain of 1.") || error.contains("Y would need a gain of 2."), "{error}");
    }
}
