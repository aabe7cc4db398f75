//! Who a node is, and what ended its life before this one.

use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Longest [`Fault::place`] in bytes.
pub const MAX_PLACE_BYTES: usize = 64;

/// Who a node is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// [`crate::frame::PROTOCOL_VERSION`] of the node.
    pub protocol_version: u8,
    /// [`crate::message::SCHEMA_HASH`] of the node.
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
