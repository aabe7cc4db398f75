//! Local gravity: as it was measured, by the latitude, or standard.

use crate::study::STANDARD_GRAVITY_M_S2;

/// What gravity is taken to be, and how well that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gravity {
    /// In m/s².
    pub value_m_s2: f64,
    /// Relative standard deviation, common to all axes and sensors: it changes no shape.
    pub relative_std: f64,
}

/// Gravity differs from that of the ellipsoid by some 30 mGal (0.3 mm/s²) at most places.
const ANOMALY_STD: f64 = 3e-5;
/// From 9.780 m/s² at the equator to 9.832 at the poles: where nobody says where, the standard deviation of a latitude drawn evenly over the ground.
const ANYWHERE_STD: f64 = 1.6e-3;

impl Gravity {
    /// As it was measured.
    pub fn measured(value_m_s2: f64) -> Self {
        Self { value_m_s2, relative_std: 0.0 }
    }

    /// At a latitude in degrees and a height in m.
    pub fn at(latitude_deg: f64, height_m: f64) -> Self {
        Self { value_m_s2: at_latitude_m_s2(latitude_deg, height_m), relative_std: ANOMALY_STD }
    }

    /// Standard gravity, where nothing is said.
    pub fn standard() -> Self {
        Self { value_m_s2: STANDARD_GRAVITY_M_S2, relative_std: ANYWHERE_STD }
    }
}

/// Normal gravity of the WGS 84 ellipsoid (Somigliana's formula; NIMA TR8350.2, 3rd edition, equations 4-1 and 4-3), less the free-air gradient.
fn at_latitude_m_s2(latitude_deg: f64, height_m: f64) -> f64 {
    const EQUATOR_M_S2: f64 = 9.780_325_335_9;
    const K: f64 = 0.001_931_852_652_41;
    const ECCENTRICITY_2: f64 = 0.006_694_379_990_13;
    /// Per m of height.
    const FREE_AIR: f64 = 3.086e-6;
    let sine_2 = latitude_deg.to_radians().sin().powi(2);
    EQUATOR_M_S2 * (1.0 + K * sine_2) / (1.0 - ECCENTRICITY_2 * sine_2).sqrt() - FREE_AIR * height_m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_is_that_of_places_where_it_was_measured() {
        // Pole and equator of the WGS 84 ellipsoid (TR8350.2, table 3.4); the gravimeters' sites at Sèvres and, less the 14 mGal by which it was
        // corrected in 1971, Potsdam.
        for (latitude_deg, height_m, measured_m_s2, most) in [
            (90.0, 0.0, 9.832_184_937_8, 1e-9),
            (0.0, 0.0, 9.780_325_335_9, 1e-12),
            (48.829, 66.0, 9.809_26, 2e-4),
            (52.381, 87.0, 9.812_60, 2e-4),
        ] {
            let found = at_latitude_m_s2(latitude_deg, height_m);
            assert!((found - measured_m_s2).abs() < most, "{latitude_deg}: {found}");
        }
    }
}
