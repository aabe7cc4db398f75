//! The node from outside: bytes and samples in, frames out.

mod calibration;

use super::*;
use crate::listening::listen;
use belfry_shared::decimation::Stages;
use belfry_shared::frame::PROTOCOL_VERSION;
use belfry_shared::message::{Acknowledgement, Again, Band, ChannelState, FaultKind, Greeting, RefusalReason, Summary};
use belfry_shared::quantise::{decode_density, decode_lines};
use belfry_shared::time::HostTime;
use heapless::Vec as HeaplessVec;
use num_complex::Complex32;
use proptest::prelude::*;
use std::boxed::Box;
use std::{vec, vec::Vec};

const IDENTITY: Identity =
    Identity { node: 3, boot: 77, channels: 4, full_scale_m_s2: 19.6, highest_rate_mhz: 4_000_000 };
const HOST: Conversation = Conversation([1, 2, 3, 4]);
const GREET: HostMessage = HostMessage::Greet(Greeting::OF_HOSTS);
const OTHER: Conversation = Conversation([5, 6, 7, 8]);
/// Raw sampling period in µs (50 Hz).
const PERIOD_US: u64 = 20_000;

fn configuration(summary: Summary) -> Configuration {
    Configuration {
        channels: 2,
        sampling_rate_uhz: 50_000_000,
        decimation: 5,
        segment: 256,
        summary,
        bands: HeaplessVec::from_slice(&[Band { first_line: 3, lines: 90 }]).unwrap(),
    }
}

fn new_node() -> Box<Node<Box<Memory>>> {
    Box::new(Node::new(IDENTITY, Box::new(Memory::new())))
}

/// A node and what it has said, as owned messages.
struct Bench {
    node: Box<Node<Box<Memory>>>,
    row: u64,
    frames: Vec<Vec<u8>>,
}

impl Bench {
    /// A node with a configuration whose clock is the host's.
    fn new(summary: Summary) -> Self {
        let mut bench = Self { node: new_node(), row: 0, frames: Vec::new() };
        bench.say(&GREET);
        bench.say(&HostMessage::Configure(configuration(summary)));
        bench.say(&HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 }));
        bench
    }

    fn now(&self) -> NodeTime {
        NodeTime(self.row * PERIOD_US)
    }

    fn say(&mut self, message: &HostMessage) {
        self.say_in(HOST, message);
    }

    fn say_in(&mut self, conversation: Conversation, message: &HostMessage) {
        self.say_as(PROTOCOL_VERSION, conversation, message, &[]);
    }

    /// Says a message of another version, with fields that this one does not know.
    fn say_as(&mut self, version: u8, conversation: Conversation, message: &HostMessage, added: &[u8]) {
        let message = &InConversation { conversation, message: message.clone() };
        let mut bytes = postcard::to_slice(message, &mut [0; 512]).unwrap().to_vec();
        bytes.extend(added);
        self.say_bytes(version, &bytes);
    }

    fn say_bytes(&mut self, version: u8, bytes: &[u8]) {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = frame::encode_as(version, bytes, &mut frame).unwrap();
        for &byte in &frame[..length] {
            self.node.receive(self.now(), byte);
        }
    }

    /// What the node says of itself when it is heard next.
    fn next_hello(&mut self) -> Option<Hello> {
        self.frames.clear();
        self.listen();
        self.messages().into_iter().find_map(|message| match message {
            NodeMessage::Hello(hello) => Some(hello),
            _ => None,
        })
    }

    /// Feeds rows without letting the node work.
    fn feed(&mut self, rows: u64, readings: impl Fn(u64) -> [f32; 2]) {
        for _ in 0..rows {
            self.node.sample(self.now(), &readings(self.row));
            self.row += 1;
        }
    }

    /// Lets the node work and collects what it says.
    fn listen(&mut self) {
        let now = self.now();
        listen(&mut self.node, now, &mut self.frames);
    }

    fn run(&mut self, rows: u64, readings: impl Fn(u64) -> [f32; 2] + Copy) {
        for _ in 0..rows {
            self.feed(1, readings);
            self.listen();
        }
    }

    fn messages(&self) -> Vec<NodeMessage<'_>> {
        self.frames.iter().map(|frame| message::decode(frame).unwrap()).collect()
    }

    fn heads(&self) -> Vec<message::WindowHead> {
        let heads = self.messages().into_iter().filter_map(|message| match message {
            NodeMessage::Head(head) => Some(head),
            _ => None,
        });
        heads.collect()
    }
}

