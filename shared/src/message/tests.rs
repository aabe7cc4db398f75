//! Golden bytes and round trips of every message.

use super::*;
use crate::time::{HostTime, NodeTime};
use heapless::{String, Vec};
use proptest::prelude::*;
use std::string::String as StdString;
use std::vec::Vec as StdVec;

fn hex(message: &impl Serialize) -> StdString {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    let bytes = postcard::to_slice(message, &mut buffer).unwrap();
    bytes.iter().map(|byte| std::format!("{byte:02x}")).collect::<StdVec<_>>().join(" ")
}

fn configuration() -> Configuration {
    Configuration {
        channels: 4,
        sampling_rate_uhz: 50_000_000,
        decimation: 10,
        segment: 4096,
        summary: Summary::Lines { bits: 6 },
        bands: Vec::from_slice(&[Band { first_line: 41, lines: 1188 }]).unwrap(),
    }
}

const CONVERSATION: Conversation = Conversation([1, 2, 3, 4]);

const NAME: WindowName = WindowName { node: 3, boot: 0xB007, number: 300 };

/// Changes to these bytes are changes of the wire format: raise [`frame::PROTOCOL_VERSION`] with them.
#[test]
fn golden_node_messages() {
    let hello = Hello {
        protocol_version: 2,
        schema_hash: 0x0123_4567_89AB_CDEF,
        node: 3,
        boot: 0xB007,
        channels: 4,
        configuration_hash: Some(1),
        clock_set: true,
        oldest_window: 299,
        next_window: 301,
        replaying: false,
        conversation: Some(CONVERSATION),
        fault: Some(Fault { kind: FaultKind::HardFault, address: 0x0800_0123, place: String::new() }),
    };
    let golden =
        "00 02 ef 9b af cd f8 ac d1 91 01 03 87 e0 02 04 01 01 01 ab 02 ad 02 00 01 01 02 03 04 01 01 a3 82 80 40 00";
    assert_eq!(hex(&NodeMessage::Hello(hello)), golden);
    let refusal = Refusal { configuration_hash: 1, reason: RefusalReason::Memory { needed: 300, available: 200 } };
    assert_eq!(hex(&NodeMessage::Refused(refusal)), "01 01 06 ac 02 c8 01");
    let reply = ClockReply {
        host_sent: HostTime(-1),
        node_received: NodeTime(2),
        node_sent: NodeTime(300),
        believed_delay_us: Some(5),
    };
    assert_eq!(hex(&NodeMessage::Clock(reply)), "02 01 02 ac 02 01 0a");
    let heartbeat = Heartbeat {
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
        },
    };
    let golden = "03 03 87 e0 02 ad 02 ab 02 00 01 06 01 00 00 00 3f 01 01 02 ac 02 c8 01 04 90 03 01 01 05";
    assert_eq!(hex(&NodeMessage::Heartbeat(heartbeat)), golden);
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
    assert_eq!(hex(&NodeMessage::Head(head)), "04 03 87 e0 02 ac 02 01 05 03 02 07 04 00 01 01 02 04");
    let lines = LinesPart { name: NAME, part: 1, channel: 2, first_line: 41, lines: 2, bits: 4, code: &[192, 0x97, 1] };
    assert_eq!(hex(&NodeMessage::Lines(lines)), "05 03 87 e0 02 ac 02 01 02 29 02 04 03 c0 97 01");
    let density = DensityPart { name: NAME, part: 1, channel: 2, first_line: 41, base: -31, code: &[248, 0] };
    assert_eq!(hex(&NodeMessage::Density(density)), "06 03 87 e0 02 ac 02 01 02 29 3d 02 f8 00");
    let peaks = Vec::from_slice(&[Peak { frequency_hz: 0.5, density: 2.0 }]).unwrap();
    let peaks = PeaksPart { name: NAME, part: 1, channel: 2, peaks };
    assert_eq!(hex(&NodeMessage::Peaks(peaks)), "07 03 87 e0 02 ac 02 01 02 01 00 00 00 3f 00 00 00 40");
    assert_eq!(hex(&NodeMessage::Fed(Fed { next_row: 300 })), "08 ac 02");
}

