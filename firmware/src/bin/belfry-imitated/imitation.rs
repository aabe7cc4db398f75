//! The imitated accelerometer: registers of an ADXL355, and a triangular wave of 32 samples on every axis.
//!
//! The wave advances with every sample fetched. In a window its spectral lines are at multiples of one line, and nowhere else, as
//! long as no sample is skipped, fetched twice or out of order.

use cortex_m::peripheral::NVIC;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::gpio::Pin;
use stm32f4xx_hal::pac::Interrupt;

use crate::board::bus::{BusError, SensorBus, Wires};
use crate::board::ticks;

/// Samples of a period of the wave.
const PERIOD: u32 = 32;
/// The wave's step in digits of the sensor: amplitude 0.25 g.
const STEP: i32 = 8000;
/// The axes' waves are apart by so many samples.
const APART: u32 = 5;

const DEVID_AD: u8 = 0x00;
const STATUS: u8 = 0x04;
const SYNC: u8 = 0x2B;
const DATA_READY: u8 = 0x01;
/// External synchronisation, with interpolation.
const EXTERNAL: u8 = 0x02;
/// Before it is synchronised it makes samples by itself, at 62.5 Hz.
const PERIOD_US: u64 = 16_000;
const IDENTITY: [u8; 3] = [0xAD, 0x1D, 0xED];
/// Looks at whether an interrupt has come that comes at once.
const LOOKS: u32 = 100;
/// 25 °C.
const TEMPERATURE: [u8; 2] = [0x07, 0x5D];

/// The bus, with an answer.
pub(crate) struct Imitation {
    bus: SensorBus,
    register: u8,
    sample: u32,
    is_external: bool,
    /// The last sample that it made by itself.
    own_sample: u64,
}

impl Imitation {
    /// As the bus without it.
    pub(crate) fn new(wires: &'static Wires, select: Pin<'B', 12>) -> Self {
        Self { bus: SensorBus::new(wires, select), register: 0, sample: 0, is_external: false, own_sample: 0 }
    }

    fn answer(&mut self, bytes: &mut [u8]) {
        bytes.fill(0);
        match self.register {
            DEVID_AD => bytes.iter_mut().zip(IDENTITY).for_each(|(byte, value)| *byte = value),
            STATUS if bytes.len() > 1 => {
                let own_sample = ticks::now().0 / PERIOD_US;
                let is_ready = self.is_external || own_sample != self.own_sample;
                self.own_sample = own_sample;
                let (head, axes) = bytes.split_at_mut(bytes.len().min(4));
                let values = [if is_ready { DATA_READY } else { 0 }, 0, TEMPERATURE[0], TEMPERATURE[1]];
                head.iter_mut().zip(values).for_each(|(byte, value)| *byte = value);
                for (axis, digits) in (0..).zip(axes.chunks_mut(3)) {
                    let phase = self.sample.wrapping_add(axis * APART) % PERIOD;
                    let value = (phase.abs_diff(PERIOD / 2) as i32 - PERIOD as i32 / 4) * STEP;
                    // 20 bits, left-justified.
                    digits.iter_mut().zip((value << 12).to_be_bytes()).for_each(|(byte, value)| *byte = value);
                }
                if self.is_external {
                    self.sample = self.sample.wrapping_add(1);
                }
            }
            // The status while it starts, and other registers, in which nothing is of interest.
            _ => {}
        }
    }
}

/// A transaction lasts as long as two bits of the serial port, and one that holds its interrupt back costs it bytes at higher baud rates: the program
/// stops itself where the interrupt does not come at once. It bears being called without a reason.
fn assert_serial_port_is_heard() {
    if NVIC::is_enabled(Interrupt::USART2) {
        NVIC::pend(Interrupt::USART2);
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        // A byte that has come just now may ask for it once more.
        let is_heard = (0..LOOKS).any(|_| !NVIC::is_pending(Interrupt::USART2));
        assert!(is_heard, "the sensor's bus holds the serial port up");
    }
}

impl ErrorType for Imitation {
    type Error = BusError;
}

impl SpiDevice for Imitation {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), BusError> {
        // The bytes go over the bus all the same, so that a transaction is as long as with a sensor.
        self.bus.transaction(operations)?;
        assert_serial_port_is_heard();
        for operation in operations {
            match operation {
                Operation::Write([command, rest @ ..]) => {
                    self.register = command >> 1;
                    if let (SYNC, [value, ..]) = (self.register, rest) {
                        self.is_external = *value == EXTERNAL;
                    }
                }
                Operation::Read(bytes) => self.answer(bytes),
                _ => {}
            }
        }
        Ok(())
    }
}
