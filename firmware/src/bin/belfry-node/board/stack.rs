//! The stack: it lies below everything else in RAM, so that it overflows out of the RAM and not into data. It is painted at the
//! start, which shows later how far it was used.

use core::ptr::addr_of;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// What unused stack holds (cortex-m-rt, feature paint-stack).
const PAINT: u32 = 0xCCCC_CCCC;

/// Its lowest address.
pub(super) fn end() -> usize {
    addr_of!(_stack_end) as usize
}

/// Its size in bytes.
pub(super) fn size() -> u32 {
    (addr_of!(_stack_start) as usize - end()) as u32
}

/// Bytes that were never used since the start.
pub(super) fn never_used() -> u32 {
    let words = size() / 4;
    let first = addr_of!(_stack_end);
    let is_unused = |index: &u32| {
        // SAFETY: within the stack by the loop's bounds; aligned, and volatile as other frames write there.
        unsafe { first.add(*index as usize).read_volatile() == PAINT }
    };
    4 * (0..words).take_while(is_unused).count() as u32
}
