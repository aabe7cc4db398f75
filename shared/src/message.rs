//! The messages between a sensor node and its host, and the rules they follow.
//!
//! # On the line
//! A message is one postcard value ([`NodeMessage`] or [`HostMessage`]) in one frame ([`crate::frame`]). Integers are
//! postcard varints, floats IEEE 754 little endian, byte strings carry their length in front. One serial line joins one
//! node with the host.
//!
//! # Windows and their names
//! A *window* is one measurement interval of one node. It is named by node id, boot id (drawn anew at every start of the
//! node) and a number that counts windows from 0 ([`WindowName`]). Every interval of the grid gets a number, also one
//! without sound data: its head then says why ([`ChannelState`]), so that "no data" and "lost" differ.
//!
//! A window travels as *parts*. Part 0 is its [`WindowHead`]: when it was, how its channels fared, how many parts follow.
//! Parts 1 to `data_parts` carry the data, each readable by itself: [`LinesPart`] under [`Summary::Lines`], [`DensityPart`]
//! and [`PeaksPart`] under [`Summary::Psd`]. Parts may arrive in any order and more than once.
//!
//! # Delivery
//! A node sends every part once and keeps it until acknowledged. Recovery is the host's work: its [`Acknowledgement`]
//! says below which number everything is stored on its side, and which parts it wants again. [`Heartbeat`]s tell the host
//! how many windows there are, so that it can miss the last one. When the outbox is full, the node drops its oldest window and
//! says so (`oldest_window`, `lost_windows`): loss is bounded and stated, never silent.
//!
//! # A conversation
//! The host says [`HostMessage::Greet`]; the node answers with [`Hello`] (also unasked, when it starts). The host compares
//! protocol version and schema hash and refuses a node that differs. It sends a [`Configuration`]; the node answers with
//! a `Hello` that carries the configuration's hash, or a [`Refusal`]. Then [`ClockRequest`]s and [`ClockReply`]s measure the
//! node's clock, and a [`ClockModel`] tells the node the time (a later `Hello` confirms it). From then on it measures, window by window on the grid
//! of host time ([`crate::time::WindowGrid`]), and host and node exchange windows, acknowledgements and clock readings.
//!
//! # Recordings
//! A node can measure a recording instead of its sensor: after [`HostMessage::Replay`] its rows come as [`FeedPart`]s, and the
//! node's clock is the recording's. It says with [`Fed`] how far it has come once everything that follows from the rows is
//! computed and sent; the host keeps few parts on the way, so that the node is neither hurried nor idle.
//!
//! # Units
//! A spectral line is in m/s²/√Hz: its squared magnitude is the one-sided power spectral density in (m/s²)²/Hz of the
//! detrended, Hann-windowed segment, its phase refers to the segment's first sample. Lines count from 0 Hz in steps of the
//! decimated sampling rate over the segment's length.

use heapless::{String, Vec};
use postcard_schema::{Schema, key::Key};
use serde::{Deserialize, Serialize};

use crate::frame::{self, FrameError, MAX_FRAME_BYTES, MAX_MESSAGE_BYTES};
use crate::time::{ClockModel, HostTime, NodeTime};

/// Most channels a node has.
pub const MAX_CHANNELS: usize = 4;
/// Most frequency bands a configuration has.
pub const MAX_BANDS: usize = 8;
/// Most ranges that one acknowledgement asks again.
pub const MAX_AGAIN: usize = 8;
/// Most peaks a node reports a channel.
pub const MAX_PEAKS: usize = 8;
/// Most readings in a [`FeedPart`].
pub const MAX_FEED: usize = 120;
/// Longest [`Fault::place`] in bytes.
pub const MAX_PLACE_BYTES: usize = 64;
/// Most data bytes in a [`LinesPart`] or [`DensityPart`]; the rest of [`MAX_MESSAGE_BYTES`] is for the other fields.
pub const MAX_DATA_BYTES: usize = 480;

