//! Conversations with a real node over a simulated line, and with impostors.

mod keys;
mod versions;

use std::io;

use super::stages::{INSPECTIONS, RETRY_US};
use super::*;
use crate::link::clock::MOST_FIRST_EXCHANGES;
use crate::link::memory::{Faults, Line};
use crate::window::{KeptWindows, NodeWindow};
use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES, PROTOCOL_VERSION};
use belfry_shared::message::{
    self, Acknowledgement, Band, ChannelState, Configuration, Conversation, Greeting, InConversation, RefusalReason,
    Versions, WindowHead, WindowName,
};
use belfry_shared::time::{NodeTime, WindowGrid};
use proptest::prelude::*;
use versions::Translator;

const BAUD: u32 = 115_200;

fn configuration() -> Configuration {
    Configuration {
        channels: 1,
        sampling_rate_uhz: 50_000_000,
        decimation: 5,
        segment: 256,
        summary: Summary::Lines { bits: 8 },
        bands: [Band { first_line: 3, lines: 60 }].into_iter().collect(),
    }
}

fn node(boot: u32) -> Node<Box<Memory>> {
    let identity = Identity { node: 3, boot, channels: 1, full_scale_m_s2: 19.6, highest_rate_mhz: 4_000_000 };
    Node::new(identity, Box::new(Memory::new()))
}

/// A session and a node joined by a line, in steps of 20 ms (a row each).
struct Bench {
    line: Line,
    node: Node<Box<Memory>>,
    session: Session,
    step: i64,
    node_start: i64,
    /// How far the host's clock is set ahead.
    host_ahead_us: i64,
    /// What makes one of the ends one of another version.
    to_node: Option<Translator>,
    to_host: Option<Translator>,
    /// What the node has said.
    carried: Vec<u8>,
}

/// The number under which sessions speak here.
const CONVERSATION: Conversation = Conversation([0xC0, 0x4E, 0x56, 1]);

fn new_session() -> Session {
    Session::new(3, Configurations::only(configuration()), BAUD).with_conversation(CONVERSATION)
}

impl Bench {
    fn new(faults: Faults) -> Self {
        let line = Line::new(BAUD, faults, 11);
        Self {
            line,
            node: node(77),
            session: new_session(),
            step: 0,
            node_start: -900,
            host_ahead_us: 0,
            to_node: None,
            to_host: None,
            carried: Vec::new(),
        }
    }

    /// One step; the node's clock gains 15 ppm and started at `node_start`.
    fn step(&mut self, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        self.step += 1;
        for part in 0..20 {
            let now_us = self.step * 20_000 + part * 1000;
            let node_us = (now_us - self.node_start * 20_000) as f64 * (1.0 + 15e-6);
            let node_time = NodeTime(node_us as u64);
            self.line.advance(now_us * 1000);
            let mut node_end = self.line.node_end();
            if part == 0 {
                self.node.sample(node_time, &[(self.step as f32 * 0.37).sin()]);
            }
            let mut buffer = [0; 64];
            while let count @ 1.. = node_end.read(&mut buffer).unwrap() {
                let bytes = buffer[..count].to_vec();
                let bytes = self.to_node.as_mut().map_or(bytes.clone(), |translator| translator.carry(&bytes));
                bytes.iter().for_each(|&byte| self.node.receive(node_time, byte));
            }
            while self.node.poll(node_time) {}
            if self.line.node_free_at() <= now_us * 1000 {
                let mut frame = [0; MAX_FRAME_BYTES];
                let count = self.node.transmit(node_time, &mut frame);
                let bytes = frame[..count].to_vec();
                let bytes = self.to_host.as_mut().map_or(bytes.clone(), |translator| translator.carry(&bytes));
                self.carried.extend(&bytes);
                node_end.write(&bytes).unwrap();
            }
            let host_time = HostTime(now_us + self.host_ahead_us);
            self.session.service(&|| host_time, &mut self.line.host_end(), sink)?;
        }
        Ok(())
    }

    fn run(&mut self, steps: usize, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
        (0..steps).try_for_each(|_| self.step(sink))
    }
}

