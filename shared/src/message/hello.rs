//! Who a node is, and why it restarted.

use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::Conversation;

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
    /// Number of channels of the node's sensor.
    pub channels: u8,
    /// [`crate::message::Configuration::hash`] of what it runs; `None` before the first configuration.
    pub configuration_hash: Option<u32>,
    /// Whether a host has set its clock.
    pub clock_set: bool,
    /// The oldest window in its outbox (`next_window` if the outbox is empty). Windows with lower numbers are gone, delivered or
    /// lost.
    pub oldest_window: u32,
    /// The number the next window will have.
    pub next_window: u32,
    /// Whether it measures a recording.
    pub replaying: bool,
    /// The host that greeted last, to which it listens; `None` before any has.
    pub conversation: Option<Conversation>,
    /// Why it restarted, unless it was only switched on.
    pub fault: Option<Fault>,
}

/// Why a node restarted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// What went wrong.
    pub kind: FaultKind,
    /// Address of the instruction; 0 if unknown.
    pub address: u32,
    /// File and line of the source; empty if unknown.
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
    /// The program panicked.
    #[error("the program stopped itself (a panic)")]
    Panic,
    /// The processor met an instruction or an address it cannot handle.
    #[error("the processor stopped (a hard fault)")]
    HardFault,
    /// The stack ran over its end.
    #[error("the stack overflowed")]
    StackOverflow,
    /// The program hung, and the watchdog reset it.
    #[error("the program hung, and the watchdog restarted it")]
    Watchdog,
    /// The external clock did not start; the node runs on its inexact internal one.
    #[error("the external clock does not run, and the node's own is inexact")]
    Clock,
}