/// A host of the next version, which adds fields and a message and still speaks this one.
#[test]
fn a_newer_host_that_still_speaks_its_version_is_served() {
    let added = [9, 0, 200];
    let mut plain = Bench::new(Summary::Lines { bits: 8 });
    let mut bench = Bench { node: new_node(), row: 0, frames: Vec::new() };
    let versions = Versions { lowest: PROTOCOL_VERSION, highest: PROTOCOL_VERSION + 1 };
    bench.say_as(PROTOCOL_VERSION + 1, HOST, &HostMessage::Greet(Greeting { versions, counter: 0 }), &added);
    let hello = bench.next_hello().unwrap();
    assert_eq!((hello.conversation, hello.answers), (Some(HOST), Some(HOST)));
    let set = HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 });
    for message in [HostMessage::Configure(configuration(Summary::Lines { bits: 8 })), set] {
        bench.say_as(PROTOCOL_VERSION, HOST, &message, &added);
    }
    // A message that came with the next version.
    bench.say_bytes(PROTOCOL_VERSION, &[1, 2, 3, 4, 99, 1, 2]);
    for bench in [&mut plain, &mut bench] {
        bench.run(256 * 5 * 3, |row| [tone(row), tone(row + 7)]);
    }
    let lines = |bench: &Bench| -> Vec<Vec<u8>> {
        let is_line = |frame: &&Vec<u8>| matches!(message::decode(frame).unwrap(), NodeMessage::Lines(_));
        bench.frames.iter().filter(is_line).cloned().collect()
    };
    assert!(lines(&bench).len() == 6 && lines(&bench) == lines(&plain));
    let heartbeat = bench.messages().into_iter().find_map(|message| match message {
        NodeMessage::Heartbeat(heartbeat) => Some((heartbeat.unknown_messages, heartbeat.damaged_frames)),
        _ => None,
    });
    assert_eq!(heartbeat, Some((1, 0)));
}

#[test]
fn it_answers_hosts_of_any_version_with_its_own_and_listens_to_none_with_which_it_shares_none() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.listen();
    // What a host of version 5 says as its greeting, and what hosts of versions that nobody knows may say.
    for (version, bytes) in [(5, &[5, 6, 7, 8, 0][..]), (3, &[0]), (9, &[5, 6, 7, 8, 0xFF, 0xFF]), (127, &[])] {
        bench.say_bytes(version, bytes);
        let hello = bench.next_hello().unwrap();
        assert_eq!((hello.versions, hello.conversation), (Versions::OF_NODES, Some(HOST)), "version {version}");
    }
    for versions in [Versions { lowest: 7, highest: 9 }, Versions { lowest: 1, highest: 5 }] {
        bench.say_as(versions.highest.max(6), OTHER, &HostMessage::Greet(Greeting { versions, counter: 0 }), &[]);
        let hello = bench.next_hello().unwrap();
        assert_eq!((hello.answers, hello.conversation), (Some(OTHER), Some(HOST)), "{versions}");
    }
}

#[test]
fn a_question_is_answered_and_leaves_it_with_its_host() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.listen();
    bench.say_in(OTHER, &HostMessage::Ask(Versions::OF_HOSTS));
    let hello = bench.next_hello().unwrap();
    assert_eq!((hello.answers, hello.conversation), (Some(OTHER), Some(HOST)));
    bench.say(&HostMessage::Clock(ClockRequest { host_sent: HostTime(1) }));
    bench.listen();
    assert!(matches!(bench.messages().last(), Some(NodeMessage::Clock(_))));
    assert_eq!(bench.next_hello(), None);
}

#[test]
fn a_node_that_cannot_measure_refuses_with_the_reason_and_says_all_that_is_wrong() {
    let mut bench = Bench { node: new_node(), row: 0, frames: Vec::new() };
    bench.node.refuse_to_measure(RefusalReason::Clock);
    let mut fault = Fault::from(FaultKind::Watchdog);
    fault.further = [FaultKind::Clock, FaultKind::Store].into_iter().collect();
    bench.node.report_fault(fault.clone());
    bench.say(&GREET);
    bench.say(&HostMessage::Configure(configuration(Summary::Lines { bits: 8 })));
    let hello = bench.next_hello().unwrap();
    assert_eq!((hello.configuration_hash, hello.fault), (None, Some(fault)));
    let configuration_hash = configuration(Summary::Lines { bits: 8 }).hash();
    let refusal = Refusal { configuration_hash, reason: RefusalReason::Clock };
    assert!(bench.messages().contains(&NodeMessage::Refused(refusal)));
    assert_eq!(bench.node.sampling_rate_uhz(), None);
}

#[test]
fn only_what_a_sensor_gave_is_corrected_for_its_filters() {
    let lines = |correct: bool, replays: bool| -> Vec<Complex32> {
        let mut bench = Bench::new(Summary::Lines { bits: 16 });
        if correct {
            bench.node.set_correction(|rate_mhz| if rate_mhz == 50_000 { 0.01 } else { f32::NAN });
        }
        if replays {
            bench.say(&HostMessage::Replay(Replay { start: HostTime(0) }));
            for first_row in (0..4000).step_by(20) {
                let readings = (first_row..first_row + 20).flat_map(|row| [tone(row), tone(row)]).collect();
                bench.say(&HostMessage::Feed(FeedPart { first_row, readings }));
                bench.listen();
            }
        } else {
            bench.run(4000, |row| [tone(row); 2]);
        }
        let first = bench.messages().into_iter().find_map(|message| match message {
            NodeMessage::Lines(part) => {
                let mut lines = vec![Complex32::default(); usize::from(part.lines)];
                decode_lines(part.code, part.bits, &mut lines).unwrap();
                Some(lines)
            }
            _ => None,
        });
        first.unwrap()
    };
    let plain = lines(false, false);
    let largest = plain.iter().map(|line| line.norm()).fold(0.0, f32::max);
    for (index, (plain, corrected)) in plain.iter().zip(lines(true, false)).enumerate() {
        // Line 3 is the first, and lines are 10/256 Hz apart.
        let frequency_hz = (3 + index) as f32 * 10.0 / 256.0;
        let expected = plain * (1.0 + 0.01 * frequency_hz * frequency_hz);
        assert!((corrected - expected).norm() < 1e-4 * largest, "line {index}: {corrected} for {expected}");
    }
    assert_eq!(lines(false, true), lines(true, true));
}

