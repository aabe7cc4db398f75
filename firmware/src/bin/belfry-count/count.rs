//! The counts.

use core::convert::Infallible;

use belfry_firmware::adxl355::{Adxl355, BURST_BYTES};
use belfry_firmware::sampling::Fetcher;
use belfry_firmware::{Identity, Memory, Node, SUPPORTED_SEGMENTS, welch_segment};
use belfry_shared::frame::{MAX_FRAME_BYTES, MAX_MESSAGE_BYTES, PROTOCOL_VERSION, crc32, encode};
use belfry_shared::message::{
    self, Band, Configuration, Conversation, Greeting, HostMessage, InConversation, MAX_CHANNELS, Summary,
};
use belfry_shared::seal::{Key, Sender};
use belfry_shared::time::{ClockModel, HostTime, NodeTime};
use cortex_m_semihosting::{debug, hprintln};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use panic_semihosting as _;
use stm32f4xx_hal::pac::TIM5;

/// What the board's core runs at.
const CORE_HZ: u64 = 168_000_000;
const LONGEST: usize = 4096;
const BOOT: u32 = 1;
const KEY: Key = Key::new([0x4B; 32]);

static mut MEMORY: Memory = Memory::new();

fn now() -> u32 {
    // SAFETY: the counter is only read.
    unsafe { (*TIM5::ptr()).cnt().read().bits() }
}

/// Instructions that `work` takes, the look at the counter left out.
fn count(work: impl FnOnce()) -> u32 {
    let empty = {
        let start = now();
        now().wrapping_sub(start)
    };
    let start = now();
    work();
    now().wrapping_sub(start).saturating_sub(empty)
}

/// A deterministic signal: numbers from -0.5 to 0.5.
fn noise(n: u32) -> f32 {
    (n.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32 - 0.5
}

#[cortex_m_rt::entry]
fn run() -> ! {
    // SAFETY: nothing else uses the timer.
    unsafe {
        (*TIM5::ptr()).arr().write(|w| w.bits(u32::MAX));
        (*TIM5::ptr()).cr1().write(|w| w.cen().set_bit());
    }
    hprintln!("a segment: straight line out, window, FFT, power, sum; and its FFT alone; points and instructions");
    for segment in SUPPORTED_SEGMENTS {
        segments(usize::from(segment));
        transforms(usize::from(segment));
    }
    hprintln!(
        "a second of the node in Hz of sampling and instructions: 4 channels, 4096 points at 5 Hz, 1188 lines of 6 bits"
    );
    // SAFETY: this function runs once, and nothing else names MEMORY.
    let memory: &'static mut Memory = unsafe { &mut *core::ptr::addr_of_mut!(MEMORY) };
    let identity = Identity { node: 1, boot: BOOT, channels: 4, full_scale_m_s2: 20.0, highest_rate_mhz: 4_000_000 };
    let mut node = Node::new(identity, memory);
    whole_node(&mut node, "second", None, 50, 10);
    whole_node(&mut node, "second", None, 1000, 200);
    hprintln!("a sample in bytes on the sensor's bus, at 5 MHz 1.6 us each, and instructions beside them");
    fetching();
    hprintln!("a seal in bytes of its message and instructions; and the same seconds of a node with a key");
    seals();
    node.set_key(Some(KEY));
    // What a host has said under a key is counted on.
    let mut said = 0;
    whole_node(&mut node, "sealed", Some(&mut said), 50, 10);
    whole_node(&mut node, "sealed", Some(&mut said), 1000, 200);
    debug::exit(debug::EXIT_SUCCESS);
    #[expect(clippy::empty_loop, reason = "the emulator has stopped")]
    loop {}
}

/// Counts the FFT alone.
fn transforms(length: usize) {
    // SAFETY: as in `segments`.
    let (samples, _) = unsafe { (*core::ptr::addr_of_mut!(MEMORY)).workbench() };
    let Some(samples) = samples.get_mut(..length) else { return };
    for (n, sample) in samples.iter_mut().enumerate() {
        *sample = noise(n as u32);
    }
    let instructions = count(|| {
        core::hint::black_box(belfry_kernels::real_fft(core::hint::black_box(samples)));
    });
    hprintln!("fft {} {}", length, instructions);
}

fn segments(length: usize) {
    // SAFETY: this function is called before the node uses MEMORY, and its borrows end with it.
    let (samples, sums) = unsafe { (*core::ptr::addr_of_mut!(MEMORY)).workbench() };
    let (Some(samples), Some(sums)) = (samples.get_mut(..length), sums.get_mut(..length / 2)) else { return };
    for (n, sample) in samples.iter_mut().enumerate() {
        *sample = noise(n as u32);
    }
    sums.fill(0.0);
    let instructions = count(|| welch_segment(samples, 5.0, sums));
    hprintln!("segment {} {}", length, instructions);
    // The host's sums are to have the same bits.
    hprintln!("checksum {} {}", length, crc32(bytemuck::cast_slice(sums)));
}

/// A bus that takes no time: what bytes take on a real one is known.
struct QuickBus;

impl ErrorType for QuickBus {
    type Error = Infallible;
}

impl SpiDevice for QuickBus {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        for operation in operations {
            if let Operation::Read(bytes) = operation {
                match bytes {
                    [ad, mst, part] => (*ad, *mst, *part) = (0xAD, 0x1D, 0xED),
                    [status] => *status = 0,
                    // A sample is ready.
                    bytes => bytes.fill(1),
                }
            }
        }
        Ok(())
    }
}

