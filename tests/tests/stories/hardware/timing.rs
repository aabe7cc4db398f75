//! Samples come on time, whatever else the node does.
//!
//! The emulator counts instructions here instead of time (`-icount`), 8 ns each, so that nothing of the computer it runs on is
//! measured with it. That is what they take on a core of 168 MHz that needs 1.34 ticks for one. When nothing is to be done,
//! the emulated time jumps to the next interrupt.
//!
//! A node says itself how late the interrupt of a sample was at most, by the count of the timer that called it (in the
//! emulator, whose alarms are some µs late themselves at times: how much later than its neighbours), and which rows stayed
//! out. The emulator has no sensor, so spectra take a program that has the node's modules and an imitated one.

use std::cell::Cell;
use std::collections::VecDeque;
use std::io;
use std::rc::Rc;
use std::time::{Duration, Instant};

use belfry_host::link::port::Port;
use belfry_host::link::{Session, Transport};
use belfry_host::window::{ChannelData, Configurations, NodeWindow};
use belfry_shared::adxl355::correction_per_hz2;
use belfry_shared::frame::{END_OF_FRAME, FrameDecoder, MAX_FRAME_BYTES};
use belfry_shared::message::{
    self, Band, ChannelState, ClockReply, ClockRequest, Configuration, Conversation, Greeting, Heartbeat, HostMessage,
    InConversation, LinesPart, NodeMessage, Refusal, RefusalReason, Replay, SensorState, Summary,
};
use belfry_shared::time::{HostTime, NodeTime, WindowGrid};

use super::emulator::{Board, program};

/// What is not answered within this time is said again.
const ASK_AGAIN: Duration = Duration::from_secs(1);
/// A whole measurement takes some 20 s where nothing else runs.
const PATIENCE: Duration = Duration::from_secs(300);
/// The number of the conversation, also of what is said beside the session.
const CONVERSATION: Conversation = Conversation([0xC0, 0x4E, 0x56, 1]);
/// The emulated line takes no time.
const BAUD: u32 = u32::MAX;
/// Pairs of frames in a burst.
const BURST: usize = 5;
/// Stands as the host's time in the questions that keep the line busy.
const IDLE_QUESTION: HostTime = HostTime(-1);
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
    garbage: usize,
}

/// The host's clock: the node's, as far as the host can know it, for the emulated time runs as fast as the emulator can.
///
/// A reply arrives when it would if its way took as long as the request's. What a session makes of such exchanges is exactly the
/// node's time, so that windows follow each other on the grid however the emulator hurries.
struct HostClock {
    time_us: Cell<i64>,
    heard: Cell<Instant>,
}

impl HostClock {
    fn now(&self) -> HostTime {
        // Where nothing is heard any more it runs as ours, so that what was lost is said again.
        let silent = self.heard.get().elapsed();
        let waited_us = if silent > ASK_AGAIN { silent.as_micros() as i64 } else { 0 };
        HostTime(self.time_us.get() + waited_us)
    }

    /// Moves to when the node sent something.
    fn hear(&self, sent: NodeTime) {
        self.time_us.set(sent.0 as i64);
        self.heard.set(Instant::now());
    }
}

/// A line that is never quiet: the node is asked the time again whenever it has answered, beside what a session says.
struct BusyLine {
    port: Port,
    clock: Rc<HostClock>,
    /// What has come and not been looked at yet, up to the end of a frame, and what the session is to read of it.
    frame: Vec<u8>,
    arrived: VecDeque<u8>,
    for_session: VecDeque<u8>,
    /// When the reply that the session is reading was sent.
    reply_sent: Option<NodeTime>,
    asked: Option<Instant>,
    answers: usize,
    refusals: usize,
    garbage: usize,
    heartbeat: Option<Heartbeat>,
}

impl BusyLine {
    fn new(port: Port) -> Self {
        let clock = HostClock { time_us: Cell::new(0), heard: Cell::new(Instant::now()) };
        Self {
            port,
            clock: Rc::new(clock),
            frame: Vec::new(),
            arrived: VecDeque::new(),
            for_session: VecDeque::new(),
            reply_sent: None,
            asked: None,
            answers: 0,
            refusals: 0,
            garbage: 0,
            heartbeat: None,
        }
    }

    fn say(&mut self, message: &HostMessage) -> io::Result<()> {
        let mut frame = [0; MAX_FRAME_BYTES];
        let message = InConversation { conversation: CONVERSATION, message: message.clone() };
        let length = message::encode(&message, &mut frame).unwrap();
        self.port.write(&frame[..length])
    }

    /// Asks the time, where the node has answered or the question was lost.
    fn keep_busy(&mut self) -> io::Result<()> {
        if self.asked.is_none_or(|asked| asked.elapsed() > ASK_AGAIN) {
            self.asked = Some(Instant::now());
            self.say(&HostMessage::Clock(ClockRequest { host_sent: IDLE_QUESTION }))?;
        }
        Ok(())
    }

    /// Sends more frames at once than a host answers to two windows, every other of them garbage.
    fn burst(&mut self) {
        for _ in 0..BURST {
            self.port.write(&[7, 1, 2, END_OF_FRAME]).unwrap();
            self.say(&HostMessage::Greet(Greeting::OF_HOSTS)).unwrap();
        }
        self.garbage += BURST;
    }

    /// The next byte of the line; `None` where none has come.
    fn next_byte(&mut self) -> io::Result<Option<u8>> {
        if self.arrived.is_empty() {
            let mut buffer = [0; 4096];
            let count = self.port.read(&mut buffer)?;
            self.arrived.extend(&buffer[..count]);
        }
        Ok(self.arrived.pop_front())
    }

