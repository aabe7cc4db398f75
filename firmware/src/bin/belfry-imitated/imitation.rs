//! The imitated accelerometer: registers of an ADXL355, and a triangular wave of 32 samples on every axis.
//!
//! The wave advances with every sample fetched. In a window its spectral lines are at multiples of one line, and nowhere else, as
//! long as no sample is skipped, fetched twice or out of order.

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::gpio::Pin;

use crate::board::bus::{BusError, SensorBus, Wires};

/// Samples of a period of the wave.
const PERIOD: u32 = 32;
/// The wave's step in digits of the sensor: amplitude 0.25 g.
const STEP: i32 = 8000;
/// The axes' waves are apart by so many samples.
const APART: u32 = 5;

const DEVID_AD: u8 = 0x00;
const TEMP2: u8 = 0x06;
const IDENTITY: [u8; 3] = [0xAD, 0x1D, 0xED];
/// 25 °C.
const TEMPERATURE: [u8; 2] = [0x07, 0x5D];

/// The bus, with an answer.
pub(crate) struct Imitation {
    bus: SensorBus,
    register: u8,
    sample: u32,
}

impl Imitation {
    /// As the bus without it.
    pub(crate) fn new(wires: &'static Wires, select: Pin<'B', 12>) -> Self {
        Self { bus: SensorBus::new(wires, select), register: 0, sample: 0 }
    }

    fn answer(&mut self, bytes: &mut [u8]) {
        bytes.fill(0);
        match self.register {
            DEVID_AD => bytes.iter_mut().zip(IDENTITY).for_each(|(byte, value)| *byte = value),
            TEMP2 => {
                let (temperature, axes) = bytes.split_at_mut(bytes.len().min(TEMPERATURE.len()));
                temperature.iter_mut().zip(TEMPERATURE).for_each(|(byte, value)| *byte = value);
                for (axis, digits) in (0..).zip(axes.chunks_mut(3)) {
                    let phase = self.sample.wrapping_add(axis * APART) % PERIOD;
                    let value = (phase.abs_diff(PERIOD / 2) as i32 - PERIOD as i32 / 4) * STEP;
                    // 20 bits, left-justified.
                    digits.iter_mut().zip((value << 12).to_be_bytes()).for_each(|(byte, value)| *byte = value);
                }
                self.sample = self.sample.wrapping_add(1);
            }
            // The status, ready, and other registers, in which nothing is of interest.
            _ => {}
        }
    }
}

impl ErrorType for Imitation {
    type Error = BusError;
}

impl SpiDevice for Imitation {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), BusError> {
        // The bytes go over the bus all the same, so that a transaction is as long as with a sensor.
        self.bus.transaction(operations)?;
        for operation in operations {
            match operation {
                Operation::Write([command, ..]) => self.register = command >> 1,
                Operation::Read(bytes) => self.answer(bytes),
                _ => {}
            }
        }
        Ok(())
    }
}
