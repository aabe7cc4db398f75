//! The node's time: microseconds since the start, from TIM5.

use core::cell::Cell;

use belfry_shared::time::NodeTime;
use critical_section::Mutex;
use stm32f4xx_hal::pac;
use stm32f4xx_hal::rcc::{Enable, Rcc, Reset};

/// Clock of the emulator's timers, whatever the registers say.
pub(super) const EMULATED_TIMER_HZ: u32 = 1_000_000_000;

/// The count at the last look, and how often it had run over.
static SEEN: Mutex<Cell<(u32, u32)>> = Mutex::new(Cell::new((0, 0)));

/// Clock of the timers on the slow bus.
pub(super) fn timer_hz(rcc: &Rcc, is_emulated: bool) -> u32 {
    if is_emulated { EMULATED_TIMER_HZ } else { rcc.clocks.timclk1().raw() }
}

/// Starts the clock.
pub(super) fn start(timer: pac::TIM5, rcc: &mut Rcc, is_emulated: bool) {
    pac::TIM5::enable(rcc);
    pac::TIM5::reset(rcc);
    let prescaler = timer_hz(rcc, is_emulated) / 1_000_000 - 1;
    timer.psc().write(|w| w.psc().set(prescaler as u16));
    // SAFETY: every value is possible.
    timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
}

/// The time. Call it at least every 71 minutes, after which the count overflows.
pub(crate) fn now() -> NodeTime {
    critical_section::with(|section| {
        // SAFETY: TIM5 is this module's, and its count is only read.
        let count = unsafe { (*pac::TIM5::ptr()).cnt().read().bits() };
        let seen = SEEN.borrow(section);
        let (last, over) = seen.get();
        let over = if count < last { over.wrapping_add(1) } else { over };
        seen.set((count, over));
        NodeTime(u64::from(over) << 32 | u64::from(count))
    })
}
