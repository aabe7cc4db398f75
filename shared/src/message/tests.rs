//! How messages grow, and round trips of every message.

use super::goldens::{CONVERSATION, calibration, configuration, encoded, heartbeat, hello_with_calibration};
use super::*;
use crate::time::{HostTime, NodeTime};
use heapless::{String, Vec};
use proptest::prelude::*;
use std::vec::Vec as StdVec;

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

/// As a later version would say it.
fn grown(message: &impl Serialize) -> StdVec<u8> {
    let mut bytes = encoded(message);
    bytes.extend([0xFF, 7, 0, 9]);
    bytes
}

#[test]
fn fields_that_a_later_version_adds_are_left_unread() {
    for message in [
        NodeMessage::Hello(hello_with_calibration()),
        NodeMessage::Heartbeat(heartbeat()),
        NodeMessage::Fed(Fed { next_row: 9 }),
    ] {
        assert_eq!(decode(&grown(&message)), Ok(message));
    }
    for message in
        [HostMessage::Greet(Greeting::OF_HOSTS), HostMessage::Configure(configuration()), HostMessage::EndReplay]
    {
        let message = InConversation { conversation: CONVERSATION, message };
        assert_eq!(decode(&grown(&message)), Ok(message));
    }
    // Within another struct too: five more bytes of the board, and its length in front says so.
    let mut bytes = encoded(&NodeMessage::Heartbeat(heartbeat()));
    let board = bytes.iter().position(|&byte| byte == 0x0C).unwrap();
    bytes[board] += 5;
    let end = bytes.len() - 5;
    bytes.splice(end..end, [1, 2, 3, 4, 5]);
    assert_eq!(decode(&bytes), Ok(NodeMessage::Heartbeat(heartbeat())));
}

#[test]
fn a_message_without_a_field_that_was_there_from_the_start_cannot_be_read() {
    let whole = encoded(&NodeMessage::Heartbeat(heartbeat()));
    // The last three, of a byte each here, came later.
    for length in 0..whole.len() - 3 {
        assert_eq!(decode::<NodeMessage<'_>>(&whole[..length]), Err(FrameError::Message), "{length}");
    }
}

/// What this version would read had it begun with fewer fields.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Shorter {
    node: u16,
    level: Vec<f32, 2>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Longer<'a> {
    node: u16,
    level: Vec<f32, 2>,
    #[serde(default = "seven")]
    added: u32,
    #[serde(default)]
    also: &'a [u8],
}

fn seven() -> u32 {
    7
}

#[test]
fn fields_that_an_older_version_does_not_have_take_their_defaults() {
    let level = Vec::from_slice(&[1.0]).unwrap();
    let shorter = Shorter { node: 300, level: level.clone() };
    let longer = Longer { node: 300, level: level.clone(), added: 7, also: &[] };
    assert_eq!(growth::read(&encoded(&shorter)), Ok(longer));
    let longer = Longer { node: 300, level, added: 1, also: &[2, 3] };
    let bytes = encoded(&longer);
    assert_eq!(growth::read(&bytes), Ok(longer));
    assert_eq!(growth::read(&bytes), Ok(shorter));
    assert_eq!(
        growth::read::<Longer<'_>>(&bytes[..bytes.len() - 1]),
        Err(FrameError::Message),
        "a field cut in the middle"
    );
}

#[test]
fn messages_and_values_that_a_later_version_adds_are_named_as_unknown() {
    assert_eq!(decode::<NodeMessage<'_>>(&[9, 1, 2]), Err(FrameError::Unknown { kind: 9 }));
    assert_eq!(decode::<InConversation>(&[1, 2, 3, 4, 0xC8, 1]), Err(FrameError::Unknown { kind: 200 }));
    let mut bytes = encoded(&NodeMessage::Heartbeat(heartbeat()));
    let stuck = bytes.windows(2).position(|pair| pair == [1, 1]).unwrap() + 1;
    bytes[stuck] = 0x63;
    let Ok(NodeMessage::Heartbeat(read)) = decode(&bytes) else { panic!("a heartbeat") };
    assert_eq!(read, Heartbeat { sensors: Vec::from_slice(&[SensorState::Unknown]).unwrap(), ..heartbeat() });
    // Behind a reason may stand anything.
    let refusal = Refusal { configuration_hash: 1, reason: RefusalReason::Unknown };
    assert_eq!(decode(&[1, 1, 0x63, 8, 8]), Ok(NodeMessage::Refused(refusal)));
}

#[test]
fn both_ends_go_on_in_the_highest_version_that_both_speak() {
    let versions = |lowest, highest| Versions { lowest, highest };
    assert_eq!(versions(5, 6).common(versions(6, 7)), Some(6));
    assert_eq!(versions(5, 6).common(versions(5, 9)), Some(6));
    assert_eq!(versions(6, 6).common(versions(7, 8)), None);
    assert_eq!(versions(6, 6).common(versions(3, 3)), None);
    assert_eq!(versions(7, 6).common(versions(5, 9)), None, "no version is as high as 7 and as low as 6");
}

#[test]
fn a_node_hears_greetings_of_any_version_from_6_on_and_nothing_else_of_others() {
    let hear = |version, message: &HostMessage| {
        let message = grown(&InConversation { conversation: CONVERSATION, message: message.clone() });
        super::hear(&Opened { version, message: &message, seal: None }).unwrap()
    };
    let greeting = HostMessage::Greet(Greeting { versions: Versions { lowest: 6, highest: 9 }, counter: 0 });
    for version in [6, 7, 127] {
        let heard = InConversation { conversation: CONVERSATION, message: greeting.clone() };
        assert_eq!(hear(version, &greeting), Heard::Message(heard));
    }
    for (version, message) in [(7, &HostMessage::EndReplay), (5, &greeting), (0, &greeting)] {
        assert_eq!(hear(version, message), Heard::OtherVersion);
    }
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
                oscillator_ppm: temperature_centi_c.map(i32::from),
                longest_fetch_us: longest_step_us / 2,
            }
        },
    )
}