    /// Looks at a message; whether it is one for the session.
    fn hear(&mut self, message: &NodeMessage<'_>) -> bool {
        match message {
            NodeMessage::Clock(ClockReply { host_sent: IDLE_QUESTION, node_sent, .. }) => {
                self.clock.hear(*node_sent);
                self.answers += 1;
                self.asked = None;
                return false;
            }
            NodeMessage::Clock(reply) => {
                let request_us = reply.node_received.0 as i64 - reply.host_sent.0;
                self.clock.hear(reply.node_sent.offset(request_us));
                self.reply_sent = Some(reply.node_sent);
            }
            NodeMessage::Refused(Refusal { reason, .. }) => {
                assert_eq!(*reason, RefusalReason::Segment);
                self.refusals += 1;
            }
            // The spectrum of the next channel is being computed; and of a window without lines.
            NodeMessage::Lines(LinesPart { part: 1, .. }) | NodeMessage::Head(_) => self.burst(),
            NodeMessage::Heartbeat(heartbeat) => self.heartbeat = Some(heartbeat.clone()),
            _ => {}
        }
        true
    }
}

impl Transport for BusyLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.port.write(bytes)
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.keep_busy()?;
        if self.for_session.is_empty() {
            if let Some(sent) = self.reply_sent.take() {
                self.clock.hear(sent);
            }
            let Some(byte) = self.next_byte()? else { return Ok(0) };
            self.frame.push(byte);
            while self.frame.last() != Some(&END_OF_FRAME) {
                let Some(byte) = self.next_byte()? else { return Ok(0) };
                self.frame.push(byte);
            }
            let frame = std::mem::take(&mut self.frame);
            let mut decoder = FrameDecoder::new();
            let opened = frame.iter().find_map(|&byte| decoder.push(byte).map(|frame| frame.unwrap().message.to_vec()));
            if opened.is_none_or(|opened| self.hear(&message::decode(&opened).unwrap())) {
                self.for_session.extend(frame);
            }
        }
        let count = self.for_session.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(self.for_session.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }
}

/// Lets a program measure with its sensor over a line that is never quiet; with every window come bursts of garbage and greetings,
/// and a configuration that it has to refuse.
fn measure(program_name: &'static str, task: Task) -> Measured {
    let (_board, port, hello) = Board::run(&program(program_name), &["-icount", "shift=3,sleep=off"]);
    let start = Instant::now();
    let assert_patience = || assert!(start.elapsed() < PATIENCE, "the node does not say what it should");
    let configuration = task.configuration();
    let impossible = HostMessage::Configure(Configuration { segment: 300, ..configuration.clone() });
    let mut session =
        Session::new(hello.node, Configurations::only(configuration), BAUD).with_conversation(CONVERSATION);
    let mut line = BusyLine::new(port);
    let clock = Rc::clone(&line.clock);
    let mut windows: Vec<NodeWindow> = Vec::new();
    let mut configured: Option<(Instant, usize)> = None;
    while windows.len() < task.windows || line.refusals < windows.len() {
        assert_patience();
        session.service(&|| clock.now(), &mut line, &mut windows).unwrap();
        // A node that is told two such configurations at once refuses them together.
        let is_due = configured.is_none_or(|(at, refusals)| line.refusals > refusals || at.elapsed() > ASK_AGAIN);
        if is_due && line.refusals < windows.len() {
            configured = Some((Instant::now(), line.refusals));
            line.say(&impossible).unwrap();
        }
    }
    // A recording begins with a heartbeat; without one the next may be two minutes away.
    line.heartbeat = None;
    let mut asked: Option<Instant> = None;
    while line.heartbeat.is_none() {
        assert_patience();
        if asked.is_none_or(|asked| asked.elapsed() > ASK_AGAIN) {
            asked = Some(Instant::now());
            line.say(&HostMessage::Replay(Replay { start: HostTime(0) })).unwrap();
        }
        line.read(&mut [0; MAX_FRAME_BYTES]).unwrap();
    }
    assert_eq!(session.hello().map(|hello| hello.boot), Some(hello.boot), "it has not started anew");
    let heartbeat = line.heartbeat.unwrap();
    Measured { windows, heartbeat, answers: line.answers, refusals: line.refusals, garbage: line.garbage }
}

/// Every sample's interrupt came on time, no row stayed out, and windows follow each other on the grid.
fn assert_on_time(task: Task, measured: &Measured) {
    let Measured { windows, heartbeat, answers, refusals, garbage } = measured;
    let board = heartbeat.board;
    println!(
        "{} Hz, segments of {}: latest {} ns, {} rows lost, longest step {} µs, {answers} answers",
        task.rate_hz, task.segment, board.latest_sample_ns, heartbeat.lost_rows, board.longest_step_us
    );
    assert_eq!((heartbeat.lost_rows, heartbeat.stale_rows, heartbeat.lost_windows), (0, 0, 0));
    assert!(board.latest_sample_ns <= LATEST_NS, "{} ns late", board.latest_sample_ns);
    assert!(*answers > windows.len() && *refusals >= windows.len(), "{answers} answers, {refusals} refusals");
    // Nothing that was said was lost, and all garbage was seen.
    assert_eq!((heartbeat.damaged_frames as usize, board.dropped_frames), (*garbage, 0));
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
    // The program takes what it measures for an ADXL355's, and corrects it for its filters, through which the wave has not passed.
    let frequency_hz = f64::from(task.rate_hz) / 32.0;
    let correction = 1.0 + f64::from(correction_per_hz2(1000 * task.rate_hz)) * frequency_hz * frequency_hz;
    let expected = correction * f64::hypot(re, im) / (2.0 * 1.5 * spacing_hz).sqrt();
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
    let task = Task { rate_hz: 4000, decimation: 4, segment: 4096, windows: 4 };
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
