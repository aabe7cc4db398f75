//! What the ADXL355's own filters do to a signal: their delay, which a node subtracts from the time of every sample, and their pass band, which it
//! divides out of the lines. A recording has passed no such filters, and only the node knows what it measures.
//!
//! All of it is of the sensor with external synchronisation and its interpolation filter (EXT_SYNC = 10, EXT_CLK = 0), as the node runs it. The
//! sensor then goes on measuring at its output data rate (ODR), by its own RC oscillator; the interpolation filter makes 64 values of each of these
//! samples, and a pulse takes the next of them. So a pulse decides when a sample is taken to within 1 / (64 ODR), and the delay and the corners
//! of the filters are as inexact as the oscillator.

/// Settings of the filters: the ODR is [`FASTEST_MHZ`] halved so many times.
pub const SETTINGS: u8 = 11;
/// The fastest ODR in mHz.
pub const FASTEST_MHZ: u32 = 4_000_000;
/// Values that the interpolation filter makes of a sample.
pub const INTERPOLATION: u64 = 64;

/// Delay in 1/100 000 of the ODR's period and attenuation at a quarter of the ODR in 0.01 dB, of both filters together (ADXL354/ADXL355 data sheet,
/// revision B, table "Combined Digital Interpolation Filter and Decimation Filter Response").
const COMBINED: [(u64, u16); SETTINGS as usize] = [
    (351_661, 618),
    (301_260, 493),
    (275_200, 466),
    (263_460, 458),
    (257_730, 455),
    (254_730, 455),
    (253_257, 455),
    (252_452, 455),
    (252_045, 455),
    (251_940, 455),
    (251_714, 455),
];

/// The setting for a sampling rate in mHz: the highest whose corner, a quarter of the ODR, is no more than 0.4 times the rate.
///
/// At 1000, 500 and 250 Hz the ODR is the rate itself. There the filters have a zero, so that nothing folds down into the band around 0 Hz that a node
/// keeps when it decimates. At other rates something does: the filters alone close too slowly.
pub const fn setting_for(rate_mhz: u32) -> u8 {
    let mut setting = 0;
    while setting + 1 < SETTINGS && 5 * ((FASTEST_MHZ >> setting) as u64) > 8 * rate_mhz as u64 {
        setting += 1;
    }
    setting
}

/// The nominal ODR of a setting in Hz.
pub fn odr_hz(setting: u8) -> f64 {
    1e9 / period_ns(setting) as f64
}

/// The nominal period of the ODR of a setting in ns.
pub const fn period_ns(setting: u8) -> u64 {
    250_000 << if setting < SETTINGS { setting } else { SETTINGS - 1 }
}

/// How long before a pulse the motion was that its sample shows, in ns, where the sensor's oscillator is fast by `oscillator_ppm`.
///
/// Half a step of the interpolation is in it: the sensor takes the next of its values, half a step after the pulse on average.
pub fn delay_ns(setting: u8, oscillator_ppm: i32) -> u64 {
    let (periods, _) = COMBINED[usize::from(setting.min(SETTINGS - 1))];
    let nominal = (periods - 50_000 / INTERPOLATION) * period_ns(setting) / 100_000;
    nominal * 1_000_000 / 1_000_000_u64.saturating_add_signed(i64::from(oscillator_ppm)).max(1)
}

/// By how many dB the filters attenuate a frequency up to a quarter of the ODR.
///
/// The table has one point a setting. Filters of this kind (powers of a sinc) fall with the square of the frequency far below their first zero: at a
/// tenth of the ODR that is within 0.02 dB of the fifth power that has the same attenuation at a quarter.
pub fn attenuation_db(setting: u8, frequency_hz: f64) -> f64 {
    let (_, at_quarter_db) = COMBINED[usize::from(setting.min(SETTINGS - 1))];
    let quarters = 4.0 * frequency_hz / odr_hz(setting);
    0.01 * f64::from(at_quarter_db) * quarters * quarters
}

/// What lines have to be multiplied by so that the filters have not attenuated them, at a sampling rate in mHz: 1 plus this times the square of the
/// frequency in Hz. It leaves 0.03 dB at a tenth of the ODR, and 0.001 dB at a fortieth.
pub fn correction_per_hz2(rate_mhz: u32) -> f32 {
    let setting = setting_for(rate_mhz);
    let (_, at_quarter) = COMBINED[usize::from(setting)];
    // ln 10 / 20 for a dB, of which the table has hundredths.
    let per_quarter2 = 1.151_292_5e-3 * f32::from(at_quarter);
    let quarters_per_hz = 4e-9 * period_ns(setting) as f32;
    per_quarter2 * quarters_per_hz * quarters_per_hz
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_is_at_most_0_4_times_the_sampling_rate_and_the_odr_the_rate_where_it_can_be() {
        for (rate_mhz, odr) in
            [(4_000_000, 4000.0), (1_000_000, 1000.0), (624_999, 500.0), (500_000, 500.0), (50_000, 62.5)]
        {
            assert_eq!(odr_hz(setting_for(rate_mhz)), odr, "{rate_mhz}");
        }
        assert_eq!((setting_for(u32::MAX), setting_for(1), odr_hz(setting_for(1))), (0, 10, 3.906_25));
    }

    #[test]
    fn delays_are_those_of_the_sheet_in_milliseconds() {
        for (setting, ms) in
            [(0, 0.88), (1, 1.51), (2, 2.75), (3, 5.27), (4, 10.31), (5, 20.38), (6, 40.52), (10, 644.39)]
        {
            let half_step_ns = period_ns(setting) / INTERPOLATION / 2;
            assert!((1e-6 * (delay_ns(setting, 0) + half_step_ns) as f64 - ms).abs() < 0.006, "{setting}");
        }
        // An oscillator that is 2 % fast shortens it by as much.
        assert!((delay_ns(2, 20_000) as f64 * 1.02 - delay_ns(2, 0) as f64).abs() < 2.0);
        assert!(delay_ns(255, i32::MIN) > 0);
    }

    #[test]
    fn the_pass_band_is_near_that_of_a_fifth_power_of_a_sinc() {
        // -1.83 dB of the decimation and -2.74 dB of the interpolation, at a quarter: a second and a third power.
        let sinc_db = |x: f64| -100.0 * libm::log10(libm::sin(core::f64::consts::PI * x) / (core::f64::consts::PI * x));
        for step in 1..=10 {
            let of_odr = 0.01 * f64::from(step);
            let difference = attenuation_db(4, of_odr * odr_hz(4)) - sinc_db(of_odr);
            assert!(difference.abs() < 0.02, "{of_odr}: {difference}");
        }
        assert!((attenuation_db(4, 62.5) - 4.55).abs() < 1e-9);
    }

    #[test]
    fn lines_are_corrected_by_what_the_filters_attenuate() {
        for (rate_mhz, of_odr, most_db) in [(1_000_000, 0.025, 0.001), (500_000, 0.1, 0.035), (50_000, 0.024, 0.001)] {
            let setting = setting_for(rate_mhz);
            let frequency_hz = of_odr * odr_hz(setting);
            let factor = 1.0 + f64::from(correction_per_hz2(rate_mhz)) * frequency_hz * frequency_hz;
            let left_db = 20.0 * libm::log10(factor) - attenuation_db(setting, frequency_hz);
            assert!(left_db.abs() < most_db, "{rate_mhz}: {left_db}");
        }
    }
}
