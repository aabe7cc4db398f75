//! Sampling: TIM2 gives the sensor its synchronisation pulse and the processor its interrupt, so that nothing in the program
//! moves a sample in time.
//!
//! The timer's interrupt goes before all others, takes some hundred instructions, and asks for the one that fetches the sample. That goes after the
//! serial port's: a fetch takes some 20 µs on the bus, and the sample waits in the sensor until half a period after its pulse. Every heartbeat
//! reports the timer's longest delay, and the longest time until a sample was fetched.

use core::cell::RefCell;

use belfry_firmware::adxl355::{self, Adxl355};
use belfry_firmware::sampling::{Fetcher, Row};
use belfry_shared::time::NodeTime;
use critical_section::Mutex;
use heapless::spsc::{Consumer, Producer, Queue};
use stm32f4xx_hal::gpio::{Alternate, Pin, Speed};
use stm32f4xx_hal::pac::{TIM2, interrupt};
use stm32f4xx_hal::rcc::{Enable, Rcc, Reset};

use super::bus::Delay;
use super::held::{FETCH, Held};
use super::ticks;
use super::timekeeping::Timekeeping;
use crate::Bus;

/// Rows that may wait for the loop: 28 ms at 1000 Hz.
const ROWS: usize = 28;
/// Time between looks for an absent sensor, in µs.
const LOOK_AGAIN_US: i64 = 2_000_000;

/// What the timer's interrupt has.
struct Timing {
    period: Period,
    timekeeping: Timekeeping,
    /// When the last one came.
    pulse: NodeTime,
}

static TIMING: Mutex<RefCell<Option<Timing>>> = Mutex::new(RefCell::new(None));

/// Works with what the timer's interrupt has. No interrupt comes meanwhile, so the work is to be short.
fn with_timing<T>(work: impl FnOnce(&mut Timing) -> T) -> Option<T> {
    critical_section::with(|section| TIMING.borrow_ref_mut(section).as_mut().map(work))
}

/// What the interrupt that fetches has.
struct Fetching {
    fetcher: Fetcher<Bus>,
    rows: Producer<'static, Row>,
    longest_fetch_us: u32,
}

static FETCHING: Held<Fetching> = Held::new();

/// The sampling period in ticks of the timer, exact on average: a period is a tick longer whenever the fractions left over add
/// up to one.
#[derive(Debug, Clone, Copy, Default)]
struct Period {
    ticks: u32,
    /// Fraction of a tick left over each time, in units of 1 / `whole`.
    fraction: u64,
    whole: u64,
    gathered: u64,
    half_us: i64,
}

impl Period {
    fn of(rate_uhz: u64, timer_hz: u32) -> Self {
        let (rate, ticks) = (rate_uhz.max(1), u64::from(timer_hz) * 1_000_000);
        Self {
            ticks: u32::try_from(ticks / rate).unwrap_or(u32::MAX).max(2),
            fraction: ticks % rate,
            whole: rate,
            gathered: 0,
            half_us: i64::try_from(500_000_000_000 / rate).unwrap_or(0),
        }
    }

    /// Ticks of the next period.
    fn next(&mut self) -> u32 {
        self.gathered += self.fraction;
        if self.gathered >= self.whole {
            self.gathered -= self.whole;
            self.ticks.saturating_add(1)
        } else {
            self.ticks
        }
    }
}

/// The pin of the pulses, PB10. The sensor's end of the wire is an output until the sensor is told that it is an input.
enum PulsePin {
    Off(Pin<'B', 10>),
    On(Pin<'B', 10, Alternate<1>>),
}

/// The loop's end of sampling.
pub(super) struct Sampler {
    timer: TIM2,
    timer_hz: u32,
    rows: Consumer<'static, Row>,
    rate_uhz: Option<u64>,
    pin: Option<PulsePin>,
    bus: Option<Bus>,
    looked: Option<NodeTime>,
}

