//! What happens while windows are collected, one event at a time.

use std::time::Duration;

use belfry_shared::message::{ChannelState, WindowName};

use super::status::PortState;

/// Something that has happened.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// When, in Unix time by the computer's clock.
    pub unix: Duration,
    /// The port.
    pub port: String,
    /// The node on it, where it is known.
    pub node: Option<u16>,
    /// What.
    pub what: Happening,
}

/// What has happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Happening {
    /// The port has come to another state.
    State(PortState),
    /// A window is in the archive.
    Stored {
        /// Its name.
        name: WindowName,
        /// When it began, in s of Unix time.
        start_s: f64,
    },
    /// A channel of a window that is in the archive has no sound data.
    Gap {
        /// The window.
        name: WindowName,
        /// The channel of the node, from 0.
        channel: usize,
        /// What was wrong.
        reason: ChannelState,
    },
    /// The archive cannot be written. It is tried again, and nodes keep their windows.
    ArchiveAway {
        /// Why.
        reason: String,
    },
    /// The archive can be written again.
    ArchiveBack {
        /// For how long it could not.
        after: Duration,
    },
    /// Windows of the node no longer exist anywhere.
    Lost {
        /// How many since the last such event.
        windows: u64,
    },
}
