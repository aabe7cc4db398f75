//! The messages between a sensor node and its host, and the rules for both: the specification of the protocol.
//!
//! # On the line
//! A frame ([`crate::frame`]) holds one message. What a node says ([`NodeMessage`]) is its kind, a number, and the fields of
//! the message. What a host says ([`InConversation`]) has the number of its conversation in front. Everything is coded by postcard: integers
//! and kinds are varints, floats IEEE 754 little endian, byte strings start with their length. One serial line connects one node with the
//! host.
//!
//! # Versions
//! Nodes hang on towers for years, and hosts are updated. So messages grow, and a version of the protocol talks to the next:
//!
//! - A later version adds fields at a message's end, further kinds of messages, and further values of enums (`message/growth.rs`
//!   says how). A reader leaves what it does not know unread. It passes over messages of kinds that it does not know and counts them
//!   ([`Heartbeat::unknown_messages`]).
//! - Whatever changes otherwise needs a new version of the protocol, and an end that goes on speaking the one before.
//! - Each end says which versions it speaks ([`Versions`]): the host in [`HostMessage::Greet`] and [`HostMessage::Ask`], the node in [`Hello`].
//!   They go on in the highest that both speak. Where there is none, the host names the one of the two to be updated.
//! - These three messages keep their kind, their place in the frame and the fields that they have now in all later versions, and each end
//!   reads them in frames of any version from 6 on. All others count only in a version that the end speaks.
//! - A node answers any undamaged frame of a version that it does not speak, also of one that it cannot know, with its own [`Hello`].
//! - A configuration is as the agreed version has it, and no longer: both ends name it by a hash of the whole.
//!
//! Version 6 is the first of these. A host speaks version 5 too ([`version_5`]); nodes do not.
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
//! A node takes no acknowledgement of windows in its outbox that it has not sent yet: whoever sends it cannot have stored them. One that names
//! windows beyond the newest is dropped whole and counted ([`Heartbeat::refused_messages`]).
//!
//! # Windows of earlier boots
//! A node with a store keeps windows over restarts. Its [`Hello`] names the oldest earlier boot of which it holds windows, and which ([`Kept`]).
//! It sends none of them unasked: the host asks for those that it lacks with an [`Acknowledgement`] that names that boot, and acknowledges
//! them in the same way. A window keeps the name that it was given when it was measured. Once the last one of a boot is acknowledged or
//! overwritten, another `Hello` names the next boot, or none: whatever the host lacks of boots that are no longer held is lost. A store also
//! holds windows of the present boot for which the outbox has no room; `oldest_window` counts them, and they are asked for like all others.
//!
//! The node has room for the messages that arrive while it computes. One that finds none is dropped and counted
//! ([`BoardState::dropped_frames`]); the host repeats whatever is not answered.
//!
//! # A conversation
//! A host draws a number for all that it says ([`Conversation`]). The node listens to the host that greeted it last: what comes
//! under another number is dropped and counted, and answered with a [`Hello`] that says whom the node listens to. So two hosts on
//! one line notice each other, and neither erases windows that the other has not stored. This keeps mistakes out. It keeps nobody out
//! who can write on the line and means to; a key does.
//!
//! Each end opens with an empty frame, which ends whatever an earlier conversation left unfinished on the line. The host says
//! [`HostMessage::Greet`]; the node answers with [`Hello`], which it also says when it starts. A host that only wants to know who is there says
//! [`HostMessage::Ask`] instead, which leaves the node with the host that it listens to. It sends a [`Configuration`]; the node answers with
//! a `Hello` that carries the configuration's hash, or a [`Refusal`]. Then [`ClockRequest`]s and [`ClockReply`]s measure the
//! node's clock, and a [`ClockModel`] tells the node the time (a later `Hello` confirms it). From then on it measures, window by
//! window on the grid of host time ([`crate::time::WindowGrid`]), and host and node exchange windows, acknowledgements and clock
//! readings.
//!
//! # Calibration
//! A host finds out what a node's axes read at rest, with the node laid on its faces: by [`HostMessage::Pace`] it asks for heartbeats every second or so,
//! which have the mean and the variance of each channel. What it finds it tells the node ([`HostMessage::Calibrate`]), which says it in every `Hello`,
//! and keeps it over restarts where it has a store. The node never applies it: windows hold what the sensor says, and hosts multiply by what the
//! study says, once.
//!
//! # Keys
//! A node may have a key, which its host has too. Every frame of both then carries a seal ([`crate::seal`]), made for the node's boot id and with a
//! counter that only rises, and an end takes nothing without one:
//!
//! - The host does not know the boot id yet, so it first says [`HostMessage::Ask`], which needs no seal and changes nothing. The sealed `Hello` that
//!   answers has the number of the host's conversation, which no earlier one has ([`Hello::answers`]): so the host knows that the boot id is the
//!   present one. From its [`Counters`] it knows from where to count. Whatever the node says from then on is new where its counter is higher.
//! - Now the host greets, sealed, and goes on as without a key. What it said in an earlier boot, or has said already, the node refuses, by whatever
//!   way it comes: a node has one counter for all that it hears. Where it no longer hears the host, because too many frames in a row were lost,
//!   its `Hello` says how far it has counted, and a greeting with the whole counter ([`Greeting::counter`]) puts that right.
//! - A node counts the messages without a sound seal ([`Heartbeat::unsealed_messages`]), obeys none, and answers with a `Hello`. Parts of windows are
//!   sealed when they are sent, so those kept through an outage are as good as others.
//! - A host that has a node's key takes nothing from it without a seal; it takes a node for another whose frames are sealed with another key, and
//!   has no use for a sealed node of which it has no key.
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
mod calibration;
mod clock;
mod configuration;
#[cfg(test)]
mod goldens;
mod greeting;
mod growth;
mod heartbeat;
mod hello;
mod recording;
#[cfg(test)]
mod tests;
pub mod version_5;
mod window;