/// A hash over the names, types and order of everything in the messages: equal on both sides, or they must not talk.
pub const SCHEMA_HASH: u64 =
    u64::from_le_bytes(Key::for_path::<(NodeMessage<'static>, HostMessage)>("belfry").to_bytes());

/// What a node says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NodeMessage<'a> {
    /// Who the node is; after a start, a greeting or an accepted configuration.
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
    /// How much of a recording it has taken.
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
    /// What is stored, and what is wanted again.
    Acknowledge(Acknowledgement),
    /// Asks for the node's time.
    Clock(ClockRequest),
    /// Tells the node the host's time. A model whose reference moment is older than the known one's, or still to come, is
    /// ignored: it was overtaken on the line, or is wrong.
    SetClock(ClockModel),
    /// Tells the node to measure a recording. Needs a configuration; the next [`Hello`] says whether it does.
    Replay(Replay),
    /// Rows of the recording.
    Feed(FeedPart),
    /// Tells the node to measure with its sensor again; it forgets the time, which was the recording's.
    EndReplay,
}

/// Who a node is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// [`crate::frame::PROTOCOL_VERSION`] of the node.
    pub protocol_version: u8,
    /// [`SCHEMA_HASH`] of the node.
    pub schema_hash: u64,
    /// The node's id, as on its label and in study.toml.
    pub node: u16,
    /// Drawn anew at every start.
    pub boot: u32,
    /// Channels the node's sensor has.
    pub channels: u8,
    /// [`Configuration::hash`] of what it runs; `None` before the first configuration.
    pub configuration_hash: Option<u32>,
    /// Whether the host has told it the time.
    pub clock_set: bool,
    /// The oldest window in its outbox, or the number that the next will have where the outbox is empty: lower ones are gone,
    /// delivered or lost.
    pub oldest_window: u32,
    /// The number the next window will have.
    pub next_window: u32,
    /// Whether it measures a recording.
    pub replaying: bool,
    /// What ended its life before this one, where that was no ordinary end.
    pub fault: Option<Fault>,
}

/// What ended a node's life.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// What it was.
    pub kind: FaultKind,
    /// Address of the instruction; 0 where it is not known.
    pub address: u32,
    /// File and line; empty where they are not known.
    pub place: String<MAX_PLACE_BYTES>,
}

impl core::fmt::Display for Fault {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.kind.fmt(formatter)?;
        if self.place.is_empty() { Ok(()) } else { write!(formatter, " at {}", self.place) }
    }
}

/// Kinds of [`Fault`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FaultKind {
    /// The program gave up.
    #[error("the program stopped itself (a panic)")]
    Panic,
    /// The processor could not go on.
    #[error("the processor stopped (a hard fault)")]
    HardFault,
    /// The stack ran over its end.
    #[error("the stack ran over")]
    StackOverflow,
    /// The program did not come round in time.
    #[error("the program hung, and the watchdog started it anew")]
    Watchdog,
    /// The external clock did not start; the node runs on its inexact internal one.
    #[error("the external clock does not run, and the node's own is inexact")]
    Clock,
}

/// What a node is to measure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Configuration {
    /// Channels to measure, 1 to [`MAX_CHANNELS`].
    pub channels: u8,
    /// Raw sampling rate in µHz.
    pub sampling_rate_uhz: u64,
    /// Raw samples a decimated sample; see [`crate::decimation::Stages`] for what is possible.
    pub decimation: u32,
    /// Decimated samples a segment: 256, 512, 1024, 2048 or 4096.
    pub segment: u16,
    /// What to send.
    pub summary: Summary,
    /// Which lines to send, ascending and without overlap.
    pub bands: Vec<Band, MAX_BANDS>,
}

impl Configuration {
    /// The hash by which node and host name a configuration: CRC-32 of its encoding.
    pub fn hash(&self) -> u32 {
        let mut buffer = [0; MAX_MESSAGE_BYTES];
        // A configuration takes 70 bytes at most, so this does not fail; 0 would only make the host send it again.
        postcard::to_slice(self, &mut buffer).map_or(0, |bytes| frame::crc32(bytes))
    }

    /// Lines a channel sends, all bands together.
    pub fn lines(&self) -> usize {
        self.bands.iter().map(|band| usize::from(band.lines)).sum()
    }

    /// Raw samples between the starts of neighbouring windows' segments (half a segment).
    pub fn hop_samples(&self) -> u64 {
        u64::from(self.segment / 2) * u64::from(self.decimation)
    }
}

/// What a node makes of its segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Summary {
    /// The complex lines of every segment, for modes: a window is one segment.
    Lines {
        /// Bits a component, [`crate::quantise::MIN_BITS`] to [`crate::quantise::MAX_BITS`].
        bits: u8,
    },
    /// Power spectral densities averaged over segments, and their peaks, for slow radios: a window is `segments` segments.
    Psd {
        /// Segments averaged, at least 1.
        segments: u16,
    },
}

/// A run of consecutive spectral lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Band {
    /// Index of the first line.
    pub first_line: u16,
    /// Number of lines.
    pub lines: u16,
}

