//! The memory chip beside the sensor, and the node's store on it.

use belfry_firmware::{SpiChip, Store};
use cortex_m::peripheral::NVIC;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::gpio::Pin;
use stm32f4xx_hal::pac::Interrupt;

use super::bus::{BusError, Device, Wires};

/// The chip's end of the bus, on PB1. The loop asks the sampler for time before it uses it, so that no sample has to wait.
pub(super) struct ChipBus(Device<1>);

/// The node's store.
pub(super) type NodeStore = Store<SpiChip<ChipBus>>;

/// Opens the store; `random` is the boot id where it has none.
pub(super) fn open(wires: &'static Wires, select: Pin<'B', 1>, random: u32) -> NodeStore {
    Store::open(SpiChip::find(ChipBus(Device::new(wires, select))), random)
}

impl ErrorType for ChipBus {
    type Error = BusError;
}

impl SpiDevice for ChipBus {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), BusError> {
        let samples = NVIC::is_enabled(Interrupt::TIM2);
        NVIC::mask(Interrupt::TIM2);
        // From here on the interrupt does not come.
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        let result = self.0.transaction(operations);
        if samples {
            // SAFETY: it was on before, and this is no critical section.
            unsafe { NVIC::unmask(Interrupt::TIM2) };
        }
        result
    }
}
