//! A simulated ADXL355 at the level of its registers, with time of its own: an oscillator that is off, the filters that hang on it, noise, offset and
//! drift. It answers on a simulated bus, whose bytes take time, and takes samples when it is given pulses.
//!
//! Motion is a sum of tones, so that the decimation filter need not be run at the rate of the modulator: a tone passes it with its attenuation and
//! its delay. Of the interpolation filter, what the data sheet says is simulated as it is: 64 values for one, by a third-order sinc.

use core::cell::RefCell;
use core::convert::Infallible;
use core::f64::consts::{PI, TAU};
use std::rc::Rc;
use std::vec::Vec;

use belfry_shared::adxl355::{delay_ns, odr_hz, period_ns};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};

use super::{CHANNELS, register};

/// Values of the interpolation filter for one of the decimation filter.
const STEPS: u64 = belfry_shared::adxl355::INTERPOLATION;
/// Digits for 1 m/s².
const DIGITS: f64 = 256_000.0 / 9.806_65;
/// A byte on the bus at 5 MHz, in s.
const BYTE_S: f64 = 1.6e-6;
/// The fuses are read within this time after a reset, in s.
const FUSES_S: f64 = 1.5e-3;
const FIFO_ENTRIES: usize = 96;

/// A tone of the motion, along all axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tone {
    pub(crate) frequency_hz: f64,
    pub(crate) amplitude_m_s2: f64,
    /// Of a cosine, at time 0.
    pub(crate) phase: f64,
}

/// What is particular about a sensor.
#[derive(Debug, Clone)]
pub(crate) struct Traits {
    /// By how much the oscillator is fast (0.02: 2 %), and by how much more for each kelvin.
    pub(crate) oscillator: f64,
    pub(crate) oscillator_per_k: f64,
    /// How much a millisecond of the oscillator scatters, in s.
    pub(crate) oscillator_jitter_s: f64,
    /// RMS of the noise in 1 Hz, in m/s²: 22.5 µg/√Hz of a sound one.
    pub(crate) noise_m_s2: f64,
    pub(crate) offset_m_s2: [f64; CHANNELS],
    pub(crate) offset_per_k_m_s2: [f64; CHANNELS],
    pub(crate) gain: [f64; CHANNELS],
    pub(crate) temperature_c: f64,
    /// How many soft resets load the fuses wrongly before one does not.
    pub(crate) bad_resets: u32,
    /// Whether the wire to DRDY is sound.
    pub(crate) has_pulses: bool,
}

impl Traits {
    /// Exact and silent.
    pub(crate) const IDEAL: Self = Self {
        oscillator: 0.0,
        oscillator_per_k: 0.0,
        oscillator_jitter_s: 0.0,
        noise_m_s2: 0.0,
        offset_m_s2: [0.0; CHANNELS],
        offset_per_k_m_s2: [0.0; CHANNELS],
        gain: [1.0; CHANNELS],
        temperature_c: 25.0,
        bad_resets: 0,
        has_pulses: true,
    };
}

#[derive(Debug)]
struct State {
    traits: Traits,
    tones: Vec<Tone>,
    registers: [u8; 128],
    now_s: f64,
    /// Periods of the ODR from when the sensor began to measure until now.
    periods: f64,
    /// The samples of the decimation filter, by their numbers; the newest last.
    decimated: Vec<(u64, [f64; CHANNELS])>,
    axes: [i32; CHANNELS],
    is_ready: bool,
    fifo: Vec<i32>,
    fuses_until_s: f64,
    random: u64,
}

/// A simulated sensor, and its end of the bus; clones are the same sensor.
#[derive(Debug, Clone)]
pub(crate) struct Simulated(Rc<RefCell<State>>);

impl Simulated {
    pub(crate) fn new(traits: Traits, tones: &[Tone]) -> Self {
        let mut state = State {
            traits,
            tones: tones.to_vec(),
            registers: [0; 128],
            now_s: 0.0,
            periods: 0.0,
            decimated: Vec::new(),
            axes: [0; CHANNELS],
            is_ready: false,
            fifo: Vec::new(),
            fuses_until_s: 0.0,
            random: 0x9E37_79B9_7F4A_7C15,
        };
        state.reset(false);
        Self(Rc::new(RefCell::new(state)))
    }

    /// Lets time pass until `time_s`.
    pub(crate) fn advance_to(&self, time_s: f64) {
        let mut state = self.0.borrow_mut();
        let dt = time_s - state.now_s;
        if dt > 0.0 {
            state.advance(dt);
        }
    }