/// A configuration the node cannot run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Refusal {
    /// [`Configuration::hash`] of what was refused.
    pub configuration_hash: u32,
    /// Why.
    pub reason: RefusalReason,
}

/// Why a node refuses a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RefusalReason {
    /// More channels than the node has, or none.
    #[error("the node has {available} channels")]
    Channels {
        /// Channels the node has.
        available: u8,
    },
    /// The sampling rate is 0, or higher than the sensor can.
    #[error("the sampling rate is not possible: the node samples up to {} Hz", f64::from(*highest_mhz) * 1e-3)]
    SamplingRate {
        /// The highest rate that the node samples at, in mHz.
        highest_mhz: u32,
    },
    /// The decimation does not split into stages.
    #[error("the decimation has no split into at most three stages of 2 to 10")]
    Decimation,
    /// The segment is no power of two from 256 to 4096.
    #[error("the segment is no power of two from 256 to 4096")]
    Segment,
    /// A band is empty, out of order, or reaches beyond the last line.
    #[error("a band is empty, out of order or beyond the last line")]
    Bands,
    /// The summary's bits or segments are out of range.
    #[error("the summary's bits or segments are out of range")]
    Summary,
    /// One window, or the running averages, would not fit into the node's memory.
    #[error("a window needs {needed} bytes, the node has {available}")]
    Memory {
        /// Bytes one window needs.
        needed: u32,
        /// Bytes there are.
        available: u32,
    },
}

/// A window's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowName {
    /// The node's id.
    pub node: u16,
    /// The node's boot id.
    pub boot: u32,
    /// Counts the node's windows from 0.
    pub number: u32,
}

/// Part 0 of a window.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowHead {
    /// Which window.
    pub name: WindowName,
    /// [`Configuration::hash`] of what it was measured with.
    pub configuration_hash: u32,
    /// Start on the grid of host time, in hops since the epoch.
    pub grid_index: u64,
    /// When the segment's middle was, minus when it should have been by the grid, in µs: what the node could not align, and what
    /// its crystal gathered over half a segment. The host removes it as phase. Of densities: the first segment's.
    pub middle_offset_us: i32,
    /// How much faster the host's clock runs than the node's, in parts per thousand million: samples were that much further
    /// apart, and the lines' frequencies that much lower. The host moves the lines.
    pub drift_ppb: i32,
    /// Data parts that belong to the window.
    pub data_parts: u16,
    /// Each channel's fate.
    pub channels: Vec<ChannelState, MAX_CHANNELS>,
}

/// How a channel fared in a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ChannelState {
    /// The data are sound; data parts follow.
    Sound {
        /// Segments they come from: 1 for lines, the number averaged for densities.
        segments: u16,
    },
    /// Samples were missing, or were no numbers.
    Missing,
    /// Samples were at the end of the sensor's range.
    Clipped,
    /// All samples were alike: the sensor is dead or not connected.
    Constant,
    /// The node did not come round to transforming the segment before new samples replaced it.
    Overrun,
}

/// Complex lines of one channel, coded as in [`crate::quantise`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinesPart<'a> {
    /// Which window.
    pub name: WindowName,
    /// Which part, from 1.
    pub part: u16,
    /// Which channel, from 0.
    pub channel: u8,
    /// Index of the first line.
    pub first_line: u16,
    /// Number of lines.
    pub lines: u16,
    /// Bits a component.
    pub bits: u8,
    /// [`crate::quantise::encode_lines`]'s code.
    pub code: &'a [u8],
}

/// Averaged power spectral densities of one channel, coded as in [`crate::quantise`], one byte a line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DensityPart<'a> {
    /// Which window.
    pub name: WindowName,
    /// Which part, from 1.
    pub part: u16,
    /// Which channel, from 0.
    pub channel: u8,
    /// Index of the first line.
    pub first_line: u16,
    /// Base exponent of the logarithmic code.
    pub base: i16,
    /// [`crate::quantise::encode_densities`]' code.
    pub code: &'a [u8],
}

/// The highest peaks of one channel's averaged density.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeaksPart {
    /// Which window.
    pub name: WindowName,
    /// Which part, from 1.
    pub part: u16,
    /// Which channel, from 0.
    pub channel: u8,
    /// The peaks, highest first.
    pub peaks: Vec<Peak, MAX_PEAKS>,
}

/// A spectral peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Peak {
    /// Frequency in Hz, interpolated between lines.
    pub frequency_hz: f32,
    /// Density at the peak in (m/s²)²/Hz.
    pub density: f32,
}