/// A host with a node's key, which counts what it says.
struct SealingHost {
    key: Key,
    boot: u32,
    said: u32,
}

impl SealingHost {
    fn of(boot: u32) -> Self {
        Self { key: KEY, boot, said: 0 }
    }

    /// The frame of what it says next.
    fn frame(&mut self, message: &HostMessage) -> Vec<u8> {
        self.said += 1;
        let message = match message {
            HostMessage::Greet(greeting) => HostMessage::Greet(Greeting { counter: self.said, ..*greeting }),
            other => other.clone(),
        };
        let message = InConversation { conversation: HOST, message };
        let bytes = postcard::to_slice(&message, &mut [0; 512]).unwrap().to_vec();
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = self.key.encode(Sender::Host, self.boot, self.said, &bytes, &mut frame).unwrap();
        frame[..length].to_vec()
    }
}

const KEY: Key = Key::new([0x4B; 32]);

/// A node with a key.
fn keyed(boot: u32) -> Bench {
    let mut node = Box::new(Node::new(Identity { boot, ..IDENTITY }, Box::new(Memory::new())));
    node.set_key(Some(KEY));
    Bench { node, row: 0, frames: Vec::new() }
}

impl Bench {
    fn take(&mut self, frame: &[u8]) {
        frame.iter().for_each(|&byte| self.node.receive(self.now(), byte));
    }

    fn unsealed_messages(&self) -> u32 {
        self.node.unsealed_messages
    }
}

fn set_up() -> [HostMessage; 3] {
    let set = HostMessage::SetClock(ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 });
    [GREET, HostMessage::Configure(configuration(Summary::Lines { bits: 8 })), set]
}

#[test]
fn with_a_key_it_obeys_nothing_without_a_seal_counts_it_and_answers() {
    let mut bench = keyed(77);
    bench.listen();
    let replay = HostMessage::Replay(message::Replay { start: HostTime(0) });
    let acknowledgement = HostMessage::Acknowledge(Acknowledgement { boot: 77, below: 0, again: HeaplessVec::new() });
    let refused = [set_up().as_slice(), &[replay, acknowledgement]].concat();
    for message in &refused {
        bench.say(message);
    }
    let hello = bench.next_hello().unwrap();
    assert_eq!((hello.conversation, hello.configuration_hash, hello.clock_set), (None, None, false));
    assert_eq!((hello.counters.map(|counters| counters.heard), bench.unsealed_messages()), (Some(0), 5));
    // A question is answered, and no offence.
    bench.say(&HostMessage::Ask(Versions::OF_HOSTS));
    let hello = bench.next_hello().unwrap();
    assert_eq!((hello.answers, hello.conversation, bench.unsealed_messages()), (Some(HOST), None, 5));
}

#[test]
fn where_its_key_is_none_it_says_who_it_is_and_obeys_nobody() {
    let mut bench = Bench { node: new_node(), row: 0, frames: Vec::new() };
    bench.node.set_key(None);
    let mut host = SealingHost { key: Key::new([0; 32]), ..SealingHost::of(77) };
    for message in set_up() {
        bench.say(&message);
        bench.take(&host.frame(&message));
    }
    let hello = bench.next_hello().unwrap();
    assert_eq!((hello.node, hello.conversation, bench.unsealed_messages()), (3, None, 6));
}

#[test]
fn it_obeys_each_sealed_message_once_in_the_boot_that_it_was_sealed_for() {
    let mut bench = keyed(77);
    let mut host = SealingHost::of(77);
    let said: Vec<Vec<u8>> = set_up().iter().map(|message| host.frame(message)).collect();
    said.iter().for_each(|frame| bench.take(frame));
    let hello = bench.next_hello().unwrap();
    assert!(hello.conversation == Some(HOST) && hello.configuration_hash.is_some() && hello.clock_set);
    assert_eq!((hello.counters.map(|counters| counters.heard), bench.unsealed_messages()), (Some(3), 0));
    // Again, on this port or another: the node has one counter.
    said.iter().for_each(|frame| bench.take(frame));
    assert_eq!(bench.unsealed_messages(), 3);
    // A frame that was lost leaves a gap, and one that is late is refused.
    let (late, next) = (host.frame(&GREET), host.frame(&GREET));
    bench.take(&next);
    bench.take(&late);
    assert_eq!(bench.unsealed_messages(), 4);
    // More frames in a row are lost than the low bits count: only a greeting finds the way back.
    host.said += 1000;
    let ask_time = HostMessage::Clock(ClockRequest { host_sent: HostTime(1) });
    bench.take(&host.frame(&ask_time));
    assert_eq!(bench.unsealed_messages(), 5);
    bench.take(&host.frame(&GREET));
    bench.take(&host.frame(&ask_time));
    assert_eq!(bench.unsealed_messages(), 5);
    // After a restart.
    let mut restarted = keyed(78);
    said.iter().chain([&next]).for_each(|frame| restarted.take(frame));
    let hello = restarted.next_hello().unwrap();
    assert_eq!((hello.conversation, hello.configuration_hash, restarted.unsealed_messages()), (None, None, 4));
    // With another key, or back to the node what the node itself has said.
    let mut stranger = SealingHost { key: Key::new([0; 32]), ..SealingHost::of(78) };
    restarted.take(&stranger.frame(&GREET));
    assert_eq!(restarted.unsealed_messages(), 5);
}