    pub(crate) fn now_s(&self) -> f64 {
        self.0.borrow().now_s
    }

    /// A rising edge at the DRDY pin, now.
    pub(crate) fn pulse(&self) {
        self.0.borrow_mut().pulse();
    }

    /// Takes the supply away for a moment.
    pub(crate) fn lose_supply(&self) {
        self.0.borrow_mut().reset(false);
    }

    pub(crate) fn change(&self, change: impl FnOnce(&mut Traits)) {
        change(&mut self.0.borrow_mut().traits);
    }

    pub(crate) fn register(&self, register: u8) -> u8 {
        self.0.borrow().registers[usize::from(register)]
    }
}

impl State {
    fn reset(&mut self, is_soft: bool) {
        self.registers = [0; 128];
        self.registers[..4].copy_from_slice(&[0xAD, 0x1D, 0xED, 0x01]);
        self.registers[usize::from(register::RANGE)] = 0x81;
        self.registers[usize::from(register::POWER_CTL)] = 0x01;
        let shadow = usize::from(register::SHADOW);
        self.registers[shadow..shadow + 5].copy_from_slice(&[0x12, 0xA5, 0x3C, 0x77, 0xE0]);
        if is_soft && self.traits.bad_resets > 0 {
            self.traits.bad_resets -= 1;
            self.registers[shadow + 2] ^= 0x08;
        }
        self.fuses_until_s = self.now_s + FUSES_S;
        self.start();
    }

    /// Begins to measure, or stops.
    fn start(&mut self) {
        (self.periods, self.is_ready) = (0.0, false);
        self.decimated.clear();
        self.fifo.clear();
    }

    fn is_measuring(&self) -> bool {
        self.registers[usize::from(register::POWER_CTL)] & 1 == 0 && self.now_s >= self.fuses_until_s
    }

    fn is_external(&self) -> bool {
        self.registers[usize::from(register::SYNC)] & 3 == 2
    }

    fn setting(&self) -> u8 {
        self.registers[usize::from(register::FILTER)] & 0x0F
    }

