//! The ADXL355, a three-axis low-noise accelerometer, over SPI (Analog Devices, ADXL354/ADXL355 data sheet, revision B).
//!
//! It runs with external synchronisation and its interpolation filter: its DRDY pin is an input, and every rising edge there makes
//! one sample. So the node's own timer samples all channels, not the sensor's oscillator.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{Operation, SpiDevice};

/// Channels: x, y and z.
pub const CHANNELS: usize = 3;
/// Readings of this magnitude or more, in m/s², are at the end of the range of 2.048 g.
pub const FULL_SCALE_M_S2: f32 = 20.0;
/// The highest sampling rate, in mHz: the fastest rate of its filters.
pub const HIGHEST_RATE_MHZ: u32 = 4_000_000;

/// Registers.
mod register {
    pub(super) const DEVID_AD: u8 = 0x00;
    pub(super) const STATUS: u8 = 0x04;
    pub(super) const TEMP2: u8 = 0x06;
    pub(super) const FILTER: u8 = 0x28;
    pub(super) const SYNC: u8 = 0x2B;
    pub(super) const RANGE: u8 = 0x2C;
    pub(super) const POWER_CTL: u8 = 0x2D;
    pub(super) const RESET: u8 = 0x2F;
}

/// What DEVID_AD, DEVID_MST and PARTID hold.
const IDENTITY: [u8; 3] = [0xAD, 0x1D, 0xED];
const RESET_CODE: u8 = 0x52;
/// ±2.048 g; the other bits say how interrupts and I2C behave.
const RANGE_2_G: u8 = 0x01;
/// External synchronisation, interpolation filter on, internal clock.
const EXTERNAL_SYNC: u8 = 0x02;
const STANDBY: u8 = 0x01;
const MEASURE: u8 = 0x00;
/// In the status: the fuses are still being read.
const NVM_BUSY: u8 = 0x10;
/// Steps of 1 ms that a start may take.
const START_MS: u32 = 20;
/// m/s² per digit: 256 000 digits per g.
const SCALE_M_S2: f32 = 9.806_65 / 256_000.0;
/// Temperature: 1885 digits at 25 °C, -9.05 digits per kelvin.
const TEMPERATURE_AT_25_C: i32 = 1885;
/// The filter's corner is a quarter of its rate, 4 kHz and halves of it.
const FASTEST_MHZ: u32 = 4_000_000;
const SLOWEST_SETTING: u8 = 10;

/// Why there is no reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub enum Error<E> {
    /// The bus failed.
    Bus(E),
    /// Something else, or nothing, answers: what it gave as its identity.
    NotThere([u8; 3]),
    /// It did not become ready.
    Busy,
    /// It answers only zeros or only ones, like a line without a sensor.
    Silent,
}

/// A reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Acceleration along x, y and z in m/s².
    pub acceleration_m_s2: [f32; CHANNELS],
    /// Temperature in units of 0.01 °C.
    pub temperature_centi_c: i16,
}

/// A sensor that measures.
#[derive(Debug)]
pub struct Adxl355<S> {
    bus: S,
}

impl<S: SpiDevice> Adxl355<S> {
    /// Starts the sensor for a sampling rate in mHz; see [`set_rate`](Self::set_rate).
    ///
    /// # Errors
    /// [`Error`], with the bus, if there is no such sensor or it is not ready within some 20 ms.
    pub fn start(mut bus: S, delay: &mut impl DelayNs, rate_mhz: u32) -> Result<Self, (Error<S::Error>, S)> {
        match Self::bring_up(&mut bus, delay, rate_mhz) {
            Ok(()) => Ok(Self { bus }),
            Err(error) => Err((error, bus)),
        }
    }