#[test]
fn all_that_it_says_is_sealed_and_counted_and_windows_from_an_outage_when_they_are_sent() {
    let mut bench = keyed(77);
    let mut host = SealingHost::of(77);
    set_up().iter().for_each(|message| bench.take(&host.frame(message)));
    let (mut decoder, mut counter, mut kinds) = (FrameDecoder::new(), 0, Vec::new());
    let mut listen = |bench: &mut Bench| {
        while bench.node.poll(bench.now()) {}
        let mut byte = [0];
        while bench.node.transmit(bench.now(), &mut byte) > 0 {
            let Some(frame) = decoder.push(byte[0]) else { continue };
            let frame = frame.unwrap();
            counter += 1;
            assert!(KEY.admits(Sender::Node, 77, counter, &frame), "frame {counter}");
            kinds.push(frame.message[0]);
        }
    };
    // Nobody listens during three windows.
    for _ in 0..256 * 5 * 3 {
        bench.feed(1, |row| [tone(row); 2]);
        while bench.node.poll(bench.now()) {}
    }
    listen(&mut bench);
    let everything = Again { first_window: 0, last_window: u32::MAX, first_part: 0, last_part: u16::MAX };
    let again = HeaplessVec::from_slice(&[everything]).unwrap();
    bench.take(&host.frame(&HostMessage::Acknowledge(Acknowledgement { boot: 77, below: 0, again })));
    listen(&mut bench);
    // Three windows of two parts and a head, each sent twice, and the last counter is that of the last frame.
    assert_eq!(kinds.iter().filter(|&&kind| (4..=5).contains(&kind)).count(), 2 * 3 * 3);
    assert_eq!(kinds.len() as u32, counter);
}

fn tone(row: u64) -> f32 {
    let t = row as f64 * 0.02;
    ((std::f64::consts::TAU * 1.0 * t).sin() + 0.3 * (std::f64::consts::TAU * 2.2 * t + 0.5).cos()) as f32
}

const SOUND: ChannelState = ChannelState::Sound { segments: 1 };

