//! Last words: why the program ended, written where a restart does not reach, and reported after it.

use core::fmt::Write;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{addr_of, addr_of_mut};

use belfry_shared::frame::crc32;
use belfry_shared::message::{Fault, FaultKind, MAX_PLACE_BYTES};
use cortex_m::peripheral::SCB;
use cortex_m_rt::ExceptionFrame;
use heapless::String;

use super::stack;

const MAGIC: u32 = 0xBE1F_0002;

#[derive(Clone, Copy)]
#[repr(C)]
struct Words {
    magic: u32,
    kind: u32,
    address: u32,
    link: u32,
    status: u32,
    length: u32,
    place: [u8; MAX_PLACE_BYTES],
    check: u32,
}

#[unsafe(link_section = ".uninit.LAST_WORDS")]
static mut WORDS: MaybeUninit<Words> = MaybeUninit::uninit();

const PANIC: u32 = 1;
const HARD_FAULT: u32 = 2;
const STACK_OVERFLOW: u32 = 3;

/// Bytes of the numbers between the magic one and the place.
const NUMBERS_BYTES: usize = 20;

impl Words {
    fn sum(&self) -> u32 {
        let mut bytes = [0; NUMBERS_BYTES + MAX_PLACE_BYTES];
        let numbers = [self.kind, self.address, self.link, self.status, self.length];
        for (place, number) in bytes.chunks_exact_mut(4).zip(numbers) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        if let Some(rest) = bytes.get_mut(NUMBERS_BYTES..) {
            rest.copy_from_slice(&self.place);
        }
        crc32(&bytes)
    }
}

/// Why the program before this one ended; the words are deleted.
pub(super) fn take() -> Option<Fault> {
    // SAFETY: called once, before anything else runs; any words are words, and volatile as the compiler cannot know them.
    let words = unsafe { addr_of!(WORDS).cast::<Words>().read_volatile() };
    // SAFETY: as above.
    unsafe { addr_of_mut!(WORDS).cast::<u32>().write_volatile(0) };
    if words.magic != MAGIC || words.check != words.sum() {
        return None;
    }
    let kind = match words.kind {
        PANIC => FaultKind::Panic,
        STACK_OVERFLOW => FaultKind::StackOverflow,
        _ => FaultKind::HardFault,
    };
    let text = words.place.get(..words.length as usize).and_then(|bytes| core::str::from_utf8(bytes).ok());
    let place = text.and_then(|text| String::try_from(text).ok()).unwrap_or_default();
    let Words { address, link, status, .. } = words;
    Some(Fault { address, place, link, status, ..Fault::from(kind) })
}

/// Writes last words and restarts.
fn end(kind: u32, [address, link, status]: [u32; 3], place: &str) -> ! {
    let length = place.len() as u32;
    let mut words = Words { magic: MAGIC, kind, address, link, status, length, place: [0; MAX_PLACE_BYTES], check: 0 };
    for (to, from) in words.place.iter_mut().zip(place.as_bytes()) {
        *to = *from;
    }
    words.check = words.sum();
    // SAFETY: nothing else runs any more.
    unsafe { addr_of_mut!(WORDS).cast::<Words>().write_volatile(words) };
    SCB::sys_reset()
}

#[panic_handler]
fn on_panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    let mut place: String<MAX_PLACE_BYTES> = String::new();
    if let Some(location) = info.location() {
        let name = location.file();
        // The end of a long name says more than its beginning.
        let tail = name.char_indices().map(|(at, _)| at).find(|at| name.len() - at <= MAX_PLACE_BYTES - 8).unwrap_or(0);
        let _ = write!(place, "{}:{}", name.get(tail..).unwrap_or(name), location.line());
    }
    end(PANIC, [0; 3], &place)
}

/// Starts with an empty stack: one that has run over has no room left to handle that.
///
/// # Safety
/// The processor calls it.
#[unsafe(no_mangle)]
#[unsafe(naked)]
unsafe extern "C" fn HardFault() -> ! {
    core::arch::naked_asm!(
        "mrs r0, msp",
        "ldr r1, =_stack_start",
        "msr msp, r1",
        "b {record}",
        record = sym record,
    )
}

/// Records a fault whose frame lies at `frame`.
extern "C" fn record(frame: usize) -> ! {
    let frame_bytes = size_of::<ExceptionFrame>();
    if frame < stack::end() + frame_bytes {
        end(STACK_OVERFLOW, [0; 3], "")
    }
    // SAFETY: within the stack, where the processor has put it.
    let frame = unsafe { &*(frame as *const ExceptionFrame) };
    // SAFETY: the register is the core's own, and is only read.
    let status = unsafe { (*SCB::PTR).cfsr.read() };
    end(HARD_FAULT, [frame.pc(), frame.lr(), status], "")
}