    fn bring_up(bus: &mut S, delay: &mut impl DelayNs, rate_mhz: u32) -> Result<(), Error<S::Error>> {
        let mut identity = [0; 3];
        read(bus, register::DEVID_AD, &mut identity)?;
        if identity != IDENTITY {
            return Err(Error::NotThere(identity));
        }
        write(bus, register::RESET, RESET_CODE)?;
        let mut waited_ms = 0;
        loop {
            delay.delay_ms(1);
            waited_ms += 1;
            let mut status = [0];
            read(bus, register::STATUS, &mut status)?;
            if status[0] & NVM_BUSY == 0 {
                break;
            }
            if waited_ms == START_MS {
                return Err(Error::Busy);
            }
        }
        write(bus, register::RANGE, RANGE_2_G)?;
        write(bus, register::SYNC, EXTERNAL_SYNC)?;
        write(bus, register::FILTER, filter_setting(rate_mhz))?;
        write(bus, register::POWER_CTL, MEASURE)
    }

    /// Sets the low-pass filter for a sampling rate in mHz: the highest corner that is no more than 0.4 times the rate, so that
    /// nothing above half of it folds down into the band that is used.
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub fn set_rate(&mut self, rate_mhz: u32) -> Result<(), Error<S::Error>> {
        write(&mut self.bus, register::POWER_CTL, STANDBY)?;
        write(&mut self.bus, register::FILTER, filter_setting(rate_mhz))?;
        write(&mut self.bus, register::POWER_CTL, MEASURE)
    }

    /// The newest sample.
    ///
    /// # Errors
    /// [`Error::Bus`], or [`Error::Silent`] where nothing answers any more.
    pub fn read(&mut self) -> Result<Reading, Error<S::Error>> {
        let mut bytes = [0; 2 + 3 * CHANNELS];
        read(&mut self.bus, register::TEMP2, &mut bytes)?;
        if bytes.iter().all(|&byte| byte == 0) || bytes.iter().all(|&byte| byte == 0xFF) {
            return Err(Error::Silent);
        }
        let [t2, t1, axes @ ..] = bytes;
        let digits = i32::from(u16::from_be_bytes([t2 & 0x0F, t1]));
        let mut acceleration_m_s2 = [0.0; CHANNELS];
        for (value, digits) in acceleration_m_s2.iter_mut().zip(axes.chunks_exact(3)) {
            // 20 bits in two's complement, left-justified in three bytes.
            if let &[high, middle, low] = digits {
                *value = (i32::from_be_bytes([high, middle, low, 0]) >> 12) as f32 * SCALE_M_S2;
            }
        }
        // 100 / 9.05 = 2000 / 181
        let temperature_centi_c = 2500 - ((digits - TEMPERATURE_AT_25_C) * 2000) / 181;
        Ok(Reading { acceleration_m_s2, temperature_centi_c: temperature_centi_c as i16 })
    }

    /// The bus, to start anew.
    pub fn release(self) -> S {
        self.bus
    }
}

/// The FILTER register for a sampling rate: no high-pass, and the low-pass of [`Adxl355::set_rate`].
fn filter_setting(rate_mhz: u32) -> u8 {
    let fits = |setting: &u8| u64::from(FASTEST_MHZ >> setting) * 10 <= u64::from(rate_mhz) * 16;
    (0..SLOWEST_SETTING).find(fits).unwrap_or(SLOWEST_SETTING)
}

fn read<S: SpiDevice>(bus: &mut S, register: u8, bytes: &mut [u8]) -> Result<(), Error<S::Error>> {
    bus.transaction(&mut [Operation::Write(&[register << 1 | 1]), Operation::Read(bytes)]).map_err(Error::Bus)
}