#[test]
fn a_node_is_brought_to_measuring_and_its_clock_found() {
    let mut bench = Bench::new(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 200, &mut windows).unwrap();
    assert!(bench.session.is_measuring());
    let model = bench.session.clock.model().unwrap();
    // The host's clock runs 15 ppm slower than the node's. The bench looks at the line every ms, and 1 ms over the two
    // minutes of exchanges is 8 ppm.
    assert!((model.drift_ppb + 15_000).abs() < 10_000, "{model:?}");
    // 200 s less the first seconds, a hop of 12.8 s.
    assert!((13..=15).contains(&windows.len()), "{}", windows.len());
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.grid_index == a.grid_index + 1));
    // Windows start within half a decimated sample (50 ms) of the grid, and the first ones on it.
    assert!(windows.iter().all(|window| window.middle_offset_us.abs() <= 50_000), "{windows:?}");
}

#[test]
fn the_handshake_survives_a_line_that_loses_every_third_frame() {
    let mut bench = Bench::new(Faults::damaging(0.33));
    bench.run(50 * 30, &mut Vec::<NodeWindow>::new()).unwrap();
    assert!(bench.session.is_measuring());
}

#[test]
fn a_node_that_restarts_is_set_up_again_and_goes_on_under_its_new_name() {
    let mut bench = Bench::new(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 60, &mut windows).unwrap();
    let before = windows.len();
    bench.node = node(78);
    bench.node_start = bench.step;
    bench.run(50 * 60, &mut windows).unwrap();
    assert!(before >= 2 && windows.len() >= before + 2, "{before}, then {}", windows.len());
    assert!(windows[..before].iter().all(|window| window.name.boot == 77));
    let after: Vec<(u32, u32)> =
        windows[before..].iter().map(|window| (window.name.boot, window.name.number)).collect();
    assert_eq!(after[..2], [(78, 0), (78, 1)]);
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.grid_index > a.grid_index));
}

/// A line that keeps what is said.
struct Said(Vec<u8>);

impl Transport for Said {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.extend(bytes);
        Ok(())
    }

    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        Ok(0)
    }
}

/// Refuses to store from a certain window on.
struct FullDisk {
    room: usize,
    stored: usize,
}

impl WindowSink for FullDisk {
    fn store(&mut self, _: NodeWindow) -> io::Result<()> {
        if self.stored == self.room {
            return Err(io::Error::other("no space left"));
        }
        self.stored += 1;
        Ok(())
    }
}

#[test]
fn a_window_that_cannot_be_stored_ends_the_session_and_is_not_acknowledged() {
    let mut bench = Bench::new(Faults::default());
    let mut disk = FullDisk { room: 2, stored: 0 };
    let error = bench.run(50 * 100, &mut disk).unwrap_err();
    assert!(
        matches!(&error, SessionError::Store { node: 3, source } if source.to_string() == "no space left"),
        "{error}"
    );
    // Windows 0 and 1 are stored; 2 is not, and stays in the node.
    assert_eq!(bench.session.delivery.present.as_ref().unwrap().below(), 2);
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.session = new_session();
    bench.run(50 * 100, &mut windows).unwrap();
    assert!(windows.iter().any(|window| window.name.number == 2), "a new session gets it");
}

/// What a session says to the given bytes.
fn heard(bytes: &[u8]) -> Result<(), SessionError> {
    new_session().receive(HostTime(0), bytes, &mut Vec::<NodeWindow>::new())
}

fn frame(message: &NodeMessage<'_>) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = message::encode(message, &mut frame).unwrap();
    frame[..length].to_vec()
}

fn hello() -> Hello {
    Hello {
        versions: Versions::OF_NODES,
        node: 3,
        boot: 1,
        answers: None,
        conversation: Some(CONVERSATION),
        channels: 1,
        configuration_hash: None,
        clock_set: false,
        oldest_window: 0,
        next_window: 0,
        replaying: false,
        fault: None,
        counters: None,
        kept: None,
        calibration: None,
    }
}

