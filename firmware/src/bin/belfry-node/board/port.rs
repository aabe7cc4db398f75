//! The serial port to the host: USART2, with a queue in either direction.

use core::ptr::addr_of_mut;

use belfry_firmware::{Inbox, InboxReader, InboxWriter};
use belfry_shared::frame::MAX_FRAME_BYTES;
use belfry_shared::time::NodeTime;
use heapless::spsc::{Consumer, Producer, Queue};
use stm32f4xx_hal::gpio::Pin;
use stm32f4xx_hal::pac::{Interrupt, USART2, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::serial::{Config, Error, Rx, Serial, Tx};

use super::ticks;

/// Bits a second.
const BAUD: u32 = 115_200;
/// Bytes that may wait for the line: a frame.
const TO_SEND: usize = MAX_FRAME_BYTES + 1;

/// What the interrupt has.
struct Shared {
    tx: Tx<USART2>,
    rx: Rx<USART2>,
    received: InboxWriter<'static>,
    to_send: Consumer<'static, u8>,
}

/// Only the handler uses it once its interrupt is on. A critical section would hold up sampling for as long as it sends.
static mut SHARED: Option<Shared> = None;

/// The loop's end of the port.
pub(super) struct Port {
    received: InboxReader<'static>,
    to_send: Producer<'static, u8>,
}

impl Port {
    /// Opens the port: out on PA2, in on PA3, the ST-LINK's serial port.
    pub(super) fn start(usart: USART2, pins: (Pin<'A', 2>, Pin<'A', 3>), rcc: &mut Rcc) -> Self {
        let config = Config::default().baudrate(BAUD.bps());
        // The only error is a baud rate that the clock cannot make.
        let Ok(mut serial) = Serial::<USART2>::new(usart, pins, config, rcc) else { panic!("no such baud rate") };
        serial.listen(stm32f4xx_hal::serial::Event::RxNotEmpty);
        let (tx, rx) = serial.split();
        let queues =
            (cortex_m::singleton!(: Inbox = Inbox::new()), cortex_m::singleton!(: Queue<u8, TO_SEND> = Queue::new()));
        // This function runs once.
        let (Some(inbox), Some(to_send)) = queues else { panic!("started twice") };
        let ((received_in, received), (to_send, to_send_out)) = (inbox.split(), to_send.split());
        let shared = Shared { tx, rx, received: received_in, to_send: to_send_out };
        // SAFETY: this function runs once, before the interrupt is on, and only the handler names SHARED besides.
        unsafe { addr_of_mut!(SHARED).write(Some(shared)) };
        Self { received, to_send }
    }

    /// The oldest byte that waits, and when its frame ended (now, before its end mark).
    pub(super) fn next_byte(&mut self) -> Option<(NodeTime, u8)> {
        let (time, byte) = self.received.next_byte()?;
        Some((time.unwrap_or_else(ticks::now), byte))
    }

    /// Whether no byte waits for the loop.
    pub(super) fn is_quiet(&self) -> bool {
        self.received.is_empty()
    }

    /// Frames from the host that were dropped since the start.
    pub(super) fn dropped_frames(&self) -> u32 {
        self.received.dropped_frames()
    }

    /// Whether the line has taken everything.
    pub(super) fn has_sent_all(&self) -> bool {
        self.to_send.is_empty()
    }

    /// Sends bytes, a frame at most. Call it when the line has taken everything.
    pub(super) fn send(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            // Cannot fail: a frame fits.
            let _ = self.to_send.enqueue(byte);
        }
        // The handler sends what it can. The emulated port has no interrupt for an empty transmitter that would call it.
        cortex_m::peripheral::NVIC::pend(Interrupt::USART2);
    }
}

#[interrupt]
fn USART2() {
    // SAFETY: set before the interrupt was on, and named by nothing else since; a handler does not interrupt itself.
    let Some(shared) = (unsafe { &mut *addr_of_mut!(SHARED) }) else { return };
    match shared.rx.read() {
        Ok(byte) => shared.received.push(ticks::now(), byte),
        Err(nb::Error::Other(Error::Overrun)) => shared.received.lost_bytes(),
        // Nothing has come; or a byte that the checksum of its frame will miss.
        Err(_) => {}
    }
    while let Some(&byte) = shared.to_send.peek() {
        if shared.tx.write(byte).is_err() {
            shared.tx.listen();
            return;
        }
        shared.to_send.dequeue();
    }
    shared.tx.unlisten();
}
