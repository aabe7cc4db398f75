//! Conversations across versions: the node of this release behind a translator that makes it one of another version, and a host of the next
//! version before the node of this release.

use super::*;
use belfry_shared::frame::{END_OF_FRAME, FrameDecoder, encode_as};
use serde::Serialize;

const NEXT: u8 = PROTOCOL_VERSION + 1;
/// What version 5 says of the layout of its messages.
const SCHEMA_5: u64 = 0x079a_30d7_5a7f_20c2;

/// Frames that stand for a frame of this version: the version and the message of each.
type Translation = fn(u8, Vec<u8>) -> Vec<(u8, Vec<u8>)>;

/// Puts what one end says into another version.
pub(super) struct Translator {
    decoder: FrameDecoder,
    translate: Translation,
}

impl Translator {
    fn new(translate: Translation) -> Option<Self> {
        Some(Self { decoder: FrameDecoder::new(), translate })
    }

    pub(super) fn carry(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut carried = Vec::new();
        for &byte in bytes {
            let frames = match self.decoder.push(byte) {
                Some(Ok(opened)) => (self.translate)(opened.version, opened.message.to_vec()),
                Some(Err(error)) => panic!("no noise is on this line: {error}"),
                None if byte == END_OF_FRAME => {
                    carried.push(END_OF_FRAME);
                    continue;
                }
                None => continue,
            };
            for (version, message) in frames {
                let mut frame = [0; MAX_FRAME_BYTES];
                let length = encode_as(version, &message, &mut frame).unwrap();
                carried.extend(&frame[..length]);
            }
        }
        carried
    }
}

/// A line on which everything is lost.
pub(super) fn silence() -> Translator {
    Translator { decoder: FrameDecoder::new(), translate: |_, _| Vec::new() }
}

fn postcard_bytes(value: &impl Serialize) -> Vec<u8> {
    postcard::to_slice(value, &mut [0; 512]).unwrap().to_vec()
}

/// What a node of version 5 hears as the node of this release would.
fn from_host_5(version: u8, mut message: Vec<u8>) -> Vec<(u8, Vec<u8>)> {
    if version != 5 {
        // It counts it as damaged.
        return Vec::new();
    }
    if message[4..] == [0] {
        message.extend([PROTOCOL_VERSION, PROTOCOL_VERSION, 0]);
    }
    vec![(PROTOCOL_VERSION, message)]
}

/// What the node of this release says as one of version 5 would.
fn from_node_5(_: u8, message: Vec<u8>) -> Vec<(u8, Vec<u8>)> {
    let body = match message::decode(&message).unwrap() {
        NodeMessage::Hello(hello) => {
            let Hello { node, boot, channels, configuration_hash, clock_set, .. } = hello;
            let fault = hello.fault.map(|fault| (fault.kind, fault.address, fault.place));
            let rest = (hello.oldest_window, hello.next_window, hello.replaying, hello.conversation, fault);
            postcard_bytes(&(0_u8, 5_u8, SCHEMA_5, node, boot, channels, configuration_hash, clock_set, rest))
        }
        NodeMessage::Heartbeat(heartbeat) => {
            let belfry_shared::message::Heartbeat { node, boot, level, sensors, lost_rows, board, .. } = heartbeat;
            let counts = (heartbeat.next_window, heartbeat.oldest_window, heartbeat.lost_windows);
            let counts = (counts, heartbeat.damaged_frames, heartbeat.refused_messages);
            let belfry_shared::message::BoardState { stack_bytes, stack_free_bytes, longest_step_us, .. } = board;
            let times = (longest_step_us, board.latest_sample_ns, board.temperature_centi_c, board.dropped_frames);
            let board = (stack_bytes, stack_free_bytes, times);
            postcard_bytes(&(3_u8, node, boot, counts, level, sensors, lost_rows, board))
        }
        _ => message,
    };
    vec![(5, body)]
}

const ADDED: [u8; 3] = [0xFF, 0, 9];
/// What a hello has at its end once something stands behind it: that the node has no store.
const NO_STORE: u8 = 0;

/// What the node of this release says as one of the next version would that has agreed on this one.
fn from_next_node(_: u8, mut message: Vec<u8>) -> Vec<(u8, Vec<u8>)> {
    let read = message::decode(&message).unwrap();
    match read {
        NodeMessage::Hello(_) => {
            message[2] = NEXT;
            message.push(NO_STORE);
            message.extend(ADDED);
            // A message that came with it.
            vec![(NEXT, message), (PROTOCOL_VERSION, vec![40, 1, 2, 3])]
        }
        NodeMessage::Heartbeat(heartbeat) => {
            assert_eq!(heartbeat.sensors.len(), 1);
            // A state that came with it, in front of the lost rows, the board and its length.
            let counts = (heartbeat.unknown_messages, heartbeat.unsealed_messages, heartbeat.stale_rows);
            let behind =
                postcard_bytes(&(heartbeat.lost_rows, heartbeat.board, counts, heartbeat.variance, heartbeat.mean))
                    .len()
                    + 1;
            let state = message.len() - behind - 1;
            message[state] = 99;
            message.extend(ADDED);
            vec![(PROTOCOL_VERSION, message)]
        }
        _ => {
            message.extend(ADDED);
            vec![(PROTOCOL_VERSION, message)]
        }
    }
}

