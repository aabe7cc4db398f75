//! Sampling: TIM2 gives the sensor its synchronisation pulse and the processor its interrupt, so that nothing in the program
//! moves a sample in time.
//!
//! The interrupt goes before all others and only fetches the sample. Every heartbeat reports its longest delay: after half a
//! period the sensor would have made its next sample already.

use core::cell::RefCell;

use belfry_firmware::adxl355::{self, Adxl355, CHANNELS, Reading};
use belfry_shared::time::NodeTime;
use critical_section::Mutex;
use heapless::spsc::{Consumer, Producer, Queue};
use stm32f4xx_hal::gpio::Pin;
use stm32f4xx_hal::pac::{TIM2, interrupt};
use stm32f4xx_hal::rcc::{Enable, Rcc, Reset};

use super::bus::Delay;
use super::ticks;
use crate::Bus;

/// Rows that may wait for the loop: 28 ms at 1000 Hz.
const ROWS: usize = 28;
/// Time between looks for an absent sensor, in µs.
const LOOK_AGAIN_US: i64 = 2_000_000;

/// A row of readings and when it was sampled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub(super) time: NodeTime,
    /// In m/s²; NaN where there was none.
    pub(super) readings: [f32; CHANNELS],
}

/// What the interrupt has.
struct Shared {
    sensor: Option<Adxl355<Bus>>,
    rows: Producer<'static, Row>,
    period: Period,
    lateness: Lateness,
    is_emulated: bool,
    temperature_centi_c: Option<i16>,
}

static SHARED: Mutex<RefCell<Option<Shared>>> = Mutex::new(RefCell::new(None));

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

/// Delay of interrupts by the timer's own count, which starts at 0 with every period.
#[derive(Debug, Clone, Copy, Default)]
struct Lateness {
    latest_ticks: u32,
    /// In the emulator: the count when the next interrupt is due, and how late the last one was.
    due: u32,
    last_ticks: i32,
}

impl Lateness {
    fn note(&mut self, count: u32) {
        self.latest_ticks = self.latest_ticks.max(count);
    }

    /// The same in the emulator, whose counts run on and whose alarms may be late: a period that begins late ends late. A delay
    /// that neighbours share is the alarm's; an interrupt that the program held up is later than the one after it.
    fn note_emulated(&mut self, count: u32, reload: u32) {
        let late = count.wrapping_sub(self.due) as i32;
        let alike = late.min(self.last_ticks);
        self.latest_ticks = self.latest_ticks.max(self.last_ticks.abs_diff(alike));
        self.last_ticks = late.wrapping_sub(alike);
        self.due = self.due.wrapping_add_signed(alike).wrapping_add(reload);
    }
}

/// The loop's end of sampling.
pub(super) struct Sampler {
    timer: TIM2,
    timer_hz: u32,
    is_emulated: bool,
    rows: Consumer<'static, Row>,
    rate_uhz: Option<u64>,
    bus: Option<Bus>,
    looked: Option<NodeTime>,
}

impl Sampler {
    /// Sets up the timer, whose pulses leave at PB10 for the sensor's DRDY pin. Nothing is sampled yet.
    pub(super) fn start(timer: TIM2, pulse: Pin<'B', 10>, bus: Bus, rcc: &mut Rcc, is_emulated: bool) -> Self {
        let _ = pulse.into_alternate::<1>();
        TIM2::enable(rcc);
        TIM2::reset(rcc);
        // Channel 3 rises in the middle of a period (PWM mode 2) and falls at its end, where the interrupt reads the sample.
        timer.ccmr2_output().write(|w| w.oc3m().pwm_mode2().oc3pe().set_bit());
        timer.ccer().write(|w| w.cc3e().set_bit());
        let queue = cortex_m::singleton!(: Queue<Row, ROWS> = Queue::new());
        // This function runs once.
        let Some(queue) = queue else { panic!("started twice") };
        let (producer, rows) = queue.split();
        let shared = Shared {
            sensor: None,
            rows: producer,
            period: Period::default(),
            lateness: Lateness::default(),
            is_emulated,
            temperature_centi_c: None,
        };
        critical_section::with(|section| SHARED.borrow_ref_mut(section).replace(shared));
        let timer_hz = ticks::timer_hz(rcc, is_emulated);
        Self { timer, timer_hz, is_emulated, rows, rate_uhz: None, bus: Some(bus), looked: None }
    }