use serde::{Deserialize, Serialize};

pub use acknowledgement::{Acknowledgement, Again, MAX_AGAIN};
pub use calibration::{AxisCalibration, Calibration, LEAST_PACE_MS, Pace};
pub use clock::{ClockReply, ClockRequest};
pub use configuration::{Band, Configuration, MAX_BANDS, MAX_CHANNELS, Refusal, RefusalReason, Summary};
pub use greeting::Greeting;
pub use heartbeat::{BoardState, Heartbeat, MEAN_STEP_M_S2, SensorState};
pub use hello::{Counters, Fault, FaultKind, Hello, Kept, MAX_FURTHER_FAULTS, MAX_PLACE_BYTES, Versions};
pub use recording::{Fed, FeedPart, MAX_FEED, Replay};
pub use window::{
    ChannelState, DensityPart, LinesPart, MAX_DATA_BYTES, MAX_PEAKS, Peak, PeaksPart, WindowHead, WindowName,
};

use crate::frame::{self, FrameError, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES, Opened, PROTOCOL_VERSION};
use crate::time::ClockModel;

/// What a node says. The kinds are 0, 1, 2 and so on, in this order.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NodeMessage<'a> {
    /// Who the node is; said after a start, a greeting or an accepted configuration.
    Hello(Hello),
    /// The answer to a configuration the node cannot run.
    Refused(Refusal),
    /// The node's answer to a clock request.
    Clock(ClockReply),
    /// A sign of life, every two minutes; of a node that sends densities alone, every two and a half.
    Heartbeat(Heartbeat),
    /// Part 0 of a window.
    Head(WindowHead),
    /// A data part: complex lines.
    Lines(LinesPart<'a>),
    /// A data part: averaged power spectral densities.
    Density(DensityPart<'a>),
    /// A data part: peak frequencies.
    Peaks(PeaksPart),
    /// How much of a recording the node has taken.
    Fed(Fed),
}

impl NodeMessage<'_> {
    /// The window of which this is a part, and which part: the head is part 0.
    pub fn part(&self) -> Option<(WindowName, u16)> {
        match self {
            Self::Head(head) => Some((head.name, 0)),
            Self::Lines(lines) => Some((lines.name, lines.part)),
            Self::Density(density) => Some((density.name, density.part)),
            Self::Peaks(peaks) => Some((peaks.name, peaks.part)),
            _ => None,
        }
    }
}

/// What the host says. The kinds are 0, 1, 2 and so on, in this order.
#[expect(clippy::large_enum_variant, reason = "nodes have no heap to put the rows of a recording on")]
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HostMessage {
    /// Asks for a [`Hello`], and to be listened to. A node that speaks none of the host's versions does not listen.
    Greet(Greeting),
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
    /// Asks for a [`Hello`], and changes nothing.
    Ask(Versions),
    /// Asks for heartbeats that come often for a while, whatever the node's summary is with variance and mean.
    Pace(Pace),
    /// Tells the node what its axes read at rest, for it to keep; a [`Hello`] that has it answers.
    Calibrate(Calibration),
}