#[test]
fn golden_host_messages() {
    assert_eq!(hex(&HostMessage::Greet), "00");
    assert_eq!(hex(&HostMessage::Configure(configuration())), "01 04 80 e1 eb 17 0a 80 20 00 06 01 29 a4 09");
    let again = Again { first_window: 1, last_window: 2, first_part: 0, last_part: u16::MAX };
    let acknowledgement = Acknowledgement { boot: 0xB007, below: 300, again: Vec::from_slice(&[again]).unwrap() };
    assert_eq!(hex(&HostMessage::Acknowledge(acknowledgement)), "02 87 e0 02 ac 02 01 01 02 00 ff ff 03");
    assert_eq!(hex(&HostMessage::Clock(ClockRequest { host_sent: HostTime(64) })), "03 80 01");
    let model = ClockModel { node: NodeTime(1), host: HostTime(2), drift_ppb: -3 };
    assert_eq!(hex(&HostMessage::SetClock(model)), "04 01 04 05");
    assert_eq!(hex(&HostMessage::Replay(Replay { start: HostTime(-2) })), "05 03");
    let part = FeedPart { first_row: 300, readings: Vec::from_slice(&[0.5]).unwrap() };
    assert_eq!(hex(&HostMessage::Feed(part)), "06 ac 02 01 00 00 00 3f");
    assert_eq!(hex(&HostMessage::EndReplay), "07");
    let greeting = InConversation { conversation: CONVERSATION, message: HostMessage::Greet };
    assert_eq!(hex(&greeting), "01 02 03 04 00");
}

#[test]
fn the_schema_hash_is_pinned() {
    assert_eq!(
        SCHEMA_HASH, 0x079a_30d7_5a7f_20c2,
        "the messages changed: raise PROTOCOL_VERSION and pin the new hash {SCHEMA_HASH:#018x}"
    );
}

#[test]
fn configurations_that_differ_have_different_hashes() {
    let mut other = configuration();
    other.decimation = 8;
    assert_ne!(configuration().hash(), other.hash());
    assert_eq!(configuration().hash(), configuration().hash());
}

#[test]
fn a_full_data_part_fits_into_a_message() {
    let name = WindowName { node: u16::MAX, boot: u32::MAX, number: u32::MAX };
    let code = &[0; MAX_DATA_BYTES][..];
    let lines = LinesPart { name, part: u16::MAX, channel: 3, first_line: u16::MAX, lines: u16::MAX, bits: 16, code };
    let density = DensityPart { name, part: u16::MAX, channel: 3, first_line: u16::MAX, base: i16::MIN, code };
    for message in [NodeMessage::Lines(lines), NodeMessage::Density(density)] {
        assert!(encode(&message, &mut [0; MAX_FRAME_BYTES]).is_ok());
    }
    let part = FeedPart { first_row: u64::MAX, readings: Vec::from_slice(&[1.0; MAX_FEED]).unwrap() };
    let fed = InConversation { conversation: CONVERSATION, message: HostMessage::Feed(part) };
    assert!(encode(&fed, &mut [0; MAX_FRAME_BYTES]).is_ok());
}

#[test]
fn bytes_left_over_make_a_message_unreadable() {
    assert_eq!(decode::<HostMessage>(&[0]), Ok(HostMessage::Greet));
    assert_eq!(decode::<HostMessage>(&[0, 0]), Err(FrameError::Message));
}

fn heapless<T: core::fmt::Debug + Clone, const N: usize>(
    element: impl Strategy<Value = T>,
) -> impl Strategy<Value = Vec<T, N>> {
    prop::collection::vec(element, 0..=N).prop_map(|values| Vec::from_slice(&values).unwrap())
}

fn name() -> impl Strategy<Value = WindowName> {
    any::<(u16, u32, u32)>().prop_map(|(node, boot, number)| WindowName { node, boot, number })
}

fn finite() -> impl Strategy<Value = f32> {
    prop::num::f32::NORMAL | prop::num::f32::ZERO
}

fn channel_state() -> impl Strategy<Value = ChannelState> {
    prop_oneof![
        any::<u16>().prop_map(|segments| ChannelState::Sound { segments }),
        Just(ChannelState::Missing),
        Just(ChannelState::Clipped),
        Just(ChannelState::Constant),
        Just(ChannelState::Overrun),
    ]
}

