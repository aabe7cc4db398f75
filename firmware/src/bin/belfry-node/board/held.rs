//! What the interrupt that fetches samples shares with the loop: the loop holds that interrupt back alone, and all others come meanwhile. A
//! transfer on the sensor's bus takes some 20 µs, for which nothing else may wait.

use core::cell::UnsafeCell;
use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::peripheral::NVIC;
use stm32f4xx_hal::pac::Interrupt;

/// The interrupt that fetches samples: SPI2's own, which the peripheral never asks for, as nothing tells it to. The timer's handler does.
pub(super) const FETCH: Interrupt = Interrupt::SPI2;

/// Works while no sample is fetched.
pub(super) fn without_fetching<T>(work: impl FnOnce() -> T) -> T {
    let was_on = NVIC::is_enabled(FETCH);
    NVIC::mask(FETCH);
    // From here on the interrupt does not come.
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    let result = work();
    compiler_fence(Ordering::SeqCst);
    if was_on {
        // SAFETY: it was on before, and this is no critical section.
        unsafe { NVIC::unmask(FETCH) };
    }
    result
}

/// What the handler of [`FETCH`] uses, and the loop while it holds that back; nothing before it is set.
pub(super) struct Held<T>(UnsafeCell<Option<T>>);

// SAFETY: only one of the two has it at a time, as its functions say.
unsafe impl<T: Send> Sync for Held<T> {}

impl<T> Held<T> {
    pub(super) const fn new() -> Self {
        Self(UnsafeCell::new(None))
    }

    /// Sets it, from the loop.
    pub(super) fn set(&self, value: T) {
        // SAFETY: the handler does not come meanwhile, and no reference outlives a function of this type.
        without_fetching(|| unsafe { *self.0.get() = Some(value) });
    }

    /// Works with it, from the loop; not to be called from within the work.
    pub(super) fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        // SAFETY: as above.
        without_fetching(|| unsafe { (*self.0.get()).as_mut() }.map(work))
    }

    /// Works with it, from the handler.
    ///
    /// # Safety
    /// Only the handler of [`FETCH`] calls this, which does not interrupt itself.
    pub(super) unsafe fn with_in_handler<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        // SAFETY: the loop holds the handler back while it has it.
        unsafe { (*self.0.get()).as_mut() }.map(work)
    }
}