fn write<S: SpiDevice>(bus: &mut S, register: u8, value: u8) -> Result<(), Error<S::Error>> {
    bus.write(&[register << 1, value]).map_err(Error::Bus)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::delay::NoopDelay;
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};
    use std::vec::Vec;

    fn reads(command: u8, answer: &[u8]) -> Vec<Transaction<u8>> {
        std::vec![
            Transaction::transaction_start(),
            Transaction::write(command),
            Transaction::read_vec(answer.to_vec()),
            Transaction::transaction_end(),
        ]
    }

    fn writes(register: u8, value: u8) -> Vec<Transaction<u8>> {
        std::vec![
            Transaction::transaction_start(),
            Transaction::write_vec(std::vec![register << 1, value]),
            Transaction::transaction_end(),
        ]
    }

    fn starting() -> Vec<Transaction<u8>> {
        let steps = [
            reads(0x01, &[0xAD, 0x1D, 0xED]),
            writes(0x2F, 0x52),
            reads(0x09, &[0x10]),
            reads(0x09, &[0x00]),
            writes(0x2C, 0x01),
            writes(0x2B, 0x02),
            writes(0x28, 6),
            writes(0x2D, 0x00),
        ];
        steps.concat()
    }

    #[test]
    fn it_starts_and_its_digits_become_metres_per_second_squared_and_degrees() {
        // -1 digit, 1 g, -2.048 g; 1885 - 905 digits: 100 K above 25 °C.
        let digits = [0x03, 0xD4, 0xFF, 0xFF, 0xF0, 0x3E, 0x80, 0x00, 0x80, 0x00, 0x00];
        let quiet = [0; 11];
        let steps = [starting(), reads(0x0D, &digits), reads(0x0D, &quiet), reads(0x0D, &[0xFF; 11])];
        let mut mock = Mock::new(&steps.concat());
        let mut sensor = Adxl355::start(mock.clone(), &mut NoopDelay, 50_000).unwrap();
        let reading = sensor.read().unwrap();
        let [x, y, z] = reading.acceleration_m_s2;
        assert_eq!(x, -SCALE_M_S2);
        assert!((y - 9.806_65).abs() < 1e-5 && (z + 2.048 * 9.806_65).abs() < 1e-5, "{y} {z}");
        assert!(z.abs() > FULL_SCALE_M_S2);
        assert_eq!(reading.temperature_centi_c, 12_500);
        assert_eq!(sensor.read(), Err(Error::Silent));
        assert_eq!(sensor.read(), Err(Error::Silent));
        mock.done();
    }

    #[test]
    fn what_is_not_there_or_never_ready_is_said_and_the_bus_comes_back() {
        let mut mock = Mock::new(&reads(0x01, &[0, 0, 0]));
        let (error, _) = Adxl355::start(mock.clone(), &mut NoopDelay, 50_000).unwrap_err();
        assert_eq!(error, Error::NotThere([0; 3]));
        mock.done();
        let mut busy = [reads(0x01, &IDENTITY), writes(0x2F, 0x52)].concat();
        busy.extend((0..START_MS).flat_map(|_| reads(0x09, &[0x10])));
        let mut mock = Mock::new(&busy);
        assert_eq!(Adxl355::start(mock.clone(), &mut NoopDelay, 50_000).unwrap_err().0, Error::Busy);
        mock.done();
    }

    #[test]
    fn the_filter_closes_below_half_the_sampling_rate() {
        for rate_mhz in [10_000, 31_250, 50_000, 62_500, 100_000, 250_000, 1_000_000, 4_000_000] {
            let setting = filter_setting(rate_mhz);
            let corner_mhz = f64::from(FASTEST_MHZ) / f64::from(1_u32 << setting) / 4.0;
            assert!(corner_mhz <= 0.4 * f64::from(rate_mhz), "{rate_mhz}: {setting}");
            assert!(setting == 0 || 2.0 * corner_mhz > 0.4 * f64::from(rate_mhz), "{rate_mhz}: {setting}");
        }
        assert_eq!(filter_setting(1), SLOWEST_SETTING);
    }

    #[test]
    fn a_new_rate_is_set_in_standby() {
        let steps = [starting(), writes(0x2D, 1), writes(0x28, 2), writes(0x2D, 0)];
        let mut mock = Mock::new(&steps.concat());
        let mut sensor = Adxl355::start(mock.clone(), &mut NoopDelay, 50_000).unwrap();
        sensor.set_rate(1_000_000).unwrap();
        sensor.release();
        mock.done();
    }
}
