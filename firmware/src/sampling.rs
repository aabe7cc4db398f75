//! Sampling: what is done with the sensor at every pulse, and when it has to be started anew.
//!
//! The board's interrupt calls [`Fetcher::fetch`] after each pulse. A row's time is that of the motion: the pulse's, less the delay of the sensor's
//! filters. Nothing later on knows of that delay, so it is subtracted once, here.

use belfry_shared::time::NodeTime;
use embedded_hal::spi::SpiDevice;

use crate::adxl355::{Adxl355, CHANNELS, Error};

/// Without a new sample at so many pulses in a row, a sensor is started anew. It takes three or so to fill its filters.
const MOST_STALE: u32 = 16;

/// A row of readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// When the motion was.
    pub time: NodeTime,
    /// In m/s²; NaN where there was none.
    pub readings: [f32; CHANNELS],
    /// Whether the sensor answers, and has taken no sample since the last row.
    pub is_stale: bool,
}

/// A sensor, or the want of one.
#[derive(Debug)]
pub struct Fetcher<S> {
    sensor: Option<Adxl355<S>>,
    /// Of the filters; of those of the last sensor where there is none, so that rows stay as far apart.
    delay_us: i64,
    temperature_centi_c: Option<i16>,
    stale_in_a_row: u32,
}

impl<S: SpiDevice> Fetcher<S> {
    /// Without a sensor.
    pub const NONE: Self = Self { sensor: None, delay_us: 0, temperature_centi_c: None, stale_in_a_row: 0 };

    /// Takes a sensor that has just been started, with its temperature.
    pub fn set_sensor(&mut self, mut sensor: Adxl355<S>) {
        self.delay_us = sensor.delay_us();
        self.temperature_centi_c = sensor.read().ok().map(|reading| reading.temperature_centi_c);
        self.stale_in_a_row = 0;
        self.sensor = Some(sensor);
    }

    /// Sets the sensor's filters for a rate in mHz.
    ///
    /// # Errors
    /// Why it takes none, and the sensor's bus: the sensor may be in standby.
    pub fn set_rate(&mut self, rate_mhz: u32) -> Result<(), (Error<S::Error>, S)> {
        let Some(mut sensor) = self.sensor.take() else { return Ok(()) };
        self.stale_in_a_row = 0;
        match sensor.set_rate(rate_mhz) {
            Ok(()) => {
                self.delay_us = sensor.delay_us();
                self.sensor = Some(sensor);
                Ok(())
            }
            Err(error) => Err((error, sensor.release())),
        }
    }

    /// The row of a pulse.
    pub fn fetch(&mut self, pulse: NodeTime) -> Row {
        let reading = self.sensor.as_mut().and_then(|sensor| sensor.read().ok());
        self.temperature_centi_c = reading.map(|reading| reading.temperature_centi_c);
        let is_stale = reading.is_some_and(|reading| reading.acceleration_m_s2.is_none());
        self.stale_in_a_row = if is_stale { self.stale_in_a_row.saturating_add(1) } else { 0 };
        Row {
            time: pulse.offset(-self.delay_us),
            readings: reading.and_then(|reading| reading.acceleration_m_s2).unwrap_or([f32::NAN; CHANNELS]),
            is_stale,
        }
    }

    /// The bus of a sensor that no longer answers, or takes no samples: it may have lost its supply, or the wire to its DRDY pin.
    pub fn take_lost(&mut self) -> Option<S> {
        if self.temperature_centi_c.is_some() && self.stale_in_a_row < MOST_STALE {
            return None;
        }
        self.temperature_centi_c = None;
        Some(self.sensor.take()?.release())
    }

    /// The sensor's temperature in units of 0.01 °C; `None` where none answers.
    pub fn temperature_centi_c(&self) -> Option<i16> {
        self.temperature_centi_c
    }

    /// By how much the sensor's oscillator was fast when it started, in ppm; `None` without a sensor.
    pub fn oscillator_ppm(&self) -> Option<i32> {
        self.sensor.as_ref().map(Adxl355::oscillator_ppm)
    }
}