impl Sampler {
    /// Sets up the timer, whose pulses leave at PB10 for the sensor's DRDY pin once it listens. Nothing is sampled yet.
    pub(super) fn start(timer: TIM2, pulse: Pin<'B', 10>, bus: Bus, rcc: &mut Rcc, is_emulated: bool) -> Self {
        TIM2::enable(rcc);
        TIM2::reset(rcc);
        // Channel 3 rises in the middle of a period (PWM mode 2) and falls at its end, where the interrupt reads the sample.
        timer.ccmr2_output().write(|w| w.oc3m().pwm_mode2().oc3pe().set_bit());
        timer.ccer().write(|w| w.cc3e().set_bit());
        let queue = cortex_m::singleton!(: Queue<Row, ROWS> = Queue::new());
        // This function runs once.
        let Some(queue) = queue else { panic!("started twice") };
        let (producer, rows) = queue.split();
        FETCHING.set(Fetching { fetcher: Fetcher::NONE, rows: producer, longest_fetch_us: 0 });
        let timekeeping = Timekeeping::new(is_emulated);
        let timing = Timing { period: Period::default(), timekeeping, pulse: ticks::now() };
        critical_section::with(|section| TIMING.borrow_ref_mut(section).replace(timing));
        let timer_hz = ticks::timer_hz(rcc, is_emulated);
        let pin = Some(PulsePin::Off(pulse));
        Self { timer, timer_hz, rows, rate_uhz: None, pin, bus: Some(bus), looked: None }
    }

    /// Whether the sensor's bus is free for so many µs before the next sample comes.
    #[cfg(feature = "store")]
    pub(super) fn has_time(&self, us: u32) -> bool {
        // Where counts run on, in the emulator, nothing takes the bus for long.
        if self.rate_uhz.is_none() || with_timing(|timing| timing.timekeeping.counts_from_zero()) != Some(true) {
            return true;
        }
        let (end, count) = (self.timer.arr().read().bits(), self.timer.cnt().read().bits());
        end.saturating_sub(count) > us.saturating_mul(self.timer_hz / 1_000_000)
    }

    /// Samples at a rate in µHz, or not at all. Call it every time the loop comes round, with what the node wants.
    pub(super) fn follow(&mut self, rate_uhz: Option<u64>) {
        self.look_for_sensor(rate_uhz);
        if rate_uhz == self.rate_uhz {
            return;
        }
        self.rate_uhz = rate_uhz;
        self.timer.cr1().write(|w| w.cen().clear_bit());
        self.timer.dier().write(|w| w.uie().clear_bit());
        let Some(rate) = rate_uhz else { return };
        let mut period = Period::of(rate, self.timer_hz);
        let reload = period.next() - 1;
        let untold = FETCHING.with(|fetching| fetching.fetcher.set_rate(milli(rate)).err());
        if let Some((error, bus)) = untold.flatten() {
            // It may still be in standby; the next look starts it again.
            defmt::warn!("the sensor takes no rate: {}", error);
            self.bus = Some(bus);
        }
        // SAFETY: every value is possible.
        self.timer.ccr3().write(|w| unsafe { w.bits(reload / 2) });
        let start = self.timer.cnt().read().bits();
        // SAFETY: as above.
        self.timer.arr().write(|w| unsafe { w.bits(reload) });
        let counts_from_zero = with_timing(|timing| {
            timing.period = period;
            timing.timekeeping.begin(start, reload);
            timing.timekeeping.counts_from_zero()
        });
        if counts_from_zero == Some(true) {
            self.timer.egr().write(|w| w.ug().set_bit());
        }
        self.timer.sr().write(|w| w.uif().clear_bit());
        self.timer.dier().write(|w| w.uie().set_bit());
        self.timer.cr1().write(|w| w.arpe().set_bit().cen().set_bit());
    }