/// The number of a conversation of a host with a node, drawn at random for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Conversation(pub [u8; 4]);

/// What a host says, and in which conversation.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InConversation {
    /// The host's.
    pub conversation: Conversation,
    /// What it says.
    pub message: HostMessage,
}

/// Writes the frame of a message and returns its length.
pub fn encode(message: &impl Serialize, out: &mut [u8; MAX_FRAME_BYTES]) -> Result<usize, FrameError> {
    frame::encode(bytes(message, &mut [0; MAX_MESSAGE_BYTES])?, out)
}

/// Writes a message without its frame.
pub fn bytes<'b>(message: &impl Serialize, buffer: &'b mut [u8; MAX_MESSAGE_BYTES]) -> Result<&'b [u8], FrameError> {
    postcard::to_slice(message, buffer).map(|bytes| &*bytes).map_err(|_| FrameError::TooLong)
}

/// What can be read from a frame.
pub trait Readable<'a>: Sized {
    /// Reads a message of this version, or of a later one as far as this version knows it.
    fn read(message: &'a [u8]) -> Result<Self, FrameError>;
}

/// Reads the message in a frame ([`frame::Opened::message`]).
pub fn decode<'a, T: Readable<'a>>(message: &'a [u8]) -> Result<T, FrameError> {
    T::read(message)
}

/// The kind in front, and what stands behind it.
fn split_kind(message: &[u8]) -> Result<(u32, &[u8]), FrameError> {
    postcard::take_from_bytes(message).map_err(|_| FrameError::Message)
}

impl<'a> Readable<'a> for NodeMessage<'a> {
    fn read(message: &'a [u8]) -> Result<Self, FrameError> {
        let (kind, body) = split_kind(message)?;
        Ok(match kind {
            0 => Self::Hello(growth::read(body)?),
            1 => Self::Refused(growth::read(body)?),
            2 => Self::Clock(growth::read(body)?),
            3 => Self::Heartbeat(growth::read(body)?),
            4 => Self::Head(growth::read(body)?),
            5 => Self::Lines(growth::read(body)?),
            6 => Self::Density(growth::read(body)?),
            7 => Self::Peaks(growth::read(body)?),
            8 => Self::Fed(growth::read(body)?),
            kind => return Err(FrameError::Unknown { kind }),
        })
    }
}

impl Readable<'_> for InConversation {
    fn read(message: &[u8]) -> Result<Self, FrameError> {
        let (&conversation, message) = message.split_first_chunk().ok_or(FrameError::Message)?;
        let (kind, body) = split_kind(message)?;
        let message = match kind {
            0 => HostMessage::Greet(growth::read(body)?),
            1 => HostMessage::Configure(growth::read(body)?),
            2 => HostMessage::Acknowledge(growth::read(body)?),
            3 => HostMessage::Clock(growth::read(body)?),
            4 => HostMessage::SetClock(growth::read(body)?),
            5 => HostMessage::Replay(growth::read(body)?),
            6 => HostMessage::Feed(growth::read(body)?),
            7 => HostMessage::EndReplay,
            8 => HostMessage::Ask(growth::read(body)?),
            9 => HostMessage::Pace(growth::read(body)?),
            10 => HostMessage::Calibrate(growth::read(body)?),
            kind => return Err(FrameError::Unknown { kind }),
        };
        Ok(Self { conversation: Conversation(conversation), message })
    }
}

/// What a node hears in an undamaged frame.
#[expect(clippy::large_enum_variant, reason = "as of HostMessage")]
#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    /// A message of a version that it speaks, or a greeting of any.
    Message(InConversation),
    /// A frame of another version.
    OtherVersion,
}

/// Reads what a node hears: a message in its own version, or greetings in any other that has them where version 6 has.
pub fn hear(frame: &Opened<'_>) -> Result<Heard, FrameError> {
    if frame.version == PROTOCOL_VERSION {
        return decode(frame.message).map(Heard::Message);
    }
    if frame.version > PROTOCOL_VERSION
        && let Ok(message @ InConversation { message: HostMessage::Greet(_) | HostMessage::Ask(_), .. }) =
            decode(frame.message)
    {
        return Ok(Heard::Message(message));
    }
    Ok(Heard::OtherVersion)
}
