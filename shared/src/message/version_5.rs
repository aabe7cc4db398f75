//! Version 5, which nodes of the release before this one speak: what a host needs to talk to them.
//!
//! Its messages have the kinds of version 6, and most have the fields that version 6 began with. Those that differ are frozen here, with golden
//! bytes. A reader of version 5 takes no byte more and none less, so nothing that version 6 has added may be said to it.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use super::configuration::MAX_CHANNELS;
use super::{
    BoardState, Conversation, FaultKind, HostMessage, InConversation, MAX_PLACE_BYTES, NodeMessage, SensorState,
    Versions, decode, split_kind,
};
use crate::frame::{self, FrameError, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES};

/// The version.
pub const VERSION: u8 = 5;
/// A hash over the layout of its messages, which nodes of version 5 say: builds from before its release have others.
const SCHEMA_HASH: u64 = 0x079a_30d7_5a7f_20c2;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Hello {
    protocol_version: u8,
    schema_hash: u64,
    node: u16,
    boot: u32,
    channels: u8,
    configuration_hash: Option<u32>,
    clock_set: bool,
    oldest_window: u32,
    next_window: u32,
    replaying: bool,
    conversation: Option<Conversation>,
    fault: Option<Fault>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Fault {
    kind: FaultKind,
    address: u32,
    place: String<MAX_PLACE_BYTES>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Heartbeat {
    node: u16,
    boot: u32,
    next_window: u32,
    oldest_window: u32,
    lost_windows: u32,
    damaged_frames: u32,
    refused_messages: u32,
    level: Vec<f32, MAX_CHANNELS>,
    sensors: Vec<SensorState, MAX_CHANNELS>,
    lost_rows: u32,
    board: Board,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Board {
    stack_bytes: u32,
    stack_free_bytes: u32,
    longest_step_us: u32,
    latest_sample_ns: u32,
    temperature_centi_c: Option<i16>,
    dropped_frames: u32,
}

impl From<Hello> for super::Hello {
    fn from(old: Hello) -> Self {
        // A node of another layout than the released one speaks no version that anybody knows.
        let version = if old.schema_hash == SCHEMA_HASH { old.protocol_version } else { 0 };
        Self {
            versions: Versions { lowest: version, highest: version },
            node: old.node,
            boot: old.boot,
            // It only knows greetings, which also make it listen.
            answers: old.conversation,
            conversation: old.conversation,
            channels: old.channels,
            configuration_hash: old.configuration_hash,
            clock_set: old.clock_set,
            oldest_window: old.oldest_window,
            next_window: old.next_window,
            replaying: old.replaying,
            fault: old.fault.map(|Fault { kind, address, place }| super::Fault {
                address,
                place,
                ..super::Fault::from(kind)
            }),
            counters: None,
            kept: None,
            calibration: None,
        }
    }
}

impl From<Heartbeat> for super::Heartbeat {
    fn from(old: Heartbeat) -> Self {
        let Board {
            stack_bytes,
            stack_free_bytes,
            longest_step_us,
            latest_sample_ns,
            temperature_centi_c,
            dropped_frames,
        } = old.board;
        Self {
            node: old.node,
            boot: old.boot,
            next_window: old.next_window,
            oldest_window: old.oldest_window,
            lost_windows: old.lost_windows,
            damaged_frames: old.damaged_frames,
            refused_messages: old.refused_messages,
            level: old.level,
            sensors: old.sensors,
            lost_rows: old.lost_rows,
            board: BoardState {
                stack_bytes,
                stack_free_bytes,
                longest_step_us,
                latest_sample_ns,
                temperature_centi_c,
                dropped_frames,
                oscillator_ppm: None,
                longest_fetch_us: 0,
            },
            unknown_messages: 0,
            unsealed_messages: 0,
            stale_rows: 0,
            variance: Vec::new(),
            mean: Vec::new(),
        }
    }
}

/// Reads what a node of version 5 says.
pub fn decode_node(message: &[u8]) -> Result<NodeMessage<'_>, FrameError> {
    let (kind, body) = split_kind(message)?;
    match kind {
        0 => whole::<Hello>(body).map(|hello| NodeMessage::Hello(hello.into())),
        3 => whole::<Heartbeat>(body).map(|heartbeat| NodeMessage::Heartbeat(heartbeat.into())),
        _ => decode(message),
    }
}

/// Writes the frame of what a host says to a node of version 5, and returns its length.
pub fn encode_host(said: &InConversation, out: &mut [u8; MAX_FRAME_BYTES]) -> Result<usize, FrameError> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    let too_long = |_| FrameError::TooLong;
    let message = match said.message {
        // Its greeting carries nothing, and it cannot be asked without being greeted.
        HostMessage::Greet(_) | HostMessage::Ask(_) => postcard::to_slice(&(said.conversation, 0_u8), &mut buffer),
        _ => postcard::to_slice(said, &mut buffer),
    };
    frame::encode_as(VERSION, message.map_err(too_long)?, out)
}

/// Bytes left over make a message of version 5 unreadable.
fn whole<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, FrameError> {
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Message),
    }
}