    /// Starts a sensor that does not run: it may have been connected late, or have lost its supply.
    fn look_for_sensor(&mut self, rate_uhz: Option<u64>) {
        let now = ticks::now();
        if self.looked.is_some_and(|looked| now.since(looked) < LOOK_AGAIN_US) {
            return;
        }
        self.looked = Some(now);
        if let Some(bus) = FETCHING.with(|fetching| fetching.fetcher.take_lost()).flatten() {
            self.bus = Some(bus);
        }
        let Some(bus) = self.bus.take() else { return };
        self.set_pulses(false);
        let rate_mhz = rate_uhz.map_or(adxl355::HIGHEST_RATE_MHZ, milli);
        match Adxl355::start(bus, &mut Delay, &mut || ticks::now().0, rate_mhz) {
            Ok(sensor) => {
                defmt::info!("the sensor answers, its oscillator {} ppm fast", sensor.oscillator_ppm());
                FETCHING.with(|fetching| fetching.fetcher.set_sensor(sensor));
                self.set_pulses(true);
            }
            Err((error, bus)) => {
                defmt::debug!("no sensor: {}", error);
                self.bus = Some(bus);
            }
        }
    }

    /// Lets the pulses out of the pin, or makes an input of it.
    fn set_pulses(&mut self, are_on: bool) {
        self.pin = self.pin.take().map(|pin| match (pin, are_on) {
            (PulsePin::Off(pin), true) => PulsePin::On(pin.into_alternate::<1>().speed(Speed::Medium)),
            (PulsePin::On(pin), false) => PulsePin::Off(pin.into_input()),
            (pin, _) => pin,
        });
    }

    /// The oldest waiting row.
    pub(super) fn next_row(&mut self) -> Option<Row> {
        self.rows.dequeue()
    }

    /// Whether no row waits.
    pub(super) fn is_empty(&self) -> bool {
        !self.rows.ready()
    }

    /// The sensor's temperature in units of 0.01 °C, and by how many ppm its oscillator was fast; `None` where there is no sensor.
    pub(super) fn sensor(&self) -> (Option<i16>, Option<i32>) {
        let told = FETCHING.with(|Fetching { fetcher, .. }| (fetcher.temperature_centi_c(), fetcher.oscillator_ppm()));
        told.unwrap_or((None, None))
    }

    /// Longest delay of an interrupt since the start, in ns, and the longest time until a sample was fetched, in µs.
    pub(super) fn latest(&self) -> (u32, u32) {
        let ticks = with_timing(|timing| timing.timekeeping.latest_ticks()).unwrap_or(0);
        let longest_fetch_us = FETCHING.with(|fetching| fetching.longest_fetch_us).unwrap_or(0);
        let ns = u64::from(ticks) * 1_000_000_000 / u64::from(self.timer_hz.max(1));
        (u32::try_from(ns).unwrap_or(u32::MAX), longest_fetch_us)
    }
}

fn milli(rate_uhz: u64) -> u32 {
    u32::try_from(rate_uhz / 1000).unwrap_or(u32::MAX)
}

#[interrupt]
fn TIM2() {
    // SAFETY: the timer's registers are written here and, with its interrupt off, in `follow`.
    let timer = unsafe { &*TIM2::ptr() };
    // First of all: anything before it would count as delay.
    let count = timer.cnt().read().bits();
    timer.sr().write(|w| w.uif().clear_bit());
    with_timing(|timing| {
        timing.pulse = ticks::now();
        let reload = timing.period.next() - 1;
        // Only where it changes: the emulator begins a period with every write.
        if timer.arr().read().bits() != reload {
            // SAFETY: every value is possible; it counts from the next period on.
            timer.arr().write(|w| unsafe { w.bits(reload) });
        }
        timing.timekeeping.note(count, reload);
    });
    cortex_m::peripheral::NVIC::pend(FETCH);
}

/// Fetches a sample; the timer's handler asks for it.
#[interrupt]
fn SPI2() {
    let Some((pulse, half_us)) = with_timing(|timing| (timing.pulse, timing.period.half_us)) else { return };
    let work = |fetching: &mut Fetching| {
        let row = fetching.fetcher.fetch(pulse.offset(-half_us));
        // If the queue is full, the node misses the row by its time and counts it.
        let _ = fetching.rows.enqueue(row);
        fetching.longest_fetch_us = fetching.longest_fetch_us.max(ticks::now().since(pulse) as u32);
    };
    // SAFETY: this is the handler.
    let _ = unsafe { FETCHING.with_in_handler(work) };
}
