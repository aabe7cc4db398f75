//! The ADXL355, a three-axis low-noise accelerometer, over SPI (Analog Devices, ADXL354/ADXL355 data sheet, revision B).
//!
//! It runs with external synchronisation and its interpolation filter: its DRDY pin is an input, and a rising edge there takes a sample of what its filters
//! put out at that moment. The sensor itself goes on measuring by its own oscillator, which is only good to a percent or so: it sets the filters'
//! delay ([`belfry_shared::adxl355`]). So the driver measures the oscillator at the start, and says how old a sample is ([`Adxl355::delay_us`]).

#[cfg(test)]
mod simulated;
#[cfg(test)]
mod tests;

use belfry_shared::adxl355::{delay_ns, period_ns, setting_for};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{Operation, SpiDevice};

/// Channels: x, y and z.
pub const CHANNELS: usize = 3;
/// Readings of this magnitude or more, in m/s², are at the end of the range of 2.048 g.
pub const FULL_SCALE_M_S2: f32 = 20.0;
/// The highest sampling rate, in mHz: the fastest rate of its filters.
pub const HIGHEST_RATE_MHZ: u32 = belfry_shared::adxl355::FASTEST_MHZ;

/// Registers (data sheet, "Register Map").
mod register {
    pub(super) const DEVID_AD: u8 = 0x00;
    pub(super) const STATUS: u8 = 0x04;
    pub(super) const FILTER: u8 = 0x28;
    pub(super) const SYNC: u8 = 0x2B;
    pub(super) const RANGE: u8 = 0x2C;
    pub(super) const POWER_CTL: u8 = 0x2D;
    pub(super) const RESET: u8 = 0x2F;
    /// Five shadow registers of what the fuses hold.
    pub(super) const SHADOW: u8 = 0x50;
}

/// What DEVID_AD, DEVID_MST and PARTID hold.
const IDENTITY: [u8; 3] = [0xAD, 0x1D, 0xED];
const RESET_CODE: u8 = 0x52;
/// ±2.048 g; the other bits say how interrupts and I2C behave.
const RANGE_2_G: u8 = 0x01;
const INTERNAL_SYNC: u8 = 0x00;
/// External synchronisation, interpolation filter on, internal clock.
const EXTERNAL_SYNC: u8 = 0x02;
const STANDBY: u8 = 0x01;
const MEASURE: u8 = 0x00;
/// DRDY_OFF: the pin stays low where it would be an output.
const MEASURE_WITHOUT_DRDY: u8 = 0x04;
/// In the status: a sample that has not been read.
const DATA_READY: u8 = 0x01;
/// In the status: the fuses are still being read.
const NVM_BUSY: u8 = 0x10;
/// Steps of 1 ms that a start may take.
const START_MS: u32 = 20;
/// Resets that may load the fuses wrongly before the sensor is given up.
const MOST_RESETS: u32 = 5;
/// The oscillator is measured at the setting of 62.5 Hz, over so many periods: in 128 ms, with looks 22 µs apart, to 200 ppm.
const OSCILLATOR_SETTING: u8 = 6;
const OSCILLATOR_PERIODS: u32 = 8;
/// An oscillator that is off by more than this, in ppm, is not one of this sensor's.
const MOST_OSCILLATOR_PPM: i64 = 100_000;
/// m/s² per digit: 256 000 digits per g.
const SCALE_M_S2: f32 = 9.806_65 / 256_000.0;
/// Temperature: 1885 digits at 25 °C, -9.05 digits per kelvin (data sheet, table "Specifications").
const TEMPERATURE_AT_25_C: i32 = 1885;
/// Status, FIFO entries, temperature and all axes, in one burst, so that they belong together.
const BURST: usize = 4 + 3 * CHANNELS;

