//! The board: its parts, and the loop that gives the node rows, bytes and time.
//!
//! Interrupts only move data: the timer's notes when a sample was taken, another reads it out of the sensor into a queue of rows ([`sampler`]), the
//! serial port's moves bytes between the line and its queues ([`port`]). They go before each other in this order: timer, serial port, sensor, as
//! the sensor's lasts longest and can wait longest. The loop below does all the work, a step at a time, and delays no sample: the few critical
//! sections are some instructions long, and what uses the sensor's bus holds only the sensor's interrupt back. A memory chip on that bus is used
//! only while there is time before the next sample. Every wait has a deadline of its own, and the watchdog covers the rest.

pub(crate) mod bus;
mod held;
mod identity;
mod last_words;
#[cfg(feature = "store")]
mod memory_chip;
mod port;
mod sampler;
mod stack;
pub(crate) mod ticks;
mod timekeeping;

use belfry_firmware::{Memory, Node};
use belfry_shared::adxl355::correction_per_hz2;
use belfry_shared::frame::MAX_FRAME_BYTES;
use belfry_shared::message::{BoardState, Fault, FaultKind, RefusalReason};
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::{entry, exception};
use defmt_rtt as _;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{Config, Rcc};
use stm32f4xx_hal::watchdog::IndependentWatchdog;
use stm32f4xx_hal::{pac, time::Hertz};

use sampler::Sampler;

/// Clock of the core.
const CORE: Hertz = Hertz::MHz(168);
/// The board's clock, which comes from the ST-LINK.
const EXTERNAL: Hertz = Hertz::MHz(8);
/// How often to look at the external clock's ready flag before giving it up: some 20 ms at 16 MHz.
const EXTERNAL_LOOKS: u32 = 50_000;
/// The loop must come round within this time, in ms.
const WATCHDOG_MS: u32 = 2000;
/// The loop comes round at least this often, in ticks of the core's clock.
const WAKE_TICKS: u32 = 8_000_000;

/// The longest step of the store: `STEP_BYTES` and a few commands on the bus, 2.6 µs a byte, and half as much again.
#[cfg(feature = "store")]
const STORE_STEP_US: u32 = 160;

/// The node's memory; all zeros, so that it takes no flash.
static mut MEMORY: Memory = Memory::new();