fn sensor_state() -> impl Strategy<Value = SensorState> {
    use SensorState::{Absent, Clipped, Failing, Noisy, Sound, Stuck};
    prop::sample::select(std::vec![Absent, Stuck, Failing, Clipped, Noisy, Sound])
}

fn board() -> impl Strategy<Value = BoardState> {
    any::<(u32, u32, u32, u32, Option<i16>, u32)>().prop_map(
        |(stack_bytes, stack_free_bytes, longest_step_us, latest_sample_ns, temperature_centi_c, dropped_frames)| {
            BoardState {
                stack_bytes,
                stack_free_bytes,
                longest_step_us,
                latest_sample_ns,
                temperature_centi_c,
                dropped_frames,
            }
        },
    )
}

fn fault() -> impl Strategy<Value = Fault> {
    use FaultKind::{Clock, HardFault, Panic, StackOverflow, Watchdog};
    let kind = prop::sample::select(std::vec![Panic, HardFault, StackOverflow, Watchdog, Clock]);
    (kind, any::<u32>(), "[ -~]{0,64}").prop_map(|(kind, address, place)| Fault {
        kind,
        address,
        place: String::try_from(place.as_str()).unwrap(),
    })
}

fn refusal_reason() -> impl Strategy<Value = RefusalReason> {
    prop_oneof![
        any::<u8>().prop_map(|available| RefusalReason::Channels { available }),
        any::<u32>().prop_map(|highest_mhz| RefusalReason::SamplingRate { highest_mhz }),
        Just(RefusalReason::Decimation),
        Just(RefusalReason::Segment),
        Just(RefusalReason::Bands),
        Just(RefusalReason::Summary),
        any::<(u32, u32)>().prop_map(|(needed, available)| RefusalReason::Memory { needed, available }),
    ]
}

fn node_message(code: &[u8]) -> impl Strategy<Value = NodeMessage<'_>> {
    let code = &code[..code.len().min(MAX_DATA_BYTES)];
    prop_oneof![
        (
            any::<(u8, u64, u16, u32, u8, Option<u32>, bool, u32, bool)>(),
            prop::option::of(fault()),
            any::<Option<[u8; 4]>>()
        )
            .prop_map(
                |(
                    (
                        protocol_version,
                        schema_hash,
                        node,
                        boot,
                        channels,
                        configuration_hash,
                        clock_set,
                        oldest_window,
                        replaying,
                    ),
                    fault,
                    conversation,
                )| {
                    NodeMessage::Hello(Hello {
                        protocol_version,
                        schema_hash,
                        node,
                        boot,
                        channels,
                        configuration_hash,
                        clock_set,
                        oldest_window,
                        next_window: oldest_window.wrapping_add(u32::from(node)),
                        replaying,
                        conversation: conversation.map(Conversation),
                        fault,
                    })
                }
            ),
        (any::<u32>(), refusal_reason())
            .prop_map(|(configuration_hash, reason)| NodeMessage::Refused(Refusal { configuration_hash, reason })),
        any::<(i64, u64, u64, Option<i64>)>().prop_map(|(sent, received, replied, believed_delay_us)| {
            NodeMessage::Clock(ClockReply {
                host_sent: HostTime(sent),
                node_received: NodeTime(received),
                node_sent: NodeTime(replied),
                believed_delay_us,
            })
        }),
        (any::<(u16, u32, u32, u32, u32, u32, u32, u32)>(), heapless(finite()), heapless(sensor_state()), board())
            .prop_map(
                |(
                    (node, boot, next_window, oldest_window, lost_windows, damaged_frames, refused_messages, lost_rows),
                    level,
                    sensors,
                    board,
                )| {
                    NodeMessage::Heartbeat(Heartbeat {
                        node,
                        boot,
                        next_window,
                        oldest_window,
                        lost_windows,
                        damaged_frames,
                        refused_messages,
                        level,
                        sensors,
                        lost_rows,
                        board,
                    })
                }
            ),
        (name(), any::<(u32, u64, i32, i32, u16)>(), heapless(channel_state())).prop_map(
            |(name, (configuration_hash, grid_index, middle_offset_us, drift_ppb, data_parts), channels)| {
                NodeMessage::Head(WindowHead {
                    name,
                    configuration_hash,
                    grid_index,
                    middle_offset_us,
                    drift_ppb,
                    data_parts,
                    channels,
                })
            }
        ),
        (name(), any::<(u16, u8, u16, u16, u8)>()).prop_map(move |(name, (part, channel, first_line, lines, bits))| {
            NodeMessage::Lines(LinesPart { name, part, channel, first_line, lines, bits, code })
        }),
        (name(), any::<(u16, u8, u16, i16)>()).prop_map(move |(name, (part, channel, first_line, base))| {
            NodeMessage::Density(DensityPart { name, part, channel, first_line, base, code })
        }),
        (name(), any::<(u16, u8)>(), heapless((finite(), finite()))).prop_map(|(name, (part, channel), peaks)| {
            let peaks: Vec<(f32, f32), MAX_PEAKS> = peaks;
            let peaks = peaks.iter().map(|&(frequency_hz, density)| Peak { frequency_hz, density }).collect();
            NodeMessage::Peaks(PeaksPart { name, part, channel, peaks })
        }),
        any::<u64>().prop_map(|next_row| NodeMessage::Fed(Fed { next_row })),
    ]
}