/// Bytes on the bus for a reading: a command, and the burst.
pub const BURST_BYTES: usize = 1 + BURST;

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
    /// Its shadow registers differ after every reset: the fuses, with its calibration, were loaded wrongly.
    Fuses,
    /// Its own oscillator makes no samples, or is far off.
    Oscillator,
    /// It answers only zeros or only ones, like a line without a sensor.
    Silent,
}

/// A reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Acceleration along x, y and z in m/s²; `None` where the sensor has taken no sample since the last reading, as without pulses at its DRDY pin.
    pub acceleration_m_s2: Option<[f32; CHANNELS]>,
    /// Temperature in units of 0.01 °C.
    pub temperature_centi_c: i16,
}

/// A sensor that measures.
#[derive(Debug)]
pub struct Adxl355<S> {
    bus: S,
    oscillator_ppm: i32,
    delay_us: i64,
}

impl<S: SpiDevice> Adxl355<S> {
    /// Starts the sensor for a sampling rate in mHz; see [`set_rate`](Self::set_rate). `now_us` is a clock in µs. Takes some 180 ms, during which
    /// nothing may drive the sensor's DRDY pin, an output until then.
    ///
    /// # Errors
    /// [`Error`], with the bus, if there is no such sensor or it does not start as it should.
    pub fn start(
        mut bus: S,
        delay: &mut impl DelayNs,
        now_us: &mut impl FnMut() -> u64,
        rate_mhz: u32,
    ) -> Result<Self, (Error<S::Error>, S)> {
        let started = bring_up(&mut bus, delay).and_then(|()| {
            let oscillator_ppm = measure_oscillator(&mut bus, now_us)?;
            write(&mut bus, register::SYNC, EXTERNAL_SYNC)?;
            Ok(oscillator_ppm)
        });
        let oscillator_ppm = match started {
            Ok(oscillator_ppm) => oscillator_ppm,
            Err(error) => return Err((error, bus)),
        };
        let mut sensor = Self { bus, oscillator_ppm, delay_us: 0 };
        match sensor.set_rate(rate_mhz) {
            Ok(()) => Ok(sensor),
            Err(error) => Err((error, sensor.bus)),
        }
    }

    /// Sets the low-pass filter for a sampling rate in mHz: [`setting_for`].
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub fn set_rate(&mut self, rate_mhz: u32) -> Result<(), Error<S::Error>> {
        let setting = setting_for(rate_mhz);
        write(&mut self.bus, register::POWER_CTL, STANDBY)?;
        write(&mut self.bus, register::FILTER, setting)?;
        write(&mut self.bus, register::POWER_CTL, MEASURE)?;
        self.delay_us = ((delay_ns(setting, self.oscillator_ppm) + 500) / 1000) as i64;
        Ok(())
    }

    /// How long before its pulse the motion was that a sample shows, in µs.
    pub fn delay_us(&self) -> i64 {
        self.delay_us
    }

    /// By how much the sensor's oscillator was fast when it started, in ppm.
    pub fn oscillator_ppm(&self) -> i32 {
        self.oscillator_ppm
    }

    /// The newest sample.
    ///
    /// # Errors
    /// [`Error::Bus`], or [`Error::Silent`] where nothing answers any more.
    pub fn read(&mut self) -> Result<Reading, Error<S::Error>> {
        let [status, _, t2, t1, axes @ ..] = burst(&mut self.bus)?;
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
        Ok(Reading {
            acceleration_m_s2: (status & DATA_READY != 0).then_some(acceleration_m_s2),
            temperature_centi_c: temperature_centi_c as i16,
        })
    }

    /// The bus, to start anew.
    pub fn release(self) -> S {
        self.bus
    }
}