/// A sign of life.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Heartbeat {
    /// The node's id.
    pub node: u16,
    /// The node's boot id.
    pub boot: u32,
    /// The number the next window will have: all lower ones exist or existed.
    pub next_window: u32,
    /// The oldest window still in the outbox (`next_window` where it is empty).
    pub oldest_window: u32,
    /// Windows dropped from a full outbox since the start.
    pub lost_windows: u32,
    /// Frames from the host that were damaged or not understood, since the start.
    pub damaged_frames: u32,
    /// Each channel's level: the RMS of the raw reading about its bias in m/s² since the last heartbeat. Good to 6 % only
    /// (a fast square root); it tells a live sensor from a dead one, and is no measurement.
    pub level: Vec<f32, MAX_CHANNELS>,
    /// What each channel's readings say of its sensor, since the last heartbeat.
    pub sensors: Vec<SensorState, MAX_CHANNELS>,
    /// Rows that stayed out since the start.
    pub lost_rows: u32,
    /// How its board is.
    pub board: BoardState,
}

/// What readings say of a sensor; the first that is true.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SensorState {
    /// There was no reading.
    #[error("absent: it gives no readings")]
    Absent,
    /// All readings were alike.
    #[error("stuck: all readings are alike")]
    Stuck,
    /// Some readings were missing.
    #[error("failing: readings are missing")]
    Failing,
    /// Some readings were at the end of the range.
    #[error("clipped: readings at the end of its range")]
    Clipped,
    /// Readings jump about as no structure moves.
    #[error("noisy: readings jump about as no structure moves")]
    Noisy,
    /// Nothing is wrong.
    #[error("sound")]
    Sound,
}

/// How a node's board is; zeros where it has none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BoardState {
    /// Bytes the stack has.
    pub stack_bytes: u32,
    /// Bytes of it that were never used since the start.
    pub stack_free_bytes: u32,
    /// Longest time between looks at the queue of samples since the start, in µs: what the program was busy with then (a
    /// spectrum, mostly) kept no sample waiting for its interrupt, but the queue must outlast it.
    pub longest_step_us: u32,
    /// Latest that the interrupt of a sample has come since the start, in ns after the timer had called it. The sensor
    /// samples by the timer's pulse, which nothing delays; the interrupt has to fetch the sample before the next pulse.
    pub latest_sample_ns: u32,
    /// The sensor's temperature in units of 0.01 °C; `None` where there is no sensor.
    pub temperature_centi_c: Option<i16>,
}

/// What the host has, and what it wants again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Acknowledgement {
    /// The boot this is about; a node of another boot ignores it.
    pub boot: u32,
    /// All windows with a lower number are stored (or given up): the node forgets them.
    pub below: u32,
    /// Parts wanted again.
    pub again: Vec<Again, MAX_AGAIN>,
}

/// Parts wanted again: those numbered `first_part` to `last_part` of every window from `first_window` to `last_window`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Again {
    /// First window.
    pub first_window: u32,
    /// Last window.
    pub last_window: u32,
    /// First part.
    pub first_part: u16,
    /// Last part (65 535: all).
    pub last_part: u16,
}

/// Tells a node to measure a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Replay {
    /// When row 0 was sampled, in the recording's time. Row n was n sampling periods of the configuration later.
    pub start: HostTime,
}

/// Rows of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FeedPart {
    /// Number of the first row here. The node takes rows in order: a part that does not go on where it stands is left out.
    pub first_row: u64,
    /// Readings in m/s², row by row, one for each channel of the configuration; NaN where one is missing.
    pub readings: Vec<f32, MAX_FEED>,
}

/// How much of a recording a node has taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fed {
    /// The row it waits for.
    pub next_row: u64,
}

/// Asks for the node's time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClockRequest {
    /// When the host sent this.
    pub host_sent: HostTime,
}

/// The node's answer; with the time of its arrival the host has the four times of a two-way exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClockReply {
    /// The request's `host_sent`.
    pub host_sent: HostTime,
    /// When the request's last byte arrived at the node.
    pub node_received: NodeTime,
    /// When the node began to send this.
    pub node_sent: NodeTime,
    /// How long after `host_sent` the request arrived by the host's time as the node has been told it, in µs: what is far from a
    /// line's delay was told by a host whose clock was wrong. `None` where the node has not been told.
    pub believed_delay_us: Option<i64>,
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

#[cfg(test)]
mod tests;