fn host_message() -> impl Strategy<Value = HostMessage> {
    let summary = prop_oneof![
        any::<u8>().prop_map(|bits| Summary::Lines { bits }),
        any::<u16>().prop_map(|segments| Summary::Psd { segments }),
    ];
    let band = any::<(u16, u16)>().prop_map(|(first_line, lines)| Band { first_line, lines });
    let again = any::<(u32, u32, u16, u16)>().prop_map(|(first_window, last_window, first_part, last_part)| Again {
        first_window,
        last_window,
        first_part,
        last_part,
    });
    prop_oneof![
        Just(HostMessage::Greet),
        any::<i64>().prop_map(|start| HostMessage::Replay(Replay { start: HostTime(start) })),
        (any::<u64>(), heapless(finite()))
            .prop_map(|(first_row, readings)| HostMessage::Feed(FeedPart { first_row, readings })),
        Just(HostMessage::EndReplay),
        (any::<(u8, u64, u32, u16)>(), summary, heapless(band)).prop_map(
            |((channels, sampling_rate_uhz, decimation, segment), summary, bands)| {
                HostMessage::Configure(Configuration {
                    channels,
                    sampling_rate_uhz,
                    decimation,
                    segment,
                    summary,
                    bands,
                })
            }
        ),
        (any::<(u32, u32)>(), heapless(again))
            .prop_map(|((boot, below), again)| HostMessage::Acknowledge(Acknowledgement { boot, below, again })),
        any::<i64>().prop_map(|sent| HostMessage::Clock(ClockRequest { host_sent: HostTime(sent) })),
        any::<(u64, i64, i32)>().prop_map(|(node, host, drift_ppb)| HostMessage::SetClock(ClockModel {
            node: NodeTime(node),
            host: HostTime(host),
            drift_ppb
        })),
    ]
}

/// What comes out of a frame decoder when `frame` goes in.
fn opened(frame: &[u8]) -> StdVec<u8> {
    let mut decoder = frame::FrameDecoder::new();
    for &byte in frame {
        if let Some(message) = decoder.push(byte) {
            return message.unwrap().to_vec();
        }
    }
    panic!("no frame in the bytes");
}

static CODE: [u8; 64] = [0x5A; 64];

proptest! {
    #[test]
    fn node_messages_come_back_from_their_frames(message in node_message(&CODE)) {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = encode(&message, &mut frame).unwrap();
        let bytes = opened(&frame[..length]);
        prop_assert_eq!(decode::<NodeMessage<'_>>(&bytes), Ok(message));
    }

    #[test]
    fn host_messages_come_back_from_their_frames(message in host_message(), conversation in any::<[u8; 4]>()) {
        let message = InConversation { conversation: Conversation(conversation), message };
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = encode(&message, &mut frame).unwrap();
        let bytes = opened(&frame[..length]);
        prop_assert_eq!(decode::<InConversation>(&bytes), Ok(message));
    }

    #[test]
    fn any_bytes_decode_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = decode::<NodeMessage<'_>>(&bytes);
        let _ = decode::<InConversation>(&bytes);
        let mut decoder = frame::FrameDecoder::new();
        for &byte in &bytes {
            let _ = decoder.push(byte);
        }
    }
}