/// Resets the sensor, until its fuses are loaded as they were before.
fn bring_up<S: SpiDevice>(bus: &mut S, delay: &mut impl DelayNs) -> Result<(), Error<S::Error>> {
    let mut identity = [0; 3];
    read(bus, register::DEVID_AD, &mut identity)?;
    if identity != IDENTITY {
        return Err(Error::NotThere(identity));
    }
    // A soft reset can load the fuses wrongly, a power-on does not. The shadow registers from before tell (data sheet, revision B, register RESET):
    // where they differ afterwards, the sensor is to be reset again.
    let shadow = shadow(bus)?;
    for _ in 0..MOST_RESETS {
        write(bus, register::RESET, RESET_CODE)?;
        wait_for_fuses(bus, delay)?;
        if self::shadow(bus)? == shadow {
            return write(bus, register::RANGE, RANGE_2_G);
        }
    }
    Err(Error::Fuses)
}

fn shadow<S: SpiDevice>(bus: &mut S) -> Result<[u8; 5], Error<S::Error>> {
    let mut registers = [0; 5];
    read(bus, register::SHADOW, &mut registers)?;
    Ok(registers)
}

fn wait_for_fuses<S: SpiDevice>(bus: &mut S, delay: &mut impl DelayNs) -> Result<(), Error<S::Error>> {
    for _ in 0..START_MS {
        delay.delay_ms(1);
        let mut status = [0];
        read(bus, register::STATUS, &mut status)?;
        if status[0] & NVM_BUSY == 0 {
            return Ok(());
        }
    }
    Err(Error::Busy)
}

/// By how much the sensor's oscillator is fast, in ppm: by the time that samples take which it makes by itself.
fn measure_oscillator<S: SpiDevice>(bus: &mut S, now_us: &mut impl FnMut() -> u64) -> Result<i32, Error<S::Error>> {
    write(bus, register::SYNC, INTERNAL_SYNC)?;
    write(bus, register::FILTER, OSCILLATOR_SETTING)?;
    write(bus, register::POWER_CTL, MEASURE_WITHOUT_DRDY)?;
    let nominal_us = period_ns(OSCILLATOR_SETTING) / 1000;
    let begun_us = now_us();
    let (mut first_us, mut samples) = (begun_us, 0);
    loop {
        let now = now_us();
        // The first samples come once the filters are full.
        if now.saturating_sub(begun_us) > nominal_us * u64::from(2 * OSCILLATOR_PERIODS) {
            return Err(Error::Oscillator);
        }
        let [status, ..] = burst(bus)?;
        if status & DATA_READY == 0 {
            continue;
        }
        if samples == 0 {
            first_us = now;
        } else if samples == OSCILLATOR_PERIODS {
            let taken_us = now.saturating_sub(first_us).max(1);
            let ppm = (nominal_us * u64::from(OSCILLATOR_PERIODS) * 1_000_000 / taken_us) as i64 - 1_000_000;
            write(bus, register::POWER_CTL, STANDBY)?;
            return i32::try_from(ppm).ok().filter(|_| ppm.abs() <= MOST_OSCILLATOR_PPM).ok_or(Error::Oscillator);
        }
        samples += 1;
    }
}

/// The registers from the status to the last axis. Reading the axes' takes the status' mark of a new sample away.
fn burst<S: SpiDevice>(bus: &mut S) -> Result<[u8; BURST], Error<S::Error>> {
    let mut bytes = [0; BURST];
    read(bus, register::STATUS, &mut bytes)?;
    if bytes.iter().all(|&byte| byte == 0) || bytes.iter().all(|&byte| byte == 0xFF) {
        return Err(Error::Silent);
    }
    Ok(bytes)
}

fn read<S: SpiDevice>(bus: &mut S, register: u8, bytes: &mut [u8]) -> Result<(), Error<S::Error>> {
    bus.transaction(&mut [Operation::Write(&[register << 1 | 1]), Operation::Read(bytes)]).map_err(Error::Bus)
}

fn write<S: SpiDevice>(bus: &mut S, register: u8, value: u8) -> Result<(), Error<S::Error>> {
    bus.write(&[register << 1, value]).map_err(Error::Bus)
}