    /// A number from 0 to 1.
    fn uniform(&mut self) -> f64 {
        // Marsaglia's xorshift.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Of a normal distribution, near enough: a sum of four.
    fn normal(&mut self) -> f64 {
        let sum: f64 = (0..4).map(|_| self.uniform()).sum();
        (sum - 2.0) * 3.0_f64.sqrt()
    }

    /// Of both filters, in periods of the ODR, as the sheet has it: what is subtracted, and the half step that is on average in it.
    fn delay_periods(&self) -> f64 {
        delay_ns(self.setting(), 0) as f64 / period_ns(self.setting()) as f64 + 0.5 / STEPS as f64
    }

    fn oscillator(&self) -> f64 {
        1.0 + self.traits.oscillator + self.traits.oscillator_per_k * (self.traits.temperature_c - 25.0)
    }

    fn odr(&self) -> f64 {
        odr_hz(self.setting()) * self.oscillator()
    }

    fn advance(&mut self, dt: f64) {
        let jitter_s = self.traits.oscillator_jitter_s * (1000.0 * dt).sqrt();
        let scatter = if jitter_s > 0.0 { jitter_s * self.normal() } else { 0.0 };
        let before = self.periods as u64;
        self.periods += (dt + scatter).max(0.0) * self.odr();
        self.now_s += dt;
        if !self.is_measuring() {
            self.periods = 0.0;
            return;
        }
        let now = self.periods as u64;
        if now > before && !self.is_external() {
            let axes = self.decimate(now);
            self.take(axes);
        }
    }

    /// The motion after the decimation filter, in sample `number`, from the time that the count of periods says.
    fn decimate(&mut self, number: u64) -> [f64; CHANNELS] {
        if let Some((_, axes)) = self.decimated.iter().rev().find(|(known, _)| *known == number) {
            return *axes;
        }
        let odr = self.odr();
        let time_s = self.now_s - (self.periods - number as f64) / odr;
        // What the sheet's delay of both filters leaves beside that of the interpolation's 190 taps.
        let interpolation = 0.5 * (3 * (STEPS - 1)) as f64 / STEPS as f64;
        let seen_s = time_s - (self.delay_periods() - interpolation) / odr;
        let motion: f64 = self
            .tones
            .iter()
            .map(|tone| {
                let x = PI * tone.frequency_hz / odr;
                // -1.83 dB at a quarter of the ODR: a second-order sinc.
                let gain = (x.sin() / x).powi(2);
                gain * tone.amplitude_m_s2 * (TAU * tone.frequency_hz * seen_s + tone.phase).cos()
            })
            .sum();
        let warmth = self.traits.temperature_c - 25.0;
        let noise = self.traits.noise_m_s2 * (0.5 * odr).sqrt();
        let axes = core::array::from_fn(|axis| {
            let offset = self.traits.offset_m_s2[axis] + warmth * self.traits.offset_per_k_m_s2[axis];
            let noise = if noise > 0.0 { noise * self.normal() } else { 0.0 };
            self.traits.gain[axis] * motion + offset + noise
        });
        if self.decimated.len() == 8 {
            self.decimated.remove(0);
        }
        self.decimated.push((number, axes));
        axes
    }

    fn pulse(&mut self) {
        if !self.traits.has_pulses || !self.is_measuring() || !self.is_external() {
            return;
        }
        // The next value of the interpolation.
        let step = (self.periods * STEPS as f64).ceil() as u64;
        let mut axes = [0.0; CHANNELS];
        for number in (step / STEPS).saturating_sub(2)..=step / STEPS {
            let weight = interpolation_tap(step - number * STEPS);
            for (sum, value) in axes.iter_mut().zip(self.decimate(number)) {
                *sum += weight * value;
            }
        }
        self.take(axes);
    }

    fn take(&mut self, axes: [f64; CHANNELS]) {
        self.axes = axes.map(|value| ((value * DIGITS).round() as i32).clamp(-(1 << 19), (1 << 19) - 1));
        self.is_ready = true;
        self.fifo.extend(self.axes);
        let excess = self.fifo.len().saturating_sub(FIFO_ENTRIES);
        self.fifo.drain(..excess);
    }

    fn read(&mut self, register: u8) -> u8 {
        match register {
            0x04 => {
                let is_busy = self.now_s < self.fuses_until_s;
                u8::from(self.is_ready) | u8::from(self.fifo.len() == FIFO_ENTRIES) << 1 | u8::from(is_busy) << 4
            }
            0x05 => self.fifo.len() as u8,
            0x06 | 0x07 => {
                let digits = (1885.0 - 9.05 * (self.traits.temperature_c - 25.0)).round() as u16;
                digits.to_be_bytes()[usize::from(register - 0x06)]
            }
            0x08..=0x10 => {
                self.is_ready = false;
                let [axis, byte] = [(register - 8) / 3, (register - 8) % 3].map(usize::from);
                (self.axes[axis] << 12).to_be_bytes()[byte]
            }
            register => self.registers[usize::from(register & 0x7F)],
        }
    }

    fn write(&mut self, register: u8, value: u8) {
        match register {
            register::RESET if value == 0x52 => self.reset(true),
            0x1E..=0x2E => {
                self.registers[usize::from(register)] = value;
                if register == register::POWER_CTL {
                    self.start();
                }
            }
            _ => {}
        }
    }
}

/// Tap `index` of three moving averages over [`STEPS`] one after the other, with gain 1 for a sample in 64.
fn interpolation_tap(index: u64) -> f64 {
    let steps = STEPS as i64;
    let choose = |n: i64| if n < 0 { 0.0 } else { ((n + 1) * (n + 2)) as f64 / 2.0 };
    let i = index as i64;
    let sum = choose(i) - 3.0 * choose(i - steps) + 3.0 * choose(i - 2 * steps) - choose(i - 3 * steps);
    sum / (STEPS * STEPS) as f64
}

impl ErrorType for Simulated {
    type Error = Infallible;
}

impl SpiDevice for Simulated {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut state = self.0.borrow_mut();
        let mut command = 0;
        for operation in operations {
            match operation {
                Operation::Write(bytes) => {
                    state.advance(BYTE_S * bytes.len() as f64);
                    command = bytes[0];
                    for (register, value) in (command >> 1..).zip(&bytes[1..]) {
                        state.write(register, *value);
                    }
                }
                Operation::Read(bytes) => {
                    assert_eq!(command & 1, 1, "a read without its mark");
                    // As it is at the burst's beginning: the sensor holds its registers for that long.
                    for (register, byte) in (command >> 1..).zip(bytes.iter_mut()) {
                        *byte = state.read(register);
                    }
                    state.advance(BYTE_S * bytes.len() as f64);
                }
                other => panic!("{other:?}"),
            }
        }
        Ok(())
    }
}

impl DelayNs for Simulated {
    fn delay_ns(&mut self, ns: u32) {
        self.0.borrow_mut().advance(1e-9 * f64::from(ns));
    }
}