#[entry]
fn run() -> ! {
    let ended = last_words::take();
    let (Some(mut core), Some(device)) = (cortex_m::Peripherals::take(), pac::Peripherals::take()) else {
        // Both are taken once, here.
        panic!("started twice");
    };
    let was_watchdog = device.RCC.csr().read().wdgrstf().bit_is_set();
    device.RCC.csr().modify(|_, w| w.rmvf().set_bit());
    let mut watchdog = IndependentWatchdog::new(device.IWDG);
    watchdog.start(WATCHDOG_MS.millis());

    let is_emulated = identity::is_emulated();
    let (mut rcc, has_external) = clocks(device.RCC, is_emulated);
    ticks::start(device.TIM5, &mut rcc, is_emulated);
    let (port_a, port_b) = (device.GPIOA.split(&mut rcc), device.GPIOB.split(&mut rcc));
    let wires = bus::Wires::start(device.SPI2, (port_b.pb13, port_b.pb14, port_b.pb15), &mut rcc);
    let bus = crate::Bus::new(wires, port_b.pb12);
    #[cfg(feature = "store")]
    let store = {
        watchdog.feed();
        memory_chip::open(wires, port_b.pb1, identity::random_boot())
    };
    let mut sampler = Sampler::start(device.TIM2, port_b.pb10, bus, &mut rcc, is_emulated);
    let mut port = port::Port::start(device.USART2, (port_a.pa2, port_a.pa3), &mut rcc);
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(WAKE_TICKS);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
    // SAFETY: all that the interrupts use has been set up. The chip has the upper four bits of a priority (RM0390, "Nested vectored interrupt controller").
    unsafe {
        core.NVIC.set_priority(pac::Interrupt::TIM2, 0);
        core.NVIC.set_priority(pac::Interrupt::USART2, 0x10);
        core.NVIC.set_priority(held::FETCH, 0x20);
        core.SCB.set_priority(SystemHandler::SysTick, 0x30);
        for interrupt in [pac::Interrupt::TIM2, pac::Interrupt::USART2, held::FETCH] {
            cortex_m::peripheral::NVIC::unmask(interrupt);
        }
    }

    // SAFETY: this function runs once and never returns, and nothing else names MEMORY.
    let memory: &'static mut Memory = unsafe { &mut *core::ptr::addr_of_mut!(MEMORY) };
    #[cfg(not(feature = "store"))]
    let mut node = Node::new(identity::identity(identity::random_boot()), memory);
    #[cfg(feature = "store")]
    let (mut node, store_fault) = {
        let fault = (!store.has_chip()).then_some(FaultKind::Store);
        (Node::with_store(identity::identity(store.boot()), memory, store), fault)
    };
    #[cfg(not(feature = "store"))]
    let store_fault = None;
    node.set_correction(correction_per_hz2);
    let watchdog_fault = was_watchdog.then_some(FaultKind::Watchdog);
    let key_fault = match identity::key(node.identity().node) {
        Ok(None) => None,
        Ok(key) => {
            node.set_key(key);
            None
        }
        Err(_) => {
            node.set_key(None);
            Some(FaultKind::Key)
        }
    };
    let clock_fault = (!has_external).then_some(FaultKind::Clock);
    if clock_fault.is_some() {
        // Off by 1 % (STM32F446xC/E data sheet, "HSI oscillator characteristics"): frequencies would be as wrong, and windows drift off the grid.
        node.refuse_to_measure(RefusalReason::Clock);
    }
    // What ended the last life says most, and has a place.
    let kinds = [key_fault, watchdog_fault, clock_fault, store_fault];
    let mut kinds = kinds.into_iter().flatten();
    if let Some(mut fault) = ended.or_else(|| kinds.next().map(Fault::from)) {
        fault.further = kinds.collect();
        defmt::warn!("restarted: {}", fault);
        node.report_fault(fault);
    }
    defmt::info!("node {} runs, emulated: {}", node.identity().node, is_emulated);

    let mut longest_us = 0;
    let mut last_look = ticks::now();
    let mut frame = [0; MAX_FRAME_BYTES];
    loop {
        watchdog.feed();
        let now = ticks::now();
        longest_us = now.since(last_look).max(longest_us);
        last_look = now;
        while let Some(row) = sampler.next_row() {
            if row.is_stale {
                node.stale(row.time);
            } else {
                node.sample(row.time, &row.readings);
            }
        }
        while let Some((time, byte)) = port.next_byte() {
            node.receive(time, byte);
        }
        sampler.follow(node.sampling_rate_uhz());
        let worked = node.poll(now);
        #[cfg(feature = "store")]
        let worked = (sampler.has_time(STORE_STEP_US) && node.keep(now)) | worked;
        if port.has_sent_all() && node.has_bytes() {
            let (latest_sample_ns, longest_fetch_us) = sampler.latest();
            let (temperature_centi_c, oscillator_ppm) = sampler.sensor();
            node.report_board(BoardState {
                stack_bytes: stack::size(),
                stack_free_bytes: stack::never_used(),
                longest_step_us: u32::try_from(longest_us).unwrap_or(u32::MAX),
                latest_sample_ns,
                temperature_centi_c,
                dropped_frames: port.dropped_frames(),
                oscillator_ppm,
                longest_fetch_us,
            });
            let count = node.transmit(ticks::now(), &mut frame);
            port.send(frame.get(..count).unwrap_or(&[]));
        }
        if !worked {
            // Interrupts give the node no bytes to send, so they may come meanwhile.
            let has_bytes = node.has_bytes();
            // With interrupts held back, none can slip in between the look and the sleep. One that waits ends the sleep.
            cortex_m::interrupt::free(|_| {
                if sampler.is_empty() && port.is_quiet() && !(has_bytes && port.has_sent_all()) {
                    cortex_m::asm::wfi();
                }
            });
            // Sleep does not count as a step.
            last_look = ticks::now();
        }
    }
}

/// Full speed from the board's 8 MHz if that clock runs, else from the chip's own oscillator; and whether it runs.
fn clocks(rcc: pac::RCC, is_emulated: bool) -> (Rcc, bool) {
    if is_emulated {
        // The emulator has no clocks that become ready.
        return (rcc.freeze(Config::hsi()), true);
    }
    rcc.cr().modify(|_, w| w.hsebyp().set_bit().hseon().set_bit());
    let has_external = (0..EXTERNAL_LOOKS).any(|_| rcc.cr().read().hserdy().bit_is_set());
    let source = if has_external { Config::hse(EXTERNAL).bypass_hse_oscillator() } else { Config::hsi() };
    (rcc.freeze(source.sysclk(CORE)), has_external)
}

/// Wakes the loop.
#[exception]
fn SysTick() {}

/// No other interrupt is on.
#[exception]
unsafe fn DefaultHandler(number: i16) {
    panic!("interrupt {number}");
}

defmt::timestamp!("{=u64:us}", ticks::now().0);
