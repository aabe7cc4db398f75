//! Samples come on time, whatever else the node does.
//!
//! The emulator counts instructions here instead of time (`-icount`), 8 ns each, so that nothing of the computer it runs on is
//! measured with it. That is what they take on a core of 168 MHz that needs 1.34 ticks for one. When nothing is to be done,
//! the emulated time jumps to the next interrupt.
//!
//! A node says itself how late the interrupt of a sample was at most, by the count of the timer that called it (in the
//! emulator, whose alarms are some µs late themselves at times: how much later than its neighbours), and which rows stayed
//! out. The emulator has no sensor, so spectra take a program that has the node's modules and an imitated one.

use std::time::{Duration, Instant};

use belfry_host::link::assembly::{Assembler, Outcome};
use belfry_host::link::port::Port;
use belfry_host::link::{ChannelData, Configurations, NodeWindow, Transport};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES};
use belfry_shared::message::{
    self, Acknowledgement, Band, ChannelState, ClockRequest, Configuration, Heartbeat, Hello, HostMessage, NodeMessage,
    Refusal, RefusalReason, Replay, SensorState, Summary,
};
use belfry_shared::time::{ClockModel, HostTime, NodeTime, WindowGrid};

use super::emulator::{Board, program};

/// What is not answered within this time is said again.
const ASK_AGAIN: Duration = Duration::from_secs(2);
/// A whole measurement takes some 20 s where nothing else runs.
const PATIENCE: Duration = Duration::from_secs(300);
/// The channels of the sensor.
const CHANNELS: usize = 3;
/// No interrupt of a sample comes later than this, in ns: 125 instructions. At 4000 Hz the sensor's next sample is 125 µs away;
/// a serial port that holds sampling up while it sends a frame delays it by 40 µs.
const LATEST_NS: u32 = 1000;

/// What a node is asked for.
#[derive(Clone, Copy)]
struct Task {
    rate_hz: u32,
    decimation: u32,
    segment: u16,
    windows: usize,
}

impl Task {
    fn configuration(self) -> Configuration {
        Configuration {
            channels: CHANNELS as u8,
            sampling_rate_uhz: u64::from(self.rate_hz) * 1_000_000,
            decimation: self.decimation,
            segment: self.segment,
            summary: Summary::Lines { bits: 10 },
            bands: [Band { first_line: self.segment / 16, lines: self.segment / 4 }].into_iter().collect(),
        }
    }
}

/// What it has measured, and said.
struct Measured {
    windows: Vec<NodeWindow>,
    heartbeat: Heartbeat,
    /// Questions that it has answered meanwhile, and refusals.
    answers: usize,
    refusals: usize,
    garbage: u32,
}

/// A conversation with a node that measures with its sensor.
struct Line {
    port: Port,
    decoder: FrameDecoder,
}

impl Line {
    fn say(&mut self, message: &HostMessage) {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = message::encode(message, &mut frame).unwrap();
        self.port.write(&frame[..length]).unwrap();
    }