#[test]
fn it_greets_and_confirms_its_configuration_by_hash() {
    let mut bench = Bench { node: new_node(), row: 0, frames: Vec::new() };
    bench.listen();
    let wanted = configuration(Summary::Lines { bits: 8 });
    bench.say(&GREET);
    bench.say(&HostMessage::Configure(wanted.clone()));
    bench.listen();
    let hashes: Vec<_> = bench
        .messages()
        .iter()
        .map(|message| match message {
            NodeMessage::Hello(hello) => (hello.node, hello.boot, hello.versions, hello.configuration_hash),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(hashes, [(3, 77, Versions::OF_NODES, None), (3, 77, Versions::OF_NODES, Some(wanted.hash()))]);
}

#[test]
fn an_empty_frame_opens_every_conversation() {
    let mut bench = Bench { node: new_node(), row: 0, frames: Vec::new() };
    for _ in 0..2 {
        // What the host has heard before is half a frame.
        let mut decoder = FrameDecoder::new();
        let mut heard = Vec::new();
        let mut byte = [0];
        for noise in [7, 1, 2] {
            assert!(decoder.push(noise).is_none());
        }
        while bench.node.transmit(bench.now(), &mut byte) > 0 {
            heard.extend(decoder.push(byte[0]).map(|frame| frame.map(|frame| frame.message.to_vec())));
        }
        assert!(heard[0].is_err() && heard.len() == 2);
        let hello: NodeMessage<'_> = message::decode(heard[1].as_ref().unwrap()).unwrap();
        assert!(matches!(hello, NodeMessage::Hello(_)), "{hello:?}");
        bench.say(&GREET);
    }
}

#[test]
fn it_refuses_what_it_cannot_run_and_goes_on_with_what_it_had() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.listen();
    bench.frames.clear();
    let mut impossible = configuration(Summary::Lines { bits: 8 });
    impossible.decimation = 11;
    bench.say(&HostMessage::Configure(impossible.clone()));
    bench.say(&GREET);
    bench.listen();
    let refusal = Refusal { configuration_hash: impossible.hash(), reason: RefusalReason::Decimation };
    assert!(bench.messages().contains(&NodeMessage::Refused(refusal)));
    let hash = configuration(Summary::Lines { bits: 8 }).hash();
    assert!(bench.messages().iter().any(|m| matches!(m, NodeMessage::Hello(h) if h.configuration_hash == Some(hash))));
}

#[test]
fn its_lines_are_those_of_the_same_segment_computed_in_f64() {
    let mut bench = Bench::new(Summary::Lines { bits: 16 });
    bench.run(256 * 5 * 3, |row| [tone(row), 9.81 + 0.5 * tone(row + 7)]);
    let heads = bench.heads();
    // Samples are on the grid (row 0 is at 0), the filter reaches 13 samples back: window 1 (12.8 s) is the first.
    let seen: Vec<_> = heads.iter().map(|head| (head.name.number, head.grid_index, head.middle_offset_us)).collect();
    assert_eq!(seen, [(0, 1, 0), (1, 2, 0), (2, 3, 0)]);
    assert!(heads.iter().all(|head| head.channels == [SOUND, SOUND]));

    // The filter passes these tones unchanged (to 1e-4), so the reference is the tone at the decimated instants.
    let reference = |grid: usize, line: usize| {
        let (mut re, mut im, mut mean) = (0.0, 0.0, 0.0);
        let sample = |n: usize| f64::from(tone((grid * 128 + n) as u64 * 5));
        for n in 0..256 {
            mean += sample(n) / 256.0;
        }
        let slope =
            (0..256).map(|n| (n as f64 - 127.5) * sample(n)).sum::<f64>() / (256.0 * (256.0_f64.powi(2) - 1.0) / 12.0);
        for n in 0..256 {
            let phase = std::f64::consts::TAU * (line * n % 256) as f64 / 256.0;
            let weight = 0.5 - 0.5 * (std::f64::consts::TAU * n as f64 / 256.0).cos();
            let value = weight * (sample(n) - mean - slope * (n as f64 - 127.5));
            re += value * phase.cos();
            im -= value * phase.sin();
        }
        let scale = (2.0_f64 / (10.0 * 96.0)).sqrt();
        (re * scale, im * scale)
    };
    let (mut compared, mut largest, mut worst) = (0, 0.0_f64, 0.0_f64);
    for message in bench.messages() {
        let NodeMessage::Lines(part) = message else { continue };
        if part.channel != 0 {
            continue;
        }
        let mut lines = vec![Complex32::default(); usize::from(part.lines)];
        decode_lines(part.code, part.bits, &mut lines).unwrap();
        for (k, line) in lines.iter().enumerate() {
            let (re, im) = reference(part.name.number as usize + 1, usize::from(part.first_line) + k);
            worst = worst.max((f64::from(line.re) - re).hypot(f64::from(line.im) - im));
            largest = largest.max(re.hypot(im));
            compared += 1;
        }
    }
    assert_eq!(compared, 3 * 90);
    // The filter's ripple of 1e-4, and 16 bits.
    assert!(worst < 2e-4 * largest, "off by {worst} of {largest}");
}

#[test]
fn its_averaged_densities_peak_where_the_tones_are() {
    let mut bench = Bench::new(Summary::Psd { segments: 3 });
    bench.run(256 * 5 * 5, |row| [tone(row), 0.1 * tone(row) + 2e-3 * (row % 7) as f32]);
    let heads = bench.heads();
    assert_eq!(heads.iter().map(|head| head.grid_index).collect::<Vec<_>>(), [1, 4]);
    assert!(heads.iter().all(|head| head.channels == [ChannelState::Sound { segments: 3 }; 2]));
    let spacing = 10.0 / 256.0;
    let mut densities = 0;
    for message in bench.messages() {
        match message {
            NodeMessage::Peaks(part) => {
                let found: Vec<f32> = part.peaks.iter().take(2).map(|peak| peak.frequency_hz).collect();
                assert!(
                    (found[0] - 1.0).abs() < 0.05 * spacing && (found[1] - 2.2).abs() < 0.05 * spacing,
                    "{found:?}"
                );
            }
            NodeMessage::Density(part) => {
                let (line, _) = part.code.iter().enumerate().max_by_key(|(_, code)| **code).unwrap();
                assert!(((usize::from(part.first_line) + line) as f32 * spacing - 1.0).abs() <= spacing);
                // A sine of amplitude a has the mean square a^2/2, its density integrates to that.
                let power: f32 = part.code.iter().map(|&code| decode_density(part.base, code) * spacing).sum();
                let expected = if part.channel == 0 { 0.5 * (1.0 + 0.09) } else { 0.005 * (1.0 + 0.09) };
                assert!((power / expected - 1.0).abs() < 0.05, "{power} for {expected}");
                densities += 1;
            }
            _ => {}
        }
    }
    assert_eq!(densities, 4);
}

#[test]
fn windows_without_sound_data_say_why_and_keep_their_numbers() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.run(256 * 5 * 4, |row| {
        [if row == 2000 { f32::NAN } else { tone(row) }, if row < 2500 { 1.0 } else { tone(row) }]
    });
    let states: Vec<_> =
        bench.heads().iter().map(|head| (head.name.number, head.channels.clone().into_array::<2>().unwrap())).collect();
    use ChannelState::{Constant, Missing};
    // Row 2000 is sample 400: windows 2 (256..512) and 3 (384..640). The second channel comes alive at sample 500.
    assert_eq!(
        states,
        [
            (0, [SOUND, Constant]),
            (1, [Missing, SOUND]),
            (2, [Missing, SOUND]),
            (3, [SOUND, SOUND]),
            (4, [SOUND, SOUND])
        ]
    );
}

