//! SPI2 with what is on it: the sensor and, where the program is built for one, a memory chip. Each is an `SpiDevice` that never waits long.

use core::cell::UnsafeCell;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{Error, ErrorKind, ErrorType, MODE_0, Operation, SpiDevice};
use stm32f4xx_hal::gpio::{Output, Pin, PinState, Speed};
use stm32f4xx_hal::pac::SPI2;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::spi::Spi;

/// Clock on the bus: the sensor takes up to 10 MHz, wires of some 10 cm take 5.
const CLOCK_MHZ: u32 = 5;
/// How often to look at the flags before giving a byte up: a byte takes 300 ticks of the core, a look some 10.
const MOST_LOOKS: u32 = 1000;

/// Why a transfer failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub(crate) enum BusError {
    /// A byte did not get through in time.
    Late,
    /// The peripheral saw a fault.
    Fault,
}

impl Error for BusError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// Waits by counting ticks of the core, some 6 ns each.
pub(super) struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        cortex_m::asm::delay(ns / 6 + 1);
    }
}

/// The bus without its selects.
pub(crate) struct Wires(UnsafeCell<Spi<SPI2>>);

// SAFETY: one device uses it at a time, as `Device` says.
unsafe impl Sync for Wires {}

impl Wires {
    /// SPI2: clock on PB13, data in on PB14 and out on PB15.
    pub(crate) fn start(
        spi: SPI2,
        (clock, input, output): (Pin<'B', 13>, Pin<'B', 14>, Pin<'B', 15>),
        rcc: &mut Rcc,
    ) -> &'static Self {
        // At their lowest speed, which they have after a reset, pins are only good for 2 to 8 MHz (STM32F446xC/E data sheet, "I/O AC characteristics").
        let clock = clock.into_alternate::<5>().speed(Speed::Medium);
        let output = output.into_alternate::<5>().speed(Speed::Medium);
        let spi = Spi::new(spi, (Some(clock), Some(input), Some(output)), MODE_0, CLOCK_MHZ.MHz(), rcc);
        // This function runs once.
        let Some(wires) = cortex_m::singleton!(: Wires = Wires(UnsafeCell::new(spi))) else { panic!("started twice") };
        wires
    }
}

/// What is selected by pin `N` of port B.
///
/// The interrupt that fetches samples uses the sensor, and the loop does only while the interrupt has none. The loop uses another device only with that
/// interrupt held back. So a transaction is over before the next begins.
pub(crate) struct Device<const N: u8> {
    wires: &'static Wires,
    select: Pin<'B', N, Output>,
}

/// The sensor, on PB12.
pub(crate) type SensorBus = Device<12>;

impl<const N: u8> Device<N> {
    /// Not selected yet.
    pub(crate) fn new(wires: &'static Wires, select: Pin<'B', N>) -> Self {
        Self { wires, select: select.into_push_pull_output_in_state(PinState::High) }
    }

    fn exchange(&mut self, byte: u8) -> Result<u8, BusError> {
        // SAFETY: no other device is in a transaction, as the type says, and no reference outlives this function.
        let spi = unsafe { &mut *self.wires.0.get() };
        let mut written = false;
        for _ in 0..MOST_LOOKS {
            if !written {
                match spi.write_nonblocking(byte) {
                    Ok(()) => written = true,
                    Err(nb::Error::WouldBlock) => {}
                    Err(nb::Error::Other(_)) => return Err(BusError::Fault),
                }
            } else {
                match spi.read_nonblocking() {
                    Ok(answer) => return Ok(answer),
                    Err(nb::Error::WouldBlock) => {}
                    Err(nb::Error::Other(_)) => return Err(BusError::Fault),
                }
            }
        }
        Err(BusError::Late)
    }

    /// Takes what a transfer that was given up has left in the receiver: it would answer the next one's first byte, and put all off by one. Reading
    /// the data and then the status also ends an overrun (RM0390, "SPI error flags"); the HAL's own read leaves the data alone while there is one.
    fn drain(&mut self) {
        // What is still on the wires takes as long as a byte.
        Delay.delay_us(2 * 8 / CLOCK_MHZ + 1);
        // SAFETY: no other device is in a transaction, as the type says, and only these two registers are read.
        let registers = unsafe { &*SPI2::ptr() };
        for _ in 0..2 {
            let _ = registers.dr().read().bits();
            let _ = registers.sr().read().bits();
        }
    }

    fn run(&mut self, operation: &mut Operation<'_, u8>) -> Result<(), BusError> {
        match operation {
            Operation::Read(bytes) => bytes.iter_mut().try_for_each(|byte| {
                *byte = self.exchange(0)?;
                Ok(())
            }),
            Operation::Write(bytes) => bytes.iter().try_for_each(|&byte| self.exchange(byte).map(drop)),
            Operation::Transfer(answers, bytes) => {
                for index in 0..answers.len().max(bytes.len()) {
                    let answer = self.exchange(bytes.get(index).copied().unwrap_or(0))?;
                    if let Some(place) = answers.get_mut(index) {
                        *place = answer;
                    }
                }
                Ok(())
            }
            Operation::TransferInPlace(bytes) => bytes.iter_mut().try_for_each(|byte| {
                *byte = self.exchange(*byte)?;
                Ok(())
            }),
            Operation::DelayNs(ns) => {
                Delay.delay_ns(*ns);
                Ok(())
            }
        }
    }
}

impl<const N: u8> ErrorType for Device<N> {
    type Error = BusError;
}

impl<const N: u8> SpiDevice for Device<N> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), BusError> {
        self.select.set_low();
        let result = operations.iter_mut().try_for_each(|operation| self.run(operation));
        if result.is_err() {
            self.drain();
        }
        self.select.set_high();
        result
    }
}