#[test]
fn nodes_that_do_not_fit_are_refused_with_what_to_do() {
    assert!(heard(&frame(&NodeMessage::Hello(hello()))).is_ok());
    let other_node = Hello { node: 4, ..hello() };
    let error = heard(&frame(&NodeMessage::Hello(other_node))).unwrap_err().to_string();
    assert!(error.contains("node 4") && error.contains("node 3") && error.contains("study.toml"), "{error}");
    let refusal = belfry_shared::message::Refusal {
        configuration_hash: configuration().hash(),
        reason: RefusalReason::Memory { needed: 30_000, available: 25_600 },
    };
    let error = heard(&frame(&NodeMessage::Refused(refusal))).unwrap_err().to_string();
    assert!(error.contains("30000") && error.contains("25600"), "{error}");
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000), chunks in 1_usize..50) {
        let mut session = new_session();
        let mut windows: Vec<NodeWindow> = Vec::new();
        for (index, chunk) in bytes.chunks(chunks).enumerate() {
            let now = HostTime(index as i64 * 100_000);
            let _ = session.receive(now, chunk, &mut windows);
            session.poll(now);
            let _ = session.next_due();
        }
        prop_assert!(windows.is_empty());
    }
}

/// A session that a node of the given boot has greeted, configured and with its clock set.
fn measuring(boot: u32) -> Session {
    let mut session = new_session();
    let ready = Hello { boot, configuration_hash: Some(configuration().hash()), clock_set: true, ..hello() };
    session.greeted(HostTime(0), &ready, &mut Vec::<NodeWindow>::new()).unwrap();
    session.stage = Stage::Measuring;
    session
}

fn heartbeat(boot: u32, oldest_window: u32, next_window: u32) -> NodeMessage<'static> {
    NodeMessage::Heartbeat(belfry_shared::message::Heartbeat {
        node: 3,
        boot,
        next_window,
        oldest_window,
        lost_windows: 0,
        damaged_frames: 0,
        refused_messages: 0,
        level: Default::default(),
        sensors: Default::default(),
        lost_rows: 0,
        board: Default::default(),
        unknown_messages: 0,
        unsealed_messages: 0,
        stale_rows: 0,
        variance: Default::default(),
        mean: Default::default(),
    })
}

/// A window without sound data: a head and nothing else.
fn unsound(boot: u32, number: u32) -> NodeMessage<'static> {
    NodeMessage::Head(belfry_shared::message::WindowHead {
        name: belfry_shared::message::WindowName { node: 3, boot, number },
        configuration_hash: configuration().hash(),
        // Within a day, however long the node has measured.
        grid_index: u64::from(number % 1000),
        middle_offset_us: 0,
        drift_ppb: 0,
        data_parts: 0,
        channels: [ChannelState::Missing].into_iter().collect(),
    })
}

fn tell(session: &mut Session, message: &NodeMessage<'_>, sink: &mut dyn WindowSink) -> Result<(), SessionError> {
    session.receive(HostTime(1_000_000), &frame(message), sink)
}

#[test]
fn an_acknowledgement_that_must_wait_does_not_make_the_session_due_at_once() {
    let mut session = measuring(1);
    tell(&mut session, &unsound(1, 0), &mut Vec::<NodeWindow>::new()).unwrap();
    session.stage = Stage::Greeting;
    let now = HostTime(2_000_000);
    session.poll(now);
    assert!(
        session.next_due() > now,
        "due at {:?} although nothing is said before the next greeting",
        session.next_due()
    );
}

#[test]
fn a_clock_reply_with_any_times_is_survived() {
    for (host_sent, node_received, node_sent) in [(i64::MAX, 0, 0), (i64::MIN, 0, u64::MAX), (-5, i64::MAX as u64, 0)] {
        let mut session = measuring(1);
        let reply = belfry_shared::message::ClockReply {
            host_sent: HostTime(host_sent),
            node_received: NodeTime(node_received),
            node_sent: NodeTime(node_sent),
            believed_delay_us: Some(host_sent),
        };
        for _ in 0..2 {
            tell(&mut session, &NodeMessage::Clock(reply), &mut Vec::<NodeWindow>::new()).unwrap();
        }
    }
}

#[test]
fn what_a_restarted_node_had_not_delivered_is_counted_as_lost() {
    let mut session = measuring(1);
    tell(&mut session, &heartbeat(1, 0, 4), &mut Vec::<NodeWindow>::new()).unwrap();
    tell(&mut session, &NodeMessage::Hello(Hello { boot: 2, ..hello() }), &mut Vec::<NodeWindow>::new()).unwrap();
    assert_eq!(session.statistics().lost_windows, 4);
}