#[test]
fn rows_that_stay_out_count_as_missing_and_a_long_interruption_starts_over_on_the_grid() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.run(1000, |row| [tone(row); 2]);
    bench.row += 3;
    bench.run(256 * 5 * 2, |row| [tone(row); 2]);
    let states: Vec<_> = bench.heads().iter().map(|head| (head.grid_index, head.channels[0])).collect();
    // Rows 1000 to 1002 are samples 200 and neighbours: window 1 (128..384); window 2 (256..512) is clean.
    assert_eq!(states, [(1, ChannelState::Missing), (2, SOUND), (3, SOUND)]);
    bench.frames.clear();
    bench.row += 5000;
    bench.run(256 * 5 * 3, |row| [tone(row); 2]);
    let heads = bench.heads();
    // From row 8563 (sample 1712.6) and 13 samples of the filter on: window 14 (sample 1792) is the first.
    assert_eq!(
        heads.iter().map(|h| (h.name.number, h.grid_index, h.middle_offset_us)).collect::<Vec<_>>(),
        [(3, 14, 0), (4, 15, 0), (5, 16, 0), (6, 17, 0)]
    );
    assert!(heads.iter().all(|head| head.channels[0] == SOUND));
}

#[test]
fn a_node_that_gets_no_time_to_work_says_overrun_not_nothing() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.feed(256 * 5 * 40, |row| [tone(row); 2]);
    bench.listen();
    let states: Vec<_> = bench.heads().iter().map(|head| (head.name.number, head.channels[0])).collect();
    assert_eq!(states[0], (0, ChannelState::Overrun));
    assert!(states.windows(2).all(|pair| pair[1].0 == pair[0].0 + 1));
}

#[test]
fn parts_are_kept_until_acknowledged_and_sent_again_when_asked() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.run(256 * 5 * 3, |row| [tone(row); 2]);
    let first = bench.frames.clone();
    bench.frames.clear();
    let again = |boot, below, window, part| {
        let again = Again { first_window: window, last_window: window, first_part: part, last_part: part };
        HostMessage::Acknowledge(Acknowledgement { boot, below, again: HeaplessVec::from_slice(&[again]).unwrap() })
    };
    bench.say(&again(77, 1, 1, 2));
    bench.listen();
    assert_eq!(bench.frames.len(), 1);
    assert!(first.contains(&bench.frames[0]));
    bench.frames.clear();
    bench.say(&again(78, 9, 2, 2));
    bench.listen();
    assert!(bench.frames.is_empty(), "boot 78 is another node's life");
    // Window 1 is gone, which is said at once.
    bench.say(&again(77, 2, 1, 2));
    bench.listen();
    let NodeMessage::Hello(hello) = bench.messages().pop().unwrap() else { panic!("no hello") };
    assert_eq!((bench.frames.len(), hello.oldest_window, hello.next_window), (1, 2, 3));
    bench.row += 120 * 50;
    bench.listen();
    let NodeMessage::Heartbeat(heartbeat) = bench.messages().pop().unwrap() else { panic!("no heartbeat") };
    assert_eq!((heartbeat.next_window, heartbeat.oldest_window, heartbeat.lost_windows), (3, 2, 0));
    // RMS 0.738 about the mean, 0.784 about the first reading (0.263); the meter is good to 6 %.
    assert!((heartbeat.level[0] / 0.784 - 1.0).abs() < 0.065, "{heartbeat:?}");
}

fn acknowledge(below: u32) -> HostMessage {
    HostMessage::Acknowledge(Acknowledgement { boot: IDENTITY.boot, below, again: HeaplessVec::new() })
}

impl Bench {
    fn last_hello(&self) -> Hello {
        let is_hello = |message| if let NodeMessage::Hello(hello) = message { Some(hello) } else { None };
        self.messages().into_iter().rev().find_map(is_hello).unwrap()
    }

    /// The oldest window and the next, and the host it listens to.
    fn holds(&mut self) -> (u32, u32, Option<Conversation>) {
        self.node.pending.hello = true;
        self.listen();
        let hello = self.last_hello();
        (hello.oldest_window, hello.next_window, hello.conversation)
    }
}

#[test]
fn a_host_that_has_not_greeted_last_changes_nothing_and_learns_it() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.run(256 * 5 * 3, |row| [tone(row); 2]);
    let before = bench.holds();
    assert_eq!(before, (0, 3, Some(HOST)));
    let hash = bench.last_hello().configuration_hash;
    let set = ClockModel { node: bench.now(), host: HostTime(1 << 50), drift_ppb: 0 };
    let replay = message::Replay { start: HostTime(0) };
    let attempts = [
        acknowledge(3),
        HostMessage::Configure(configuration(Summary::Psd { segments: 4 })),
        HostMessage::SetClock(set),
        HostMessage::Replay(replay),
    ];
    for (attempt, message) in (1..).zip(&attempts) {
        bench.frames.clear();
        bench.say_in(OTHER, message);
        bench.listen();
        let hello = bench.last_hello();
        assert_eq!((hello.conversation, hello.configuration_hash, hello.replaying), (Some(HOST), hash, false));
        assert_eq!((bench.holds(), bench.node.refused_messages), (before, attempt), "{message:?}");
    }
    assert_eq!(bench.node.clock.unwrap().host, HostTime(0));
    // The one that greets is listened to from then on, and the one before no longer.
    bench.say_in(OTHER, &GREET);
    bench.say(&acknowledge(3));
    assert_eq!(bench.holds(), (0, 3, Some(OTHER)));
    bench.say_in(OTHER, &acknowledge(2));
    assert_eq!(bench.holds(), (2, 3, Some(OTHER)));
}