impl DelayNs for QuickBus {
    fn delay_ns(&mut self, _: u32) {}
}

/// Counts what is done with the sensor at each pulse, beside the bytes on its bus.
fn fetching() {
    // Every look at its oscillator's samples finds one, in time.
    let mut us = 0;
    let mut now_us = || {
        us += 16_000;
        us
    };
    let Ok(sensor) = Adxl355::start(QuickBus, &mut QuickBus, &mut now_us, 1_000_000) else {
        hprintln!("no sensor");
        return;
    };
    let mut fetcher = Fetcher::NONE;
    fetcher.set_sensor(sensor);
    let instructions = count(|| {
        core::hint::black_box(fetcher.fetch(core::hint::black_box(NodeTime(1))));
    });
    hprintln!("fetch {} {}", BURST_BYTES, instructions);
}

fn seals() {
    let message = [0x5A; MAX_MESSAGE_BYTES];
    for length in [16, 128, MAX_MESSAGE_BYTES] {
        let message = message.get(..length).unwrap_or(&[]);
        let instructions = count(|| {
            core::hint::black_box(KEY.seal(Sender::Node, BOOT, 1, PROTOCOL_VERSION, core::hint::black_box(message)));
        });
        hprintln!("seal {} {}", length, instructions);
    }
}

/// Counts a second of the node. With a key, `said` is how many sealed frames the host has sent.
fn whole_node(
    node: &mut Node<&'static mut Memory>,
    kind: &str,
    mut said: Option<&mut u32>,
    rate_hz: u32,
    decimation: u32,
) {
    let configuration = Configuration {
        channels: MAX_CHANNELS as u8,
        sampling_rate_uhz: u64::from(rate_hz) * 1_000_000,
        decimation,
        segment: LONGEST as u16,
        summary: Summary::Lines { bits: 6 },
        bands: [Band { first_line: 41, lines: 1188 }].into_iter().collect(),
    };
    let greeting_counter = said.as_deref().map_or(0, |said| said + 1);
    let mut frame = [0; MAX_FRAME_BYTES];
    let mut say = |node: &mut Node<&'static mut Memory>, message: &HostMessage| {
        let message = InConversation { conversation: Conversation([1; 4]), message: message.clone() };
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        let bytes = message::bytes(&message, &mut buffer).unwrap_or(&[]);
        let length = match said.as_deref_mut() {
            Some(said) => {
                *said += 1;
                KEY.encode(Sender::Host, BOOT, *said, bytes, &mut frame)
            }
            None => encode(bytes, &mut frame),
        };
        let length = length.unwrap_or(0);
        for &byte in frame.iter().take(length) {
            node.receive(NodeTime(0), byte);
        }
    };
    say(node, &HostMessage::Greet(Greeting { counter: greeting_counter, ..Greeting::OF_HOSTS }));
    say(node, &HostMessage::Configure(configuration));
    say(node, &HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 }));
    // Two windows, after the filters are full.
    let rows = decimation * (LONGEST as u32 * 3 / 2 + 100);
    let (mut sampling, mut working, mut sending) = (0_u64, 0_u64, 0_u64);
    let (mut longest_row, mut longest_step, mut bytes) = (0, 0, 0);
    let mut out = [0; MAX_FRAME_BYTES];
    for row in 0..rows {
        let time = NodeTime(u64::from(row) * 1_000_000 / u64::from(rate_hz));
        let readings = [noise(row), noise(row + 7), 9.8 + noise(row + 11), noise(row + 13)];
        let taken = count(|| node.sample(time, &readings));
        sampling += u64::from(taken);
        longest_row = longest_row.max(taken);
        loop {
            let mut worked = false;
            let step = count(|| worked = node.poll(time));
            working += u64::from(step);
            longest_step = longest_step.max(step);
            if !worked {
                break;
            }
        }
        while node.has_bytes() {
            let mut sent = 0;
            sending += u64::from(count(|| sent = node.transmit(time, &mut out)));
            bytes += sent;
            if sent == 0 {
                break;
            }
        }
    }
    let total = sampling + working + sending;
    let a_second = total * u64::from(rate_hz) / u64::from(rows);
    // In units of 0.001 %.
    let share = a_second * 100_000 / CORE_HZ;
    hprintln!(
        "{} {} {} = {}.{:03} % of 168 MHz; a row {} (most {}), work {}, sending {} for {} bytes; longest step {}",
        kind,
        rate_hz,
        a_second,
        share / 1000,
        share % 1000,
        sampling / u64::from(rows),
        longest_row,
        working,
        sending,
        bytes,
        longest_step
    );
}
