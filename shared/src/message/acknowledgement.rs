//! What the host has stored, and what it wants again.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most ranges of parts that one acknowledgement asks for again.
pub const MAX_AGAIN: usize = 8;

/// What the host has, and what it wants again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Acknowledgement {
    /// Boot id of the node it is for; a node that has restarted ignores it.
    pub boot: u32,
    /// The host has stored (or given up) all windows with lower numbers; the node forgets those that it has
    /// sent.
    pub below: u32,
    /// Parts wanted again.
    pub again: Vec<Again, MAX_AGAIN>,
}

/// Parts wanted again: those numbered `first_part` to `last_part` of every window from `first_window` to `last_window`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