    /// Whether the sensor's bus is free for so many µs before the next sample comes.
    #[cfg(feature = "store")]
    pub(super) fn has_time(&self, us: u32) -> bool {
        // In the emulator counts run on, and nothing takes the bus for long.
        if self.rate_uhz.is_none() || self.is_emulated {
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
        let untold = critical_section::with(|section| {
            let mut shared = SHARED.borrow_ref_mut(section);
            let shared = shared.as_mut()?;
            shared.period = period;
            let error = shared.sensor.as_mut()?.set_rate(milli(rate)).err()?;
            Some((error, shared.sensor.take()?))
        });
        if let Some((error, sensor)) = untold {
            // It may still be in standby; the next look starts it again.
            defmt::warn!("the sensor takes no rate: {}", error);
            self.bus = Some(sensor.release());
        }
        // SAFETY: every value is possible.
        self.timer.ccr3().write(|w| unsafe { w.bits(reload / 2) });
        let start = self.timer.cnt().read().bits();
        // SAFETY: as above.
        self.timer.arr().write(|w| unsafe { w.bits(reload) });
        // In the emulator, writing ARR has set the alarm; restarting the count would add its clock to every period.
        if !self.is_emulated {
            self.timer.egr().write(|w| w.ug().set_bit());
        }
        critical_section::with(|section| {
            if let Some(shared) = SHARED.borrow_ref_mut(section).as_mut() {
                (shared.lateness.due, shared.lateness.last_ticks) = (start.wrapping_add(reload), 0);
            }
        });
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
        let lost = critical_section::with(|section| {
            let mut shared = SHARED.borrow_ref_mut(section);
            // A temperature is there as long as the sensor answers.
            shared.as_mut().filter(|shared| shared.temperature_centi_c.is_none())?.sensor.take()
        });
        if let Some(sensor) = lost {
            self.bus = Some(sensor.release());
        }
        let Some(bus) = self.bus.take() else { return };
        match Adxl355::start(bus, &mut Delay, rate_uhz.map_or(adxl355::HIGHEST_RATE_MHZ, milli)) {
            Ok(mut sensor) => {
                let temperature_centi_c = sensor.read().ok().map(|reading| reading.temperature_centi_c);
                critical_section::with(|section| {
                    if let Some(shared) = SHARED.borrow_ref_mut(section).as_mut() {
                        shared.sensor = Some(sensor);
                        shared.temperature_centi_c = temperature_centi_c;
                    }
                });
                defmt::info!("the sensor answers");
            }
            Err((error, bus)) => {
                defmt::debug!("no sensor: {}", error);
                self.bus = Some(bus);
            }
        }
    }

    /// The oldest waiting row.
    pub(super) fn next_row(&mut self) -> Option<Row> {
        self.rows.dequeue()
    }

    /// Whether no row waits.
    pub(super) fn is_empty(&self) -> bool {
        !self.rows.ready()
    }

    /// The sensor's temperature in units of 0.01 °C; `None` where there is no sensor.
    pub(super) fn temperature_centi_c(&self) -> Option<i16> {
        critical_section::with(|section| SHARED.borrow_ref(section).as_ref()?.temperature_centi_c)
    }

    /// Longest delay of an interrupt since the start, in ns.
    pub(super) fn latest_ns(&self) -> u32 {
        let latest =
            critical_section::with(|section| SHARED.borrow_ref(section).as_ref().map(|shared| shared.lateness));
        let ticks = latest.map_or(0, |lateness| lateness.latest_ticks);
        u32::try_from(u64::from(ticks) * 1_000_000_000 / u64::from(self.timer_hz.max(1))).unwrap_or(u32::MAX)
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
    critical_section::with(|section| {
        timer.sr().write(|w| w.uif().clear_bit());
        let mut shared = SHARED.borrow_ref_mut(section);
        let Some(shared) = shared.as_mut() else { return };
        let time = ticks::now().offset(-shared.period.half_us);
        let reload = shared.period.next() - 1;
        // Only where it changes: the emulator begins a period with every write.
        if timer.arr().read().bits() != reload {
            // SAFETY: every value is possible; it counts from the next period on.
            timer.arr().write(|w| unsafe { w.bits(reload) });
        }
        if shared.is_emulated {
            shared.lateness.note_emulated(count, reload);
        } else {
            shared.lateness.note(count);
        }
        let reading = shared.sensor.as_mut().and_then(|sensor| sensor.read().ok());
        shared.temperature_centi_c = reading.map(|reading: Reading| reading.temperature_centi_c);
        let readings = reading.map_or([f32::NAN; CHANNELS], |reading| reading.acceleration_m_s2);
        // If the queue is full, the node misses the row by its time and counts it.
        let _ = shared.rows.enqueue(Row { time, readings });
    });
}