#[test]
fn windows_that_were_never_sent_are_not_taken_as_stored() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.run(256 * 5 * 3, |row| [tone(row); 2]);
    bench.say(&acknowledge(u32::MAX));
    bench.say(&acknowledge(4));
    assert_eq!((bench.holds(), bench.node.refused_messages), ((0, 3, Some(HOST)), 2));
    // A window more is there, and not on the line yet.
    bench.feed(640, |row| [tone(row); 2]);
    while bench.node.poll(bench.now()) {}
    bench.say(&acknowledge(4));
    assert_eq!(bench.holds(), (3, 4, Some(HOST)));
    bench.say(&acknowledge(4));
    assert_eq!(bench.holds(), (4, 4, Some(HOST)));
}

#[test]
fn an_outbox_that_overflows_counts_what_it_lost_and_keeps_the_newest() {
    let mut bench = Bench::new(Summary::Lines { bits: 16 });
    for _ in 0..200 {
        bench.feed(640, |row| [tone(row); 2]);
        while bench.node.poll(bench.now()) {}
    }
    bench.listen();
    let heads = bench.heads();
    // 25 600 samples less the filter's 13: window 197 of the grid is complete, and window 1 was number 0.
    assert_eq!(heads.last().unwrap().name.number, 196);
    let lost = bench.messages().iter().rev().find_map(|m| match m {
        NodeMessage::Heartbeat(heartbeat) => Some((heartbeat.lost_windows, heartbeat.oldest_window)),
        _ => None,
    });
    let oldest = heads[0].name.number;
    assert_eq!(lost, Some((oldest, oldest)));
    assert_eq!(heads.len() as u32, 197 - oldest);
}

/// How long an outage may last of which a chip of 512 KB keeps all windows: three channels with segments of 4096 points at 5 Hz, lines from 0.05 to
/// 1.5 Hz.
fn hours_kept(bits: u8) -> f64 {
    let configuration = Configuration {
        channels: 3,
        sampling_rate_uhz: 5_000_000,
        decimation: 1,
        segment: 4096,
        summary: Summary::Lines { bits },
        bands: HeaplessVec::from_slice(&[Band { first_line: 41, lines: 1188 }]).unwrap(),
    };
    let chip = crate::SimulatedChip::new(vec![0xFF; 512 << 10], crate::Technology::Fram);
    let store = crate::Store::open(chip, IDENTITY.boot);
    let mut node = Node::with_store(IDENTITY, Box::new(Memory::new()), store);
    let clock = ClockModel { node: NodeTime(0), host: HostTime(0), drift_ppb: 0 };
    for message in [GREET, HostMessage::Configure(configuration), HostMessage::SetClock(clock)] {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = message::encode(&InConversation { conversation: HOST, message }, &mut frame).unwrap();
        frame[..length].iter().for_each(|&byte| node.receive(NodeTime(0), byte));
    }
    let mut row = 0_u64;
    while node.store().lost_windows() == 0 {
        let time = NodeTime(row * 200_000);
        node.sample(time, &[tone(row), tone(3 * row), tone(7 * row)]);
        while node.poll(time) | node.keep(time) {}
        row += 1;
    }
    let oldest = node.store().oldest_window().unwrap();
    let windows = f64::from(node.windows.next_number() - oldest);
    windows * 2048.0 / 5.0 / 3600.0
}

#[test]
fn a_chip_of_512_kilobytes_keeps_the_windows_of_hours() {
    let (coarse, fine) = (hours_kept(6), hours_kept(10));
    std::println!("{coarse:.1} h of 6 bits, {fine:.1} h of 10 bits");
    // Bits of lines, of 8 Mbit s, leave no more than a quarter for the rest, with the sector that is overwritten next.
    let most = |bits: f64| (512 << 10) as f64 * 8.0 / (3.0 * 1188.0 * 2.0 * bits) * 2048.0 / 5.0 / 3600.0;
    assert!((0.75 * most(6.0)..most(6.0)).contains(&coarse), "{coarse} of {}", most(6.0));
    assert!((0.75 * most(10.0)..most(10.0)).contains(&fine), "{fine} of {}", most(10.0));
}