fn fault() -> impl Strategy<Value = Fault> {
    use FaultKind::{Clock, HardFault, Key, Panic, StackOverflow, Watchdog};
    let kind = prop::sample::select(std::vec![Panic, HardFault, StackOverflow, Watchdog, Clock, Key]);
    (kind, any::<u32>(), "[ -~]{0,64}").prop_map(|(kind, address, place)| Fault {
        kind,
        address,
        place: String::try_from(place.as_str()).unwrap(),
        link: address / 2,
        status: address / 3,
        further: (0..address % 7).map(|_| kind).collect(),
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
            any::<(u8, u8, u16, u32, u8, Option<u32>, bool, u32, bool)>(),
            prop::option::of(fault()),
            any::<[Option<[u8; 4]>; 2]>()
        )
            .prop_map(
                |(
                    (lowest, highest, node, boot, channels, configuration_hash, clock_set, oldest_window, replaying),
                    fault,
                    conversations,
                )| {
                    let [answers, conversation] = conversations.map(|number| number.map(Conversation));
                    NodeMessage::Hello(Hello {
                        versions: Versions { lowest, highest },
                        node,
                        boot,
                        answers,
                        conversation,
                        channels,
                        configuration_hash,
                        clock_set,
                        oldest_window,
                        next_window: oldest_window.wrapping_add(u32::from(node)),
                        replaying,
                        fault,
                        counters: replaying.then_some(Counters { said: boot, heard: oldest_window }),
                        kept: clock_set.then_some(Kept {
                            last_time: replaying.then_some(HostTime(i64::from(boot) << channels.min(30))),
                            boot: boot.wrapping_sub(1),
                            oldest_window,
                            next_window: oldest_window.wrapping_add(u32::from(channels)),
                        }),
                        calibration: replaying.then(calibration),
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
                        unknown_messages: lost_windows / 2,
                        unsealed_messages: lost_windows / 3,
                        stale_rows: lost_rows / 2,
                        variance: Vec::from_slice(&[0.5; 3]).unwrap(),
                        mean: Heartbeat::means_of(&[9.8; 3]),
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

fn of_calibrations() -> impl Strategy<Value = HostMessage> {
    prop_oneof![
        any::<(u8, u8)>().prop_map(|(lowest, highest)| HostMessage::Ask(Versions { lowest, highest })),
        any::<(u32, u16)>().prop_map(|(period_ms, heartbeats)| HostMessage::Pace(Pace { period_ms, heartbeats })),
        (any::<i64>(), heapless(any::<(i32, u32, i32)>())).prop_map(|(time, axes): (i64, Vec<_, MAX_CHANNELS>)| {
            let axis = |&(gain_ppm, gain_std_ppm, offset_um_s2): &(i32, u32, i32)| AxisCalibration {
                gain_ppm,
                gain_std_ppm,
                offset_um_s2,
            };
            HostMessage::Calibrate(Calibration { time: HostTime(time), axes: axes.iter().map(axis).collect() })
        }),
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
        any::<(u8, u8, u32)>().prop_map(|(lowest, highest, counter)| HostMessage::Greet(Greeting {
            versions: Versions { lowest, highest },
            counter
        })),
        of_calibrations(),
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
            return message.unwrap().message.to_vec();
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
        let _ = version_5::decode_node(&bytes);
        let _ = hear(&Opened { version: 7, message: &bytes, seal: None });
        let mut decoder = frame::FrameDecoder::new();
        for &byte in &bytes {
            let _ = decoder.push(byte);
        }
    }
}
