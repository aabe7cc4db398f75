//! Who a node is, and why it restarted.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use super::{Calibration, Conversation, growth};
use crate::frame::PROTOCOL_VERSION;
use crate::time::HostTime;

/// Longest [`Fault::place`] in bytes.
pub const MAX_PLACE_BYTES: usize = 64;
/// Most faults beside the first.
pub const MAX_FURTHER_FAULTS: usize = 6;

/// The versions of the protocol that an end speaks: all from the lowest to the highest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Versions {
    /// The lowest.
    pub lowest: u8,
    /// The highest.
    pub highest: u8,
}

impl Versions {
    /// A node's of this release.
    pub const OF_NODES: Self = Self { lowest: PROTOCOL_VERSION, highest: PROTOCOL_VERSION };
    /// A host's of this release.
    pub const OF_HOSTS: Self = Self { lowest: super::version_5::VERSION, highest: PROTOCOL_VERSION };

    /// The highest version that both ends speak.
    pub fn common(self, other: Self) -> Option<u8> {
        let highest = self.highest.min(other.highest);
        (highest >= self.lowest.max(other.lowest)).then_some(highest)
    }
}

impl core::fmt::Display for Versions {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { lowest, highest } = self;
        match highest.saturating_sub(*lowest) {
            0 => write!(formatter, "version {highest}"),
            1 => write!(formatter, "versions {lowest} and {highest}"),
            _ => write!(formatter, "versions {lowest} to {highest}"),
        }
    }
}

/// Who a node is. From here to the conversations, the fields are the same in all versions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// The versions of the protocol that the node speaks.
    pub versions: Versions,
    /// The node's id, as on its label and in study.toml.
    pub node: u16,
    /// Drawn anew at every start.
    pub boot: u32,
    /// The host whose greeting or question this answers; `None` where it answers none.
    pub answers: Option<Conversation>,
    /// The host that greeted last, to which it listens; `None` before any has.
    pub conversation: Option<Conversation>,
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
    /// Why it restarted, unless it was only switched on.
    #[serde(with = "growth::optional")]
    pub fault: Option<Fault>,
    /// How far sealed frames have been counted; `None` of a node without a key.
    pub counters: Option<Counters>,
    /// What it has kept over restarts; `None` of a node without a store.
    #[serde(default, with = "growth::optional")]
    pub kept: Option<Kept>,
    /// What a host has found out about its axes; `None` before any has. Nodes without one say nothing here, as before there were
    /// calibrations; once another field stands behind this one, they have to.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "growth::optional")]
    pub calibration: Option<Calibration>,
}

/// What a node with a store has kept from before its last start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Kept {
    /// The last time that was stored before this start, by the host's clock; `None` where no host had set the clock.
    pub last_time: Option<HostTime>,
    /// The oldest earlier boot of which it still holds windows.
    pub boot: u32,
    /// The oldest window of that boot that it still holds. Windows with lower numbers are gone, delivered or overwritten.
    pub oldest_window: u32,
    /// One above the last window of that boot that it holds; `oldest_window` where it holds none of any earlier boot.
    pub next_window: u32,
}

impl Kept {
    /// Whether it holds windows of an earlier boot.
    pub fn has_windows(&self) -> bool {
        self.oldest_window < self.next_window
    }
}

/// How far a node has counted sealed frames ([`crate::seal`]) since its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// The counter of the frame that says this.
    pub said: u32,
    /// The counter of the last frame that it took from a host; 0 before the first.
    pub heard: u32,
}

/// Why a node restarted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// What went wrong.
    pub kind: FaultKind,
    /// Address of the instruction; 0 if unknown.
    pub address: u32,
    /// File and line of the source; empty if unknown.
    pub place: String<MAX_PLACE_BYTES>,
    /// Of a hard fault, where the function that failed was to return to (the link register); 0 if unknown.
    #[serde(default)]
    pub link: u32,
    /// Of a hard fault, what the processor could not do: its Configurable Fault Status Register (ARMv7-M, B3.2.15); 0 if unknown.
    #[serde(default)]
    pub status: u32,
    /// What else is wrong at the same time.
    #[serde(default)]
    pub further: Vec<FaultKind, MAX_FURTHER_FAULTS>,
}

impl From<FaultKind> for Fault {
    fn from(kind: FaultKind) -> Self {
        Self { kind, address: 0, place: String::new(), link: 0, status: 0, further: Vec::new() }
    }
}

impl core::fmt::Display for Fault {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.kind.fmt(formatter)?;
        if !self.place.is_empty() {
            write!(formatter, " at {}", self.place)?;
        } else if self.kind == FaultKind::HardFault {
            let Self { address, link, status, .. } = self;
            write!(formatter, " at {address:#010x}, to return to {link:#010x}, status {status:#010x}")?;
        }
        self.further.iter().try_for_each(|kind| write!(formatter, "; {kind}"))
    }
}

/// Kinds of [`Fault`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
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
    /// The external clock did not start; the node runs on its inexact internal one, and does not measure.
    #[error(
        "the external clock does not run, and the node's own is too inexact to measure with: check the board's solder bridges for its clock"
    )]
    Clock,
    /// Where its key should be is something else. It can be asked who it is, and does nothing.
    #[error("its key is damaged or another node's, so it obeys nobody: write the image of its key again")]
    Key,
    /// It was built for a store, and no memory chip that it knows answers. It keeps windows in its RAM only.
    #[error("its memory chip does not answer, so it keeps nothing over a restart: check the chip's wires")]
    Store,
    /// Something of which only a later version knows.
    #[error("of a kind that this version of Belfry does not know")]
    #[serde(other)]
    Unknown,
}
