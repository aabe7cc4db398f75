//! Golden bytes: what stood on the line in versions 3 and 5, and what stands there now.
//!
//! Changes to the bytes of version 6 are changes of the wire format. Further fields at a message's end, further messages and further values of enums
//! are growth: a golden of them goes beside those that are here, which must still be read. Anything else needs another version.

use super::*;
use crate::time::{HostTime, NodeTime};
use heapless::Vec;
use std::string::String as StdString;
use std::vec::Vec as StdVec;

pub(super) const CONVERSATION: Conversation = Conversation([1, 2, 3, 4]);
const NAME: WindowName = WindowName { node: 3, boot: 0xB007, number: 300 };
const VERSIONS: Versions = Versions { lowest: 5, highest: 6 };

fn hex(bytes: &[u8]) -> StdString {
    bytes.iter().map(|byte| std::format!("{byte:02x}")).collect::<StdVec<_>>().join(" ")
}

fn bytes(hex: &str) -> StdVec<u8> {
    hex.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

pub(super) fn encoded(message: &impl Serialize) -> StdVec<u8> {
    postcard::to_slice(message, &mut [0; MAX_MESSAGE_BYTES]).unwrap().to_vec()
}

/// The message in a frame, and its version.
fn opened(frame: &[u8]) -> (u8, StdVec<u8>) {
    let mut decoder = frame::FrameDecoder::new();
    let opened = frame.iter().find_map(|&byte| {
        decoder.push(byte).map(|opened| opened.map(|opened| (opened.version, opened.message.to_vec())).unwrap())
    });
    opened.expect("a frame")
}

pub(super) fn configuration() -> Configuration {
    Configuration {
        channels: 4,
        sampling_rate_uhz: 50_000_000,
        decimation: 10,
        segment: 4096,
        summary: Summary::Lines { bits: 6 },
        bands: Vec::from_slice(&[Band { first_line: 41, lines: 1188 }]).unwrap(),
    }
}

pub(super) fn hello() -> Hello {
    Hello {
        versions: Versions { lowest: 6, highest: 6 },
        node: 3,
        boot: 0xB007,
        answers: Some(CONVERSATION),
        conversation: Some(CONVERSATION),
        channels: 4,
        configuration_hash: Some(1),
        clock_set: true,
        oldest_window: 299,
        next_window: 301,
        replaying: false,
        fault: Some(Fault { address: 0x0800_0123, ..Fault::from(FaultKind::HardFault) }),
        counters: Some(Counters { said: 300, heard: 2 }),
        kept: None,
        calibration: None,
    }
}

/// Of a node that has windows 7 and 8 of the boot before.
pub(super) fn hello_with_store() -> Hello {
    let kept = Kept { last_time: Some(HostTime(1)), boot: 0xB006, oldest_window: 7, next_window: 9 };
    Hello { kept: Some(kept), ..hello() }
}

pub(super) fn heartbeat() -> Heartbeat {
    Heartbeat {
        node: 3,
        boot: 0xB007,
        next_window: 301,
        oldest_window: 299,
        lost_windows: 0,
        damaged_frames: 1,
        refused_messages: 6,
        level: Vec::from_slice(&[0.5]).unwrap(),
        sensors: Vec::from_slice(&[SensorState::Stuck]).unwrap(),
        lost_rows: 2,
        board: BoardState {
            stack_bytes: 300,
            stack_free_bytes: 200,
            longest_step_us: 4,
            latest_sample_ns: 400,
            temperature_centi_c: Some(-1),
            dropped_frames: 5,
            oscillator_ppm: None,
            longest_fetch_us: 0,
        },
        unknown_messages: 7,
        unsealed_messages: 8,
        stale_rows: 0,
        variance: Vec::new(),
        mean: Vec::new(),
    }
}

/// The same of nodes that say what their sensor does beside.
fn grown_heartbeat() -> Heartbeat {
    let board = BoardState { oscillator_ppm: Some(-5000), longest_fetch_us: 25, ..heartbeat().board };
    Heartbeat {
        board,
        stale_rows: 300,
        variance: Vec::from_slice(&[0.5]).unwrap(),
        mean: Heartbeat::means_of(&[2.0]),
        ..heartbeat()
    }
}

/// The same of nodes that say where a hard fault was to return to, why, and what else is wrong.
fn grown_hello() -> Hello {
    let further = Vec::from_slice(&[FaultKind::Clock]).unwrap();
    let fault = hello().fault.map(|fault| Fault { link: 0x0800_0201, status: 0x8200, further, ..fault });
    Hello { fault, ..hello() }
}

/// Of a node that was calibrated.
pub(super) fn hello_with_calibration() -> Hello {
    Hello { calibration: Some(calibration()), ..grown_hello() }
}

pub(super) fn calibration() -> Calibration {
    let axis = AxisCalibration { gain_ppm: -300, gain_std_ppm: 200, offset_um_s2: 1 };
    Calibration { time: HostTime(64), axes: Vec::from_slice(&[axis]).unwrap() }
}

const HELLO_3: &str = "00 02 ef 9b af cd f8 ac d1 91 01 03 87 e0 02 04 01 01 01 ab 02 00 01 01 a3 82 80 40 00";
const HELLO_5: &str =
    "00 05 c2 c1 fc d3 f5 9a 8c cd 07 03 87 e0 02 04 01 01 01 ab 02 ad 02 00 01 01 02 03 04 01 01 a3 82 80 40 00";
const HELLO_6: &str =
    "00 06 06 03 87 e0 02 01 01 02 03 04 01 01 02 03 04 04 01 01 01 ab 02 ad 02 00 06 01 a3 82 80 40 00 01 ac 02 02";
const HEARTBEAT_3: &str = "03 03 87 e0 02 ad 02 ab 02 00 01 01 00 00 00 3f 01 01 02 ac 02 c8 01 04 90 03 01 01";
const HEARTBEAT_5: &str = "03 03 87 e0 02 ad 02 ab 02 00 01 06 01 00 00 00 3f 01 01 02 ac 02 c8 01 04 90 03 01 01 05";
const HEARTBEAT_6: &str =
    "03 03 87 e0 02 ad 02 ab 02 00 01 06 01 00 00 00 3f 01 01 02 0a ac 02 c8 01 04 90 03 01 01 05 07 08";

const HELLO_6_GROWN: &str = "00 06 06 03 87 e0 02 01 01 02 03 04 01 01 02 03 04 04 01 01 01 ab 02 ad 02 00 0f 01 a3 82 80 40 00 81 84 80 40 80 84 02 01 04 01 ac 02 02 00";
const HEARTBEAT_6_GROWN: &str = "03 03 87 e0 02 ad 02 ab 02 00 01 06 01 00 00 00 3f 01 01 02 0e ac 02 c8 01 04 90 03 01 01 05 01 8f 4e 19 07 08 ac 02 01 00 00 00 3f 01 c0 b8 02";

/// What a node says in the same bytes since version 3.
fn unchanged_of_nodes() -> StdVec<(NodeMessage<'static>, &'static str)> {
    let refusal = Refusal { configuration_hash: 1, reason: RefusalReason::Memory { needed: 300, available: 200 } };
    let reply = ClockReply {
        host_sent: HostTime(-1),
        node_received: NodeTime(2),
        node_sent: NodeTime(300),
        believed_delay_us: Some(5),
    };
    let head = WindowHead {
        name: NAME,
        configuration_hash: 1,
        grid_index: 5,
        middle_offset_us: -2,
        drift_ppb: 1,
        data_parts: 7,
        channels: Vec::from_slice(&[
            ChannelState::Sound { segments: 1 },
            ChannelState::Missing,
            ChannelState::Clipped,
            ChannelState::Overrun,
        ])
        .unwrap(),
    };
    let lines = LinesPart { name: NAME, part: 1, channel: 2, first_line: 41, lines: 2, bits: 4, code: &[192, 0x97, 1] };
    let density = DensityPart { name: NAME, part: 1, channel: 2, first_line: 41, base: -31, code: &[248, 0] };
    let peaks = Vec::from_slice(&[Peak { frequency_hz: 0.5, density: 2.0 }]).unwrap();
    let peaks = PeaksPart { name: NAME, part: 1, channel: 2, peaks };
    std::vec![
        (NodeMessage::Refused(refusal), "01 01 06 ac 02 c8 01"),
        (NodeMessage::Clock(reply), "02 01 02 ac 02 01 0a"),
        (NodeMessage::Head(head), "04 03 87 e0 02 ac 02 01 05 03 02 07 04 00 01 01 02 04"),
        (NodeMessage::Lines(lines), "05 03 87 e0 02 ac 02 01 02 29 02 04 03 c0 97 01"),
        (NodeMessage::Density(density), "06 03 87 e0 02 ac 02 01 02 29 3d 02 f8 00"),
        (NodeMessage::Peaks(peaks), "07 03 87 e0 02 ac 02 01 02 01 00 00 00 3f 00 00 00 40"),
        (NodeMessage::Fed(Fed { next_row: 300 }), "08 ac 02"),
    ]
}

/// What a host says in the same bytes since version 3; since version 5 with the number of its conversation in front.
fn unchanged_of_hosts() -> StdVec<(HostMessage, &'static str)> {
    let again = Again { first_window: 1, last_window: 2, first_part: 0, last_part: u16::MAX };
    let acknowledgement = Acknowledgement { boot: 0xB007, below: 300, again: Vec::from_slice(&[again]).unwrap() };
    let model = ClockModel { node: NodeTime(1), host: HostTime(2), drift_ppb: -3 };
    let part = FeedPart { first_row: 300, readings: Vec::from_slice(&[0.5]).unwrap() };
    std::vec![
        (HostMessage::Configure(configuration()), "01 04 80 e1 eb 17 0a 80 20 00 06 01 29 a4 09"),
        (HostMessage::Acknowledge(acknowledgement), "02 87 e0 02 ac 02 01 01 02 00 ff ff 03"),
        (HostMessage::Clock(ClockRequest { host_sent: HostTime(64) }), "03 80 01"),
        (HostMessage::SetClock(model), "04 01 04 05"),
        (HostMessage::Replay(Replay { start: HostTime(-2) }), "05 03"),
        (HostMessage::Feed(part), "06 ac 02 01 00 00 00 3f"),
        (HostMessage::EndReplay, "07"),
    ]
}

fn said(message: HostMessage) -> InConversation {
    InConversation { conversation: CONVERSATION, message }
}

#[test]
fn golden_messages_of_version_6() {
    let mut of_nodes = unchanged_of_nodes();
    of_nodes.push((NodeMessage::Hello(grown_hello()), HELLO_6_GROWN));
    let calibrated = std::format!("{HELLO_6_GROWN} 08 80 01 01 d7 04 c8 01 02");
    of_nodes.push((NodeMessage::Hello(hello_with_calibration()), &calibrated));
    of_nodes.push((NodeMessage::Heartbeat(grown_heartbeat()), HEARTBEAT_6_GROWN));
    // What version 6 began with, and nodes of that release still say.
    let with_store = std::format!("{HELLO_6} 07 01 02 86 e0 02 07 09");
    for (message, golden) in [
        (NodeMessage::Hello(hello()), HELLO_6),
        (NodeMessage::Hello(grown_hello()), HELLO_6_GROWN.strip_suffix(" 00").unwrap()),
        (NodeMessage::Hello(hello_with_store()), &with_store),
        (NodeMessage::Heartbeat(heartbeat()), HEARTBEAT_6),
    ] {
        assert_eq!(decode(&bytes(golden)), Ok(message));
    }
    for (message, golden) in of_nodes {
        assert_eq!(hex(&encoded(&message)), golden);
        assert_eq!(decode(&bytes(golden)), Ok(message));
    }
    let mut of_hosts = unchanged_of_hosts();
    of_hosts.push((HostMessage::Greet(Greeting { versions: VERSIONS, counter: 300 }), "00 05 06 ac 02"));
    of_hosts.push((HostMessage::Ask(VERSIONS), "08 05 06"));
    of_hosts.push((HostMessage::Pace(Pace { period_ms: 1000, heartbeats: 300 }), "09 e8 07 ac 02"));
    of_hosts.push((HostMessage::Calibrate(calibration()), "0a 80 01 01 d7 04 c8 01 02"));
    for (message, golden) in of_hosts {
        let (golden, message) = (std::format!("01 02 03 04 {golden}"), said(message));
        assert_eq!(hex(&encoded(&message)), golden);
        assert_eq!(decode(&bytes(&golden)), Ok(message));
    }
}

#[test]
fn golden_messages_of_version_5_are_read_and_written() {
    let version_5 = Versions { lowest: 5, highest: 5 };
    let mut of_nodes = unchanged_of_nodes();
    of_nodes.push((NodeMessage::Hello(Hello { versions: version_5, counters: None, ..hello() }), HELLO_5));
    of_nodes.push((
        NodeMessage::Heartbeat(Heartbeat { unknown_messages: 0, unsealed_messages: 0, ..heartbeat() }),
        HEARTBEAT_5,
    ));
    for (message, golden) in of_nodes {
        assert_eq!(version_5::decode_node(&bytes(golden)), Ok(message));
    }
    let mut of_hosts = unchanged_of_hosts();
    // A question is a greeting there.
    of_hosts.push((HostMessage::Greet(Greeting { versions: VERSIONS, counter: 0 }), "00"));
    of_hosts.push((HostMessage::Ask(VERSIONS), "00"));
    for (message, golden) in of_hosts {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = version_5::encode_host(&said(message), &mut frame).unwrap();
        assert_eq!(opened(&frame[..length]), (5, bytes(&std::format!("01 02 03 04 {golden}"))));
    }
}

#[test]
fn a_build_of_version_5_with_other_messages_speaks_no_version_that_a_host_does() {
    let other = HELLO_5.replace("cd 07", "cd 06");
    let Ok(NodeMessage::Hello(hello)) = version_5::decode_node(&bytes(&other)) else { panic!("a greeting") };
    assert_eq!((hello.node, hello.versions.common(Versions::OF_HOSTS)), (3, None));
}

/// Nobody speaks version 3 any more; a frame still says that it is one, and its data have the bytes that they have now.
#[test]
fn golden_messages_of_version_3() {
    let mut frame = [0; MAX_FRAME_BYTES];
    let of_nodes = unchanged_of_nodes().into_iter().map(|(_, golden)| golden).chain([HELLO_3, HEARTBEAT_3]);
    // A greeting is its number alone.
    let of_hosts = unchanged_of_hosts().into_iter().map(|(_, golden)| golden).chain(["00"]);
    for golden in of_nodes.chain(of_hosts) {
        let length = frame::encode_as(3, &bytes(golden), &mut frame).unwrap();
        let (version, message) = opened(&frame[..length]);
        assert_eq!((version, hex(&message).as_str()), (3, golden));
        assert_eq!(hear(&Opened { version, message: &message, seal: None }), Ok(Heard::OtherVersion));
    }
}