/// What the host of this release says as one of the next version would.
fn from_next_host(_: u8, mut message: Vec<u8>) -> Vec<(u8, Vec<u8>)> {
    let is_greeting = message[4] == 0;
    if is_greeting {
        message[5..7].copy_from_slice(&[PROTOCOL_VERSION, NEXT]);
    }
    let unknown = [&message[..4], &[50, 7]].concat();
    message.extend(ADDED);
    if is_greeting { vec![(NEXT, message), (PROTOCOL_VERSION, unknown)] } else { vec![(PROTOCOL_VERSION, message)] }
}

fn collected(bench: &mut Bench) -> Vec<NodeWindow> {
    let mut windows = Vec::new();
    bench.run(50 * 150, &mut windows).unwrap();
    assert!(bench.session.is_measuring());
    windows
}

/// Only the window during which the node is told a better time may differ.
fn assert_alike(windows: &[NodeWindow], plain: &[NodeWindow]) {
    assert!(windows.len() >= 8, "{}", windows.len());
    let known: Vec<_> = plain.iter().map(|window| (window.grid_index, &window.channels)).collect();
    let alike = windows.iter().filter(|window| known.contains(&(window.grid_index, &window.channels))).count();
    assert!(alike + 1 >= windows.len(), "{alike} of {}", windows.len());
}

#[test]
fn a_node_of_version_5_is_collected_from() {
    let mut bench = Bench::new(Faults::default());
    (bench.to_node, bench.to_host) = (Translator::new(from_host_5), Translator::new(from_node_5));
    let windows = collected(&mut bench);
    // 150 s less the first seconds, a hop of 12.8 s.
    assert!((9..=11).contains(&windows.len()), "{}", windows.len());
    assert!(windows.iter().zip(&windows[1..]).all(|(a, b)| b.grid_index == a.grid_index + 1));
    let is_sound = |window: &NodeWindow| matches!(&window.channels[..], [crate::window::ChannelData::Lines(_)]);
    assert!(windows.iter().all(is_sound), "{windows:?}");
    let statistics = bench.session.statistics();
    assert_eq!((statistics.damaged_frames, statistics.unknown_messages, statistics.contradictions), (0, 0, 0));
    assert!(bench.session.heartbeat().is_some_and(|heartbeat| heartbeat.sensors.len() == 1));
    // It is flashed with the firmware of this release, and says so when it starts.
    (bench.to_node, bench.to_host) = (None, None);
    (bench.node, bench.node_start) = (node(78), bench.step);
    let windows = collected(&mut bench);
    assert!(windows.iter().any(|window| window.name.boot == 78));
}

#[test]
fn a_node_of_the_next_version_is_collected_from_as_far_as_this_one_goes() {
    let plain = collected(&mut Bench::new(Faults::default()));
    let mut bench = Bench::new(Faults::default());
    bench.to_host = Translator::new(from_next_node);
    assert_alike(&collected(&mut bench), &plain);
    let statistics = bench.session.statistics();
    assert_eq!((statistics.damaged_frames, statistics.contradictions), (0, 0));
    assert!(statistics.unknown_messages >= 1, "{statistics:?}");
    let heartbeat = bench.session.heartbeat().unwrap();
    assert_eq!(heartbeat.sensors.as_slice(), [belfry_shared::message::SensorState::Unknown]);
}

#[test]
fn a_host_of_the_next_version_collects_from_the_node_of_this_one() {
    let plain = collected(&mut Bench::new(Faults::default()));
    let mut bench = Bench::new(Faults::default());
    bench.to_node =
        Translator::new(|version, message| if version == 5 { Vec::new() } else { from_next_host(version, message) });
    assert_alike(&collected(&mut bench), &plain);
    let heartbeat = bench.session.heartbeat().unwrap();
    assert!(heartbeat.damaged_frames == 0 && heartbeat.unknown_messages >= 1, "{heartbeat:?}");
}

fn framed(version: u8, message: &[u8]) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME_BYTES];
    let length = encode_as(version, message, &mut frame).unwrap();
    frame[..length].to_vec()
}

#[test]
fn of_two_that_share_no_version_the_older_is_to_be_updated() {
    let hello = |lowest, highest| {
        let hello = Hello { versions: Versions { lowest, highest }, ..hello() };
        let mut bytes = postcard_bytes(&NodeMessage::Hello(hello));
        bytes.push(NO_STORE);
        bytes.extend(ADDED);
        bytes
    };
    let error = heard(&framed(9, &hello(8, 9))).unwrap_err().to_string();
    assert_eq!(
        error,
        "node 3 speaks versions 8 and 9 of the protocol, this host speaks versions 5 and 6: update Belfry on this computer to the release of the node's firmware"
    );
    // The greeting of a node of version 3, as its golden bytes have it.
    let golden = "00 02 ef 9b af cd f8 ac d1 91 01 03 87 e0 02 04 01 01 01 ab 02 00 01 01 a3 82 80 40 00";
    let golden: Vec<u8> = golden.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    let error = heard(&framed(3, &golden)).unwrap_err().to_string();
    assert_eq!(
        error,
        "node 3 speaks version 3 of the protocol, this host speaks versions 5 and 6: flash the node with the firmware of this release"
    );
    // Of another version, and no greeting: it is said to another host.
    assert!(heard(&framed(9, &[3, 1, 2])).is_ok());
}