    /// Looks at messages until one is what is waited for. `asked` is said, and said again: a frame to the emulated board is lost now
    /// and then. Why has not been found; its line is held to no rate, and the node may not keep up.
    fn wait_for<T>(
        &mut self,
        start: Instant,
        asked: &[HostMessage],
        mut wanted: impl FnMut(&mut Self, &NodeMessage<'_>, &[u8]) -> Option<T>,
    ) -> T {
        let mut buffer = [0; 4096];
        let mut frames = Vec::new();
        let mut said: Option<Instant> = None;
        loop {
            if said.is_none_or(|said| said.elapsed() > ASK_AGAIN) {
                said = Some(Instant::now());
                asked.iter().for_each(|message| self.say(message));
            }
            assert!(start.elapsed() < PATIENCE, "the node does not say what it should");
            let count = self.port.read(&mut buffer).unwrap();
            for &byte in &buffer[..count] {
                // Of what was on its way before, the first may be cut.
                frames.extend(self.decoder.push(byte).and_then(Result::ok).map(<[u8]>::to_vec));
            }
            for frame in frames.drain(..) {
                let message = message::decode::<NodeMessage<'_>>(&frame).unwrap();
                if let Some(found) = wanted(self, &message, &frame) {
                    // What comes behind it belongs to nothing that anybody waits for.
                    return found;
                }
            }
        }
    }

    fn hello_after(&mut self, start: Instant, asked: &[HostMessage], done: impl Fn(&Hello) -> bool) -> Hello {
        self.wait_for(start, asked, |_, message, _| match message {
            NodeMessage::Hello(hello) if done(hello) => Some(hello.clone()),
            _ => None,
        })
    }
}

/// Lets a program measure with its sensor, with its line never quiet: it is asked the time again whenever it has answered,
/// and with every window come garbage, a greeting and a configuration that it has to refuse.
fn measure(program_name: &str, task: Task) -> Measured {
    let board = Board::run(&program(program_name), &["-icount", "shift=3,sleep=off"]);
    let start = Instant::now();
    let configuration = task.configuration();
    let hash = configuration.hash();
    // What is said before it listens is lost.
    let boot = board.hello().boot;
    let mut line = Line { port: board.port(), decoder: FrameDecoder::new() };
    let configure = HostMessage::Configure(configuration.clone());
    line.hello_after(start, &[configure], |hello| hello.configuration_hash == Some(hash));
    let set_clock = HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 });
    line.hello_after(start, &[set_clock, HostMessage::Greet], |hello| hello.clock_set);
    line.say(&HostMessage::Clock(ClockRequest { host_sent: HostTime(0) }));

    let impossible = Configuration { segment: 300, ..configuration.clone() };
    let (mut answers, mut refusals, mut garbage) = (0, 0, 0);
    let configurations = Configurations::only(configuration.clone());
    let mut assembler = Assembler::new(boot);
    let mut windows = Vec::new();
    let windows = line.wait_for(start, &[], |line, message, encoded| match message {
        NodeMessage::Clock(_) => {
            answers += 1;
            line.say(&HostMessage::Clock(ClockRequest { host_sent: HostTime(0) }));
            None
        }
        NodeMessage::Refused(Refusal { reason, .. }) => {
            assert_eq!(*reason, RefusalReason::Segment);
            refusals += 1;
            None
        }
        NodeMessage::Hello(hello) => {
            assert_eq!((hello.boot, hello.configuration_hash), (boot, Some(hash)));
            None
        }
        NodeMessage::Head(_) | NodeMessage::Lines(_) => {
            match assembler.take(&configurations, message, encoded) {
                Outcome::Taken => return None,
                Outcome::Whole(window) => {
                    assembler.stored(window.name.number);
                    windows.push(*window);
                }
                other => panic!("{other:?}"),
            }
            let below = assembler.below();
            line.say(&HostMessage::Acknowledge(Acknowledgement { boot, below, again: [].into_iter().collect() }));
            line.port.write(&[7, 1, 2, 0]).unwrap();
            garbage += 1;
            line.say(&HostMessage::Greet);
            line.say(&HostMessage::Configure(impossible.clone()));
            (windows.len() == task.windows).then(|| std::mem::take(&mut windows))
        }
        _ => None,
    });
    // A recording begins with a heartbeat; without one the next may be two minutes away.
    let replay = HostMessage::Replay(Replay { start: HostTime(0) });
    let heartbeat = line.wait_for(start, &[replay], |_, message, _| match message {
        NodeMessage::Heartbeat(heartbeat) => Some(heartbeat.clone()),
        _ => None,
    });
    Measured { windows, heartbeat, answers, refusals, garbage }
}

/// Every sample's interrupt came on time, no row stayed out, and windows follow each other on the grid.
fn assert_on_time(task: Task, measured: &Measured) {
    let Measured { windows, heartbeat, answers, refusals, garbage } = measured;
    let board = heartbeat.board;
    println!(
        "{} Hz, segments of {}: latest {} ns, {} rows lost, longest step {} µs, {answers} answers",
        task.rate_hz, task.segment, board.latest_sample_ns, heartbeat.lost_rows, board.longest_step_us
    );
    assert_eq!((heartbeat.lost_rows, heartbeat.lost_windows), (0, 0));
    assert!(board.latest_sample_ns <= LATEST_NS, "{} ns late", board.latest_sample_ns);
    // The last of each may still be on the way.
    assert!(*answers > windows.len() && *refusals + 1 >= windows.len(), "{answers} answers, {refusals} refusals");
    // The last may still be on the way, and a frame may be cut on the emulated line (see `wait_for`).
    let damaged = heartbeat.damaged_frames;
    assert!(damaged.abs_diff(*garbage) <= 2, "{damaged} damaged frames told, {garbage} sent");
    let grid = WindowGrid {
        sampling_rate_uhz: task.configuration().sampling_rate_uhz,
        hop_samples: task.configuration().hop_samples(),
    };
    for pair in windows.windows(2) {
        assert_eq!(pair[1].name.number, pair[0].name.number + 1);
        assert_eq!(pair[1].grid_index, pair[0].grid_index + 1);
        // Starts are a hop of samples apart. The emulator's alarms come some µs late at times; a row would be a whole period.
        let start = |window: &NodeWindow| grid.start(window.grid_index).0 + i64::from(window.middle_offset_us);
        let hop_us = (grid.start(1).0 - grid.start(0).0) as f64;
        let apart_us = (start(&pair[1]) - start(&pair[0])) as f64;
        assert!((apart_us - hop_us).abs() < 0.5e6 / f64::from(task.rate_hz), "{apart_us} µs apart, {hop_us} wanted");
    }
}