#[test]
fn a_greeting_from_a_nodes_last_life_that_comes_late_delivers_nothing_twice() {
    let mut session = measuring(1);
    let mut windows: Vec<NodeWindow> = Vec::new();
    tell(&mut session, &unsound(1, 0), &mut windows).unwrap();
    for boot in [2, 1] {
        tell(&mut session, &NodeMessage::Hello(Hello { boot, ..hello() }), &mut windows).unwrap();
    }
    tell(&mut session, &unsound(1, 0), &mut windows).unwrap();
    assert_eq!(windows.len(), 1);
}

#[test]
fn a_window_that_could_not_be_stored_comes_again_when_there_is_room() {
    let mut session = measuring(1);
    let failed = tell(&mut session, &unsound(1, 0), &mut FullDisk { room: 0, stored: 0 });
    assert!(matches!(failed, Err(SessionError::Store { .. })));
    let mut windows: Vec<NodeWindow> = Vec::new();
    tell(&mut session, &unsound(1, 0), &mut windows).unwrap();
    assert_eq!((windows.len(), session.statistics().lost_windows), (1, 0));
}

#[test]
fn a_session_finds_its_place_with_a_node_that_has_measured_for_weeks() {
    let mut session = measuring(1);
    let mut windows: Vec<NodeWindow> = Vec::new();
    tell(&mut session, &heartbeat(1, 70_000, 70_003), &mut windows).unwrap();
    tell(&mut session, &unsound(1, 70_000), &mut windows).unwrap();
    assert_eq!(windows.len(), 1);
}

/// The messages that a session says, read from its outgoing bytes.
fn said(session: &mut Session) -> Vec<HostMessage> {
    let mut decoder = FrameDecoder::new();
    let mut said = Said(Vec::new());
    session.wire.send(&mut said).unwrap();
    let bytes = said.0;
    let frames = bytes.iter().filter_map(|&byte| decoder.push(byte).map(|frame| frame.unwrap().message.to_vec()));
    frames.map(|frame| message::decode::<InConversation>(&frame).unwrap().message).collect()
}

#[test]
fn a_node_that_was_left_in_a_recording_is_told_to_measure_again() {
    let mut session = measuring(1);
    let left = Hello { replaying: true, ..hello() };
    tell(&mut session, &NodeMessage::Hello(left), &mut Vec::<NodeWindow>::new()).unwrap();
    assert!(!session.is_measuring());
    assert!(said(&mut session).contains(&HostMessage::EndReplay));
}

#[test]
fn windows_of_another_study_end_the_session_unless_they_may_be_dropped() {
    let NodeMessage::Head(head) = unsound(1, 0) else { panic!("a window without data is a head") };
    let foreign = NodeMessage::Head(message_of_another_study(head));
    let mut windows: Vec<NodeWindow> = Vec::new();
    let mut session = measuring(1);
    let error = tell(&mut session, &foreign, &mut windows).unwrap_err();
    assert!(matches!(error, SessionError::ForeignWindows { node: 3 }), "{error}");
    let acknowledges = |session: &mut Session| {
        said(session).iter().any(|message| matches!(message, HostMessage::Acknowledge(said) if said.below > 0))
    };
    assert!(!acknowledges(&mut session));
    // Tried again later, nor does it acknowledge it then.
    session.reconnect();
    tell(&mut session, &NodeMessage::Hello(hello()), &mut windows).unwrap();
    for _ in 0..3 {
        tell(&mut session, &heartbeat(1, 0, 1), &mut windows).unwrap();
        session.poll(HostTime(1_000_000_000));
        assert!(!acknowledges(&mut session));
    }
    let mut session = measuring(1).dropping_foreign(true);
    tell(&mut session, &foreign, &mut windows).unwrap();
    assert_eq!((session.statistics().foreign_windows, session.statistics().lost_windows, windows.len()), (1, 0, 0));
}