#[test]
fn a_clock_setting_that_was_overtaken_or_lies_in_the_future_changes_nothing() {
    let mut bench = Bench::new(Summary::Lines { bits: 8 });
    bench.run(256 * 5 * 2, |row| [tone(row); 2]);
    let set =
        |node, host| HostMessage::SetClock(ClockModel { node: NodeTime(node), host: HostTime(host), drift_ppb: 0 });
    let now = bench.now().0;
    bench.say(&set(now, now as i64));
    bench.say(&set(now - 1_000_000, now as i64 + 40_000));
    bench.say(&set(now + 1_000_000, now as i64 + 70_000));
    bench.run(256 * 5 * 2, |row| [tone(row); 2]);
    assert!(bench.heads().iter().all(|head| head.middle_offset_us == 0), "{:?}", bench.heads());
    bench.say(&set(bench.now().0, bench.now().0 as i64 + 30_000));
    bench.run(256 * 5 * 2, |row| [tone(row); 2]);
    // 30 ms later on the host: windows start 30 ms off, or a sample (100 ms) earlier.
    assert!([30_000, -70_000].contains(&bench.heads().last().unwrap().middle_offset_us));
}

/// A recording fed as messages gives the windows that the same rows give from a sensor, and is taken in order.
#[test]
fn a_recording_gives_the_windows_of_the_same_rows_from_a_sensor() {
    let readings = |row: u64| [tone(row), 9.81 + 0.5 * tone(row + 7)];
    let mut sampled = Bench::new(Summary::Lines { bits: 16 });
    sampled.run(256 * 5 * 3, readings);

    let mut fed = Bench { node: new_node(), row: 0, frames: Vec::new() };
    fed.say(&GREET);
    fed.say(&HostMessage::Replay(message::Replay { start: HostTime(0) }));
    fed.listen();
    let replaying = |bench: &Bench| {
        let hello = bench.messages().into_iter().rev().find_map(|message| match message {
            NodeMessage::Hello(hello) => Some(hello),
            _ => None,
        });
        hello.unwrap().replaying
    };
    assert!(!replaying(&fed), "there is no configuration yet");
    fed.say(&HostMessage::Configure(configuration(Summary::Lines { bits: 16 })));
    fed.say(&HostMessage::Replay(message::Replay { start: HostTime(0) }));
    fed.listen();
    assert!(replaying(&fed) && fed.node.sampling_rate_uhz().is_none());
    let part = |first_row: u64, rows: u64| {
        let readings = (first_row..first_row + rows).flat_map(readings).collect();
        HostMessage::Feed(message::FeedPart { first_row, readings })
    };
    let mut row = 0;
    while row < 256 * 5 * 3 {
        // The sensor is left alone meanwhile, and a part that came before is not taken twice.
        fed.node.sample(NodeTime(1_000_000_000 + row), &[1.0, 2.0]);
        fed.say(&part(row, 40));
        fed.say(&part(row, 40));
        fed.frames.retain(|frame| !matches!(message::decode(frame).unwrap(), NodeMessage::Fed(_)));
        fed.listen();
        row += 40;
        assert_eq!(fed.messages().last(), Some(&NodeMessage::Fed(Fed { next_row: row })));
    }
    let data = |bench: &Bench| -> Vec<Vec<u8>> {
        let is_data =
            |frame: &&Vec<u8>| matches!(message::decode(frame).unwrap(), NodeMessage::Head(_) | NodeMessage::Lines(_));
        bench.frames.iter().filter(is_data).cloned().collect()
    };
    assert_eq!(data(&fed).len(), 3 * 3);
    assert_eq!(data(&fed), data(&sampled));

    fed.say(&HostMessage::EndReplay);
    fed.listen();
    assert!(!replaying(&fed) && fed.node.sampling_rate_uhz() == Some(50_000_000));
}

#[test]
fn the_node_fits_into_112_kilobytes() {
    let bytes = size_of::<Node<&mut Memory>>() + size_of::<Memory>();
    assert!(bytes <= 112 * 1024, "{bytes}");
}

#[test]
fn every_stage_count_of_decimation_runs() {
    for decimation in [1, 10, 60, 200] {
        let mut bench = Bench::new(Summary::Lines { bits: 8 });
        let mut wanted = configuration(Summary::Lines { bits: 8 });
        wanted.decimation = decimation;
        bench.say(&HostMessage::Configure(wanted));
        let settling = u64::from(Stages::of(decimation).unwrap().reach_rows());
        bench.run(u64::from(decimation) * 256 * 2 + 2 * settling, |row| [tone(row); 2]);
        assert!(!bench.heads().is_empty(), "decimation {decimation}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn no_bytes_samples_or_times_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        steps in prop::collection::vec((any::<u64>(), any::<[f32; 2]>(), 0_u8..3), 0..200),
        clocks in prop::collection::vec((any::<u64>(), any::<i64>(), any::<i32>()), 1..4),
        segments in 0_u16..4,
    ) {
        let mut bench = Bench::new(if segments == 0 { Summary::Lines { bits: 5 } } else { Summary::Psd { segments } });
        for (node, host, drift_ppb) in clocks {
            bench.say(&HostMessage::SetClock(ClockModel { node: NodeTime(node), host: HostTime(host), drift_ppb }));
            for &byte in &bytes {
                bench.node.receive(NodeTime(1), byte);
            }
            let mut time = 0_u64;
            for &(jump, readings, kind) in &steps {
                time = match kind { 0 => time.wrapping_add(PERIOD_US), 1 => time.wrapping_add(jump % 10_000_000), _ => jump };
                bench.node.sample(NodeTime(time), &readings);
                bench.node.poll(NodeTime(time));
                let _ = bench.node.transmit(NodeTime(time), &mut [0; 100]);
            }
        }
    }
}
