//! The messages between a sensor node and its host, and the rules for both: the specification of the protocol.
//!
//! # On the line
//! A message is one postcard value ([`NodeMessage`] or [`InConversation`]) in one frame ([`crate::frame`]). Integers are
//! postcard varints, floats IEEE 754 little endian, byte strings start with their length. One serial line connects one node
//! with the host.
//!
//! # Windows and their names
//! A *window* is one measurement interval of one node. It is named by node id, boot id (drawn anew at every start of the
//! node) and a number that counts windows from 0 ([`WindowName`]). Every interval of the grid gets a number, even one without
//! sound data: its head then says why ([`ChannelState`]). So the host can tell "no data" from "lost".
//!
//! A window travels as *parts*. Part 0 is its [`WindowHead`]: when it was measured, the state of its channels, how many parts
//! follow. Parts 1 to `data_parts` carry the data, each readable by itself: [`LinesPart`] under [`Summary::Lines`], [`DensityPart`]
//! and [`PeaksPart`] under [`Summary::Psd`]. Parts may arrive in any order and more than once.
//!
//! # Delivery
//! A node sends every part once and keeps it until the host acknowledges it. Recovery is up to the host: its
//! [`Acknowledgement`] says below which number it has stored everything, and which parts it wants again. [`Heartbeat`]s say how
//! many windows there are, so that the host notices when even the last one is missing. When the outbox is full, the node drops
//! its oldest window and says so (`oldest_window`, `lost_windows`): no loss is silent.
//!
//! A node takes no acknowledgement of windows that it has not sent yet: whoever sends it cannot have stored them. One that names
//! windows beyond the newest is dropped whole and counted ([`Heartbeat::refused_messages`]).
//!
//! The node has room for the messages that arrive while it computes. One that finds none is dropped and counted
//! ([`BoardState::dropped_frames`]); the host repeats whatever is not answered.
//!
//! # A conversation
//! A host draws a number for all that it says ([`Conversation`]). The node listens to the host that greeted it last: what comes
//! under another number is dropped and counted, and answered with a [`Hello`] that says whom the node listens to. So two hosts on
//! one line notice each other, and neither erases windows that the other has not stored. This keeps mistakes out. It keeps nobody out
//! who can write on the line and means to.
//!
//! Each end opens with an empty frame, which ends whatever an earlier conversation left unfinished on the line. The host says
//! [`HostMessage::Greet`]; the node answers with [`Hello`], which it also says when it starts. The host compares protocol version
//! and schema hash and refuses a node that differs. It sends a [`Configuration`]; the node answers with
//! a `Hello` that carries the configuration's hash, or a [`Refusal`]. Then [`ClockRequest`]s and [`ClockReply`]s measure the
//! node's clock, and a [`ClockModel`] tells the node the time (a later `Hello` confirms it). From then on it measures, window by
//! window on the grid of host time ([`crate::time::WindowGrid`]), and host and node exchange windows, acknowledgements and clock
//! readings.
//!
//! # Recordings
//! A node can measure a recording instead of its sensor: after [`HostMessage::Replay`] the recording's rows arrive as
//! [`FeedPart`]s, and its time replaces the node's. Once the node has computed and sent everything that follows from the rows, it
//! says with [`Fed`] how far it has come. The host sends few parts ahead, so that the node is neither swamped nor idle.
//!
//! # Units
//! A spectral line is in m/s²/√Hz: its squared magnitude is the one-sided power spectral density in (m/s²)²/Hz of the
//! detrended, Hann-windowed segment; its phase refers to the segment's first sample. Lines count from 0 Hz in steps of the
//! decimated sampling rate over the segment's length.

mod acknowledgement;
mod clock;
mod configuration;
mod heartbeat;
mod hello;
mod recording;
#[cfg(test)]
mod tests;
mod window;

use postcard_schema::{Schema, key::Key};
use serde::{Deserialize, Serialize};

pub use acknowledgement::{Acknowledgement, Again, MAX_AGAIN};
pub use clock::{ClockReply, ClockRequest};
pub use configuration::{Band, Configuration, MAX_BANDS, MAX_CHANNELS, Refusal, RefusalReason, Summary};
pub use heartbeat::{BoardState, Heartbeat, SensorState};
pub use hello::{Fault, FaultKind, Hello, MAX_PLACE_BYTES};
pub use recording::{Fed, FeedPart, MAX_FEED, Replay};
pub use window::{
    ChannelState, DensityPart, LinesPart, MAX_DATA_BYTES, MAX_PEAKS, Peak, PeaksPart, WindowHead, WindowName,
};

use crate::frame::{self, FrameError, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES};
use crate::time::ClockModel;

/// A hash over the names, types and order of everything in the messages. Host and node talk only if theirs are equal.
pub const SCHEMA_HASH: u64 =
    u64::from_le_bytes(Key::for_path::<(NodeMessage<'static>, InConversation)>("belfry").to_bytes());

/// What a node says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NodeMessage<'a> {
    /// Who the node is; said after a start, a greeting or an accepted configuration.
    Hello(Hello),
    /// The answer to a configuration the node cannot run.
    Refused(Refusal),
    /// The node's answer to a clock request.
    Clock(ClockReply),
    /// A sign of life, every two minutes.
    Heartbeat(Heartbeat),
    /// Part 0 of a window.
    Head(WindowHead),
    /// A data part: complex lines.
    #[serde(borrow)]
    Lines(LinesPart<'a>),
    /// A data part: averaged power spectral densities.
    #[serde(borrow)]
    Density(DensityPart<'a>),
    /// A data part: peak frequencies.
    Peaks(PeaksPart),
    /// How much of a recording the node has taken.
    Fed(Fed),
}

/// What the host says.
#[expect(clippy::large_enum_variant, reason = "nodes have no heap to put the rows of a recording on")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HostMessage {
    /// Asks for a [`Hello`].
    Greet,
    /// Tells the node what to measure.
    Configure(Configuration),
    /// What the host has stored, and what it wants again.
    Acknowledge(Acknowledgement),
    /// Asks for the node's time.
    Clock(ClockRequest),
    /// Tells the node the host's time. The node ignores a model whose reference moment is older than that of the model it has (a
    /// newer one overtook it on the line) or lies in the future (it is wrong).
    SetClock(ClockModel),
    /// Tells the node to measure a recording. A node without a configuration cannot; the next [`Hello`] says whether it does.
    Replay(Replay),
    /// Rows of the recording.
    Feed(FeedPart),
    /// Tells the node to measure with its sensor again. It forgets the time, which was the recording's.
    EndReplay,
}

/// The number of a host's conversation with nodes, drawn at random when the host starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Conversation(pub [u8; 4]);

/// What a host says, and in which conversation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InConversation {
    /// The host's.
    pub conversation: Conversation,
    /// What it says.
    pub message: HostMessage,
}

/// Writes the frame of a message and returns its length.
pub fn encode(message: &impl Serialize, out: &mut [u8; MAX_FRAME_BYTES]) -> Result<usize, FrameError> {
    let mut buffer = [0; MAX_MESSAGE_BYTES];
    let bytes = postcard::to_slice(message, &mut buffer).map_err(|_| FrameError::TooLong)?;
    frame::encode(bytes, out)
}

/// Reads the message in a frame ([`frame::FrameDecoder::push`]'s result). Bytes left over make it unreadable.
pub fn decode<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, FrameError> {
    match postcard::take_from_bytes(bytes) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Message),
    }
}