#[test]
fn a_node_that_measures_for_another_study_is_asked_for_windows_before_it_is_told_anything() {
    let NodeMessage::Head(head) = unsound(1, 7) else { panic!("a window without data is a head") };
    let foreign = NodeMessage::Head(message_of_another_study(head));
    let greeting = || {
        let configuration_hash = Some(configuration().hash() ^ 1);
        NodeMessage::Hello(Hello { configuration_hash, oldest_window: 7, next_window: 8, ..hello() })
    };
    let mut windows: Vec<NodeWindow> = Vec::new();
    let mut session = new_session();
    tell(&mut session, &greeting(), &mut windows).unwrap();
    let is_for_the_oldest = |message: &HostMessage| {
        let HostMessage::Acknowledge(asked) = message else { return false };
        asked.below == 7 && asked.again.iter().any(|again| again.first_window == 7 && again.first_part == 0)
    };
    session.poll(HostTime(0));
    let first = said(&mut session);
    assert!(first.len() == 1 && is_for_the_oldest(&first[0]), "{first:?}");
    let error = tell(&mut session, &foreign, &mut windows).unwrap_err();
    assert!(matches!(error, SessionError::ForeignWindows { node: 3 }), "{error}");
    // One that has none is taken over.
    let mut session = new_session();
    tell(&mut session, &greeting(), &mut windows).unwrap();
    let mut messages = Vec::new();
    for tick in 0..10 {
        session.poll(HostTime(tick * RETRY_US));
        messages.extend(said(&mut session));
    }
    assert_eq!(messages.iter().filter(|message| is_for_the_oldest(message)).count(), INSPECTIONS as usize);
    assert!(messages.iter().any(|message| matches!(message, HostMessage::Configure(_))), "{messages:?}");
}

/// Writes on the line what another program says.
fn say_as_other(line: &Line, message: HostMessage) {
    say_as(line, Conversation([9; 4]), message);
}

fn say_as(line: &Line, conversation: Conversation, message: HostMessage) {
    let message = InConversation { conversation, message };
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = message::encode(&message, &mut frame).unwrap();
    line.host_end().write(&frame[..length]).unwrap();
}

#[test]
fn what_another_program_says_on_the_line_costs_no_window() {
    let mut bench = Bench::new(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    for _ in 0..200 {
        for below in [1, 2, 9, u32::MAX] {
            let forged = Acknowledgement { boot: 77, below, again: Default::default() };
            say_as_other(&bench.line, HostMessage::Acknowledge(forged));
        }
        let other = Configuration { segment: 512, ..configuration() };
        say_as_other(&bench.line, HostMessage::Configure(other));
        bench.run(50, &mut windows).unwrap();
    }
    let numbers: Vec<u32> = windows.iter().map(|window| window.name.number).collect();
    assert!(
        numbers.len() >= 12 && numbers.iter().enumerate().all(|(at, &number)| at == number as usize),
        "{numbers:?}"
    );
    assert_eq!(bench.session.statistics().lost_windows, 0);
}

#[test]
fn a_node_that_another_program_has_greeted_is_greeted_again_and_left_to_it_where_it_goes_on() {
    let mut bench = Bench::new(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 20, &mut windows).unwrap();
    say_as_other(&bench.line, HostMessage::Greet(Greeting::OF_HOSTS));
    bench.run(50 * 60, &mut windows).unwrap();
    assert!(bench.session.is_measuring() && windows.len() >= 4, "{}", windows.len());
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.name.number == a.name.number + 1));
    let mut fight = || {
        say_as_other(&bench.line, HostMessage::Greet(Greeting::OF_HOSTS));
        bench.run(50, &mut windows)
    };
    let error = (0..20).find_map(|_| fight().err()).expect("it is said that another program collects");
    assert!(matches!(error, SessionError::TakenOver { node: 3 }), "{error}");
}

