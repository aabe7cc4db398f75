//! The memory chip beside the sensor, and the node's store on it.

use belfry_firmware::{SpiChip, Store};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::gpio::Pin;

use super::bus::{BusError, Device, Wires};
use super::held::without_fetching;

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
        without_fetching(|| self.0.transaction(operations))
    }
}