/// The imitated sensor's wave in m/s²: a triangle of 32 samples.
fn wave(sample: usize) -> f64 {
    (((sample % 32) as f64 - 16.0).abs() - 8.0) * 8000.0 * 9.806_65 / 256_000.0
}

/// Windows have the wave's fundamental, as large as it is, and nothing beside it: no sample was left out, taken twice, or out
/// of order, each of which would turn the wave's phase in the middle of the window.
fn assert_one_wave(task: Task, windows: &[NodeWindow]) {
    let (segment, decimation) = (usize::from(task.segment), task.decimation as usize);
    let line = segment * decimation / 32 - segment / 16;
    let (re, im) = (0..32).fold((0.0, 0.0), |(re, im), n| {
        let phase = std::f64::consts::TAU * n as f64 / 32.0;
        (re + wave(n) * phase.cos() / 16.0, im + wave(n) * phase.sin() / 16.0)
    });
    // A line's squared magnitude is a density: half the squared amplitude over the Hann window's 1.5 lines.
    let spacing_hz = f64::from(task.rate_hz) / f64::from(task.decimation) / f64::from(task.segment);
    let expected = f64::hypot(re, im) / (2.0 * 1.5 * spacing_hz).sqrt();
    for channel in windows.iter().flat_map(|window| &window.channels) {
        let ChannelData::Lines(lines) = channel else { panic!("{channel:?}") };
        let found = f64::from(lines[line].norm());
        // The filter's passband is flat to better than that.
        assert!((found / expected - 1.0).abs() < 0.01, "{found} of {expected}");
        for (index, other) in lines.iter().enumerate().filter(|(index, _)| index.abs_diff(line) > 1) {
            // 10 bits: half a step of 1/511 of a block's full scale, which is up to 19 % above its largest component.
            assert!(f64::from(other.norm()) < 2e-3 * expected, "line {index}: {other} beside {expected}");
        }
    }
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn no_sample_is_late_or_lost_while_long_spectra_are_computed_and_sent() {
    let task = Task { rate_hz: 4000, decimation: 4, segment: 4096, windows: 8 };
    let measured = measure("belfry-imitated", task);
    assert_on_time(task, &measured);
    assert_one_wave(task, &measured.windows);
    // A spectrum is one step of the program: ten samples and more came while it was computed.
    assert!(measured.heartbeat.board.longest_step_us > 10 * 250, "{:?}", measured.heartbeat.board);
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn no_sample_is_late_or_lost_while_short_spectra_are_computed_and_sent() {
    let task = Task { rate_hz: 4000, decimation: 4, segment: 256, windows: 60 };
    let measured = measure("belfry-imitated", task);
    assert_on_time(task, &measured);
    assert_one_wave(task, &measured.windows);
    assert!(measured.heartbeat.board.longest_step_us > 250, "{:?}", measured.heartbeat.board);
}

#[test]
#[cfg_attr(not(emulator), ignore = "needs qemu-system-arm and a compiler for the board")]
fn the_pace_of_rows_is_kept_without_a_sensor() {
    let task = Task { rate_hz: 4000, decimation: 4, segment: 256, windows: 60 };
    let measured = measure("belfry-node", task);
    assert_on_time(task, &measured);
    assert_eq!(measured.heartbeat.sensors, [SensorState::Absent; CHANNELS]);
    let missing = ChannelData::Unsound(ChannelState::Missing);
    assert!(measured.windows.iter().flat_map(|window| &window.channels).all(|channel| *channel == missing));
}