#[test]
fn windows_of_another_node_or_of_a_time_that_has_not_been_are_refused() {
    let NodeMessage::Head(head) = unsound(1, 0) else { panic!("a window without data is a head") };
    let mut session = measuring(1);
    let mut windows: Vec<NodeWindow> = Vec::new();
    let of_another = belfry_shared::message::WindowName { node: 8, ..head.name };
    // A hop is 12.8 s; the host's clock stands at 1 s. Two days ahead, a century, and what no date has.
    let grid_indices = [2 * 86_400 * 10 / 128, 100 * 366 * 86_400 * 10 / 128, u64::MAX / 2, u64::MAX];
    let wrong = grid_indices.map(|grid_index| WindowHead { grid_index, ..head.clone() });
    let wrong = wrong.into_iter().chain([WindowHead { name: of_another, ..head.clone() }]);
    for (refused, head) in (1..).zip(wrong) {
        tell(&mut session, &NodeMessage::Head(head.clone()), &mut windows).unwrap();
        assert_eq!((session.statistics().contradictions, windows.len()), (refused, 0), "{head:?}");
    }
    // Nor does another node's sign of life say what this one has.
    let NodeMessage::Heartbeat(heartbeat) = heartbeat(1, 5, 9) else { panic!("a heartbeat") };
    let of_another = belfry_shared::message::Heartbeat { node: 8, ..heartbeat };
    tell(&mut session, &NodeMessage::Heartbeat(of_another), &mut windows).unwrap();
    assert_eq!((session.statistics().lost_windows, session.heartbeat()), (0, None));
    tell(&mut session, &NodeMessage::Head(head), &mut windows).unwrap();
    assert_eq!(windows.len(), 1, "the window itself still comes");
}

/// A peer that always has something to say.
struct Endless {
    said: Vec<u8>,
    at: usize,
}

impl Transport for Endless {
    fn write(&mut self, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        for place in buffer.iter_mut() {
            *place = self.said[self.at % self.said.len()];
            self.at += 1;
        }
        Ok(buffer.len())
    }
}

#[test]
fn a_peer_that_never_pauses_leaves_its_host_time_for_everything_else() {
    for said in [vec![7], vec![0], frame(&NodeMessage::Hello(hello())), frame(&heartbeat(1, 0, 9))] {
        let mut peer = Endless { said, at: 0 };
        let mut session = measuring(1);
        for _ in 0..3 {
            session.service(&|| HostTime(0), &mut peer, &mut Vec::<NodeWindow>::new()).unwrap();
        }
        let mut peer = Endless { said: vec![7, 0], at: 0 };
        let greeted = crate::link::Greeting::new().service(std::time::Duration::ZERO, &mut peer);
        assert!(matches!(greeted, Ok(None)));
    }
}

fn message_of_another_study(head: belfry_shared::message::WindowHead) -> belfry_shared::message::WindowHead {
    belfry_shared::message::WindowHead { configuration_hash: head.configuration_hash ^ 1, ..head }
}

#[test]
fn an_earlier_hosts_time_stays_until_a_better_one_is_known() {
    let mut bench = Bench::new(Faults::default());
    let mut windows: Vec<NodeWindow> = Vec::new();
    bench.run(50 * 60, &mut windows).unwrap();
    bench.session = new_session();
    // Four seconds, in which no window comes.
    bench.run(50 * 4, &mut windows).unwrap();
    assert!(bench.session.is_measuring() && bench.session.knows_time);
    // One that was told by a host whose clock was wrong does not.
    bench.host_ahead_us = 3_600_000_000;
    bench.session = new_session();
    bench.run(50 * 4, &mut windows).unwrap();
    assert!(bench.session.is_measuring() && !bench.session.knows_time);
    let before = windows.len();
    bench.run(50 * 120, &mut windows).unwrap();
    let grid = WindowGrid { sampling_rate_uhz: 50_000_000, hop_samples: configuration().hop_samples() };
    let ahead = windows[before..].iter().filter(|window| grid.start(window.grid_index).0 > bench.host_ahead_us).count();
    assert!(ahead > 2 && windows.len() - before <= ahead + 3, "{ahead} of {}", windows.len() - before);
    // The host's own clock was set: now at once.
    bench.session.restart();
    bench.run(50 * 60, &mut windows).unwrap();
    assert!(bench.session.is_measuring() && !bench.session.knows_time && !bench.session.must_set_time);
}

/// Windows that were kept of a life before this session, as an archive has them.
struct KeptBefore {
    kept: Vec<(u32, u64)>,
    stored: Vec<NodeWindow>,
}

impl WindowSink for KeptBefore {
    fn store(&mut self, window: NodeWindow) -> io::Result<()> {
        self.kept.push((window.name.number, window.grid_index));
        self.stored.push(window);
        Ok(())
    }

    fn kept(&mut self, _: u16, _: u32, _: u32) -> io::Result<Option<KeptWindows>> {
        let numbers = self.kept.iter().map(|(number, _)| *number).collect();
        Ok(Some(KeptWindows { numbers, last: self.kept.last().copied(), ..KeptWindows::default() }))
    }

    fn start(&mut self, name: &WindowName) -> io::Result<Option<u64>> {
        Ok(self.kept.iter().find(|(number, _)| *number == name.number).map(|(_, start)| *start))
    }
}

#[test]
fn a_late_window_from_before_the_clock_was_set_back_is_no_other_life() {
    let head = |number: u32, grid_index: u64| WindowHead {
        name: WindowName { node: 3, boot: 77, number },
        configuration_hash: configuration().hash(),
        grid_index,
        middle_offset_us: 0,
        drift_ppb: 0,
        data_parts: 0,
        channels: [ChannelState::Missing].into_iter().collect(),
    };
    let deliver = |head: WindowHead| {
        let mut delivery = crate::link::delivery::Delivery::new(3, Configurations::only(configuration()));
        // Window 1 had not come when the time was set back, after which window 2 began earlier than it.
        let mut sink = KeptBefore { kept: vec![(0, 100), (2, 50)], stored: Vec::new() };
        delivery.present = Some(crate::window::Assembler::resuming(3, 77, &sink.kept(3, 77, 0).unwrap().unwrap()));
        let part = NodeMessage::Head(head);
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = message::encode(&part, &mut frame).unwrap();
        let mut decoder = FrameDecoder::new();
        let encoded =
            frame[..length].iter().find_map(|&byte| decoder.push(byte).map(|m| m.unwrap().message.to_vec())).unwrap();
        delivery.take(None, &part, &encoded, &mut sink).map(|()| sink.stored.len())
    };
    assert_eq!(deliver(head(1, 101)).unwrap(), 1);
    assert_eq!(deliver(head(0, 100)).unwrap(), 0, "it is kept already");
    assert!(matches!(deliver(head(0, 130)), Err(SessionError::RepeatedLife { node: 3 })));
}

#[test]
fn a_host_that_never_lives_for_long_has_the_node_forget_what_is_stored() {
    let mut bench = Bench::new(Faults::default());
    let mut sink = KeptBefore { kept: Vec::new(), stored: Vec::new() };
    bench.run(2000, &mut sink).unwrap();
    // Half a second each: too short for the exchanges that its clock is measured with first.
    for _ in 0..100 {
        bench.session = new_session();
        bench.run(25, &mut sink).unwrap();
        assert!(!bench.session.is_measuring());
    }
    let numbers: Vec<u32> = sink.kept.iter().map(|(number, _)| *number).collect();
    assert!(numbers.len() > 2 && numbers.iter().copied().eq(0..numbers.len() as u32), "{numbers:?}");
    let oldest = bench.session.hello().unwrap().oldest_window;
    assert!(oldest as usize >= numbers.len() - 1, "the node still has windows from {oldest} on of {numbers:?}");
}

#[test]
fn on_a_line_that_jitters_the_clock_is_measured_for_longer_before_it_is_set() {
    let exchanges = |faults: Faults| {
        let mut bench = Bench::new(faults);
        while !bench.session.is_measuring() {
            bench.run(1, &mut Vec::<NodeWindow>::new()).unwrap();
            assert!(bench.step < 1000, "it never measures");
        }
        let now_us = bench.step * 20_000;
        let node_us = (now_us - bench.node_start * 20_000) as f64 * (1.0 + 15e-6);
        let model = bench.session.clock.model().unwrap();
        (bench.session.clock.len(), model.host_time(NodeTime(node_us as u64)).0 - now_us)
    };
    assert_eq!(exchanges(Faults::default()).0, FIRST_EXCHANGES);
    let (count, error_us) = exchanges(Faults { jitter_us: 40_000, ..Faults::default() });
    assert_eq!(count, MOST_FIRST_EXCHANGES);
    // The quickest of thirty draws of up to 40 ms each way is 1.3 ms late, give or take as much.
    assert!(error_us.abs() < 4_000, "{error_us} µs");
}
